"""The redispatch plant, which changes set-points as little as the limits allow."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from opfmodel.model import Elastic
from opfmodel.network.arrays import PerUnitNetwork
from opfmodel.network.bounds import number_within
from opfmodel.network.governed import widest
from opfmodel.network.quantities import In
from opfmodel.plan import End, MultiStage, Plan
from opfmodel.simulation.plants.base import Array, Values
from opfmodel.simulation.plants.problem import (
    ALWAYS,
    SHED,
    ACPlant,
    SetPoints,
    decided,
    one_stage,
)

__all__ = ["Redispatch"]


class Redispatch(ACPlant):
    r"""Minimise the change of set-points within all AC, ramp and storage limits.

    .. math::
        \min\; \pi_p \sum |p^g - \hat p^g| + \pi_p \sum |p^s - \hat p^s|
             + \pi_q \sum |q^g - \hat q^g| + \pi_q \sum |q^s - \hat q^s| + \text{elastic terms}

    Reactive set-points that a plan lacks are zero. Demand may be shed and limits exceeded at the
    prices of an elastic problem, so every plan has a response. Of each load the same share is shed as in the
    plan; to shed less or more of it costs as much as unserved demand.

    Parameters
    ----------
    price, reactive_price
        :math:`\pi_p` and :math:`\pi_q` in $/MWh and $/MVArh; only their ratios to the others matter.
    shedding_price
        Price of unserved demand, $/MWh.
    violation_price
        Price of limit violations, $/MWh; see :class:`opfmodel.Elastic`.
    """

    def __init__(
        self,
        price: Annotated[float, In("$/MWh")] = 100.0,
        reactive_price: Annotated[float, In("$/MVArh")] = 1.0,
        shedding_price: Annotated[float, In("$/MWh")] = 10_000.0,
        violation_price: Annotated[float, In("$/MWh")] = 50_000.0,
    ) -> None:
        super().__init__()
        self.price = number_within("redispatch: price", price, above=0)
        self.reactive_price = number_within("redispatch: reactive_price", reactive_price, above=0)
        self.elastic = Elastic(violation_price, shedding_price, 2.0 * violation_price)

    def make(self, plan: Plan) -> MultiStage:
        """Return a problem with all limits and a price on the deviation from set-points."""
        units = decided(plan.problem.arrays, plan.problem.devices)
        wanted = list(dict.fromkeys([*ALWAYS, *units]))
        reactive = (*ALWAYS[1::2], *(key for key, unit in units.items() if unit == "MVAr"))
        base = plan.problem.arrays.base_mva
        prices = {key: base * (self.reactive_price if key in reactive else self.price) for key in wanted}
        if SHED in prices:  # less or more of it is no easier than other demand that is unserved
            prices[SHED] = base * self.elastic.shedding
        # a small value of stored energy keeps lossy storage from charging and discharging at once
        end = End(price=0.01 * self.price)
        names = self.outages.components
        # more than an avoided redispatch is worth, so that a relaxation wastes no power to save one
        waste = {
            (device.component.kind, name): 2.0 * base * self.price
            for device in plan.problem.devices
            for name in device.waste
        }
        self._set_points = SetPoints(prices, _limits(plan.problem) if names else {}, waste)
        return one_stage(
            plan.problem,
            self._set_points,
            plan.problem.devices,
            elastic=self.elastic,
            end=end,
            outages=names,
        )

    def find(self, plan: Plan, aims: Values, network: PerUnitNetwork) -> Plan:
        """Change the set-points as little as possible."""
        base = network.base_mva
        before = None if self._before is None else self._before * base
        dispatch = {"pg": before, "qg": None} if len(network.generator) else {}
        initial = {**dispatch, **self.stocks(plan)}
        window = self._set_points.targets(network, aims)
        for kind, field in self._set_points.fields:
            window[kind, field] = network.tables[kind].arrays[field]
        if self._happening.surprising(plan.time, plan.problem.step) and len(network.generator):
            window |= self._within(aims["generator", "pg"][:, None], network)
        return self.solve(plan, initial, window)

    def _within(self, planned: Array, network: PerUnitNetwork) -> Values:
        """Return the limits of units that move from their set-points for as long as a response may take."""
        units = network.generator
        assert self._happening.minutes is not None
        reach = units.ramp * self._happening.minutes / 60
        low, high = np.maximum(units.p_min, planned - reach), np.minimum(units.p_max, planned + reach)
        return {
            ("generator", "p_min"): np.minimum(low, units.p_max),
            ("generator", "p_max"): np.maximum(high, units.p_min),
        }


def _limits(problem: MultiStage) -> Values:
    """Return the fields that differ in a step in which the controller does not know what is out."""
    loosest = widest(problem.profiles, problem.arrays)
    fields = (("generator", "p_min"), ("generator", "p_max"), ("generator", "ramp"), ("branch", "rating"))
    return {
        (kind, field): loosest.get((kind, field), problem.arrays.tables[kind].arrays[field])
        for kind, field in fields
    }
