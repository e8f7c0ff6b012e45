"""Long horizons by overlapping windows in time, each solved by another back end."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from solvers.placewise import PlacewiseEvaluator
from solvers.program import Instance, Program
from solvers.solution import Solution, Start
from solvers.solve import back_ends, installed, prepare
from solvers.status import SolutionStatus, TerminationCondition
from solvers.structure import Kind, classify
from solvers.windows.chain import Chain, Sessions
from solvers.windows.crew import crew
from solvers.windows.decay import best_overlap, influence
from solvers.windows.partition import Partition, spans
from solvers.windows.piece import Piece
from solvers.windows.settings import Settings
from solvers.windows.staged import Staged
from solvers.windows.sweeps import Sweep, Sweeps
from solvers.windows.window import Span, Window

__all__ = ["Windows", "WindowsSession"]

_MOST_VARIABLES = 120_000  # of a window whose length is not stated
_JUMP = 1e-8  # p.u.: largest primal jump at a seam that is left


class Windows:
    """Programs in stages, window by window; ``windows:NAME`` selects the back end of the windows."""

    name = "windows"
    accepts = Kind.NONLINEAR
    in_parts = True

    def solvers(self) -> Iterator[str]:
        """The other back ends, IPOPT first."""
        others = [name for name, end in back_ends().items() if name != self.name and installed(end)]
        yield from sorted(others, key=lambda name: name != "ipopt")

    def prepare(
        self, program: Program, solver: str, options: Mapping[str, Any], verbose: bool
    ) -> WindowsSession:
        """Check the options; windows are compiled at the first instance."""
        return WindowsSession(program, solver, options, verbose)


class WindowsSession:
    """A program to be solved by windows.

    Attributes
    ----------
    trace
        The course of the last solve.
    overlap
        That of its windows.
    """

    def __init__(self, program: Program, solver: str, options: Mapping[str, Any], verbose: bool) -> None:
        self._program = program
        self._solver = solver
        self._settings, self._options = Settings.split(options)
        self._verbose = verbose
        self._evaluator = PlacewiseEvaluator(program)
        self.trace: list[Sweep] = []
        self.overlap = 0  # not known yet
        self._cut: _Cut | None = None
        self._recalled: Mapping[str, Mapping[str, Any]] = {}

    def solve(self, instance: Instance, start: Start | None = None) -> Solution:
        """Solve an instance by sweeps over the windows."""
        settings, cut = self._settings, self._cut_for(instance)
        made = [Chain(cut.sessions, _pieces(chain, instance)) for chain in cut.partition.chains]
        with crew(made, settings) as solve:
            sweeps = Sweeps(cut.partition, instance, solve, self._evaluator, settings.proximal, start)
            self.trace = sweeps.trace
            while not sweeps.done(settings.tolerance) and len(self.trace) < settings.sweeps:
                sweeps.sweep()
                self._say(sweeps)
                if sweeps.done(settings.tolerance) and sweeps.failed is None and self.trace[-1].jump > _JUMP:
                    behind = Partition(cut.staged, [cut.alone[len(cut.partition.chains[0]) :]])
                    sweeps.close(behind.windows, Sessions(behind.programs, self._solver, self._options))
                    self._say(sweeps)
        return self._solution(sweeps, len(cut.alone), instance)

    def _say(self, sweeps: Sweeps) -> None:
        if self._verbose and sweeps.failed is None:
            sys.stdout.write(f"{self.trace[-1]}\n")

    def memory(self) -> dict[str, Any]:
        """Return the measured overlap and what the back end of the windows remembers."""
        sessions = self._recalled if self._cut is None else self._cut.sessions.memory()
        return {"overlap": self.overlap, "sessions": dict(sessions)}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Put back what :meth:`memory` returned; an overlap that is not known is measured again."""
        overlap, sessions = int(memory.get("overlap", 0)), memory.get("sessions", {})
        if self._cut is not None and (self._settings.overlap != "auto" or overlap == self.overlap):
            self._cut.sessions.recall(sessions)
        else:
            self.overlap, self._cut, self._recalled = overlap, None, sessions

    def _cut_for(self, instance: Instance) -> _Cut:
        """Return the program cut into windows; again the last one, if the same rows are in force."""
        free = np.isneginf(instance.row_lower) & np.isposinf(instance.row_upper)
        if self._cut is not None and np.array_equal(free, self._cut.free):
            return self._cut
        staged = Staged(self._program, instance)
        length = self._length(staged)
        self.overlap = self.overlap or self._overlap(staged, length, instance)
        alone = spans(staged.stages, length, self.overlap)
        chains = _split(len(alone), self._settings.workers)
        led = spans(staged.stages, length, self.overlap, frozenset(chain[0] for chain in chains))
        partition = Partition(staged, [[led[number] for number in chain] for chain in chains])
        sessions = Sessions(partition.programs, self._solver, self._options, self._recalled)
        self._cut, self._recalled = _Cut(free, staged, alone, partition, sessions), {}
        return self._cut

    def _length(self, staged: Staged) -> int:
        """Return the number of stages that a window has of its own."""
        if self._settings.window != "auto":
            return min(self._settings.window, staged.stages)
        each = self._program.n_variables / staged.stages
        return int(np.clip(_MOST_VARIABLES / max(each, 1.0), 1, staged.stages))

    def _overlap(self, staged: Staged, length: int, instance: Instance) -> int:
        """Return the overlap that is stated, or the best one by the decay that a longer window shows."""
        if self._settings.overlap != "auto":
            return self._settings.overlap
        reach = length + max(length // 2, 1)
        while reach < staged.stages:
            window = Window(staged, Span(0, 0, reach, reach))
            session = prepare(window.program([window]), self._solver, self._options)
            change = influence(window, session, instance)
            if change is None:  # the sweeps will fail in the same place, and say so
                return length
            best = best_overlap(change, length)
            if best is not None:
                return best
            reach *= 2
        return staged.stages

    def _solution(self, sweeps: Sweeps, windows: int, instance: Instance) -> Solution:
        """Return the solution, with the status that the gap and the windows support."""
        last, failed = self.trace[-1] if self.trace else None, sweeps.failed
        if failed is not None:
            window, found = failed
            termination, status, message = found.termination, found.status, found.message
            if window.span.first:  # from where the window before it ends; perhaps not from elsewhere
                status = SolutionStatus.NONE
            if windows > 1:
                message = f"{message}, in stages {window.span.first} to {window.span.last - 1}"
        else:
            assert last is not None
            swept = f"{_counted(last.number, 'sweep')} of {_counted(windows, 'window')}"
            message = f"gap {last.gap:.1e} after {swept}"
            convex = classify(self._program, instance).kind < Kind.NONLINEAR
            status = SolutionStatus.GLOBALLY_OPTIMAL if convex else SolutionStatus.LOCALLY_OPTIMAL
            termination = TerminationCondition.CONVERGED
            if not last.gap <= self._settings.tolerance:
                status, termination = SolutionStatus.NONE, TerminationCondition.ITERATION_LIMIT
        return Solution(
            program=self._program,
            evaluator=self._evaluator,
            instance=instance,
            x=sweeps.x,
            lam_x=sweeps.lam_x,
            lam_g=sweeps.lam_g,
            z=sweeps.z,
            termination=termination,
            status=status,
            message=message,
            solver=f"{Windows.name}:{self._solver}",
            iterations=sweeps.iterations,
            seconds=sweeps.seconds,
        )


class _Cut(NamedTuple):
    """A program cut into windows.

    Attributes
    ----------
    free
        The rows that are not in force.
    alone
        The windows of a single chain.
    """

    free: npt.NDArray[np.bool_]
    staged: Staged
    alone: list[Span]
    partition: Partition
    sessions: Sessions


def _pieces(chain: list[Window], instance: Instance) -> list[Piece]:
    """Return the windows of a chain."""
    before = [None, *chain]
    return [Piece.of(window, instance, last) for last, window in zip(before, chain, strict=False)]


def _split(windows: int, workers: int) -> list[list[int]]:
    """Return the numbers of the windows of each worker, of about the same number each."""
    shares = np.array_split(np.arange(windows), min(workers, windows))
    return [share.tolist() for share in shares]


def _counted(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
