"""Set-points are held, and limits are measured."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from opfmodel.errors import ModelError, nearest
from opfmodel.model import Device, Model
from opfmodel.network.arrays import Index, PerUnitNetwork, Table
from opfmodel.network.components import Generator, Load, Storage
from opfmodel.plan import MultiStage, Plan
from opfmodel.simulation.plants.base import Array, Values
from opfmodel.simulation.plants.problem import ALWAYS, ACPlant, SetPoints, one_stage, set_points
from opfmodel.simulation.records import DESCRIBED

__all__ = ["PowerFlow"]

_SHARE = ("load", "unserved")
_WIDE = 1e3  # p.u.; stands for a range without limit
_LEAST_VM, _MOST_VM = 0.2, 2.0  # p.u.; no grid runs outside, and Newton's steps stay inside


class PowerFlow(ACPlant):
    r"""Units hold their set-points and limits are measured, not enforced.

    Losses and forecast errors are taken by a distributed slack: with participation factors
    :math:`\gamma`, which sum to one in an island,

    .. math::
        p^g_i = \hat p^g_i + \gamma_i s

    Voltages are held where there are generators, at the plan's magnitude or, if the plan has none, at
    1 p.u. within the limits of the bus; the generators of a bus share its reactive power in
    proportion to their ranges. Storages hold ``ps`` and ``qs``, zero where the plan has none. A set-point
    above what is available is lowered to that.

    Parameters
    ----------
    participation
        Factor of each generator by name; those that are not mentioned take no part. By default
        in proportion to ``p_max``.
    """

    def __init__(self, participation: Mapping[str, float] | None = None) -> None:
        super().__init__()
        for name, factor in (participation or {}).items():
            if not 0 <= factor < np.inf:
                raise ModelError(f"participation: {name} = {factor!r}: must be a number, at least 0")
        self.participation = participation

    def shares(self, network: PerUnitNetwork) -> Array:
        """Share of each generator in the slack of its island; those of an island sum to one.

        Raises
        ------
        ModelError
            A factor is of no generator in service.
        """
        table = network.generator
        if self.participation is None:
            factors = np.clip(table.p_max[:, 0], 0.0, _WIDE)
        else:
            for name in self.participation:
                if name not in table.position:
                    known = nearest(name, table.names)
                    raise ModelError(f"participation: no generator in service is named {name!r}; {known}")
            factors = np.array([float(self.participation.get(name, 0.0)) for name in table.names])
        return _divide(factors, network.island[table.bus])

    def check(self, network: PerUnitNetwork) -> None:
        """Raise :class:`ModelError` for factors that do not fit a network."""
        self.shares(network)

    def make(self, plan: Plan) -> MultiStage:
        """Devices hold set-points, and the network has no limits."""
        problem = plan.problem
        own: dict[type, Device] = {
            Generator: _HeldGenerators(self.shares(problem.arrays)),
            Storage: _HeldStorages(),
            Load: _HeldLoads(),
        }
        devices = [own.get(device.component, device) for device in problem.devices]
        others = [key for key in set_points(plan) if key not in ALWAYS]
        prices = dict.fromkeys((*ALWAYS, _SHARE), 0.0) | dict.fromkeys(others, 1.0)
        self._set_points = SetPoints(prices, _without_limits(problem.arrays))
        return one_stage(problem, self._set_points, devices)

    def find(self, plan: Plan, aims: Values, network: PerUnitNetwork) -> Plan:
        """Hold the set-points, and voltages where there are generators."""
        if _SHARE[1] in plan.solution.program.variables:  # an elastic plan sheds on purpose
            aims = aims | {_SHARE: plan.solution.value(_SHARE[1])[:, 0]}
        window = self._set_points.targets(network, aims)
        held = window["generator", "pg_set"]
        window["generator", "pg_set"] = np.minimum(held, network.generator.p_max)
        low, high = network.bus.vm_min, network.bus.vm_max
        at = np.unique(network.generator.bus)
        wanted = plan.quantities().get(("bus", "vm"), np.ones((len(network.bus), 1)))[:, :1]
        least, most = np.full_like(wanted, _LEAST_VM), np.full_like(wanted, _MOST_VM)
        least[at] = most[at] = np.clip(wanted, low, high)[at]
        window |= {("bus", "vm_min"): least, ("bus", "vm_max"): most}
        return self.solve(plan.time, None, window)


class _HeldGenerators(Device):
    """Generators at their set-points and a distributed slack in every island."""

    component = Generator

    def __init__(self, shares: Array) -> None:
        self.shares = shares

    def declare(self, model: Model, table: Table) -> None:
        """Publish ``pg`` and ``qg`` in terms of one slack per island and one per bus with generators."""
        network = model.network
        slack = model.build.variable("slack", network.n_islands, model.stages)
        pg = model.parameter("generator", "pg_set") + self.shares * slack[network.island[table.bus]]
        at, which = np.unique(table.bus, return_inverse=True)
        extra = model.build.variable("slack_q", at.size, model.stages)
        shares = _divide(np.minimum(table.q_max - table.q_min, _WIDE)[:, 0], which)
        qg = model.parameter("generator", "qg_set") + shares * extra[which]
        model.publish("generator", "pg", pg, unit="MW", description="active generation")
        model.publish("generator", "qg", qg, unit="MVAr", description="reactive generation")
        model.inject(table.bus, p=pg, q=qg)


class _HeldStorages(Device):
    """Storages at their set-points."""

    component = Storage

    def declare(self, model: Model, table: Table) -> None:
        """Publish ``ps`` and ``qs`` as they were planned."""
        ps, qs = model.parameter("storage", "ps_set"), model.parameter("storage", "qs_set")
        model.publish("storage", "ps", ps, unit="MW", description="charging power")
        model.publish("storage", "qs", qs, unit="MVAr", description="reactive power drawn")
        model.inject(table.bus, p=-ps, q=-qs)


class _HeldLoads(Device):
    """Loads, less the share that is shed on purpose."""

    component = Load

    def declare(self, model: Model, table: Table) -> None:
        """Withdraw what is served; publish what is not."""
        share = model.parameter(_SHARE[0], f"{_SHARE[1]}_set")
        for name, power in (("p", model.parameter("load", "p")), ("q", model.parameter("load", "q"))):
            unit, text = DESCRIBED[f"{name}_unserved"]
            model.publish("load", f"{name}_unserved", power * share, unit=unit, description=text)
            served = power * share - power
            model.inject(table.bus, **{name: served})


def _divide(weights: Array, group: Index) -> Array:
    """Weights divided by the sum over their group; equal ones where that is zero."""
    sums = np.bincount(group, weights)[group]
    equal = 1.0 / np.bincount(group)[group]
    return np.asarray(np.where(sums > 0, weights / np.where(sums > 0, sums, 1.0), equal))


def _without_limits(network: PerUnitNetwork) -> Values:
    """Fields that leave the network without limits of its own."""
    none = np.full((len(network.branch), 1), np.inf)
    return {
        ("branch", "rating"): none,
        ("branch", "angle_min"): -none,
        ("branch", "angle_max"): none,
        ("bus", "vm_min"): np.full((len(network.bus), 1), _LEAST_VM),
        ("bus", "vm_max"): np.full((len(network.bus), 1), _MOST_VM),
    }
