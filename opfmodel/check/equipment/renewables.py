"""Renewable generation."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from opfmodel.check.equipment.base import Equipment
from opfmodel.check.equipment.capability import check_capability
from opfmodel.check.trajectories import Array, Complex
from opfmodel.network.components import Renewable

__all__ = ["Renewables"]


class Renewables(Equipment):
    """Available power, its curtailment and cost, and limits of reactive power."""

    component = Renewable

    def check(self) -> None:
        """Check limits, and that what is reported as curtailed is what is available but not generated."""
        checker, units = self.checker, self.items
        p, available = units.values("renewable_p"), self._available()
        checker.inside("renewable p", units, p, (np.zeros_like(available), available), "MW")
        curtailed = units.values("renewable_curtailed")
        checker.note("renewable curtailment", units.names, np.abs(available - p - curtailed), "MW")
        q = units.values("renewable_q") if checker.reactive else np.zeros_like(p)
        if checker.reactive:
            checker.inside("renewable q", units, q, units.left("q"), "MVAr")
            limited = units.where(np.isfinite(units.constant("power_factor"))[:, 0])
            cosine = limited.constant("power_factor")
            active, reactive = limited.values("renewable_p"), limited.values("renewable_q")
            beyond = cosine * np.abs(reactive) - np.sqrt(1.0 - cosine**2) * active
            checker.note("renewable power factor", limited.names, beyond, "MVAr")
        checker.note("renewable rating", units.names, np.hypot(p, q) - units.number("rating"), "MVA")
        check_capability(checker, units, "renewable_p", "renewable_q")

    def _available(self) -> Array:
        """Available power, MW; nothing while a unit is out of service."""
        return np.where(self.items.status() > 0, self.items.number("available"), 0.0)

    def power(self) -> Iterator[tuple[list[str], Complex]]:
        """Yield what is generated."""
        yield self.items.each("bus"), self.checker.power("renewable_p", "renewable_q", self.items)

    def cost_rate(self) -> Array | float:
        """Cost of curtailment."""
        units = self.items
        curtailed = self._available() - units.values("renewable_p")
        return np.asarray((units.number("curtail_cost") * curtailed).sum(axis=0))
