"""Quadratic programs through qpsolvers: PIQP, HiGHS, SCS and any other installed solver."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.sparse as sp

from solvers.assembly import Evaluator
from solvers.backends.clarabel import Clarabel
from solvers.backends.osqp import OSQP
from solvers.certify import certified
from solvers.errors import SolverOptionError
from solvers.matrices import MatrixMaker, standard_form
from solvers.program import Array, Instance, Program
from solvers.solution import Solution, Start
from solvers.solve import BackEnd, Session
from solvers.status import SolutionStatus, TerminationCondition
from solvers.structure import Kind

__all__ = ["QP"]

_PREFERRED = ("clarabel", "piqp", "osqp", "highs", "scs")
# These have dedicated back ends.
_DIRECT: dict[str, BackEnd] = {"clarabel": Clarabel(), "osqp": OSQP()}


@dataclass(frozen=True)
class _Report:
    """Why a solver stopped: its own code and message, and its iterations."""

    status: int | str | None
    words: str
    iterations: int | None


def _report(found: Any) -> _Report:
    """Report of a solver of which qpsolvers returns nothing but success or failure."""
    words = "solved" if found.found else "not solved; qpsolvers reports no reason"
    return _Report(None, words, None)


def _report_of_piqp(found: Any) -> _Report:
    info = found.extras["info"]
    return _Report(info.status.name, info.status.name, int(info.iter))


def _report_of_scs(found: Any) -> _Report:
    info = found.extras
    return _Report(info["status_val"], info["status"], info["iter"])


@dataclass(frozen=True)
class _Known:
    """Default options of a solver, how to read its report, and what its codes mean.

    Codes for an optimum are left out because qpsolvers reports whether one was found.
    """

    defaults: Mapping[str, Any] = field(default_factory=dict)
    report: Callable[[Any], _Report] = _report
    statuses: Mapping[int | str | None, TerminationCondition] = field(default_factory=dict)


_KNOWN = {
    "piqp": _Known(
        {"eps_abs": 1e-8, "eps_rel": 1e-9, "check_duality_gap": True},
        _report_of_piqp,
        {
            "PIQP_MAX_ITER_REACHED": TerminationCondition.ITERATION_LIMIT,
            "PIQP_PRIMAL_INFEASIBLE": TerminationCondition.INFEASIBLE,
            "PIQP_DUAL_INFEASIBLE": TerminationCondition.UNBOUNDED,
            "PIQP_NUMERICS": TerminationCondition.NUMERICAL_FAILURE,
        },
    ),
    "scs": _Known(
        {"eps_abs": 1e-7, "eps_rel": 1e-7, "max_iters": 50_000},
        _report_of_scs,
        {
            2: TerminationCondition.ACCEPTABLE,  # inaccurate: stopped at a limit close to convergence
            -1: TerminationCondition.UNBOUNDED,
            -2: TerminationCondition.INFEASIBLE,
            -3: TerminationCondition.NUMERICAL_FAILURE,  # indeterminate
            -5: TerminationCondition.INTERRUPTED,
            -6: TerminationCondition.UNBOUNDED,  # inaccurate
            -7: TerminationCondition.INFEASIBLE,  # inaccurate
        },
    ),
    # The default of 1e-7 moves the optimum; with zero, HiGHS reports points as optimal that are not.
    "highs": _Known({"qp_regularization_value": 1e-9}),
}


class QP:
    """Linear and convex quadratic programs through qpsolvers."""

    name = "qp"
    accepts = Kind.QUADRATIC

    def solvers(self) -> Iterator[str]:
        """Installed solvers that qpsolvers can call, the most robust first."""
        import qpsolvers

        known = qpsolvers.sparse_solvers
        yield from (name for name in _PREFERRED if name in known)
        yield from (name for name in known if name not in _PREFERRED)

    def prepare(self, program: Program, solver: str, options: Mapping[str, Any], verbose: bool) -> Session:
        """Fold the program into matrices, here or in the solver's dedicated back end."""
        if solver in _DIRECT:
            return _DIRECT[solver].prepare(program, solver, options, verbose)
        return QPSession(program, solver, dict(options), verbose)


class QPSession:
    """A program as matrices, of which a new instance changes only the vectors."""

    def __init__(self, program: Program, solver: str, options: dict[str, Any], verbose: bool) -> None:
        self._evaluator = Evaluator(program)
        self._maker = MatrixMaker(self._evaluator)
        self._solver = solver
        self._known = _KNOWN.get(solver, _Known())
        self._given = _checked(solver, options)
        self._options = dict(self._known.defaults) | self._given
        self._verbose = verbose

    def solve(self, instance: Instance, start: Start | None = None) -> Solution:
        """Solve, from the values of ``start`` if the solver uses them; of PIQP, HiGHS and SCS only SCS does.

        Raises
        ------
        KeyboardInterrupt
            Ctrl-C, if the solver catches it itself.
        """
        import qpsolvers

        form = standard_form(self._maker.at(instance))
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
                warnings.simplefilter("ignore")  # the status reports the same
                found = qpsolvers.solve_problem(
                    problem,
                    self._solver,
                    initvals=None if start is None else start.x,
                    verbose=self._verbose,
                    **self._options,
                )
        except (TypeError, AttributeError, ValueError, qpsolvers.exceptions.ParamError) as error:
            if not self._given:
                raise
            raise SolverOptionError(f"{self._solver} rejected options {self._given}: {error}") from error
        except qpsolvers.exceptions.QPError as error:
            found, report = qpsolvers.Solution(problem, found=False), _Report(None, str(error), None)
        else:
            report = self._known.report(found)
        seconds = time.perf_counter() - began
        termination = (
            TerminationCondition.CONVERGED
            if found.found
            else self._known.statuses.get(report.status, TerminationCondition.ERROR)
        )
        if termination is TerminationCondition.INTERRUPTED:
            raise KeyboardInterrupt
        lam_x, lam_g = form.multipliers(
            _sized(found.y, form.b), _sized(found.z, form.h), _sized(found.z_box, form.q)
        )
        return certified(
            Solution(
                program=self._evaluator.program,
                evaluator=self._evaluator,
                instance=instance,
                x=_sized(found.x, form.q),
                lam_x=lam_x,
                lam_g=lam_g,
                z=np.zeros(0),
                termination=termination,
                status=SolutionStatus.NONE,
                message=report.words,
                solver=self._solver,
                iterations=report.iterations,
                seconds=seconds,
            )
        )


def _checked(solver: str, options: dict[str, Any]) -> dict[str, Any]:
    """Options as the solver takes them; those that qpsolvers would silently drop are rejected here."""
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
        raise SolverOptionError(f"{solver} rejected option {unknown[0]!r}: wrong name or value in {options}")
    return options


def _matrix(matrix: sp.csc_array) -> sp.csc_matrix:
    """Convert to the class and integer type that the solvers behind qpsolvers take."""
    indices, starts = (i.astype(np.int32) for i in (matrix.indices, matrix.indptr))
    return sp.csc_matrix((matrix.data, indices, starts), shape=matrix.shape)


def _sized(values: Any, like: Array) -> Array:
    """Values, or zeros if a failed solver returned none."""
    array = np.zeros(0) if values is None else np.asarray(values, dtype=float).ravel()
    return array if array.size == like.size else np.zeros_like(like)
