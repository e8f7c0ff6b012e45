"""Scenarios of a plan as fans: one line for each, the fainter the less probable."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.results.report.page import Chart, Section, Table, View
from opfmodel.results.report.sheet import COLOURS, Sheet, steps

__all__ = ["Futures", "futures"]

Array = npt.NDArray[np.float64]

# Quantity, title, unit, and how components make one figure.
_QUANTITIES = (
    ("pd", "demand", "MW", np.sum),
    ("pg", "generation", "MW", np.sum),
    ("renewable_p", "renewable generation", "MW", np.sum),
    ("ps", "charging power", "MW", np.sum),
    ("e", "stored energy", "MWh", np.sum),
    ("lmp", "mean price", "", np.mean),
)

Futures = dict[str, tuple[float, float, Sheet]]
"""Probability, cost and trajectories of each scenario."""


def futures(every: Futures) -> Section | None:
    """Return the fans and a table of the scenarios; None without several."""
    if len(every) < 2:
        return None
    most = max(probability for probability, _, _ in every.values())
    views = []
    for quantity, title, unit, over in _QUANTITIES:
        lines = []
        own = unit
        for name, (probability, _, sheet) in every.items():
            if sheet.has(quantity):
                own = unit or sheet.data[quantity].attrs["units"]
                style: dict[str, Any] = {"opacity": 0.25 + 0.75 * probability / most}
                label = f"{name} ({100 * probability:.3g} %)"
                values = over(sheet.moments.values(quantity), axis=0)
                lines.append(steps(sheet, label, values, line={"color": COLOURS[0]}, **style))
        if lines:
            views.append(View(title, lines, sheet.over_time(f"{title} [{own}]")))
    currency = next(iter(every.values()))[2].summary.get("currency", "$")
    rows = [[name, probability, cost] for name, (probability, cost, _) in every.items()]
    table = Table("Scenarios", ["scenario", "probability", f"cost [{currency}]"], rows)
    return Section("Scenarios", [Chart("All scenarios", views, {}, 360, "quantity"), table])
