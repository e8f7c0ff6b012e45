"""Overlapping windows in time: the optimum of the whole, a gap that is a bound, and what is refused."""

from __future__ import annotations

import pickle
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import opfmodel as om
import solvers
from opfmodel.check import check
from opfmodel.plan.memory import problem_bytes
from solvers import Evaluator, ProgramBuilder, SolutionStatus, TerminationCondition, total
from solvers.backends.windows import WindowsSession
from solvers.placewise import PlacewiseEvaluator
from solvers.windows.decay import best_overlap

STAGES = 72


def grid(*, peak: float = 1.0, budget: bool = False) -> om.Network:
    """Two buses, a slow and a dear unit, and a store that takes 6 h to fill."""
    network = om.Network("pair", base_mva=100)
    network.north = om.Bus(vm=(0.95, 1.05), reference=True)
    network.south = om.Bus(vm=(0.95, 1.05))
    network.tie = om.Branch("north", "south", r=0.01, x=0.1, rating=120)
    network.coal = om.Generator("north", p=(0, 110), q=(-80, 80), ramp=15, cost=om.Polynomial(0.05, 15, 0))
    network.gas = om.Generator("south", p=(0, 60), q=(-40, 40), cost=om.Polynomial(0.02, 40, 0))
    network.cell = om.Storage("south", energy=60, power=10, q=(-10, 10), initial=20)
    network.town = om.Load("south", p=90 * peak, q=20)
    if budget:
        network.add("coal_year", om.Budget(amount=5000, hours=8760, uses={"coal": 1.0}))
    return network


def demand(stages: int = STAGES, seed: int = 1) -> dict[str, np.ndarray]:
    hours, rng = np.arange(stages), np.random.default_rng(seed)
    wave = 1 + 0.25 * np.sin(2 * np.pi * (hours - 8) / 24) + 0.05 * rng.standard_normal(stages)
    return {"town.p": 85 * wave, "town.q": 20 * wave}


def problem(formulation: str, solver: str, **options: Any) -> om.MultiStage:
    return om.MultiStage(
        grid(), STAGES, formulation=formulation, profiles=demand(), solver=solver, options=options
    )


@cache
def whole(formulation: str) -> om.Plan:
    return problem(formulation, "ipopt", tol=1e-9).solve()


@pytest.mark.parametrize(
    ("formulation", "inner"),
    [("ac", "ipopt"), ("ac-rectangular", "ipopt"), ("soc", "clarabel"), ("dc", "clarabel"), ("dc", "ipopt")],
)
def test_windows_find_the_optimum_of_the_whole(formulation: str, inner: str) -> None:
    plan = problem(formulation, f"windows:{inner}", window=20, overlap=6, tolerance=1e-8).solve()
    session, reference = plan.problem.session, whole(formulation)
    assert isinstance(session, WindowsSession)
    assert plan.optimal
    assert session.trace[-1].number > 1
    assert plan.objective == pytest.approx(reference.objective, rel=2e-7)
    assert plan.data.e.values == pytest.approx(reference.data.e.values, abs=0.05)
    assert plan.data.lmp.values == pytest.approx(reference.data.lmp.values, abs=0.01)
    assert check(plan.problem.network, plan.data, plan.problem.profiles).max_violation < 1e-6


def test_the_gap_bounds_the_distance_from_the_optimum() -> None:
    """At every sweep, even with an overlap far shorter than a store takes to fill."""
    plan = problem("dc", "windows:clarabel", window=12, overlap=2, tolerance=1e-9, sweeps=6).solve()
    session, optimum = plan.problem.session, whole("dc").solution.objective
    assert isinstance(session, WindowsSession)
    excess = [sweep.objective / optimum - 1 for sweep in session.trace]
    gaps = [sweep.gap for sweep in session.trace]
    assert excess[0] > 1e-6  # the first sweep does not know what lies behind its windows
    assert all(e <= gap + 1e-8 for e, gap in zip(excess, gaps, strict=True))
    assert gaps[-1] < gaps[0]


def test_windows_solve_elastic_problems() -> None:
    found = []
    for solver, options in (("ipopt", {}), ("windows", {"window": 20, "overlap": 12, "tolerance": 1e-7})):
        soft = om.MultiStage(
            grid(), STAGES, formulation="dc", profiles=demand(), elastic=om.Elastic(), solver=solver,
            options=options,
        )  # fmt: skip
        found.append(soft.solve().objective)
    assert found[1] == pytest.approx(found[0], rel=1e-6)


def test_sweeps_that_do_not_reach_the_tolerance_are_reported() -> None:
    plan = problem("dc", "windows", window=12, overlap=1, tolerance=1e-14, sweeps=2).solve()
    assert not plan.optimal
    assert plan.solution.termination is TerminationCondition.ITERATION_LIMIT
    assert "after 2 sweeps of 6 windows" in plan.termination


def test_a_solution_is_the_start_of_the_next_solve() -> None:
    windows = problem("dc", "windows", window=20, overlap=12, tolerance=1e-8)
    first = windows.solve()
    again = windows.solve(previous=first)
    session = windows.session
    assert isinstance(session, WindowsSession)
    assert len(session.trace) == 1
    assert again.objective == pytest.approx(first.objective, rel=1e-7)


def test_a_closed_loop_of_windows_costs_as_much_as_one_of_whole_plans() -> None:
    costs = []
    for solver, options in (("ipopt", {}), ("windows", {"window": 12, "overlap": 10, "tolerance": 1e-8})):
        loop = om.MultiStage(grid(), 36, formulation="dc", profiles=demand(), solver=solver, options=options)
        run = om.simulate(loop, steps=4)
        assert run.status == "done"
        costs.append(run.cost)
    assert costs[1] == pytest.approx(costs[0], rel=1e-6)


def test_the_overlap_is_chosen_by_the_decay_that_is_measured() -> None:
    plan = problem("dc", "windows", window=16, tolerance=1e-7).solve()
    session = plan.problem.session
    assert isinstance(session, WindowsSession)
    assert plan.optimal
    assert 2 <= session.overlap <= 32
    assert plan.objective == pytest.approx(whole("dc").objective, rel=1e-6)


def test_the_best_overlap_weighs_work_per_sweep_against_sweeps() -> None:
    halving = 0.5 ** (np.arange(1, 41) / 4)  # halves every four stages: work falls until overlap = length
    assert best_overlap(halving, 10**6) == 40
    assert best_overlap(np.where(np.arange(40) < 9, 0.9, 1e-9), 20) == 10
    assert best_overlap(np.full(40, 0.9), 20) is None


# Random programs ----------------------------------------------------------------------------------


@st.composite
def chains(draw: st.DrawFn) -> solvers.Program:
    """Stores that trade at changing prices: linear or quadratic, with losses and limits of change."""
    stages, items = draw(st.integers(8, 14)), draw(st.integers(1, 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**16)))
    curvature = draw(st.sampled_from([0.0, 0.5]))
    build = ProgramBuilder("chain")
    e = build.variable("e", items, stages + 1, 0.0, rng.uniform(1.0, 3.0, (items, 1)))
    p = build.variable("p", items, stages, -1.0, 1.0)
    price = build.parameter("price", items, stages, rng.uniform(1.0, 5.0, (items, stages)))
    kept = rng.uniform(0.9, 1.0, (items, 1))
    build.constrain("dynamics", e[:, 1:] - kept * e[:, :-1] - p == 0.0)
    build.constrain("begin", e[:, :1] == 0.5)
    if draw(st.booleans()):
        build.constrain("change", p[:, 1:] - p[:, :-1] <= 0.7)
    if draw(st.booleans()):
        build.constrain("shared", total(p) <= 1.2)
    build.minimize(price * p)
    build.minimize(-1.5 * e[:, stages:])
    if curvature:
        build.minimize(curvature * p**2)
    return build.build()


@given(chains(), st.integers(2, 6), st.integers(1, 8))
@settings(max_examples=8)
def test_windows_solve_random_chains(program: solvers.Program, window: int, overlap: int) -> None:
    optimum = solvers.solve(program, "clarabel").objective
    options = {"window": window, "overlap": overlap, "tolerance": 1e-7, "sweeps": 10}
    session = solvers.prepare(program, "windows:clarabel", options)
    solution = session.solve(program.default)
    excess = solution.objective - optimum
    assert isinstance(session, WindowsSession)
    scale = max(abs(optimum), 1.0)
    assert excess >= -1e-6 * scale
    assert excess <= session.trace[-1].gap * abs(solution.objective) + 1e-6 * scale
    assert solution.primal_residual < 1e-6


@given(chains())
@settings(max_examples=10)
def test_programs_are_evaluated_in_parts_as_at_once(program: solvers.Program) -> None:
    at_once, in_parts = Evaluator(program), PlacewiseEvaluator(program)
    x, p = np.random.default_rng(0).standard_normal(program.n_variables), program.default.parameters
    for name in ("objective", "rows", "gradient"):
        assert getattr(in_parts, name)(x, p) == pytest.approx(getattr(at_once, name)(x, p), rel=1e-12)
    assert abs(in_parts.jacobian(x, p) - at_once.jacobian(x, p)).max() < 1e-12


def test_functions_of_alternating_current_are_evaluated_in_parts_as_at_once() -> None:
    solution = whole("ac").solution
    x, p = solution.x, solution.instance.parameters
    at_once, in_parts = solution.evaluator, PlacewiseEvaluator(solution.program)
    assert in_parts.objective(x, p) == pytest.approx(at_once.objective(x, p), rel=1e-12)
    assert in_parts.rows(x, p) == pytest.approx(at_once.rows(x, p), abs=1e-12)
    assert in_parts.gradient(x, p) == pytest.approx(at_once.gradient(x, p), rel=1e-12)
    assert abs(in_parts.jacobian(x, p) - at_once.jacobian(x, p)).max() < 1e-12
    for name, values in at_once.outputs(x, p).items():
        assert in_parts.outputs(x, p)[name] == pytest.approx(values, abs=1e-12)


def test_programs_travel_to_other_processes() -> None:
    program = whole("ac").solution.program
    other = pickle.loads(pickle.dumps(program))
    x, p = whole("ac").solution.x, whole("ac").solution.instance.parameters
    assert Evaluator(other).objective(x, p) == Evaluator(program).objective(x, p)
    assert abs(Evaluator(other).jacobian(x, p) - Evaluator(program).jacobian(x, p)).max() == 0.0


# Refusals -----------------------------------------------------------------------------------------


def refusal(**arguments: Any) -> str:
    """What is said of a problem that windows cannot solve."""
    network, end = arguments.pop("network", None) or grid(), arguments.pop("end", None)
    asked: dict[str, Any] = {"horizon": 24, "profiles": demand(), "formulation": "dc"} | arguments
    made = om.MultiStage(network, solver="windows", options={"window": 8, "overlap": 4}, **asked)
    with pytest.raises(solvers.UnsupportedProgramError) as caught:
        made.solve(end=end)
    return str(caught.value)


def test_what_couples_distant_stages_is_refused_by_name() -> None:
    assert "'e_cyclic' of 'pair, 24 stages of 1 h' couples stage 0 with stage 23" in refusal(
        end=om.End(cyclic=True)
    )
    assert "'budget" in refusal(network=grid(budget=True))


def test_trees_and_contingencies_are_refused_by_name() -> None:
    tree = om.Horizon.tree([1.0] * 6, {"low": 0.5, "high": 0.5}, common=2)
    assert "couples stage" in refusal(horizon=tree, profiles=None)


def test_options_are_checked() -> None:
    for options, message in (
        ({"window": 0}, "windows: window = 0: must be a whole number of at least 1 or 'auto'"),
        ({"overlap": "long"}, "windows: overlap = 'long': must be a whole number of at least 1 or 'auto'"),
        ({"workers": True}, "windows: workers = True: must be a whole number of at least 1"),
        ({"sweeps": 2.5}, "windows: sweeps = 2.5: must be a whole number of at least 1"),
        ({"tolerance": 0}, "windows: tolerance = 0: must be a number above 0"),
        ({"proximal": -1}, "windows: proximal = -1: must be a number of at least 0"),
        ({"scheduler": 8786}, "windows: scheduler = 8786: must be a text"),
        ({"memory": "lots"}, "windows: memory = 'lots': must be an amount such as 2GiB, at least 100MB"),
        ({"memory": "10MB"}, "windows: memory = '10MB': must be an amount such as 2GiB, at least 100MB"),
    ):
        with pytest.raises(solvers.SolverOptionError) as caught:
            problem("dc", "windows", **options).solve()
        assert str(caught.value) == message


# Failure ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("at", "overlap", "proven"), [(3, 4, True), (3, "auto", True), (50, 4, False)])
def test_a_window_without_solution_is_named(at: int, overlap: int | str, proven: bool) -> None:
    series = demand()
    series["town.p"][at] = 500.0
    made = om.MultiStage(
        grid(), STAGES, formulation="dc", profiles=series, solver="windows:clarabel",
        options={"window": 20, "overlap": overlap},
    )  # fmt: skip
    solution = made.solve().solution
    assert solution.termination is TerminationCondition.INFEASIBLE
    assert solution.status is (SolutionStatus.PROVEN_INFEASIBLE if proven else SolutionStatus.NONE)
    assert f"in stages {0 if proven else 40} to " in solution.message


def test_a_problem_in_parts_is_allowed_more_stages() -> None:
    assert problem_bytes(600, 8760, reactive=True) > 4 * problem_bytes(
        600, 8760, reactive=True, in_parts=True
    )
    assert solvers.in_parts("windows:ipopt")
    assert not solvers.in_parts("ipopt")


@pytest.mark.slow
@pytest.mark.parametrize("tolerance", [1e-7, 1e-2])
def test_workers_find_the_same_optimum(tolerance: float) -> None:
    """Chains do not know where the one before them ends; at a loose tolerance a last pass closes the jumps."""
    plan = problem("dc", "windows", window=12, overlap=4, tolerance=tolerance, workers=2).solve()
    session = plan.problem.session
    assert isinstance(session, WindowsSession)
    assert plan.optimal
    assert plan.solution.primal_residual < 1e-7
    assert session.trace[-1].jump < 1e-8
    excess = plan.objective / whole("dc").objective - 1
    assert -1e-7 <= excess <= session.trace[-1].gap + 1e-6
    assert session.trace[-1].gap <= tolerance
