"""The shortfalls behind an elastic plan, without the power that is shed along with them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from opfmodel.model.elastic import LEAST
from solvers import Solution

if TYPE_CHECKING:
    from opfmodel.plan.result import Plan

__all__ = ["shortfall_due"]


def shortfall_due(plan: Plan) -> Solution:
    """Return the minimum shortfall of a plan if active and reactive demand can be shed independently.

    A plan sheds the same share of both, even where only one is lacking. Here the shares are independent, and
    only loads that the plan sheds can be shed. With the resulting amounts added, the hard problem is
    feasible. If the solver fails, the solution of the plan is returned, for which this also holds, and so it
    is if shortfalls are traded against cost: the minimum shortfall is then not what the plan accepts.
    """
    shares, elastic = plan.model.shares, plan.model.elastic
    if not (shares and plan.model.reactive) or (elastic is not None and elastic.traded):
        return plan.solution
    most = np.where(plan.solution.value(shares[0]) > LEAST, 1.0, 0.0)
    if not most.any():
        return plan.solution
    problem = plan.problem.split_shedding_problem
    found = problem.solve_once(plan.request, limits=dict.fromkeys(problem.model.shares, (0.0, most)))
    return found.solution if found.optimal else plan.solution
