"""Storages."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from opfmodel.check.equipment.base import Equipment
from opfmodel.check.equipment.capability import check_capability
from opfmodel.check.trajectories import Array, Complex
from opfmodel.network.components import Storage

__all__ = ["Storages"]


class Storages(Equipment):
    """Power, apparent power, capability curves and, unless the data have no energy, that of each storage."""

    component = Storage

    def check(self) -> None:
        """Check power, rating, capability curve and energy."""
        checker, units = self.checker, self.items
        ps = units.values("ps")
        qs = units.values("qs") if checker.reactive else np.zeros_like(ps)
        checker.inside("storage power", units, ps, units.left("power"), "MW")
        checker.inside("storage q", units, qs, units.left("q"), "MVAr")
        checker.note("storage rating", units.names, np.hypot(ps, qs) - units.number("rating"), "MVA")
        check_capability(checker, units, "ps", "qs")
        if checker.has("e", "e_next") or not units.names:
            self._check_energy(ps)
        else:  # a power flow is the state of one moment
            checker.leave_out("stored energy: the results do not include it")

    def _check_energy(self, ps: Array) -> None:
        """Check energy limits and the energy balance of each storage."""
        checker, units = self.checker, self.items
        e, e_next = units.values("e"), units.values("e_next")
        recovers = np.isfinite(units.constant("recovery_cost"))
        checker.note("storage energy", units.names, np.where(recovers, -np.inf, self._outside(e_next)), "MWh")
        wanted = units.where(np.isfinite(units.constant("wanted"))[:, 0])
        if wanted.names:
            least = wanted.status() * checker.trajectories.from_clock(wanted, "energy_wanted")
            checker.note("wanted energy", wanted.names, least - wanted.values("e_next"), "MWh")
        if checker.has("storage_outside"):
            outside, reported = np.maximum(self._outside(e_next), 0.0), units.values("storage_outside")
            checker.note(
                "storage outside", units.names, np.where(recovers, np.abs(reported - outside), 0.0), "MWh"
            )
        checker.continuous("energy continuity", units, e, e_next, "MWh")
        stored = (e_next - (1 - units.constant("standing_loss") * checker.hours) * e) / checker.hours
        # a given net power stores the most energy without simultaneous charging and discharging
        gain, drain = units.constant("charge_efficiency"), 1 / units.constant("discharge_efficiency")
        most = np.where(ps >= 0, gain * ps, drain * ps)
        lossy = gain < drain
        excess = np.where(lossy, stored - most, np.abs(stored - ps))
        checker.note("storage dynamics", units.names, excess, "MW")
        wasted = np.divide(most - stored, drain - gain, out=np.zeros_like(ps), where=lossy).max(axis=1)
        most_wasted = float(np.fmax.reduce(wasted, initial=0.0)) / checker.base
        checker.report.simultaneous = max(checker.report.simultaneous, most_wasted)

    def _outside(self, e_next: Array) -> Array:
        """Distance of the energy from its range at the end of each stage, MWh; negative within it."""
        low, high = self.items.number("energy_min"), self.items.number("energy")
        return np.asarray(np.maximum(low - e_next, e_next - high))

    def cost_rate(self) -> Array | float:
        """Cost of throughput, and of energy outside its limits."""
        units, has = self.items, self.checker.has
        rate = np.zeros(len(self.checker.hours))
        if units.names:
            rate += (units.number("throughput_cost") * np.abs(units.values("ps"))).sum(axis=0)
        price = units.constant("recovery_cost")
        price = np.where(np.isfinite(price), price, 0.0)
        if price.any() and has("e_next"):
            rate += (price * np.maximum(self._outside(units.values("e_next")), 0.0)).sum(axis=0)
        return rate

    def power(self) -> Iterator[tuple[list[str], Complex]]:
        """Yield what is discharged."""
        yield self.items.each("bus"), -self.checker.power("ps", "qs", self.items)
