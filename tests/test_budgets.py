"""Budgets: emissions, water, cycles; against linear programs, PyPSA and closed forms."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pypsa_networks import snapshots
from scipy.optimize import linprog

import opfmodel as om
from opfmodel.analysis.subject import Subject
from opfmodel.check import check
from opfmodel.data.calendar import Calendar
from opfmodel.errors import CaseWarning, ComponentError, IncompatibleError, ScenarioError
from opfmodel.forecasts.noisy import Noisy
from opfmodel.scenario.rehearsal import rehearse
from opfmodel.simulation import Controller, NominalPlant, Plant, simulate

HOURS = np.arange(48)
DEMAND = 60 + 25 * np.sin(2 * np.pi * HOURS / 24 - 2)


def system(**budget: object) -> om.Network:
    """Two units, of which only the cheap one emits, and demand over two buses."""
    grid = om.Network("budget", base_mva=100)
    grid.north, grid.south = om.Bus(reference=True), om.Bus()
    grid.line = om.Branch("north", "south", r=0.01, x=0.1, rating=150)
    grid.coal = om.Generator("north", p=(0, 120), q=(-90, 90), cost=om.Polynomial(0, 10, 0))
    grid.gas = om.Generator("south", p=(0, 120), q=(-90, 90), cost=om.Polynomial(0, 30, 0))
    grid.town = om.Load("south", p=60, q=10)
    grid.cap = om.Budget(**{"amount": 600, "uses": {"coal": 0.8}, "hours": 24, **budget})
    return grid


# Against others --------------------------------------------------------------------------------------


def test_dispatch_under_a_cap_is_that_of_a_linear_program() -> None:
    cost, rate, most = np.array([12.0, 25.0, 40.0]), np.array([0.95, 0.4, 0.0]), np.array([60.0, 50.0, 90.0])
    ramp, cap, demand = 9.0, 700.0, DEMAND[:24]
    grid = om.Network("cap")
    grid.bus = om.Bus()
    for i, name in enumerate(("coal", "gas", "oil")):
        grid.add(
            name,
            om.Generator(
                "bus", p=(0, most[i]), ramp=ramp if i == 0 else None, cost=om.Polynomial(0, cost[i], 0)
            ),
        )
    grid.town = om.Load("bus", p=1)
    grid.cap = om.Budget(amount=cap, uses={"coal": 0.95, "gas": 0.4}, hours=24)
    problem = om.MultiStage(grid, 24, formulation="copperplate", profiles={"town.p": demand})
    plan = problem.solve(initial={"pg": None})
    change = np.zeros((46, 72))
    for k in range(23):
        change[[k, 23 + k], 3 * k], change[[k, 23 + k], 3 * k + 3] = (-1, 1), (1, -1)
    found = linprog(
        np.tile(cost, 24),
        A_ub=np.vstack([np.tile(rate, 24), change]),
        b_ub=np.append(cap, np.full(46, ramp)),
        A_eq=np.kron(np.eye(24), np.ones(3)),
        b_eq=demand,
        bounds=list(zip(np.zeros(72), np.tile(most, 24), strict=True)),
    )
    assert plan.objective == pytest.approx(found.fun, rel=1e-7)
    price = -found.ineqlin.marginals[0]
    assert price > 1.0
    assert plan.data.budget_price.values == pytest.approx(np.full((24, 1), price), rel=1e-6)
    assert plan.data.budget_used.values[:, 0] == pytest.approx(plan.data.pg.values @ rate, abs=1e-6)


@pytest.mark.filterwarnings("ignore::FutureWarning", "ignore::opfmodel.errors.CaseWarning")
def test_emissions_are_limited_as_in_pypsa() -> None:
    for name in ("pypsa", "linopy"):
        logging.getLogger(name).setLevel(logging.ERROR)
    rng = np.random.default_rng(3)
    n = snapshots(24, 1.0)
    n.add("Bus", "a", v_nom=110.0)
    n.add("Bus", "b", v_nom=110.0)
    n.add("Line", "ab", bus0="a", bus1="b", x=10, r=1, s_nom=60)
    n.add("Carrier", ["coal", "gas", "wind"], co2_emissions=[0.34, 0.2, 0.0])
    n.add("Generator", "coal", bus="a", p_nom=90, carrier="coal", efficiency=0.4, marginal_cost=20)
    n.add("Generator", "gas", bus="b", p_nom=90, carrier="gas", efficiency=0.5, marginal_cost=45)
    n.add("Generator", "wind", bus="b", p_nom=40, carrier="wind", p_max_pu=rng.uniform(0, 1, 24))
    n.add(
        "StorageUnit",
        "hydro",
        bus="b",
        p_nom=15,
        max_hours=4,
        efficiency_store=0.9,
        state_of_charge_initial=30,
    )
    n.add("Load", "town", bus="b", p_set=DEMAND[:24])
    grid = om.from_pypsa(n)
    grid.co2 = om.Budget(amount=600, uses={"coal": 0.34 / 0.4, "gas": 0.2 / 0.5}, hours=24)
    n.add(
        "GlobalConstraint",
        "co2",
        type="primary_energy",
        carrier_attribute="co2_emissions",
        sense="<=",
        constant=600,
    )
    n.optimize(solver_name="highs", include_objective_constant=False)
    plan = om.MultiStage(grid, 24, formulation="dc", regularisation=0.0).solve()
    assert plan.objective == pytest.approx(n.objective, rel=1e-6)
    mu = -float(n.global_constraints.mu["co2"])
    assert mu > 1.0
    assert plan.data.budget_price.values[:, 0] == pytest.approx(np.full(24, mu), rel=1e-5)


def test_cycles_of_a_battery_per_day() -> None:
    price = np.tile([10.0, 50.0, 10.0, 30.0], 6)  # a cycle earns 40 or 20 $/MWh
    grid = om.Network("cycles")
    grid.bus = om.Bus()
    grid.market = om.Generator("bus", p=(-100, 100), cost=om.Polynomial(0, 1, 0))
    grid.cell = om.Storage("bus", energy=8, power=8, initial=0)
    grid.town = om.Load("bus", p=20)
    grid.wear = om.Budget(amount=2 * 8 * 7, uses={"cell": 1}, hours=24)  # seven full cycles
    series = {"market.c1": price}
    saved = {}
    for cost in (None, 5.0, 12.0):
        grid.update("wear", over_cost=cost)
        plan = om.MultiStage(grid, 24, formulation="copperplate", profiles=series, regularisation=0.0).solve()
        moved = np.abs(plan.data.ps.values).sum()
        saved[cost] = 20 * price.sum() - plan.objective
        assert plan.data.budget_used.values.sum() == pytest.approx(moved, abs=1e-4)
        assert check(grid, plan.data, series).max_violation < 1e-6
    assert saved[None] == pytest.approx(8 * (6 * 40 + 20), rel=1e-6)
    assert saved[12.0] == pytest.approx(saved[None], rel=1e-6)  # 24 $/MWh per cycle are more than it earns
    assert saved[5.0] == pytest.approx(8 * (6 * 40 + 6 * 20 - 5 * 2 * 5), rel=1e-6)
    grid.update("wear", over_cost=None)
    plan = om.MultiStage(grid, 24, formulation="copperplate", profiles=series, regularisation=0.0).solve()
    assert plan.data.budget_price.values == pytest.approx(np.full((24, 1), 10.0), rel=1e-5)


# The share of a horizon ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "horizon",
    [
        om.Horizon.chain(1),
        om.Horizon.chain(6),
        om.Horizon.grid([1, 1, 2, 4, 8, 12]),
        om.Horizon.tree([1, 1, 2, 3], {"low": 0.3, "high": 0.7}, common=1),
    ],
    ids=str,
)
@pytest.mark.parametrize("time", [0, 5, 19, 24])
def test_a_plan_leaves_the_rest_of_its_share(horizon: om.Horizon, time: int) -> None:
    grid = system(left=300)
    plan = om.MultiStage(grid, horizon, formulation="dc").solve(time)
    begin, end = time % 24, time % 24 + horizon.steps
    had = 600.0 if time == 24 else 300.0  # at midnight the amount is available again
    least = had * (24 - end) / (24 - begin) if end <= 24 else 600.0 * (-end % 24) / 24
    least = max(least, had - 48.0) if horizon.steps == 1 else least  # all is cheap in one hour
    left = plan.data.budget_left_next.values[horizon.leaves]
    assert left == pytest.approx(np.full_like(left, least), abs=1e-4)
    for name in horizon.scenarios:
        report = check(grid, plan.scenario(name), first=time)
        assert max(report.violations[f"budget{what}"].value for what in ("", " use", " dynamics")) < 1e-7
    used = horizon.hours * horizon.probability @ plan.data.budget_used.values[:, 0]
    cheap = used / 0.8  # MWh
    assert plan.objective == pytest.approx(60 * 30 * horizon.steps - 20 * cheap, rel=1e-6)


@pytest.mark.parametrize("time", [30, 43, 46, 47])
def test_plans_that_end_with_the_data_leave_the_rest_of_their_share(time: int) -> None:
    problem = om.MultiStage(system(), 6, formulation="dc", profiles={"town.p": DEMAND}, at_end="shrink")
    state = {"budget_left": [25.0]}
    shrunk = problem.solve(time, state)
    stages = min(6, 48 - time)
    alone = om.MultiStage(system(), stages, formulation="dc", profiles={"town.p": DEMAND}).solve(time, state)
    assert shrunk.data.budget_left_next.values[-1] == pytest.approx(
        25 * (48 - time - stages) / (48 - time), abs=1e-4
    )
    assert shrunk.objective == pytest.approx(alone.objective, rel=1e-7)
    assert shrunk.data.budget_price.values == pytest.approx(alone.data.budget_price.values, abs=1e-4)


@settings(max_examples=8, deadline=None)
@given(
    hours=st.integers(2, 30),
    steps=st.integers(1, 40),
    start=st.sampled_from(["2025-03-29T05:00", "2025-10-25T00:00", "2025-03-30T00:30"]),
)
def test_the_check_finds_the_periods_of_the_clock(hours: int, steps: int, start: str) -> None:
    grid = system(hours=hours, amount=50)
    profiles = om.Profiles(
        {"town.p": np.full(steps, 60.0)}, calendar=Calendar(np.datetime64(start), 1.0, "Europe/Berlin")
    )
    plan = om.MultiStage(grid, steps, formulation="copperplate", profiles=profiles).solve()
    assert check(grid, plan.data, profiles).violations["budget dynamics"].value < 1e-7


# Overspending ----------------------------------------------------------------------------------------


def test_a_price_of_overspending_bounds_the_price_of_the_budget() -> None:
    grid = system(over_cost=7)  # less than the 25 $ that one unit is worth
    plan = om.MultiStage(grid, 24, formulation="dc").solve()
    used = 24 * 60 * 0.8
    assert plan.objective == pytest.approx(24 * 60 * 10 + 7 * (used - 600), rel=1e-7)
    assert plan.data.budget_price.values == pytest.approx(np.full((24, 1), 7.0), rel=1e-5)
    share = om.MultiStage(grid, 6, formulation="dc").solve()
    assert share.objective == pytest.approx(6 * 60 * 10 + 7 * (used / 4 - 150), rel=1e-7)
    assert share.data.budget_left_next.values[-1, 0] == pytest.approx(600 - used / 4, abs=1e-4)
    assert share.data.budget_over.values[:, 0] == pytest.approx([0, 0, 0, 0, 0, used / 4 - 150], abs=1e-4)
    assert check(grid, share.data).cost == pytest.approx(share.objective, rel=1e-9)


def test_a_budget_that_cannot_be_kept_is_explained() -> None:
    grid = system()
    grid.update("gas", p=(0, 20))
    assert om.MultiStage(grid, 24, formulation="dc").solve().infeasible
    plan = om.MultiStage(grid, 24, formulation="dc", elastic=om.Elastic(shedding=2e4)).solve()
    assert "budget cap" in str(plan.shortages[0])
    assert "is overspent by 168.0 units at hour 23" in str(plan.shortages[0])  # 24 h times 32 units, less 600
    assert plan.data.budget_over.values[-1, 0] == pytest.approx(168, abs=1e-3)


@pytest.mark.parametrize(
    "plant", [NominalPlant(), om.PowerFlow(), om.Redispatch()], ids=lambda p: type(p).__name__
)
def test_what_is_left_is_handed_on_over_two_periods(plant: Plant) -> None:
    grid = system(hours=6, amount=150)
    nominal, series = isinstance(plant, NominalPlant), {"town.p": DEMAND[:24]}
    problem = om.MultiStage(grid, 3, formulation="ac" if nominal else "dc", profiles=series, at_end="repeat")
    run = simulate(Controller(problem, None if nominal else Noisy(0.04, seed=2)), plant, 12)
    data = run.data
    used = 0.8 * data.pg.sel(generator="coal").values
    assert data.budget_used.values[:, 0] == pytest.approx(used, abs=1e-7)
    left, after, over = (data[f"budget_{name}"].values[:, 0] for name in ("left", "left_next", "over"))
    assert left[1:] == pytest.approx(after[:-1], abs=1e-9)
    begins = np.where(np.arange(12) == 6, 150.0, left)
    assert after == pytest.approx(begins - used + over, abs=1e-7)
    assert after.min() >= 0.0
    assert after[5] < 3.0  # nothing is kept for a period that has its own
    assert check(grid, data, series).violations["budget dynamics"].value < 1e-7
    if nominal:
        assert over.max() == pytest.approx(0.0, abs=1e-6)
        assert used.sum() == pytest.approx(300, abs=1e-3)
    else:  # coal also generates losses and errors that plans do not know
        assert 0 < over.sum() < 10
        assert over[[*range(5), *range(6, 11)]].max() == 0.0


def test_realised_overspending_costs() -> None:
    grid = system(amount=20, hours=1, over_cost=100)
    grid.update("line", r=0.05)
    plan = om.MultiStage(grid, 1, formulation="dc")
    run = simulate(plan, om.PowerFlow({"coal": 1.0}), 2)
    over, pg = run.data.budget_over.values[:, 0], run.data.pg.values
    assert over == pytest.approx(0.8 * pg[:, 0] - 20, abs=1e-7)
    assert over.min() > 0.1
    assert run.cost == pytest.approx(float((pg @ [10, 30] + 100 * over).sum()), rel=1e-9)
    assert run.data.budget_left.values[1, 0] == 0.0
    assert run.summary()["overspent_units"] == {"cap": pytest.approx(over.sum())}


def test_outages_that_have_not_happened_use_nothing() -> None:
    grid = system()
    grid.second = om.Branch("north", "south", r=0.01, x=0.1, rating=60)
    grid.cell = om.Storage("south", energy=20, power=10)
    grid.update("cap", uses={"coal": 0.8, "cell": 0.1})
    for response in ("corrective", "preventive"):
        secure = om.MultiStage(
            grid, 4, formulation="dc", security=om.Security(response=response, screen=False)
        )
        plan = secure.solve()
        use = 0.8 * plan.data.pg.values[:, 0] + 0.1 * np.abs(plan.data.ps.values[:, 0])
        assert plan.data.budget_used.values[:, 0] == pytest.approx(use, abs=1e-6)
        assert plan.data.budget_left_next.values[-1, 0] == pytest.approx(500, abs=1e-4)


# Input and check -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("amount", -1, "cap: amount = -1: must be at least 0"),
        ("amount", "much", "cap: amount = 'much': must be a number"),
        ("uses", {}, "cap: uses = {}: must name at least one component"),
        ("uses", {"coal": "x"}, "cap: uses"),
        ("uses", {"cell": -1}, "cap: uses.cell = -1: must be at least 0 for a storage"),
        ("uses", {"town": 1}, "cap: uses.town = 1: no generator, connection, storage, branch or shunt"),
        ("hours", 0, "cap: hours = 0: must be greater than 0"),
        ("left", -2, "cap: left = -2: must be at least 0"),
        ("over_cost", -2, "cap: over_cost = -2: must be at least 0"),
    ],
)
def test_bad_input_is_refused(field: str, value: object, message: str) -> None:
    grid = system()
    grid.cell = om.Storage("south", energy=20, power=10)
    with pytest.raises(ComponentError) as refused:
        grid.update("cap", **{field: value})
        om.MultiStage(grid)
    assert message in str(refused.value)


@pytest.mark.parametrize(
    ("hours", "horizon", "message"),
    [
        (1.5, om.Horizon.chain(2), "cap: hours = 1.5: must be a multiple of the step of 1 h"),
        (2, om.Horizon.grid([1, 4]), "cap: hours = 2: must be at least the longest stage, 4 h"),
    ],
)
def test_periods_consist_of_steps(hours: float, horizon: om.Horizon, message: str) -> None:
    with pytest.raises(IncompatibleError, match=message):
        om.MultiStage(system(hours=hours), horizon, formulation="dc").solve()


def test_a_generator_may_refill_a_budget_and_the_amount_may_vary() -> None:
    grid = system(uses={"coal": 1, "gas": -0.5}, hours=2, amount=10)
    amounts = np.repeat([10.0, 30.0], 2)
    plan = om.MultiStage(grid, 4, formulation="dc", profiles={"cap.amount": amounts}).solve()
    pg = plan.data.pg.values
    assert (pg @ [1, -0.5]).reshape(2, 2).sum(axis=1) == pytest.approx([10, 30], abs=1e-4)
    assert check(grid, plan.data, {"cap.amount": amounts}).max_violation < 1e-7


@pytest.mark.parametrize(
    ("quantity", "family"),
    [
        ("budget_used", "budget use"),
        ("budget_left_next", "budget dynamics"),
        ("budget_left", "budget continuity"),
        ("budget_over", "budget"),
    ],
)
def test_the_check_finds_falsified_results(quantity: str, family: str) -> None:
    grid = system()
    data = om.MultiStage(grid, 3, formulation="dc").solve().data
    assert check(grid, data).max_violation < 1e-7
    data[quantity][1] += 6.0
    assert check(grid, data).violations[family].value == pytest.approx(0.01, rel=1e-4)


def test_a_scenario_file_has_budgets(tmp_path: Path) -> None:
    file = tmp_path / "budget.yaml"
    file.write_text(
        """
network:
  buses: {bus: {}}
  generators: {coal: {bus: bus, p: [0, 100], cost: {c1: 10}}, gas: {bus: bus, p: [0, 100], cost: {c1: 30}}}
  loads: {town: {bus: bus, p: 50 MW}}
  budgets: {cap: {amount: 60 units, uses: {coal: 0.5 units/MWh}, hours: 240 min}}
controller: {formulation: copperplate, horizon: 3}
time: {steps: 6}
"""
    )
    scenario = om.load_scenario(file)
    run = scenario.simulate()
    assert run.status == "done"
    left = run.data.budget_left_next.values[:, 0]
    assert left[3] == pytest.approx(0.0, abs=1e-3)
    assert left[4] >= 35.0
    assert scenario.network["cap"] == om.Budget(amount=60, uses={"coal": 0.5}, hours=4)
    for right, wrong in (("60 units", "60 t"), ("{coal: 0.5 units/MWh}", "coal")):
        (tmp_path / "wrong.yaml").write_text(file.read_text().replace(right, wrong))
        with pytest.raises(ScenarioError, match=r"wrong\.yaml:6:\d+: network\.budgets\.cap\.(amount|uses): "):
            om.load_scenario(tmp_path / "wrong.yaml")


@pytest.mark.parametrize("time", [0, 7])
def test_the_price_is_the_value_of_one_more_unit(time: int) -> None:
    tree = om.Horizon.tree([1, 2, 3], {"low": 0.3, "high": 0.7}, common=1)
    problem = om.MultiStage(system(), tree, formulation="dc")
    costs = [problem.solve(time, {"budget_left": [left]}).objective for left in (300.0, 301.0)]
    share = 1.0 - (24 - time - 6) / (24 - time)  # of one more unit, which the plan may use
    assert costs[0] - costs[1] == pytest.approx(25.0 * share, rel=1e-4)
    assert problem.solve(time, {"budget_left": [300.0]}).data.budget_price.values == pytest.approx(
        np.full((5, 1), 25.0), rel=1e-4
    )


def test_a_budget_has_no_steady_state() -> None:
    with pytest.raises(IncompatibleError, match="cap: budgets depend on the time of day"):
        Subject(om.MultiStage(system(), 3, formulation="dc"))


@pytest.mark.filterwarnings("ignore::opfmodel.errors.CaseWarning")
def test_a_power_flow_takes_no_account_of_budgets() -> None:
    grid = system()
    flow = om.power_flow(grid)
    grid.remove("cap")
    assert flow.slack == om.power_flow(grid).slack


def test_a_matpower_case_has_no_budgets(tmp_path: Path) -> None:
    with pytest.warns(CaseWarning, match="budgets cap: MATPOWER has no such equipment"):
        om.write_network(system(), tmp_path / "case.m")


@pytest.mark.parametrize("time", [1, 3, 6])
def test_overspending_where_a_period_ends_within_a_stage(time: int) -> None:
    grid = system(amount=100, hours=6, over_cost=7)
    plan = om.MultiStage(grid, om.Horizon.grid([1, 1, 2, 4]), formulation="dc").solve(time)
    report = check(grid, plan.data, first=time)
    assert report.max_violation < 1e-6
    assert report.cost == pytest.approx(plan.objective, rel=1e-9)
    assert plan.data.pg.values[:, 1] == pytest.approx(np.zeros(4), abs=1e-4)  # 7 $ are less than 25 $
    data = plan.data
    data["budget_over"][:] = 0.0
    assert check(grid, data, first=time).violations["budget"].value > 0.1


def test_errors_in_a_scenario_name_the_line_of_the_field(tmp_path: Path) -> None:
    text = """
network:
  buses: {here: {}}
  generators: {coal: {bus: here, p: [0, 50], cost: {c1: 20}}}
  loads: {town: {bus: here, p: 20}}
  budgets:
    co2: {amount: 30, uses: {coal: 1}, hours: 1.5}
time: {steps: 2}
controller: {horizon: 2, formulation: dc}
"""
    for old, new, place in (
        (
            "hours: 1.5",
            "hours: 1.5",
            r":7:40: network\.budgets\.co2\.hours: co2: hours = 1\.5: must be a multiple",
        ),
        (
            "{coal: 1}",
            "{coke: 1}",
            r":7:30: network\.budgets\.co2\.uses\.coke: 1: no generator, .* or shunt has this name; available: coal",
        ),
    ):
        (tmp_path / "budget.yaml").write_text(text.replace(old, new))
        with pytest.raises(om.OpfmodelError, match=place):
            rehearse(om.load_scenario(tmp_path / "budget.yaml"))
