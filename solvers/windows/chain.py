"""Windows that are solved one after another, each from where the one before it ends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from solvers.program import Array, Program
from solvers.solution import Start
from solvers.solve import Session, prepare, recall_session, session_memory
from solvers.status import SolutionStatus, TerminationCondition
from solvers.windows.piece import End, Piece

__all__ = ["Chain", "Found", "Sessions"]


class Sessions(dict[bytes, Session]):
    """Compiled programs by structure, each compiled when it is first needed.

    Parameters
    ----------
    recalled
        What the sessions remember, by the structure in hexadecimal digits; see :meth:`memory`.
    """

    def __init__(
        self,
        programs: Mapping[bytes, Program],
        solver: str,
        options: Mapping[str, Any],
        recalled: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> None:
        super().__init__()
        self._programs = programs
        self._solver, self._options = solver, dict(options)
        self._recalled = recalled or {}

    def __missing__(self, structure: bytes) -> Session:
        self[structure] = prepare(self._programs[structure], self._solver, self._options)
        recall_session(self[structure], self._recalled.get(structure.hex(), {}))
        return self[structure]

    def memory(self) -> dict[str, Mapping[str, Any]]:
        """Return what the sessions remember, and those that are not prepared yet shall."""
        known = {structure.hex(): session_memory(session) for structure, session in self.items()}
        return {**self._recalled, **{structure: memory for structure, memory in known.items() if memory}}

    def recall(self, recalled: Mapping[str, Mapping[str, Any]]) -> None:
        """Put back what :meth:`memory` returned, also in sessions that are not prepared yet."""
        self._recalled = recalled
        for structure, session in self.items():
            recall_session(session, recalled.get(structure.hex(), {}))


@dataclass(frozen=True, eq=False)
class Found:
    """What a window found in a sweep.

    Attributes
    ----------
    x, lam_x, lam_g, z
        Of its own stages.
    price
        Of the end of its own stages, by its own multipliers.
    joint
        Values of the variables in which its own stages touch those before.
    """

    termination: TerminationCondition
    status: SolutionStatus
    message: str
    iterations: int
    x: Array
    lam_x: Array
    lam_g: Array
    z: Array
    price: Array
    joint: Array


class Chain:
    """Windows in their order."""

    def __init__(self, sessions: Sessions, pieces: Sequence[Piece]) -> None:
        self._sessions = sessions
        self._pieces = pieces
        self._last: _Last | None = None

    def sweep(
        self, given: Array | None, ends: Sequence[End | None], starts: Sequence[Start | None]
    ) -> list[Found]:
        """Solve the windows; stop at one that fails.

        Parameters
        ----------
        given
            Values before the first window; None if they are not known.
        ends
            Of each window; None if it is not known, at the first sweep: the price of the end is then that
            which the window before it found at the end of its own stages.
        starts
            Point of each to start from; None if it is not known: that of the window solved last, moved in
            time.
        """
        found: list[Found] = []
        for number, (piece, end, start) in enumerate(zip(self._pieces, ends, starts, strict=True)):
            if number and piece.link is not None and self._last is not None:
                given = self._last.start.x[piece.link]
            known = found[-1].price if found else None
            found.append(self.solve(number, given, end or _as_before(piece, known), start))
            if not found[-1].status.is_optimal:
                break
        return found

    def solve(self, number: int, given: Array | None, end: End, start: Start | None) -> Found:
        """Solve one window from a starting point, else from the window solved last."""
        piece, last = self._pieces[number], self._last
        if start is None and last is not None and last.structure == piece.structure:
            start = replace(last.start, moved=1)
        session, instance = self._sessions[piece.structure], piece.posed(given, end)
        solution = session.solve(instance, start)
        iterations = solution.iterations or 0
        if start is not None and not solution.status.is_optimal:
            solution = session.solve(instance)
            iterations += solution.iterations or 0
        self._last = _Last(piece.structure, solution.start())
        variables, rows, cones = piece.own
        return Found(
            solution.termination,
            solution.status,
            solution.message,
            iterations,
            solution.x[variables],
            solution.lam_x[variables],
            solution.lam_g[rows],
            solution.z[cones],
            np.zeros(0) if piece.seam is None else piece.seam.price(solution.x, solution.lam_g),
            solution.x[piece.joint],
        )


def _as_before(piece: Piece, known: Array | None) -> End:
    """Return an end of the price that the window before has found at its own, if it has one."""
    free = End.free(piece.behind)
    return free if known is None or known.size != piece.behind else replace(free, price=known)


class _Last(NamedTuple):
    """The structure of the window that was solved last, and its solution."""

    structure: bytes
    start: Start
