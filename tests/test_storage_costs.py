"""Storages with a cost of throughput, wanted energy and recovery; generators whose slopes change."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

import opfmodel as om
from opfmodel.analysis.subject import Subject
from opfmodel.check import check
from opfmodel.data.calendar import Calendar, Times
from opfmodel.errors import CaseError, ComponentError, IncompatibleError, ProfileError
from opfmodel.forecasts import Noisy
from opfmodel.model.elastic import Elastic


def shop(price: float = 30.0, **fields: Any) -> om.Network:
    """A storage at a bus with a generator of constant price."""
    made = om.Network("shop", base_mva=100)
    made.a = om.Bus(vm=(0.9, 1.1))
    made.unit = om.Generator("a", p=(-50, 50), q=(-20, 20), cost=om.Polynomial(0, price, 0))
    made.cell = om.Storage("a", **{"energy": 10, "power": 3, **fields})
    made.town = om.Load("a", p=5)
    return made


def solved(network: om.Network, horizon: Any, series: Any = None, **options: Any) -> om.Plan:
    settings = {"formulation": "dc", "solver": "clarabel", "regularisation": 0.0, **options}
    initial = settings.pop("initial", None)
    time = settings.pop("time", 0)
    plan = om.MultiStage(network, horizon, profiles=series, **settings).solve(time, initial)
    assert plan.optimal, plan.termination
    return plan


def closed(plan: om.Plan, network: om.Network, series: Any = None) -> None:
    """The independent check accepts a plan and finds the same cost."""
    report = check(network, plan.data, series, plan.time)
    assert report.max_violation < 1e-6, report.worst
    assert report.cost == pytest.approx(plan.objective, rel=1e-9, abs=1e-6)


def energies(plan: om.Plan) -> Any:
    return plan.data["e_next"].sel(storage="cell").values


# Throughput -----------------------------------------------------------------------------------------


@given(st.integers(0, 10_000), st.sampled_from([1.0, 0.9]))
@settings(max_examples=4)
def test_throughput_costs_what_a_linear_program_says(seed: int, efficiency: float) -> None:
    rng = np.random.default_rng(seed)
    n, hours = 6, rng.choice([1.0, 2.0], 6)
    steps = int(hours.sum())
    price, wear = rng.uniform(10, 80, steps), rng.uniform(0, 15, steps)
    network = shop(charge_efficiency=efficiency, initial=4, throughput_cost=1)
    series = {"unit.c1": price, "cell.throughput_cost": wear}
    plan = solved(network, om.Horizon.grid([*hours], 1.0), series)
    parts = np.split(np.arange(steps), np.cumsum(hours).astype(int)[:-1])
    price, wear = (np.array([values[part].mean() for part in parts]) for values in (price, wear))
    # the LP buys for the load and the storage: charging, discharging, energy
    cost = np.concatenate([hours * (price + wear), hours * (wear - price), np.zeros(n)])
    dynamics = np.hstack([-np.diag(hours * efficiency), np.diag(hours), np.eye(n) - np.eye(n, k=-1)])
    start = np.zeros(n)
    start[0] = 4.0
    found = linprog(cost, A_eq=dynamics, b_eq=start, bounds=[(0, 3)] * (2 * n) + [(0, 10)] * n)
    assert plan.objective == pytest.approx(found.fun + 5 * float(hours @ price), rel=1e-7)
    closed(plan, network, series)


def test_a_storage_without_new_costs_adds_nothing_to_the_program() -> None:
    program = om.MultiStage(shop(), 3, formulation="dc").compile()
    assert program.epigraphs == ()
    assert {"e_wanted", "e_recovery_low"}.isdisjoint(program.rows)
    assert "storage_outside" not in program.variables


def test_throughput_is_not_worth_a_small_spread() -> None:
    series = {"unit.c1": [20.0, 30.0]}
    for wear, moved in ((4.9, 3.0), (5.1, 0.0)):  # each MWh is charged and discharged
        plan = solved(shop(initial=0, throughput_cost=wear), 2, series)
        assert plan.data["ps"].values[:, 0] == pytest.approx([moved, -moved], abs=1e-5)
        closed(plan, shop(initial=0, throughput_cost=wear), series)


def test_the_cost_of_throughput_is_paid_in_ac_and_in_a_closed_loop() -> None:
    network = shop(initial=5, throughput_cost=3)
    series = {"unit.c1": [20.0, 60.0, 15.0, 70.0], "town.p": [5.0, 6.0, 4.0, 7.0]}
    run = om.simulate(
        om.Controller(om.MultiStage(network, 2, profiles=series, at_end="repeat"), forecast=Noisy(0.1, 2)),
        om.PowerFlow(),
        steps=4,
    )
    report = check(network, run.data, series)
    assert report.max_violation < 1e-6, report.worst
    expected = series["unit.c1"] @ run.data["pg"].values[:, 0] + 3 * np.abs(run.data["ps"].values).sum()
    assert run.cost == pytest.approx(expected, rel=1e-9) == report.cost


# Energy wanted at given hours -----------------------------------------------------------------------


def test_wanted_energy_is_there_at_the_hour() -> None:
    network = shop(initial=1, wanted=8, wanted_at=4, wanted_every=6)
    series = {"unit.c1": np.tile([10.0, 20, 90, 95, 15, 12], 2)}  # better empty at that hour
    plan = solved(network, 12, series)
    stored = energies(plan)
    assert stored[[3, 9]] == pytest.approx([8, 8], abs=1e-5)
    closed(plan, network, series)
    broken = plan.data.copy(deep=True)
    broken["e_next"].values[3] -= 0.5
    assert check(network, broken, series).violations["wanted energy"].physical == pytest.approx(0.5, abs=1e-4)
    plain = shop(initial=1)
    limits = np.where(np.arange(12) % 6 == 3, 8.0, 0.0)  # the other way to state it
    assert energies(solved(plain, 12, series))[[3, 9]] == pytest.approx([0, 0], abs=1e-5)
    other = solved(plain, 12, {**series, "cell.energy_min": limits})
    assert other.objective == pytest.approx(plan.objective, rel=1e-7)


def test_it_is_wanted_at_the_end_of_a_stage_that_contains_the_hour() -> None:
    network = shop(initial=1, wanted=7, wanted_at=3)
    plan = solved(network, om.Horizon.grid([1, 1, 4, 2], 1.0), {"unit.c1": np.arange(8) + 5.0})
    assert energies(plan)[2] == pytest.approx(7, abs=1e-5)
    closed(plan, network, {"unit.c1": np.arange(8) + 5.0})


def test_the_hour_is_local_time() -> None:
    storage = om.Storage("a", energy=9, power=1, wanted=5, wanted_at=7)
    calendar = Calendar(np.datetime64("2025-03-29T11:00"), 1.0, "Europe/Berlin")  # noon
    wanted = storage.at_clock(Times(np.arange(48), 1.0, calendar))["energy_wanted"]
    assert np.flatnonzero(wanted).tolist() == [17, 17 + 24]  # the night is an hour shorter
    assert set(wanted.tolist()) == {0.0, 5.0}
    late = om.Storage("a", energy=9, power=1, wanted=5, wanted_at=30, wanted_every=1000)
    assert np.flatnonzero(late.at_clock(Times(np.arange(48), 1.0))["energy_wanted"]).tolist() == [29]


def test_an_elastic_plan_is_short_of_what_is_wanted() -> None:
    network = shop(initial=1, wanted=9, wanted_at=2)
    problem = om.MultiStage(network, 2, formulation="dc", elastic=Elastic())
    assert not om.MultiStage(network, 2, formulation="dc").solve().optimal
    plan = problem.solve()
    assert [str(each) for each in plan.shortages] == [
        "storage cell is 2 MWh short of what is wanted at hour 1"
    ]


def test_every_scenario_reaches_it_and_contingencies_need_not() -> None:
    network = shop(initial=1, wanted=7, wanted_at=2, wanted_every=2)
    network.gas = om.Generator("a", p=(0, 9), q=(0, 0), cost=om.Polynomial(0, 90, 0))
    horizon = om.Horizon.tree([1, 1, 1], {"low": 0.5, "high": 0.5}, common=1)
    plan = solved(network, horizon)
    for name in ("low", "high"):
        assert plan.scenario(name)["e_next"].values[1, 0] >= 7 - 1e-6
    network.update("cell", initial=4, wanted=7, wanted_at=1)  # by charging until the hour; then it discharges
    network.update("gas", p=(0, 3))
    secured = solved(network, 1, security=om.Security({"generators": ["unit"]}, screen=False))
    assert energies(secured)[0] == pytest.approx(7, abs=1e-5)
    after = secured.solution.value("e_next")[0, 1] * secured.network.base_mva
    assert 7 - 0.25 * 3 - 1e-6 < after < 7 - 0.25 * 2 + 1e-6
    closed(secured, network)


# Recovery -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("solver", ["clarabel", "ipopt"])
def test_a_start_below_the_minimum_recovers_at_its_price(solver: str) -> None:
    fields = {"energy_min": 8, "power": 2, "initial": 3}
    network = shop(recovery_cost=100, **fields)
    series = {"unit.c1": [33.0, 32.0, 31.0, 30.0]}  # better to buy late
    plan = solved(network, 4, series, solver=solver)
    assert energies(plan) == pytest.approx([5, 7, 8, 8], abs=1e-4)
    assert plan.data["storage_outside"].values[:, 0] == pytest.approx([3, 1, 0, 0], abs=1e-4)
    bought = 33 * 7 + 32 * 7 + 31 * 6 + 30 * 5
    assert plan.objective == pytest.approx(bought + 100 * (3 + 1), rel=1e-6)
    report = check(network, plan.data, series)
    assert report.max_violation < 1e-6, report.worst
    assert report.cost == pytest.approx(plan.objective, rel=1e-6)
    with pytest.raises(ComponentError, match="initial = 3: must be between energy_min = 8"):
        shop(**fields)
    plain = om.MultiStage(shop(energy_min=8, power=2), 4, formulation="dc", solver=solver)
    assert not plain.solve(initial={"e": [3.0]}).optimal


def test_a_capacity_that_falls_is_left_over_time() -> None:
    network = shop(price=-20, recovery_cost=100, power=1, initial=9)  # energy is worth storing
    series = {"cell.energy": [6.0] * 4}
    plan = solved(network, 4, series)
    assert energies(plan) == pytest.approx([8, 7, 6, 6], abs=1e-4)
    assert plan.objective == pytest.approx(-20 * (4 * 5 - 3) + 100 * (2 + 1), rel=1e-6)
    cheap = shop(price=-20, recovery_cost=1, power=1, initial=9)  # cheaper than to discharge
    assert energies(solved(cheap, 4, series)).min() > 8.99


def test_recovery_goes_with_ends_and_soft_limits_and_outages() -> None:
    network = shop(energy_min=4, recovery_cost=50, initial=2, wanted=5, wanted_at=3)
    network.gas = om.Generator("a", p=(0, 9), q=(0, 0), cost=om.Polynomial(0, 90, 0))
    full = solved(network, 3, end=om.End(minimum=0.9))
    assert energies(full)[-1] == pytest.approx(9, abs=1e-5)
    closed(full, network)
    soft = solved(network, 3, elastic=Elastic(), end=om.End(minimum=0.9))
    assert not soft.shortages
    assert soft.objective == pytest.approx(full.objective, rel=1e-6)
    gone = om.MultiStage(network, 3, formulation="dc", outages=["cell"], solver="clarabel").solve(
        out=["cell"]
    )
    assert gone.optimal
    assert energies(gone) == pytest.approx([2, 2, 2], abs=1e-6)
    closed(gone, network)
    secured = solved(network, 2, security=om.Security({"generators": ["unit"]}, screen=False))
    outside = secured.solution.value("storage_outside")[0]
    assert (outside[2:] <= outside[:2] + 1e-9).all()


@pytest.mark.parametrize("plant", [om.PowerFlow(), om.Redispatch()], ids=["power-flow", "redispatch"])
def test_a_closed_loop_recovers(plant: Any) -> None:
    network = shop(energy_min=6, recovery_cost=80, initial=1, power=2, q=1)
    series = {"town.p": [5.0, 6.0, 4.0, 5.0, 5.0], "unit.c1": [34.0, 33.0, 32.0, 31.0, 30.0]}
    run = om.simulate(om.MultiStage(network, 2, profiles=series), plant, steps=4)
    assert run.status == "done"
    assert run.data["e_next"].values[:, 0] == pytest.approx([3, 5, 6, 6], abs=1e-3)
    report = check(network, run.data, series)
    assert report.max_violation < 1e-6, report.worst
    assert report.cost == pytest.approx(run.cost, rel=1e-6)


@pytest.mark.parametrize(
    ("family", "quantity", "change"),
    [
        ("storage outside", "storage_outside", lambda x: x + 0.1),
        ("storage outside", "e_next", lambda x: x - 0.1),
        ("storage dynamics", "e_next", lambda x: x + 0.1),
    ],
)
def test_falsified_recovery_is_found(family: str, quantity: str, change: Callable[[Any], Any]) -> None:
    network = shop(energy_min=8, power=2, initial=3, recovery_cost=100)
    data = solved(network, 3).data.copy(deep=True)
    data[quantity].values[:] = change(data[quantity].values)
    assert check(network, data).violations[family].physical > 0.09
    rate = check(network, data.assign(ps=data["ps"] + 1)).cost
    assert rate == pytest.approx(check(network, data).cost)  # without a cost of throughput


# Slopes ---------------------------------------------------------------------------------------------

POINTS = ((2.0, 30.0), (10.0, 190.0), (30.0, 890.0))


def bends(**options: Any) -> om.Network:
    made = om.Network("bends", base_mva=100)
    made.a = om.Bus(vm=(0.9, 1.1))
    made.coal = om.Generator("a", p=(2, 30), q=(-9, 9), cost=om.PiecewiseLinear(POINTS), **options)
    made.gas = om.Generator(
        "a", p=(0, 40), q=(-9, 9), cost=om.PiecewiseLinear([(0, 0), (20, 500), (40, 1400)])
    )
    made.town = om.Load("a", p=25)
    return made


@given(st.integers(0, 10_000))
@settings(max_examples=4)
def test_slopes_that_change_give_one_linear_program_per_hour(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 4
    low = rng.uniform(5, 40, n)
    series = {
        "coal.slope_1": low,
        "coal.slope_2": low + rng.uniform(0, 30, n),
        "town.p": rng.uniform(5, 60, n),
    }
    if seed % 2:
        del series["coal.slope_2"]
        series["coal.slope_1"] = rng.uniform(0, 35, n)
    plan = solved(bends(), n, series)
    expected = 0.0
    for k in range(n):  # by the power in each segment
        first, second = series["coal.slope_1"][k], series.get("coal.slope_2", np.full(n, 35.0))[k]
        found = linprog(
            [first, second, 25, 45], A_eq=np.ones((1, 4)), b_eq=[series["town.p"][k] - 2],
            bounds=[(0, 8), (0, 20), (0, 20), (0, 20)],
        )  # fmt: skip
        expected += found.fun + 30
    assert plan.objective == pytest.approx(expected, rel=1e-7)
    closed(plan, bends(), series)


def test_slopes_are_averaged_over_long_stages_and_forecast() -> None:
    series = {"coal.slope_1": [10.0, 10, 12, 20], "coal.slope_2": [40.0, 30, 30, 30]}
    uneven = solved(bends(), om.Horizon.grid([1, 1, 2], 1.0), series)
    mean = solved(bends(), 3, {"coal.slope_1": [10.0, 10, 16], "coal.slope_2": [40.0, 30, 30]})
    assert uneven.node_costs == pytest.approx(mean.node_costs * [1, 1, 2], rel=1e-7)
    closed(uneven, bends(), series)
    network = bends(ramp=10)
    run = om.simulate(om.MultiStage(network, 2, profiles=series, at_end="repeat"), om.PowerFlow(), steps=4)
    report = check(network, run.data, series)
    assert report.max_violation < 1e-6
    assert report.cost == pytest.approx(run.cost, rel=1e-9)


def test_a_unit_that_is_out_costs_nothing_whatever_its_slopes() -> None:
    problem = om.MultiStage(
        bends(),
        2,
        formulation="dc",
        profiles={"coal.slope_1": [3.0, 4.0]},
        outages=["coal"],
        solver="clarabel",
    )
    plan = problem.solve(out=["coal"])
    assert plan.objective == pytest.approx(2 * (500 + 5 * 45), rel=1e-6)
    report = check(bends(), plan.data, {"coal.slope_1": [3.0, 4.0]})
    assert report.cost == pytest.approx(plan.objective, rel=1e-6)


@pytest.mark.parametrize(
    ("series", "message"),
    [
        ({"coal.slope_1": [10, 36]}, "'coal.slope_1': step 1: 36: must be at most slope_2 = 35"),
        ({"coal.slope_2": [40, 19]}, "'coal.slope_2': step 1: 19: must be at least slope_1 = 20"),
        ({"coal.slope_1": [10, 30], "coal.slope_2": [9, 40]}, "step 0: .* slope_"),
        ({"coal.slope_3": [10, 20]}, "a generator has no number 'slope_3'"),
        ({"coal.c1": [10, 20]}, "the cost of 'coal' is piecewise linear; its numbers are slope_1, slope_2"),
        ({"coal.slope_1": [10, np.inf]}, "step 1: inf: must be a finite number"),
        ({"cell.wanted": [1, 2]}, "the wanted of a storage is constant"),
        ({"cell.throughput_cost": [1, -2]}, "step 1: -2: must be at least 0"),
        ({"cell.energy_wanted": [1, 2]}, "the energy_wanted of a storage is constant"),
    ],
)
def test_wrong_series_are_refused(series: dict[str, Any], message: str) -> None:
    network = bends()
    network.cell = om.Storage("a", energy=1, power=1)
    with pytest.raises(ProfileError, match=message):
        om.MultiStage(network, 2, profiles=series)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"throughput_cost": -1}, "cell: throughput_cost = -1: must be at least 0"),
        ({"wanted": 11}, "cell: wanted = 11: must be at most energy = 10"),
        ({"wanted": -1}, "cell: wanted = -1: must be at least 0"),
        ({"wanted_at": "noon"}, "cell: wanted_at = 'noon': must be a number in h"),
        ({"wanted_every": 0}, "cell: wanted_every = 0: must be greater than 0"),
        ({"recovery_cost": 0}, "cell: recovery_cost = 0: must be greater than 0"),
        ({"energy_min": 11, "recovery_cost": 4}, "cell: energy_min = 11: must be at most energy = 10"),
    ],
)
def test_wrong_fields_are_refused(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(ComponentError, match=message):
        shop(**fields)


@pytest.mark.filterwarnings("ignore:.*buses are numbered")
@pytest.mark.parametrize("fields", [{"throughput_cost": 1}, {"wanted": 3}, {"recovery_cost": 9}])
def test_a_case_has_none_of_the_fields(fields: dict[str, Any], tmp_path: Path) -> None:
    om.write_network(shop(), tmp_path / "case.m", lossy=False)
    with pytest.raises(CaseError, match="cell: throughput_cost, wanted and recovery_cost are left out"):
        om.write_network(shop(**fields), tmp_path / "case.m", lossy=False)


def test_a_scenario_file_has_the_fields(tmp_path: Path) -> None:
    rows = [f"{10 + k},{30 + k},2\n" for k in range(6)]
    (tmp_path / "series.csv").write_text("unit.slope_1,unit.slope_2,cell.throughput_cost\n" + "".join(rows))
    (tmp_path / "shop.yaml").write_text(
        """
name: shop
network:
  buses: {a: {}}
  generators: {unit: {bus: a, p: [0, 20], cost: {points: [[0, 0], [5, 100], [20, 700]]}}}
  storages:
    cell: {bus: a, energy: 6, power: 2, initial: 0, energy_min: 1, throughput_cost: 2 $/MWh,
           wanted: 4 MWh, wanted_at: 2 h, recovery_cost: 70 $/MWh/h}
  loads: {town: {bus: a, p: 4}}
time: {step: 1, steps: 3}
profiles: [{table: {file: series.csv}}]
controller: {horizon: 3, formulation: dc}
"""
    )
    scenario = om.load_scenario(tmp_path / "shop.yaml")
    run = scenario.simulate()
    assert run.status == "done"
    report = check(scenario.network, run.data, scenario.profiles)
    assert report.max_violation < 1e-6
    assert report.cost == pytest.approx(run.cost, rel=1e-6)
    assert run.data["e_next"].values[1, 0] == pytest.approx(4, abs=1e-5)


def test_energy_wanted_at_an_hour_has_no_steady_state() -> None:
    grid = om.Network("wanted")
    grid.bus = om.Bus()
    grid.unit = om.Generator("bus", p=(0, 50))
    grid.cell = om.Storage("bus", energy=10, power=5, wanted=8, wanted_at=3)
    with pytest.raises(IncompatibleError, match="cell: wanted depends on the time of day"):
        Subject(om.MultiStage(grid, 3, formulation="dc"))
