"""The least shortage first, then the least cost: elastic plans in which no cost outbids a shortage."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from opfmodel.model import Model, Stage
from opfmodel.network.arrays import PerUnitNetwork
from opfmodel.objectives.base import Objective
from opfmodel.plan.request import Request
from opfmodel.plan.result import Plan
from solvers import Solution

if TYPE_CHECKING:
    from opfmodel.plan.multistage import MultiStage

__all__ = ["CEILING", "Nothing", "limit_shortage", "without_outbidding"]

CEILING = "shortage"  # name of the row that limits the priced shortage

# Two shortages are the same within the first, relative and in p.u. h. The second is what a limit on the
# shortage leaves to the solver; it must exceed the solver's own tolerance.
_SAME, _SLACK = 1e-4, 1e-6


class Nothing(Objective):
    """No cost at all, so that only shortages count.

    Parameters
    ----------
    objective
        The objective that it stands in for, whose series the network keeps.
    """

    def __init__(self, objective: Objective) -> None:
        self.objective = objective

    def series(self, network: PerUnitNetwork) -> Mapping[tuple[str, str], npt.NDArray[np.float64]]:
        """The series of the objective."""
        return self.objective.series(network)

    def stage_cost(self, stage: Stage) -> Any:  # noqa: ARG002
        """None."""
        return None


def limit_shortage(model: Model) -> None:
    """State a row with the priced shortage of all stages, p.u. h of the cheapest kind; free so far."""
    rows = model.build.rows(CEILING, 1, 1, -np.inf, np.inf)
    for cost in model.penalties:
        model.build.add(cost / _unit(model), into=rows)


def without_outbidding(problem: MultiStage, plan: Plan, request: Request) -> Plan:
    """The cheapest of the plans with the least priced shortage.

    Parameters
    ----------
    plan
        The plan with the least sum of cost and priced shortage. It is the one that is wanted unless some
        cost is higher than the price of a shortage, so that a shortage was accepted to save it.
    """
    least_shortage, rationed = problem.shortage_problems
    least = least_shortage.solve_once(request)
    if not least.optimal:
        note = f"whether the shortage is the least is not known: {least.termination}"
        return _with_effort(problem, plan, [least], plan.solution, note)
    unit = _unit(plan.model)
    if plan.penalty <= (1.0 + _SAME) * least.penalty + _SAME * unit:
        return _with_effort(problem, plan, [least], least.solution)
    ceiling = (1.0 + _SLACK) * least.penalty / unit + _SLACK
    cheapest = rationed.solve_once(request, ceiling=ceiling)
    if not cheapest.optimal:
        note = f"the cheapest plan with this shortage was not found: {cheapest.termination}"
        return _with_effort(problem, least, [plan, cheapest], least.solution, note)
    return _with_effort(problem, cheapest, [plan, least], least.solution)


def _unit(model: Model) -> float:
    """What 1 p.u. h of the cheapest shortage costs, $."""
    assert model.elastic is not None
    prices = (model.elastic.limit, model.elastic.shedding, model.elastic.balance)
    return min(prices) * model.network.base_mva


def _with_effort(
    problem: MultiStage, plan: Plan, others: list[Plan], least: Solution, note: str = ""
) -> Plan:
    """A plan with the effort of others added to its own, and something to know about it."""
    solutions = [p.solution for p in (plan, *others)]
    counted = [s.iterations for s in solutions if s.iterations is not None]
    solution = replace(
        plan.solution,
        iterations=sum(counted) if counted else None,
        seconds=sum(s.seconds for s in solutions),
        message="; ".join(text for text in (plan.solution.message, note) if text),
    )
    return Plan(problem, plan.model, solution, plan.network, plan.time, least)
