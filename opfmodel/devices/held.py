"""Devices that hold their set-points, for power flows: unlike dispatched ones, they decide nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.devices.dc_line import DESCRIBED, DCLineDevice
from opfmodel.devices.flexible_load import reactive_share
from opfmodel.model import Device, Model
from opfmodel.network.arrays import Array, Index, PerUnitNetwork, Table
from opfmodel.network.components import DCLine, FlexibleLoad, Generator, Load, Renewable, Storage
from opfmodel.network.shares import WIDE, divide

__all__ = [
    "HeldFlexibleLoads",
    "HeldGenerators",
    "HeldStorages",
    "held_devices",
    "without_limits",
]


class HeldGenerators(Device):
    r"""Generators at their set-points, with a slack per island and one of reactive power per bus.

    .. math::
        p^g_i = \hat p^g_i + \gamma_i s, \quad q^g_i = \hat q^g_i + \rho_i s^q

    The generators of a bus that regulate its voltage share :math:`s^q` in proportion to their ranges.

    Parameters
    ----------
    shares
        Share :math:`\gamma` of each generator in the slack of its island, ``(generators,)`` or
        ``(generators, 1)``.
    regulates
        Mask of the generators that regulate; by default all of them.
    """

    component = Generator

    def __init__(self, shares: Array, regulates: npt.NDArray[np.bool_] | None = None) -> None:
        self.shares = shares
        self.regulates = regulates

    def declare(self, model: Model, table: Table) -> None:
        """Publish ``pg`` and ``qg`` as functions of the slacks ``slack`` and ``slack_q``."""
        network = model.network
        slack = model.build.variable("slack", network.n_islands, model.stages)
        island = network.island[table.bus]
        left = _left(model, "slack", self.shares, island)
        pg = model.parameter("generator", "pg_set") + left * slack[island]
        regulates = np.ones(len(table), dtype=bool) if self.regulates is None else self.regulates
        at, which = np.unique(table.bus[regulates], return_inverse=True)
        extra = model.build.variable("slack_q", at.size, model.stages)
        ranges = np.clip(table.q_max[regulates] - table.q_min[regulates], 0.0, WIDE)[:, 0]
        shares, owner = np.zeros(len(table)), np.zeros(len(table), dtype=np.intp)
        shares[regulates], owner[regulates] = divide(ranges, which), which
        left = _left(model, "slack_q", shares, table.bus)
        qg = model.parameter("generator", "qg_set") + left * extra[owner]
        model.publish("generator", "pg", pg, unit="MW", description="active generation")
        model.publish("generator", "qg", qg, unit="MVAr", description="reactive generation")
        model.inject(table.bus, p=pg, q=qg)


class HeldStorages(Device):
    """Storages at their set-points."""

    component = Storage

    def declare(self, model: Model, table: Table) -> None:
        """Publish ``ps`` and ``qs`` as set."""
        ps, qs = model.parameter("storage", "ps_set"), model.parameter("storage", "qs_set")
        model.publish("storage", "ps", ps, unit="MW", description="charging power")
        model.publish("storage", "qs", qs, unit="MVAr", description="reactive power drawn")
        model.inject(table.bus, p=-ps, q=-qs)


class HeldRenewables(Device):
    """Renewables that generate what they can, with the reactive power within its limits nearest to 0."""

    component = Renewable

    def declare(self, model: Model, table: Table) -> None:
        """Publish ``renewable_p`` and ``renewable_q`` as set."""
        p, q = model.parameter("renewable", "p_set"), model.parameter("renewable", "q_set")
        model.publish("renewable", "renewable_p", p, unit="MW", description="renewable generation")
        curtailed = model.field("renewable", "available") - p
        text = "available power not generated"
        model.publish("renewable", "renewable_curtailed", curtailed, unit="MW", description=text)
        text = "reactive power of renewables"
        model.publish("renewable", "renewable_q", q, unit="MVAr", description=text)
        model.inject(table.bus, p=p, q=q)


class HeldLoads(Device):
    """Loads that are served in full."""

    component = Load

    def declare(self, model: Model, table: Table) -> None:
        """Withdraw the demand from its bus."""
        model.inject(table.bus, p=-model.parameter("load", "p"), q=-model.parameter("load", "q"))


class HeldFlexibleLoads(Device):
    """Flexible loads at their set-points."""

    component = FlexibleLoad

    def declare(self, model: Model, table: Table) -> None:
        """Publish ``flexible_load_p`` and ``flexible_load_q`` as set."""
        p = model.parameter("flexible_load", "flexible_load_p_set")
        q = p * reactive_share(table)
        model.publish("flexible_load", "flexible_load_p", p, unit="MW", description="power drawn")
        model.publish("flexible_load", "flexible_load_q", q, unit="MVAr", description="reactive power drawn")
        model.inject(table.bus, p=-p, q=-q)


class HeldDCLines(Device):
    """DC lines at their set-points; the power at the to end follows from that at the from end."""

    component = DCLine

    def declare(self, model: Model, table: Table) -> None:
        """Publish the power at both ends as set."""
        fields = ("forward_set", "backward_set", "qf_set", "qt_set")
        units = ("MW", "MW", "MVAr", "MVAr")
        forward, backward, qf, qt = values = [model.parameter("dc_line", field) for field in fields]
        for (name, description), value, unit in zip(DESCRIBED.items(), values, units, strict=True):
            model.publish("dc_line", name, value, unit=unit, description=description)
        DCLineDevice.connect(model, table, (forward, backward), (qf, qt))


def held_devices(network: PerUnitNetwork, generators: HeldGenerators) -> list[Device]:
    """Return the devices of a power flow: generators, and all other kinds in service at their set-points."""
    others = (HeldStorages, HeldLoads, HeldRenewables, HeldFlexibleLoads, HeldDCLines)
    present = [held() for held in others if len(network.tables[held.component.kind])]
    return [generators, *present]


def _left(model: Model, what: str, shares: Array, group: Index) -> Any:
    """Return the shares of the units that are in service, if solves may take some out."""
    weights = np.ravel(shares)

    def left(table: Table) -> Array:
        columns = [divide(weights * status, group) * status for status in table.status.T]
        return np.column_stack(columns)

    if ("generator", "status") not in model.series:
        return shares
    return model.of_fields("generator", f"{what} share", left)


def without_limits(network: PerUnitNetwork) -> dict[tuple[str, str], Array]:
    """Return the fields, by kind and name, that remove the limits of the branches."""
    none = np.full((len(network.branch), 1), np.inf)
    return {("branch", "rating"): none, ("branch", "angle_min"): -none, ("branch", "angle_max"): none}
