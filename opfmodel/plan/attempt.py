"""The record of the solves that led to a plan."""

from __future__ import annotations

from dataclasses import dataclass

from opfmodel.plan.result import Plan, status_word

__all__ = ["Attempt", "attempts"]


@dataclass(frozen=True)
class Attempt:
    """One of the solves that led to a plan.

    Attributes
    ----------
    start
        ``cold``; in a closed loop also ``warm`` (the shifted last plan with its multipliers), ``other`` (the
        shifted last plan without multipliers) or ``elastic`` (the same problem with soft limits).
    solver
        The solver; ``expanded`` is IPOPT on the expanded form of the problem.
    """

    start: str
    solver: str
    status: str
    termination: str
    iterations: int | None
    seconds: float


def attempts(plan: Plan, start: str = "cold") -> list[Attempt]:
    """Return the solves that led to a plan, the last of which found it."""
    return [
        Attempt(
            start,
            each.solver,
            status_word(each.status),
            f"{each.termination.value} ({each.message})",
            each.iterations,
            each.seconds,
        )
        for each in plan.solution.attempts
    ]
