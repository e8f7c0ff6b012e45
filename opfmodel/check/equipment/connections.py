"""Connections to another grid."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from opfmodel.check.equipment.base import Equipment
from opfmodel.check.trajectories import Array, Complex
from opfmodel.network.components import Connection

__all__ = ["Connections"]


class Connections(Equipment):
    """Limits of active and reactive power, peaks of imports, prices and peak charges."""

    component = Connection

    def check(self) -> None:
        """Check limits and, where results have them, peaks."""
        checker, items = self.checker, self.items
        p = items.values("connection_p")
        checker.inside("connection p", items, p, items.left("p"), "MW")
        if checker.reactive:
            q = items.values("connection_q")
            checker.inside("connection q", items, q, items.left("q"), "MVAr")
        if items.names and checker.has("connection_peak", "connection_peak_next"):
            start, end = items.values("connection_peak"), items.values("connection_peak_next")
            checker.continuous("peak continuity", items, start, end, "MW")
            checker.note("connection peak", items.names, np.abs(end - self._peak(start)), "MW")
        elif items.number("peak_cost").any():
            checker.leave_out("peak charges: the results do not include the peaks")

    def _peak(self, start: Array) -> Array:
        """Maximum import of the billing period at the end of each stage, from that at its start, MW."""
        return np.maximum(self._kept() * start, self.items.values("connection_p"))

    def _kept(self) -> Array:
        """0 in a stage in which a billing period begins, else 1."""
        return self.checker.trajectories.from_clock(self.items, "kept")

    def power(self) -> Iterator[tuple[list[str], Complex]]:
        """Yield what is imported."""
        yield self.items.each("bus"), self.checker.power("connection_p", "connection_q", self.items)

    def cost_rate(self) -> Array | float:
        """Cost of imports less the revenue of exports, and the charge for the increase of the peak."""
        items = self.items
        if not items.names:
            return 0.0
        p = items.values("connection_p")
        rate = items.number("buy") * np.maximum(p, 0.0) + items.number("sell") * np.minimum(p, 0.0)
        charge = items.number("peak_cost")
        if charge.any() and self.checker.has("connection_peak"):
            start = items.values("connection_peak")
            rate = rate + charge * (self._peak(start) - self._kept() * start) / self.checker.hours
        return np.asarray(rate.sum(axis=0))
