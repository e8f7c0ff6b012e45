"""The shortfalls behind an elastic plan: what is lacking, apart from what is shed along with it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from opfmodel.model.elastic import LEAST
from solvers import Solution

if TYPE_CHECKING:
    from opfmodel.plan.request import Limits
    from opfmodel.plan.result import Plan

__all__ = ["shortfall_due"]


def shortfall_due(plan: Plan) -> Solution:
    """Return the minimum shortfall of a plan if active and reactive demand need not be shed alike.

    A plan sheds the same share of both, also where only one is lacking. Here the shares are independent, and
    only loads that the plan sheds may be shed. Whoever adds the amounts makes the hard problem feasible. If
    the solver fails, the solution of the plan is returned, of which the same is true.
    """
    if not plan.model.ties:
        return plan.solution
    least_shortage, _ = plan.problem.shortage_problems
    limits: Limits = {
        name: (0.0, np.where(plan.solution.value(name) > LEAST, 1.0, 0.0)) for name in plan.model.shares
    } | dict.fromkeys(plan.model.ties, (-np.inf, np.inf))
    found = least_shortage.solve_once(plan.request, limits=limits)
    return found.solution if found.optimal else plan.solution
