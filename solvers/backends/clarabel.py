"""Clarabel, called directly: linear, convex quadratic and second-order cone programs."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping
from importlib.util import find_spec
from typing import Any

import numpy as np
import scipy.sparse as sp

from solvers.assembly import Evaluator
from solvers.certify import certified
from solvers.errors import SolverOptionError
from solvers.matrices import Matrices, MatrixMaker
from solvers.program import Array, Cone, Instance, Program
from solvers.solution import Solution, Start
from solvers.status import SolutionStatus, TerminationCondition
from solvers.structure import Kind

__all__ = ["Clarabel"]

_TERMINATION = {
    "Solved": TerminationCondition.CONVERGED,
    "AlmostSolved": TerminationCondition.ACCEPTABLE,
    "PrimalInfeasible": TerminationCondition.INFEASIBLE,
    "AlmostPrimalInfeasible": TerminationCondition.INFEASIBLE,
    "DualInfeasible": TerminationCondition.UNBOUNDED,
    "AlmostDualInfeasible": TerminationCondition.UNBOUNDED,
    "MaxIterations": TerminationCondition.ITERATION_LIMIT,
    "MaxTime": TerminationCondition.TIME_LIMIT,
    "InsufficientProgress": TerminationCondition.NUMERICAL_FAILURE,
    "NumericalError": TerminationCondition.NUMERICAL_FAILURE,
}


class Clarabel:
    """Linear, quadratic and second-order cone programs through Clarabel."""

    name = "clarabel"
    accepts = Kind.CONIC

    def solvers(self) -> Iterator[str]:
        """Clarabel, if it is installed."""
        if find_spec("clarabel"):
            yield "clarabel"

    def prepare(
        self,
        program: Program,
        solver: str,  # noqa: ARG002
        options: Mapping[str, Any],
        verbose: bool,
    ) -> ClarabelSession:
        """Fold the program into matrices."""
        return ClarabelSession(program, options, verbose)


class ClarabelSession:
    """A program as matrices, passed to a new Clarabel solver for every instance.

    Updating the vectors of one solver instead saves 2 of 13 ms on DC problems with 48 stages and
    5 buses and nothing with 118 buses, and ties every instance to the equilibration of the first.
    """

    def __init__(self, program: Program, options: Mapping[str, Any], verbose: bool) -> None:
        self._evaluator = Evaluator(program)
        self._maker = MatrixMaker(self._evaluator)
        self._settings = _settings(options, verbose)

    def solve(self, instance: Instance, start: Start | None = None) -> Solution:  # noqa: ARG002
        """Solve an instance; Clarabel ignores the start."""
        matrices = self._maker.at(instance)
        began = time.perf_counter()
        stated = _Stated(matrices, self._evaluator.program.cones.values())
        found = stated.solve(self._settings)
        lam_x, lam_g, z = stated.multipliers(np.array(found.z))
        message = str(found.status)
        return certified(
            Solution(
                program=self._evaluator.program,
                evaluator=self._evaluator,
                instance=instance,
                x=np.array(found.x),
                lam_x=lam_x,
                lam_g=lam_g,
                z=z,
                termination=_TERMINATION.get(message, TerminationCondition.ERROR),
                status=SolutionStatus.NONE,
                message=message,
                solver="clarabel",
                iterations=int(found.iterations),
                seconds=time.perf_counter() - began,
            )
        )


class _Stated:
    """A program in Clarabel's form, with the inverse mapping of multipliers.

    ``minimise x' p x / 2 + q' x`` such that ``b - a x`` lies in a product of cones: zero for
    equations, nonnegative for inequalities, and second-order cones. Every row is one of ``(a; I; s)``
    of the program, with its sign reversed if it is bounded from below or belongs to a cone.
    """

    def __init__(self, m: Matrices, cones: Iterable[Cone]) -> None:
        import clarabel

        lower, upper = m.limits
        free = lower < upper
        equal = np.flatnonzero(~free)
        above, below = (np.flatnonzero(free & np.isfinite(side)) for side in (upper, lower))
        self._sizes = m.row_lower.size, m.q.size, m.s0.size
        self._rows = np.concatenate([equal, above, below, lower.size + np.arange(m.s0.size)])
        self._signs = np.repeat([1.0, -1.0], [equal.size + above.size, below.size + m.s0.size])
        whole = sp.vstack([m.a, sp.eye_array(m.q.size), m.s], format="csr")
        self._a = (sp.diags_array(self._signs) @ whole[self._rows]).tocsc()
        self._b = np.concatenate([upper[equal], upper[above], -lower[below], m.s0])
        self._cones = [
            clarabel.ZeroConeT(equal.size),
            clarabel.NonnegativeConeT(above.size + below.size),
            *(clarabel.SecondOrderConeT(c.dimension) for c in cones for _ in range(c.items * c.stages)),
        ]
        # Measured on SOC relaxations: with this scale all 14 PGLib cases are solved, in 267 iterations;
        # divided by the largest slope, seven stop short of their tolerance. Unscaled, all are solved too, but
        # two of four elastic problems end without a result. DC problems, elastic or not, are best unscaled.
        self._scale = m.cost_scale if m.s0.size else 1.0
        self._p, self._q = sp.triu(m.p, format="csc") / self._scale, m.q / self._scale

    def solve(self, settings: Any) -> Any:
        """Return Clarabel's solution."""
        import clarabel

        return clarabel.DefaultSolver(self._p, self._q, self._a, self._b, self._cones, settings).solve()

    def multipliers(self, found: Array) -> tuple[Array, Array, Array]:
        """``(lam_x, lam_g, z)`` of the program, from the multipliers of the rows."""
        signed = np.zeros(sum(self._sizes))
        np.add.at(signed, self._rows, self._scale * self._signs * found)
        lam_g, lam_x, z = np.split(signed, np.cumsum(self._sizes)[:-1])
        return lam_x, lam_g, -z


def _settings(options: Mapping[str, Any], verbose: bool) -> Any:
    """Clarabel's settings, tried on an empty program because some values are rejected only there."""
    import clarabel

    settings, nothing = clarabel.DefaultSettings(), sp.csc_array((0, 0))
    settings.verbose = verbose
    try:
        for name, value in options.items():
            setattr(settings, name, value)
        clarabel.DefaultSolver(nothing, np.zeros(0), nothing, np.zeros(0), [], settings)
    except Exception as error:  # Clarabel has no exception class, and only the options can be wrong
        raise SolverOptionError(f"clarabel rejected options {options}: {error}") from error
    return settings
