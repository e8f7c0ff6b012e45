"""Why a solver stopped, and what its result is worth: two separate answers."""

from __future__ import annotations

from enum import StrEnum

__all__ = ["SolutionStatus", "TerminationCondition"]


class TerminationCondition(StrEnum):
    """Why the back end stopped, as it reported it.

    ``LIMIT`` is a limit of iterations, time or something else, where a library between us and the
    solver does not pass on which. ``ERROR`` is a status that no table of a back end has; the
    message of the solution holds the solver's own words.
    """

    CONVERGED = "converged"
    ACCEPTABLE = "acceptable"
    INFEASIBLE = "infeasible"
    UNBOUNDED = "unbounded"
    ITERATION_LIMIT = "iteration limit"
    TIME_LIMIT = "time limit"
    LIMIT = "limit"
    INTERRUPTED = "interrupted"
    NUMERICAL_FAILURE = "numerical failure"
    INVALID_PROGRAM = "invalid program"
    ERROR = "error"


class SolutionStatus(StrEnum):
    """What the returned numbers hold.

    ``LOCALLY_INFEASIBLE`` says that a local method found a stationary point of the
    infeasibility; ``PROVEN_INFEASIBLE`` says that a certificate excludes every point.
    """

    GLOBALLY_OPTIMAL = "globally optimal"
    LOCALLY_OPTIMAL = "locally optimal"
    LOCALLY_INFEASIBLE = "locally infeasible"
    PROVEN_INFEASIBLE = "proven infeasible"
    NONE = "none"

    @property
    def is_optimal(self) -> bool:
        """Whether the point is an optimum of some kind."""
        return self in (SolutionStatus.GLOBALLY_OPTIMAL, SolutionStatus.LOCALLY_OPTIMAL)

    @property
    def is_infeasible(self) -> bool:
        """Whether there is no feasible point, at least near the point."""
        return self in (SolutionStatus.LOCALLY_INFEASIBLE, SolutionStatus.PROVEN_INFEASIBLE)
