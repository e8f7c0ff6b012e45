"""Quadratic programs through qpsolvers: OSQP, Clarabel, PIQP, and whatever else is installed."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
import scipy.sparse as sp

from solvers.assembly import Evaluator
from solvers.errors import SolverError, SolverOptionError
from solvers.matrices import MatrixMaker, proves_infeasible, standard_form
from solvers.program import Array, Instance, Program
from solvers.solution import Solution, Start
from solvers.status import SolutionStatus, TerminationCondition
from solvers.structure import Kind

__all__ = ["QP"]

_PREFERRED = ("clarabel", "piqp", "osqp", "highs", "scs")
_DEFAULTS: dict[str, dict[str, Any]] = {
    "osqp": {"eps_abs": 1e-6, "eps_rel": 1e-6, "max_iter": 50_000, "polishing": True},
    "scs": {"eps_abs": 1e-7, "eps_rel": 1e-7, "max_iters": 50_000},
    "piqp": {"eps_abs": 1e-8, "eps_rel": 1e-9, "check_duality_gap": True},
    "clarabel": {},
    "highs": {"qp_regularization_value": 0.0},  # HiGHS adds 1e-7 x'x by default
}


class QP:
    """Linear and convex quadratic programs through qpsolvers."""

    name = "qp"
    accepts = Kind.QUADRATIC

    def solvers(self) -> Iterator[str]:
        """What qpsolvers finds installed, the most robust first."""
        import qpsolvers

        known = qpsolvers.sparse_solvers
        yield from (name for name in _PREFERRED if name in known)
        yield from (name for name in known if name not in _PREFERRED)

    def prepare(self, program: Program, solver: str, options: dict[str, Any], verbose: bool) -> QPSession:
        """Fold the program into matrices."""
        return QPSession(program, solver, options, verbose)


class QPSession:
    """A program as matrices, of which the next instance changes vectors only."""

    def __init__(self, program: Program, solver: str, options: dict[str, Any], verbose: bool) -> None:
        self._evaluator = Evaluator(program)
        self._maker = MatrixMaker(self._evaluator)
        self._solver = solver
        self._options = _DEFAULTS.get(solver, {}) | options
        self._verbose = verbose

    def solve(self, instance: Instance, start: Start | None = None) -> Solution:
        """Solve; the primal start reaches solvers that take one."""
        import qpsolvers

        matrices = self._maker.at(instance)
        form = standard_form(matrices)
        problem = qpsolvers.Problem(
            P=_matrix(form.p),
            q=form.q,
            G=_matrix(form.g) if form.h.size else None,
            h=form.h if form.h.size else None,
            A=_matrix(form.a) if form.b.size else None,
            b=form.b if form.b.size else None,
            lb=form.lb,
            ub=form.ub,
        )
        began = time.perf_counter()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # the status says it
                found = qpsolvers.solve_problem(
                    problem,
                    self._solver,
                    initvals=None if start is None else start.x,
                    verbose=self._verbose,
                    **self._options,
                )
        except (TypeError, AttributeError, qpsolvers.exceptions.ParamError) as error:
            raise SolverOptionError(f"{self._solver} refused its options {self._options}: {error}") from error
        except qpsolvers.exceptions.QPError as error:
            raise SolverError(f"{self._solver} failed: {error}") from error
        seconds = time.perf_counter() - began
        message, iterations = _describe(found.extras)
        termination = TerminationCondition.CONVERGED if found.found else _termination(message)
        y, z, z_box = (_array(v) for v in _multipliers(found, form.h.size, form.b.size))
        lam_x, lam_g = form.multipliers(_sized(y, form.b), _sized(z, form.h), _sized(z_box, form.q))
        status = SolutionStatus.NONE
        if found.found:
            status = SolutionStatus.GLOBALLY_OPTIMAL
        elif termination is TerminationCondition.INFEASIBLE:
            proven = proves_infeasible(matrices, lam_x, lam_g, np.zeros(0))
            status = SolutionStatus.PROVEN_INFEASIBLE if proven else SolutionStatus.LOCALLY_INFEASIBLE
        return Solution(
            program=self._evaluator.program,
            evaluator=self._evaluator,
            instance=instance,
            x=_sized(_array(found.x), form.q),
            lam_x=lam_x,
            lam_g=lam_g,
            z=np.zeros(0),
            termination=termination,
            status=status,
            message=message or ("solved" if found.found else "not solved; qpsolvers passes on no reason"),
            solver=self._solver,
            iterations=iterations,
            seconds=seconds,
        )


def _multipliers(found: Any, inequalities: int, equalities: int) -> tuple[Any, Any, Any]:
    """Multipliers of a solution, or the certificate of infeasibility that OSQP keeps apart."""
    certificate = found.extras.get("prim_inf_cert")
    if not found.found and certificate is not None:
        stacked = np.asarray(certificate, dtype=float)
        g, a = stacked[:inequalities], stacked[inequalities : inequalities + equalities]
        return a, g, stacked[inequalities + equalities :]
    return found.y, found.z, found.z_box


def _describe(extras: dict[str, Any]) -> tuple[str, int]:
    """Status text and number of iterations, wherever a solver keeps them."""
    info = extras.get("info", extras)
    status = _entry(info, "status")
    if status is None:
        status = extras.get("status", "")
    iterations = _entry(info, "iter")
    return str(status).rpartition(".")[2], int(iterations or 0)


def _entry(info: Any, name: str) -> Any:
    return info.get(name) if isinstance(info, dict) else getattr(info, name, None)


# Words in a convex solver's status, in the order in which they decide.
_WORDS = (
    ("dualinfeas", TerminationCondition.UNBOUNDED),
    ("unbounded", TerminationCondition.UNBOUNDED),
    ("infeas", TerminationCondition.INFEASIBLE),
    ("time", TerminationCondition.TIME_LIMIT),
    ("maxiter", TerminationCondition.ITERATION_LIMIT),
    ("maximumiterations", TerminationCondition.ITERATION_LIMIT),
    ("interrupt", TerminationCondition.INTERRUPTED),
    ("sigint", TerminationCondition.INTERRUPTED),
    ("nonconvex", TerminationCondition.INVALID_PROGRAM),
)


def _termination(message: str) -> TerminationCondition:
    """Why a convex solver stopped, from its own words."""
    said = message.lower().replace("_", "").replace(" ", "")
    if not said:
        return TerminationCondition.ERROR
    found = (condition for word, condition in _WORDS if word in said)
    return next(found, TerminationCondition.NUMERICAL_FAILURE)


def _matrix(matrix: sp.csc_array) -> sp.csc_matrix:
    """The class and the integers that the solvers behind qpsolvers take."""
    indices, starts = (i.astype(np.int32) for i in (matrix.indices, matrix.indptr))
    return sp.csc_matrix((matrix.data, indices, starts), shape=matrix.shape)


def _array(values: Any) -> Array:
    return np.zeros(0) if values is None else np.asarray(values, dtype=float).ravel()


def _sized(values: Array, like: Array) -> Array:
    """Values, or zeros where a solver that failed returned none."""
    return values if values.size == like.size else np.zeros_like(like)
