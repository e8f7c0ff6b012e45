"""What the sections of a page draw from, and the traces that they share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.results.report.moments import MOST_VALUES, Moments
from opfmodel.results.report.page import Trace, View, of

__all__ = ["COLOURS", "Sheet", "amount", "line", "steps"]

Array = npt.NDArray[np.float64]

# Okabe-Ito palette, which colour-blind readers can tell apart, and its lighter kin.
COLOURS = (
    "#0072B2", "#E69F00", "#009E73", "#D55E00", "#56B4E9", "#CC79A7", "#8C6D31", "#6B6ECF", "#9C9E3A",
    "#7B4173", "#637939", "#AD494A",
)  # fmt: skip


@dataclass
class Sheet:
    """A dataset, what is known about it, and the arrays of its page.

    Attributes
    ----------
    moments
        The dataset and the moments that are shown of it.
    summary
        Figures of the run or plan.
    arrays
        Arrays of the page by name, which sections add.
    kept
        Components whose values the page has, by array, unless it has all of them.
    """

    moments: Moments
    summary: Mapping[str, Any]
    arrays: dict[str, Array] = field(default_factory=dict)
    kept: dict[str, list[int]] = field(default_factory=dict)

    @property
    def data(self) -> Any:
        """The dataset."""
        return self.moments.data

    def names(self, kind: str) -> list[str]:
        """Names of the components of a kind."""
        return [str(name) for name in self.data[kind].values] if kind in self.data.coords else []

    def has(self, *names: str) -> bool:
        """Whether the dataset has quantities, each with a value."""
        return all(n in self.data and np.isfinite(self.data[n].values).any() for n in names)

    def add(self, name: str, values: Array, worst: Array | None = None) -> Array:
        """Add an array to the page; of too many components, those with the largest ``worst``."""
        most = max(1, MOST_VALUES // max(1, values.shape[-1]))
        if worst is not None and len(values) > most:
            order = np.argsort(-np.nan_to_num(worst, nan=-np.inf), kind="stable")
            self.kept[name] = np.sort(order[:most]).tolist()
            self.arrays[name] = values[self.kept[name]]
        else:
            self.arrays[name] = values
        return values

    def row(self, name: str, row: int) -> dict[str, Any]:
        """Stand in a trace for the values of a component, which must have been kept."""
        return of(name, self.kept[name].index(row) if name in self.kept else row)

    def total(self, name: str) -> Array:
        """Sum of a quantity over all components at the moments."""
        values = self.moments.values(name)
        return values.sum(axis=0) if values.ndim > 1 else values

    def over_time(self, y: str, **axis: Any) -> dict[str, Any]:
        """Return the layout of a chart over time, with the title of its other axis."""
        return {
            "xaxis": {"title": {"text": self.moments.title}},
            "yaxis": {"title": {"text": y}, **axis},
        }

    def heat(self, array: str, names: Sequence[str], unit: str, kind: str) -> View:
        """Return a map of an array of the page over components and time."""
        kept = self.kept.get(array)
        trace = {
            "type": "heatmap",
            "x": self.moments.axis,
            "y": list(names) if kept is None else [names[row] for row in kept],
            "z": of(array),
            "colorscale": "Viridis",
            "colorbar": {"title": {"text": unit, "side": "right"}, "thickness": 14},
            "hovertemplate": f"{kind} %{{y}}<br>%{{x}}<br>%{{z:.6g}} {unit}<extra></extra>",
        }
        label = "map" if kept is None else f"map of {len(kept):,} of {len(names):,}"
        axis = {"type": "category", "title": {"text": kind}, "autorange": "reversed"}
        return View(label, [trace], {"yaxis": axis})


def steps(sheet: Sheet, name: str, values: Any, **style: Any) -> Trace:
    """Return a line that is constant during each stage; the last value is repeated at the end."""
    return {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "x": sheet.moments.axis,
        "y": _closed(values),
        "line": {"shape": "hv", "width": 1.8, **style.pop("line", {})},
        **style,
    }


def line(sheet: Sheet, name: str, values: Any, **style: Any) -> Trace:
    """Return a line through the values at the beginnings of the stages and the end of the last."""
    made = steps(sheet, name, values, **style)
    made["line"] = {**made["line"], "shape": "linear"}
    return made


def _closed(values: Any) -> Any:
    """Return values with the last one again; an array of the page is closed by the browser."""
    if isinstance(values, Mapping):
        return {**values, "closed": True}
    known = np.asarray(values, dtype=float)
    return [*known.tolist(), *known[-1:].tolist()]


def amount(value: Any, unit: str = "", digits: int = 2) -> str:
    """Return a figure as text."""
    if value is None or (isinstance(value, float) and not np.isfinite(value)):
        return "none"
    text = f"{value:,}" if isinstance(value, int) else f"{value:,.{digits}f}"
    return f"{text} {unit}".strip()
