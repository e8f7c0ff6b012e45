"""What programs of the same structure share: the functions assembled from their templates.

Assembled functions depend on the templates of a program, on their places and on its program data. Bounds,
parameters that instances may change and starting points are arguments, and names are for messages. So two
programs that differ in nothing else have the same functions, and assembling them is most of the work of
preparing a program. Solvers and their state are never shared. Starting points are shared on request.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any

from solvers.program import Index, Program
from solvers.template import Template

if TYPE_CHECKING:
    from solvers.solution import Start

__all__ = ["Sharing", "assembled", "of_starts", "structure_digest"]


class Sharing:
    """The functions of the last few programs that were assembled while it was active.

    Parameters
    ----------
    most
        Number of programs.
    variables
        Total number of variables of these programs, which limits memory; a program with more is not kept.

    Attributes
    ----------
    assembled, shared
        How many programs were assembled, and how many took the functions of another one.

    Examples
    --------
    >>> from solvers import ProgramBuilder, Sharing, solve
    >>> def bounded(lower):
    ...     build = ProgramBuilder()
    ...     x = build.variable("x", 1, lower=lower)
    ...     build.minimize(x**2)
    ...     return build.build()
    >>> sharing = Sharing()
    >>> with sharing.active():
    ...     found = [round(solve(bounded(lower), "ipopt").objective, 4) for lower in (1.0, 2.0)]
    >>> found, sharing.assembled, sharing.shared
    ([1.0, 4.0], 1, 1)
    """

    def __init__(self, most: int = 8, variables: int = 40_000) -> None:
        self.most = most
        self.variables = variables
        self.assembled = self.shared = 0
        self._kept: OrderedDict[str, tuple[int, Any]] = OrderedDict()
        self._starts: OrderedDict[str, Start] = OrderedDict()

    @contextmanager
    def active(self, starts: bool = False) -> Iterator[None]:
        """Share the functions of all programs that this thread prepares inside the context.

        Parameters
        ----------
        starts
            Whether the first solve of a program, if it has no starting point of its own, starts from the
            first solution of the last program of the same structure. Without a result it starts again,
            from its own default.
        """
        token = _ACTIVE.set((self, starts))
        try:
            yield
        finally:
            _ACTIVE.reset(token)

    def clear(self) -> None:
        """Forget all functions and starting points."""
        self._kept.clear()
        self._starts.clear()

    def start(self, digest: str) -> Start | None:
        """Return the first solution of the last program of a structure."""
        return self._starts.get(digest)

    def keep_start(self, digest: str, start: Start) -> None:
        """Keep the first solution of a program for the next one of its structure."""
        self._starts[digest] = start
        self._starts.move_to_end(digest)
        while len(self._starts) > self.most:
            self._starts.popitem(last=False)

    def of(self, program: Program, assemble: Callable[[Program], Any]) -> Any:
        """Return the functions of a program, or of an earlier one with the same structure."""
        digest = structure_digest(program)
        if digest in self._kept:
            self.shared += 1
            self._kept.move_to_end(digest)
            return self._kept[digest][1]
        self.assembled += 1
        made = assemble(program)
        if program.n_variables > self.variables:
            return made
        self._kept[digest] = program.n_variables, made
        while len(self._kept) > self.most or sum(size for size, _ in self._kept.values()) > self.variables:
            self._kept.popitem(last=False)
        return made


_ACTIVE: ContextVar[tuple[Sharing, bool] | None] = ContextVar("sharing", default=None)


def assembled(program: Program, assemble: Callable[[Program], Any]) -> Any:
    """Return the functions of a program, shared if a :class:`Sharing` is active."""
    active = _ACTIVE.get()
    return assemble(program) if active is None else active[0].of(program, assemble)


def of_starts() -> Sharing | None:
    """Return the active :class:`Sharing` if it shares starting points."""
    active = _ACTIVE.get()
    return None if active is None or not active[1] else active[0]


def structure_digest(program: Program) -> str:
    """Return a digest that is equal for programs that can share their functions."""
    digest = hashlib.sha256()
    sizes = program.n_variables, program.n_parameters, program.n_rows, program.n_cone_values
    fixed = program.fixed_parameters
    digest.update(repr(sizes).encode())
    digest.update(fixed.tobytes())
    digest.update(program.values[fixed].tobytes())
    for role in (program.constraints, program.costs, program.cone_values):
        digest.update(f"{len(role)} placements".encode())
        for placement in role:
            _add(digest, placement.template, placement.variables, placement.parameters, placement.into)
    return digest.hexdigest()


def _add(digest: Any, template: Template, *positions: Index) -> None:
    digest.update(template.serialized.encode())
    for index in positions:
        digest.update(repr(index.shape).encode())
        digest.update(index.tobytes())
