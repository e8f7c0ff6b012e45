"""The contract of a formulation."""

from __future__ import annotations

import numpy as np

from opfmodel.check import check
from opfmodel.errors import ModelError
from opfmodel.formulations.base import Formulation
from opfmodel.horizon import Horizon
from opfmodel.model import Model
from opfmodel.network.arrays import per_unit
from opfmodel.network.components import Load
from opfmodel.network.network import Network
from opfmodel.plan import MultiStage, Plan
from opfmodel.testing.grids import EDGE_GRIDS, demand, feeder, ring
from opfmodel.testing.options import check_documentation
from solvers.testing import Contract

__all__ = ["check_formulation"]

_VIOLATION = 1e-6  # p.u.


def check_formulation(formulation: Formulation) -> None:
    """Raise :class:`ContractError` unless a formulation satisfies its contract.

    - It states its name, whether it balances reactive power, and what it publishes; it publishes
      exactly that on any grid.
    - It solves a radial grid with all built-in devices and time series, for one stage and for three,
      and :func:`opfmodel.check.check` finds no violation.
    - The price ``lmp`` of a bus is the derivative of the cost with respect to its demand.
    - It supports branches without ratings, grids without shunts or branches, islands, and equipment
      out of service.
    - It solves a grid with a loop, or rejects it with a ``ModelError``.
    """
    rules = Contract(f"formulation {type(formulation).__name__}")
    rules.require(isinstance(formulation, Formulation), "is a Formulation")
    check_documentation(rules, type(formulation))
    _check_statements(rules, formulation)
    for horizon in (Horizon.chain(1), Horizon.chain(3)):
        _check_plan(rules, formulation, feeder(), horizon, "a feeder")
    for name, grid in EDGE_GRIDS.items():
        _check_plan(rules, formulation, grid(), Horizon.chain(2), f"a grid with {name}", series=False)
    _check_prices(rules, formulation)
    with rules.rule("solves a grid with a loop or rejects it with a ModelError"):
        try:
            MultiStage(ring(), formulation=formulation).declare()
        except ModelError as error:
            rules.require("'ring'" in str(error), "names the grid that it rejects", str(error))
            return
    _check_plan(rules, formulation, ring(), Horizon.chain(2), "a ring", series=False)


def _check_statements(rules: Contract, formulation: Formulation) -> None:
    """The attributes exist, and the published quantities are those stated."""
    for attribute, kind in (("name", str), ("reactive", bool), ("publishes", tuple)):
        value = getattr(formulation, attribute, None)
        rules.require(isinstance(value, kind), f"states {attribute}, a {kind.__name__}", repr(value))
    for grid in (feeder(), *(make() for make in EDGE_GRIDS.values())):
        arrays = per_unit(grid)
        with rules.rule("assigns every bus to a row of the balance"):
            zones = formulation.zones(arrays)
            model = Model(arrays, Horizon.chain(2), reactive=formulation.reactive, zones=zones)
        rules.require(zones.shape == (len(arrays.bus),), "assigns every bus to a row of the balance")
        with rules.rule("can be declared on any grid"):
            formulation.declare(model)
        stated, published = set(formulation.publishes), set(model.published)
        rules.require(stated <= published, "publishes what it states", ", ".join(sorted(stated - published)))
        rules.require(published <= stated, "states what it publishes", ", ".join(sorted(published - stated)))


def _solved(rules: Contract, problem: MultiStage, rule: str, time: int = 0) -> Plan:
    with rules.rule(rule):
        plan = problem.solve(time)
    rules.require(plan.optimal, rule, plan.termination)
    return plan


def _check_plan(
    rules: Contract, formulation: Formulation, grid: Network, horizon: Horizon, what: str, series: bool = True
) -> None:
    """A grid is solved, and the independent check finds no violation."""
    profiles = demand() if series else {}
    plan = _solved(
        rules, MultiStage(grid, horizon, formulation=formulation, profiles=profiles), f"solves {what}"
    )
    with rules.rule(f"reports results of {what} that can be checked"):
        report = check(grid, plan.data, profiles)
    worst = report.worst
    found = "" if worst is None else f"{worst.family} at {worst.component}: {worst.value:.1e} p.u."
    rules.require(report.max_violation <= _VIOLATION, f"satisfies all limits and balances of {what}", found)
    balanced = not any(left_out.startswith("balance") for left_out in report.unchecked)
    rules.require(balanced, "publishes the flows of all branches, or none", "; ".join(report.unchecked))
    with rules.rule("reports the distance from relaxed equations"):
        distances = plan.relaxation.values()
    sound = all(np.isfinite(distance) and distance >= 0.0 for distance in distances)
    rules.require(sound, "reports the distance from relaxed equations", str(plan.relaxation))


def _check_prices(rules: Contract, formulation: Formulation) -> None:
    """The price of a bus is the derivative of the optimal cost of a half-hour stage in its demand."""
    grid, step, change = feeder(), 0.5, 0.05
    grid.remove("tank")
    grid.remove("battery")
    grid.update("line", rating=None)
    loads = grid.of(Load)
    # at step 0 the demand of the grid, then of one load after the other a little more and a little less
    series = {f"{name}.p": np.full(1 + 2 * len(loads), load.p, dtype=float) for name, load in loads.items()}
    for number, values in enumerate(series.values()):
        values[1 + 2 * number : 3 + 2 * number] += (change, -change)
    problem = MultiStage(grid, 1, step, formulation=formulation, profiles=series)
    rule = "solves a feeder with changed demand"
    prices = _solved(rules, problem, rule).data["lmp"]
    for number, load in enumerate(loads.values()):
        price = float(prices.sel(bus=load.bus)[0])
        more, less = (
            _solved(rules, problem, rule, time).objective for time in (1 + 2 * number, 2 + 2 * number)
        )
        slope = (more - less) / (2 * change * step)
        rules.require(
            np.isclose(price, slope, rtol=1e-3, atol=1e-3),
            "the price of a bus is the derivative of the cost with respect to its demand",
            f"at {load.bus}, {price:g} instead of {slope:g} $/MWh",
        )
