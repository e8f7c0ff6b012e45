"""What security costs: as a whole, and each outage on its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from opfmodel.errors import ModelError
from opfmodel.plan.result import Plan
from opfmodel.plan.security import KINDS, Security

__all__ = ["SecurityCost", "security_cost"]

_PRICELESS = 1e-6  # $/MWh; smaller prices are tolerance


@dataclass(frozen=True)
class SecurityCost:
    """What security costs over the horizon of a plan, $.

    Attributes
    ----------
    total
        Cost of the plan beyond that of the plan without security.
    by_outage
        Cost of the plan beyond that of the plan that need not survive this outage after any stage, by name.
        They do not add up to the total: often several outages ask for the same.
    """

    total: float
    by_outage: Mapping[str, float]


def security_cost(plan: Plan) -> SecurityCost:
    """Return what it costs that a plan survives its outages.

    The problem is solved again without security, and without each outage that has a price. Those without one
    cost nothing.

    Raises
    ------
    ModelError
        The plan is not secure or not optimal.

    Examples
    --------
    >>> import opfmodel as om
    >>> grid = om.Network("two-bus")
    >>> grid.north, grid.south = om.Bus(), om.Bus()
    >>> grid.one = om.Branch("north", "south", r=0.0, x=0.1, rating=80)
    >>> grid.two = om.Branch("north", "south", r=0.0, x=0.1, rating=80)
    >>> grid.coal = om.Generator("north", p=(0, 200), ramp=40, cost=om.Polynomial(0, 20, 0))
    >>> grid.gas = om.Generator("south", p=(0, 200), ramp=40, cost=om.Polynomial(0, 30, 0))
    >>> grid.town = om.Load("south", p=100)
    >>> plan = om.MultiStage(grid, formulation="dc", security=om.Security(minutes=15)).solve()
    >>> cost = om.security_cost(plan)
    >>> round(cost.total), {name: round(value) for name, value in cost.by_outage.items()}
    (100, {'one': 0, 'two': 0})
    """
    security = plan.problem.security
    if security is None:
        raise ModelError("the plan is not secure: its problem has no security")
    if not plan.optimal:
        raise ModelError(f"the plan from step {plan.time} is {plan.status}: its security has no cost")

    def saved(other: Security | None) -> float:
        problem = plan.problem.with_security(other)
        varies = plan.request.horizon.varying
        horizon = plan.request.horizon.regular if varies else problem.horizon
        return plan.objective - problem.solve_requested(replace(plan.request, horizon=horizon)).objective

    every = security.outages(plan.problem.peak)
    priced = _priced(plan)
    by_outage = {
        name: saved(replace(security, contingencies=_by_kind(plan, [o for o in every if o != name])))
        if name in priced
        else 0.0
        for name in every
    }
    return SecurityCost(saved(None), by_outage)


def _priced(plan: Plan) -> set[str]:
    """Return the outages after which more demand would cost something."""
    horizon = plan.request.horizon
    price = np.abs(plan.contingency_prices())
    at = zip(horizon.contingencies, price.max(axis=0, initial=0.0), strict=True)
    return {name for node, most in at if most > _PRICELESS for name in horizon.out[node]}


def _by_kind(plan: Plan, names: list[str]) -> dict[str, list[str]]:
    """Return names of components as contingencies."""
    tables = plan.network.tables
    return {key: [n for n in names if n in tables[kind].position] for key, kind in KINDS.items()}
