"""Connections to another grid."""

from __future__ import annotations

from typing import Any

from opfmodel.model import Device, Model, Stage, declare_peak
from opfmodel.network.arrays import Table
from opfmodel.network.components import Connection
from solvers import largest, total

__all__ = ["ConnectionDevice"]

_PEAK = "connection_peak"


class ConnectionDevice(Device):
    r"""Connections with prices of imports and exports, and a charge for the maximum import.

    With the imported power p, negative if exported, and the peak m of the billing period,

    .. math::
        \max(\pi_b p, \pi_s p) + \pi_m \frac{m(k + 1) - \kappa(k)\, m(k)}{\Delta}, \quad
        m(k + 1) \ge \kappa(k)\, m(k), \quad m(k + 1) \ge p(k)

    in $/h, convex because :math:`\pi_s \le \pi_b`; :math:`\kappa` is 0 where a billing period begins, else 1.
    The charges add up to :math:`\pi_m` times the maximum import of each period. Peaks are a quantity of the
    model only if a connection has a peak cost.
    """

    component = Connection

    def declare(self, model: Model, table: Table) -> None:
        """Declare ``connection_p``, ``connection_q`` and ``connection_peak``."""
        p = model.variable(
            "connection", "connection_p", "p_min", "p_max", unit="MW", description="imported active power"
        )
        q = None
        if model.reactive:
            q = model.variable(
                "connection", "connection_q", "q_min", "q_max",
                unit="MVAr", description="injected reactive power",
            )  # fmt: skip
        model.inject(table.bus, p=p, q=q)
        if table.peak_cost.any() or ("connection", "peak_cost") in model.series:
            kept = model.field("connection", "kept")
            declare_peak(
                model, "connection", _PEAK, p, kept, unit="MW", initial="peak", description="peak of imports"
            )  # fmt: skip

    def cost(self, stage: Stage) -> Any:
        """Return the cost of imports less the revenue of exports, and the peak charge, $/h."""
        connection = stage.connection
        if not len(stage.network.tables["connection"]):
            return None
        p = connection.connection_p
        cost = total(largest(connection.buy * p, connection.sell * p))
        if not stage.has(_PEAK):
            return cost
        increase = connection.connection_peak_next - connection.kept * connection.connection_peak
        return cost + total(connection.peak_cost * increase / stage.step)
