"""Demand that is shed at a cost: optima known from outside, elastic and secure problems, plants, the check."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import opfmodel as om
from opfmodel.check import check
from opfmodel.errors import CaseWarning, ComponentError, ProfileError
from opfmodel.forecasts import Noisy

DEMAND = {"town.p": [40.0, 70.0, 90.0, 55.0], "town.q": [8.0, 14.0, 18.0, 11.0]}


def grid(shed_cost: float | None = 300.0, capacity: float = 60.0) -> om.Network:
    """A town that the only unit cannot serve in full, and a mill that is never shed."""
    made = om.Network("shedding", base_mva=100)
    made.north = om.Bus(vm=(0.95, 1.05), reference=True)
    made.south = om.Bus(vm=(0.95, 1.05))
    made.tie = om.Branch("north", "south", r=0.001, x=0.01, rating=100)
    made.coal = om.Generator("north", p=(0, capacity), q=(-60, 60), cost=om.Polynomial(0, 20, 0))
    made.town = om.Load("south", p=40, q=8, shed_cost=shed_cost)
    made.mill = om.Load("south", p=5, q=1)
    return made


def test_what_cannot_be_served_is_shed_at_its_cost() -> None:
    plan = om.MultiStage(grid(), 4, formulation="copperplate", profiles=DEMAND).solve()
    shed = plan.data["load_shed"].sel(load="town").values
    assert shed == pytest.approx([0, 15, 35, 0], abs=1e-5)
    assert plan.data["load_shed"].sel(load="mill").values == pytest.approx(0, abs=1e-6)
    assert plan.objective == pytest.approx(20 * (45 + 60 + 60 + 60) + 300 * 50)
    # in the last hour the unit is at its limit, but nothing is shed: any price in between is right
    assert plan.data["lmp"].sel(bus="north").values[:3] == pytest.approx([20, 300, 300], rel=1e-4)


@pytest.mark.parametrize("formulation", ["ac", "ac-rectangular", "soc"])
def test_reactive_demand_is_shed_with_the_active(formulation: str) -> None:
    problem = om.MultiStage(grid(), 4, formulation=formulation, profiles=DEMAND)
    plan = problem.solve()
    town = plan.data.sel(load="town")
    assert plan.optimal
    assert (town["load_shed"].values[1:3] > 14).all()
    assert town["load_shed_q"].values == pytest.approx(0.2 * town["load_shed"].values, abs=1e-6)
    report = check(problem.network, plan.data, DEMAND)
    assert report.max_violation < 1e-6
    assert report.cost == pytest.approx(plan.objective, rel=1e-9)


def test_a_load_is_shed_once_its_price_is_below_that_of_power() -> None:
    """The cost follows its time series."""
    series = {**DEMAND, "town.shed_cost": [10.0, 300.0, 300.0, 19.0]}
    plan = om.MultiStage(grid(capacity=200), 4, formulation="dc", profiles=series).solve()
    assert plan.data["load_shed"].sel(load="town").values == pytest.approx([40, 0, 0, 55], abs=1e-4)
    declared = om.MultiStage(grid(None, capacity=200), 4, formulation="dc", profiles=series).solve()
    assert declared.objective == pytest.approx(plan.objective)  # a series is enough
    assert check(grid(), plan.data, series).cost == pytest.approx(plan.objective)


def test_injections_and_reactive_loads_are_not_shed() -> None:
    network = grid(capacity=200)
    network.sun = om.Load("south", p=-30, shed_cost=0)
    network.coil = om.Load("south", p=0, q=5, shed_cost=0)
    network.swinging = om.Load("south", p=1, shed_cost=0)
    series = {"swinging.p": [4.0, -4.0]}
    plan = om.MultiStage(network, 2, profiles=series).solve()
    shed = plan.data["load_shed"]
    assert shed.sel(load=["sun", "coil"]).values == pytest.approx(0, abs=1e-6)
    assert shed.sel(load="swinging").values == pytest.approx([4, 0], abs=1e-4)
    assert check(network, plan.data, series).max_violation < 1e-6


def test_without_a_cost_nothing_is_declared() -> None:
    for options in ({}, {"elastic": om.Elastic()}):
        problem = om.MultiStage(grid(None), 2, **options)
        program = problem.compile()
        names = {*program.variables, *program.rows, *program.parameters}
        assert not [name for name in names if "shed_" in name or name.startswith("load_")]
        assert "load_shed" not in problem.model.published


# Elastic problems and security --------------------------------------------------------------------


@pytest.mark.parametrize("traded", [False, True])
@pytest.mark.parametrize("price", [300.0, 50_000.0])
def test_shedding_comes_before_shortfalls_unless_these_are_traded(traded: bool, price: float) -> None:
    elastic = om.Elastic(traded=traded)  # 10,000 $/MWh of unserved demand
    problem = om.MultiStage(grid(price), 4, formulation="dc", elastic=elastic, profiles=DEMAND)
    plan = problem.solve()
    shed, unserved = (plan.data[name].sum() for name in ("load_shed", "p_unserved"))
    paid = not (traded and price > 10_000)
    assert (float(shed), float(unserved)) == pytest.approx((50, 0) if paid else (0, 50), abs=1e-3)
    assert bool(plan.shortages) != paid


@pytest.mark.parametrize("formulation", ["dc", "ac"])
def test_shed_and_unserved_demand_do_not_exceed_the_load(formulation: str) -> None:
    """The mill cannot be shed at a cost, so some of it is unserved once all of the town is shed."""
    network = grid(capacity=2)
    problem = om.MultiStage(network, 2, formulation=formulation, elastic=om.Elastic(), profiles=DEMAND)
    plan = problem.solve()
    assert plan.data["load_shed"].sel(load="town").values == pytest.approx([40, 70], abs=1e-3)
    assert plan.data["p_unserved"].sel(load="town").values == pytest.approx(0, abs=1e-3)
    assert plan.data["p_unserved"].sel(load="mill").values == pytest.approx(3, abs=1e-2)
    assert [shortage.component for shortage in plan.shortages if shortage.unit == "MW"] == ["south"]
    assert check(network, plan.data, DEMAND).max_violation < 1e-6


@pytest.mark.parametrize("response", ["corrective", "preventive"])
@pytest.mark.parametrize("formulation", ["dc", "ac"])
def test_an_outage_sheds_nothing_more(response: str, formulation: str) -> None:
    """With one of two lines left, only 30 MW reach the town, so the rest is shed in advance or never."""
    network = grid(capacity=100)
    network.update("tie", rating=30)
    network.second = om.Branch("north", "south", r=0.001, x=0.01, rating=30)
    network.update("town", p=37, q=5)
    security = om.Security(contingencies={"branches": ["second"]}, response=response, screen=False)
    problem = om.MultiStage(network, 2, formulation=formulation, security=security)
    plan = problem.solve()
    shed = plan.solution.value("load_shed")[0] * plan.network.base_mva
    assert shed == pytest.approx(np.full(4, shed[0]), abs=1e-6)
    if formulation == "dc":
        assert shed == pytest.approx(12, abs=1e-3)
    assert shed[0] >= 12 - 1e-3
    screened = problem.with_security(om.Security({"branches": ["second"]}, response=response))
    assert screened.solve().objective == pytest.approx(plan.objective, rel=1e-5)


def test_a_tree_sheds_in_each_scenario_what_it_lacks() -> None:
    horizon = om.Horizon.tree([1, 2], {"low": 0.4, "high": 0.6}, common=1)
    problem = om.MultiStage(grid(), horizon, formulation="copperplate")
    demand = np.array([[0.4, 0.5, 0.8], [0.05, 0.05, 0.05]]) * 100 / problem.arrays.base_mva
    problem = om.MultiStage(grid(), horizon, formulation="copperplate", profiles={"town.p": [40.0] * 3})
    plan = problem.solve(expected={("load", "p"): demand})
    assert plan.data["load_shed"].sel(load="town").values == pytest.approx([0, 0, 25], abs=1e-4)
    expected = 20 * (45 + 2 * (0.4 * 55 + 0.6 * 60)) + 300 * 2 * 0.6 * 25
    assert plan.objective == pytest.approx(expected)


# Plants, power flow, results ----------------------------------------------------------------------


@pytest.mark.parametrize("plant", [om.PowerFlow(), om.Redispatch(), om.NominalPlant()])
def test_a_plant_sheds_the_planned_share(plant: om.Plant) -> None:
    problem = om.MultiStage(grid(), 1, profiles=DEMAND)
    forecast = None if isinstance(plant, om.NominalPlant) else Noisy(deviation=0.03, seed=3)
    run = om.simulate(om.Controller(problem, forecast), plant, steps=4)
    town = run.data.sel(load="town")
    shed, real = town["load_shed"].values, np.array(DEMAND["town.p"])
    assert run.status == "done"
    assert run.summary()["shed_mwh"] == pytest.approx(float(shed.sum()), abs=1e-3)
    assert shed[1:3] == pytest.approx([15, 35], rel=0.25)
    assert town["load_shed_q"].values == pytest.approx(0.2 * shed, abs=1e-6)
    if forecast is not None and isinstance(plant, om.PowerFlow):
        for step, step_shed in enumerate(shed):
            ahead = forecast.expected(problem.profiles, step, 1)
            plan = problem.solve(step, expected=problem.expected([ahead]))
            share = plan.data["load_shed"].sel(load="town").values[0] / ahead["town.p"][0]
            assert step_shed == pytest.approx(share * real[step], abs=1e-3)
    report = check(problem.network, run.data, DEMAND)
    families = {name: v.physical for name, v in report.violations.items() if not name.startswith("generator")}
    assert max(families.values()) < 1e-4
    assert report.cost == pytest.approx(run.cost, rel=1e-9)


def test_a_power_flow_serves_every_load() -> None:
    flows = [om.power_flow(grid(cost)) for cost in (None, 300.0)]
    assert [flow.status for flow in flows] == ["converged"] * 2
    assert flows[0].slack == pytest.approx(flows[1].slack)


def test_the_figures_show_what_is_shed(tmp_path: Path) -> None:
    from opfmodel.results.figures import demand, system

    plan = om.MultiStage(grid(), 4, formulation="dc", profiles=DEMAND).solve()
    for draw in (system, demand):
        lines = {line.get_label(): line for axis in draw(plan.data).axes for line in axis.get_lines()}
        assert max(lines["shed demand"].get_ydata()) == pytest.approx(35, abs=1e-3)


def test_a_writer_reports_the_cost_as_lost(tmp_path: Path) -> None:
    with pytest.warns(CaseWarning, match="town: shed_cost"):
        om.write_network(grid(), tmp_path / "case.m")


# Errors --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "family"),
    [
        ({"load_shed": 3.0}, "active balance"),
        ({"load_shed": 80.0}, "load shed"),
        ({"load_shed": -1.0}, "load shed"),
        ({"load_shed_q": 2.0}, "load shed power factor"),
        ({"p_unserved": 60.0}, "load shed and unserved"),
    ],
)
def test_the_check_finds_falsified_data(change: dict[str, float], family: str) -> None:
    problem = om.MultiStage(grid(), 2, profiles=DEMAND, elastic=om.Elastic())
    data = problem.solve().data.copy(deep=True)
    assert check(problem.network, data, DEMAND).max_violation < 1e-6
    for name, value in change.items():
        data[name].loc[{"load": "town", "time": 0.0}] += value
    assert check(problem.network, data, DEMAND).violations[family].value > 1e-3


def test_the_check_finds_a_load_without_a_cost_that_is_shed() -> None:
    problem = om.MultiStage(grid(), 2, profiles=DEMAND)
    data = problem.solve().data.copy(deep=True)
    data["load_shed"].loc[{"load": "mill"}] = 1.0
    worst = check(problem.network, data, DEMAND).violations["load shed"]
    assert (worst.component, worst.physical) == ("mill", pytest.approx(1.0))


@pytest.mark.parametrize("value", [-1.0, float("nan"), "much"])
def test_a_bad_cost_is_named(value: object) -> None:
    with pytest.raises(ComponentError, match=r"town: shed_cost = .*: must be"):
        grid(value)  # type: ignore[arg-type]
    if isinstance(value, float):
        with pytest.raises(ProfileError, match=r"town\.shed_cost"):
            om.MultiStage(grid(), 2, profiles={"town.shed_cost": [value, 1.0]})


def test_a_scenario_file_sheds(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text("""
network:
  buses: {a: {}}
  generators: {g: {bus: a, p: [0, 9], cost: {c1: 10}}}
  loads: {l: {bus: a, p: 12, shed_cost: 500}}
controller: {horizon: 2, formulation: copperplate}
time: {steps: 2}
""")
    run = om.load_scenario(tmp_path / "s.yaml").simulate()
    assert run.cost == pytest.approx(2 * (9 * 10 + 3 * 500), rel=1e-6)
