"""Why a solver stopped, and what its result is worth: two separate answers."""

from __future__ import annotations

from enum import StrEnum

__all__ = ["SolutionStatus", "TerminationCondition"]


class TerminationCondition(StrEnum):
    """Why the back end stopped, as it reported it."""

    CONVERGED = "converged"
    ACCEPTABLE = "acceptable"
    INFEASIBLE = "infeasible"
    UNBOUNDED = "unbounded"
    ITERATION_LIMIT = "iteration limit"
    TIME_LIMIT = "time limit"
    INTERRUPTED = "interrupted"
    NUMERICAL_FAILURE = "numerical failure"
    INVALID_PROGRAM = "invalid program"
    ERROR = "error"

    @classmethod
    def said(cls, message: str) -> TerminationCondition:
        """The condition that a solver's own words mean, for solvers without a table of statuses."""
        words = "".join(c for c in message.lower() if c.isalpha())
        if not words:
            return cls.ERROR
        return next((condition for word, condition in _WORDS.items() if word in words), cls.NUMERICAL_FAILURE)


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


# Words in a solver's status, in the order in which they decide.
_WORDS = {
    "dualinfeas": TerminationCondition.UNBOUNDED,
    "unbounded": TerminationCondition.UNBOUNDED,
    "infeas": TerminationCondition.INFEASIBLE,
    "almostsolved": TerminationCondition.ACCEPTABLE,
    "inaccurate": TerminationCondition.ACCEPTABLE,
    "time": TerminationCondition.TIME_LIMIT,
    "maxiter": TerminationCondition.ITERATION_LIMIT,
    "maximumiter": TerminationCondition.ITERATION_LIMIT,
    "iterationlimit": TerminationCondition.ITERATION_LIMIT,
    "interrupt": TerminationCondition.INTERRUPTED,
    "sigint": TerminationCondition.INTERRUPTED,
    "nonconvex": TerminationCondition.INVALID_PROGRAM,
}
