"""Elastic plans in two steps: minimum penalty first, then minimum cost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from opfmodel.model import Model, Stage
from opfmodel.network.arrays import PerUnitNetwork
from opfmodel.objectives.base import Objective
from opfmodel.plan.result import Plan

if TYPE_CHECKING:
    from opfmodel.plan.multistage import MultiStage

__all__ = ["SHORTAGE", "Nothing", "limit_shortage", "without_outbidding"]

SHORTAGE = "shortage"  # name of the row that limits the penalty

# Both are relative and, in p.u. h, absolute: the tolerance within which two penalties are equal, and the
# margin that a limit on the penalty leaves to the solver, which must exceed the solver's tolerance.
_SAME, _SLACK = 1e-4, 1e-6


class Nothing(Objective):
    """No cost, which leaves only the penalty to minimise.

    Parameters
    ----------
    objective
        The objective that it replaces; the problem keeps its series and quantities.
    """

    def __init__(self, objective: Objective) -> None:
        self.objective = objective
        self.needs = objective.needs

    def series(self, network: PerUnitNetwork) -> Mapping[tuple[str, str], npt.NDArray[np.float64]]:
        """Return the series of the objective."""
        return self.objective.series(network)

    def stage_cost(self, stage: Stage) -> Any:  # noqa: ARG002
        """Return None."""
        return None


def limit_shortage(model: Model) -> None:
    """Add a row with the penalty of all stages, in p.u. h of the cheapest kind; free until limited."""
    rows = model.build.rows(SHORTAGE, 1, 1, -np.inf, np.inf)
    for cost in model.penalties:
        model.build.add(cost / _unit(model), into=rows)


def without_outbidding(problem: MultiStage, plan: Plan) -> Plan:
    """Return the cheapest of the plans with the minimum penalty.

    Parameters
    ----------
    plan
        The plan with the minimum sum of cost and penalty. It is the result unless some cost exceeds the
        price of a shortfall, which was then accepted to save that cost, or the solver failed. Costs far
        above the prices can make it fail, which says nothing of the problems solved here.
    """
    least_shortage, rationed = problem.shortage_problems
    least = least_shortage.solve_once(plan.request)
    if not least.optimal:
        note = f"the minimum shortfall is not known: {least.termination}"
        return _with_effort(problem, plan, [least], note)
    unit = _unit(plan.model)
    if plan.optimal and plan.program_penalty <= (1.0 + _SAME) * least.program_penalty + _SAME * unit:
        return _with_effort(problem, plan, [least])
    ceiling = (1.0 + _SLACK) * least.program_penalty / unit + _SLACK
    cheapest = rationed.solve_once(plan.request, limits={SHORTAGE: (-np.inf, ceiling)})
    if not cheapest.optimal:
        note = f"the cheapest plan with this shortfall was not found: {cheapest.termination}"
        return _with_effort(problem, least, [plan, cheapest], note)
    return _with_effort(problem, cheapest, [plan, least])


def _unit(model: Model) -> float:
    """Return the penalty of 1 p.u. h of the cheapest kind of shortfall, $."""
    assert model.elastic is not None
    prices = (model.elastic.limit, model.elastic.shedding, model.elastic.balance)
    return min(prices) * model.network.base_mva


def _with_effort(problem: MultiStage, plan: Plan, others: list[Plan], note: str = "") -> Plan:
    """Return a plan with the effort of other solves added to its own, and a note in its message."""
    solutions = [p.solution for p in (plan, *others)]
    counted = [s.iterations for s in solutions if s.iterations is not None]
    solution = replace(
        plan.solution,
        iterations=sum(counted) if counted else None,
        seconds=sum(s.seconds for s in solutions),
        message="; ".join(text for text in (plan.solution.message, note) if text),
    )
    return plan.with_solution(problem, solution)
