"""Connections to another grid: tariffs, peak charges, plants and outages, against a linear program."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
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
from opfmodel.errors import (
    CaseError,
    ComponentError,
    IncompatibleError,
    ModelError,
    ProfileError,
    SecurityError,
)
from opfmodel.forecasts import Noisy
from opfmodel.model.elastic import Elastic
from opfmodel.network.inspection import inspect
from opfmodel.results.aggregates import injections
from opfmodel.results.figures import system

HOURS = 24
RNG = np.random.default_rng(5)
BUY = 30 + 25 * RNG.random(HOURS)
SERIES = {"grid.buy": BUY, "grid.sell": 0.7 * BUY, "town.p": 8 + 6 * RNG.random(HOURS)}


def site(**fields: Any) -> om.Network:
    """A load with a battery behind a connection."""
    made = om.Network("site", base_mva=100)
    made.a = om.Bus(vm=(0.9, 1.1), reference=True)
    made.b = om.Bus(vm=(0.9, 1.1))
    made.line = om.Branch("a", "b", r=0.01, x=0.05)
    given = {"p": (-30, 40), "q": (-20, 20), "buy": 40, "sell": 10, "peak_cost": 300, **fields}
    made.grid = om.Connection("a", **given)
    made.cell = om.Storage("b", energy=16, power=5, q=2, initial=6)
    made.town = om.Load("b", p=10, q=1)
    return made


def by_hand(
    buy: Sequence[float], sell: Sequence[float], load: Sequence[float], hours: Sequence[float],
    period: Sequence[int], charge: float, before: float,
) -> float:  # fmt: skip
    """Cost of the site: imports, exports, charging, energy and the peak of each period as one LP."""
    n, periods = len(load), max(period) + 1
    imports, exports, charging, energy = (slice(k * n, (k + 1) * n) for k in range(4))
    size = 4 * n + periods
    cost = np.zeros(size)
    cost[imports], cost[exports] = np.multiply(buy, hours), -np.multiply(sell, hours)
    cost[4 * n :] = charge
    balance, dynamics = np.zeros((n, size)), np.zeros((n, size))
    balance[:, imports], balance[:, exports], balance[:, charging] = np.eye(n), -np.eye(n), -np.eye(n)
    dynamics[:, energy], dynamics[:, charging] = np.eye(n) - np.eye(n, k=-1), -np.diag(hours)
    peaks = np.zeros((n, size))
    peaks[:, imports], peaks[:, exports] = np.eye(n), -np.eye(n)
    peaks[np.arange(n), 4 * n + np.array(period)] = -1.0
    first = np.zeros(n)
    first[0] = 6.0
    bounds = [(0, 40)] * n + [(0, 30)] * n + [(-5, 5)] * n + [(0, 16)] * n + [(before, None)]
    found = linprog(
        cost, peaks, np.zeros(n), np.vstack([balance, dynamics]), np.concatenate([load, first]),
        [*bounds, *[(0, None)] * (periods - 1)], options={"dual_feasibility_tolerance": 1e-10},
    )  # fmt: skip
    assert found.status == 0
    return float(found.fun) - charge * before


def closed(plan: om.Plan, network: om.Network, series: Any = None) -> None:
    """The independent check accepts a plan and finds the same cost."""
    report = check(network, plan.data, series, plan.time)
    assert report.max_violation < 1e-6, report.worst
    assert not report.unchecked
    assert report.cost == pytest.approx(plan.objective, rel=1e-9)


@pytest.mark.parametrize(
    ("formulation", "solver", "options"),
    [("copperplate", "clarabel", {}), ("dc", "ipopt", {"tol": 1e-10})],
)
@pytest.mark.parametrize(("charge", "period", "before"), [(0, None, 0), (300, None, 0), (300, 6, 9.5)])
def test_a_day_with_tariff_and_demand_charge_costs_what_a_linear_program_says(
    formulation: str,
    solver: str,
    options: dict[str, float],
    charge: float,
    period: float | None,
    before: float,
) -> None:
    network = site(peak_cost=charge, peak_hours=period, peak=before)
    plan = om.MultiStage(
        network, HOURS, formulation=formulation, profiles=SERIES, solver=solver, options=options,
        regularisation=0.0,
    ).solve()  # fmt: skip
    numbers = [int(k // (period or HOURS)) for k in range(HOURS)]
    expected = by_hand(
        SERIES["grid.buy"], SERIES["grid.sell"], SERIES["town.p"], [1.0] * HOURS, numbers, charge, before
    )
    assert plan.objective == pytest.approx(expected, rel=1e-7)
    closed(plan, network, SERIES)


@given(st.integers(0, 10_000))
@settings(max_examples=4)
def test_uneven_stages_count_with_their_mean_power(seed: int) -> None:
    rng = np.random.default_rng(seed)
    hours = rng.choice([1.0, 2.0, 3.0], size=6)
    buy, load = rng.uniform(-5, 60, 24), rng.uniform(0, 20, 24)
    series = {"grid.buy": buy, "grid.sell": buy - rng.uniform(0, 20, 24), "town.p": load}
    network = site(peak_hours=5.0, peak_cost=150, peak=4)
    plan = om.MultiStage(
        network, om.Horizon.grid([*hours], 1.0), formulation="copperplate", profiles=series, solver="clarabel",
        regularisation=0.0,
    ).solve()  # fmt: skip
    ends = np.cumsum(hours).astype(int)
    begins = ends - hours.astype(int)
    stages = [(int(b), int(e)) for b, e in zip(begins, ends, strict=True)]
    mean = {key: [float(np.mean(values[b:e])) for b, e in stages] for key, values in series.items()}
    anew = [any(k % 5 == 0 and k for k in range(b, e)) for b, e in stages]
    expected = by_hand(
        mean["grid.buy"], mean["grid.sell"], mean["town.p"], [*hours], np.cumsum(anew).tolist(), 150, 4
    )
    assert plan.objective == pytest.approx(expected, rel=1e-7, abs=1e-4)
    closed(plan, network, series)


def test_a_battery_earns_the_spread_between_buying_and_selling() -> None:
    network = site(peak_cost=0)
    series = {"town.p": [0.0, 0.0], "grid.buy": [20.0, 60.0], "grid.sell": [10.0, 45.0]}
    problem = om.MultiStage(
        network, 2, formulation="dc", profiles=series, end=om.End(cyclic=True), regularisation=0.0
    )
    plan = problem.solve()
    assert plan.objective == pytest.approx(5 * 20 - 5 * 45, rel=1e-7)
    assert plan.data["connection_p"].values[:, 0] == pytest.approx([5, -5], abs=1e-5)
    assert "connection_peak" not in plan.data
    dear = om.MultiStage(
        network, 2, formulation="dc", profiles={**series, "grid.sell": [10.0, 19.0]}, end=om.End(cyclic=True)
    )
    assert dear.solve().objective == pytest.approx(0, abs=1e-4)  # the spread is negative


@pytest.mark.parametrize("formulation", ["ac", "soc"])
def test_imports_cover_losses_and_reactive_power(formulation: str) -> None:
    network = site()
    plan = om.MultiStage(network, 3, formulation=formulation, profiles=SERIES).solve()
    closed(plan, network, SERIES)
    data = plan.data
    flows = data["pf"].values[:, 0], data["qf"].values[:, 0]
    for quantity, flow in zip(("connection_p", "connection_q"), flows, strict=True):
        assert data[quantity].values[:, 0] == pytest.approx(flow, abs=1e-5)


# Peaks ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("solver", ["clarabel", "ipopt"])
def test_peaks_are_the_maxima_so_far_whatever_they_cost(solver: str) -> None:
    network = site(peak_cost=200, peak_hours=4, peak=2)
    network.free = om.Connection("b", p=(0, 3), buy=25, peak=1)
    plan = om.MultiStage(network, 8, formulation="dc", profiles=SERIES, solver=solver).solve()
    quantities = ("connection_p", "connection_peak", "connection_peak_next")
    p, start, end = (plan.data[name].sel(connection=["grid", "free"]).values.T for name in quantities)
    grid = [*np.maximum.accumulate([2, *p[0, :4]])[1:], *np.maximum.accumulate([0, *p[0, 4:]])[1:]]
    free = np.maximum.accumulate([1, *p[1]])[1:]
    assert end == pytest.approx(np.array([grid, free]), abs=1e-12)
    assert start[:, 1:] == pytest.approx(end[:, :-1], abs=1e-12)
    closed(plan, network, SERIES)


def test_each_path_of_a_tree_pays_for_its_own_peak() -> None:
    network = site(peak_cost=90, peak=8)
    horizon = om.Horizon.branching([1, 1, 2], {1: 2, 2: 2}).with_probabilities([0.1, 0.4, 0.3, 0.2])
    problem = om.MultiStage(network, horizon, formulation="dc", profiles=SERIES, regularisation=0.0)
    futures = [om.Profiles({"town.p": [10.0, 10.0, *late]}) for late in ((9, 9), (12, 8), (20, 24), (33, 1))]
    plan = problem.solve(expected=problem.expected(futures))
    assert plan.optimal
    highest = []
    for (name, cost), future in zip(plan.scenario_costs.items(), futures, strict=True):
        path = plan.scenario(name)
        report = check(network, path, {**SERIES, "town.p": future["town.p"]})
        assert report.max_violation < 1e-6, report.worst
        assert report.cost == pytest.approx(cost, rel=1e-9)
        p = path["connection_p"].values[:, 0]
        highest.append(max(8.0, p.max()))
        rate = np.where(p > 0, [BUY[0], BUY[1], BUY[2:4].mean()], 0) * p
        assert cost == pytest.approx(float(rate @ [1, 1, 2]) + 90 * (highest[-1] - 8), rel=1e-7)
        assert path["connection_peak_next"].values[-1, 0] == pytest.approx(highest[-1], abs=1e-9)
    assert len({round(peak, 3) for peak in highest}) >= 3
    assert plan.objective == pytest.approx(
        float(np.dot([0.1, 0.4, 0.3, 0.2], [*plan.scenario_costs.values()]))
    )


def test_a_billing_period_begins_at_midnight_in_local_time() -> None:
    """One day has 23 hours, and step 0 is at eight o'clock."""
    connection = om.Connection("a", p=(0, 1), buy=1, peak_hours=24)
    calendar = Calendar(np.datetime64("2025-03-29T07:00"), 1.0, "Europe/Berlin")
    kept = connection.at_clock(Times(np.arange(72), 1.0, calendar))["kept"]
    assert np.flatnonzero(kept == 0).tolist() == [16, 16 + 23, 16 + 23 + 24]
    later = connection.at_clock(Times(np.arange(16, 20), 1.0, calendar))["kept"]
    assert later.tolist() == kept[16:20].tolist()


def test_a_plan_that_ends_with_the_data_pays_for_the_peak_that_is_left() -> None:
    network = site(peak_cost=80)
    series = {key: values[:6] for key, values in SERIES.items()}
    problem = om.MultiStage(
        network, 4, formulation="dc", profiles=series, at_end="shrink", solver="clarabel", regularisation=0.0
    )
    before = {"e": [6.0], "connection_peak": [9.0]}
    plan = problem.solve(4, before)
    expected = by_hand(
        *(series[key][4:] for key in ("grid.buy", "grid.sell", "town.p")), [1, 1], [0, 0], 80, 9.0
    )
    assert plan.objective == pytest.approx(expected, rel=1e-7)
    closed(plan, network, series)


# Closed loops ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("plant", "forecast", "generates"),
    [
        (None, None, True),
        (om.PowerFlow(), Noisy(0.2, 3), True),
        (om.PowerFlow(), Noisy(0.2, 3), False),
        (om.Redispatch(), None, True),
    ],
    ids=["nominal", "power-flow", "without generators", "redispatch"],
)
def test_a_closed_loop_pays_the_peak_that_occurred(plant: Any, forecast: Any, generates: bool) -> None:
    network = site(peak_cost=120, peak_hours=4, peak=7)
    if generates:
        network.gas = om.Generator("b", p=(0, 4), q=(-5, 5), cost=om.Polynomial(0.0, 44, 0))
    problem = om.MultiStage(network, 3, profiles=SERIES, formulation="ac" if plant else "dc")
    run = om.simulate(om.Controller(problem, forecast=forecast), plant, steps=6)
    assert run.status == "done", run.termination
    report = check(network, run.data, SERIES)
    held = {family: each for family, each in report.violations.items() if family != "generator p"}
    assert max(each.value for each in held.values()) < 1e-6  # a power flow measures limits of units
    assert report.cost == pytest.approx(run.cost, rel=1e-9)
    p = run.data["connection_p"].values[:, 0]
    energy = np.where(p > 0, SERIES["grid.buy"][:6], SERIES["grid.sell"][:6]) @ p
    generated = 44 * run.data["pg"].values.sum() if generates else 0.0
    charge = 120 * (max(7.0, p[:4].max()) - 7.0 + max(0.0, p[4:].max()))
    assert run.cost == pytest.approx(float(energy + generated + charge), rel=1e-9)


# Outages and shortages ------------------------------------------------------------------------------


def test_imports_after_an_outage_count_in_no_peak() -> None:
    network = site(peak_cost=500)
    network.gas = om.Generator("b", p=(0, 9), q=(-9, 9), cost=om.Polynomial(0, 5, 0))
    security = om.Security({"generators": ["gas"]}, screen=False)
    plan = om.MultiStage(network, 3, formulation="dc", profiles=SERIES, security=security).solve()
    assert plan.optimal
    closed(plan, network, SERIES)
    imported = plan.solution.value("connection_p")[0] * plan.network.base_mva
    assert imported[3:].min() > imported[:3].max() + 1
    assert plan.data["connection_peak_next"].values[-1, 0] == pytest.approx(
        max(imported[:3].max(), 0), abs=1e-6
    )


def test_a_connection_may_go_out() -> None:
    network = site(p=(0, 40), peak_cost=0)
    network.gas = om.Generator("b", p=(0, 20), q=(-20, 20), ramp=None, cost=om.Polynomial(0, 90, 0))
    problem = om.MultiStage(network, 2, profiles=SERIES, outages=["grid"])
    assert problem.solve().data["connection_p"].values.max() > 1
    alone = problem.solve(out=["grid"])
    assert np.abs(alone.data["connection_p"].values).max() < 1e-6
    assert np.abs(alone.data["connection_q"].values).max() < 1e-6
    closed(alone, network, SERIES)
    secured = om.MultiStage(
        network, 2, profiles=SERIES, formulation="dc", security=om.Security({"connections": ["grid"]})
    ).solve()
    assert secured.optimal
    with pytest.raises(SecurityError, match="'gird': no connection in service has this name"):
        om.MultiStage(network, security=om.Security({"connections": ["gird"]}))


def test_an_elastic_plan_names_what_the_connection_cannot_deliver() -> None:
    network = site(p=(0, 6), peak_cost=50)
    problem = om.MultiStage(network, 2, formulation="dc", profiles={"town.p": [20.0, 5.0]}, elastic=Elastic())
    plan = problem.solve()
    assert str(plan.shortages[0]) == "bus b lacks 9 MW at hour 0"
    assert plan.data["connection_peak_next"].values[:, 0] == pytest.approx([6, 6], abs=1e-5)


def test_expected_prices_that_cross_are_no_gain() -> None:
    problem = om.MultiStage(site(peak_cost=0), 2, formulation="dc", profiles=SERIES)
    plan = problem.solve(expected={("connection", "buy"): np.full((1, 2), 500.0)})
    assert plan.optimal
    assert plan.objective < 20 * 500 * 2


# Bad input ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"sell": 41}, r"grid: sell = 41: must be at most buy = 40"),
        ({"p": (3, 1)}, r"grid: p = \(3, 1\): the minimum 3 is above the maximum 1"),
        ({"q": 3}, r"grid: q = 3: must be a pair"),
        ({"buy": None}, r"grid: buy = None: must be a number in \$/MWh"),
        ({"peak_cost": -1}, r"grid: peak_cost = -1: must be at least 0"),
        ({"peak_hours": 0}, r"grid: peak_hours = 0: must be greater than 0"),
        ({"peak": -2}, r"grid: peak = -2: must be at least 0"),
        ({"peek": 2}, r"peek = 2: unknown field; did you mean 'peak'"),
    ],
)
def test_wrong_fields_are_refused(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(ComponentError, match=message):
        site(**fields)


@pytest.mark.parametrize(
    ("series", "message"),
    [
        ({"grid.sell": [10, 45]}, r"'grid.sell': step 1: 45: must be at most buy = 40"),
        ({"grid.buy": [50, 9]}, r"'grid.buy': step 1: 9: must be at least sell = 10"),
        ({"grid.buy": [50, 30], "grid.sell": [0, 31]}, r"step 1: .*3[01]: must be at (most|least) .* 3[01]$"),
        ({"grid.peak": [1, 2]}, "the peak of a connection is constant"),
        ({"grid.peak_cost": [1, -2]}, "step 1: -2: must be at least 0"),
    ],
)
def test_wrong_series_are_refused(series: dict[str, Any], message: str) -> None:
    with pytest.raises(ProfileError, match=message):
        om.MultiStage(site(), 2, profiles=series)


def test_a_power_flow_and_a_case_have_no_connections(tmp_path: Path) -> None:
    network = site()
    with pytest.raises(ModelError, match="grid: connections have no set-points"):
        om.power_flow(network)
    with pytest.raises(CaseError, match=r"connections .*grid.*: MATPOWER has no such equipment"):
        om.write_network(network, tmp_path / "case.m", lossy=False)


def test_a_peak_charge_has_no_steady_state() -> None:
    network = site()
    with pytest.raises(IncompatibleError, match="no generator is in service"):
        Subject(om.MultiStage(network, 2, formulation="dc"))
    network.unit = om.Generator("a", p=(0, 5))
    with pytest.raises(IncompatibleError, match="grid: a charge for the peak of a period"):
        Subject(om.MultiStage(network, 2, formulation="dc"))


def test_imports_count_as_capacity_and_appear_in_figures() -> None:
    network = site()
    network.update("a", reference=False)
    found = inspect(network)
    assert (found.capacity_mw, found.spare_mw, found.islands[0].capacity_mw) == (40, 30, 40)
    assert "'a' is used" in found.notes[0]
    data = om.MultiStage(network, 2, formulation="dc", profiles=SERIES).solve().data
    assert injections(data) == ["connection_p"]
    assert data["connection_p_max"].values == pytest.approx(40)
    figure = system(data)
    assert "connection" in [text.get_text().split()[0] for text in figure.legends[0].get_texts()]
    figure.canvas.draw()
    assert figure.legends[0].get_window_extent().width < figure.bbox.width


def test_a_scenario_file_has_connections(tmp_path: Path) -> None:
    (tmp_path / "series.csv").write_text(
        "shop.p,grid.buy\n" + "".join(f"{4 + k},{30 + k}\n" for k in range(8))
    )
    (tmp_path / "shop.yaml").write_text(
        """
name: shop
network:
  buses: {a: {}}
  connections: {grid: {bus: a, p: [-10, 20 MW], q: [-5, 5], buy: 40 $/MWh, sell: 20, peak_cost: 100, peak_hours: 24 h}}
  storages: {cell: {bus: a, energy: 6, power: 2, initial: 3}}
  loads: {shop: {bus: a, p: 4}}
time: {step: 1, steps: 4}
profiles: [{table: {file: series.csv}}]
controller: {horizon: 4, formulation: dc, security: {contingencies: {connections: []}}, on_infeasible: elastic}
plant: {outages: [{connection: grid, step: 3, hours: 1}]}
"""
    )
    run = om.load_scenario(tmp_path / "shop.yaml").simulate()
    assert run.status == "done"
    assert run.data["connection_status"].values[:, 0].tolist() == [1, 1, 1, 0]
    highest = run.data["connection_p"].values.max()
    assert run.data["connection_peak_next"].values[-1, 0] == pytest.approx(highest, abs=1e-9)


@pytest.mark.parametrize("peak_cost", [0, 100])
def test_peaks_have_no_steady_state(peak_cost: float) -> None:
    network = site()
    network.update("grid", peak_cost=peak_cost)
    network.backup = om.Generator("a", p=(0, 5), cost=om.Polynomial(0, 400, 0))
    problem = om.MultiStage(network, 3, formulation="dc")
    if not peak_cost:
        assert {state.name for state in Subject(problem).states} >= {"e"}
        return
    with pytest.raises(
        IncompatibleError, match="grid: a charge for the peak of a period has no steady state"
    ):
        Subject(problem)


# The independent check ------------------------------------------------------------------------------


def falsified(quantity: str, change: Callable[[Any], Any]) -> Callable[[Any], Any]:
    def falsify(data: Any) -> Any:
        made = data.copy(deep=True)
        made[quantity].values[:] = change(made[quantity].values)
        return made

    return falsify


@cache
def solved_in_ac() -> tuple[om.Network, Any]:
    network = site(peak_hours=2)
    plan = om.MultiStage(network, 3, profiles=SERIES).solve()
    closed(plan, network, SERIES)
    return network, plan.data


@pytest.mark.parametrize(
    ("family", "falsify"),
    [
        ("connection p", falsified("connection_p", lambda p: p - 80)),
        ("active balance", falsified("connection_p", lambda p: p + 0.1)),
        ("connection q", falsified("connection_q", lambda q: q + 40)),
        ("reactive balance", falsified("connection_q", lambda q: q + 0.1)),
        ("connection peak", falsified("connection_peak_next", lambda m: m + 0.1)),
        ("connection peak", falsified("connection_peak_next", lambda m: m - 0.1)),
        ("connection peak", falsified("connection_p", lambda p: p + 9)),
        ("peak continuity", falsified("connection_peak", lambda m: m + 0.1)),
    ],
)
def test_falsified_results_are_found(family: str, falsify: Callable[[Any], Any]) -> None:
    network, data = solved_in_ac()
    report = check(network, falsify(data), SERIES)
    assert report.violations[family].physical > 0.09


def test_the_check_counts_periods_from_the_clock_of_the_results() -> None:
    network = site(peak_hours=6)
    series = om.Profiles(SERIES, Calendar(np.datetime64("2025-03-30T01:00"), 1.0, "Europe/Berlin"))
    plan = om.MultiStage(network, 6, formulation="dc", profiles=series).solve(
        2, {"connection_peak": [8.0], "e": [6]}
    )
    closed(plan, network, series)
