"""What all figures share: panels, lines of stages and scenarios, the axis of time, legends."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from opfmodel.data.calendar import zone_of

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

__all__ = [
    "COLOURS",
    "WIDTH",
    "add_legend",
    "add_title",
    "colour_of",
    "column",
    "draw_key",
    "draw_line",
    "draw_steps",
    "ends",
    "fan",
    "finish",
    "label_time",
    "mark_outages",
    "prepare",
]

# Okabe-Ito palette; distinct line styles keep figures readable in greyscale.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
WIDTH = 7.2  # inches: the text width of a page
_CHARACTERS = 118  # in a row of a legend


def column(rows: int) -> tuple[Figure, list[Any]]:
    """Return a figure with panels below each other."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, 1.0 + 1.55 * rows), layout="constrained")
    axes = list(np.atleast_1d(figure.subplots(rows, 1, sharex=True)))
    for axis in axes:
        prepare(axis)
    return figure, axes


def prepare(axis: Any) -> None:
    """Give a panel its grid and margins."""
    axis.grid(alpha=0.3, linewidth=0.5)
    axis.margins(x=0.01)


def colour_of(names: Sequence[str]) -> dict[str, Any]:
    """Return a colour for each name, all different."""
    if len(names) <= len(COLOURS):
        return dict(zip(names, COLOURS, strict=False))
    scale = import_module("matplotlib").colormaps["turbo"]
    return {name: scale(place) for name, place in zip(names, np.linspace(0, 1, len(names)), strict=True)}


def draw_steps(axis: Any, data: xr.Dataset, values: Any, **style: Any) -> None:
    """Plot a quantity that is constant during each stage."""
    for path, line in fan(data, {"linewidth": 1.2, **style}):
        own = values[path]
        axis.step(ends(data, path), np.append(own, own[-1]), where="post", **line)


def draw_line(axis: Any, data: xr.Dataset, start: Any, end: Any, **style: Any) -> None:
    """Plot a state at the start of each stage and at the end of the last."""
    for path, line in fan(data, style):
        values = np.append(start[path], end[path[-1]])
        axis.plot(ends(data, path), values, linewidth=1.2, marker=".", markersize=3, **line)


def draw_key(axis: Any) -> None:
    """Explain the line styles of active and reactive power in the legend."""
    for style, label in (("-", "active"), ("--", "reactive")):
        axis.plot([], [], color="0.4", linewidth=1.2, linestyle=style, label=label)


def fan(data: xr.Dataset, style: dict[str, Any]) -> list[tuple[Any, dict[str, Any]]]:
    """Positions of the stages of each scenario, and the style of its line; the label is given once."""
    if "node" not in data.dims:
        return [(np.arange(data.sizes["time"]), style)]
    parent, probability = data["parent"].values, data["probability"].values
    lines: list[tuple[Any, dict[str, Any]]] = []
    for leaf in sorted(set(range(parent.size)) - set(parent.tolist())):
        path = [leaf]
        while parent[path[0]] >= 0:
            path.insert(0, int(parent[path[0]]))
        label = {} if lines else {"label": style.get("label")}
        lines.append((np.array(path), {**style, "label": None, **label, "alpha": probability[leaf]}))
    most = max(shown["alpha"] for _, shown in lines)
    return [(path, {**shown, "alpha": 0.3 + 0.7 * shown["alpha"] / most}) for path, shown in lines]


def ends(data: xr.Dataset, path: Any) -> Any:
    """Start of each stage of a path and end of the last: hours, or times in UTC."""
    times = data["time"].values[path]
    step: Any = float(data.attrs.get("step_hours", 1.0))
    if "hours" in data.coords:
        step = float(data["hours"].values[path[-1]])
    if _dated(data):
        step = np.timedelta64(round(3_600_000_000_000 * step), "ns")
    return np.append(times, times[-1] + step)


def _dated(data: xr.Dataset) -> bool:
    """Whether the stages have time stamps."""
    return bool(np.issubdtype(data["time"].dtype, np.datetime64))


def finish(figure: Figure, data: xr.Dataset) -> None:
    """Add the legend and the marks of outages, and label the axis of time of panels below each other."""
    label_time(figure.axes[-1], data)
    mark_outages(figure.axes, data)
    known: dict[str, Any] = {}
    for axis in figure.axes:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            known.setdefault(label, handle)
    if known:
        add_legend(figure, list(known.values()), list(known), _columns(list(known)))


def _columns(labels: Sequence[str]) -> int:
    """Return how many columns of a legend fit into the width of a figure."""
    for columns in range(min(len(labels), 7), 1, -1):
        widest = [max(map(len, own)) for own in np.array_split(np.array(labels, dtype=object), columns)]
        if sum(widest) + 9 * columns <= _CHARACTERS:  # a line and the space beside it take nine
            return columns
    return 1


def label_time(axis: Any, data: xr.Dataset, *, narrow: bool = False) -> None:
    """Label an axis of time: hours, or dates in the zone of the data, of which a narrow axis has fewer."""
    if not _dated(data):
        axis.set_xlabel("time [h]")
        return
    dates: Any = import_module("matplotlib.dates")
    name = str(data["time"].attrs.get("zone", "UTC"))
    zone = zone_of(name)
    fewer = {"minticks": 3, "maxticks": 6} if narrow else {}
    locator = dates.AutoDateLocator(tz=zone, **fewer)
    axis.xaxis.set_major_locator(locator)
    axis.xaxis.set_major_formatter(dates.ConciseDateFormatter(locator, tz=zone))
    axis.set_xlabel(f"time [{name}]")


def mark_outages(axes: Sequence[Any], data: xr.Dataset) -> None:
    """Shade the steps in which a component is out of service, and name it in the first panel."""
    times = ends(data, np.arange(data.sizes["time"])) if "time" in data.dims else []
    for quantity in (str(name) for name in data if str(name).endswith("_status")):
        kind = quantity.removesuffix("_status")
        if data[quantity].dims != ("time", kind):
            continue
        for name in data[kind].values:
            out = np.append(data[quantity].sel({kind: name}).values == 0, False)
            edges = np.flatnonzero(np.diff(out.astype(int), prepend=0))
            for first, last in zip(edges[::2], edges[1::2], strict=True):
                for axis in axes:
                    axis.axvspan(times[first], times[last], color="0.5", alpha=0.15, linewidth=0)
                at = axes[0].get_xaxis_transform()
                axes[0].text(
                    times[first], 1.0, f" {name} out", transform=at, va="top", fontsize="small", color="0.3"
                )


def add_legend(
    figure: Figure, handles: Sequence[Any], labels: Sequence[str], columns: int, **style: Any
) -> None:
    """Add a legend above all panels."""
    figure.legend(
        handles,
        labels,
        loc="outside upper center",
        ncols=columns,
        fontsize=8,
        frameon=False,
        **style,
    )


def add_title(figure: Figure, text: str) -> None:
    """Add a title: over the first panel or, if panels are beside each other, over the legend."""
    grid = figure.axes[0].get_gridspec()
    if grid is None or grid.ncols == 1:
        figure.axes[0].set_title(text)
    for legend in figure.legends if grid is not None and grid.ncols > 1 else ():
        legend.set_title(text)
        legend.get_title().set_fontsize("large")
