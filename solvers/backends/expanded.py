"""IPOPT on the expanded form of programs, in which intermediate quantities are variables."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from typing import Any

from solvers.assembly import Evaluator
from solvers.backends.ipopt import IpoptSession
from solvers.expansion import expand
from solvers.program import Instance, Program
from solvers.solution import Solution, Start
from solvers.status import SolutionStatus, TerminationCondition
from solvers.structure import Kind

__all__ = ["Expanded", "TwoForms"]

# Pivots that are delayed for want of scaling fill the factors of large grids; docs/backends.md has figures.
_OPTIONS = {"mumps_scaling": 77}
_LOST = (TerminationCondition.NO_PROGRESS, TerminationCondition.NUMERICAL_FAILURE)


class Expanded:
    """IPOPT on the program that :func:`solvers.expansion.expand` makes of a program."""

    name = "expanded"
    accepts = Kind.NONLINEAR

    def solvers(self) -> Iterator[str]:
        """Itself: that the solver is IPOPT goes without saying."""
        yield self.name

    def prepare(
        self,
        program: Program,
        solver: str,  # noqa: ARG002
        options: dict[str, Any],
        verbose: bool,
    ) -> ExpandedSession:
        """Expand ``program`` and prepare it for IPOPT."""
        return ExpandedSession(program, options, verbose)


class ExpandedSession:
    """A program prepared in its expanded form."""

    def __init__(self, program: Program, options: dict[str, Any], verbose: bool) -> None:
        self._form = expand(program)
        self._evaluator = Evaluator(program)
        self._session = IpoptSession(self._form.program, "ipopt", _OPTIONS | options, verbose)

    def solve(self, instance: Instance, start: Start | None = None) -> Solution:
        """Solve an instance; a start that includes multipliers is a warm start."""
        begin = None if start is None else self._form.start(start, instance)
        solution = self._session.solve(self._form.instance(instance), begin)
        return replace(self._form.solution(solution, self._evaluator, instance), solver=Expanded.name)


class TwoForms:
    """A program that IPOPT solves as it is or, where it finds nothing from a cold start, in expanded form.

    If the expanded form fails too, an attempt that was stopped because it went nowhere is made once more,
    without end; so nothing is given up that is found with patience. Forms are prepared when they are needed.
    A warm start that fails is left to the caller, who has others to offer.
    """

    def __init__(self, program: Program, options: dict[str, Any], verbose: bool) -> None:
        self._program, self._options, self._verbose = program, options, verbose
        self._given = IpoptSession(program, "ipopt", options, verbose, watched=True)

    @cached_property
    def _expanded(self) -> ExpandedSession:
        return ExpandedSession(self._program, self._options, self._verbose)

    @cached_property
    def _patient(self) -> IpoptSession:
        return IpoptSession(self._program, "ipopt", self._options, self._verbose)

    def solve(self, instance: Instance, start: Start | None = None) -> Solution:
        """Solve an instance; a start that includes multipliers is a warm start."""
        first = self._given.solve(instance, start)
        warm = start is not None and start.lam_g is not None
        if warm or first.termination not in _LOST:
            return first
        second = self._expanded.solve(instance, start)
        if second.status is not SolutionStatus.NONE:
            return second.after(first)
        if first.termination is not TerminationCondition.NO_PROGRESS:
            return second.after(first)
        return self._patient.solve(instance, start).after(first, second)
