"""Costs of a pandapower network."""

from __future__ import annotations

import ast
import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

from opfmodel.errors import CaseError, listed, shown
from opfmodel.network.cases.pandapower.source import Row, Source
from opfmodel.network.cases.warn import warn
from opfmodel.network.costs import Cost, PiecewiseLinear, Polynomial

__all__ = ["Costs"]

_REACTIVE = ("cq0_eur", "cq1_eur_per_mvar", "cq2_eur_per_mvar2")
_REDISPATCH = ("redispatch_up_eur_per_mw", "redispatch_down_eur_per_mw")


class Costs:
    """Costs of the elements that an optimal power flow decides, in $/h of the power that they inject.

    Parameters
    ----------
    default
        Cost of units without cost data; None for none, with a warning.
    """

    def __init__(self, source: Source, default: Cost | None) -> None:
        self.source = source
        self.default = default
        self._rows: dict[tuple[str, int], tuple[str, Row]] = {}
        self._without: list[str] = []
        for table in ("poly_cost", "pwl_cost"):
            for row in source.rows(table):
                self._collect(table, row)

    def of(self, table: str, item: Row) -> Cost:
        """Cost of a unit."""
        found = self._rows.get((table, item.index))
        if found is None:
            if self.default is None and item.in_service:
                self._without.append(item.name)
            return self.default or Polynomial()
        return self._cost(item, *found)

    def of_demand(self, table: str, item: Row) -> Cost:
        """Cost of a controllable load, whose tables state a cost of the power that it draws."""
        found = self._rows.get((table, item.index))
        if found is None:
            return Polynomial()
        cost = self._cost(item, *found)
        if isinstance(cost, PiecewiseLinear):
            return PiecewiseLinear(tuple((-p, c) for p, c in reversed(cost.points)))
        return Polynomial(cost.c2, -cost.c1, cost.c0)

    def of_dc_line(self, item: Row, forward: bool) -> float:
        """Cost of the power that a DC line draws, $/MWh; what has another form is lost."""
        found = self._rows.get(("dcline", item.index))
        cost = Polynomial() if found is None else self._cost(item, *found)
        if cost == Polynomial():
            return 0.0
        if forward and isinstance(cost, Polynomial) and cost.c1 >= 0 and not (cost.c2 or cost.c0):
            return cost.c1
        self.source.losses.add(
            f"dcline {item.name!r}: its cost is left out; only cp1_eur_per_mw of a line that flows forward "
            "is represented, at least 0"
        )
        return 0.0

    def given(self, table: str, item: Row) -> bool:
        """Whether an element has a cost other than zero."""
        found = self._rows.get((table, item.index))
        return found is not None and self._cost(item, *found) != Polynomial()

    def warn(self) -> None:
        """Warn about units without cost data."""
        if not self._without:
            return
        what = f"no cost data for {listed(map(repr, self._without))}" if self._rows else "no cost data"
        warn(
            f"{self.source.where}: {what}; these units cost nothing unless a default cost is given "
            "(default_cost=Polynomial(0, 30, 0) in Python, --default-cost 30 on the command line, "
            "network.default_cost in a scenario)"
        )

    def _collect(self, table: str, row: Row) -> None:
        et, element = row.text("et"), int(row.given("element"))
        label = f"{self.source.where}: {table} {row.index}: cost of {et} {self.source.name(et, element)!r}"
        reactive = table == "pwl_cost" and row.text("power_type") == "q"
        if reactive or any(row.number(key, 0.0) for key in _REACTIVE):
            self.source.losses.add(f"{table} {row.index}: a cost of reactive power; it is left out")
        if reactive:
            return
        if any(row.number(key, 0.0) for key in _REDISPATCH):
            self.source.losses.add(f"{table} {row.index}: a cost of redispatch; it is left out")
        if (et, element) in self._rows:
            raise CaseError(f"{label}: given twice; an element has one cost")
        self._rows[et, element] = (table, row)

    def _cost(self, item: Row, table: str, row: Row) -> Polynomial | PiecewiseLinear:
        if table == "poly_cost":
            return Polynomial(
                row.number("cp2_eur_per_mw2", 0.0),
                row.number("cp1_eur_per_mw", 0.0),
                row.number("cp0_eur", 0.0),
            )
        return _piecewise(item, list(_areas(item, row)))


def _areas(item: Row, row: Row) -> Iterator[tuple[float, float, float]]:
    """Ranges of power and their slopes."""
    value: Any = row.values.get("points")
    try:
        areas = ast.literal_eval(value) if isinstance(value, str) else value
        for low, high, slope in areas:
            yield float(low), float(high), float(slope)
    except (SyntaxError, TypeError, ValueError):
        raise CaseError(
            f"{item.label}: points = {shown(value)}: must be a list of [from MW, to MW, $/MWh]"
        ) from None


def _piecewise(item: Row, areas: Sequence[tuple[float, float, float]]) -> Polynomial | PiecewiseLinear:
    """Piecewise-linear cost, whose first range passes through zero as in pandapower."""
    if not areas:
        raise CaseError(f"{item.label}: points = []: must have at least one range")
    for (_, high, _), (low, _, _) in pairwise(areas):
        if high != low:
            raise CaseError(f"{item.label}: points: a range begins at {low:g} MW, where none ends")
    if len(areas) == 1:
        return Polynomial(0.0, areas[0][2], 0.0)
    start = areas[0][0] if math.isfinite(areas[0][0]) else areas[0][1] - 1.0
    points = [(start, start * areas[0][2])]
    for _, high, slope in areas:
        p, cost = points[-1]
        end = high if math.isfinite(high) else p + 1.0
        points.append((end, cost + (end - p) * slope))
    return PiecewiseLinear(tuple(points))
