"""One grid with equipment of every kind: every formulation, horizon and plant, against the independent check."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import opfmodel as om
from opfmodel import plugins
from opfmodel.check import check
from opfmodel.forecasts import Noisy
from opfmodel.network.components import BUILT_IN

STEPS = 12
WAVE = 1.0 + 0.3 * np.sin(np.arange(STEPS) * np.pi / 6)
PROFILES = {
    "town.p": 60 * WAVE,
    "town.q": 15 * WAVE,
    "sun.available": 25 * np.maximum(np.sin((np.arange(STEPS) + 1) * np.pi / 12), 0),
    "trade.buy": 30 + 20 * WAVE,
    "trade.sell": 10 + 5 * WAVE,
    "spinning.requirement": 6 + 2 * WAVE,
    "peaker.slope_2": 60 + 10 * WAVE,
    "old.on": (np.arange(STEPS) % 6 < 4).astype(float),
}
FORMULATIONS = sorted(name for name, p in plugins.plugins("formulation").items() if p.origin == "opfmodel")


def everything() -> om.Network:
    """Return two AC islands with a DC line between them and every kind of equipment."""
    grid = om.Network("everything", base_mva=100)
    for name in ("north", "east", "south"):
        grid.add(name, om.Bus(vm=(0.94, 1.06), reference=name == "north"))
    grid.isle = om.Bus(vm=(0.94, 1.06), reference=True)
    grid.line = om.Branch("north", "south", r=0.01, x=0.08, rating=90)
    grid.line2 = om.Branch("north", "south", r=0.01, x=0.09, rating=90)
    grid.tie = om.Branch("east", "south", r=0.02, x=0.1, rating=60, angle=(-30, 30))
    grid.trafo = om.Branch(
        "north",
        "east",
        r=0.005,
        x=0.12,
        rating=80,
        tap=(0.92, 1.08),
        tap_steps=17,
        shift=(-10, 10),
        move_cost=2,
    )
    grid.coal = om.Generator(
        "north",
        p=(10, 90),
        q=(-50, 50),
        ramp=60,
        cost=om.Polynomial(0.02, 22, 10),
        capability=((0, -50), (60, -50), (90, -30), (90, 30), (60, 50), (0, 50)),
    )
    grid.peaker = om.Generator(
        "south", p=(0, 40), q=(-20, 20), cost=om.PiecewiseLinear(((0, 0), (20, 900), (40, 2200)))
    )
    grid.old = om.Generator("east", p=(2, 15), q=(-8, 8), cost=om.Polynomial(0, 35, 20))
    grid.sun = om.Renewable("east", available=20, q=(-8, 8), power_factor=0.9, curtail_cost=1)
    grid.cell = om.Storage(
        "south",
        energy=40,
        power=12,
        q=6,
        charge_efficiency=0.95,
        discharge_efficiency=0.95,
        throughput_cost=1,
        wanted=22,
        wanted_at=6,
        wanted_every=12,
        recovery_cost=200,
    )
    grid.trade = om.Connection("south", p=(-20, 40), q=(-10, 10), buy=40, sell=20, peak_cost=30)
    grid.town = om.Load("south", p=60, q=15)
    grid.mill = om.Load("east", p=12, q=4, shed_cost=300)
    grid.village = om.Load("isle", p=8, q=2, shed_cost=900)
    grid.diesel = om.Generator("isle", p=(0, 12), q=(-8, 8), cost=om.Polynomial(0, 90, 0))
    grid.cars = om.FlexibleLoad(
        "east",
        energy=9,
        power=(0, 5),
        begin=2,
        hours=5,
        every=6,
        efficiency=0.95,
        power_factor=0.97,
        unserved_cost=500,
    )
    grid.capacitor = om.Shunt("south", g=0.2, b=(0, 12), steps=3, move_cost=1)
    grid.cable = om.DCLine(
        "south", "isle", p=(-10, 15), loss=0.03, loss_fixed=0.1, q_from=(-4, 4), q_to=(-4, 4), cost=0.5
    )
    grid.spinning = om.Reserve(8, minutes=15, hours=0.5, lacking_cost=800, cost={"cell": 1})
    grid.falling = om.Reserve(4, "down", minutes=30)
    grid.co2 = om.Budget(500, uses={"coal": 0.9, "peaker": 0.5}, hours=STEPS, over_cost=60)
    grid.cycles = om.Budget(120, uses={"cell": 1}, hours=STEPS)
    return grid  # fmt: skip


def worst(grid: om.Network, data: object, **options: object) -> str:
    """Return the worst violation of a trajectory, empty within the tolerance; everything must be checked."""
    report = check(grid, data, PROFILES, **options)  # type: ignore[arg-type]
    assert not report.unchecked
    return "" if report.max_violation < 1e-6 else f"{report.worst}\n{report}"


@cache
def planned(formulation: str, horizon: str = "chain") -> om.Plan:
    horizons: dict[str, om.Horizon | int] = {
        "chain": 6,
        "uneven": om.Horizon.grid([1, 1, 2, 1, 1]),
        "tree": om.Horizon.tree([1, 1, 1], {"low": 0.4, "high": 0.6}, common=1),
    }
    return om.MultiStage(everything(), horizons[horizon], formulation=formulation, profiles=PROFILES).solve()


def test_the_grid_has_every_kind() -> None:
    assert {type(everything()[name]) for name in everything()} == set(BUILT_IN)


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_every_formulation_satisfies_the_check_and_its_cost(formulation: str) -> None:
    plan = planned(formulation)
    assert plan.optimal, plan.termination
    assert worst(everything(), plan.data) == ""
    assert check(everything(), plan.data, PROFILES).cost == pytest.approx(plan.objective, rel=1e-6)


def test_relaxations_are_lower_bounds() -> None:
    cost = {name: planned(name).objective for name in ("ac", "ac-rectangular", "soc", "dc", "copperplate")}
    assert cost["ac"] == pytest.approx(cost["ac-rectangular"], rel=1e-5)
    continuous = planned("ac").rounded_from
    assert continuous is not None
    assert cost["soc"] <= continuous.objective * (1 + 1e-6) <= cost["ac"] * (1 + 2e-6)
    assert cost["copperplate"] <= cost["dc"] * (1 + 1e-6)


@pytest.mark.parametrize("horizon", ["uneven", "tree"])
@pytest.mark.parametrize("formulation", ["ac", "dc"])
def test_other_horizons_satisfy_the_check(formulation: str, horizon: str) -> None:
    plan = planned(formulation, horizon)
    assert plan.optimal, plan.termination
    for scenario in plan.horizon.scenarios:
        assert worst(everything(), plan.scenario(scenario)) == ""


@pytest.mark.parametrize("response", ["corrective", "preventive"])
def test_outages_of_several_kinds_are_survived(response: str) -> None:
    contingencies = {"branches": ["line"], "renewables": ["sun"], "dc_lines": ["cable"], "storages": ["cell"]}
    costs = []
    for screen in (True, False):
        security = om.Security(contingencies=contingencies, response=response, rating=1.3, screen=screen)
        plan = om.MultiStage(everything(), 3, formulation="dc", profiles=PROFILES, security=security).solve()
        assert plan.optimal, plan.termination
        assert worst(everything(), plan.data) == ""
        costs.append(plan.objective)
    assert costs[0] == pytest.approx(costs[1], rel=1e-6)


@pytest.mark.parametrize("plant", ["nominal", "power-flow", "redispatch"])
def test_closed_loops_hand_every_state_on(plant: str) -> None:
    grid = everything()
    problem = om.MultiStage(grid, 4, profiles=PROFILES)
    forecast = None if plant == "nominal" else Noisy(deviation=0.02, seed=1)
    controller = om.Controller(problem, forecast=forecast, on_infeasible="elastic")
    run = om.simulate(controller, plugins.make("plant", plant, {}), steps=4)
    assert run.status == "done", run.termination
    for state in problem.model.states.values():
        if state.role == "stock":
            before, after = run.data[f"{state.name}_next"].values[:-1], run.data[state.name].values[1:]
            if state.name not in ("flexible_load_delivered",):  # begins anew with each window
                np.testing.assert_allclose(before, after, atol=1e-5)
    if plant != "power-flow":  # which measures limits without enforcing them
        assert worst(grid, run.data) == ""


def test_an_elastic_plan_of_a_shortage_names_what_is_lacking() -> None:
    grid = everything()
    grid.update("town", p=400)
    plan = om.MultiStage(grid, 2, elastic=om.Elastic()).solve()
    assert plan.optimal
    assert any("lacks" in str(shortage) for shortage in plan.shortages)


def test_figures_of_buses_show_what_is_connected() -> None:
    from opfmodel.results.figures import buses

    labels = " ".join(axis.get_ylabel() for axis in buses(planned("dc").data).axes)
    for word in ("generation", "renewables", "import", "storage power", "flexible demand", "angle"):
        assert word in labels
