"""Flexible loads."""

from __future__ import annotations

from typing import Any

import numpy as np

from opfmodel.model import Device, Model, Soft, Stage
from opfmodel.network.arrays import Array, Table
from opfmodel.network.components import FlexibleLoad
from solvers import largest, total

__all__ = ["FlexibleLoadDevice", "reactive_share"]


class FlexibleLoadDevice(Device):
    r"""Demand for an energy E in every window of the clock.

    The energy e that has been delivered in a window is zero at its beginning (:math:`\kappa = 0` in the stage
    that opens it, else 1), and E at its end. With the hours :math:`\tau` from the end of a stage to that of
    its window,

    .. math::
        e(k+1) = \kappa\, e(k) + \Delta \eta p, \quad p_{min} \le p \le p_{max}, \quad
        \max(0,\, E - \eta p_{max} \tau) \le e(k+1) \le E

    and p is zero outside. The lower bound is E at the end of a window and, before it, what a receding
    horizon must have delivered to remain feasible. With an ``unserved_cost`` c it is zero, and the stage that
    ends with a window costs :math:`c (E - e) / \Delta` per hour. Reactive power is
    :math:`q = p \tan(\arccos \varphi)`.

    After an outage, which happens at the end of a stage, the load may draw what it may in the stage, whether
    or not its energy is complete.
    """

    component = FlexibleLoad

    def declare(self, model: Model, table: Table) -> None:
        """Declare ``flexible_load_p`` and ``flexible_load_delivered``."""
        kind, horizon = "flexible_load", model.horizon
        p = model.variable(kind, f"{kind}_p", _least_power, _most_power, unit="MW", description="power drawn")
        after = np.zeros((1, model.stages))
        after[0, horizon.contingencies] = 1.0

        def most_energy(t: Table) -> Array:
            return np.asarray(np.where(after > 0, np.inf, t.energy) if after.any() else t.energy)

        e, e_next = model.stock(
            kind, f"{kind}_delivered", 0.0, most_energy, initial="delivered", unit="MWh",
            description="energy delivered in the window", ends=False,
        )  # fmt: skip
        q = None
        if model.reactive:
            q = p * reactive_share(table)
            model.publish(kind, f"{kind}_q", q, unit="MVAr", description="reactive power drawn")
        model.inject(table.bus, p=-p, q=None if q is None else -q)
        if not len(table):
            return
        kept = model.field(kind, "kept")
        if after.any():  # what happens after an outage belongs to the window of the stage before
            kept = kept * (1.0 - after) + after
        rows = model.build.rows(f"{kind}_energy", len(table), model.stages)
        model.build.add(e_next - kept * e - model.step * table.efficiency * p, into=rows)
        self._complete(model, table, e_next)

    @staticmethod
    def _complete(model: Model, table: Table, e_next: Any) -> None:
        """State what must have been delivered at the end of each stage."""
        firm = np.flatnonzero(np.isinf(table.unserved_cost))
        if not firm.size:
            return
        charging = table.efficiency * table.power_max  # the maximum over time series, as programs are built

        def least(t: Table) -> Array:
            reachable = t.energy - charging * t.hours_left
            return np.asarray(np.where(t.inside > 0, np.maximum(reachable, 0.0), 0.0)[firm])

        soft = Soft(
            "window", firm, "MWh", below="lacks {} to complete its energy", price="shedding"
        )  # fmt: skip
        nodes = np.arange(len(model.horizon.regular))
        model.rows("flexible_load", "flexible_load_due", e_next[firm][:, nodes], least, np.inf, soft, nodes)

    def cost(self, stage: Stage) -> Any:
        """Cost of energy that is missing at the end of windows, $/h."""
        loads = stage.flexible_load
        priced = np.flatnonzero(np.isfinite(stage.network.tables["flexible_load"].unserved_cost))
        if not priced.size:
            return None
        delivered = loads.flexible_load_delivered_next[priced]
        missing = largest(loads.due[priced] * (loads.energy[priced] - delivered), 0.0)
        return total(loads.unserved_cost[priced] * missing / stage.step)


def reactive_share(table: Table) -> Array:
    """Return the reactive power drawn per active power."""
    return np.asarray(np.sqrt(1.0 / table.power_factor**2 - 1.0))


def _least_power(table: Table) -> Array:
    """Return the minimum power: none outside windows."""
    return np.asarray(table.power_min * table.inside)


def _most_power(table: Table) -> Array:
    """Return the maximum power: none outside windows."""
    return np.asarray(table.power_max * table.inside)
