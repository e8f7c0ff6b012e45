"""The power-flow plant, which holds set-points and measures limits."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from opfmodel.devices.held import HeldFlexibleLoads, HeldGenerators, HeldStorages, without_limits
from opfmodel.devices.load import per_active_power, sheddable
from opfmodel.errors import ModelError, nearest
from opfmodel.model import Device, Model
from opfmodel.network.arrays import Index, PerUnitNetwork, Table
from opfmodel.network.bounds import number_within
from opfmodel.network.components import FlexibleLoad, Generator, Load, Storage
from opfmodel.network.shares import WIDE, divide
from opfmodel.plan import MultiStage, Plan
from opfmodel.simulation.plants.base import Array, Values
from opfmodel.simulation.plants.problem import (
    ALWAYS,
    SHED,
    ACPlant,
    SetPoints,
    decided,
    one_stage,
)
from opfmodel.simulation.records import DESCRIBED

__all__ = ["PowerFlow"]

_SHARE = ("load", "unserved")
_HELD = (*ALWAYS, _SHARE, SHED, ("flexible_load", "flexible_load_p"))
_LEAST_VM, _MOST_VM = 0.2, 2.0  # p.u.; wider than any operating range, but bounds Newton steps


class PowerFlow(ACPlant):
    r"""Hold the set-points of all units, and measure limits without enforcing them.

    A distributed slack covers losses and forecast errors. With participation factors
    :math:`\gamma`, which sum to one in each island,

    .. math::
        p^g_i = \hat p^g_i + \gamma_i s

    Buses with generators hold the voltage magnitude of the plan or, if the plan has none,
    1 p.u. clipped to the limits of the bus; in an island without generators, a connection to another grid
    does so and covers the balance, within its limits. The generators of a bus share its reactive power in
    proportion to their ranges. Storages hold ``ps`` and ``qs``, zero if the plan has none. A set-point
    above the available power is reduced to it. Of each load the same share is shed as in the plan.

    Parameters
    ----------
    participation
        Factor of each generator by name; generators not listed do not participate. By default
        in proportion to ``p_max``.
    """

    def __init__(self, participation: Mapping[str, float] | None = None) -> None:
        super().__init__()
        for name, factor in (participation or {}).items():
            number_within(f"participation: {name}", factor, at_least=0)
        self.participation = participation

    def shares(self, network: PerUnitNetwork) -> Array:
        """Return the share of each generator in the slack of its island; shares sum to one per island.

        Raises
        ------
        ModelError
            A factor belongs to no generator in service.
        """
        table = network.generator
        if self.participation is None:
            factors = np.clip(table.p_max[:, 0], 0.0, WIDE)
        else:
            for name in self.participation:
                if name not in table.position:
                    known = nearest(name, table.names)
                    raise ModelError(f"participation: no generator in service is named {name!r}; {known}")
            factors = np.array([float(self.participation.get(name, 0.0)) for name in table.names])
        return divide(factors, network.island[table.bus])

    def check(self, network: PerUnitNetwork) -> None:
        """Raise :class:`ModelError` if the factors do not fit a network."""
        self.shares(network)

    def make(self, plan: Plan) -> MultiStage:
        """Return a problem whose devices hold set-points and whose network has no limits."""
        problem = plan.problem
        own: dict[type, Device] = {
            Generator: HeldGenerators(self.shares(problem.arrays)),
            Storage: HeldStorages(),
            Load: _HeldLoads(),
            FlexibleLoad: HeldFlexibleLoads(),
        }
        devices = [own.get(device.component, device) for device in problem.devices]
        deciding = [device for device in problem.devices if device.component not in own]
        others = [key for key in decided(problem.arrays, deciding) if key not in _HELD]
        prices = dict.fromkeys(_HELD, 0.0) | dict.fromkeys(others, 1.0)
        self._set_points = SetPoints(prices, _without_limits(problem.arrays))
        return one_stage(problem, self._set_points, devices, outages=self.outages.components)

    def find(self, plan: Plan, aims: Values, network: PerUnitNetwork) -> Plan:
        """Solve for the set-points, with voltages held at buses with generators."""
        if _SHARE[1] in plan.solution.program.variables:  # an elastic plan sheds deliberately
            aims = aims | {_SHARE: plan.solution.value(_SHARE[1])[:, 0]}
        window = self._set_points.targets(network, aims)
        held = window["generator", "pg_set"]
        window["generator", "pg_set"] = np.minimum(held, network.generator.p_max)
        low, high = network.bus.vm_min, network.bus.vm_max
        at = _holding(network)
        wanted = plan.quantities().get(("bus", "vm"), np.ones((len(network.bus), 1)))[:, :1]
        least, most = np.full_like(wanted, _LEAST_VM), np.full_like(wanted, _MOST_VM)
        least[at] = most[at] = np.clip(wanted, low, high)[at]
        window |= {("bus", "vm_min"): least, ("bus", "vm_max"): most}
        return self.solve(plan, self.stocks(plan), window)


class _HeldLoads(Device):
    """Loads, less what the plan sheds."""

    component = Load

    def declare(self, model: Model, table: Table) -> None:
        """Withdraw the served demand, and publish what is shed and what is unserved."""
        if sheddable(table).size:
            self._shed(model, table)
        share = model.parameter(_SHARE[0], f"{_SHARE[1]}_set")
        for name, power in (("p", model.parameter("load", "p")), ("q", model.parameter("load", "q"))):
            unit, text = DESCRIBED[f"{name}_unserved"]
            model.publish("load", f"{name}_unserved", power * share, unit=unit, description=text)
            served = power * share - power
            model.inject(table.bus, **{name: served})

    @staticmethod
    def _shed(model: Model, table: Table) -> None:
        active = model.parameter(SHED[0], f"{SHED[1]}_set")
        reactive = model.of_fields("load", "load reactive share", per_active_power) * active
        for name, power in (("load_shed", active), ("load_shed_q", reactive)):
            unit, text = DESCRIBED[name]
            model.publish("load", name, power, unit=unit, description=text)
        model.inject(table.bus, p=active, q=reactive)


def _holding(network: PerUnitNetwork) -> Index:
    """Return the buses that hold their voltage: of generators, in islands without them of connections."""
    units, connections = network.generator, network.tables["connection"]
    generating = units.bus[units.status[:, 0] > 0]
    alone = ~np.isin(network.island[connections.bus], network.island[generating])
    moves = (connections.q_min < connections.q_max)[:, 0]
    return np.unique(np.concatenate([generating, connections.bus[alone & moves]]))


def _without_limits(network: PerUnitNetwork) -> Values:
    """Return the fields that remove the limits of the network."""
    buses = (len(network.bus), 1)
    return {
        **without_limits(network),
        ("bus", "vm_min"): np.full(buses, _LEAST_VM),
        ("bus", "vm_max"): np.full(buses, _MOST_VM),
    }
