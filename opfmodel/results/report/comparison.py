"""The page of several runs side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from opfmodel.errors import ResultError
from opfmodel.results.aggregates import generation
from opfmodel.results.limits import loading
from opfmodel.results.report.moments import Moments
from opfmodel.results.report.page import Chart, Page, Section, Table, View
from opfmodel.results.report.sheet import COLOURS, Sheet, steps

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["comparison_page"]

Array = npt.NDArray[np.float64]

_FIGURES = (
    "status", "cost", "steps", "max_violation", "iterations_mean", "solve_seconds_mean", "solve_seconds_max",
    "stored_mwh", "redispatched_mwh", "shed_mwh", "curtailed_mwh", "violated_steps", "unsolved_steps",
    "elastic_steps",
)  # fmt: skip


def comparison_page(runs: Mapping[str, tuple[xr.Dataset, Mapping[str, Any]]]) -> Page:
    """Return the page of runs by name, each with its trajectories and its figures.

    Raises
    ------
    ResultError
        There are fewer than two runs, or some have time stamps and others have not.
    """
    if len(runs) < 2:
        raise ResultError("a comparison needs at least two runs")
    sheets = {name: Sheet(Moments.of(data), summary) for name, (data, summary) in runs.items()}
    if len({sheet.moments.dated for sheet in sheets.values()}) > 1:
        raise ResultError("some runs have time stamps, others hours: they cannot be shown on one axis")
    names = list(sheets)
    present = [key for key in _FIGURES if any(key in sheet.summary for sheet in sheets.values())]
    rows = [[key.replace("_", " "), *(sheets[name].summary.get(key) for name in names)] for key in present]
    costs = [sheet.summary.get("cost") for sheet in sheets.values()]
    if costs[0] and all(isinstance(cost, float) for cost in costs[1:]):
        relative = [f"{100 * (cost / costs[0] - 1):+.3f} %" for cost in costs if cost is not None]
        rows.append([f"cost, relative to {names[0]}", *relative])
    table = Table("Figures side by side", ["figure", *names], rows)
    first = next(iter(sheets.values()))
    charts = [
        Chart(title, [View(title, traces)], first.over_time(unit), 300)
        for title, unit, traces in _overlays(sheets)
    ]
    currency = str(first.summary.get("currency", "$"))
    about = f"{len(runs)} runs, costs in {currency}"
    return Page("Comparison", about, [Section("In short", [table]), Section("Over time", charts)])


def _overlays(sheets: Mapping[str, Sheet]) -> Sequence[tuple[str, str, list[dict[str, Any]]]]:
    """Titles, titles of the axis, and lines of what is compared over time."""
    made = []
    for title, unit, of in (
        ("Cost so far", "cost", _cost),
        ("Generation", "power [MW]", generation),
        (
            "Stored energy",
            "energy [MWh]",
            lambda data: data["e"].sum("storage").values if "e" in data else None,
        ),
        ("Mean price", "price", lambda data: data["lmp"].mean("bus").values if "lmp" in data else None),
        (
            "Lowest voltage",
            "voltage [p.u.]",
            lambda data: data["vm"].min("bus").values if "vm" in data else None,
        ),
        ("Largest loading", "loading [%]", _largest_loading),
        (
            "Iterations",
            "iterations",
            lambda data: data["iterations"].values if "iterations" in data else None,
        ),
    ):
        lines = []
        for number, (name, sheet) in enumerate(sheets.items()):
            values = of(sheet.data)
            if values is not None and np.isfinite(values).any():
                style = {"color": COLOURS[number % len(COLOURS)]}
                lines.append(steps(sheet, name, values[:: sheet.moments.stride], line=style))
        if lines:
            made.append((title, unit, lines))
    return made


def _cost(data: xr.Dataset) -> Array | None:
    if "cost_rate" not in data:
        return None
    return np.asarray(np.cumsum(data["cost_rate"].values) * float(data.attrs.get("step_hours", 1.0)))


def _largest_loading(data: xr.Dataset) -> Array | None:
    percent = loading(data)
    return None if percent is None else np.asarray(np.nanmax(percent, axis=1))
