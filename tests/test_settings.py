"""Taps, phase shifters and switchable shunts that are decided, at positions, with moves that cost."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from pypower.api import ppoption, runopf
from scipy.optimize import linprog

import opfmodel as om
from opfmodel.analysis.subject import Subject
from opfmodel.check import check
from opfmodel.network.cases.write import tables_of

CASE14 = ROOT / "tests" / "data" / "pglib" / "pglib_opf_case14_ieee.m"
TRAFO = "4-7"


def case14(**changes: object) -> om.Network:
    """Return the case with its transformer 4-7 changed."""
    grid = om.read_network(CASE14)
    grid.update(TRAFO, **changes)
    return grid


def peer_cost(grid: om.Network) -> float:
    """Return the optimum that PYPOWER finds for a network without adjustable equipment."""
    tables = tables_of(grid, {name: int(name) for name in grid.of(om.Bus)})
    case = {key: np.array(value) if isinstance(value, list) else value for key, value in tables.items()}
    result = runopf(case, ppoption(VERBOSE=0, OUT_ALL=0, OPF_VIOLATION=1e-8, PDIPM_COSTTOL=1e-10))
    assert result["success"]
    return float(result["f"])


def parallel(**second: object) -> om.Network:
    """Return two buses with parallel lines of unequal reactance, cheap supply at one and demand at the other."""
    grid = om.Network("parallel", base_mva=100)
    grid.a, grid.b = om.Bus(reference=True), om.Bus()
    grid.cheap = om.Generator("a", p=(0, 300), q=(-200, 200), cost=om.Polynomial(0, 10, 0))
    grid.dear = om.Generator("b", p=(0, 300), q=(-200, 200), cost=om.Polynomial(0, 50, 0))
    grid.town = om.Load("b", p=150, q=10)
    grid.one = om.Branch("a", "b", r=0, x=0.1, rating=50)
    grid.two = om.Branch("a", "b", r=0, x=0.2, rating=50, **second)
    return grid


def test_an_optimal_tap_costs_what_another_tool_finds_and_neighbours_cost_more() -> None:
    plan = om.MultiStage(case14(tap=(0.9, 1.1))).solve()
    chosen = float(plan.data.tap.sel(branch=TRAFO).item())
    assert 0.91 < chosen < 1.09
    assert plan.objective == pytest.approx(peer_cost(case14(tap=chosen)), rel=1e-7)
    for other in (chosen - 0.01, chosen + 0.01):
        assert peer_cost(case14(tap=other)) > plan.objective * (1 + 1e-6)


def test_an_optimal_shunt_at_steps_is_the_best_of_all() -> None:
    grid = om.read_network(CASE14)
    name = next(iter(grid.of(om.Shunt)))
    grid.update(name, b=(0, 60), steps=3)
    plan = om.MultiStage(grid).solve()
    costs = {}
    for b in (0.0, 20.0, 40.0, 60.0):
        grid.update(name, b=b, steps=None)
        costs[b] = peer_cost(grid)
    best = min(costs, key=lambda b: costs[b])
    assert plan.data.shunt_b.item() == pytest.approx(best)
    assert plan.objective == pytest.approx(costs[best], rel=1e-7)
    assert 0 <= plan.rounding_loss < max(costs.values()) - min(costs.values())


@pytest.mark.parametrize("formulation", ["ac", "ac-rectangular"])
def test_positions_are_the_nearest_and_their_loss_is_reported(formulation: str) -> None:
    plan = om.MultiStage(case14(tap=(0.9, 1.1), tap_steps=5), formulation=formulation).solve()
    assert plan.rounded_from is not None
    before = plan.rounded_from.data.tap.sel(branch=TRAFO).item()
    position = plan.data.tap.sel(branch=TRAFO).item()
    assert position == pytest.approx(0.9 + 0.05 * round((before - 0.9) / 0.05))
    assert plan.objective == pytest.approx(peer_cost(case14(tap=position)), rel=1e-7)
    assert plan.rounding_loss == pytest.approx(plan.objective - plan.rounded_from.objective)
    assert plan.rounding_loss > 0


@pytest.mark.parametrize("formulation", ["dc", "dc-matpower", "ac", "soc", "dc-losses"])
def test_a_phase_shifter_loads_parallel_lines_fully(formulation: str) -> None:
    """The flows divide 2:1, so that without it line two is at 25 MW when line one is at its limit."""
    grid = parallel(shift=(-20, 20))
    plan = om.MultiStage(grid, formulation=formulation).solve()
    assert plan.optimal
    sent = float(plan.data.pg.sel(generator="cheap").item())
    if formulation in ("dc", "dc-matpower", "dc-losses"):
        assert sent == pytest.approx(100, rel=1e-6)
        assert om.MultiStage(parallel(), formulation=formulation).solve().data.pg.sel(
            generator="cheap"
        ).item() == pytest.approx(75, rel=1e-6)
        one, shift = 0.5 * 0.1, np.deg2rad(plan.data["shift"].sel(branch="two").item())
        assert one - shift == pytest.approx(0.5 * 0.2, abs=1e-6)  # x f = angle - shift on each line
    else:  # reactive power shares the ratings
        assert 95 < sent <= 100 + 1e-4
    assert check(grid, plan.data).max_violation < 1e-6


def test_a_phase_shifter_in_a_mesh_against_a_linear_program() -> None:
    """Three buses in a triangle; the program is written out in angles and the shift."""
    grid = om.Network("triangle", base_mva=100)
    for bus in "abc":
        grid.add(bus, om.Bus(reference=bus == "a"))
    grid.ab = om.Branch("a", "b", r=0, x=0.1, rating=60)
    grid.bc = om.Branch("b", "c", r=0, x=0.1, rating=60)
    grid.ac = om.Branch("a", "c", r=0, x=0.2, rating=40, shift=(-3, 3))
    grid.coal = om.Generator("a", p=(0, 200), cost=om.Polynomial(0, 12, 0))
    grid.gas = om.Generator("b", p=(0, 200), cost=om.Polynomial(0, 30, 0))
    grid.town = om.Load("c", p=90)
    plan = om.MultiStage(grid, formulation="dc").solve()
    # x = coal, gas (p.u.), angle b, angle c, shift (rad)
    ab, bc = np.array([0, 0, -10, 0, 0]), np.array([0, 0, 10, -10, 0])
    ac = np.array([0, 0, 0, -5, -5.0])
    coal, gas = np.eye(5)[:2]
    equal = np.array([coal - ab - ac, gas + ab - bc, bc + ac])
    limits = np.vstack([sign * flow for flow in (ab, bc, ac) for sign in (1, -1)])
    found = linprog(
        [1200, 3000, 0, 0, 0], limits, [0.6, 0.6, 0.6, 0.6, 0.4, 0.4], equal, [0, 0, 0.9],
        [(0, 2), (0, 2), (None, None), (None, None), (-np.pi / 60, np.pi / 60)],
    )  # fmt: skip
    assert plan.objective == pytest.approx(found.fun, rel=1e-6)
    grid.update("ac", shift=0.0)
    assert om.MultiStage(grid, formulation="dc").solve().objective > found.fun * 1.01


def test_the_relaxation_is_a_lower_bound_and_exact_on_a_radial_grid() -> None:
    grid = om.Network("radial", base_mva=100)
    grid.source, grid.low, grid.end = om.Bus(vm=(1.0, 1.0), reference=True), om.Bus(), om.Bus(vm=(0.9, 1.1))
    grid.trafo = om.Branch("source", "low", r=0.005, x=0.12, tap=(0.9, 1.1))
    grid.line = om.Branch("low", "end", r=0.05, x=0.1)
    grid.unit = om.Generator("source", p=(0, 200), q=(-100, 100), cost=om.Polynomial(0, 20, 0))
    grid.town = om.Load("end", p=50, q=20)
    grid.capacitor = om.Shunt("end", b=(0, 10))
    ac, soc = (om.MultiStage(grid, formulation=f).solve() for f in ("ac", "soc"))
    assert soc.objective == pytest.approx(ac.objective, rel=1e-6)
    assert check(grid, soc.data).max_violation < 1e-6
    fixed = grid.copy()
    fixed.update("trafo", tap=1.0)
    assert om.MultiStage(fixed).solve().objective > ac.objective * (1 + 1e-5)
    meshed = case14(tap=(0.9, 1.1), shift=(-10, 10))
    ac, soc = (om.MultiStage(meshed, formulation=f).solve() for f in ("ac", "soc"))
    assert soc.objective < ac.objective
    assert check(meshed, soc.data).max_violation < 1e-6


def swinging() -> tuple[om.Network, dict[str, np.ndarray]]:
    """Return a feeder that needs another tap at low and at high demand."""
    grid = om.Network("swing", base_mva=100)
    grid.source, grid.end = om.Bus(vm=(1.0, 1.0), reference=True), om.Bus(vm=(0.98, 1.02))
    grid.trafo = om.Branch("source", "end", r=0.01, x=0.15, tap=(0.9, 1.1), tap_steps=21, move_cost=3.0)
    grid.unit = om.Generator("source", p=(0, 200), q=(-200, 200), cost=om.Polynomial(0, 20, 0))
    grid.town = om.Load("end", p=10, q=2)
    demand = np.array([10.0, 60.0, 60.0, 10.0])
    return grid, {"town.p": demand, "town.q": 0.4 * demand}


def test_moves_are_counted_and_priced() -> None:
    grid, profiles = swinging()
    plan = om.MultiStage(grid, 4, profiles=profiles).solve()
    taps, moves = (plan.data[name].sel(branch="trafo").values for name in ("tap", "tap_moves"))
    counted = np.abs(np.diff(taps)) / 0.01
    assert counted.sum() >= 2
    assert moves[1:] == pytest.approx(counted, abs=1e-4)
    energy = float((20 * plan.data.pg).sum())
    assert plan.objective == pytest.approx(energy + 3.0 * counted.sum(), rel=1e-6)
    report = check(grid, plan.data, profiles)
    assert report.max_violation < 1e-6
    assert report.cost == pytest.approx(plan.objective, rel=1e-7)


@pytest.mark.parametrize(
    "plant", [om.NominalPlant(), om.PowerFlow(), om.Redispatch()], ids=lambda p: type(p).__name__
)
def test_a_closed_loop_hands_positions_on(plant: om.Plant) -> None:
    grid, profiles = swinging()
    problem = om.MultiStage(grid, 2, profiles=profiles, at_end="repeat")
    run = om.simulate(problem, plant, steps=4, initial={"tap": [1.0]})
    assert run.status == "done"
    taps = run.data.tap.sel(branch="trafo").values
    moves = run.data.tap_moves.sel(branch="trafo").values
    assert moves == pytest.approx(np.abs(np.diff(taps, prepend=1.0)) / 0.01, abs=1e-3)
    assert (taps - 0.9) / 0.01 == pytest.approx(np.rint((taps - 0.9) / 0.01), abs=1e-6)
    assert check(grid, run.data, profiles).max_violation < 1e-6


@pytest.mark.parametrize("formulation", ["soc", "dc"])
def test_plants_hold_positions_that_a_plan_neglects(formulation: str) -> None:
    grid, profiles = swinging()
    grid.update("trafo", tap=(0.95, 1.08), tap_steps=3)  # 1 is no position
    grid.capacitor = om.Shunt("end", b=(0, 10), steps=2)
    run = om.simulate(om.MultiStage(grid, 2, formulation=formulation, profiles=profiles), om.PowerFlow(), 2)
    violations = check(grid, run.data, profiles).violations
    assert violations["branch tap position"].value < 1e-9
    assert violations["shunt b position"].value < 1e-9


def test_plans_that_end_with_the_data_have_positions() -> None:
    grid, profiles = swinging()
    plan = om.MultiStage(grid, 4, profiles=profiles, at_end="shrink").solve(1)
    assert (plan.stages, plan.status) == (3, "locally_optimal")
    assert check(grid, plan.data, profiles, first=1).max_violation < 1e-6


def test_settings_are_no_states_of_the_theory() -> None:
    grid, profiles = swinging()
    grid.cell = om.Storage("end", energy=20, power=5)
    subject = Subject(om.MultiStage(grid, 3, profiles=profiles))
    assert [state.name for state in subject.states] == ["pg", "qg", "e"]
    assert subject.declared({"pg": [10], "qg": [0], "e": [5]}) == pytest.approx([0.1, 0, 0.05])


def test_single_stage_optima_move_for_nothing() -> None:
    grid, profiles = swinging()
    cost = om.single_stage_sequence(om.MultiStage(grid, profiles=profiles), 3).cost
    for name in [*grid.of(om.Branch), *grid.of(om.Shunt)]:
        grid.update(name, move_cost=None)
    free = om.single_stage_sequence(om.MultiStage(grid, profiles=profiles), 3)
    assert cost == pytest.approx(free.cost, rel=1e-9)


def test_a_power_flow_holds_neutral_values() -> None:
    grid = parallel(tap=(1.02, 1.1), shift=(-10, 10))
    grid.bank = om.Shunt("b", b=(-10, 40), steps=5, move_cost=1)
    flow = om.power_flow(grid)
    grid.update("two", tap=1.02, shift=0)
    grid.remove("bank")
    assert flow.converged
    assert flow.slack == pytest.approx(om.power_flow(grid).slack, abs=1e-9)


def test_the_check_finds_falsified_settings() -> None:
    grid, profiles = swinging()
    grid.capacitor = om.Shunt("end", b=(0, 10), steps=2)
    plan = om.MultiStage(grid, 4, profiles=profiles).solve()
    for name, by, family in (
        ("tap", 0.5, "branch tap range"),
        ("tap", 0.004, "branch tap position"),
        ("tap_moves", -1.0, "branch tap moves"),
        ("shunt_b", 2.0, "shunt b position"),
        ("shunt_b", 20.0, "shunt b range"),
    ):
        data = plan.data.copy(deep=True)
        data[name][1] += by
        assert check(grid, data, profiles).violations[family].value > 1e-3, family
    assert check(grid, plan.data, profiles).max_violation < 1e-6


def test_contingencies_leave_settings_as_they_were() -> None:
    grid = parallel(shift=(-20, 20), shift_steps=9)
    grid.three = om.Branch("a", "b", r=0.01, x=0.2, rating=50, tap=(0.9, 1.1))
    grid.update("town", p=60)
    costs = []
    for screen in (True, False):
        security = om.Security(contingencies={"branches": ["one"]}, screen=screen)
        plan = om.MultiStage(grid, 2, security=security).solve()
        assert plan.optimal
        costs.append(plan.objective)
        assert plan.data["shift"].sel(branch="two").values / 5 == pytest.approx(
            np.rint(plan.data["shift"].sel(branch="two").values / 5), abs=1e-6
        )
    assert costs[0] == pytest.approx(costs[1], rel=1e-6)


def test_a_plan_with_one_contingency_is_assessed() -> None:
    grid = parallel(shift=(-10, 10))
    grid.link = om.DCLine("a", "b", p=20)
    security = om.Security({"dc_lines": ["link"]}, screen=False)
    plan = om.MultiStage(grid, 1, formulation="dc", security=security).solve()
    assert [outcome.status for outcome in om.assess(plan, security).outcomes] == ["secure"]


def test_a_preventive_response_switches_no_shunts() -> None:
    grid = parallel()
    grid.update("town", p=40, q=20)
    grid.bank = om.Shunt("b", b=(0, 40), steps=4, move_cost=1)
    security = om.Security({"branches": ["one"]}, "preventive", rating=3, screen=False)
    plan = om.MultiStage(grid, 2, security=security).solve()
    assert plan.optimal
    assert om.assess(plan).secure


def test_trees_and_uneven_stages_count_moves_along_their_paths() -> None:
    grid, profiles = swinging()
    tree = om.Horizon.tree([1, 1, 2], {"low": 0.4, "high": 0.6}, common=1)
    plan = om.MultiStage(grid, tree, profiles=profiles).solve()
    assert plan.optimal
    for scenario in ("low", "high"):
        data = plan.scenario(scenario)
        moved = np.abs(np.diff(data.tap.sel(branch="trafo").values)) / 0.01
        assert data.tap_moves.sel(branch="trafo").values[1:] == pytest.approx(moved, abs=1e-3)


@pytest.mark.parametrize(
    ("component", "message"),
    [
        (lambda: om.Branch("a", "b", r=0, x=1, tap=(1.1, 0.9)), "x: tap = .*the minimum 1.1 is above"),
        (lambda: om.Branch("a", "b", r=0, x=1, tap=(0, 1)), "x: tap = .*at least 0.001"),
        (lambda: om.Branch("a", "b", r=0, x=1, tap="1"), "x: tap = '1': must be a number or a pair"),
        (lambda: om.Branch("a", "b", r=0, x=1, tap_steps=3), "x: tap_steps = 3: tap = 1.0 is constant"),
        (lambda: om.Branch("a", "b", r=0, x=1, tap=(0.9, 1.1), tap_steps=2.5), "tap_steps = 2.5: .*whole"),
        (lambda: om.Branch("a", "b", r=0, x=1, tap=(0.9, 1.1), move_cost=1), "move_cost = 1: needs tap_steps"),
        (lambda: om.Branch("a", "b", r=0, x=1, move_cost=1), "move_cost = 1: needs tap_steps or shift_steps"),
        (lambda: om.Shunt("a", b=(0, 1), steps=0), "steps = 0: must be at least 1"),
        (lambda: om.Shunt("a", b=(0, 1, 2)), "b = .*must be a pair"),
    ],
)  # fmt: skip
def test_errors_of_settings(component: object, message: str) -> None:
    grid = om.Network()
    with pytest.raises(om.OpfmodelError, match=message):
        grid.add("x", component())  # type: ignore[operator]


def test_a_scenario_file_may_adjust_a_network_file(tmp_path: Path) -> None:
    (tmp_path / "taps.yaml").write_text(
        f"""
network:
  file: {CASE14}
  update:
    {TRAFO}: {{tap: [0.9, 1.1], tap_steps: 17}}
time: {{steps: 2}}
controller: {{horizon: 2}}
"""
    )
    run = om.load_scenario(tmp_path / "taps.yaml").simulate()
    assert run.status == "done"
    assert ((run.data.tap.sel(branch=TRAFO) - 0.9) / 0.0125 % 1).values == pytest.approx(0.0, abs=1e-6)


def test_a_network_file_holds_neutral_values_and_says_so(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="tap is adjustable"):
        om.write_network(case14(tap=(0.95, 1.05)), tmp_path / "case.m", lossy=True)
    assert om.read_network(tmp_path / "case.m").of(om.Branch)[TRAFO].tap == 1.0


@pytest.mark.parametrize("plant", [om.NominalPlant(), om.PowerFlow()], ids=lambda p: type(p).__name__)
def test_a_budget_limits_the_moves_of_a_day(plant: om.Plant) -> None:
    grid, profiles = swinging()
    grid.update("trafo", move_cost=0.0)
    grid.moves = om.Budget(3, uses={"trafo": 1}, hours=24, over_cost=1e4)
    run = om.simulate(om.MultiStage(grid, 4, profiles=profiles, at_end="repeat"), plant, steps=4)
    assert run.status == "done"
    assert run.data.tap_moves.sum() >= 2 - 1e-6
    left = 3 - run.data.tap_moves.values.cumsum()
    assert run.data.budget_left_next.values[:, 0] == pytest.approx(left, abs=1e-4)
    assert check(grid, run.data, profiles).max_violation < 1e-6
    grid.update("trafo", move_cost=None)
    with pytest.raises(
        om.OpfmodelError, match=r"moves: uses.trafo: the moves of this branch are not counted"
    ):
        om.MultiStage(grid, 4, profiles=profiles).solve()
