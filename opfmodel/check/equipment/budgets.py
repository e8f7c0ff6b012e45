"""Budgets."""

from __future__ import annotations

import numpy as np

from opfmodel.check.equipment.base import Equipment
from opfmodel.check.trajectories import Array
from opfmodel.network.components import Budget

__all__ = ["Budgets"]

_SAME = 1e-6  # steps
_POWERS = (("generator", "pg"), ("connection", "connection_p"), ("storage", "ps"))
_MOVES = (("branch", "tap_moves"), ("branch", "shift_moves"), ("shunt", "shunt_b_moves"))


class Budgets(Equipment):
    """What is used and left of each budget, in shares of its amount."""

    component = Budget

    def check(self) -> None:
        """Check what is used, what is left, and that no more is used than the amount unless it has a cost."""
        checker, budgets = self.checker, self.items
        if not budgets.names:
            return
        if not checker.has("budget_left", "budget_left_next"):  # a power flow is the state of one moment
            checker.leave_out("budgets: the results do not include what is left")
            return
        used, over = budgets.values("budget_used"), budgets.values("budget_over")
        left, left_next = budgets.values("budget_left"), budgets.values("budget_left_next")
        amount = budgets.number("amount")
        share = np.maximum(amount.max(axis=1, keepdims=True), 1e-6)
        wrong = np.abs(used - self._used()) * checker.hours
        checker.note("budget use", budgets.names, wrong / share, "p.u.")
        carried, counted = self._periods()
        end = carried * left + (1.0 - carried) * amount - counted * used
        # a plan may owe until its period ends; in a run each step settles what it overspends
        plan, run = np.abs(left_next - end), np.abs(left_next - np.maximum(end, 0.0))
        checker.note("budget dynamics", budgets.names, np.minimum(plan, run) / share, "p.u.")
        gap = np.abs(left[:, 1:] - left_next[:, :-1])
        checker.note("budget continuity", budgets.names, np.pad(gap, ((0, 0), (0, 1))) / share, "p.u.")
        hard = np.array([price is None for price in budgets.each("over_cost")])[:, None]
        within = (carried == 0) & (counted < checker.hours - _SAME)  # a period ends within the stage
        ending = np.pad((carried == 0)[:, 1:] & ~within[:, 1:], ((0, 0), (0, 1)))
        settled = np.where(
            within, left - (checker.hours - counted) * used, np.where(ending, left_next, np.inf)
        )
        owed = -np.where(run < plan, end, settled) - over * checker.hours
        exceeded = np.where(hard, over * checker.hours, 0.0)
        checker.note("budget", budgets.names, np.maximum(exceeded, owed) / share, "p.u.")

    def _used(self) -> Array:
        """What is used in each stage, units per hour, from the power of the units."""
        at = self.checker.trajectories
        made = np.zeros((len(self.items.names), len(at.hours)))
        for row, uses in enumerate(self.items.each("uses")):
            for name, weight in uses.items():
                for kind, quantity in _POWERS:
                    if name in at.position(kind):
                        power = at.of(quantity, [name])[0]
                        made[row] += weight * (np.abs(power) if kind == "storage" else power)
                for kind, quantity in _MOVES:
                    if name in at.position(kind) and at.has(quantity):
                        made[row] += weight * at.of(quantity, [name])[0] / at.hours
        return made

    def _periods(self) -> tuple[Array, Array]:
        """1 in stages that continue a period and 0 in those that begin one; hours of each in its last one."""
        at, hours = self.checker.trajectories, self.items.constant("hours")
        length = np.rint(hours / at.base)
        # a step within which a period begins belongs to it, except step 0, before which nothing was used
        last = np.ceil(at.clock(at.ends - 1) / at.base - _SAME)
        before = np.ceil(at.clock(np.maximum(at.begins - 1, 0)) / at.base - _SAME)
        carried = np.floor(last / length) == np.floor(before / length)
        since = (last - length * np.floor(last / length) + 1.0) * at.base
        return carried.astype(float), np.minimum(at.hours, since)

    def cost_rate(self) -> Array | float:
        """Cost of overspending."""
        if not self.items.names or not self.checker.has("budget_over"):
            return 0.0
        price = np.array([cost or 0.0 for cost in self.items.each("over_cost")])[:, None]
        return np.asarray((price * self.items.values("budget_over")).sum(axis=0))
