"""Figures of a run or a plan, for the entire system and for individual buses.

The scenarios of a plan appear as a fan: one line for each, the fainter the less probable.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from opfmodel.data.calendar import zone_of
from opfmodel.data.writing import replace
from opfmodel.errors import ResultError, nearest, shown

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

__all__ = ["FIGURES", "buses", "demand", "figure_paths", "save_figures", "system"]

# Okabe-Ito palette; distinct line styles keep figures readable in greyscale.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
_WIDTH = 7.2  # inches: the text width of a page
_MOST_LINES = 7
_FORMATS: dict[str, dict[str, Any]] = {"pdf": {}, "png": {"dpi": 200, "pil_kwargs": {"compress_level": 9}}}


def system(data: xr.Dataset, names: Sequence[str] | None = None) -> Figure:  # noqa: ARG001 - same signature
    """Plot system totals: demand and generation, storage power, branch losses, stored energy and cost."""
    stored = "e_next" in data
    figure, axes = _figure(2 + stored + ("cost_rate" in data))
    panels = iter(axes)
    generation, drawn, charging = (_total(data, name) for name in ("pg", "pd", "ps"))
    power, rest = next(panels), next(panels)
    _steps(power, data, drawn, label="demand", color=_COLOURS[6], linestyle="-.")
    _steps(power, data, generation, label="generation", color=_COLOURS[0])
    power.set_ylabel("power [MW]")
    if stored:
        _steps(rest, data, charging, label="storage (charging > 0)", color=_COLOURS[1], linestyle="--")
    if {"pf", "pt"} <= set(data):
        losses = _total(data, "pf") + _total(data, "pt")
        _steps(rest, data, losses, label="branch losses", color=_COLOURS[4])
    for number, name in enumerate(_injections(data)):
        label = name.removesuffix("_p")
        _steps(
            rest, data, _total(data, name), label=f"{label} (injection > 0)", color=_COLOURS[5 - number % 2]
        )
    rest.set_ylabel("power [MW]")
    if stored:
        axis = next(panels)
        _line(axis, data, _total(data, "e"), _total(data, "e_next"), label="stored energy", color=_COLOURS[2])
        axis.set_ylabel("energy [MWh]")
    if "cost_rate" in data:
        axis = next(panels)
        _steps(axis, data, data["cost_rate"].values, label="cost", color=_COLOURS[3])
        axis.set_ylabel(f"cost [{data['cost_rate'].attrs['units']}]")
    _finish(figure, data)
    return figure


def demand(data: xr.Dataset, names: Sequence[str] | None = None) -> Figure:
    """Plot active (solid) and reactive (dashed) demand of some buses, and the total active demand."""
    figure, axes = _figure(2)
    for number, bus in enumerate(_buses(data, names)):
        colour = _COLOURS[number % len(_COLOURS)]
        _steps(axes[0], data, data["pd"].sel(bus=bus).values, label=f"bus {bus}", color=colour)
        _steps(axes[0], data, data["qd"].sel(bus=bus).values, color=colour, linestyle="--")
    _key(axes[0])
    axes[0].set_ylabel("demand [MW], [MVAr]")
    _steps(axes[1], data, _total(data, "pd"), label="all buses", color=_COLOURS[6], linestyle="-.")
    axes[1].set_ylabel("total demand [MW]")
    _finish(figure, data)
    return figure


def buses(data: xr.Dataset, names: Sequence[str] | None = None) -> Figure:
    """Plot generation, storage power, voltage, angle and stored energy at some buses.

    Reactive power is dashed; all other quantities are solid.
    """
    colours = {bus: _COLOURS[n % len(_COLOURS)] for n, bus in enumerate(_buses(data, names))}
    panels = [
        ("generator", ("pg", "qg"), "generation\n[MW], [MVAr]"),
        ("storage", ("ps", "qs"), "storage power\n[MW], [MVAr]"),
        ("bus", ("vm",), "voltage [p.u.]"),
        ("bus", ("va",), "angle [deg]"),
        ("storage", ("e", "e_next"), "energy [MWh]"),
    ]
    panels = [panel for panel in panels if panel[1][0] in data]
    figure, axes = _figure(len(panels))
    for axis, (kind, quantities, label) in zip(axes, panels, strict=True):
        for bus, colour in colours.items():
            values = [_at_bus(data, quantity, kind, bus) for quantity in quantities]
            if values[0] is None:
                continue
            if quantities[0] == "e":
                _line(axis, data, *values, label=f"bus {bus}", color=colour)
                continue
            _steps(axis, data, values[0], label=f"bus {bus}", color=colour)
            for reactive in values[1:]:
                if reactive is not None:
                    _steps(axis, data, reactive, color=colour, linestyle="--")
        axis.set_ylabel(label)
    if {"qg", "qs"} & set(data):
        _key(axes[0])
    _finish(figure, data)
    return figure


FIGURES = {"system": system, "demand": demand, "buses": buses}


def save_figures(
    data: xr.Dataset,
    folder: Path,
    names: Sequence[str] | None = None,
    figures: Iterable[str] = tuple(FIGURES),
) -> list[Path]:
    """Draw figures and write each as PDF and PNG, replacing files atomically.

    Parameters
    ----------
    names
        Buses to show; by default a few with the highest demand or generation.

    Raises
    ------
    ResultError
        A bus is unknown, or the folder cannot be written.
    """
    written: dict[Path, bytes] = {}
    for name in figures:
        figure = FIGURES[name](data, names)
        shown = data.attrs.get("scenario", data.attrs.get("network", ""))
        figure.axes[0].set_title(f"{shown}: {name}")
        for path in figure_paths(folder, [name]):
            written[path] = _drawn(figure, path.suffix.removeprefix("."))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        replace(written)
    except OSError as error:
        raise ResultError(f"{folder}: figures cannot be written: {error.strerror or error}") from error
    return list(written)


def figure_paths(folder: Path, figures: Iterable[str] = tuple(FIGURES)) -> list[Path]:
    """Return the files of figures in a folder, whether they exist or not."""
    return [folder / f"{name}.{suffix}" for name in figures for suffix in _FORMATS]


def _drawn(figure: Figure, suffix: str) -> bytes:
    """Return the file of a figure, drawn in memory: matplotlib fails with obscure errors on a full disk."""
    stream = io.BytesIO()
    figure.savefig(stream, format=suffix, **_FORMATS[suffix])
    return stream.getvalue()


def _figure(rows: int) -> tuple[Figure, list[Any]]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDTH, 1.0 + 1.55 * rows), layout="constrained")
    axes = list(np.atleast_1d(figure.subplots(rows, 1, sharex=True)))
    for axis in axes:
        axis.grid(alpha=0.3, linewidth=0.5)
        axis.margins(x=0.01)
    return figure, axes


def _step_hours(data: xr.Dataset) -> float:
    return float(data.attrs.get("step_hours", 1.0))


def _steps(axis: Any, data: xr.Dataset, values: Any, **style: Any) -> None:
    """Plot a quantity that is constant during each stage."""
    for path, line in _fan(data, style):
        own = values[path]
        axis.step(_ends(data, path), np.append(own, own[-1]), where="post", linewidth=1.2, **line)


def _line(axis: Any, data: xr.Dataset, starts: Any, ends: Any, **style: Any) -> None:
    """Plot a state at the start of each stage and at the end of the last."""
    for path, line in _fan(data, style):
        values = np.append(starts[path], ends[path[-1]])
        axis.plot(_ends(data, path), values, linewidth=1.2, marker=".", markersize=3, **line)


def _fan(data: xr.Dataset, style: dict[str, Any]) -> list[tuple[Any, dict[str, Any]]]:
    """Positions of the stages of each scenario, and the style of its line; the label is given once."""
    if "node" not in data.dims:
        return [(np.arange(data.sizes["time"]), style)]
    parent, probability = data["parent"].values, data["probability"].values
    fan: list[tuple[Any, dict[str, Any]]] = []
    for leaf in sorted(set(range(parent.size)) - set(parent.tolist())):
        path = [leaf]
        while parent[path[0]] >= 0:
            path.insert(0, int(parent[path[0]]))
        label = {} if fan else {"label": style.get("label")}
        fan.append((np.array(path), {**style, "label": None, **label, "alpha": probability[leaf]}))
    most = max(shown["alpha"] for _, shown in fan)
    return [(path, {**shown, "alpha": 0.3 + 0.7 * shown["alpha"] / most}) for path, shown in fan]


def _key(axis: Any) -> None:
    """Explain the line styles of active and reactive power in the legend."""
    for style, label in (("-", "active"), ("--", "reactive")):
        axis.plot([], [], color="0.4", linewidth=1.2, linestyle=style, label=label)


def _ends(data: xr.Dataset, path: Any) -> Any:
    """Start of each stage of a path and end of the last: hours, or times in UTC."""
    times = data["time"].values[path]
    step: Any = float(data["hours"].values[path[-1]]) if "hours" in data.coords else _step_hours(data)
    if _dated(data):
        step = np.timedelta64(round(3_600_000_000_000 * step), "ns")
    return np.append(times, times[-1] + step)


def _dated(data: xr.Dataset) -> bool:
    """Whether the stages have time stamps."""
    return bool(np.issubdtype(data["time"].dtype, np.datetime64))


def _finish(figure: Figure, data: xr.Dataset) -> None:
    """Add the legend, and label the axis of time: hours, or dates in the zone of the data."""
    last = figure.axes[-1]
    if _dated(data):
        dates: Any = import_module("matplotlib.dates")
        name = str(data["time"].attrs.get("zone", "UTC"))
        zone = zone_of(name)
        locator = dates.AutoDateLocator(tz=zone)
        last.xaxis.set_major_locator(locator)
        last.xaxis.set_major_formatter(dates.ConciseDateFormatter(locator, tz=zone))
        last.set_xlabel(f"time [{name}]")
    else:
        last.set_xlabel("time [h]")
    _mark_outages(figure, data)
    _legend(figure)


def _mark_outages(figure: Figure, data: xr.Dataset) -> None:
    """Shade the steps in which a component is out of service, and name it."""
    ends = _ends(data, np.arange(data.sizes["time"])) if "time" in data.dims else []
    for quantity in (str(name) for name in data if str(name).endswith("_status")):
        kind = quantity.removesuffix("_status")
        if data[quantity].dims != ("time", kind):
            continue
        for name in data[kind].values:
            out = np.append(data[quantity].sel({kind: name}).values == 0, False)
            edges = np.flatnonzero(np.diff(out.astype(int), prepend=0))
            for first, last in zip(edges[::2], edges[1::2], strict=True):
                for axis in figure.axes:
                    axis.axvspan(ends[first], ends[last], color="0.5", alpha=0.15, linewidth=0)
                at = figure.axes[0].get_xaxis_transform()
                figure.axes[0].text(
                    ends[first], 1.0, f" {name} out", transform=at, va="top", fontsize="small", color="0.3"
                )


def _total(data: xr.Dataset, quantity: str) -> Any:
    if quantity not in data:
        return np.zeros(data.sizes[_stages(data)])
    array = data[quantity]
    return array.sum([d for d in array.dims if d != _stages(data)]).values


def _stages(data: xr.Dataset) -> str:
    """Dimension of the stages: nodes of a tree, or time."""
    return "node" if "node" in data.dims else "time"


def _injections(data: xr.Dataset) -> list[str]:
    """Names of the injections of devices from other packages: ``<kind>_p``."""
    return [str(n) for n in data if str(n).endswith("_p") and data[n].dims == (_stages(data), "bus")]


def _at_bus(data: xr.Dataset, quantity: str, kind: str, bus: str) -> Any:
    """Sum of a quantity over the components at a bus; None without components."""
    if quantity not in data:
        return None
    if kind == "bus":
        return data[quantity].sel(bus=bus).values
    members = [c for c, b in zip(data[kind].values, data[f"{kind}_bus"].values, strict=True) if b == bus]
    return data[quantity].sel({kind: members}).sum(kind).values if members else None


def _buses(data: xr.Dataset, names: Sequence[str] | None) -> list[str]:
    known = [str(b) for b in data["bus"].values]
    if names is not None:
        for name in names:
            if name not in known:
                raise ResultError(f"no bus is named {shown(name)}; {nearest(name, known)}")
        return list(names)
    if len(known) <= _MOST_LINES:
        return known
    weight = dict.fromkeys(known, 0.0)
    for bus in known:
        weight[bus] = float(np.abs(data["pd"].sel(bus=bus)).max())
        generated = _at_bus(data, "pg", "generator", bus)
        if generated is not None:
            weight[bus] = max(weight[bus], float(np.abs(generated).max()))
    return sorted(sorted(known, key=lambda b: -weight[b])[:4], key=known.index)


def _legend(figure: Figure) -> None:
    """Add a single legend above all panels, with each label once."""
    known: dict[str, Any] = {}
    for axis in figure.axes:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            known.setdefault(label, handle)
    if known:
        columns = min(len(known), _MOST_LINES)
        figure.legend(
            list(known.values()),
            list(known),
            loc="outside upper center",
            ncols=columns,
            fontsize=8,
            frameon=False,
        )
