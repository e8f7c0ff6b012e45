"""What happened beyond the plan: redispatch, violations, outages, and the effort of the solver."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.results.report.page import Chart, Notes, Section, Table, View
from opfmodel.results.report.sheet import COLOURS, Sheet, steps

__all__ = ["deviations", "effort", "outages"]

Array = npt.NDArray[np.float64]

_ENDINGS = ("_excess", "_redispatch", "_curtailed")
_AMOUNTS = ("load_shed", "p_unserved", "p_shortage", "p_surplus", "q_unserved", "q_shortage", "q_surplus")
_LEAST = 1e-3  # MW, MVA, deg, or thousandths of p.u.: less is tolerance of the solver


def deviations(sheet: Sheet) -> Section | None:
    """What the plant changed and which limits it exceeded, and what the independent check found."""
    data = sheet.data
    views, rows = [], []
    for name in map(str, data.data_vars):
        if not (name.endswith(_ENDINGS) or name in _AMOUNTS) or "time" not in data[name].dims:
            continue
        values = np.nan_to_num(np.atleast_2d(data[name].transpose(..., "time").values))
        unit = data[name].attrs.get("units", "")
        if np.abs(values).max(initial=0.0) <= _LEAST * (1e-3 if unit == "p.u." else 1.0):
            continue
        worst = name.endswith("_excess")
        shown = (np.max if worst else np.sum)(np.abs(values), axis=0)
        title = data[name].attrs.get("long_name", name.replace("_", " "))
        row, time = np.unravel_index(int(np.abs(values).argmax()), values.shape)
        kind = next((str(d) for d in data[name].dims if d != "time"), "")
        where = str(data[kind].values[row]) if kind in data.coords else ""
        energy = float(np.abs(values).sum()) * float(data.attrs.get("step_hours", 1.0))
        total = f"{energy:,.3f} MWh" if unit == "MW" and not worst else ""
        rows.append([title, float(np.abs(values).max()), unit, where, sheet.moments.name(int(time)), total])
        label = f"{name.replace('_', ' ')} ({'largest' if worst else 'total'})"
        trace = steps(
            sheet, title, shown[:: sheet.moments.stride], fill="tozeroy", line={"color": COLOURS[3]}
        )
        views.append(View(label, [trace], sheet.over_time(unit)))
    parts: list[Any] = []
    if views:
        parts.append(Chart("Redispatch, unserved power and exceeded limits", views, {}, 280))
        columns = ["what", "largest", "unit", "component", "when", "in total"]
        parts.append(Table("The largest of each kind", columns, rows))
    checked = _checked(sheet)
    if checked is not None:
        parts.append(checked)
    unchecked = sheet.summary.get("unchecked") or []
    if unchecked:
        parts.append(Notes([f"Not checked: {'; '.join(map(str, unchecked))}."], mild=True))
    return Section("Limits and redispatch", parts) if parts else None


def outages(sheet: Sheet) -> Section | None:
    """The outages that happened in a loop, or that a plan does not survive."""
    parts = []
    happened = sheet.summary.get("outages") or {}
    if happened:
        rows = [
            [name, len(stages), *(sheet.moments.name(stages[end]) if stages else "" for end in (0, -1))]
            for name, stages in happened.items()
        ]
        columns = ["component", "steps out of service", "first", "last"]
        parts.append(Table("Outages that happened", columns, rows))
    tested = sheet.summary.get("contingencies") or []
    if tested:
        columns = ["outage", "stage", "scenario", "status", "what is lacking"]
        rows = [
            [each.get("out", ""), each.get("stage", ""), each.get("scenario") or "", each.get("status", ""),
             each.get("text", "")]
            for each in tested
        ]  # fmt: skip
        parts.append(Table("Contingencies", columns, rows))
    return Section("Outages", parts) if parts else None


def effort(sheet: Sheet) -> Section | None:
    """Iterations and seconds of each step, and the solves that were repeated."""
    parts: list[Any] = []
    views = []
    for name, title, unit in (
        ("iterations", "iterations", "iterations"),
        ("solve_seconds", "solve time", "solve time [s]"),
    ):
        if sheet.has(name) and sheet.data[name].dims == ("time",):
            values = sheet.moments.values(name)
            trace = {
                "type": "bar", "name": title, "x": sheet.moments.axis[:-1], "y": values,
                "marker": {"color": COLOURS[0]},
            }  # fmt: skip
            views.append(View(title, [trace], sheet.over_time(unit)))
    if views:
        parts.append(Chart("Effort of each step", views, {"bargap": 0.15}, 260))
    retries = sheet.summary.get("retries") or {}
    if retries:
        rows = [[int(step), "; then ".join(tried)] for step, tried in retries.items()]
        parts.append(Table("Steps that took more than one solve", ["step", "solves"], rows))
    return Section("Solver effort", parts) if parts else None


def _checked(sheet: Sheet) -> Table | None:
    """What the independent check found."""
    found = sheet.summary.get("violations") or {}
    if not found:
        return None
    rows = [
        [family, float(each["value"]), each["unit"], each["component"], each.get("moment", "")]
        for family, each in found.items()
    ]
    columns = ["constraint", "largest violation", "unit", "component", "when"]
    return Table("Largest violations found by the independent check", columns, rows)
