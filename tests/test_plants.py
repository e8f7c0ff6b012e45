"""AC plants: the physical state that follows from a plan, against published power flows and the check."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
import xarray as xr
from conftest import DATA, SCENARIOS, demand, everything, examples, two_bus
from hypothesis import given
from hypothesis import strategies as st

import opfmodel as om
from opfmodel.check import check, losses
from opfmodel.errors import ModelError, ScenarioError
from opfmodel.forecasts import Noisy, Persistence
from opfmodel.model import Device, Model
from opfmodel.network import Component, at_bus, span
from opfmodel.network.arrays import Table
from opfmodel.plan import compiled as plan_module
from opfmodel.simulation import Run, Step

PLANTS = [om.PowerFlow, om.Redispatch]
Series = dict[str, np.ndarray]


def case5(formulation: str, delay: int = 1) -> om.Scenario:
    overrides = {
        "time.steps": 4,
        "controller.horizon": 6,
        "controller.formulation": formulation,
        "controller.generator_delay": delay,
    }
    return om.load_scenario(SCENARIOS / "case5-step.yaml", overrides=overrides)


def looped(scenario: om.Scenario, plant: om.Plant | None) -> Run:
    return om.simulate(
        scenario.problem, plant, scenario.steps, initial=scenario.initial(), objective=scenario.cost
    )


def series(scenario: om.Scenario) -> Series:
    return scenario.profiles


def unhurried() -> om.Network:
    """The grid with everything but ramps."""
    grid = everything()
    grid.update("cheap", ramp=None)
    return grid


# Exact plans --------------------------------------------------------------------------------------


@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize("plant", PLANTS)
def test_an_exact_plan_is_changed_by_nothing(plant: type, delay: int) -> None:
    scenario = case5("ac", delay)
    nominal, run = looped(scenario, None), looped(scenario, plant())
    data = run.data
    assert run.status == "done"
    assert float(data["pg_redispatch"].max()) / 100 < 1e-5
    assert float(data["ps_redispatch"].max()) / 100 < 1e-5
    assert run.cost == pytest.approx(nominal.cost, rel=1e-6)
    for name in ("vm", "va", "qg", "e_next"):
        assert data[name].values == pytest.approx(nominal.data[name].values, abs=2e-3)
    assert check(scenario.network, data, series(scenario)).max_violation <= 1e-6
    assert run.summary()["violated_steps"] == 0


@pytest.mark.parametrize("plant", PLANTS)
def test_a_grid_without_generators_lives_on_its_stores(plant: type) -> None:
    grid = two_bus()
    grid.remove("coal")
    grid.update("cell", bus="north", q=(-60, 60))
    grid.update("town", p=5, q=2)
    problem = om.MultiStage(grid, 2, objective=om.LossMinimisation(1.0))
    run = om.simulate(problem, plant(), 2)
    assert run.status == "done"
    assert run.summary()["unsolved_steps"] == 0
    assert check(grid, run.data).max_violation <= 1e-6


# Simplified plans -----------------------------------------------------------------------------------


@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize("formulation", ["dc", "dc-losses", "copperplate", "soc"])
def test_power_flow_measures_what_the_check_finds(formulation: str, delay: int) -> None:
    scenario = case5(formulation, delay)
    run = looped(scenario, om.PowerFlow())
    data, summary = run.data, run.summary()
    assert run.status == "done"
    assert data.attrs["formulation"] == "ac"
    assert data.attrs["controller_formulation"] == formulation
    found = check(scenario.network, data, series(scenario)).violations
    for family in ("active balance", "reactive balance", "reported flow", "storage dynamics"):
        assert found[family].value < 1e-6
    for family, name in (
        ("voltage", "vm_excess"),
        ("branch rating", "flow_excess"),
        ("generator p", "pg_excess"),
        ("generator q", "qg_excess"),
        ("ramp", "ramp_excess"),
    ):
        unit = 1.0 if name == "vm_excess" else 100.0
        assert float(data[name].max()) / unit == pytest.approx(found[family].value, abs=1e-9)
        assert summary[f"largest_{name}"] == pytest.approx(float(data[name].max()))
    assert summary["violated_steps"] > 0
    assert summary["redispatched_mwh"] == pytest.approx(
        float(data["pg_redispatch"].sum() + data["ps_redispatch"].sum())
    )


@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize("formulation", ["dc", "dc-losses", "copperplate", "soc"])
def test_redispatch_keeps_every_limit(formulation: str, delay: int) -> None:
    scenario = case5(formulation, delay)
    run = looped(scenario, om.Redispatch())
    data, summary = run.data, run.summary()
    assert run.status == "done"
    report = check(scenario.network, data, series(scenario))
    assert report.max_violation < 2e-6, str(report)
    assert np.isfinite(summary["redispatched_mwh"])
    # reactive power and voltages can be chosen to give the losses that dc-losses predicts
    assert summary["redispatched_mwh"] > 1 or formulation == "dc-losses"
    assert summary["shed_mwh"] == pytest.approx(0, abs=1e-2)
    assert summary["violated_steps"] == 0
    assert data["e"].values[1:] == pytest.approx(data["e_next"].values[:-1], abs=1e-9)


def test_redispatch_changes_less_than_any_other_feasible_state() -> None:
    """The AC optimum of the same stage is feasible too, so it cannot be nearer to the set-points."""
    scenario = case5("dc", 0)
    problem = scenario.problem
    plan = problem.solve(0)
    step = om.Redispatch().apply(plan)
    exact = om.MultiStage(scenario.network, profiles=scenario.profiles).solve(0).quantities()
    planned = plan.quantities()

    def distance(values: dict[tuple[str, str], np.ndarray]) -> float:
        return sum(
            float(np.abs(values[key].ravel() - planned[key][:, 0]).sum())
            for key in (("generator", "pg"), ("storage", "ps"))
        )

    assert 0 < distance(dict(step.values)) < distance(exact)


@pytest.mark.slow
@pytest.mark.parametrize("plant", PLANTS)
def test_a_dc_controller_of_118_buses(plant: type) -> None:
    overrides = {"time.steps": 3, "controller.horizon": 4, "controller.formulation": "dc"}
    scenario = om.load_scenario(SCENARIOS / "case118-step.yaml", overrides=overrides)
    run = looped(scenario, plant())
    summary = run.summary()
    assert run.status == "done"
    assert summary["unsolved_steps"] == 0
    assert summary["redispatched_mwh"] > 100
    found = check(scenario.network, run.data, series(scenario)).violations
    assert found["active balance"].value < 1e-6
    assert found["generator q"].value == pytest.approx(summary["largest_qg_excess"] / 100, abs=1e-6)
    assert (summary["violated_steps"] == 3) == (plant is om.PowerFlow)


# The power flow -------------------------------------------------------------------------------------


def power_flow(grid: om.Network, dispatch: dict[str, float], voltage: dict[str, float], slack: str) -> Step:
    """The power flow for a given dispatch and generator voltages, from a plan without any freedom."""
    for name, power in dispatch.items():
        if name != slack:
            grid.update(name, p=(power, power))
    for bus, vm in voltage.items():
        grid.update(bus, vm=(vm, vm))  # without planned voltages, those of the bus are held
    plan = om.MultiStage(grid, formulation="dc").solve()
    return om.PowerFlow({slack: 1.0}).apply(plan)


def test_the_power_flow_of_the_textbook() -> None:
    """The nine-bus system of Anderson and Fouad, Power System Control and Stability, figure 2.18."""
    grid = om.read_network(DATA / "matpower" / "case9.m")
    slack, second, third = grid.of(om.Generator)
    step = power_flow(
        grid, {second: 163.0, third: 85.0}, {"1": 1.04, "2": 1.025, "3": 1.025}, slack
    )  # fmt: skip
    # buses 5 to 9 of the file are 6, 9, 8, 7, 5 of the book
    vm = [1.04, 1.025, 1.025, 1.026, 1.013, 1.032, 1.016, 1.026, 0.996]
    va = [0.0, 9.3, 4.7, -2.2, -3.7, 2.0, 0.7, 3.7, -4.0]
    assert step.values["bus", "vm"] == pytest.approx(vm, abs=6e-4)
    assert np.rad2deg(step.values["bus", "va"]) == pytest.approx(va, abs=0.06)
    assert 100 * step.values["generator", "pg"] == pytest.approx([71.6, 163, 85], abs=0.06)
    assert 100 * step.values["generator", "qg"] == pytest.approx([27.0, 6.7, -10.9], abs=0.1)


def matpower_table(path: Path, table: str) -> np.ndarray:
    text = re.search(rf"mpc\.{table} = \[(.*?)\];", path.read_text(), re.DOTALL)
    assert text is not None
    return np.array([[float(v) for v in row.split()] for row in text[1].strip().rstrip(";").split(";")])


def test_the_losses_of_118_buses() -> None:
    """132.863 MW at the dispatch and voltages of the file, the base case in reactive-dispatch papers."""
    path = SCENARIOS / "data" / "case118.m"
    units = matpower_table(path, "gen")
    grid = om.read_network(path)
    names = list(grid.of(om.Generator))
    buses = [grid[name].buses[0] for name in names]
    slack = names[buses.index("69")]
    step = power_flow(
        grid, dict(zip(names, units[:, 1], strict=True)), dict(zip(buses, units[:, 5], strict=True)), slack
    )
    branch = step.values["branch", "pf"] + step.values["branch", "pt"]
    assert 100 * branch.sum() == pytest.approx(132.863, abs=2e-3)


@examples(5)
@given(
    scale=st.lists(st.floats(0.4, 1.15), min_size=2, max_size=2),
    factors=st.tuples(st.floats(0, 5), st.floats(0.1, 5)),
    formulation=st.sampled_from(["dc", "soc", "copperplate"]),
)
def test_power_flow_balances_every_bus(
    scale: list[float], factors: tuple[float, float], formulation: str
) -> None:
    grid = unhurried()
    what = {"town.p": 40 * scale[0], "town.q": 12 * scale[0], "mill.p": 25 * scale[1], "mill.q": 8 * scale[1]}
    happens = {key: np.full(3, value) for key, value in what.items()}
    share = dict(zip(("cheap", "dear"), factors, strict=True))
    run = om.simulate(
        om.MultiStage(grid, 2, formulation=formulation, profiles=happens), om.PowerFlow(share), 2
    )
    data = run.data
    found = check(grid, data, happens).violations
    for family in (
        "active balance",
        "reactive balance",
        "reported flow",
        "storage dynamics",
        "energy continuity",
    ):
        assert found[family].value < 1e-6
    balance = (
        data["pg"].sum("generator")
        - data["pd"].sum("bus")
        - data["ps"].sum("storage")
        - grid.capacitor.g * data["vm"].sel(bus="d") ** 2
    )
    assert losses(grid, data) == pytest.approx(balance.values, abs=1e-4)
    change = data["pg_redispatch"].values
    total = change.sum(axis=1, keepdims=True)
    assert change == pytest.approx(total * np.array(factors) / sum(factors), abs=1e-4)


def test_by_default_units_take_part_in_proportion_to_their_capacity() -> None:
    grid = unhurried()
    problem = om.MultiStage(grid, 2, formulation="dc", profiles=demand(3))
    change = om.simulate(problem, om.PowerFlow(), 2).data["pg_redispatch"].values
    assert change[:, 0] / change[:, 1] == pytest.approx([60 / 50] * 2, rel=1e-6)


def test_voltages_of_a_plan_are_held_where_there_are_generators() -> None:
    grid = unhurried()
    problem = om.MultiStage(grid, 2, profiles=demand(3))
    plan = problem.solve()
    disturbed = Noisy(0.1, seed=2)
    run = om.simulate(om.Controller(problem, disturbed), om.PowerFlow(), 1)
    seen = om.Controller(problem, disturbed).plan(0, None)
    assert run.data["vm"].sel(bus=["a", "c"]).values[0] == pytest.approx(
        seen.data["vm"].sel(bus=["a", "c"]).values[0], abs=1e-9
    )
    assert float(np.abs(run.data["vm"].sel(bus="d") - plan.data["vm"].sel(bus="d"))[0]) > 1e-5


def test_limits_with_time_series_are_measured_not_enforced() -> None:
    series = {
        "tie.rating": [200.0, 40.0, 200.0, 40.0],
        "south.vm_min": [1.02, 1.02, 0.9, 0.9],
        "south.vm_max": [1.03, 1.03, 1.1, 1.1],
        "town.p": [90.0] * 4,
    }
    grid = two_bus()
    run = om.simulate(om.MultiStage(grid, 1, formulation="copperplate", profiles=series), om.PowerFlow(), 4)
    assert run.status == "done"
    free = om.simulate(
        om.MultiStage(grid, 1, formulation="copperplate", profiles={"town.p": [90.0] * 4}), om.PowerFlow(), 4
    )
    for name in ("vm", "pf", "pg"):
        assert run.data[name].values == pytest.approx(free.data[name].values, abs=1e-6)
    apparent = np.hypot(run.data["pf"], run.data["qf"]).values[:, 0]
    assert apparent.min() > 60
    assert run.data["flow_excess"].values[[1, 3], 0] == pytest.approx(apparent[[1, 3]] - 40, abs=1.0)
    assert run.data["flow_excess"].values[[0, 2], 0] == pytest.approx(0)
    south = run.data["vm"].sel(bus="south").values
    assert run.data["vm_excess"].sel(bus="south").values[:2] == pytest.approx(1.02 - south[:2])
    assert run.data["vm_excess"].sel(bus="south").values[2:] == pytest.approx(0)


def test_a_power_flow_without_solution_is_recorded_and_the_loop_goes_on() -> None:
    grid = two_bus()
    grid.update("coal", p=(0, 9000), ramp=None)
    grid.update("tie", rating=None)
    problem = om.MultiStage(grid, 2, formulation="dc", profiles={"town.p": [90, 3000, 90, 90]})
    run = om.simulate(problem, om.PowerFlow(), 3)
    assert run.status == "unsolved"
    assert run.termination.startswith("the plant found no solution in 1 of 3 steps, first in step 1: locally")
    assert [word == "locally_optimal" for word in run.data["plant_status"].values] == [True, False, True]
    assert np.isnan(run.data["vm"].values[1]).all()
    assert np.isnan(run.data["flow_excess"].values[1]).all()
    assert np.isfinite(run.data["vm"].values[[0, 2]]).all()
    assert np.isfinite(run.cost_rate).tolist() == [True, False, True]
    assert np.isnan(run.cost)
    assert "no cost" in repr(run)
    summary = run.summary()
    assert summary["unsolved_steps"] == 1
    assert summary["cost"] is None
    json.dumps(summary, allow_nan=False)


@pytest.mark.parametrize(("reactive", "unsolved"), [(0.0, 0), (3.0, 1)])
def test_an_island_without_generators_must_balance_by_itself(reactive: float, unsolved: int) -> None:
    grid = two_bus()
    grid.away = om.Bus()
    grid.hut = om.Load("away", p=5.0, q=reactive)
    grid.battery = om.Storage("away", energy=100, power=10)
    run = om.simulate(om.MultiStage(grid, formulation="dc"), om.PowerFlow(), 1)
    assert run.status == ("unsolved" if unsolved else "done")
    assert run.summary()["unsolved_steps"] == unsolved


def test_a_unit_without_limits_takes_the_slack() -> None:
    grid = two_bus()
    grid.grid_supply = om.Generator("north", p=(0, np.inf), cost=om.Polynomial(0, 99, 0))
    run = om.simulate(om.MultiStage(grid, formulation="dc"), om.PowerFlow(), 1)
    change, reactive = run.data["pg_redispatch"].values[0], run.data["qg"].values[0]
    assert change[1] > 100 * change[0] > 0
    assert reactive[1] > 100 * reactive[0]


def test_participation_names_generators() -> None:
    plan = om.MultiStage(two_bus(), formulation="dc").solve()
    with pytest.raises(ModelError, match="no generator in service is named 'cole'; did you mean 'coal'"):
        om.PowerFlow({"cole": 1.0}).apply(plan)
    with pytest.raises(ModelError, match=r"participation: coal = -1: .* at least 0"):
        om.PowerFlow({"coal": -1})


# Scarcity -------------------------------------------------------------------------------------------

SURPRISE = {"town.p": [90.0, 90.0, 260.0, 90.0, 90.0, 90.0]}


def strong() -> om.Network:
    grid = two_bus()
    grid.update("coal", ramp=None)
    grid.update("tie", rating=None)
    return grid


def test_redispatch_sheds_what_it_cannot_serve() -> None:
    grid = strong()
    problem = om.MultiStage(grid, 2, profiles=SURPRISE)
    controller = om.Controller(problem, Persistence(), on_infeasible="elastic")
    run = om.simulate(controller, om.Redispatch(), 4)
    data, summary = run.data, run.summary()
    assert run.status == "done"
    unserved = data["p_unserved"].values[:, 0]
    assert unserved[[0, 1, 3]] == pytest.approx(0, abs=1e-2)
    # unit and storage give their maximum; the unserved demand keeps the power factor 90:30
    assert float(data["pg"][2, 0]) - float(data["ps"][2, 0]) <= 210 + 1e-3
    assert unserved[2] > 50
    assert data["q_unserved"].values[2, 0] == pytest.approx(unserved[2] * 30 / 260, rel=1e-6)
    report = check(grid, data, SURPRISE)
    assert report.violations["active balance"].value < 1e-6
    assert report.unserved["p unserved"].value == pytest.approx(unserved[2] / 100)
    assert report.max_violation < 1e-5  # no limit is exceeded
    assert summary["shed_mwh"] == pytest.approx(unserved.sum(), abs=0.05)
    assert summary["elastic_steps"] == 1  # step 3 is forecast as observed at step 2
    assert list(summary["diagnosis"]) == ["3"]


def test_power_flow_serves_it_at_the_expense_of_limits_unless_shedding_was_planned() -> None:
    grid = strong()
    surprised = om.Controller(om.MultiStage(grid, 2, profiles=SURPRISE), Persistence(), "elastic")
    run = om.simulate(surprised, om.PowerFlow(), 3)
    assert run.data["p_unserved"].values == pytest.approx(0)
    assert float(run.data["pg_excess"].max()) > 50
    warned = om.Controller(om.MultiStage(grid, 2, profiles=SURPRISE), None, "elastic")
    run = om.simulate(warned, om.PowerFlow(), 3)
    assert run.data["p_unserved"].values[2, 0] > 50
    assert float(run.data["pg_excess"].max()) < 1e-2
    assert check(grid, run.data, SURPRISE).violations["active balance"].value < 1e-6


def test_limits_are_exceeded_when_shedding_is_dearer() -> None:
    grid = two_bus()
    grid.update("coal", ramp=None)
    series = {"town.p": [90.0, 90.0, 150.0, 90.0]}
    runs = []
    for options in ({"shedding_price": 1e3}, {"shedding_price": 1e5, "violation_price": 1e4}):
        controller = om.Controller(om.MultiStage(grid, 2, profiles=series), Persistence())
        runs.append(om.simulate(controller, om.Redispatch(**options), 3).summary())
    assert runs[0]["shed_mwh"] > 10
    assert runs[0]["largest_flow_excess"] == pytest.approx(0, abs=1e-3)
    assert runs[1]["shed_mwh"] == pytest.approx(0, abs=1e-2)
    assert runs[1]["largest_flow_excess"] > 10


@pytest.mark.parametrize("plant", PLANTS)
def test_what_is_not_available_is_not_generated_and_what_is_not_used_is_curtailed(plant: type) -> None:
    grid = strong()
    grid.wind = om.Generator("south", p=(0, 60), q=(0, 0))
    grid.update("tie", rating=120)
    series = {
        "wind.p_max": [60.0, 20.0, 60.0, 60.0],
        "town.p": [90.0, 90.0, 40.0, 90.0],
        "town.q": [30.0] * 4,
    }
    problem = om.MultiStage(grid, 1, formulation="dc", profiles=series)
    run = om.simulate(
        om.Controller(problem, Persistence()), plant({"coal": 1.0}) if plant is om.PowerFlow else plant(), 4
    )
    wind = run.data["pg"].sel(generator="wind").values
    available = np.array(series["wind.p_max"])
    assert (wind <= available + 1e-4).all()
    curtailed = run.data["pg_curtailed"].sel(generator="wind").values
    assert curtailed == pytest.approx(np.maximum(available - wind, 0), abs=1e-9)
    assert run.data["pg_curtailed"].sel(generator="coal").values == pytest.approx(0)
    assert run.summary()["curtailed_mwh"] == pytest.approx(curtailed.sum(), abs=1e-2)
    assert curtailed[2] > 15  # of 60 MW at step 2, 20 were forecast


# From step to step ----------------------------------------------------------------------------------


def test_without_delay_the_next_plan_starts_from_what_was_really_generated() -> None:
    grid = two_bus()
    problem = om.MultiStage(grid, 3, formulation="dc", profiles={"town.p": [60, 70, 80, 80, 80]})
    plant, controller = om.PowerFlow(), om.Controller(problem)
    first = plant.apply(controller.plan(0, None))
    assert first.state["pg"] == pytest.approx(first.values["generator", "pg"] * 100)
    assert first.state["pg"] != pytest.approx(controller.plan(0, None).data["pg"].values[0], abs=1e-3)
    second = controller.plan(1, first.state)
    assert abs(float(second.data["pg"][0, 0]) - first.state["pg"][0]) <= 20 + 1e-6


def test_with_delay_the_committed_dispatch_stays() -> None:
    scenario = case5("dc", 1)
    plan = scenario.problem.solve(0, scenario.initial())
    step = om.PowerFlow().apply(plan)
    assert step.state["pg"] == pytest.approx(plan.data["pg"].values[1])
    assert step.state["e"] == pytest.approx(plan.data["e"].values[1])


def test_a_slack_beyond_a_limit_is_not_handed_on() -> None:
    grid = strong()
    problem = om.MultiStage(grid, 1, profiles=SURPRISE)
    controller = om.Controller(problem, Persistence())
    step = om.PowerFlow().apply(controller.plan(2, None))
    assert step.values["generator", "pg"][0] > 2.2
    assert step.state["pg"] == pytest.approx([200])


@pytest.mark.parametrize("plant", PLANTS)
def test_stores_with_losses(plant: type) -> None:
    grid = unhurried()
    happens = demand(6)
    run = om.simulate(om.MultiStage(grid, 3, formulation="dc", profiles=happens), plant(), 4)
    report = check(grid, run.data, happens)
    assert report.violations["storage dynamics"].value < 1e-6
    assert report.violations["energy continuity"].value < 1e-9
    assert report.simultaneous < 1e-5


@pytest.mark.parametrize("plant", PLANTS)
def test_a_plant_is_compiled_once_and_serves_runs_one_after_the_other(
    plant: type, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiled = []
    prepare = plan_module.prepare
    monkeypatch.setattr(plan_module, "prepare", lambda *a: compiled.append(a) or prepare(*a))
    grid = unhurried()
    problem = om.MultiStage(grid, 2, formulation="dc", profiles=demand(5))
    used = plant()
    first, second = (om.simulate(problem, used, 3) for _ in range(2))
    assert len(compiled) == 2  # the controller's problem and the plant's
    assert second.cost == pytest.approx(first.cost, rel=1e-6)
    assert float(second.data["ramp_excess"][0].max()) == 0.0


# Scenarios and files ----------------------------------------------------------------------------------


def test_records_are_saved(tmp_path: Path) -> None:
    from opfmodel.results import load, save

    run = looped(case5("dc"), om.PowerFlow())
    save(run.data, run.summary(), tmp_path)
    data: xr.Dataset = load(tmp_path)
    for name in ("vm_excess", "flow_excess", "angle_excess", "qg_excess", "pg_redispatch", "ps_redispatch"):
        assert name in data
        assert data[name].attrs["units"]
        assert data[name].attrs["long_name"]
    assert set(data["plant_status"].values) == {"locally_optimal"}
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert {"redispatched_mwh", "shed_mwh", "curtailed_mwh", "violated_steps"} <= set(summary)


def scenario(**overrides: object) -> om.Scenario:
    keys = {key.replace("__", "."): value for key, value in overrides.items()}
    return om.load_scenario(SCENARIOS / "case5-step.yaml", overrides=keys)


def test_a_scenario_names_its_plant() -> None:
    assert isinstance(scenario().plant(), om.NominalPlant)
    plant = scenario(plant__mode="power-flow", plant__participation={"gen1": 2}).plant()
    assert isinstance(plant, om.PowerFlow)
    assert plant.participation == {"gen1": 2}
    plant = scenario(plant={"mode": "redispatch", "shedding_price": 500.0, "violation_price": 900.0}).plant()
    assert isinstance(plant, om.Redispatch)
    assert (plant.elastic.shedding, plant.elastic.limit) == (500, 900)


@pytest.mark.parametrize(
    ("plant", "message"),
    [
        ({"mode": "ac"}, "plant.mode: there is no plant 'ac'; available: nominal, power-flow, redispatch"),
        (
            {"shedding_price": 5.0},
            "plant.shedding_price: plant 'nominal' has no option 'shedding_price'; available: known, minutes, mode",
        ),
        (
            {"mode": "power-flow", "price": 5.0},
            "plant.price: plant 'power-flow' has no option 'price'; available: known, minutes, mode, outages, participation",
        ),
        (
            {"mode": "redispatch", "price": -5.0},
            "plant: redispatch: price = -5.0: must be a finite number, above 0",
        ),
        ({"mode": "power-flow", "participation": {"gen9": 1.0}}, "no generator in service is named 'gen9'"),
        ({"mood": "redispatch"}, "plant.mood: plant 'nominal' has no option 'mood'; did you mean 'mode'"),
    ],
)
def test_mistakes_in_a_plant(plant: dict[str, object], message: str) -> None:
    with pytest.raises(ScenarioError, match=re.escape(message)):
        scenario(plant=plant)


# Devices of other packages ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Heater(Component):
    """A flexible demand."""

    kind: ClassVar[str] = "heater"
    plural: ClassVar[str] = "heaters"

    bus: str = at_bus()
    power: tuple[float, float] = span("MW")
    in_service: bool = field(default=True, metadata={"form": "flag", "unit": ""})


class HeaterDevice(Device):
    component = Heater

    def declare(self, model: Model, table: Table) -> None:
        heat = model.variable("heater", "heat", "power_min", "power_max", unit="MW", description="heat")
        model.inject(table.bus, p=-heat)


@pytest.mark.parametrize("plant", PLANTS)
def test_devices_of_others_keep_their_set_points(plant: type) -> None:
    grid = strong()
    grid.boiler = Heater("south", power=(12, 20))
    devices = [*om.MultiStage(strong()).devices, HeaterDevice()]
    run = om.simulate(om.MultiStage(grid, 2, formulation="dc", devices=devices), plant(), 1)
    assert run.data["heat"].values[0, 0] == pytest.approx(12, abs=1e-3)
    used = run.data["pg"].sum("generator") - run.data["pd"].sum("bus") - run.data["ps"].sum("storage")
    assert float(used[0]) == pytest.approx(12 + float(losses(grid, run.data)[0]), abs=1e-3)
