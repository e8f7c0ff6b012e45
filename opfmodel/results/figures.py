"""Figures of a run or a plan, for the entire system and for individual buses.

The scenarios of a plan appear as a fan: one line for each, the fainter the less probable.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from opfmodel.data.writing import replace
from opfmodel.errors import ResultError
from opfmodel.results.aggregates import at_bus, chosen, generation, injections, total
from opfmodel.results.drawing import (
    COLOURS,
    add_title,
    colour_of,
    column,
    draw_key,
    draw_line,
    draw_steps,
    finish,
)
from opfmodel.results.paper import paper

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

__all__ = ["FIGURES", "buses", "demand", "figure_paths", "paper", "save_figures", "system", "write_figures"]

_DEFAULT = ("system", "demand", "buses")
# what demand is made of besides that of loads which are served
_PARTS = (("load_shed", "shed demand", ":"), ("flexible_load_p", "flexible demand", "--"))
_FORMATS: dict[str, dict[str, Any]] = {"pdf": {}, "png": {"dpi": 200, "pil_kwargs": {"compress_level": 9}}}


def system(data: xr.Dataset, names: Sequence[str] | None = None) -> Figure:  # noqa: ARG001 - same signature
    """Plot system totals: demand and generation, storage power, losses, stored energy and cost."""
    stored = "e_next" in data
    figure, axes = column(2 + stored + ("cost_rate" in data))
    panels = iter(axes)
    drawn, charging = (total(data, name) for name in ("pd", "ps"))
    power, rest = next(panels), next(panels)
    draw_steps(power, data, drawn, label="demand", color=COLOURS[6], linestyle="-.")
    draw_steps(power, data, generation(data), label="generation", color=COLOURS[0])
    if _has(data, "renewable_p"):
        renewable = total(data, "renewable_p")
        draw_steps(power, data, renewable, label="of which renewable", color=COLOURS[2], linestyle=":")
    for quantity, label, style in _PARTS:
        if _has(data, quantity):
            draw_steps(power, data, total(data, quantity), label=label, color=COLOURS[5], linestyle=style)
    power.set_ylabel("power [MW]")
    if stored:
        draw_steps(rest, data, charging, label="storage (charging > 0)", color=COLOURS[1], linestyle="--")
    if {"pf", "pt"} <= set(data):
        losses = total(data, "pf") + total(data, "pt")
        draw_steps(rest, data, losses, label="branch losses", color=COLOURS[4])
    if _has(data, "dc_line_loss"):
        draw_steps(
            rest, data, total(data, "dc_line_loss"), label="DC line losses", color=COLOURS[3], linestyle=":"
        )
    for number, name in enumerate(injections(data)):
        label, colour = name.removesuffix("_p"), COLOURS[5 if number % 2 == 0 else 0]
        draw_steps(rest, data, total(data, name), label=f"{label} (injection > 0)", color=colour)
    rest.set_ylabel("power [MW]")
    if stored:
        axis = next(panels)
        draw_line(
            axis, data, total(data, "e"), total(data, "e_next"), label="stored energy", color=COLOURS[2]
        )
        axis.set_ylabel("energy [MWh]")
    if "cost_rate" in data:
        axis = next(panels)
        draw_steps(axis, data, data["cost_rate"].values, label="cost", color=COLOURS[3])
        axis.set_ylabel(f"cost [{data['cost_rate'].attrs['units']}]")
    finish(figure, data)
    return figure


def demand(data: xr.Dataset, names: Sequence[str] | None = None) -> Figure:
    """Plot active (solid) and reactive (dashed) demand of some buses, and the total active demand.

    Demand is what is served and what is shed; flexible demand comes on top of it.
    """
    figure, axes = column(2)
    for bus, colour in colour_of(chosen(data, names)).items():
        draw_steps(axes[0], data, data["pd"].sel(bus=bus).values, label=f"bus {bus}", color=colour)
        draw_steps(axes[0], data, data["qd"].sel(bus=bus).values, color=colour, linestyle="--")
    draw_key(axes[0])
    axes[0].set_ylabel("demand [MW], [MVAr]")
    draw_steps(axes[1], data, total(data, "pd"), label="all buses", color=COLOURS[6], linestyle="-.")
    for quantity, label, style in _PARTS:
        if _has(data, quantity):
            draw_steps(axes[1], data, total(data, quantity), label=label, color=COLOURS[5], linestyle=style)
    axes[1].set_ylabel("total demand [MW]")
    finish(figure, data)
    return figure


def buses(data: xr.Dataset, names: Sequence[str] | None = None) -> Figure:
    """Plot generation, imports, storages, flexible demand, voltage, angle and stored energy at some buses.

    Reactive power is dashed; all other quantities are solid.
    """
    colours = colour_of(chosen(data, names))
    panels = [
        ("generator", ("pg", "qg"), "generation\n[MW], [MVAr]"),
        ("renewable", ("renewable_p", "renewable_q"), "renewables\n[MW], [MVAr]"),
        ("connection", ("connection_p", "connection_q"), "import\n[MW], [MVAr]"),
        ("storage", ("ps", "qs"), "storage power\n[MW], [MVAr]"),
        ("flexible_load", ("flexible_load_p", "flexible_load_q"), "flexible demand\n[MW], [MVAr]"),
        ("bus", ("vm",), "voltage [p.u.]"),
        ("bus", ("va",), "angle [deg]"),
        ("storage", ("e", "e_next"), "energy [MWh]"),
    ]
    panels = [panel for panel in panels if panel[1][0] in data]
    figure, axes = column(len(panels))
    for axis, (kind, quantities, label) in zip(axes, panels, strict=True):
        for bus, colour in colours.items():
            values = [at_bus(data, quantity, kind, bus) for quantity in quantities]
            if values[0] is None:
                continue
            if quantities[0] == "e":
                draw_line(axis, data, *values, label=f"bus {bus}", color=colour)
                continue
            draw_steps(axis, data, values[0], label=f"bus {bus}", color=colour)
            for reactive in values[1:]:
                if reactive is not None:
                    draw_steps(axis, data, reactive, color=colour, linestyle="--")
        axis.set_ylabel(label)
    if {"qg", "qs"} & set(data):
        draw_key(axes[0])
    finish(figure, data)
    return figure


def _has(data: xr.Dataset, quantity: str) -> bool:
    """Whether results have a quantity of at least one component."""
    return quantity in data and data[quantity].size > 0


FIGURES = {"system": system, "demand": demand, "buses": buses, "paper": paper}


def save_figures(
    data: xr.Dataset,
    folder: Path,
    names: Sequence[str] | None = None,
    figures: Iterable[str] = _DEFAULT,
) -> list[Path]:
    """Draw figures and write each as PDF and PNG, replacing files atomically.

    Parameters
    ----------
    names
        Buses to show; by default all of a small network, or a few with the highest demand or generation.
    figures
        Names in :data:`FIGURES`.

    Raises
    ------
    ResultError
        A bus is unknown, or the folder cannot be written.
    """
    shown = data.attrs.get("scenario", data.attrs.get("network", ""))
    drawn = {name: FIGURES[name](data, names) for name in figures}
    for name, figure in drawn.items():
        add_title(figure, f"{shown}: {name}")
    return write_figures(drawn, folder)


def write_figures(figures: Mapping[str, Figure], folder: Path) -> list[Path]:
    """Write each figure as PDF and PNG under its name, replacing files atomically.

    Raises
    ------
    ResultError
        The folder cannot be written.
    """
    written = {
        path: _drawn(figure, path.suffix.removeprefix("."))
        for name, figure in figures.items()
        for path in figure_paths(folder, [name])
    }
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
