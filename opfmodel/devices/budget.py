"""Budgets over time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.errors import IncompatibleError
from opfmodel.horizon import Horizon
from opfmodel.model import Device, Model, NumericStage, Soft, Stage
from opfmodel.network.arrays import Array, Index, Table
from opfmodel.network.components.budget import COUNTED, Budget, Use
from solvers import Expression, largest, total

__all__ = ["BudgetDevice"]

_SAME = 1e-6  # h, and relative


class BudgetDevice(Device):
    r"""Stocks of a limited amount per period, of which a plan uses no more than its share.

    .. math::
        b(k+1) = \kappa\, b(k) + (1 - \kappa)\, B - \Delta\, u, \quad
        u = \sum_i w_i p^g_i + \sum_j w_j |p^s_j|

    with :math:`\kappa = 0` in a stage that begins a period, else 1. At the end of a period
    :math:`b + \Delta\, o \ge 0`, and at the end of the horizon, in the first period or in a later one,

    .. math::
        b(N) + \Delta\, o \ge \frac{R}{R + H}\, b(0) \quad\text{or}\quad \frac{R}{hours}\, B

    with the length H of the horizon and the hours R of the period that are left after it. Overspending o is
    zero or has a cost.
    """

    component = Budget
    physical = False

    def declare(self, model: Model, table: Table) -> None:
        """Declare ``budget_left``, ``budget_used`` and ``budget_over``."""
        horizon, items = model.horizon, np.arange(len(table))
        _check(table, horizon)
        _check_moves(model, table)
        # what is used never returns, unless a weight is negative: then limits hold at the end of every stage
        left, left_next = model.stock(
            "budget", "budget_left", -np.inf, np.inf, initial="left", ends=False,
            unit="units", description="units of the budget that are left",
        )  # fmt: skip
        used = model.build.variable("budget use", items.size, model.stages)
        model.publish("budget", "budget_used", used, unit="units/h", description="units of the budget used")
        last = np.isin(horizon.owner, horizon.leaves)

        def most(table: Table) -> Array:
            settled = last | (table.remaining < _SAME) | (_before(horizon)(table) > _SAME)
            return np.where(settled & np.isfinite(table.over_cost), np.inf, 0.0)

        soft = Soft("budget", items, "", above="is overspent by {} units")
        over = model.variable(
            "budget", "budget_over", 0.0, most, unit="units/h", start=0.0, soft=soft,
            description="units used above the amount, or above the share of the horizon at its end",
        )  # fmt: skip
        if not items.size:
            return
        self._count(model, table, used)
        even, regular = horizon.is_even, np.arange(len(horizon.regular))
        counted = model.step if even else model.of_fields("budget", "budget hours", _counted(horizon))
        dynamics = model.build.rows("budget_dynamics", items.size, model.stages)
        change = left_next - model.field("budget", "carried") * left + counted * used
        model.build.add(change - model.of_fields("budget", "budget refill", _refill), into=dynamics)
        self._limit(model, table, left, left_next + model.step * over)
        if not even:  # a period may end within a stage
            before = model.of_fields("budget", "budget hours before", _before(horizon))
            body = (left - before * used + model.step * over)[:, regular]
            ends = _least(lambda t: _before(horizon)(t) > _SAME)
            model.rows("budget", "budget_before", body, ends, np.inf, nodes=regular)
        model.price(
            "budget",
            "budget_price",
            lambda solution, _: solution.dual("budget_dynamics"),
            "$/unit",
            "value of one more unit of the budget left at the end of the stage",
            rate=False,
        )

    @staticmethod
    def _count(model: Model, table: Table, used: Expression) -> None:
        """State what is used in each stage; what happens after outages does not count."""
        rows = model.build.rows("budget_use", used.items, model.stages)
        model.build.add(used, into=rows)
        regular = np.arange(len(model.horizon.regular))
        length = model.horizon.hours[None, regular]
        for counted, owner, member, weight in _uses(table):
            if counted.moves and not model.has(counted.quantity):
                continue  # the formulation moves nothing
            quantity = getattr(getattr(model, counted.kind), counted.quantity)[member][:, regular]
            if counted.magnitude:
                quantity = largest(quantity, -quantity)
            rate = weight / length if counted.moves else weight
            model.build.add(-rate * quantity, into=rows[owner][:, regular])

    @staticmethod
    def _limit(model: Model, table: Table, left: Expression, paid: Expression) -> None:
        """State what has to be left at the end of each period, and at the end of each scenario.

        Parameters
        ----------
        paid
            What is left at the end of each stage, with overspending.
        """
        horizon = model.horizon
        leaves, hours = horizon.leaves, horizon.hours

        def through(table: Table) -> Array:
            """Whether the period of the first stage lasts until the end of each node, as 1 or 0."""
            carried = np.array(np.broadcast_to(table.carried, (len(table), len(horizon))))
            for node in horizon.inner:  # parents come first
                carried[:, node] *= carried[:, horizon.parent[node]]
            return carried

        def of_left(table: Table) -> Array:
            first = horizon.roots[:1] if table.remaining.shape[1] > 1 else [0]
            whole = table.remaining[:, first] + hours[horizon.roots[0]]
            return np.asarray(through(table) * table.remaining / whole)

        def of_amount(table: Table) -> Array:
            return np.asarray((1.0 - through(table)) * table.remaining / table.hours * table.amount)

        part = model.of_fields("budget", "budget share", of_left, leaves)
        least = model.of_fields("budget", "budget share later", of_amount, leaves)
        body = model.leaves(paid) - part * left[:, horizon.roots[:1]] - least
        model.whole.append(model.rows("budget", "budget_share", body, 0.0, np.inf, nodes=leaves).name)
        regular, inner = np.arange(len(horizon.regular)), np.ones(len(horizon), dtype=bool)
        inner[leaves] = inner[horizon.contingencies] = False
        ends = _least(lambda t: inner & (t.remaining < _SAME))
        model.rows("budget", "budget_end", paid[:, regular], ends, np.inf, nodes=regular)
        refilled = np.unique(
            np.concatenate([owner[weight[:, 0] < 0] for _, owner, _, weight in _uses(table)])
        )
        if refilled.size:
            body = paid[refilled][:, regular]
            hard = np.isinf(table.over_cost[refilled])
            soft = Soft("budget", refilled, "", below="is overspent by {} units")
            lower = np.where(hard, 0.0, -np.inf)
            model.rows("budget", "budget_within", body, lower, np.inf, soft, nodes=regular)

    def cost(self, stage: Stage) -> Any:
        """Return the cost of overspending, $/h."""
        g = stage.budget
        price = np.where(np.isfinite(g.over_cost), g.over_cost, 0.0)
        return total(price * g.budget_over)

    def follow(self, stage: NumericStage) -> Mapping[str, Array]:
        """Return what is used and left; without decisions, what exceeds the budget is overspent at once."""
        budgets, horizon, table = stage.budget, stage.horizon, stage.network.tables["budget"]
        shape = len(table), len(horizon)
        used = np.zeros(shape)
        for counted, owner, member, weight in _uses(table):
            values = stage.values.get((counted.kind, counted.quantity))
            if values is None:  # the formulation moves nothing
                continue
            quantity = values[member]
            rate = weight / horizon.hours[None, :] if counted.moves else weight
            np.add.at(used, owner, rate * (np.abs(quantity) if counted.magnitude else quantity))
        decided = "budget_over" in budgets
        carried, refill = (np.broadcast_to(values, shape) for values in (table.carried, _refill(table)))
        hours = np.broadcast_to(_counted(horizon)(table), shape)
        left, left_next = np.array(budgets.budget_left, dtype=float), np.zeros(shape)
        over = np.zeros(shape)
        for node, parent in enumerate(horizon.parent):
            if parent >= 0:
                left[:, node] = left_next[:, parent]
            end = carried[:, node] * left[:, node] + refill[:, node] - hours[:, node] * used[:, node]
            if not decided:
                over[:, node] = np.maximum(-end, 0.0) / horizon.hours[node]
            left_next[:, node] = end if decided else np.maximum(end, 0.0)
        made = {"budget_used": used, "budget_left": left, "budget_left_next": left_next}
        return made if decided else {**made, "budget_over": over}


def _check(table: Table, horizon: Horizon) -> None:
    """Raise :class:`IncompatibleError` unless periods consist of steps, and no stage is longer than one."""
    longest = float(horizon.regular.hours.max())
    for name, (hours,) in zip(table.names, table.hours, strict=True):
        if abs(hours / horizon.base - round(hours / horizon.base)) > _SAME:
            raise IncompatibleError(
                f"{name}: hours = {hours:g}: must be a multiple of the step of {horizon.base:g} h",
                *_at(name, "hours"),
            )
        if hours < longest * (1.0 - _SAME):
            raise IncompatibleError(
                f"{name}: hours = {hours:g}: must be at least the longest stage, {longest:g} h",
                *_at(name, "hours"),
            )


def _at(budget: str, field: str) -> tuple[str, ...]:
    """Return the key of a field in a scenario file."""
    return "network", Budget.plural, budget, field


def _refill(table: Table) -> Array:
    """Return the amount in the stages that begin a period."""
    return np.asarray((1.0 - table.carried) * table.amount)


def _counted(horizon: Horizon) -> Callable[[Table], Array]:
    """Return the hours of each stage in the period in which it ends."""
    return lambda table: np.minimum(horizon.hours, table.hours - table.remaining)


def _before(horizon: Horizon) -> Callable[[Table], Array]:
    """Return the hours of each stage in an earlier period."""
    return lambda table: np.asarray(horizon.hours - _counted(horizon)(table))


def _least(limited: Callable[[Table], npt.NDArray[np.bool_]]) -> Callable[[Table], Array]:
    """Return a lower limit of zero where something holds, and none elsewhere."""
    return lambda table: np.where(limited(table), 0.0, -np.inf)


def _check_moves(model: Model, table: Table) -> None:
    """Raise :class:`IncompatibleError` unless the moves that use up a budget are counted."""
    for counted, owner, member, _ in _uses(table):
        units = model.network.tables[counted.kind]
        for budget, unit in zip(owner, member, strict=True) if counted.moves else ():
            if not np.isfinite(units.move_cost[unit, 0]):
                raise IncompatibleError(
                    f"{table.names[budget]}: uses.{units.names[unit]}: the moves of this {counted.kind} are "
                    "not counted; state its move_cost, 0 if moves cost nothing",
                    *_at(table.names[budget], "uses"),
                )


def _uses(table: Table) -> Iterator[tuple[Use, Index, Index, Array]]:
    """Yield what counts, the positions of budgets and components, and units per energy or per move."""
    for counted in COUNTED:
        kind = counted.kind
        owner, weight = table.arrays[f"uses_{kind}_owner"], table.arrays[f"uses_{kind}"]
        if owner.size:
            per = weight / table.base_mva if counted.moves else weight
            yield counted, owner, table.arrays[f"uses_{kind}_member"], per
