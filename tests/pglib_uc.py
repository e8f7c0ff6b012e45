"""Instances of PGLib-UC on one bus, and their optimum by a mixed-integer program from the definitions."""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from scipy.optimize import Bounds, LinearConstraint, milp

import opfmodel as om

Array = npt.NDArray[np.float64]


def read(path: Path, hours: int, units: Sequence[int] | None = None) -> dict[str, Any]:
    """Some units and hours of an instance.

    Its ramp limits are the tighter of up and down, those of starts and stops follow from the minimum output,
    and starts cost as hot ones. With some of the units, demand has the shape of that less the renewables.
    """
    given = json.loads(path.read_text())
    thermal = list(given["thermal_generators"].items())
    kept = thermal if units is None else [thermal[i] for i in units]
    wind = given["renewable_generators"]
    demand, reserves = (np.array(given[key][:hours]) for key in ("demand", "reserves"))
    if units is not None:
        free = sum(np.array(g["power_output_maximum"][:hours]) for g in wind.values())
        net = demand - free
        capacity = sum(g["power_output_maximum"] for _, g in kept)
        demand = capacity * (0.25 + 0.55 * (net - net.min()) / (net.max() - net.min()))
        reserves, wind = 0.03 * demand, {}
    return {"units": dict(kept), "wind": wind, "demand": demand, "reserves": reserves, "hours": hours}


def points(unit: dict[str, Any]) -> list[tuple[float, float]]:
    return [(p["mw"], p["cost"]) for p in unit["piecewise_production"]]


def network(data: dict[str, Any]) -> tuple[om.Network, dict[str, Array], Array]:
    """The instance as a network, its series, and the dispatch before it."""
    grid, series, before = om.Network("pglib-uc"), {"town.p": data["demand"]}, []
    grid.bus = om.Bus()
    for name, u in data["units"].items():
        running = u["unit_on_t0"] > 0
        cost = (
            om.PiecewiseLinear(tuple(points(u)))
            if len(points(u)) > 1
            else om.Polynomial(0, 0, points(u)[0][1])
        )
        grid.add(
            name,
            om.Generator(
                "bus",
                p=(u["power_output_minimum"], u["power_output_maximum"]),
                ramp=min(u["ramp_up_limit"], u["ramp_down_limit"]),
                cost=cost,
                start_cost=u["startup"][0]["cost"],
                min_up=u["time_up_minimum"],
                min_down=u["time_down_minimum"],
                hours_on=float(u["time_up_t0"] if running else -u["time_down_t0"]),
            ),
        )
        before.append(u["power_output_t0"])
    for name, w in data["wind"].items():
        grid.add(name, om.Generator("bus", p=(0, max(w["power_output_maximum"]))))
        series[f"{name}.p_min"] = np.array(w["power_output_minimum"][: data["hours"]], dtype=float)
        series[f"{name}.p_max"] = np.array(w["power_output_maximum"][: data["hours"]], dtype=float)
        before.append(w["power_output_minimum"][0])
    grid.town = om.Load("bus", p=0)
    return grid, series, np.array(before, dtype=float)


def optimum(data: dict[str, Any], reserves: bool = True) -> float:  # noqa: PLR0912 - all definitions on one page
    """Minimum cost with one binary per unit and hour, as stated in the definitions."""
    names, hours = list(data["units"]), data["hours"]
    count = len(names)
    shape = (count, hours)
    u, p, start, cost = (k * count * hours + np.arange(count * hours).reshape(shape) for k in range(4))
    n = 4 * count * hours
    rows: list[dict[int, float]] = []
    limits: list[tuple[float, float]] = []

    def state(entries: dict[int, float], low: float, high: float) -> None:
        rows.append(entries)
        limits.append((low, high))

    lower, upper = np.zeros(n), np.full(n, np.inf)
    upper[u] = 1.0
    for i, name in enumerate(names):
        g = data["units"][name]
        p_min, p_max = g["power_output_minimum"], g["power_output_maximum"]
        ramp = min(g["ramp_up_limit"], g["ramp_down_limit"])
        moving = max(ramp, p_min)
        on0 = float(g["unit_on_t0"])
        for k in range(hours):
            state({p[i, k]: 1, u[i, k]: -p_min}, 0, np.inf)
            state({p[i, k]: 1, u[i, k]: -p_max}, -np.inf, 0)
            corners = points(g)
            if len(corners) == 1:
                state({cost[i, k]: 1, u[i, k]: -corners[0][1]}, 0, np.inf)
            for (x, y), (x2, y2) in pairwise(corners):
                slope = (y2 - y) / (x2 - x)
                state({cost[i, k]: 1, p[i, k]: -slope, u[i, k]: slope * x - y}, 0, np.inf)
            price = g["startup"][0]["cost"]
            if k:
                state({start[i, k]: 1, u[i, k]: -price, u[i, k - 1]: price}, 0, np.inf)
                state({p[i, k]: 1, p[i, k - 1]: -1, u[i, k - 1]: moving - ramp}, -np.inf, moving)
                state({p[i, k]: -1, p[i, k - 1]: 1, u[i, k]: moving - ramp}, -np.inf, moving)
            else:
                state({start[i, k]: 1, u[i, k]: -price}, -price * on0, np.inf)
                p0 = g["power_output_t0"]
                state({p[i, k]: 1}, -np.inf, p0 + (ramp if on0 else moving))
                state({p[i, k]: -1, u[i, k]: moving - ramp}, -np.inf, moving - p0)
            for later in range(k + 1, hours):
                if later < k + g["time_up_minimum"]:  # u[later] >= u[k] - u[k-1]
                    entries = {u[i, later]: 1.0, u[i, k]: -1.0}
                    if k:
                        entries[u[i, k - 1]] = 1.0
                    state(entries, 0.0 if k else -on0, np.inf)
                if later < k + g["time_down_minimum"]:  # u[later] <= 1 - (u[k-1] - u[k])
                    entries = {u[i, later]: 1.0, u[i, k]: -1.0}
                    if k:
                        entries[u[i, k - 1]] = 1.0
                    state(entries, -np.inf, 1.0 if k else 1.0 - on0)
            if on0 and k < g["time_up_minimum"] - g["time_up_t0"]:
                lower[u[i, k]] = 1.0
            if not on0 and k < g["time_down_minimum"] - g["time_down_t0"]:
                upper[u[i, k]] = 0.0
    for k in range(hours):
        state({p[i, k]: 1 for i in range(count)}, data["demand"][k], data["demand"][k])
        if reserves:
            spare = {p[i, k]: -1.0 for i in range(count)}
            spare |= {u[i, k]: data["units"][name]["power_output_maximum"] for i, name in enumerate(names)}
            state(spare, data["reserves"][k], np.inf)
    matrix = sp.lil_array((len(rows), n))
    for row, entries in enumerate(rows):
        for column, value in entries.items():
            matrix[row, column] += value
    objective = np.zeros(n)
    objective[start], objective[cost] = 1.0, 1.0
    whole = np.zeros(n)
    whole[u] = 1
    low, high = np.array(limits).T
    found = milp(
        objective,
        constraints=LinearConstraint(matrix.tocsr(), low, high),
        bounds=Bounds(lower, upper),
        integrality=whole,
        options={"mip_rel_gap": 0.0},
    )
    assert found.success, found.message
    return float(found.fun)
