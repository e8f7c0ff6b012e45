"""Holding a convex solver to its word: what it reports is measured before it is believed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solvers.matrices import MatrixMaker, proves_infeasible
from solvers.solution import Solution
from solvers.status import SolutionStatus, TerminationCondition

__all__ = ["certified"]

# Relative to the numbers of the program. First-order methods stop at 1e-6 of their own scaled
# residuals, which are up to a hundred times larger in the program's.
_CONVERGED = 1e-4
_ACCEPTABLE = 1e-3


def certified(solution: Solution) -> Solution:
    """The solution of a convex program with the status that its own numbers support.

    Where the solver reports an optimum, the largest of primal residual, dual residual and gap
    decides, each relative to the size of what it is the error of: below 1e-4 the point is an optimum,
    below 1e-3 an acceptable one, and otherwise it is none. Where it reports infeasibility, this is
    proven if the multipliers are a certificate; see :func:`solvers.proves_infeasible`. Anything else
    has no status.
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
            message=f"{solution.message}; its residuals are {error:.0e} relative",
        )
    return replace(
        solution,
        status=SolutionStatus.NONE,
        termination=TerminationCondition.NUMERICAL_FAILURE,
        message=f"{solution.message}, but its residuals are {error:.0e} relative",
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
