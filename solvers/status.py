"""Why a solver stopped and what its status guarantees, reported separately."""

from __future__ import annotations

from enum import StrEnum

__all__ = ["SolutionStatus", "TerminationCondition"]


class TerminationCondition(StrEnum):
    """Reason why the solver stopped, as it reported it.

    ``LIMIT`` is a limit on iterations, time or another resource, where the interface library does
    not report which. ``NO_PROGRESS``: a back end stopped an attempt that went nowhere, see
    :mod:`solvers.backends.progress`. ``ERROR`` is a status that the back end does not recognise; the
    solution's message holds the solver's own text.
    """

    CONVERGED = "converged"
    ACCEPTABLE = "acceptable"
    INFEASIBLE = "infeasible"
    UNBOUNDED = "unbounded"
    ITERATION_LIMIT = "iteration limit"
    TIME_LIMIT = "time limit"
    LIMIT = "limit"
    INTERRUPTED = "interrupted"
    NO_PROGRESS = "no progress"
    NUMERICAL_FAILURE = "numerical failure"
    INVALID_PROGRAM = "invalid program"
    ERROR = "error"


class SolutionStatus(StrEnum):
    """What the status guarantees about the returned point.

    ``LOCALLY_INFEASIBLE``: a local method found a stationary point of the infeasibility.
    ``PROVEN_INFEASIBLE``: a certificate excludes every point.
    """

    GLOBALLY_OPTIMAL = "globally optimal"
    LOCALLY_OPTIMAL = "locally optimal"
    LOCALLY_INFEASIBLE = "locally infeasible"
    PROVEN_INFEASIBLE = "proven infeasible"
    NONE = "none"

    @property
    def is_optimal(self) -> bool:
        """Whether the point is a global or local optimum."""
        return self in (SolutionStatus.GLOBALLY_OPTIMAL, SolutionStatus.LOCALLY_OPTIMAL)

    @property
    def is_infeasible(self) -> bool:
        """Whether no point is feasible, at least in the neighbourhood of this one."""
        return self in (SolutionStatus.LOCALLY_INFEASIBLE, SolutionStatus.PROVEN_INFEASIBLE)
