"""Renewables: available power, its curtailment, forecasts of it, and limits of reactive power."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import opfmodel as om
from opfmodel.check import check
from opfmodel.errors import CaseError, ComponentError
from opfmodel.forecasts import Noisy, Persistence
from opfmodel.network import write_network
from opfmodel.results.aggregates import generation
from opfmodel.results.figures import FIGURES
from opfmodel.simulation import Controller

REACTIVE = ("ac", "ac-rectangular", "soc")


def one_bus(wind: om.Renewable, unit: om.Generator, p: float, q: float = 0.0) -> om.Network:
    grid = om.Network("one-bus")
    grid.bus = om.Bus()
    grid.wind, grid.unit = wind, unit
    grid.town = om.Load("bus", p=p, q=q)
    return grid


def unit(p: Any, c1: float, q: Any = (0, 0)) -> om.Generator:
    return om.Generator("bus", p=p, q=q, cost=om.Polynomial(0, c1, 0))


def solved(grid: om.Network, formulation: str = "ac", **options: Any) -> om.Plan:
    """Return the optimum of one stage, which the check confirms."""
    plan = om.MultiStage(grid, formulation=formulation, **options).solve()
    assert plan.optimal, plan.termination
    report = check(grid, plan.data)
    assert report.max_violation < 1e-7
    assert report.cost == pytest.approx(plan.objective, rel=1e-6, abs=1e-5)
    return plan


# Closed forms --------------------------------------------------------------------------------------


@pytest.mark.parametrize("formulation", [*REACTIVE, "dc", "dc-matpower", "copperplate"])
def test_curtailment_against_minimum_output(formulation: str) -> None:
    grid = one_bus(om.Renewable("bus", available=40, curtail_cost=5), unit((20, 100), 15), p=50)
    plan = solved(grid, formulation)
    assert plan.objective == pytest.approx(20 * 15 + 10 * 5, rel=1e-6)
    assert plan.data["renewable_p"].values == pytest.approx(30, abs=1e-4)
    assert plan.data["renewable_curtailed"].values == pytest.approx(10, abs=1e-4)
    assert plan.data["lmp"].values == pytest.approx(-5, rel=1e-5)  # more demand saves curtailment


@pytest.mark.parametrize(("price", "curtailed"), [(-3.0, 0.0), (-8.0, 40.0)])
def test_curtailment_against_a_negative_price(price: float, curtailed: float) -> None:
    grid = one_bus(om.Renewable("bus", available=40, curtail_cost=5), unit((0, 100), price), p=50)
    plan = solved(grid)
    assert plan.data["renewable_curtailed"].values == pytest.approx(curtailed, abs=1e-4)
    assert plan.objective == pytest.approx(price * (10 + curtailed) + 5 * curtailed, rel=1e-6)


@pytest.mark.parametrize("formulation", REACTIVE)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_power_factor_ties_reactive_to_active_power(formulation: str, sign: float) -> None:
    """Wind alone gives 30 MVAr, for which it must generate 40 MW at a factor of 0.8, whatever the price."""
    wind = om.Renewable("bus", available=60, q=(-50, 50), power_factor=0.8)
    plan = solved(one_bus(wind, unit((0, 100), -10), p=50, q=sign * 30), formulation)
    assert plan.data["renewable_p"].values == pytest.approx(40, abs=1e-4)
    assert plan.objective == pytest.approx(-100, rel=1e-5)


@pytest.mark.parametrize("formulation", REACTIVE)
def test_a_rating_is_shared(formulation: str) -> None:
    wind = om.Renewable("bus", available=60, q=(-50, 50), rating=50)
    plan = solved(one_bus(wind, unit((0, 100), 20), p=60, q=30), formulation)
    assert plan.objective == pytest.approx(20 * 20, rel=1e-5)
    assert plan.data["renewable_p"].values == pytest.approx(40, abs=1e-4)


def test_a_rating_limits_active_power_alone() -> None:
    plan = solved(one_bus(om.Renewable("bus", available=60, rating=50), unit((0, 100), 20), p=60), "dc")
    assert plan.objective == pytest.approx(200, rel=1e-6)


@pytest.mark.parametrize("formulation", REACTIVE)
def test_a_unit_power_factor_leaves_no_reactive_power(formulation: str) -> None:
    wind = om.Renewable("bus", available=60, q=(-50, 50), power_factor=1)
    plan = solved(one_bus(wind, unit((0, 100), 20, q=(-50, 50)), p=60, q=30), formulation)
    assert plan.data["renewable_q"].values == pytest.approx(0, abs=1e-6)


def test_a_capability_curve_limits_it_too() -> None:
    corners = ((0, -30), (60, -30), (60, 0), (30, 30), (0, 30))
    wind = om.Renewable("bus", available=60, q=(-50, 50), capability=corners)
    plan = solved(one_bus(wind, unit((0, 100), 20), p=60, q=20))
    assert plan.data["renewable_p"].values == pytest.approx(40, abs=1e-4)


@given(st.floats(0, 100), st.floats(0.3, 1), st.floats(0, 30), st.floats(5, 90), st.floats(0, 40))
@settings(max_examples=8, deadline=None)
def test_the_cost_of_one_bus(available: float, factor: float, cost: float, p: float, least: float) -> None:
    wind = om.Renewable("bus", available=available, q=(-9, 9), power_factor=factor, curtail_cost=cost)
    plan = solved(one_bus(wind, unit((least, 200), 20, q=(-50, 50)), p=p + least, q=3))
    used = min(available, p)
    known = 20 * (p + least - used) + cost * (available - used)
    assert plan.objective == pytest.approx(known, rel=1e-5, abs=1e-3)


# Against PyPSA -------------------------------------------------------------------------------------


def test_a_day_of_curtailed_wind_is_that_of_pypsa() -> None:
    pypsa = pytest.importorskip("pypsa")
    hours = np.arange(24)
    wind = 60 + 50 * np.sin(hours / 3.0)
    demand = 60 + 15 * np.cos(hours / 4.0)
    theirs = pypsa.Network()
    theirs.set_snapshots(hours)
    theirs.add("Bus", ["north", "south"])
    theirs.add("Line", "tie", bus0="north", bus1="south", x=0.1, s_nom=45)
    theirs.add(
        "Generator", "wind", bus="north", p_nom=120, p_max_pu=wind / 120, marginal_cost=-4.0
    )  # a price of curtailment is minus that of generation, and a constant
    theirs.add("Generator", "coal", bus="south", p_nom=100, p_min_pu=0.2, marginal_cost=20.0)
    theirs.add("Load", "near", bus="north", p_set=0.3 * demand)
    theirs.add("Load", "far", bus="south", p_set=0.7 * demand)
    assert theirs.optimize(solver_name="highs", log_to_console=False)[0] == "ok"
    grid = om.Network("two-bus")
    grid.north, grid.south = om.Bus(reference=True), om.Bus()
    grid.tie = om.Branch("north", "south", r=0.0, x=0.1, rating=45)
    grid.wind = om.Renewable("north", available=0, curtail_cost=4)
    grid.coal = om.Generator("south", p=(20, 100), cost=om.Polynomial(0, 20, 0))
    grid.near, grid.far = om.Load("north", p=0), om.Load("south", p=0)
    series = {"wind.available": wind, "near.p": 0.3 * demand, "far.p": 0.7 * demand}
    plan = om.MultiStage(grid, 24, formulation="dc", profiles=series).solve()
    assert plan.objective == pytest.approx(theirs.objective + 4 * wind.sum(), rel=1e-6)
    mine, known = plan.data["renewable_p"].values[:, 0], theirs.generators_t.p["wind"].to_numpy()
    assert mine == pytest.approx(known, abs=1e-3)
    assert (wind - mine).max() > 10
    prices = theirs.buses_t.marginal_price[["north", "south"]].to_numpy()
    assert plan.data["lmp"].values == pytest.approx(prices, abs=1e-4)


# Horizons, outages and elastic problems ------------------------------------------------------------


def pair(**options: Any) -> om.Network:
    grid = om.Network("pair")
    grid.north, grid.south = om.Bus(reference=True), om.Bus()
    grid.tie = om.Branch("north", "south", r=0.01, x=0.05, rating=90)
    grid.coal = om.Generator("north", p=(0, 90), q=(-50, 50), ramp=200, cost=om.Polynomial(0, 20, 0))
    fields = {"available": 30, "q": (-10, 10), "power_factor": 0.9, "curtail_cost": 3}
    grid.wind = om.Renewable("south", **{**fields, **options})
    grid.town = om.Load("south", p=50, q=10)
    return grid


SERIES = {"wind.available": [30.0, 0.0, 90.0, 60.0, 20.0, 45.0]}


@pytest.mark.parametrize(
    "horizon", [om.Horizon.grid([1, 2, 1]), om.Horizon.tree([1, 1, 2], {"a": 0.3, "b": 0.7}, common=1)]
)
@pytest.mark.parametrize("formulation", ["ac", "dc"])
def test_trees_and_uneven_steps(horizon: om.Horizon, formulation: str) -> None:
    grid = pair()
    plan = om.MultiStage(grid, horizon, formulation=formulation, profiles=SERIES).solve()
    assert plan.optimal
    costs = 0.0
    for name, probability in zip(
        plan.horizon.scenarios, plan.horizon.probability[plan.horizon.leaves], strict=True
    ):
        report = check(grid, plan.scenario(name), SERIES)
        assert report.max_violation < 1e-7
        costs += probability * report.cost
    assert costs == pytest.approx(plan.objective, rel=1e-6)


@pytest.mark.parametrize("response", ["corrective", "preventive"])
def test_a_plan_survives_its_outage(response: Any) -> None:
    security = om.Security({"renewables": ["wind"]}, response=response)
    plan = om.MultiStage(pair(), 2, profiles=SERIES, security=security).solve()
    assert plan.optimal
    assert om.assess(plan, security).secure
    assert check(pair(), plan.data, SERIES).max_violation < 1e-7


@pytest.mark.parametrize("formulation", ["ac", "dc"])
def test_it_goes_out(formulation: str) -> None:
    problem = om.MultiStage(pair(), 2, formulation=formulation, outages=["wind"])
    plan = problem.solve(out=["wind"])
    assert plan.data["renewable_p"].values == pytest.approx(0, abs=1e-6)
    assert plan.data["renewable_curtailed"].values == pytest.approx(0, abs=1e-6)
    report = check(pair(), plan.data)
    assert report.max_violation < 1e-7
    assert report.cost == pytest.approx(plan.objective, rel=1e-6)


@pytest.mark.parametrize("plant", [om.NominalPlant, om.PowerFlow, om.Redispatch])
def test_nothing_is_curtailed_while_it_is_out(plant: Any) -> None:
    grid = pair()
    problem = om.MultiStage(grid, 2, profiles=SERIES, outages=["wind"])
    run = om.simulate(problem, plant().with_outages([om.Outage("wind", step=2, hours=1)]), 4)
    assert run.status == "done"
    assert run.data["renewable_p"].values[2] == pytest.approx(0, abs=1e-5)
    report = check(grid, run.data, SERIES)
    measured = {"voltage"} if plant is om.PowerFlow else set()  # a power flow keeps no limit of the grid
    assert all(v.value < 1e-6 for v in report.violations.values() if v.family not in measured)
    assert report.cost == pytest.approx(run.cost, rel=1e-6)


def test_an_elastic_problem_curtails_before_it_has_a_surplus() -> None:
    grid = one_bus(om.Renewable("bus", available=80), unit((20, 100), 15), p=50)
    plan = solved(grid, elastic=om.Elastic())
    assert not plan.short
    assert plan.data["renewable_curtailed"].values == pytest.approx(50, abs=1e-3)


# Forecasts and plants ------------------------------------------------------------------------------


def test_forecasts_forecast_what_is_available() -> None:
    actual = om.Profiles(SERIES)
    (key,) = actual
    noisy = Noisy(0.2, seed=1)
    assert not np.allclose(noisy.expected(actual, 0, 4)[key], SERIES["wind.available"][:4])
    drawn = noisy.paths(actual, 0, 5, seed=2)[key]
    assert drawn.shape == (5, 6) and np.ptp(drawn[:, 0]) > 1
    assert Persistence(1).expected(actual, 3, 2)[key].tolist() == [90, 90]


@pytest.mark.parametrize("plant", [om.PowerFlow(), om.Redispatch()])
@pytest.mark.parametrize("formulation", ["ac", "dc"])
def test_set_points_follow_what_is_really_available(plant: Any, formulation: str) -> None:
    grid = pair()
    problem = om.MultiStage(grid, 2, formulation=formulation, profiles=SERIES, at_end="repeat")
    controller = Controller(problem, Noisy(0.3, seed=3))
    run = om.simulate(controller, plant, 6)
    assert run.status == "done" and run.summary()["unsolved_steps"] == 0
    report = check(grid, run.data, SERIES)
    assert report.max_violation < 1e-6
    assert report.cost == pytest.approx(run.cost, rel=1e-6)
    planned = [step.values["renewable", "renewable_p_redispatch"][0] for step in run.steps]
    p, available = run.data["renewable_p"].values[:, 0], np.array(SERIES["wind.available"])
    assert max(planned) * 100 > 1  # once, less was there than planned
    assert (p <= available + 1e-4).all()
    assert run.summary()["curtailed_mwh"] == pytest.approx((available - p).sum(), abs=1e-3)
    if formulation == "dc" and isinstance(
        plant, om.PowerFlow
    ):  # the plan has no reactive power; that of the wind farm then is zero
        assert run.data["renewable_q"].values == pytest.approx(0, abs=1e-3)


def test_a_run_records_what_is_curtailed() -> None:
    run = om.simulate(om.MultiStage(pair(), 1, formulation="dc", profiles=SERIES), om.NominalPlant(), 4)
    assert run.summary()["curtailed_mwh"] == pytest.approx(40 + 10, rel=1e-5)


def test_scenarios_of_what_is_available(tmp_path: Path) -> None:
    (tmp_path / "wind.csv").write_text("wind.available\n" + "\n".join(map(str, SERIES["wind.available"])))
    (tmp_path / "s.yaml").write_text(
        """name: s
network:
  buses: {north: {reference: true}, south: {}}
  branches: {tie: {from_bus: north, to_bus: south, r: 0.01, x: 0.05}}
  generators: {coal: {bus: north, p: [0, 90], q: [-50, 50], cost: {c1: 20}}}
  renewables: {wind: {bus: south, available: 30 MW, q: [-10, 10], power_factor: 0.9, curtail_cost: 3 $/MWh}}
  loads: {town: {bus: south, p: 50, q: 10}}
time: {steps: 3}
profiles: [{table: {file: wind.csv}}]
forecast: {noisy: {deviation: 0.2, seed: 1}}
controller:
  horizon: 2
  scenarios: {draw: {number: 20, keep: 3, seed: 1}}
  security: {contingencies: {renewables: [w*]}}
plant: {mode: redispatch, outages: [{renewable: wind, step: 1, hours: 1}]}
"""
    )
    run = om.load_scenario(tmp_path / "s.yaml").simulate()
    assert run.status == "done"
    assert run.data["renewable_p"].values[1] == pytest.approx(0, abs=1e-4)
    assert check(pair(), run.data, SERIES).max_violation < 1e-6


# The rest of the package ---------------------------------------------------------------------------


def test_a_power_flow_injects_what_is_available() -> None:
    flow = om.power_flow(pair(available=95, rating=20))
    assert flow.status == "converged"
    assert flow.data["renewable_p"].values == pytest.approx(20)
    assert flow.data["renewable_curtailed"].values == pytest.approx(75)
    assert "renewable curtailment" in check(pair(available=95, rating=20), flow.data).violations


def test_figures_show_it() -> None:
    data = om.MultiStage(pair(), 4, profiles=SERIES).solve().data
    total = data["pg"].values[:, 0] + data["renewable_p"].values[:, 0]
    assert generation(data) == pytest.approx(total)
    for draw in FIGURES.values():
        labels = {line.get_label() for axis in draw(data).axes for line in axis.lines}
        assert labels
    labels = {line.get_label() for line in FIGURES["system"](data).axes[0].lines}
    assert "of which renewable" in labels


def test_matpower_has_no_renewables(tmp_path: Path) -> None:
    with pytest.raises(CaseError, match="renewables wind: MATPOWER has no such equipment"):
        write_network(pair(), tmp_path / "x.m", lossy=False)


FALSIFIED = {
    "renewable p": {"renewable_p": 5.0},
    "renewable curtailment": {"renewable_curtailed": -1.0},
    "renewable q": {"renewable_q": 9.0},
    "renewable power factor": {"renewable_q": 9.0, "renewable_p": -28.0},
    "renewable rating": {"renewable_p": 4.0},
    "renewable capability": {"renewable_q": -24.0},
    "active balance": {"renewable_p": -1.0},
    "reactive balance": {"renewable_q": -1.0},
}


@pytest.mark.parametrize("family", FALSIFIED)
def test_the_check_finds_falsified_results(family: str) -> None:
    grid = pair(rating=31, capability=((0, -9), (40, -9), (40, 12), (0, 12)))
    data = om.MultiStage(grid, 1).solve().data
    assert check(grid, data).max_violation < 1e-7
    for quantity, change in FALSIFIED[family].items():
        data[quantity] = data[quantity] + change
    assert check(grid, data).violations[family].physical > 0.1


def test_the_check_prices_curtailment() -> None:
    data = om.MultiStage(pair(), 3, formulation="dc", profiles=SERIES).solve().data
    one, other = (check(pair(curtail_cost=cost), data, SERIES).cost for cost in (3, 4))
    assert other - one == pytest.approx(40, rel=1e-6)  # MWh that are not needed in the third hour


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"available": -1}, "available = -1: must be at least 0"),
        ({"available": math.inf}, "available = inf: must be a finite number"),
        ({"power_factor": 0}, "power_factor = 0: must be greater than 0"),
        ({"power_factor": 1.1}, "power_factor = 1.1: must be at most 1"),
        ({"curtail_cost": -2}, "curtail_cost = -2: must be at least 0"),
        ({"rating": -2}, "rating = -2: must be at least 0"),
        ({"q": (5, 9), "rating": 3}, "rating = 3: q needs at least 5 MVA"),
        ({"q": (5, 9), "power_factor": 0.9}, "q = .*: must include 0 with a power_factor"),
        ({"capability": ((5, 0), (9, 1), (9, -1))}, "capability = .*: must admit p = 0"),
        ({"avail": 3}, "unknown field; did you mean"),
    ],
)
def test_bad_values_are_refused(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(ComponentError, match=message):
        om.Renewable("bus", **{"available": 10, **fields}).check("a")


def test_a_negative_availability_over_time_is_refused() -> None:
    with pytest.raises(om.OpfmodelError, match=r"wind.available.*step 1: -1: must be at least 0"):
        om.MultiStage(pair(), 2, profiles={"wind.available": [1, -1]}).solve()
