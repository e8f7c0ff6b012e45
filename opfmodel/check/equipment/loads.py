"""Loads."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from opfmodel.check.equipment.base import Equipment
from opfmodel.check.trajectories import Array, Complex
from opfmodel.network.components import Load

if TYPE_CHECKING:
    from opfmodel.check.checker import Checker

__all__ = ["Loads"]


class Loads(Equipment):
    """Demand, of which a part may be shed at a cost, and another may be unserved."""

    component = Load

    def __init__(self, checker: Checker) -> None:
        super().__init__(checker)
        self.items = checker.at_work(Load)

    def check(self) -> None:
        """Check that only loads with a cost are shed, at most in full and with their power factor."""
        checker, loads = self.checker, self.items
        if not (checker.has("load_shed") and loads.names):
            return
        p, q, shed = loads.number("p"), loads.number("q"), loads.values("load_shed")
        allowed = np.isfinite(loads.number("shed_cost")) & (p > 0) & (p >= 1e-3 * np.abs(q))
        checker.inside("load shed", loads, shed, (np.zeros_like(shed), np.where(allowed, p, 0.0)), "MW")
        if checker.has("p_unserved"):
            excess = np.where(p > 0, shed + loads.values("p_unserved") - p, 0.0)
            checker.note("load shed and unserved", loads.names, excess, "MW")
        if checker.has("load_shed_q"):
            # q_shed / p_shed = q / p, in terms of apparent power
            gap = np.abs(p * loads.values("load_shed_q") - q * shed) / np.maximum(np.hypot(p, q), 1e-12)
            checker.note("load shed power factor", loads.names, gap, "MVAr")

    def power(self) -> Iterator[tuple[list[str], Complex]]:
        """Yield the demand less what is shed and unserved; the latter lies between zero and the demand."""
        checker, loads = self.checker, self.items
        served = np.zeros((len(loads.names), len(checker.hours)), dtype=complex)
        for letter, factor, unit in (("p", 1.0, "MW"), ("q", 1j, "MVAr")):
            demand, quantity = loads.number(letter), f"{letter}_unserved"
            served += factor * demand / checker.base
            shed = "load_shed" if letter == "p" else "load_shed_q"
            if checker.has(shed) and loads.names:
                served -= factor * loads.values(shed) / checker.base
            if not (checker.has(quantity) and loads.names):
                continue
            values, family = loads.values(quantity), quantity.replace("_", " ")
            served -= factor * values / checker.base
            limits = np.minimum(demand, 0), np.maximum(demand, 0)
            checker.inside(f"{family} range", loads, values, limits, unit)
            checker.report.unserved[family] = checker.largest(family, loads.names, np.abs(values), unit)
        yield loads.each("bus"), -served

    def cost_rate(self) -> Array | float:
        """Cost of demand that is shed."""
        loads = self.items
        if not (self.checker.has("load_shed") and loads.names):
            return 0.0
        price = loads.number("shed_cost")
        known = np.isfinite(price)
        return np.asarray(
            (np.where(known, price, 0.0) * np.where(known, loads.values("load_shed"), 0)).sum(axis=0)
        )
