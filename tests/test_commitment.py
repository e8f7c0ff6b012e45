"""Units that are shut down at given times: ``Generator(on=...)``."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pypsa_networks import snapshots

import opfmodel as om
from opfmodel.check import check
from opfmodel.errors import CaseError, ComponentError, ProfileError
from opfmodel.simulation import Controller, NominalPlant, Plant, simulate

DEMAND = 80 + 30 * np.sin(np.arange(24) / 3)
ON = np.array([0, 0, 1, 1, 1, 1, 0, 0, 1, 1, 1, 1] * 2, dtype=float)


def system(**unit: object) -> om.Network:
    """A unit that runs at times and one that always runs."""
    grid = om.Network("commitment", base_mva=100)
    grid.north, grid.south = om.Bus(reference=True), om.Bus()
    grid.line = om.Branch("north", "south", r=0.01, x=0.1)
    grid.second = om.Branch("north", "south", r=0.01, x=0.1)
    coal = {"p": (30, 100), "q": (-50, 50), "ramp": 10, "cost": om.Polynomial(0.01, 10, 100), **unit}
    grid.coal = om.Generator("south", **coal)
    points = ((0, 50), (100, 3050), (200, 8000))
    grid.gas = om.Generator("north", p=(0, 250), q=(-90, 90), cost=om.PiecewiseLinear(points))
    grid.town = om.Load("south", p=80, q=10)
    return grid


@pytest.mark.filterwarnings("ignore::FutureWarning", "ignore::opfmodel.errors.CaseWarning")
def test_dispatch_of_a_commitment_is_that_of_pypsa() -> None:
    for name in ("pypsa", "linopy"):
        logging.getLogger(name).setLevel(logging.ERROR)
    n = snapshots(24, 1.0)
    n.add("Bus", "a", v_nom=110.0)
    for name, power, least, ramp, cost in (
        ("coal", 100, 0.4, 0.15, 20), ("oil", 60, 0.5, 0.3, 35), ("gas", 120, 0.2, None, 60),
    ):  # fmt: skip
        limits = {} if ramp is None else {
            "ramp_limit_up": ramp, "ramp_limit_down": ramp, "ramp_limit_start_up": max(least, ramp),
            "ramp_limit_shut_down": max(least, ramp),
        }  # fmt: skip
        n.add(
            "Generator", name, bus="a", p_nom=power, p_min_pu=least, marginal_cost=cost, committable=True,
            start_up_cost=50, **limits,
        )  # fmt: skip
    n.add("Load", "town", bus="a", p_set=90 + 60 * np.sin(np.arange(24) / 3))
    n.optimize(solver_name="highs", include_objective_constant=False)
    status, power = n.generators_t.status, n.generators_t.p
    cost = float((power * n.generators.marginal_cost).to_numpy().sum())
    assert np.abs(np.diff(status.to_numpy(), axis=0)).sum() >= 3.5
    grid = om.Network("commitment")
    grid.a = om.Bus()
    for name, unit in n.generators.iterrows():
        ramp = None if np.isnan(unit.ramp_limit_up) else unit.ramp_limit_up * unit.p_nom
        grid.add(
            name,
            om.Generator(
                "a",
                p=(unit.p_min_pu * unit.p_nom, unit.p_nom),
                ramp=ramp,
                cost=om.Polynomial(0, unit.marginal_cost, 0),
            ),
        )
    grid.town = om.Load("a", p=1)
    series = {f"{name}.on": np.rint(status[name].to_numpy()) for name in status}
    series["town.p"] = n.loads_t.p_set["town"].to_numpy()
    plan = om.MultiStage(grid, 24, formulation="copperplate", profiles=series).solve()
    assert plan.objective == pytest.approx(cost, rel=1e-7)
    assert check(grid, plan.data, series).max_violation < 1e-6
    always = {key: values for key, values in series.items() if not key.endswith(".on")}
    assert om.MultiStage(grid, 24, formulation="copperplate", profiles=always).solve().infeasible


def test_a_unit_costs_and_moves_as_its_status_says() -> None:
    grid, series = system(), {"coal.on": ON[:12]}
    plan = om.MultiStage(grid, 12, formulation="dc", profiles=series).solve()
    pg = plan.data.pg.sel(generator="coal").values
    assert pg == pytest.approx([0, 0, 30, 40, 40, 30, 0, 0, 30, 40, 50, 60], abs=1e-4)
    gas = 80 - pg
    cost = (0.01 * pg**2 + 10 * pg + 100 * ON[:12]).sum() + (30 * gas + 50).sum()
    assert plan.objective == pytest.approx(cost, rel=1e-7)
    report = check(grid, plan.data, series)
    assert report.cost == pytest.approx(plan.objective, rel=1e-9)
    assert report.max_violation < 1e-6
    expected = [10, 10, 30, 10, 10, 10, 30, 10, 30, 10, 10, 10]
    assert plan.data.pg_ramp.sel(generator="coal").values == pytest.approx(expected)


@settings(max_examples=6, deadline=None)
@given(
    status=st.lists(st.sampled_from([0.0, 0.5, 1.0]), min_size=9, max_size=9),
    time=st.integers(0, 2),
    horizon=st.sampled_from(
        [
            om.Horizon.chain(1),
            om.Horizon.grid([1, 1, 2, 2]),
            om.Horizon.tree([1, 2, 2], {"low": 0.3, "high": 0.7}, common=1),
        ]
    ),
)
def test_the_check_agrees_on_every_horizon(status: list[float], time: int, horizon: om.Horizon) -> None:
    grid, series = system(ramp=35), {"coal.on": np.array(status)}
    plan = om.MultiStage(grid, horizon, profiles=series).solve(time)
    assert plan.optimal
    for name in plan.horizon.scenarios:
        report = check(grid, plan.scenario(name), series, first=time)
        assert report.max_violation < 1e-6
        assert report.cost == pytest.approx(plan.scenario_costs[name], rel=1e-9)


@pytest.mark.parametrize(
    "plant", [NominalPlant(), om.PowerFlow(), om.Redispatch()], ids=lambda p: type(p).__name__
)
def test_closed_loops_with_units_that_are_shut_down(plant: Plant) -> None:
    nominal = isinstance(plant, NominalPlant)
    grid, series = system(), {"coal.on": ON[:8], "town.p": DEMAND[:8]}
    problem = om.MultiStage(grid, 3, formulation="ac" if nominal else "dc", profiles=series, at_end="shrink")
    run = simulate(Controller(problem, on_infeasible="elastic"), plant, 8)
    off = ON[:8] == 0
    coal = run.data.sel(generator="coal")
    for quantity in ("pg", "qg"):
        assert coal[quantity].values[off] == pytest.approx(np.zeros(off.sum()), abs=1e-6)
    assert coal.pg.values[~off].min() > 29.9
    assert np.abs(coal.qg.values[~off]).min() > 0.1
    report = check(grid, run.data, series)
    physical = ("active balance", "reactive balance", "generator q", "branch rating")
    assert max(report.violations[family].value for family in physical) < 1e-6
    assert run.cost == pytest.approx(report.cost, rel=1e-9)
    exceeded = {family for family, found in report.violations.items() if found.value > 1e-5}
    assert exceeded <= (set() if nominal else {"ramp"})  # a unit that generates losses has to shut down
    assert report.violations["ramp"].physical < 2.0


def test_outages_and_contingencies_of_units_that_are_shut_down() -> None:
    grid, series = system(ramp=None), {"coal.on": np.array([1.0, 0.0, 1.0])}
    security = om.Security(response="preventive", screen=False)
    plan = om.MultiStage(grid, 3, formulation="dc", profiles=series, security=security).solve()
    assert plan.data.pg.sel(generator="coal").values == pytest.approx([80, 0, 80], abs=1e-4)
    problem = om.MultiStage(grid, 3, profiles=series, outages=["coal"])
    for out, expected in (((), [True, False, True]), (("coal",), [False] * 3)):
        plan = problem.solve(out=out)
        assert (plan.data.pg.sel(generator="coal").values > 1).tolist() == expected
        assert check(grid, plan.data, series).cost == pytest.approx(plan.objective, rel=1e-9)


def test_a_unit_that_always_runs_has_the_program_of_one_without_a_status() -> None:
    plain, stated = (om.MultiStage(system(**on), 3) for on in ({}, {"on": 1.0}))
    one, other = plain.compile(), stated.compile()
    assert one.parameters.keys() == other.parameters.keys()
    assert plain.solve().solution.x == pytest.approx(stated.solve().solution.x, abs=0)
    always = om.MultiStage(system(), 3, profiles={"coal.on": np.ones(3)}).solve()
    assert always.objective == pytest.approx(plain.solve().objective, rel=1e-8)
    never = om.MultiStage(system(on=0.0), 3).solve()
    assert never.data.pg.sel(generator="coal").values == pytest.approx(np.zeros(3), abs=1e-8)


def test_a_status_is_between_zero_and_one() -> None:
    with pytest.raises(ComponentError, match=r"coal: on = 1\.5: must be at most 1"):
        system(on=1.5)
    with pytest.raises(ProfileError, match=r"profile 'coal\.on': step 1: -1: must be at least 0"):
        om.MultiStage(system(), 2, profiles={"coal.on": [0, -1]})


@pytest.mark.parametrize(
    ("quantity", "step", "family"), [("pg", 0, "generator p"), ("qg", 0, "generator q"), ("pg", 4, "ramp")]
)
def test_the_check_finds_units_that_run_when_shut_down(quantity: str, step: int, family: str) -> None:
    grid, series = system(), {"coal.on": ON[:12]}
    data = om.MultiStage(grid, 12, profiles=series).solve().data
    data[quantity].loc[{"generator": "coal", "time": step}] += 5.0
    assert check(grid, data, series).violations[family].value == pytest.approx(0.05, rel=1e-3)


def test_a_network_file_has_no_status_between_zero_and_one(tmp_path: Path) -> None:
    with pytest.raises(CaseError, match=r"coal: on = 0\.5 is left out"):
        om.write_network(system(on=0.5), tmp_path / "case.m", lossy=False)
