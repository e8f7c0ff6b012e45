"""OSQP, called directly: linear and convex quadratic programs, with primal and dual warm starts."""

from __future__ import annotations

import io
import time
from collections.abc import Iterator, Mapping
from contextlib import nullcontext, redirect_stdout
from dataclasses import dataclass, fields
from importlib.util import find_spec
from typing import Any

import numpy as np
import scipy.sparse as sp

from solvers.assembly import Evaluator
from solvers.certify import certified
from solvers.errors import SolverOptionError
from solvers.matrices import MatrixMaker
from solvers.program import Array, Instance, Program
from solvers.solution import Solution, Start
from solvers.status import SolutionStatus, TerminationCondition
from solvers.structure import Kind

__all__ = ["OSQP"]

_DEFAULTS: dict[str, Any] = {"eps_abs": 1e-6, "eps_rel": 1e-6, "max_iter": 50_000, "polishing": True}
_TERMINATION = {
    "OSQP_SOLVED": TerminationCondition.CONVERGED,
    "OSQP_SOLVED_INACCURATE": TerminationCondition.ACCEPTABLE,
    "OSQP_PRIMAL_INFEASIBLE": TerminationCondition.INFEASIBLE,
    "OSQP_PRIMAL_INFEASIBLE_INACCURATE": TerminationCondition.INFEASIBLE,
    "OSQP_DUAL_INFEASIBLE": TerminationCondition.UNBOUNDED,
    "OSQP_DUAL_INFEASIBLE_INACCURATE": TerminationCondition.UNBOUNDED,
    "OSQP_MAX_ITER_REACHED": TerminationCondition.ITERATION_LIMIT,
    "OSQP_TIME_LIMIT_REACHED": TerminationCondition.TIME_LIMIT,
    "OSQP_NON_CVX": TerminationCondition.INVALID_PROGRAM,
    "OSQP_NONCVX_ERROR": TerminationCondition.INVALID_PROGRAM,  # detected during setup
    "OSQP_SIGINT": TerminationCondition.INTERRUPTED,
}


class OSQP:
    """Linear and convex quadratic programs through OSQP."""

    name = "osqp"
    accepts = Kind.QUADRATIC

    def solvers(self) -> Iterator[str]:
        """OSQP, if it is installed."""
        if find_spec("osqp"):
            yield "osqp"

    def prepare(
        self,
        program: Program,
        solver: str,  # noqa: ARG002
        options: Mapping[str, Any],
        verbose: bool,
    ) -> OSQPSession:
        """Fold the program into matrices; OSQP is set up at the first instance."""
        return OSQPSession(program, options, verbose)


@dataclass(frozen=True)
class _Found:
    """Result of OSQP; for an infeasible program the certificate replaces the multipliers."""

    status: str
    message: str
    x: Array
    multipliers: Array
    iterations: int


class OSQPSession:
    """A program as matrices, set up once; instances update vectors, and matrix values if necessary."""

    def __init__(self, program: Program, options: Mapping[str, Any], verbose: bool) -> None:
        self._evaluator = Evaluator(program)
        self._maker = MatrixMaker(self._evaluator)
        self._options = _checked(_DEFAULTS | {"verbose": verbose} | dict(options))
        self._solver: Any = None
        self._stated: tuple[sp.csc_matrix, sp.csc_matrix] | None = None
        self._scaled_by: Instance | None = None  # whose matrices and costs OSQP has scaled
        self._adapted = False

    def solve(self, instance: Instance, start: Start | None = None) -> Solution:
        """Solve, from the values and multipliers of ``start`` or from zero.

        Raises
        ------
        KeyboardInterrupt
            Ctrl-C, which OSQP catches itself.
        """
        began = time.perf_counter()
        with nullcontext() if self._options["verbose"] else redirect_stdout(io.StringIO()):
            found = self._call(instance, _point(start, instance))
        seconds = time.perf_counter() - began
        termination = _TERMINATION.get(found.status, TerminationCondition.ERROR)
        if termination is TerminationCondition.INTERRUPTED:
            raise KeyboardInterrupt
        lam_g, lam_x = np.split(found.multipliers, [instance.row_lower.size])
        return certified(
            Solution(
                program=self._evaluator.program,
                evaluator=self._evaluator,
                instance=instance,
                x=found.x,
                lam_x=lam_x,
                lam_g=lam_g,
                z=np.zeros(0),
                termination=termination,
                status=SolutionStatus.NONE,
                message=found.message,
                solver="osqp",
                iterations=found.iterations,
                seconds=seconds,
            )
        )

    def memory(self) -> dict[str, Array]:
        """Return the instance whose scaling later ones share."""
        scaled = self._scaled_by
        return {} if scaled is None else {each.name: getattr(scaled, each.name) for each in fields(scaled)}

    def recall(self, memory: Mapping[str, Array]) -> None:
        """Scale by the instance that :meth:`memory` returned, or by the next one."""
        self._solver, self._stated, self._scaled_by, self._adapted = None, None, None, False
        if memory:
            with redirect_stdout(io.StringIO()):
                self._state(Instance(**memory))

    def _call(self, instance: Instance, point: tuple[Array, Array]) -> _Found:
        import osqp

        try:
            self._state(instance)
        except osqp.OSQPException as error:
            status = osqp.SolverError(error.args[0]).name
            return _Found(status, status, *point, iterations=0)
        self._solver.warm_start(*point)
        found = self._solver.solve(raise_error=False)
        self._adapted = found.info.rho_updates > 0
        status = osqp.SolverStatus(found.info.status_val).name
        infeasible = _TERMINATION.get(status) is TerminationCondition.INFEASIBLE
        multipliers = found.prim_inf_cert if infeasible else found.y
        return _Found(
            status, found.info.status, np.array(found.x), np.array(multipliers), int(found.info.iter)
        )

    def _state(self, instance: Instance) -> None:
        """State ``minimise x' p x / 2 + q' x`` subject to ``lower <= (a; I) x <= upper``."""
        import osqp

        m = self._maker.at(instance)
        stated, (lower, upper) = self._stated, m.limits
        if stated is not None and self._maker.constant:
            self._solver.update(q=m.q, l=lower, u=upper)
        else:
            p = _matrix(sp.triu(m.p, format="csc"))
            a = _matrix(sp.vstack([m.a, sp.eye_array(m.q.size)], format="csc"))
            if stated is not None and _same_places(p, stated[0]) and _same_places(a, stated[1]):
                self._solver.update(q=m.q, l=lower, u=upper, Px=p.data, Ax=a.data)
            else:
                self._stated, self._solver = None, osqp.OSQP()
                self._solver.setup(p, m.q, a, lower, upper, **self._options)
                self._stated = p, a
            self._scaled_by = instance
        if self._adapted:  # the step size reached at the end of one solve does not suit the next
            self._solver.update_settings(rho=self._solver.settings.rho)


def _matrix(matrix: sp.csc_array) -> sp.csc_matrix:
    """Convert to the class that OSQP takes, with sorted entries."""
    made = sp.csc_matrix(matrix)
    made.sort_indices()
    return made


def _same_places(one: sp.csc_matrix, other: sp.csc_matrix) -> bool:
    """Whether two matrices have the same sparsity pattern."""
    return np.array_equal(one.indptr, other.indptr) and np.array_equal(one.indices, other.indices)


def _point(start: Start | None, instance: Instance) -> tuple[Array, Array]:
    """Values and multipliers to start from, zero where missing."""
    x, rows = np.zeros(instance.lower.size), np.zeros(instance.row_lower.size)
    if start is None:
        return x, np.concatenate([rows, x])
    lam_x, lam_g = (x if start.lam_x is None else start.lam_x), (rows if start.lam_g is None else start.lam_g)
    return start.x, np.concatenate([lam_g, lam_x])


def _checked(options: dict[str, Any]) -> dict[str, Any]:
    """Return the options if OSQP accepts them for a program of one variable."""
    import osqp

    one, zero, printed = sp.csc_matrix([[1.0]]), np.zeros(1), io.StringIO()
    try:
        with redirect_stdout(printed):
            osqp.OSQP().setup(one, zero, one, zero, zero, **options | {"verbose": False})
    except Exception as error:  # OSQP raises several classes, and only the options can be wrong
        reason = (printed.getvalue() or str(error)).partition("\n")[0]
        raise SolverOptionError(f"osqp rejected options {options}: {reason}") from error
    return options
