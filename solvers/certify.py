"""Certification of convex solvers: the reported status is checked against measured residuals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solvers.matrices import MatrixMaker, proves_infeasible
from solvers.solution import Solution
from solvers.status import SolutionStatus, TerminationCondition

__all__ = ["certified"]

# Relative to the magnitudes in the program. First-order methods stop when their own scaled residuals
# reach 1e-6; in the units of the program these are up to a hundred times larger.
_CONVERGED = 1e-4
_ACCEPTABLE = 1e-3


def certified(solution: Solution) -> Solution:
    """Return the solution of a convex program with the status that its residuals support.

    If the solver reports an optimum, the largest of primal residual, dual residual and gap decides,
    each relative to the magnitude of the quantities involved: up to 1e-4 the point is optimal, up to
    1e-3 acceptable, and above that it has no status. If it reports infeasibility, this is proven if
    the multipliers are a certificate (see :func:`solvers.proves_infeasible`). Anything else has no
    status.
    """
    if solution.termination is TerminationCondition.INFEASIBLE:
        matrices = MatrixMaker(solution.evaluator).at(solution.instance)
        if proves_infeasible(matrices, solution.lam_x, solution.lam_g, solution.z):
            return replace(solution, status=SolutionStatus.PROVEN_INFEASIBLE)
        return replace(
            solution,
            status=SolutionStatus.NONE,
            message=f"{solution.message}, but its multipliers do not prove it",
        )
    if solution.termination not in (TerminationCondition.CONVERGED, TerminationCondition.ACCEPTABLE):
        return replace(solution, status=SolutionStatus.NONE)
    error = _relative_error(solution)
    if error <= _CONVERGED:
        return replace(solution, status=SolutionStatus.GLOBALLY_OPTIMAL)
    if error <= _ACCEPTABLE:
        return replace(
            solution,
            status=SolutionStatus.GLOBALLY_OPTIMAL,
            termination=TerminationCondition.ACCEPTABLE,
            message=f"{solution.message}; the largest relative residual is {error:.0e}",
        )
    return replace(
        solution,
        status=SolutionStatus.NONE,
        termination=TerminationCondition.NUMERICAL_FAILURE,
        message=f"{solution.message}, but the largest relative residual is {error:.0e}",
    )


def _relative_error(solution: Solution) -> float:
    at = solution.instance
    slope = solution.evaluator.gradient(solution.x, at.parameters)
    errors = (
        solution.primal_residual / _size(solution.x, solution.rows, solution.cones),
        solution.dual_residual / _size(slope, solution.lam_x, solution.lam_g, solution.z),
        solution.gap / (1.0 + abs(solution.objective)),
    )
    return float(np.nan_to_num(np.max(errors), nan=np.inf))


def _size(*vectors: np.ndarray) -> float:
    return 1.0 + max(float(np.abs(v).max(initial=0.0)) for v in vectors)
