"""The figure of closed-loop trajectories in the paper that opfmodel follows, with limits and where they bind.

After T. Faulwasser and A. Engelmann, "Towards economic NMPC for multi-stage AC optimal power flow" (2019),
section "Simulation Examples".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from opfmodel.results.aggregates import at_bus, chosen, generation, injections, members, stages, total
from opfmodel.results.drawing import (
    COLOURS,
    WIDTH,
    add_legend,
    colour_of,
    draw_line,
    draw_steps,
    ends,
    fan,
    label_time,
    mark_outages,
    prepare,
)
from opfmodel.results.limits import binding

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

__all__ = ["paper"]

_SIZE = 8  # points: text of panels that are half as wide as a page
_COLUMNS = 6  # of the legend
_GREY = "0.4"
_WIDTH = 1.2
_FAR = 0.5  # from the values in a panel, relative to their range
_LIMIT: dict[str, Any] = {"linewidth": 0.6, "zorder": 1.5}
_MARKS: dict[str, dict[str, Any]] = {
    "at upper limit": {"marker": "^", "markersize": 3, "markeredgewidth": 0},
    "at lower limit": {"marker": "v", "markersize": 3, "markeredgewidth": 0},
    "at ramp limit": {"marker": "D", "markersize": 3.5, "markeredgecolor": "black", "markeredgewidth": 0.6},
}
_UPPER, _LOWER, _RAMP = _MARKS
_ON_DOTS = {"markersize": 5}  # larger than the dots of a line


class _Panel(NamedTuple):
    """Quantities at buses, solid and dashed, with the label of the axis and that of a second one."""

    kind: str
    solid: str
    dashed: str
    label: str
    second: str = ""


_PANELS = (
    _Panel("generator", "pg", "qg", "generation\n[MW], [MVAr]"),
    _Panel("renewable", "renewable_p", "renewable_q", "renewables\n[MW], [MVAr]"),
    _Panel("storage", "ps", "qs", "charging power\n[MW], [MVAr]"),
    _Panel("bus", "vm", "va", "voltage [p.u.]", "angle [deg]"),
    _Panel("storage", "e", "", "energy [MWh]"),
)


def paper(data: xr.Dataset, names: Sequence[str] | None = None) -> Figure:
    r"""Plot inputs, outputs, states and demand at some buses, and the totals, as the paper does.

    (a) ``pg``, ``ps``, ``vm`` and ``e`` are solid, ``qg``, ``qs`` and ``va`` dashed; ``e`` includes the value
    at the end of the last step. Limits are thin lines, and marks show where a limit binds; see
    :func:`opfmodel.results.binding`. (b) ``pd`` is solid, ``qd`` dashed, the total demand dash-dotted.
    (c) The total demand is dash-dotted, generation solid, charging power dashed, losses yellow. Losses are
    those of the branches, from their flows: that the balance of the paper,

    .. math:: P^g - P^d - P^s - P^{loss} = 0,

    holds is then a property of the data, not a definition.

    Parameters
    ----------
    names
        Buses to show; by default all of a small network, or a few with the highest demand or generation.

    Raises
    ------
    ResultError
        A bus is unknown.
    """
    colours = colour_of(chosen(data, names))
    shown = [panel for panel in _PANELS if panel.solid in data or (panel.second and panel.dashed in data)]
    figure, axes = _grid(len(shown), stored="e_next" in data)
    states, (each, all_), totals = axes[: len(shown)], axes[len(shown) :][:2], axes[len(shown) + 2 :]
    at_limit = binding(data)
    for axis, panel in zip(states, shown, strict=True):
        _draw_panel(axis, data, panel, at_limit, colours)
    _draw_demand(each, all_, data, colours)
    _draw_totals(totals, data)
    headings = {0: "(a) inputs, outputs and states", len(shown): "(b) demand", len(shown) + 2: "(c) totals"}
    for place, heading in headings.items():
        axes[place].set_title(heading, loc="left", fontsize=_SIZE)
    for axis in axes:
        axis.yaxis.label.set_size(_SIZE)
        lowest = axis in totals[1:]
        axis.tick_params(labelbottom=lowest)
        axis.xaxis.offsetText.set_visible(lowest)
        if lowest:
            label_time(axis, data, narrow=True)
            axis.xaxis.label.set_size(_SIZE)
            axis.xaxis.offsetText.set_size(_SIZE)
    mark_outages(axes, data)
    _add_key(figure, colours, totals, limited=bool(set(at_limit)))
    return figure


def _grid(states: int, *, stored: bool) -> tuple[Figure, list[Any]]:
    """Return a figure and its panels: states and demand in two columns, then power, and stored energy."""
    from matplotlib.figure import Figure

    rows = (states + 1) // 2
    figure = Figure(figsize=(WIDTH, 1.0 + 1.8 * (rows + 2)), layout="constrained")
    grid = figure.add_gridspec(rows + 3, 2, height_ratios=[*[1.0] * (rows + 1), 0.6, 0.6])
    places = [grid[number // 2, number % 2] for number in range(states)]
    places += [grid[rows, 0], grid[rows, 1]]
    left = 0 if stored else slice(None)
    places += [grid[rows + 1, left], grid[rows + 2, left]]
    if stored:
        places.append(grid[rows + 1 :, 1])
    axes: list[Any] = []
    for place in places:
        axis = figure.add_subplot(place, sharex=axes[0] if axes else None)
        prepare(axis)
        axis.tick_params(labelsize=_SIZE)
        axes.append(axis)
    return figure, axes


def _draw_panel(
    axis: Any, data: xr.Dataset, panel: _Panel, at_limit: xr.Dataset, colours: Mapping[str, Any]
) -> None:
    """Draw quantities at buses with their limits and marks."""
    other, label = axis, panel.label
    if panel.second and panel.dashed in data:
        if panel.solid in data:
            other = axis.twinx()
            other.tick_params(labelsize=_SIZE)
            other.set_ylabel(panel.second, fontsize=_SIZE)
        else:
            label = panel.second
    axis.set_ylabel(label)
    drawn = ((panel.solid, axis, "-"), (panel.dashed, other, "--"))
    for quantity, on, style in drawn:
        for bus, colour in colours.items():
            values = at_bus(data, quantity, panel.kind, bus)
            if values is None:
                continue
            if quantity == "e":
                stored = at_bus(data, "e_next", panel.kind, bus)
                draw_line(on, data, values, stored, color=colour)
                values = stored
            else:
                draw_steps(on, data, values, color=colour, linestyle=style)
            reached = _reached(data, at_limit, panel.kind, quantity, bus)
            _draw_marks(on, data, values, reached, colour, at_end=quantity == "e")
    views = {on: tuple(on.dataLim.intervaly) for on in (axis, other)}
    for quantity, on, style in drawn:
        _draw_limits(on, data, panel.kind, quantity, colours, view=views[on], linestyle=style)


def _draw_limits(
    axis: Any,
    data: xr.Dataset,
    kind: str,
    quantity: str,
    colours: Mapping[str, Any],
    *,
    view: tuple[float, float],
    linestyle: str,
) -> None:
    """Draw the limits at each bus in its colour, and those that several buses share once, in grey.

    Those far from all values are left out, for the values to remain legible.
    """
    lines: dict[tuple[float, ...], Any] = {}
    for bus, colour in colours.items():
        for end in ("min", "max"):
            limit = at_bus(data, f"{quantity}_{end}", kind, bus)
            if limit is not None and np.isfinite(limit).all():
                values = np.broadcast_to(limit, data.sizes[stages(data)])
                key = tuple(values.tolist())
                lines[key] = _GREY if key in lines else colour
    far = _FAR * (view[1] - view[0])
    for limits, colour in lines.items():
        if max(limits) >= view[0] - far and min(limits) <= view[1] + far:
            draw_steps(axis, data, np.array(limits), color=colour, linestyle=linestyle, **_LIMIT)


def _reached(
    data: xr.Dataset, at_limit: xr.Dataset, kind: str, quantity: str, bus: str
) -> dict[str, npt.NDArray[np.bool_]]:
    """Return the stages in which a component at a bus is at a limit, by mark."""
    found = members(data, kind, bus)
    made: dict[str, xr.DataArray] = {}
    if quantity in at_limit:
        at = at_limit[quantity].sel({kind: found})
        made = {_UPPER: at > 0, _LOWER: at < 0}
    if f"{quantity}_ramp" in at_limit:
        made[_RAMP] = at_limit[f"{quantity}_ramp"].sel({kind: found}) != 0
    return {mark: array.any(kind).values for mark, array in made.items()}


def _draw_marks(
    axis: Any,
    data: xr.Dataset,
    values: Any,
    reached: Mapping[str, npt.NDArray[np.bool_]],
    colour: Any,
    *,
    at_end: bool,
) -> None:
    """Mark stages in their middle, states at the end of the stage, and ramps half-way between two stages."""
    for path, line in fan(data, {"color": colour}):
        times, own = ends(data, path), values[path]
        middle = times[:-1] + (times[1:] - times[:-1]) / 2
        for mark, where in reached.items():
            at, heights = (times[1:], own) if at_end else (middle, own)
            if mark == _RAMP:
                at, heights = times[:-1], 0.5 * (own + np.append(own[0], own[:-1]))
            there = where[path]
            style = {**_MARKS[mark], **(_ON_DOTS if at_end else {})}
            if there.any():
                axis.plot(at[there], heights[there], linestyle="none", zorder=3, **line, **style)


def _draw_demand(each: Any, all_: Any, data: xr.Dataset, colours: Mapping[str, Any]) -> None:
    """Draw the demand of buses and that of all."""
    for bus, colour in colours.items():
        draw_steps(each, data, data["pd"].sel(bus=bus).values, color=colour)
        draw_steps(each, data, data["qd"].sel(bus=bus).values, color=colour, linestyle="--")
    each.set_ylabel("demand\n[MW], [MVAr]")
    draw_steps(all_, data, total(data, "pd"), color=COLOURS[6], linestyle="-.")
    all_.set_ylabel("total demand [MW]")


def _draw_totals(axes: Sequence[Any], data: xr.Dataset) -> None:
    """Draw demand and generation above storage and losses, which are much smaller, and stored energy."""
    large, small = axes[:2]
    draw_steps(large, data, total(data, "pd"), label="demand $P^d$", color=COLOURS[6], linestyle="-.")
    draw_steps(large, data, generation(data), label="generation $P^g$", color=COLOURS[0])
    if "renewable_p" in data:
        renewable = total(data, "renewable_p")
        draw_steps(large, data, renewable, label="of which renewable", color=COLOURS[2], linestyle=":")
    if "ps" in data:
        draw_steps(small, data, total(data, "ps"), label="charging $P^s$", color=COLOURS[1], linestyle="--")
    if {"pf", "pt"} <= set(data):
        losses = total(data, "pf") + total(data, "pt")
        draw_steps(small, data, losses, label="losses $P^{loss}$", color=COLOURS[4])
    for number, name in enumerate(injections(data)):
        label = name.removesuffix("_p")
        draw_steps(small, data, total(data, name), label=label, color=COLOURS[5 - number % 2])
    for axis in (large, small):
        axis.set_ylabel("power [MW]")
    if len(axes) > 2:
        draw_line(
            axes[2], data, total(data, "e"), total(data, "e_next"), label="energy $E$", color=COLOURS[2]
        )
        axes[2].set_ylabel("total energy [MWh]")


def _add_key(figure: Figure, colours: Mapping[str, Any], totals: Sequence[Any], *, limited: bool) -> None:
    """Add a legend with a row, or more, of the buses, of styles and marks, and of the totals."""
    from matplotlib.lines import Line2D

    def key(label: str, **style: Any) -> Any:
        return Line2D([], [], label=label, **{"color": _GREY, "linewidth": _WIDTH, **style})

    buses = [key(f"bus {bus}", color=colour) for bus, colour in colours.items()]
    styles = [key("active, voltage", linestyle="-"), key("reactive, angle", linestyle="--")]
    if limited:
        styles.append(key("limit", **_LIMIT))
        styles += [key(mark, linestyle="none", **style) for mark, style in _MARKS.items()]
    sums = [handle for axis in totals for handle in axis.get_legend_handles_labels()[0]]
    rows: list[list[Any]] = []
    for group in (buses, styles, sums):
        for start in range(0, len(group), _COLUMNS):
            row = group[start : start + _COLUMNS]
            rows.append([*row, *[key(" ", linestyle="none")] * (_COLUMNS - len(row))])
    # a legend is filled column by column
    handles = [row[column] for column in range(_COLUMNS) for row in rows]
    labels = [handle.get_label() for handle in handles]
    add_legend(figure, handles, labels, _COLUMNS, handlelength=1.6, columnspacing=1.0)
