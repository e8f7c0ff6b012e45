"""Quadratic programs through qpsolvers: OSQP, Clarabel, PIQP, and whatever else is installed."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
import scipy.sparse as sp

from solvers.assembly import Evaluator
from solvers.certify import certified
from solvers.clarabel import solve_clarabel
from solvers.errors import SolverOptionError
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
    # By default 1e-7, which moves the optimum; with none it calls points optimal that are not.
    "highs": {"qp_regularization_value": 1e-9},
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
        self._options = _DEFAULTS.get(solver, {}) | _checked(solver, options)
        self._verbose = verbose

    def solve(self, instance: Instance, start: Start | None = None) -> Solution:
        """Solve; the primal start reaches OSQP and SCS. qpsolvers hands on no dual start."""
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
                if self._solver == "clarabel":
                    found = solve_clarabel(problem, self._verbose, self._options)
                else:
                    found = qpsolvers.solve_problem(
                        problem,
                        self._solver,
                        initvals=None if start is None else start.x,
                        verbose=self._verbose,
                        **self._options,
                    )
        except (TypeError, AttributeError, ValueError, qpsolvers.exceptions.ParamError) as error:
            raise SolverOptionError(f"{self._solver} refused its options {self._options}: {error}") from error
        except qpsolvers.exceptions.QPError as error:
            found = qpsolvers.Solution(problem, found=False, extras={"status": f"failed: {error}"})
        seconds = time.perf_counter() - began
        message, iterations = _describe(found.extras)
        termination = TerminationCondition.CONVERGED if found.found else TerminationCondition.said(message)
        y, z, z_box = (_array(v) for v in _multipliers(found, form.h.size, form.b.size))
        lam_x, lam_g = form.multipliers(_sized(y, form.b), _sized(z, form.h), _sized(z_box, form.q))
        status = SolutionStatus.NONE
        if termination is TerminationCondition.INFEASIBLE:
            proven = proves_infeasible(matrices, lam_x, lam_g, np.zeros(0))
            status = SolutionStatus.PROVEN_INFEASIBLE if proven else SolutionStatus.LOCALLY_INFEASIBLE
        solution = Solution(
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
        claimed = termination in (TerminationCondition.CONVERGED, TerminationCondition.ACCEPTABLE)
        return certified(solution) if claimed else solution


def _checked(solver: str, options: dict[str, Any]) -> dict[str, Any]:
    """Options as the solver takes them; those that qpsolvers would drop in silence are refused here."""
    if solver == "piqp":
        import piqp

        settings = piqp.SparseSolver().settings
        unknown = [name for name in options if name != "backend" and not hasattr(settings, name)]
        if isinstance(options.get("kkt_solver"), str):
            options = options | {"kkt_solver": getattr(piqp.KKTSolver, options["kkt_solver"], None)}
            unknown += ["kkt_solver"] if options["kkt_solver"] is None else []
    elif solver == "highs":
        import highspy

        highs = highspy.Highs()
        highs.silent()
        refused = highspy.HighsStatus.kError
        unknown = [name for name, value in options.items() if highs.setOptionValue(name, value) == refused]
    else:
        unknown = []
    if unknown:
        raise SolverOptionError(f"{solver} has no option {unknown[0]!r} with such a value: {options}")
    return options


def _multipliers(found: Any, inequalities: int, equalities: int) -> tuple[Any, Any, Any]:
    """Multipliers of a solution, or the certificate of infeasibility that OSQP keeps apart."""
    certificate = found.extras.get("prim_inf_cert")
    if not found.found and certificate is not None:
        stacked = np.asarray(certificate, dtype=float)
        g, a = stacked[:inequalities], stacked[inequalities : inequalities + equalities]
        return a, g, stacked[inequalities + equalities :]
    return found.y, found.z, found.z_box


def _describe(extras: dict[str, Any]) -> tuple[str, int | None]:
    """Status text and number of iterations, wherever qpsolvers keeps them, if it does."""
    info = extras.get("info", extras)
    status = _entry(info, "status")
    if status is None:
        status = extras.get("status", "")
    iterations = _entry(info, "iter")
    return str(status).rpartition(".")[2], None if iterations is None else int(iterations)


def _entry(info: Any, name: str) -> Any:
    return info.get(name) if isinstance(info, dict) else getattr(info, name, None)


def _matrix(matrix: sp.csc_array) -> sp.csc_matrix:
    """The class and the integers that the solvers behind qpsolvers take."""
    indices, starts = (i.astype(np.int32) for i in (matrix.indices, matrix.indptr))
    return sp.csc_matrix((matrix.data, indices, starts), shape=matrix.shape)


def _array(values: Any) -> Array:
    return np.zeros(0) if values is None else np.asarray(values, dtype=float).ravel()


def _sized(values: Array, like: Array) -> Array:
    """Values, or zeros where a solver that failed returned none."""
    return values if values.size == like.size else np.zeros_like(like)
