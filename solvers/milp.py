"""Mixed-integer linear programs, solved by HiGHS through CVXPY."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from solvers.errors import SolverError
from solvers.program import Array, Index
from solvers.status import SolutionStatus, TerminationCondition

__all__ = ["MixedInteger", "MixedSolution", "solve_mixed"]

_STATUS = {
    "optimal": (TerminationCondition.CONVERGED, SolutionStatus.GLOBALLY_OPTIMAL),
    "infeasible": (TerminationCondition.INFEASIBLE, SolutionStatus.PROVEN_INFEASIBLE),
    "infeasible_or_unbounded": (TerminationCondition.INFEASIBLE, SolutionStatus.NONE),
    "unbounded": (TerminationCondition.UNBOUNDED, SolutionStatus.NONE),
    "user_limit": (TerminationCondition.TIME_LIMIT, SolutionStatus.NONE),
}


@dataclass(frozen=True, eq=False)
class MixedInteger:
    """``minimise q'x + constant`` subject to ``row_lower <= a x <= row_upper, lower <= x <= upper``.

    Attributes
    ----------
    binary
        Positions of the variables that are 0 or 1.
    """

    q: Array
    constant: float
    a: sp.csr_array
    row_lower: Array
    row_upper: Array
    lower: Array
    upper: Array
    binary: Index


@dataclass(frozen=True, eq=False)
class MixedSolution:
    """The best point that was found, and what is proven about the optimum.

    Attributes
    ----------
    x
        NaN if no feasible point was found.
    bound
        Proven lower bound on the optimum.
    """

    x: Array
    objective: float
    bound: float
    termination: TerminationCondition
    status: SolutionStatus
    seconds: float

    @property
    def found(self) -> bool:
        """Whether there is a feasible point."""
        return bool(np.isfinite(self.x).all())


def solve_mixed(
    program: MixedInteger, gap: float = 1e-4, seconds: float | None = None, verbose: bool = False
) -> MixedSolution:
    """Solve a mixed-integer linear program.

    Parameters
    ----------
    gap
        Relative difference between objective and bound at which the search stops.
    seconds
        Time limit.

    Raises
    ------
    SolverError
        HiGHS is not installed, or fails.
    """
    import cvxpy as cp

    if "HIGHS" not in cp.installed_solvers():
        raise SolverError("mixed-integer programs need HiGHS, which is not installed: pip install highspy")
    import highspy

    highspy.Highs.resetGlobalScheduler(True)  # else it fails after a solve with other threads in this process
    binary, n = program.binary, program.q.size
    whole = cp.Variable(binary.size, boolean=True)
    rest = np.setdiff1d(np.arange(n), binary)
    other = cp.Variable(rest.size)
    place = sp.csr_array((np.ones(n), (np.concatenate([binary, rest]), np.arange(n))), shape=(n, n))
    x = place @ cp.hstack([whole, other])
    low, high = (np.flatnonzero(np.isfinite(bound)) for bound in (program.lower, program.upper))
    equal = program.row_lower == program.row_upper
    above = ~equal & np.isfinite(program.row_upper)
    below = ~equal & np.isfinite(program.row_lower)
    constraints = [
        x[low] >= program.lower[low],
        x[high] <= program.upper[high],
        program.a[np.flatnonzero(equal)] @ x == program.row_lower[equal],
        program.a[np.flatnonzero(above)] @ x <= program.row_upper[above],
        program.a[np.flatnonzero(below)] @ x >= program.row_lower[below],
    ]
    scale = max(1.0, float(np.abs(program.q).max(initial=0.0)))
    problem = cp.Problem(cp.Minimize((program.q / scale) @ x), [c for c in constraints if c.size])
    options = {"mip_rel_gap": gap, "mip_abs_gap": 0.0, "threads": 1}
    if seconds is not None:
        options["time_limit"] = seconds
    began = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the status reports the same
            problem.solve(solver="HIGHS", verbose=verbose, **options)
    except cp.error.SolverError as error:
        raise SolverError(f"HiGHS failed: {error}") from error
    took = time.perf_counter() - began
    termination, status = _STATUS.get(problem.status, (TerminationCondition.ERROR, SolutionStatus.NONE))
    info = problem.solver_stats.extra_stats
    point = np.full(n, np.nan)
    if other.value is not None and (not binary.size or whole.value is not None):
        point[rest] = other.value
        if binary.size:
            point[binary] = np.rint(whole.value)
        if not np.isfinite(info.objective_function_value):
            point[:] = np.nan  # a limit was reached before the first feasible point
    bound = info.mip_dual_bound if binary.size else info.objective_function_value
    proven = status is SolutionStatus.GLOBALLY_OPTIMAL or np.isfinite(bound)
    return MixedSolution(
        x=point,
        objective=float(program.q @ point + program.constant),
        bound=float(bound * scale + program.constant) if proven else -np.inf,
        termination=termination,
        status=status,
        seconds=took,
    )
