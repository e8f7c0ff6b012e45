"""Programs of any kind through CasADi: IPOPT or another ``nlpsol`` plugin."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from solvers.assembly import Evaluator
from solvers.backends.progress import Progress
from solvers.errors import SolverError, SolverOptionError
from solvers.interrupt import interruptible
from solvers.program import Array, Instance, Program
from solvers.solution import Solution, Start
from solvers.status import SolutionStatus, TerminationCondition
from solvers.structure import Kind, classify, curvature_varies
from solvers.threads import use_one_blas_thread
from solvers.transform import smooth

if TYPE_CHECKING:
    from solvers.backends.expanded import TwoForms

__all__ = ["Ipopt"]

# Measured on multi-stage AC-OPF; docs/warm-start.md has the figures.
_COLD: dict[str, Any] = {
    "tol": 1e-6,
    "constr_viol_tol": 1e-7,
    "mumps_pivot_order": 5,  # METIS
    "mumps_scaling": 0,
    "mumps_permuting_scaling": 0,
    "mumps_mem_percent": 5,  # the default allocates ten times what is needed; clearing it takes time
    "min_refinement_steps": 0,
}
# With coupling in time the starting point is better than that of a single stage.
_COLD_IN_TIME: dict[str, Any] = {"mu_init": 1e-2}
# Without scaling, cone rows make MUMPS delay pivots until the factors are nearly dense.
_WITH_CONES: dict[str, Any] = {"mumps_scaling": 77}
_PUSHES = (
    "warm_start_bound_push",
    "warm_start_bound_frac",
    "warm_start_slack_bound_push",
    "warm_start_slack_bound_frac",
    "warm_start_mult_bound_push",
)


def _warm(push: float) -> dict[str, Any]:
    return _COLD | {"warm_start_init_point": "yes", "mu_init": 1e-7} | dict.fromkeys(_PUSHES, push)


# A solve of so few iterations was an easy one, and the next is none if it takes so many.
_FEW_ITERATIONS = 8
_MANY_ITERATIONS = 12
_EASY = "moved from an easy solve"
# Re-solving the same problem starts at its solution. A problem shifted in time has other active limits;
# from a point that close to the old ones IPOPT takes tiny steps. Multipliers may stay close to zero where few
# limits change their side, as the iterations of the last solve show. docs/warm-start.md has the figures.
_OPTIONS = {
    "cold": _COLD,
    "again": _warm(1e-6),
    "moved": _warm(1e-2),
    _EASY: _warm(1e-2) | {"warm_start_mult_bound_push": 1e-4, "max_iter": _MANY_ITERATIONS},
}
# Plugins that take their options in a dictionary named after the plugin.
_NESTED = ("ipopt", "bonmin", "knitro", "snopt", "worhp", "uno", "madnlp", "fatrop", "conopt")

_TERMINATION = {
    "Solve_Succeeded": TerminationCondition.CONVERGED,
    "Solved_To_Acceptable_Level": TerminationCondition.ACCEPTABLE,
    "Feasible_Point_Found": TerminationCondition.CONVERGED,
    "Infeasible_Problem_Detected": TerminationCondition.INFEASIBLE,
    "Diverging_Iterates": TerminationCondition.UNBOUNDED,
    "Maximum_Iterations_Exceeded": TerminationCondition.ITERATION_LIMIT,
    "Maximum_CpuTime_Exceeded": TerminationCondition.TIME_LIMIT,
    "Maximum_WallTime_Exceeded": TerminationCondition.TIME_LIMIT,
    "User_Requested_Stop": TerminationCondition.INTERRUPTED,
    "Search_Direction_Becomes_Too_Small": TerminationCondition.NUMERICAL_FAILURE,
    "Restoration_Failed": TerminationCondition.NUMERICAL_FAILURE,
    "Error_In_Step_Computation": TerminationCondition.NUMERICAL_FAILURE,
    "Not_Enough_Degrees_Of_Freedom": TerminationCondition.INVALID_PROGRAM,
    "Invalid_Problem_Definition": TerminationCondition.INVALID_PROGRAM,
    "Invalid_Number_Detected": TerminationCondition.INVALID_PROGRAM,
}
# CasADi's unified statuses for all plugins.
_UNIFIED = {
    "SOLVER_RET_SUCCESS": TerminationCondition.CONVERGED,
    "SOLVER_RET_LIMITED": TerminationCondition.LIMIT,
    "SOLVER_RET_INFEASIBLE": TerminationCondition.INFEASIBLE,
    "SOLVER_RET_NAN": TerminationCondition.NUMERICAL_FAILURE,
}


class Ipopt:
    """IPOPT with MUMPS from CasADi's wheel; ``ipopt:NAME`` selects any other ``nlpsol`` plugin."""

    name = "ipopt"
    accepts = Kind.NONLINEAR

    def solvers(self) -> Iterator[str]:
        """IPOPT, then the other plugins whose libraries load."""
        yield "ipopt"
        others = ("sqpmethod", "fatrop", "bonmin", "knitro", "snopt", "worhp", "uno", "madnlp")
        yield from (name for name in others if ca.has_nlpsol(name))

    def prepare(
        self, program: Program, solver: str, options: dict[str, Any], verbose: bool
    ) -> IpoptSession | TwoForms:
        """Assemble the functions of ``program`` and create the solver for cold starts."""
        if solver == self.name and program.composed:
            from solvers.backends.expanded import TwoForms

            return TwoForms(program, options, verbose)
        return IpoptSession(program, solver, options, verbose)


class IpoptSession:
    """A program assembled for an ``nlpsol`` plugin.

    Parameters
    ----------
    watched
        Whether cold starts that go nowhere are stopped.
    """

    def __init__(
        self,
        program: Program,
        plugin: str,
        options: dict[str, Any],
        verbose: bool,
        watched: bool = False,
    ) -> None:
        use_one_blas_thread()
        self._program = program
        self._smooth = smooth(program)
        self._evaluator = Evaluator(program)
        same = self._smooth.program is program
        self._assembly = self._evaluator.assembly if same else Evaluator(self._smooth.program).assembly
        self._plugin = plugin
        self._options = options
        self._verbose = verbose
        self._progress = Progress(self._assembly) if watched else None
        self._current: tuple[str, Any] | None = None
        self._convex = classify(program).kind < Kind.NONLINEAR
        self._curvature_varies = curvature_varies(program)
        self._solver("cold")

    def _solver(self, situation: str) -> Any:
        """Solver with the options for a situation, which cannot change once it is created.

        All solvers share the same functions, but each keeps its own factors. Only the last one is kept, since
        another costs less than an iteration.
        """
        if self._current is None or self._current[0] != situation:
            self._current = None  # so that the next one can use its memory
            self._current = situation, self._created(situation)
        return self._current[1]

    def _created(self, situation: str) -> Any:
        functions = {
            "grad_f": self._assembly.gradient,
            "jac_g": self._assembly.jacobian,
            "hess_lag": self._assembly.hessian,
        }
        # plugins that do not take all three need them in other forms, and derive their own
        given = functions if set(functions) <= set(ca.nlpsol_options(self._plugin)) else {}
        try:
            return ca.nlpsol(
                "solver", self._plugin, self._assembly.oracle, given | self._plugin_options(situation)
            )
        except RuntimeError as error:
            raise SolverOptionError(
                f"{self._plugin} rejected options {self._options or '(defaults)'}: {_reason(error)}"
            ) from error

    def _plugin_options(self, situation: str) -> dict[str, Any]:
        general: dict[str, Any] = {
            "print_time": False,
            "error_on_fail": False,
            "calc_lam_p": False,
        }
        if self._progress is not None and situation == "cold":
            general |= self._progress.options
        if self._plugin != "ipopt":
            own = {self._plugin: self._options} if self._plugin in _NESTED else self._options
            return general | own
        printing = {"print_level": 5} if self._verbose else {"print_level": 0, "sb": "yes"}
        options = dict(_OPTIONS[situation])
        if situation == "cold" and any(block.stages > 1 for block in self._program.variables.values()):
            options |= _COLD_IN_TIME
        if self._program.cones:
            options |= _WITH_CONES
        # the gradient of the Lagrangian is not used, and takes long to derive; other plugins need it
        return general | {"no_nlp_grad": True, "ipopt": options | printing | self._options}

    def solve(self, instance: Instance, start: Start | None = None) -> Solution:
        """Solve an instance; a start that includes multipliers is a warm start."""
        situation = _situation(start) if self._plugin == "ipopt" else "cold"
        solution = self._solved(instance, start, situation)
        limited = solution.termination is TerminationCondition.ITERATION_LIMIT
        if situation != _EASY or not limited or "max_iter" in self._options:
            return solution
        more = self._solved(instance, solution.start(), "moved")  # not as easy as the last one
        return replace(
            more,
            iterations=(solution.iterations or 0) + (more.iterations or 0),
            seconds=solution.seconds + more.seconds,
        )

    def _solved(self, instance: Instance, start: Start | None, situation: str) -> Solution:
        at = self._smooth.instance(instance)
        arguments: dict[str, Any] = {
            "x0": instance.start if start is None else start.x,
            "p": at.parameters,
            "lbx": at.lower,
            "ubx": at.upper,
            "lbg": at.row_lower,
            "ubg": at.row_upper,
        }
        if start is not None and start.lam_x is not None and start.lam_g is not None:
            arguments["lam_x0"] = start.lam_x
            arguments["lam_g0"] = self._row_multipliers(start.lam_g, start, at)
        solver = self._solver(situation)
        if self._progress is not None:
            self._progress.begin(at)
        began = time.perf_counter()
        try:
            with interruptible(quiet=True):
                result = solver(**arguments)
        except RuntimeError as error:
            raise SolverError(f"{self._plugin} failed: {_reason(error)}") from error
        seconds = time.perf_counter() - began
        return self._solution(instance, result, solver.stats(), seconds)

    def _row_multipliers(self, lam_g: Array, start: Start, at: Instance) -> Array:
        if not self._program.cones:
            return lam_g
        s, _ = self._evaluator.cones(start.x, at.parameters)
        z = np.zeros_like(s) if start.z is None else start.z
        return self._smooth.row_multipliers(lam_g, z, s)

    def _solution(
        self, instance: Instance, result: dict[str, Any], stats: dict[str, Any], seconds: float
    ) -> Solution:
        program = self._program
        x, lam_x, lam_g = (_vector(result[key]) for key in ("x", "lam_x", "lam_g"))
        z = np.zeros(0)
        if program.cones:
            s, _ = self._evaluator.cones(x, instance.parameters)
            z = self._smooth.cone_multipliers(lam_g, s)
        message = str(stats.get("return_status", ""))
        if self._plugin == "ipopt":
            termination = _TERMINATION.get(message, TerminationCondition.ERROR)
        else:
            unified = str(stats.get("unified_return_status"))
            termination = _UNIFIED.get(unified, TerminationCondition.ERROR)
        if self._progress is not None and self._progress.lost:
            termination = TerminationCondition.NO_PROGRESS
            message = f"stopped after {stats.get('iter_count')} iterations"
        if message == "Invalid_Option":
            raise SolverOptionError(f"{self._plugin} rejected options {self._options}")
        return Solution(
            program=program,
            evaluator=self._evaluator,
            instance=instance,
            x=x,
            lam_x=lam_x,
            lam_g=lam_g[: program.n_rows],
            z=z,
            termination=termination,
            status=self._status(instance, termination),
            message=message,
            solver=self._plugin,
            iterations=int(stats.get("iter_count", 0)),
            seconds=seconds,
        )

    def _status(self, instance: Instance, termination: TerminationCondition) -> SolutionStatus:
        if termination in (TerminationCondition.CONVERGED, TerminationCondition.ACCEPTABLE):
            convex = self._convex
            if self._curvature_varies:
                convex = classify(self._program, instance).kind < Kind.NONLINEAR
            return SolutionStatus.GLOBALLY_OPTIMAL if convex else SolutionStatus.LOCALLY_OPTIMAL
        if termination is TerminationCondition.INFEASIBLE:
            return SolutionStatus.LOCALLY_INFEASIBLE
        return SolutionStatus.NONE


def _situation(start: Start | None) -> str:
    """Key of the options for a solve from ``start``."""
    if start is None or start.lam_x is None or start.lam_g is None:
        return "cold"
    if not start.moved:
        return "again"
    easy = start.iterations is not None and start.iterations <= _FEW_ITERATIONS
    return _EASY if easy else "moved"


def _vector(value: Any) -> Array:
    return np.asarray(value, dtype=float).ravel()


def _reason(error: Exception) -> str:
    """The line of CasADi's message that states the fault, without its location in CasADi's source."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    telling = [line for line in lines if "option:" in line.lower()] or lines[-1:]
    return (
        telling[0].rpartition("cpp:")[2].partition(": ")[2] or telling[0] if telling else type(error).__name__
    )
