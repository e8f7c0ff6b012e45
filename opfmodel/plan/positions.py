"""Plans whose settings of the network are at positions: rounded, and solved once more."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from opfmodel.plan.request import Request
from opfmodel.plan.result import Plan

__all__ = ["at_positions"]


def at_positions(plan: Plan, solve: Callable[[Request], Plan]) -> Plan:
    """Return the plan with its settings at the nearest positions, and the effort of both.

    Parameters
    ----------
    plan
        A plan with continuous settings.
    solve
        Solves a request, starting from the plan.
    """
    settings = {
        setting.name: setting.rounded(plan.solution.variable(setting.name))
        for setting in plan.model.settings.values()
        if setting.stepped.any()
    }
    if not settings or not plan.optimal or plan.request.settings is not None:
        return plan
    found = solve(replace(plan.request, settings=settings))
    before, after = plan.solution, found.solution
    counted = [s.iterations for s in (before, after) if s.iterations is not None]
    solution = replace(
        after,
        iterations=sum(counted) if counted else None,
        seconds=before.seconds + after.seconds,
        message=after.message if found.optimal else f"{after.message}; at the nearest positions",
    )
    made = found.with_solution(found.problem, solution)
    made.rounded_from = plan
    return made
