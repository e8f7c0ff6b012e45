"""Reserves: against a linear program stated here, closed forms, and the independent check."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

import opfmodel as om
from opfmodel import plugins
from opfmodel.check import check
from opfmodel.devices.reserve import ReserveDevice
from opfmodel.errors import ComponentError, ModelError
from opfmodel.forecasts import Noisy
from opfmodel.network.arrays import per_unit
from opfmodel.network.cases.losses import Losses
from opfmodel.network.cases.write import find_losses
from opfmodel.plan.parts import make_devices
from opfmodel.scenario.write import write_scenario

REFERENCE = {"regularisation": 0.0}  # without it, plans are those of the linear programs


def one_bus(**reserve: object) -> om.Network:
    """A cheap and an expensive unit at one bus, so that every formulation has the same optimum."""
    grid = om.Network("one-bus")
    grid.bus = om.Bus(reference=True)
    grid.cheap = om.Generator("bus", p=(0, 100), q=(-50, 50), cost=om.Polynomial(0, 10, 0))
    grid.dear = om.Generator("bus", p=(0, 100), q=(-50, 50), cost=om.Polynomial(0, 30, 0))
    grid.town = om.Load("bus", p=90, q=5)
    if reserve:
        grid.spin = om.Reserve(**reserve)  # type: ignore[arg-type]
    return grid


def with_cell() -> om.Network:
    """Two buses, a lossy storage and products in both directions, some of which share headroom."""
    grid = om.Network("reserves")
    grid.north, grid.south = om.Bus(reference=True), om.Bus()
    grid.tie = om.Branch("north", "south", r=0.001, x=0.01, rating=500)
    grid.twin = om.Branch("north", "south", r=0.001, x=0.01, rating=500)
    grid.cheap = om.Generator("north", p=(20, 100), q=(-90, 90), ramp=60, cost=om.Polynomial(0, 10, 0))
    grid.dear = om.Generator("south", p=(0, 80), q=(-90, 90), ramp=50, cost=om.Polynomial(0, 33, 0))
    grid.cell = om.Storage(
        "south", energy=40, power=15, q=5, initial=4, energy_min=2,
        charge_efficiency=0.9, discharge_efficiency=0.8,
    )  # fmt: skip
    grid.town = om.Load("south", p=90, q=10)
    grid.fast = om.Reserve(14, minutes=10, hours=0.5, cost={"cheap": 3.5, "cell": 1.25})
    grid.slow = om.Reserve(
        25, minutes=30, hours=2, units={"dear": 12, "cell": 9, "cheap": 40}, lacking_cost=55
    )
    grid.down = om.Reserve(11, "down", hours=1.5, units={"cell": 30, "cheap": 18}, cost={"cheap": 2.25})
    return grid


TOWN = np.array([83.0, 104.0, 131.0, 149.0, 122.0])
SLOW = np.array([25.0, 21.0, 17.0, 70.0, 24.0])


# Against the outside ---------------------------------------------------------------------------------


def by_hand(town: np.ndarray, slow: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Optimum, energy prices and reserve prices of :func:`with_cell` without its lines, by HiGHS.

    The model of the docstring of ``ReserveDevice``, stated once more for this system alone.
    """
    stages = len(town)
    names = [
        "cheap", "dear", "charge", "discharge", "energy",
        "fast cheap", "fast dear", "fast cell", "slow cheap", "slow dear", "slow cell", "down cheap", "down cell",
        "slow lacking",
    ]  # fmt: skip
    at = {(name, k): stages * i + k for i, name in enumerate(names) for k in range(stages)}
    most = {
        "cheap": (20, 100), "dear": (0, 80), "charge": (0, 15), "discharge": (0, 15), "energy": (2, 40),
        "fast cheap": (0, 60 / 6), "fast dear": (0, 50 / 6), "slow cheap": (0, 60 / 2), "slow dear": (0, 12),
        "slow cell": (0, 9), "down cheap": (0, 15), "down cell": (0, 30),
    }  # fmt: skip
    price = {
        "cheap": 10,
        "dear": 33,
        "fast cheap": 3.5,
        "fast cell": 1.25,
        "down cheap": 2.25,
        "slow lacking": 55,
    }
    left, right, equal, given = [], [], [], []

    def row(terms: dict[tuple[str, int], float]) -> np.ndarray:
        made = np.zeros(len(at))
        for key, value in terms.items():
            made[at[key]] += value
        return made

    for k in range(stages):
        equal.append(row({("cheap", k): 1, ("dear", k): 1, ("discharge", k): 1, ("charge", k): -1}))
        given.append(town[k])
    for k in range(stages):
        before = {("energy", k - 1): -1.0} if k else {}
        equal.append(row({("energy", k): 1, ("charge", k): -0.9, ("discharge", k): 1 / 0.8, **before}))
        given.append(0.0 if k else 4.0)
    requirements = [("fast", np.full(stages, 14.0)), ("slow", slow), ("down", np.full(stages, 11.0))]
    for product, required in requirements:
        for k in range(stages):
            offers = [name for name in names if name.startswith(product)]
            left.append(row({(name, k): -1 for name in offers}))
            right.append(-required[k])
    for k in range(stages):
        rows_of_stage = [
            ({"cheap": 1, "fast cheap": 1, "slow cheap": 1}, 100),
            ({"dear": 1, "fast dear": 1, "slow dear": 1}, 80),
            ({"discharge": 1, "charge": -1, "fast cell": 1, "slow cell": 1}, 15),
            ({"cheap": -1, "down cheap": 1}, -20),
            ({"charge": 1, "discharge": -1, "down cell": 1}, 15),
            ({"fast cell": 0.5 / 0.8, "slow cell": 2 / 0.8, "energy": -1}, -2),
            ({"down cell": 1.5 * 0.9, "energy": 1}, 40),
        ]
        for terms, limit in rows_of_stage:
            left.append(row({(name, k): float(v) for name, v in terms.items()}))
            right.append(float(limit))
        # the fast product lasts half an hour: called at the start of the stage, with all that lasts as long
        half = {("fast cell", k): 0.5 / 0.8, ("slow cell", k): 0.5 / 0.8, ("energy", k): -0.5}
        start = {("energy", k - 1): -0.5} if k else {}
        left.append(row({**half, **start}))
        right.append(-2.0 + (0.0 if k else 0.5 * 4))
        if k:
            for unit, ramp in (("cheap", 60), ("dear", 50)):
                for sign in (1, -1):
                    left.append(row({(unit, k): sign, (unit, k - 1): -sign}))
                    right.append(ramp)
    cost = row({(name, k): value for name, value in price.items() for k in range(stages)})
    bounds = [most.get(name, (0, None)) for name in names for _ in range(stages)]
    found = linprog(cost, np.array(left), right, np.array(equal), given, bounds, method="highs")
    assert found.status == 0
    energy = found.eqlin.marginals[:stages]
    return found.fun, energy, -found.ineqlin.marginals[: 3 * stages].reshape(3, stages)


@pytest.mark.parametrize("formulation", ["dc", "copperplate"])
def test_optimum_and_prices_are_those_of_a_linear_program(formulation: str) -> None:
    cost, energy, reserve = by_hand(TOWN, SLOW)
    profiles = {"town.p": TOWN, "slow.requirement": SLOW}
    problem = om.MultiStage(with_cell(), 5, formulation=formulation, profiles=profiles, **REFERENCE)
    plan = problem.solve()
    assert plan.objective == pytest.approx(cost, rel=1e-7)
    assert plan.data.lmp.values[:, 0] == pytest.approx(energy, rel=1e-7)
    prices = plan.data.reserve_price.values.T
    assert prices == pytest.approx(reserve, rel=1e-7, abs=1e-5)
    assert (reserve > 1.0).sum(axis=1).min() >= 2  # each product is scarce at times
    assert plan.data.reserve_lacking.values[:, 1].max() > 1.0


@pytest.mark.parametrize(
    "formulation", ["ac", "ac-rectangular", "dc", "dc-matpower", "dc-losses", "soc", "copperplate"]
)
def test_a_reserve_costs_what_the_unit_that_provides_it_would_earn(formulation: str) -> None:
    """The cheap unit gives way to the expensive one: 20 $/MWh per MW."""
    grid = one_bus(requirement=30, units={"cheap": 100}, cost={"cheap": 2})
    plan = om.MultiStage(grid, 2, formulation=formulation, **REFERENCE).solve()
    assert plan.objective == pytest.approx(2 * (70 * 10 + 20 * 30 + 30 * 2), rel=1e-6)
    assert plan.data.reserve_price.values == pytest.approx(22.0, rel=1e-5)
    assert plan.data.lmp.values == pytest.approx(30.0, rel=1e-5)
    assert plan.data.spin_generator.values == pytest.approx(np.array([[30.0, 0.0]] * 2), abs=1e-4)
    assert plan.data.reserve_offered.values == pytest.approx(30.0, rel=1e-6)
    assert check(grid, plan.data).max_violation < 1e-6


def case30(tmp_path: Path) -> om.Network:
    """The case with reserves of PYPOWER, a port of MATPOWER, without its reserves."""
    case = pytest.importorskip("pypower.t.t_case30_userfcns").t_case30_userfcns()
    tables = (
        f"mpc.{name} = [\n" + "\n".join(" ".join(map(repr, row)) for row in case[name].tolist()) + "\n];\n"
        for name in ("bus", "gen", "branch", "gencost")
    )
    file = tmp_path / "case30.m"
    file.write_text(f"function mpc = case30\nmpc.version = '2';\nmpc.baseMVA = 100;\n{''.join(tables)}")
    grid = om.read_network(file)
    units = dict(zip(grid.of(om.Generator), [1.9, 2, 3, 4, 5, 5.5], strict=True))
    zone = list(units)[4:]
    # MATPOWER requires 60 MW of all units, of which 20 MW of the last two
    grid.add("all", om.Reserve(40, units=dict.fromkeys(units, 25), cost=units))
    of_zone = {name: units[name] for name in zone}
    grid.add("zone", om.Reserve(20, units=dict.fromkeys(zone, 25), cost=of_zone))
    return grid


@pytest.mark.parametrize(
    ("without", "offers", "cost"),
    [
        (None, [25, 15, 0, 0, 19.3906, 0.6094], 177.8047),
        (4, [25, 15, 0, 0, 0, 20], 187.5),
    ],
)
def test_offers_and_prices_are_those_of_matpower(
    tmp_path: Path, without: int | None, offers: list[float], cost: float
) -> None:
    """An AC optimal power flow with fixed zonal reserves; the figures of PYPOWER's ``t_runopf_w_res``."""
    grid = case30(tmp_path)
    if without is not None:
        gone = list(grid.of(om.Generator))[without]
        for name in ("all", "zone"):
            reserve = grid[name]
            assert isinstance(reserve, om.Reserve)
            kept = [{k: v for k, v in part.items() if k != gone} for part in (reserve.units, reserve.cost)]
            grid.update(name, units=kept[0], cost=kept[1])
    data = om.MultiStage(grid, options={"tol": 1e-10}, **REFERENCE).solve().data
    both = data.all_generator.values[0] + data.zone_generator.values[0]
    assert both == pytest.approx(offers, abs=5e-5)
    assert both @ [1.9, 2, 3, 4, 5, 5.5] == pytest.approx(cost, abs=5e-5)
    assert data.reserve_price.values[0] == pytest.approx([2.0, 5.5], abs=5e-7)


def offered(grid: om.Network, stages: int = 1, **options: object) -> np.ndarray:
    """What is offered of the product ``spin``, of which more is required than there is, MW."""
    plan = om.MultiStage(grid, stages, formulation="dc", **REFERENCE, **options).solve()  # type: ignore[arg-type]
    assert plan.optimal, plan.termination
    assert check(grid, plan.data, plan.problem.profiles).max_violation < 1e-6
    assert plan.data.reserve_price.values == pytest.approx(500.0)
    return plan.data.reserve_offered.values[:, 0]


def scarce(grid: om.Network, **reserve: object) -> om.Network:
    """The grid with a product of which as much as possible is offered."""
    grid.spin = om.Reserve(500, lacking_cost=500, **reserve)  # type: ignore[arg-type]
    return grid


def test_a_generator_offers_what_it_reaches_in_time() -> None:
    grid = one_bus()
    grid.update("dear", ramp=80)
    assert offered(scarce(grid, units={"dear": 90})) == pytest.approx(20.0)  # 80 MW/h for 15 min
    grid.update("spin", minutes=30, units={"dear": 33})
    assert offered(grid) == pytest.approx(33.0)
    grid.update("spin", direction="down", units={})
    assert offered(grid) == pytest.approx(90.0)  # all that is generated, at most 40 of it by dear


@pytest.mark.parametrize(
    ("direction", "hours", "initial", "expected"),
    [
        ("up", 2.0, 6.0, (6 - 1 + 0.9 * 20) * 0.8 / 2),  # it charges with 20 MW
        ("up", 0.5, 5.0, (5 - 1 + 0.9 * 20 / 2) * 0.8 / 0.5),  # when called up at the start of the stage
        ("up", 0.0, 5.0, 40.0),  # power alone
        ("down", 2.0, 30.0, (40 - 30 + 20 / 0.8) / 2 / 0.9),  # it discharges with 20 MW
        ("down", 0.5, 39.0, (40 - 39 + 20 / 0.8 / 2) / 0.5 / 0.9),
    ],
)
def test_a_storage_offers_what_its_energy_lasts_for(
    direction: str, hours: float, initial: float, expected: float
) -> None:
    grid = one_bus()
    grid.cell = om.Storage(
        "bus", energy=40, power=20, initial=initial, energy_min=1,
        charge_efficiency=0.9, discharge_efficiency=0.8,
    )  # fmt: skip
    scarce(grid, direction=direction, hours=hours, units={"cell": 200})
    assert offered(grid) == pytest.approx(expected)


def test_a_rating_limits_what_a_storage_offers() -> None:
    grid = one_bus()
    grid.cell = om.Storage("bus", energy=40, power=20, rating=7, initial=40)
    assert offered(scarce(grid, units={"cell": 99})) == pytest.approx(7.0)  # it is full


def test_products_share_headroom_and_energy() -> None:
    grid = one_bus()
    grid.cell = om.Storage("bus", energy=12, power=(0, 1e-6), initial=12)
    grid.update("cell", power=(-20, 0))
    grid.spin = om.Reserve(500, hours=2, lacking_cost=500, units={"cell": 99})
    grid.more = om.Reserve(4, hours=1, lacking_cost=2000, units={"cell": 99})
    plan = om.MultiStage(grid, formulation="dc", **REFERENCE).solve()
    assert plan.data.reserve_offered.values[0] == pytest.approx([(12 - 4) / 2, 4.0])


def test_a_limit_of_energy_that_rises_does_not_ask_for_reserve() -> None:
    """Without offers, the rows of the energy hold whatever was stored before."""
    grid = one_bus()
    grid.cell = om.Storage("bus", energy=40, power=20, initial=0)
    scarce(grid, hours=0.5, units={"cell": 20})
    profiles = {"cell.energy_min": [12.0, 16.0]}
    assert offered(grid, 2, profiles=profiles) == pytest.approx([16.0, 20.0])


# Horizons, contingencies and outages ---------------------------------------------------------------------


def test_every_node_of_a_tree_has_its_own_offers_and_price() -> None:
    grid = one_bus(requirement=0, units={"cheap": 100})
    tree = om.Horizon.tree([1, 1], {"low": 0.3, "high": 0.7}, common=1)
    problem = om.MultiStage(
        grid, tree, formulation="dc", profiles={"spin.requirement": [9.0] * 2}, **REFERENCE
    )
    required = np.array([[20.0, 5.0, 30.0]]) / problem.arrays.base_mva
    plan = problem.solve(expected={("reserve", "requirement"): required})
    assert plan.data.pg.values[:, 0] == pytest.approx([80.0, 90.0, 70.0])
    assert plan.data.reserve_price.values[:, 0] == pytest.approx([20.0, 0.0, 20.0], abs=1e-5)
    assert plan.objective == pytest.approx(1100 + 0.3 * 900 + 0.7 * 1300)


def test_over_a_long_stage_the_largest_requirement_counts() -> None:
    grid = one_bus(requirement=0, units={"cheap": 100})
    profiles = {"spin.requirement": [20.0, 12.0, 30.0]}
    plan = om.MultiStage(
        grid, om.Horizon.grid([1, 2]), formulation="dc", profiles=profiles, **REFERENCE
    ).solve()
    assert plan.data.pg.values[:, 0] == pytest.approx([80.0, 70.0])
    assert plan.data.reserve_price.values[:, 0] == pytest.approx(20.0)
    assert check(grid, plan.data, profiles).max_violation < 1e-6


def test_stages_of_different_lengths_pass_the_check() -> None:
    profiles = {"town.p": np.resize(TOWN, 14), "cell.energy_min": np.resize([2.0, 9.0, 4.0], 14)}
    horizon = om.Horizon.grid([0.25, 0.25, 0.5, 1.0, 1.5])
    plan = om.MultiStage(with_cell(), horizon, formulation="dc", profiles=profiles, **REFERENCE).solve()
    report = check(with_cell(), plan.data, profiles)
    assert report.max_violation < 1e-6
    assert report.cost == pytest.approx(plan.objective, rel=1e-8)


@pytest.mark.parametrize("response", ["corrective", "preventive"])
@pytest.mark.parametrize("screen", [True, False])
def test_contingencies_need_no_reserve(response: str, screen: bool) -> None:
    """After the loss of the expensive unit, the other one has 10 MW left, not the 30 MW required."""
    grid = one_bus(requirement=30, units={"cheap": 100})
    security = om.Security({"generators": ["dear"]}, response=response, screen=screen)  # type: ignore[arg-type]
    plan = om.MultiStage(grid, 2, formulation="dc", security=security, **REFERENCE).solve()
    assert plan.objective == pytest.approx(2600.0)
    assert plan.data.reserve_price.values == pytest.approx(20.0)


def test_a_unit_that_is_out_of_service_offers_nothing() -> None:
    grid = one_bus(requirement=30, lacking_cost=80)
    grid.update("dear", ramp=100)
    plan = om.MultiStage(grid, formulation="dc", outages=["cheap"], **REFERENCE).solve(out=["cheap"])
    assert plan.data.spin_generator.values[0] == pytest.approx([0.0, 10.0], abs=1e-5)
    assert plan.data.reserve_lacking.values == pytest.approx(20.0)
    assert check(grid, plan.data).max_violation < 1e-6


def test_without_units_in_service_a_product_is_not_offered_by_others() -> None:
    grid = one_bus(requirement=30, lacking_cost=80, units={"old": 50})
    grid.old = om.Generator("bus", p=(0, 50), in_service=False)
    plan = om.MultiStage(grid, formulation="dc", **REFERENCE).solve()
    assert plan.data.reserve_lacking.values == pytest.approx(30.0)
    assert "spin_generator" not in plan.data


def test_a_shortage_is_reported() -> None:
    problem = om.MultiStage(one_bus(requirement=130), 2, formulation="dc")
    assert problem.solve().infeasible
    found = problem.elastic_twin().solve().shortages
    assert [str(s) for s in found] == ["reserve spin lacks 20.0 MW at hour 0 (in 2 stages, 40.0 MWh in all)"]


def test_energy_that_is_lacking_is_no_reserve() -> None:
    """A storage below its minimum leaves the requirement unmet, and no energy is made up for the offer."""
    grid = one_bus(requirement=10, hours=0.25, units={"cell": 10})
    grid.cell = om.Storage("bus", energy=40, power=(-10, 0), initial=1)
    found = om.MultiStage(grid, formulation="dc", elastic=om.Elastic()).solve().shortages
    assert [str(s) for s in found] == ["reserve spin lacks 6 MW at hour 0"]


# Closed loops ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("plant", [om.PowerFlow(), om.Redispatch()], ids=["power-flow", "redispatch"])
def test_a_plant_calls_up_what_the_plan_keeps_ready(plant: om.Plant) -> None:
    """What demand exceeds its forecast by is served from the reserve; results report that of the plan."""
    grid = one_bus(requirement=30, lacking_cost=1000)
    grid.update("dear", p=(0, 20))
    demand = 84 + 3 * np.sin(np.arange(8.0))
    problem = om.MultiStage(grid, 2, profiles={"town.p": demand})
    controller = om.Controller(problem, forecast=Noisy(deviation=0.2, seed=1))
    run = om.simulate(controller, plant, steps=4)
    assert run.status == "done"
    assert run.summary()["shed_mwh"] == pytest.approx(0.0, abs=1e-4)
    used = run.data.pg.values + run.data.spin_generator.values
    assert used.sum(axis=1).max() > 121.0  # more than both units have: a part of the reserve was called up
    assert run.data.reserve_offered.values[:, 0] == pytest.approx(run.data.spin_generator.values.sum(axis=1))
    assert not [f for f, v in check(grid, run.data, {"town.p": demand}).as_dict().items() if "reserve" in f
                and v["value"] > 1e-4]  # fmt: skip


def test_a_plan_that_does_not_know_of_an_outage_counts_on_the_unit() -> None:
    grid = one_bus(requirement=30, units={"dear": 60}, cost={"dear": 1}, lacking_cost=100)
    problem = om.MultiStage(grid, 2, formulation="dc", outages=["dear"])
    plant = om.Redispatch().with_outages([om.Outage("dear", 1, 3)])
    run = om.simulate(problem, plant, steps=4)
    assert run.data.spin_generator.values[:, 1] == pytest.approx([30.0, 30.0, 0.0, 0.0], abs=1e-3)
    assert check(grid, run.data).max_violation < 1e-6


def test_a_nominal_loop_passes_the_check() -> None:
    profiles = {"town.p": np.resize(TOWN, 6), "slow.requirement": np.resize(SLOW, 6)}
    problem = om.MultiStage(with_cell(), 3, formulation="dc", profiles=profiles, at_end="shrink")
    run = om.simulate(problem, steps=6)
    assert run.status == "done"
    report = check(with_cell(), run.data, profiles)
    assert report.max_violation < 1e-6
    assert report.cost == pytest.approx(run.cost, rel=1e-6)


def test_single_stages_are_without_reserves() -> None:
    with_reserve, without = (
        om.single_stage_sequence(om.MultiStage(grid, 2, formulation="dc"), 2).cost
        for grid in (one_bus(requirement=30, units={"cheap": 100}), one_bus())
    )
    assert with_reserve == pytest.approx(without)


# The check -----------------------------------------------------------------------------------------------


@st.composite
def products(draw: st.DrawFn) -> om.Reserve:
    numbers = {"cheap": st.floats(0, 60), "dear": st.floats(0, 60), "cell": st.floats(0, 30)}
    units = draw(st.dictionaries(st.sampled_from(list(numbers)), st.floats(0, 60)))
    priced = list(units) if units else list(numbers)
    return om.Reserve(
        draw(st.floats(0, 80)),
        draw(st.sampled_from(["up", "down"])),
        minutes=draw(st.sampled_from([5, 15, 60])),
        hours=draw(st.sampled_from([0, 0.25, 0.6, 1, 3])),
        units=units,
        cost=draw(st.dictionaries(st.sampled_from(priced), st.floats(0, 20))),
        lacking_cost=draw(st.floats(30, 90)),
    )


@settings(max_examples=8)
@given(st.lists(products(), min_size=1, max_size=3), st.sampled_from([(1, 1, 1), (0.5, 1, 1.5)]))
def test_plans_with_any_products_pass_the_check(drawn: list[om.Reserve], hours: tuple[float, ...]) -> None:
    grid = with_cell()
    for name in ("fast", "slow", "down"):
        grid.remove(name)
    for number, product in enumerate(drawn):
        grid.add(f"product {number}", product)
    plan = om.MultiStage(grid, om.Horizon.grid(hours), formulation="dc", **REFERENCE).solve()
    assert plan.optimal
    report = check(grid, plan.data)
    assert report.max_violation < 1e-6
    assert report.cost == pytest.approx(plan.objective, rel=1e-6, abs=1e-4)


@pytest.fixture(scope="module")
def planned() -> om.Plan:
    """A plan with reserves in both directions."""
    return om.MultiStage(with_cell(), 2, formulation="dc", **REFERENCE).solve()


@pytest.mark.parametrize(
    ("quantity", "change", "family"),
    [
        ("reserve_offered", 1.0, "reserve offered"),
        ("reserve_lacking", -1.0, "reserve requirement"),
        ("slow_generator", -30.0, "reserve offer of generators"),
        ("slow_generator", 40.0, "reserve offer of generators"),
        ("down_storage", 31.0, "reserve offer of storages"),
        ("pg", 30.0, "reserve headroom of generators"),
        ("pg", -80.0, "reserve headroom of generators"),
        ("ps", -20.0, "reserve headroom of storages"),
        ("ps", 20.0, "reserve headroom of storages"),
        ("e_next", -15.0, "reserve energy"),
        ("e_next", 60.0, "reserve energy"),
        ("e", -30.0, "reserve energy"),
    ],
)
def test_the_check_finds_what_is_wrong(planned: om.Plan, quantity: str, change: float, family: str) -> None:
    assert check(with_cell(), planned.data).violations[family].physical < 1e-5
    data = planned.data.copy(deep=True)
    data[quantity] = data[quantity] + change
    assert check(with_cell(), data).violations[family].physical > 0.1


# Declarations ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fields", "key", "message"),
    [
        ({"requirement": -1}, "requirement", "at least 0"),
        ({"direction": "sideways"}, "direction", "up or down"),
        ({"direction": None}, "direction", "up or down"),
        ({"minutes": 0}, "minutes", "greater than 0"),
        ({"hours": -1}, "hours", "at least 0"),
        ({"units": {"cheap": -1}}, "units.cheap", "at least 0"),
        ({"units": ["cheap"]}, "units", "must be {name: number"),
        ({"units": {"cheap": 1}, "cost": {"dear": 1}}, "cost.dear", "not among the units"),
        ({"cost": {"cheap": -1}}, "cost.cheap", "at least 0"),
        ({"lacking_cost": -1}, "lacking_cost", "at least 0"),
    ],
)
def test_wrong_fields_are_named(fields: dict[str, object], key: str, message: str) -> None:
    with pytest.raises(ComponentError, match=message) as error:
        one_bus(**{"requirement": 10, **fields})
    assert f"spin: {key} = " in str(error.value)


def test_units_must_exist() -> None:
    with pytest.raises(ComponentError, match=r"spin: units.chap = 3.*did you mean 'cheap'"):
        om.MultiStage(one_bus(requirement=10, units={"chap": 3}))
    with pytest.raises(ComponentError, match=r"spin: cost.town = 3.*no generator or storage"):
        om.MultiStage(one_bus(requirement=10, cost={"town": 3}))


def test_two_quantities_of_one_name_are_refused() -> None:
    problem = om.MultiStage(one_bus(requirement=10))
    problem.constrain("reserve", lambda s: om.total(s.generator.pg) <= 200)
    with pytest.raises(ModelError, match="'reserve_price'; choose another name"):
        problem.compile()


def test_without_a_reserve_in_service_the_program_is_the_same() -> None:
    plain, other = one_bus(), one_bus(requirement=10, in_service=False)
    assert [type(d) for d in make_devices(per_unit(plain))] == [
        type(d) for d in make_devices(per_unit(other))
    ]
    one, two = (om.MultiStage(grid, 2).compile() for grid in (plain, other))
    assert (list(one.variables), list(one.rows)) == (list(two.variables), list(two.rows))
    assert len(one.costs) == len(two.costs)
    assert len(one.constraints) == len(two.constraints)


def test_devices_without_a_bus_come_last() -> None:
    grid = om.Network("order")
    grid.spin = om.Reserve(0)
    for name, component in ((name, one_bus()[name]) for name in one_bus()):
        grid.add(name, component)
    plan = om.MultiStage(grid, formulation="dc", devices=[ReserveDevice()]).solve()
    assert plan.optimal
    kinds = [device.component.kind for device in plan.problem.devices]
    assert kinds == ["generator", "load", "reserve"]
    assert plugins.load("device", "reserve") is ReserveDevice


SCENARIO = """
name: reserves
network:
  buses: {bus: {reference: true}}
  generators:
    cheap: {bus: bus, p: [0, 100], ramp: 80, cost: {c1: 10}}
    dear: {bus: bus, p: [0, 100], cost: {c1: 30}}
  storages: {cell: {bus: bus, energy: 40, power: 10, initial: 40}}
  loads: {town: {bus: bus, p: 90}}
  reserves:
    spin: {requirement: 30 MW, minutes: 0.25 h, hours: 30 min, units: {cheap: 25 MW, cell: 10}, cost: {cell: 1.5}}
    down: {requirement: 5, direction: down, lacking_cost: 4 $/kWh}
time: {steps: 2}
controller: {horizon: 2, formulation: dc}
"""


def test_a_scenario_file_states_reserves_and_a_network_is_written_to_one(tmp_path: Path) -> None:
    file = tmp_path / "reserves.yaml"
    file.write_text(SCENARIO)
    grid = om.load_scenario(file).network
    spin = grid.spin
    assert isinstance(spin, om.Reserve)
    assert (spin.minutes, spin.hours, spin.units["cheap"], spin.direction) == (15.0, 0.5, 25.0, "up")
    assert grid["down"] == om.Reserve(5, "down", lacking_cost=4000.0)
    again = tmp_path / "again.yaml"
    write_scenario(grid, again)
    assert {n: om.load_scenario(again).network[n] for n in grid} == {n: grid[n] for n in grid}
    losses = Losses("case.m", writing=True)
    find_losses(grid, losses)
    assert "reserves spin, down" in str(vars(losses))


@pytest.mark.parametrize(
    ("wrong", "found"),
    [
        ("direction: down", "direction: up or so"),
        ("cheap: 25 MW", "cheap: 25 MWh"),
        ("5, d", "5, minutes: 0, d"),
    ],
)
def test_errors_of_a_file_have_their_place(tmp_path: Path, wrong: str, found: str) -> None:
    file = tmp_path / "reserves.yaml"
    file.write_text(SCENARIO.replace(wrong, found))
    with pytest.raises(Exception, match=r"reserves.yaml:1\d:\d+") as error:
        om.load_scenario(file)
    assert isinstance(error.value, om.OpfmodelError)


def test_bounds_are_certified_with_reserves() -> None:
    plan = om.MultiStage(one_bus(requirement=30, units={"cheap": 100}), 2).solve()
    assert om.certify(plan).lower == pytest.approx(2600.0, rel=1e-4)
