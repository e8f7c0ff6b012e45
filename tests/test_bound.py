"""Certified bounds: published gaps, exact relaxations, proofs of infeasibility, and what is refused."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import DATA, Call, pglib_baseline, two_bus

import opfmodel as om
from opfmodel.errors import IncompatibleError
from solvers import ProgramBuilder, dual_bound, prepare, total

BASELINE = pglib_baseline()
DEMAND = {"town.p": [60, 80, 110, 120, 90, 60]}


def feeder() -> om.Network:
    """A radial feeder with losses in line and storage, where the relaxation is exact."""
    grid = om.Network("feeder", base_mva=100)
    grid.a = om.Bus(vm=(0.95, 1.05), reference=True)
    grid.b, grid.c = om.Bus(vm=(0.95, 1.05)), om.Bus(vm=(0.95, 1.05))
    grid.ab = om.Branch("a", "b", r=0.01, x=0.05, b=0.02, rating=150, tap=0.98)
    grid.bc = om.Branch("b", "c", r=0.01, x=0.05)
    grid.coal = om.Generator("a", p=(0, 200), q=(-100, 100), ramp=30, cost=om.Polynomial(0.02, 15, 0))
    grid.gas = om.Generator("c", p=(0, 50), cost=om.PiecewiseLinear([(0, 0), (20, 500), (50, 2000)]))
    grid.cell = om.Storage(
        "b", energy=60, power=20, q=(-10, 10), initial=0.5, charge_efficiency=0.95, discharge_efficiency=0.9
    )
    grid.bank = om.Shunt("c", b=10)
    grid.town = om.Load("c", p=90, q=20)
    return grid


def parallel() -> om.Network:
    """Two lines in parallel; the angle across them is limited as long as ``ab`` is in service."""
    grid = om.Network("parallel", base_mva=100)
    grid.a = om.Bus(vm=(0.95, 1.05), reference=True)
    grid.b = om.Bus(vm=(0.95, 1.05))
    grid.ab = om.Branch("a", "b", r=0.01, x=0.06, rating=100, angle=(-2.5, 2.5))
    grid.twin = om.Branch("a", "b", r=0.01, x=0.06, rating=110)
    grid.coal = om.Generator("a", p=(0, 150), q=(-90, 90), ramp=60, cost=om.Polynomial(0, 15, 0))
    grid.gas = om.Generator("b", p=(0, 60), q=(-90, 90), ramp=60, cost=om.Polynomial(0, 40, 0))
    grid.town = om.Load("b", p=90, q=20)
    return grid


def test_a_bound_holds_for_all_positions() -> None:
    grid = feeder()
    grid.update("ab", tap=(0.9, 1.1), tap_steps=3, move_cost=3)
    plan = om.MultiStage(grid, 2).solve(initial={"tap": [0.95, 1.0]})
    certificate = om.certify(plan)
    assert plan.rounded_from is not None
    assert certificate.lower == pytest.approx(plan.rounded_from.objective, rel=1e-6)
    assert certificate.upper == plan.objective


def beyond(most: float = 300.0) -> om.Network:
    """Two buses with a demand that the line cannot carry."""
    grid = two_bus()
    grid.update("town", p=most)
    return grid


@pytest.mark.parametrize(
    "case", ["case5_pjm", "case14_ieee", "case39_epri", "case118_ieee", "case30_as__sad"]
)
def test_gaps_are_those_of_the_library(case: str) -> None:
    """To every printed digit; PGLib rounds gaps up."""
    name = f"pglib_opf_{case}"
    certificate = om.certify(om.MultiStage(om.read_network(DATA / "pglib" / f"{name}.m")).solve())
    assert math.ceil(1e4 * certificate.gap) / 100 == float(BASELINE[name]["soc_gap_percent"])
    assert certificate.status == "globally_optimal"
    assert not certificate.exact


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"formulation": "ac-rectangular", "end": om.End(cyclic=True)},
        {"formulation": "soc", "generator_delay": 1},
        {"end": om.End(price=20.0, minimum=0.3)},
        {"regularisation": 50.0},
    ],
    ids=str,
)
def test_on_a_radial_feeder_plans_are_exact(options: dict[str, Any]) -> None:
    problem = om.MultiStage(feeder(), 6, profiles=DEMAND, **options)
    problem.constrain("reserve", lambda s: om.total(s.generator.p_max - s.generator.pg) >= 80)
    plan = problem.solve(initial={"e": [20.0]})
    certificate = om.certify(plan)
    assert -1e-7 < certificate.gap < (1e-6 if "regularisation" not in options else 1e-2)
    assert certificate.exact or "regularisation" in options
    assert certificate.plan is plan
    assert (certificate.upper == plan.objective) == ("price" not in str(options) or options["end"].price == 0)


def test_a_plan_that_ends_with_the_data() -> None:
    plan = om.MultiStage(feeder(), 6, profiles=DEMAND, at_end="shrink").solve(2, initial={"e": [30.0]})
    short = om.MultiStage(feeder(), 4, profiles={"town.p": DEMAND["town.p"][2:]})
    whole = om.certify(short.solve(initial={"e": [30.0]}))
    assert plan.stages == 4
    assert om.certify(plan).lower == pytest.approx(whole.lower, rel=1e-6)
    assert om.certify(plan).exact


@pytest.mark.parametrize("risk", [None, om.Risk(level=0.5, weight=0.5)], ids=["mean", "risk"])
def test_scenarios_and_risk(risk: om.Risk | None) -> None:
    """With linear costs; the risk of quadratic ones is no second-order cone program."""
    grid = feeder()
    grid.update("coal", cost=om.Polynomial(0, 15, 0))
    horizon = om.Horizon.tree([1, 1, 2], {"low": 0.4, "high": 0.6}, common=1)
    problem = om.MultiStage(grid, horizon, profiles=DEMAND, risk=risk)
    demand = [om.Profiles({"town.p": [60, *peak]}) for peak in ([60, 60, 60], [90, 120, 120])]
    plan = problem.solve(initial={"e": [20.0]}, expected=problem.expected(demand))
    certificate = om.certify(plan)
    assert plan.scenario_costs["high"] > 1.2 * plan.scenario_costs["low"]
    assert -1e-7 < certificate.gap < 1e-6


@pytest.mark.parametrize("screen", [False, True])
def test_secure_plans(screen: bool) -> None:
    """A line that goes out limits no angle, also in the relaxation."""
    problem = om.MultiStage(parallel(), 2, security=om.Security(minutes=1, screen=screen))
    plan = problem.solve()
    certificate = om.certify(plan)
    assert plan.optimal
    assert certificate.status == "globally_optimal"
    assert -1e-6 < certificate.gap < 1e-6


def test_an_outage_in_force() -> None:
    plan = om.MultiStage(parallel(), outages=["ab"]).solve(out=["ab"])
    angles = plan.data["va"].isel(time=0)
    assert angles.sel(bus="a") - angles.sel(bus="b") > 2.5
    certificate = om.certify(plan)
    assert certificate.exact
    assert -1e-7 < certificate.gap < 1e-6


# Infeasibility ----------------------------------------------------------------------------------


def test_infeasibility_is_proven() -> None:
    demand = {"town.p": [90, 90, 300, 90]}
    plan = om.MultiStage(two_bus(), 4, profiles=demand).solve()
    certificate = om.certify(plan)
    assert (plan.status, certificate.plan.status) == ("locally_infeasible", "proven_infeasible")
    assert certificate.status == "proven_infeasible"
    assert "relaxation 'soc'" in certificate.plan.termination
    assert certificate.plan.infeasible
    assert np.isnan([certificate.lower, certificate.upper, certificate.gap]).all()
    assert not certificate.exact


def test_a_solve_that_stopped_is_infeasible_if_the_relaxation_is() -> None:
    plan = om.MultiStage(beyond(), options={"max_iter": 1}).solve()
    assert (plan.status, om.certify(plan).plan.status) == ("stopped", "proven_infeasible")
    plan = om.MultiStage(beyond(90), options={"max_iter": 1}).solve()
    certificate = om.certify(plan)
    assert (plan.status, certificate.plan.status) == ("stopped", "stopped")
    assert certificate.lower > 0
    assert np.isnan(certificate.gap)


def test_what_only_the_relaxation_can_do_is_not_proven_infeasible() -> None:
    """A unit that must run generates more than the line can lose; slack in the cone loses it."""
    grid = two_bus()
    grid.update("coal", p=(96, 96))
    grid.update("cell", power=0)
    grid.support = om.Generator("south", p=(0, 0), q=(-80, 80), cost=om.Polynomial(0, 1, 0))
    plan = om.MultiStage(grid).solve()
    certificate = om.certify(plan)
    assert (plan.status, certificate.plan.status) == ("locally_infeasible", "locally_infeasible")
    assert certificate.status == "globally_optimal"
    assert certificate.plan is plan


# The bound itself --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "grid", [feeder(), om.read_network(DATA / "pglib" / "pglib_opf_case14_ieee.m")], ids=str
)
def test_a_bound_is_valid_however_inaccurate_the_solution(grid: om.Network) -> None:
    problem = om.MultiStage(grid, formulation="soc", solver="clarabel", regularisation=0.0)
    optimum = problem.solve().solution
    tolerance = 1e-6 * abs(optimum.objective)
    assert optimum.objective - tolerance <= dual_bound(optimum) <= optimum.objective + tolerance
    rng = np.random.default_rng(1)
    for steps in (1, 3, 5, 8):
        early = prepare(problem.compile(), "clarabel", {"max_iter": steps}).solve(optimum.instance)
        assert dual_bound(early) <= optimum.objective + tolerance
    for size in (1e-4, 1e-2, 1.0):
        x, rows, z = (
            v * (1 + size * rng.standard_normal(v.size)) for v in (optimum.x, optimum.lam_g, optimum.z)
        )
        moved = replace(optimum, x=x, lam_g=rows, z=z)
        assert dual_bound(moved) <= optimum.objective + tolerance


def test_variables_without_bounds_leave_no_residual() -> None:
    """min t with t >= x - 1, t >= 1 - x and x free: 0; multipliers that miss it slightly are corrected."""
    build = ProgramBuilder("free")
    t, x = build.variable("t", 1), build.variable("x", 1)
    build.constrain("above", t - x >= -1.0)
    build.constrain("below", t + x >= 1.0)
    build.minimize(total(t))
    program = build.build()
    found = prepare(program, "clarabel").solve(program.default)
    inaccurate = replace(found, lam_g=np.array([-0.4, -0.3]))
    assert dual_bound(inaccurate) == pytest.approx(0.0, abs=1e-9)


# Refused and printed -----------------------------------------------------------------------------


def _angle(problem: om.MultiStage) -> None:
    problem.constrain("narrow", lambda s: s.bus.va <= 10)


@pytest.mark.parametrize(
    ("options", "change", "named"),
    [
        ({"formulation": "dc"}, None, "formulation 'dc'"),
        ({"elastic": om.Elastic()}, None, "soft limits"),
        ({"objective": om.VoltageDeviation()}, None, "VoltageDeviation needs vm"),
        ({}, _angle, "constraint 'narrow': formulation 'soc' does not publish bus.va"),
        ({}, None, None),
    ],
    ids=["dc", "elastic", "objective", "constraint", "exclusive"],
)
def test_what_has_no_bound_is_named(
    options: dict[str, Any], change: Callable[[om.MultiStage], None] | None, named: str | None
) -> None:
    grid = two_bus()
    if named is None:
        named = "not convex: .*'storage_exclusive'"
        grid.update("cell", charge_efficiency=0.9, exclusive=True)
    problem = om.MultiStage(grid, **options)
    if change is not None:
        change(problem)
    with pytest.raises(IncompatibleError, match=f"^bound: .*{named}"):
        om.certify(problem.solve())


def test_the_command_prints_bound_and_gap(call: Call, tmp_path: Path) -> None:
    case = DATA / "pglib" / "pglib_opf_case5_pjm.m"
    code, out, _ = call("solve", case, "--bound", "--json")
    bound = json.loads(out)["bound"]
    assert (code, bound["status"]) == (0, "globally_optimal")
    assert bound["gap"] == pytest.approx(0.145407, abs=1e-6)
    assert bound["lower"] == pytest.approx(14999.7, abs=0.1)
    assert bound["seconds"] > 0
    assert json.loads(call("solve", case, "--json")[1])["bound"] is None
    printed = call("solve", case, "--bound")[1]
    assert "lower bound    14,999.7" in printed
    assert "gap            14.5407 %" in printed
    refused = call("solve", case, "--bound", "--formulation", "dc")
    assert refused[0] == 2
    assert "formulation 'dc'" in refused[2]
    file = tmp_path / "beyond.m"
    om.write_network(beyond(), file)
    code, out, _ = call("solve", file, "--bound", "--json")
    assert (code, json.loads(out)["status"]) == (1, "proven_infeasible")
    assert json.loads(out)["bound"]["lower"] is None
    assert "relaxation 'soc'" in call("solve", file, "--bound")[1]
