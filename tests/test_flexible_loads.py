"""Flexible loads: energy in windows of the clock, in plans, trees, contingencies and closed loops."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings

import opfmodel as om
from opfmodel.check import check
from opfmodel.data.calendar import Calendar
from opfmodel.errors import CaseWarning, ComponentError, IncompatibleError, ProfileError
from opfmodel.forecasts import Noisy

PRICES = 40 + 25 * np.sin(0.7 * np.arange(96)) + 10 * np.cos(2.3 * np.arange(96))


def market(**fields: Any) -> om.Network:
    """A bus at which power has a price, and a flexible load."""
    grid = om.Network("market", base_mva=10)
    grid.bus = om.Bus()
    grid.supply = om.Generator("bus", p=(-50, 50), cost=om.Polynomial(0, 40, 0))
    grid.cars = om.FlexibleLoad("bus", **{"energy": 6.0, "power": (0, 2), **fields})
    return grid


def problem(
    horizon: int | om.Horizon, step: float | None = None, *, calendar: Calendar | None = None, **fields: Any
) -> om.MultiStage:
    """The problem of a market with prices that vary."""
    prices = om.Profiles({"supply.c1": PRICES}, calendar)
    return om.MultiStage(market(**fields), horizon, step, formulation="copperplate", profiles=prices)


def cheapest(windows: list[range], energy: float, most: float, step: float = 1.0) -> float:
    """Cost of the energy of each window in its cheapest stages."""
    cost = 0.0
    for window in windows:
        left = energy
        for price in sorted(PRICES[window]):
            cost += price * min(most * step, left)
            left -= min(most * step, left)
    return cost


# Plans ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fields", "step", "stages", "windows"),
    [
        ({}, 1.0, 48, [range(24), range(24, 48)]),
        ({"begin": 8, "hours": 9}, 1.0, 48, [range(8, 17), range(32, 41)]),
        # a window that crosses midnight is open at the beginning; its last seven hours take all
        ({"begin": 18, "hours": 13}, 1.0, 56, [range(7), range(18, 31), range(42, 55)]),
        ({"begin": 1.75, "hours": 4.5}, 0.25, 80, [range(7, 25)]),
        ({"begin": 1, "hours": 3.5, "every": 6}, 0.5, 47, [range(2, 9), range(14, 21), range(26, 33), range(38, 45)]),
        ({"begin": 30, "hours": 12, "every": 36}, 1.0, 48, [range(6), range(30, 42)]),
    ],
)  # fmt: skip
def test_energy_goes_to_the_cheapest_hours_of_each_window(
    fields: dict[str, float], step: float, stages: int, windows: list[range]
) -> None:
    case = problem(stages, step, **fields)
    plan = case.solve()
    assert plan.objective == pytest.approx(cheapest(windows, 6.0, 2.0, step), rel=1e-6)
    p = plan.data["flexible_load_p"].values[:, 0]
    for window in windows:
        assert step * p[window].sum() == pytest.approx(6.0, abs=1e-5)
    assert step * p.sum() == pytest.approx(6.0 * len(windows), abs=1e-4)
    assert check(case.network, plan.data, case.profiles).max_violation < 1e-6


def test_an_open_window_goes_on_from_what_was_delivered() -> None:
    plan = problem(24, begin=18, hours=13, delivered=4.5).solve()
    assert plan.data["flexible_load_p"].values[:7].sum() == pytest.approx(1.5, abs=1e-5)
    later = problem(24, begin=18, hours=13).solve(time=20, initial={"flexible_load_delivered": [5.0]})
    assert later.data["flexible_load_p"].values[:11].sum() == pytest.approx(1.0, abs=1e-5)
    opening = problem(13, begin=18, hours=13).solve(time=18, initial={"flexible_load_delivered": [5.0]})
    assert opening.data["flexible_load_p"].sum() == pytest.approx(6.0, abs=1e-5)


def test_a_plan_that_ends_in_a_window_can_finish_it() -> None:
    plan = problem(22, begin=18, hours=6).solve()  # two of six hours are left, which take 4 MWh
    assert plan.data["flexible_load_delivered_next"].values[-1, 0] == pytest.approx(2.0, abs=1e-5)


@pytest.mark.parametrize(
    ("day", "hours"),
    [("2025-03-30", 7), ("2025-10-26", 9), ("2025-05-05", 8)],  # clocks put forward, back, unchanged
)
def test_windows_are_those_of_the_local_clock(day: str, hours: int) -> None:
    midnight = {"2025-10-26": "22:00", "2025-03-30": "23:00", "2025-05-05": "22:00"}[day]
    start = np.datetime64(day) - np.timedelta64(1, "D")
    calendar = Calendar(np.datetime64(f"{start}T{midnight}"), 1.0, "Europe/Berlin")
    case = problem(24, calendar=calendar, begin=22, hours=8)  # to 6 o'clock of the next day
    plan = case.solve(initial={"flexible_load_delivered": [0.0]})
    assert check(case.network, plan.data, case.profiles).max_violation < 1e-6
    inside = plan.network.tables["flexible_load"].inside[0]
    assert int(inside[:12].sum()) == hours - 2
    # energy only in the last possible hours: the earlier the price falls, the later it is drawn
    late = om.Profiles({"supply.c1": -np.arange(48.0) + 60}, calendar)
    greedy = om.MultiStage(case.network, 24, formulation="copperplate", profiles=late).solve()
    p = greedy.data["flexible_load_p"].values[:, 0]
    assert p[hours - 5 : hours - 2] == pytest.approx(2.0, abs=1e-4)


@pytest.mark.parametrize("boundary", [2.0, 2.5, 3.0])
@pytest.mark.parametrize("day", ["2025-03-30", "2025-10-26"])
@pytest.mark.parametrize("which", ["begin", "end"])
def test_a_boundary_in_the_hour_of_a_clock_change_happens_once(boundary: float, day: str, which: str) -> None:
    before = np.datetime64(day) - np.timedelta64(1, "D")
    calendar = Calendar(np.datetime64(f"{before}T21:00"), 0.5, "Europe/Berlin")
    begin, hours = (boundary, 3.0) if which == "begin" else (boundary - 1.5, 1.5)
    case = problem(20, 0.5, calendar=calendar, begin=begin, hours=hours, energy=1)
    plan = case.solve(initial={"flexible_load_delivered": [0.0]})
    table = plan.network.tables["flexible_load"]
    assert (int((table.kept == 0).sum()), int(table.due.sum())) == (1, 1)
    assert check(case.network, plan.data, case.profiles).max_violation < 1e-6


def test_feeding_back_buys_low_and_sells_high() -> None:
    forward = problem(24, power=(0, 2)).solve()
    both = problem(24, power=(-2, 2)).solve()
    assert both.objective < forward.objective - 10
    assert both.data["flexible_load_p"].values.min() == pytest.approx(-2, abs=1e-5)
    assert both.data["flexible_load_delivered_next"].values.min() > -1e-6


def test_energy_is_lost_in_charging_and_reactive_power_is_drawn() -> None:
    grid = market(efficiency=0.8, power_factor=0.9, hours=6)
    grid.update("supply", q=(-20, 20))
    case = om.MultiStage(grid, 6, profiles={"supply.c1": PRICES})
    plan = case.solve()
    p, q = plan.data["flexible_load_p"].values, plan.data["flexible_load_q"].values
    assert p.sum() == pytest.approx(7.5, abs=1e-4)
    assert q == pytest.approx(p * np.tan(np.arccos(0.9)), abs=1e-7)
    assert plan.data["qg"].values == pytest.approx(q, abs=1e-5)
    assert check(grid, plan.data, case.profiles).max_violation < 1e-6


def test_energy_may_be_missing_at_a_cost() -> None:
    """It is drawn in the hours in which power costs less."""
    case = problem(48, unserved_cost=45.0, power=(0, 1), begin=6, hours=8)
    plan = case.solve()
    windows = [PRICES[6:14], PRICES[30:38]]
    expected = sum(
        sum(p for p in sorted(w)[:6] if p < 45) + 45 * sum(p >= 45 for p in sorted(w)[:6]) for w in windows
    )
    assert any(sorted(w)[5] > 45 for w in windows)
    assert plan.objective == pytest.approx(expected, rel=1e-6)
    report = check(case.network, plan.data, case.profiles)
    assert report.cost == pytest.approx(plan.objective, rel=1e-9)
    assert report.max_violation < 1e-6
    impossible = problem(24, unserved_cost=1e3, power=(0, 0.5), begin=6, hours=8).solve()
    assert impossible.data["flexible_load_delivered_next"].values[13, 0] == pytest.approx(4.0, abs=1e-5)


def test_power_follows_the_vehicles_that_are_present() -> None:
    present = np.where(np.arange(24) % 3 == 0, 3.0, 0.0)
    prices = {"supply.c1": PRICES, "cars.power_max": np.tile(present, 4)}
    case = om.MultiStage(market(), 24, formulation="copperplate", profiles=prices)
    plan = case.solve()
    p = plan.data["flexible_load_p"].values[:, 0]
    best = np.sort(PRICES[:24][present > 0])[:2]
    assert p[present == 0] == pytest.approx(0, abs=1e-6)
    assert plan.objective == pytest.approx(3 * best.sum(), rel=1e-6)
    assert check(case.network, plan.data, case.profiles).max_violation < 1e-6


# Horizons ------------------------------------------------------------------------------------------


def test_scenarios_share_what_was_drawn_before_they_split() -> None:
    horizon = om.Horizon.tree([1.0] * 6, {"low": 0.5, "high": 0.5}, common=2)
    case = om.MultiStage(
        market(hours=6, every=6), horizon, formulation="copperplate", profiles={"supply.c1": [40.0] * 6}
    )
    low = np.array([name == "low" for name in horizon.scenario])
    price = np.where(horizon.depth < 2, np.where(horizon.depth == 0, 50.0, 30.0), np.where(low, 10.0, 90.0))
    plan = case.solve(expected={("generator", "c1"): price[None, :] * case.arrays.base_mva})
    # 2 MWh at 30 $ in the common part; the rest costs 10 or 90; the first hour at 50 equals the mean
    assert plan.objective == pytest.approx(2 * 30 + 4 * 50, rel=1e-6)
    for name in ("low", "high"):
        data = plan.scenario(name)
        assert data["flexible_load_p"].sum() == pytest.approx(6, abs=1e-5)
        assert data["flexible_load_delivered_next"].values[-1, 0] == pytest.approx(6, abs=1e-5)


def test_uneven_stages_that_match_the_windows_are_exact() -> None:
    horizon = om.Horizon.grid([0.5, 0.5, 1, 2, 2, 0.5, 1.5])
    case = problem(horizon, begin=1, hours=5.5, power=(0, 2))
    plan = case.solve()
    prices = [PRICES[2:4].mean(), PRICES[4:8].mean(), PRICES[8:12].mean(), PRICES[12]]
    left, expected = 6.0, 0.0
    for price, length in sorted(zip(prices, [1, 2, 2, 0.5], strict=True)):
        expected += price * min(2 * length, left)
        left -= min(2 * length, left)
    assert plan.objective == pytest.approx(expected, rel=1e-6)
    assert check(case.network, plan.data, case.profiles).max_violation < 1e-6


@pytest.mark.parametrize(
    ("horizon", "fields", "stage"),
    [
        (om.Horizon.grid([1, 2, 1]), {"begin": 2, "hours": 2}, "2 h that begins at hour 1"),
        (om.Horizon.grid([1, 2, 1]), {"begin": 1, "hours": 1}, "2 h that begins at hour 1"),
        (om.Horizon.grid([1, 4, 1]), {"begin": 0, "hours": 2, "every": 2, "energy": 1}, "4 h"),
        (om.Horizon.chain(4), {"begin": 2.5, "hours": 4}, "1 h that begins at hour 2"),
        (om.Horizon.chain(4), {"begin": 0, "hours": 1.5, "energy": 1}, "1 h that begins at hour 1"),
    ],
)
def test_a_stage_across_the_edge_of_a_window_is_refused(
    horizon: om.Horizon, fields: dict[str, float], stage: str
) -> None:
    with pytest.raises(IncompatibleError, match=rf"^cars: a window from .* inside the stage of {stage}"):
        problem(horizon, **{"energy": 2, **fields}).solve()


def secure(formulation: str, response: str, screen: bool) -> om.MultiStage:
    """Two lines of which each must be able to go out at any time."""
    grid = om.Network("secure", base_mva=100)
    grid.north, grid.south = om.Bus(vm=(0.95, 1.05), reference=True), om.Bus(vm=(0.95, 1.05))
    for name in ("one", "two"):
        grid.add(name, om.Branch("north", "south", r=0.001, x=0.01, rating=30))
    grid.coal = om.Generator("north", p=(0, 100), q=(-50, 50), ramp=100, cost=om.Polynomial(0.05, 20, 0))
    grid.town = om.Load("south", p=18)
    grid.cars = om.FlexibleLoad("south", energy=40, power=(2, 30), begin=1, hours=3)
    security = om.Security({"branches": ["one"]}, response, screen=screen)  # type: ignore[arg-type]
    return om.MultiStage(grid, 5, formulation=formulation, security=security)


@pytest.mark.parametrize(
    ("formulation", "response"), [("dc", "corrective"), ("dc", "preventive"), ("ac", "corrective"), ("soc", "preventive")]
)  # fmt: skip
def test_after_an_outage_the_load_may_respond(formulation: str, response: str) -> None:
    """A corrective response draws less for a while; a preventive one needs room on the lines in advance."""
    case = secure(formulation, response, screen=False)
    if response == "preventive":  # 12 MW in each of three hours are too little
        assert case.solve().infeasible
        case.network.update("cars", energy=30)
        case = om.MultiStage(case.network, 5, formulation=formulation, security=case.security)
    plan = case.solve()
    assert plan.optimal
    p = plan.solution.value("flexible_load_p")[0] * plan.network.base_mva
    drawn, after = p[:5], p[5:]
    assert drawn[1:4].sum() == pytest.approx(40 if response == "corrective" else 30, abs=1e-3)
    assert after[[0, 4]] == pytest.approx(0, abs=1e-5)
    assert after.max() <= 12.01
    if response == "preventive":
        assert after == pytest.approx(drawn, abs=1e-4)
    screened = om.MultiStage(
        case.network, 5, formulation=formulation, security=om.Security({"branches": ["one"]}, response)
    )
    assert screened.solve().objective == pytest.approx(plan.objective, rel=1e-5)


def test_an_elastic_problem_reports_what_is_missing() -> None:
    case = om.MultiStage(
        market(begin=1, hours=4), 6, formulation="copperplate", elastic=om.Elastic(), profiles={"supply.c1": PRICES}
    )  # fmt: skip
    assert case.solve().shortages == ()
    late = case.solve(time=3, initial={"flexible_load_delivered": [1.0]})
    (shortage,) = late.shortages
    assert "cars lacks 1 MWh to complete its energy" in str(shortage)
    assert late.data["flexible_load_p"].values[:2].sum() == pytest.approx(4, abs=1e-4)
    hard = problem(6, begin=1, hours=4).solve(time=3, initial={"flexible_load_delivered": [1.0]})
    assert hard.infeasible


# Closed loops --------------------------------------------------------------------------------------


@pytest.mark.parametrize("at_end", ["error", "shrink", "repeat"])
def test_a_loop_that_sees_each_window_costs_what_one_plan_costs(at_end: str) -> None:
    grid, prices = market(begin=18, hours=13), {"supply.c1": PRICES[: 32 + 13 * (at_end == "error")]}
    options: dict[str, Any] = {"formulation": "copperplate", "profiles": prices}
    whole = om.MultiStage(grid, 32, **options).solve()
    run = om.simulate(om.MultiStage(grid, 14, at_end=at_end, **options), steps=32)
    assert run.status == "done"
    assert run.cost == pytest.approx(whole.objective, rel=1e-5)
    assert check(grid, run.data, prices).max_violation < 1e-6


@settings(max_examples=8)
@given(data=st.data())
def test_every_window_gets_its_energy(data: st.DataObject) -> None:
    """Also if the horizon is shorter than a window: what is drawn leaves enough time for the rest."""
    step = data.draw(st.sampled_from([0.25, 0.5, 1.0]), "step")
    period = data.draw(st.integers(2, 10), "steps from window to window")
    length = data.draw(st.integers(1, period), "steps of a window")
    first = data.draw(st.integers(0, period - 1), "first step of a window")
    energy = data.draw(st.floats(0.1, 1.0), "share") * 2.0 * length * step
    case = problem(
        data.draw(st.integers(1, 6), "horizon"),
        step,
        begin=first * step,
        hours=length * step,
        every=period * step,
        power=(data.draw(st.sampled_from([0.0, -1.0]), "minimum"), 2.0),
        energy=energy,
    )
    state: Any = None
    drawn = []
    for time in range(first, first + 2 * period):
        plan = case.solve(time, state)
        assert plan.optimal
        state = plan.next_state()
        drawn.append(float(plan.solution.value("flexible_load_p")[0, 0]) * plan.network.base_mva)
    power = np.array(drawn).reshape(2, period)
    assert power[:, length:] == pytest.approx(0, abs=1e-6)
    assert step * power.sum(axis=1) == pytest.approx([energy] * 2, abs=1e-4)


@pytest.mark.parametrize("plant", [om.PowerFlow(), om.Redispatch()])
def test_plants_hold_what_is_drawn(plant: om.Plant) -> None:
    grid = om.Network("feeder", base_mva=100)
    grid.north, grid.south = om.Bus(vm=(0.9, 1.1), reference=True), om.Bus(vm=(0.9, 1.1))
    grid.tie = om.Branch("north", "south", r=0.002, x=0.02, rating=100)
    grid.coal = om.Generator("north", p=(0, 80), q=(-50, 50), cost=om.Polynomial(0.1, 20, 0))
    grid.town = om.Load("south", p=40, q=10)
    grid.cars = om.FlexibleLoad("south", energy=12, power=(0, 5), begin=2, hours=5, every=8, power_factor=0.9)
    series = {"town.p": 40 + 8 * np.sin(np.arange(20)), "town.q": np.full(20, 10.0)}
    controller = om.Controller(om.MultiStage(grid, 6, profiles=series), Noisy(deviation=0.03, seed=1))
    run = om.simulate(controller, plant, steps=15)
    assert run.status == "done"
    drawn = run.data["flexible_load_p"].values[:, 0]
    assert (drawn[2:7].sum(), drawn[10:15].sum()) == pytest.approx((12, 12), abs=1e-3)
    families = check(grid, run.data, series).violations
    assert max(families[f].physical for f in families if f.startswith(("flexible", "active", "reac"))) < 1e-4


def test_there_are_no_single_stage_optima_of_a_window() -> None:
    grid = om.Network("window")
    grid.bus = om.Bus()
    grid.unit = om.Generator("bus", p=(0, 50))
    grid.cars = om.FlexibleLoad("bus", energy=6, power=(0, 4), hours=4)
    with pytest.raises(IncompatibleError, match="flexible_load carries its flexible_load_delivered"):
        om.single_stage_sequence(om.MultiStage(grid, 4, formulation="dc"), 4)


def test_a_power_flow_draws_the_set_point() -> None:
    grid = om.Network("flow")
    grid.bus = om.Bus(reference=True)
    grid.unit = om.Generator("bus", p=(0, 50), q=(-20, 20))
    grid.cars = om.FlexibleLoad("bus", energy=6, power=(0, 4), power_factor=0.8, p_set=3)
    flow = om.power_flow(grid)
    assert flow.slack["bus"] == pytest.approx(3)
    assert float(flow.data["qg"].sum()) == pytest.approx(2.25)


# Errors, files, figures ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"energy": -1}, "energy = -1: must be at least 0"),
        ({"energy": 50}, "energy = 50: a window takes at most 48 MWh; state unserved_cost"),
        ({"power": (1, 2), "energy": 6}, "energy = 6: a window takes at least 24 MWh"),
        ({"power": 2}, "power = 2: must be a pair"),
        ({"power": (0, float("inf"))}, "power = .*: both ends must be finite"),
        ({"power": (-1, 2), "efficiency": 0.9}, "efficiency = 0.9: must be 1 for a load that feeds back"),
        ({"efficiency": 0.0}, "efficiency = 0"),
        ({"efficiency": 1.1}, "efficiency = 1.1: must be at most 1"),
        ({"begin": 24}, "begin = 24: must be below every = 24"),
        ({"begin": -1}, "begin = -1: must be at least 0"),
        ({"hours": 25}, "hours = 25: must be at most every = 24"),
        ({"hours": 0}, "hours = 0: must be greater than 0"),
        ({"every": 0}, "every = 0: must be greater than 0"),
        ({"power_factor": 0}, "power_factor = 0"),
        ({"power_factor": 1.2}, "power_factor = 1.2: must be at most 1"),
        ({"unserved_cost": -5}, "unserved_cost = -5: must be at least 0"),
        ({"delivered": 7}, "delivered = 7: must be at most energy = 6"),
        ({"delivered": "much"}, "delivered = 'much': must be a number"),
        ({"p_set": "low"}, "p_set = 'low': must be a number"),
        ({"departure": 7}, "departure = 7: unknown field"),
    ],
)
def test_a_bad_field_is_named(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(ComponentError, match=message):
        market(**fields)


def test_only_power_has_a_series() -> None:
    with pytest.raises(ProfileError, match="the energy of a flexible_load is constant"):
        om.MultiStage(market(), 2, profiles={"cars.energy": [1, 2]})
    with pytest.raises(ProfileError, match="the inside of a flexible_load is constant"):
        om.MultiStage(market(), 2, profiles={"cars.inside": [1, 0]})


FALSE = [
    ({"flexible_load_p": (3, 0.1)}, "flexible load dynamics"),
    ({"flexible_load_p": (3, 2.5)}, "flexible load power"),
    ({"flexible_load_p": (10, 0.1)}, "flexible load power"),
    ({"flexible_load_p": (3, 0.1)}, "active balance"),
    ({"flexible_load_q": (3, 0.1)}, "flexible load q"),
    ({"flexible_load_delivered": (4, 0.1)}, "flexible load continuity"),
    ({"flexible_load_delivered_next": (5, -0.1)}, "flexible load due"),
    ({"flexible_load_delivered_next": (5, 0.1)}, "flexible load energy"),
]


@pytest.mark.parametrize(("change", "family"), FALSE)
def test_the_check_finds_falsified_data(change: dict[str, tuple[int, float]], family: str) -> None:
    grid = market(begin=2, hours=4, every=12)
    grid.update("supply", q=(-20, 20))
    plan = om.MultiStage(grid, 12, profiles={"supply.c1": PRICES}).solve()
    data = plan.data.copy(deep=True)
    assert check(grid, data, {"supply.c1": PRICES}).max_violation < 1e-6
    for name, (stage, value) in change.items():
        data[name][stage] += value
    assert check(grid, data, {"supply.c1": PRICES}).violations[family].value > 1e-4


@pytest.mark.parametrize("fields", [{"begin": 3}, {"hours": 3}, {"every": 6, "begin": 2}, {"energy": 6.5}])
def test_the_check_finds_another_window(fields: dict[str, float]) -> None:
    grid = market(begin=2, hours=4, every=12)
    plan = om.MultiStage(grid, 12, formulation="copperplate").solve()
    other = market(**{"begin": 2, "hours": 4, "every": 12, **fields})
    assert check(other, plan.data).max_violation > 1e-3


def test_a_scenario_file_with_a_charging_station(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text("""
network:
  buses: {a: {}}
  generators: {g: {bus: a, p: [0, 90], cost: {c2: 1, c1: 10}}}
  loads: {l: {bus: a, p: 20}}
  flexible_loads: {cars: {bus: a, energy: 8, power: [0, 4], begin: 1, hours: 4, every: 6}}
controller: {horizon: 6, formulation: copperplate}
time: {steps: 6}
""")
    run = om.load_scenario(tmp_path / "s.yaml").simulate()
    assert run.data["flexible_load_p"].values[:, 0] == pytest.approx([0, 2, 2, 2, 2, 0], abs=1e-3)


def test_figures_and_limits_show_the_load() -> None:
    from opfmodel.results.figures import demand, system

    plan = problem(24, begin=6, hours=8).solve()
    for draw in (system, demand):
        labels = [line.get_label() for axis in draw(plan.data).axes for line in axis.get_lines()]
        assert "flexible demand" in labels
    most = plan.data["flexible_load_p_max"].values[:, 0]
    assert most == pytest.approx([0] * 6 + [2] * 8 + [0] * 10)


def test_a_writer_reports_the_load_as_lost(tmp_path: Path) -> None:
    with pytest.warns(CaseWarning, match="flexible_loads cars: MATPOWER has no such equipment"):
        om.write_network(market(), tmp_path / "case.m")
