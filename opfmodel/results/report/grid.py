"""Prices, voltages and branch loading, over time and on a diagram of the network."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.network.layout import MOST_BUSES, positions
from opfmodel.results import limits
from opfmodel.results.report.page import Chart, Diagram, Section, Table, Trace, View, of
from opfmodel.results.report.sheet import COLOURS, Sheet, steps

__all__ = ["loading", "network", "prices", "voltages"]

Array = npt.NDArray[np.float64]

_MOST_CHOSEN = 200  # buses or branches that can be chosen
_MOST_LISTED = 15


def prices(sheet: Sheet) -> Section | None:
    """Nodal prices, as a map over buses and time and for single buses."""
    parts = []
    for quantity, title in (("lmp", "Price of active power"), ("lmp_q", "Price of reactive power")):
        if not sheet.has(quantity):
            continue
        values = sheet.moments.values(quantity)
        sheet.add(quantity, values, np.ptp(np.nan_to_num(values), axis=1))
        unit = sheet.data[quantity].attrs["units"]
        names = sheet.names("bus")
        views = [_band(sheet, values, "all buses")]
        if len(names) > 1:
            heat = sheet.heat(quantity, names, unit, "bus")
            views = [heat, *views, *_each(sheet, quantity, names, COLOURS[0])]
        parts.append(Chart(title, views, sheet.over_time(f"price [{unit}]"), 380, "buses"))
    return Section("Prices", parts) if parts else None


def voltages(sheet: Sheet) -> Section | None:
    """Voltage magnitudes as a band with limits, as a map and for single buses."""
    if not sheet.has("vm"):
        return None
    values = sheet.moments.values("vm")
    sheet.add("vm", values, np.max(np.abs(values - 1.0), axis=1))
    names, limits = sheet.names("bus"), dict[str, Array]()
    for end in ("min", "max"):
        if sheet.has(f"vm_{end}"):
            limits[end] = sheet.moments.values(f"vm_{end}")
    band = _band(sheet, values, "all buses")
    widest = {end: (np.min if end == "min" else np.max)(bound, axis=0) for end, bound in limits.items()}
    views = [View("all buses", [*band.traces, *_limits(sheet, widest)])]
    if len(names) > 1:
        views.append(sheet.heat("vm", names, "p.u.", "bus"))
        views += _each(sheet, "vm", names, COLOURS[0], limits)
    layout = sheet.over_time("voltage [p.u.]")
    return Section("Voltages", [Chart("Voltage magnitudes and their limits", views, layout, 380, "buses")])


def loading(sheet: Sheet) -> Section | None:
    """Loading of the branches with ratings, and a table of the most loaded ones."""
    known = limits.loading(sheet.data)
    if known is None:
        return None
    percent = known.T
    names = sheet.names("branch")
    peak = np.nanmax(np.where(np.isnan(percent), -np.inf, percent), axis=1)
    shown = sheet.add("loading", percent[:, :: sheet.moments.stride], peak)
    rated = np.isfinite(peak)
    order = [int(row) for row in np.argsort(-peak, kind="stable") if rated[row]]
    top = [
        steps(sheet, names[row], sheet.row("loading", row), line={"color": COLOURS[n % len(COLOURS)]})
        for n, row in enumerate(order[:8])
    ]
    limit = steps(sheet, "rating", np.full(shown.shape[1], 100.0), line={"dash": "dot"}, meta="ink")
    views = [View("the most loaded", [*top, limit])]
    if len(order) > 1:
        views.insert(0, sheet.heat("loading", names, "%", "branch"))
    times = [int(np.nanargmax(percent[row])) for row in order[:_MOST_LISTED]]
    rating = np.broadcast_to(sheet.data["rating"].values, sheet.data["pf"].shape)
    rows = [
        [names[row], _end(sheet, "from", row), _end(sheet, "to", row), round(float(peak[row]), 3),
         sheet.moments.name(time), round(float(rating[time, row]), 3), int(np.sum(percent[row] >= 99.95))]
        for row, time in zip(order[:_MOST_LISTED], times, strict=True)
    ]  # fmt: skip
    columns = ["branch", "from", "to", "peak [%]", "when", "rating [MVA]", "stages at the limit"]
    layout = sheet.over_time("loading [%]", rangemode="tozero")
    return Section(
        "Branch loading",
        [
            Chart(
                "Apparent power of the branches in percent of their ratings", views, layout, 400, "branches"
            ),
            Table("The most loaded branches", columns, rows),
        ],
    )


def network(sheet: Sheet) -> Section | None:
    """The diagram of the network; None if it is too large to draw."""
    data = sheet.data
    names = sheet.names("bus")
    ends = [data.coords.get(f"branch_{end}_bus") for end in ("from", "to")]
    if any(end is None for end in ends) or len(names) < 2:
        return None
    stated = "bus_x" in data.coords and bool(np.isfinite(data["bus_x"].values).any())
    if len(names) > MOST_BUSES and not stated:
        return None
    at = {name: number for number, name in enumerate(names)}
    edges = [(at[str(one)], at[str(other)]) for one, other in zip(*(end.values for end in ends), strict=True)]
    placed = positions(_graph(data, names, edges))
    colours = dict(_colours(sheet))
    if not colours:
        return None
    diagram = Diagram(
        "The network: buses and branches by voltage, price and loading",
        names,
        [(round(x, 5), round(y, 5)) for x, y in (placed[name] for name in names)],
        sheet.names("branch"),
        edges,
        colours,
        sheet.moments.labels,
    )
    return Section("Network", [diagram])


def _graph(data: Any, names: list[str], edges: list[tuple[int, int]]) -> Any:
    import networkx as nx

    graph = nx.Graph()
    for number, name in enumerate(names):
        place = [
            float(data[f"bus_{axis}"].values[number]) if f"bus_{axis}" in data.coords else np.nan
            for axis in "xy"
        ]
        known = dict(zip("xy", place, strict=True)) if np.isfinite(place).all() else {}
        graph.add_node(name, **known)
    graph.add_edges_from((names[one], names[other]) for one, other in edges)
    return graph


def _colours(sheet: Sheet) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Quantities by which the network can be coloured, and their scales."""
    for label, array, kind, unit in (
        ("voltage", "vm", "bus", "p.u."),
        ("price", "lmp", "bus", ""),
        ("loading", "loading", "branch", "%"),
    ):
        if array not in sheet.arrays or array in sheet.kept:
            continue
        values = sheet.arrays[array]
        known = values[np.isfinite(values)]
        if not known.size:
            continue
        low, high = float(known.min()), float(known.max())
        if kind == "branch":
            low, high = 0.0, max(100.0, high)
        own = unit or sheet.data[array].attrs["units"]
        yield label, {"kind": kind, "array": array, "unit": own, "low": low, "high": high}


def _band(sheet: Sheet, values: Array, label: str) -> View:
    """Return the range, the middle and the mean of a quantity over the buses."""
    if values.shape[0] == 1:
        return View(label, [steps(sheet, sheet.names("bus")[0], values[0], line={"color": COLOURS[0]})])
    low, lower, upper, high = np.nanquantile(values, [0.0, 0.05, 0.95, 1.0], axis=0)
    edge: dict[str, Any] = {"width": 0, "color": COLOURS[0]}
    return View(
        label,
        [
            steps(sheet, "minimum", low, line=edge, showlegend=False),
            steps(sheet, "all buses", high, line=edge, fill="tonexty", fillcolor="rgba(0,114,178,0.18)"),
            steps(sheet, "5 %", lower, line=edge, showlegend=False),
            steps(sheet, "9 of 10 buses", upper, line=edge, fill="tonexty", fillcolor="rgba(0,114,178,0.35)"),
            steps(sheet, "mean", np.nanmean(values, axis=0), line={"color": COLOURS[0], "width": 2}),
        ],
    )


def _each(
    sheet: Sheet, array: str, names: list[str], colour: str, limits: Mapping[str, Array] | None = None
) -> list[View]:
    """Return a view for each bus, unless there are too many."""
    if len(names) > _MOST_CHOSEN:
        return []
    return [
        View(
            f"bus {name}",
            [
                steps(sheet, name, of(array, row), line={"color": colour}),
                *_limits(sheet, {end: bound[row] for end, bound in (limits or {}).items()}),
            ],
        )
        for row, name in enumerate(names)
    ]


def _limits(sheet: Sheet, limits: Mapping[str, Array]) -> list[Trace]:
    words = {"min": "lower limit", "max": "upper limit"}
    return [
        steps(sheet, words[end], bound, line={"dash": "dot", "width": 1.5}, meta="ink")
        for end, bound in limits.items()
        if np.isfinite(bound).all()
    ]


def _end(sheet: Sheet, end: str, row: int) -> str:
    ends = sheet.data.coords.get(f"branch_{end}_bus")
    return "" if ends is None else str(ends.values[row])
