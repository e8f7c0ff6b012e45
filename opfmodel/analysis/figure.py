"""The figure of a turnpike."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from opfmodel.analysis.finding import Finding

__all__ = ["turnpike_figure"]


def turnpike_figure(finding: Finding, scenario: str) -> Figure:
    """Draw the distance from the steady state for every horizon, and the steps outside the ball.

    The plans are those from full storages, unless these are the steady state.
    """
    from matplotlib import colormaps
    from matplotlib.figure import Figure

    from opfmodel.results.drawing import WIDTH, prepare

    figures: Any = finding.figures
    start = next(reversed(figures["distance"]))
    figure = Figure(figsize=(WIDTH, 3.2), layout="constrained")
    distance, count = figure.subplots(1, 2)
    shades = colormaps["viridis"](np.linspace(0.85, 0.05, max(1, len(figures["horizons"]))))
    for horizon, merged, shade in zip(
        figures["horizons"], figures["base_steps_per_stage"], shades, strict=True
    ):
        away = np.array(figures["distance"][start][str(horizon)])
        distance.plot(np.arange(away.size) * merged, away, color=shade, linewidth=1.2, label=f"N = {horizon}")
    distance.axhline(figures["epsilon"], color="0.4", linewidth=0.8, linestyle=":", label="ε")
    distance.set(xlabel="step", ylabel="distance from $x_s$ [p.u.]", title=f"{scenario}: {start} storages")
    for (name, of), mark in zip(figures["by_initial_state"].items(), "os^", strict=False):
        count.plot(figures["horizons"], of["outside"], marker=mark, markersize=4, linewidth=1.2, label=name)
    count.plot(figures["horizons"], figures["horizons"], color="0.4", linewidth=0.8, linestyle=":", label="N")
    count.set(xlabel="horizon N [steps]", ylabel="steps outside the ball", title="turnpike")
    for axis in (distance, count):
        prepare(axis)
        axis.legend(fontsize=7, frameon=False)
    return figure
