"""Dispatch, storage and demand."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.results.aggregates import injections
from opfmodel.results.report.page import Chart, Section, Trace, View, of
from opfmodel.results.report.sheet import COLOURS, Sheet, line, steps

__all__ = ["dispatch", "storage"]

Array = npt.NDArray[np.float64]

_MOST = 12  # units with an area of their own
_MOST_CHOSEN = 200  # storages that can be chosen
# Kind, quantity, sign of an injection, and what all of a kind are called.
_SOURCES = (
    ("generator", "pg", 1.0, "generators"),
    ("renewable", "renewable_p", 1.0, "renewables"),
    ("storage", "ps", -1.0, "storage"),
    ("flexible_load", "flexible_load_p", -1.0, "flexible demand"),
)


def dispatch(sheet: Sheet) -> Section | None:
    """Generation, import and storage as stacked areas, above zero what they supply, with the demand."""
    units: list[tuple[str, Array]] = []
    kinds: list[tuple[str, Array]] = []
    for kind, quantity, sign, title in _SOURCES:
        if sheet.has(quantity):
            values = sign * sheet.moments.values(quantity)
            units += zip(sheet.names(kind), values, strict=True)
            kinds.append((title, values.sum(axis=0)))
    for quantity in injections(sheet.data):
        kinds.append((quantity.removesuffix("_p").replace("_", " "), sheet.total(quantity)))
        units.append(kinds[-1])
    if not units:
        return None
    demand = steps(sheet, "demand", sheet.total("pd"), line={"dash": "dash", "width": 2}, meta="ink")
    lines = [demand]
    if sheet.has("load_shed"):
        served = sheet.total("pd") - sheet.total("load_shed")
        lines.append(steps(sheet, "served demand", served, line={"dash": "dot", "width": 2}, meta="ink"))
    layout = {**sheet.over_time("power [MW]"), "hovermode": "x unified"}
    views = [
        View("units", [*_stacked(sheet, _largest(units)), *lines]),
        View("kinds", [*_stacked(sheet, kinds), *lines]),
    ]
    chart = Chart("Supply (above zero), charging and export (below), and demand", views, layout, 400, "areas")
    return Section("Dispatch", [chart])


def _largest(units: list[tuple[str, Array]]) -> list[tuple[str, Array]]:
    """Return the units with the most energy, and the sum of the others as one."""
    if len(units) <= _MOST:
        return units
    energy = [float(np.abs(values).sum()) for _, values in units]
    kept = sorted(sorted(range(len(units)), key=lambda n: -energy[n])[: _MOST - 1])
    rest = [values for n, (_, values) in enumerate(units) if n not in kept]
    return [*(units[n] for n in kept), (f"{len(rest)} others", np.sum(rest, axis=0))]


def _stacked(sheet: Sheet, units: list[tuple[str, Array]]) -> list[Trace]:
    """Return areas, each in two parts if its values have both signs."""
    made = []
    for number, (name, values) in enumerate(units):
        colour = COLOURS[number % len(COLOURS)]
        parts = [("up", np.maximum(values, 0.0)), ("down", np.minimum(values, 0.0))]
        present = [(stack, part) for stack, part in parts if np.any(part)] or parts[:1]
        for place, (stack, part) in enumerate(present):
            style: dict[str, Any] = {"stackgroup": stack, "legendgroup": name, "showlegend": place == 0}
            made.append(
                steps(sheet, name, part, line={"width": 0.5, "color": colour}, fillcolor=colour, **style)
            )
    return made


def storage(sheet: Sheet) -> Section | None:
    """Stored energy with its capacity, and power."""
    if not sheet.has("e", "e_next"):
        return None
    names = sheet.names("storage")
    last = sheet.data["e_next"].values[-1:]
    stored = np.hstack([sheet.moments.values("e"), last.T])
    sheet.add("stored energy", stored)
    most = None
    if sheet.has("e_max"):
        limits = sheet.moments.values("e_max")
        most = np.hstack([limits, limits[:, -1:]])
    views = [_energy(sheet, "all", stored.sum(axis=0), None if most is None else most.sum(axis=0))]
    if 1 < len(names) <= _MOST_CHOSEN:
        views += [
            _energy(sheet, name, of("stored energy", row), None if most is None else most[row])
            for row, name in enumerate(names)
        ]
    layout = sheet.over_time("energy [MWh]", rangemode="tozero")
    parts = [Chart("Stored energy", views, layout, 300, "storage")]
    if sheet.has("ps"):
        power = sheet.add("charging power", sheet.moments.values("ps"))
        shown = [View("all", [_bars(sheet, power.sum(axis=0))])]
        if 1 < len(names) <= _MOST_CHOSEN:
            shown += [View(name, [_bars(sheet, of("charging power", row))]) for row, name in enumerate(names)]
        layout = sheet.over_time("power [MW], charging > 0")
        parts.append(Chart("Power of the storage", shown, layout, 260, "storage"))
    return Section("Storage", parts)


def _energy(sheet: Sheet, label: str, stored: Any, most: Array | None) -> View:
    x = sheet.moments.axis
    traces = [
        {"type": "scatter", "mode": "lines", "name": "stored energy", "x": x, "y": stored, "fill": "tozeroy",
         "line": {"color": COLOURS[2], "width": 2}}
    ]  # fmt: skip
    if most is not None and np.isfinite(most).all():
        limit = line(sheet, "capacity", most[:-1], line={"dash": "dot", "width": 1.5}, meta="ink")
        traces.append(limit)
    return View(label, traces)


def _bars(sheet: Sheet, values: Any) -> Trace:
    return steps(sheet, "charging power", values, fill="tozeroy", line={"color": COLOURS[4]})
