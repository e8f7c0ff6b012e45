"""Generators."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from opfmodel.check.equipment.base import Equipment
from opfmodel.check.equipment.capability import check_capability
from opfmodel.check.trajectories import Array, Complex, Items
from opfmodel.data.series import SeriesKey
from opfmodel.network.components import Generator
from opfmodel.network.costs import PiecewiseLinear

__all__ = ["Generators"]


class Generators(Equipment):
    """Active and reactive power limits, capability curves, ramps and costs."""

    component = Generator

    def check(self) -> None:
        """Check limits and ramps; a ramp is known only where the dispatch before it is."""
        checker, units = self.checker, self.items
        checker.inside("generator p", units, units.values("pg"), units.left("p"), "MW")
        if checker.reactive:
            checker.inside("generator q", units, units.values("qg"), units.left("q"), "MVAr")
        check_capability(checker, units, "pg", "qg", units.number("on") > 0)
        ramped = units.where(np.isfinite(units.number("ramp")).any(axis=1))
        known = checker.previous_pg or {}
        before = np.array([known.get(name, math.nan) for name in ramped.names]).reshape(-1, 1)
        change = np.abs(np.diff(ramped.values("pg"), axis=1, prepend=before))
        change[np.diff(ramped.status(), axis=1, prepend=1.0) != 0] = 0.0  # a unit trips, or returns
        change[np.isnan(change)] = 0.0
        between = 0.5 * (checker.hours + np.concatenate([checker.hours[:1], checker.hours[:-1]]))
        most = ramped.number("ramp") * between
        # a unit that starts up or shuts down may move by its minimum output
        started = np.abs(np.diff(ramped.number("on"), axis=1, prepend=self._on_before(ramped)))
        most = most + started * np.maximum(ramped.bounds("p")[0] - most, 0.0)
        checker.note("ramp", ramped.names, change - most, "MW")

    @staticmethod
    def _on_before(units: Items) -> Array:
        """The part that ran before the first stage; that of the first stage if it is not known."""
        at, first = units.trajectories, units.number("on")[:, :1].copy()
        step = int(at.begins[0]) - 1
        for row, name in enumerate(units.names):
            key = SeriesKey(name, "on")
            if step >= 0 and key in at.series:
                first[row] = at.series[key][step]
            elif step < 0 and units.members[row].hours_on is not None:
                first[row] = float(units.members[row].hours_on > 0)
        return first

    def power(self) -> Iterator[tuple[list[str], Complex]]:
        """Yield what is generated."""
        yield self.items.each("bus"), self.checker.power("pg", "qg", self.items)

    def cost_rate(self) -> Array:
        """Cost of active generation, from the declared cost functions."""
        piecewise = [isinstance(cost, PiecewiseLinear) for cost in self.items.each("cost")]
        smooth, linear = self.items.where([not p for p in piecewise]), self.items.where(piecewise)
        costs, pg = replace(smooth, members=smooth.each("cost")), smooth.values("pg")
        rate = costs.number("c2") * pg**2 + costs.number("c1") * pg + smooth.number("on") * costs.number("c0")
        rate = (rate * smooth.status()).sum(axis=0)
        running = np.broadcast_to(linear.number("on"), linear.values("pg").shape)
        for name, cost, dispatch, on, status in zip(
            linear.names, linear.each("cost"), linear.values("pg"), running, linear.status(), strict=True
        ):
            of_running = np.divide(dispatch, on, out=np.zeros_like(dispatch), where=on > 0)
            rate += status * on * self._of_segments(name, cost, of_running)
        return np.asarray(rate + self._start_rate())

    def _of_segments(self, name: str, cost: PiecewiseLinear, dispatch: Array) -> Array:
        """Piecewise-linear cost of a unit: from the first point on, with each slope from its bend on."""
        (begin, rate), *_ = (point for _, point in cost.bends)
        total: Array = np.full_like(dispatch, rate)
        before: Array | float = 0.0
        for number, (constant, (bend, _)) in enumerate(cost.bends, 1):
            declared = self.checker.trajectories.declared
            slope = declared(f"slope_{number}", [name], np.array([[constant]]), "mean")[0]
            beyond = dispatch - begin if number == 1 else np.maximum(dispatch - bend, 0.0)
            total = total + (slope - before) * beyond
            before = slope
        return total

    def _start_rate(self) -> Array:
        """Cost of the starts in each stage, spread over it."""
        units = self.items
        on = np.broadcast_to(units.number("on"), units.values("pg").shape)
        starts = np.maximum(np.diff(on, axis=1, prepend=self._on_before(units)), 0.0)
        return np.asarray(
            (units.constant("start_cost") * starts * units.status()).sum(axis=0) / self.checker.hours
        )
