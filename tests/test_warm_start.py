"""Warm starts: they save iterations and change no result; failed solves are repeated and recorded."""

from __future__ import annotations

from dataclasses import replace

import pytest
from conftest import SCENARIOS, two_bus
from numpy.testing import assert_array_equal

import opfmodel as om
from opfmodel.plan import Plan
from opfmodel.simulation import Run
from solvers import SolutionStatus, Start

WAVE = {"town.p": [60.0, 80, 100, 100, 70, 60, 80, 90], "town.q": [20.0, 30, 35, 35, 22, 20, 25, 30]}


TIGHT = {"name": "ipopt", "options": {"tol": 1e-8}}


def scenario(name: str, steps: int, solver: str | dict = "ipopt") -> om.Scenario:
    overrides = {"time.steps": steps, "controller.solver": solver}
    return om.load_scenario(SCENARIOS / f"{name}.yaml", overrides=overrides)


@pytest.mark.parametrize(
    ("name", "steps"),
    [
        ("case5-step", 12),
        ("case5-random", 6),
        pytest.param("case118-step", 4, marks=pytest.mark.slow),
        pytest.param("case118-random", 4, marks=pytest.mark.slow),
    ],
)
def test_warm_plans_have_the_cost_of_tight_cold_ones(name: str, steps: int) -> None:
    made = scenario(name, steps)
    tight = scenario(name, steps, TIGHT).problem
    controller, state = om.Controller(made.problem), made.initial()
    warm, cold = [], []
    for time in range(steps):
        plan = controller.plan(time, state)
        assert [attempt.start for attempt in controller.attempts] == ["warm" if time else "cold"]
        reference = tight.solve(time, state)
        assert plan.objective == pytest.approx(reference.objective, rel=1e-6)
        warm.append(plan.solution.iterations)
        cold.append(reference.solution.iterations)
        state = plan.next_state()
    assert sum(warm[1:]) < sum(cold[1:]) / 2


@pytest.mark.slow
def test_a_loop_of_warm_plans_has_the_cost_of_a_loop_of_tight_cold_ones() -> None:
    made = scenario("case5-step", 49)  # costs over part of the cycle depend on what is stored
    fast = made.simulate()
    tight = scenario("case5-step", 49, TIGHT).problem
    state, steps = made.initial(), []
    for time in range(49):
        plan = tight.solve(time, state)
        steps.append(om.NominalPlant().apply(plan))
        state = steps[-1].state
    assert fast.cost == pytest.approx(Run(tight, made.cost, steps=steps).cost, rel=1e-6)
    assert fast.summary()["retries"] == {}


@pytest.mark.parametrize(
    ("name", "horizon", "steps"),
    [
        ("case5-step", 24, 12),
        ("case5-random", 12, 24),
        pytest.param("case118-step", 24, 5, marks=pytest.mark.slow),
        pytest.param("case118-random", 8, 12, marks=pytest.mark.slow),
    ],
)
def test_the_push_of_multipliers_follows_the_last_step(name: str, horizon: int, steps: int) -> None:
    runs = {}
    for push in (1e-2, 1e-4, None):
        options = {} if push is None else {"warm_start_mult_bound_push": push}
        overrides = {
            "controller.horizon": horizon,
            "time.steps": steps,
            "controller.solver": {"name": "ipopt", "options": options},
        }
        runs[push] = om.load_scenario(SCENARIOS / f"{name}.yaml", overrides=overrides).simulate()
    taken = {push: sum(plan["iterations"] for plan in run.plans[1:]) for push, run in runs.items()}
    # the step after the cold solve is pushed far whatever the system, and a change of system shows one step late
    assert taken[None] <= 1.03 * min(taken[1e-2], taken[1e-4]) + 8
    for push in (1e-2, 1e-4):
        assert runs[None].cost == pytest.approx(runs[push].cost, rel=1e-6)


def test_a_controller_that_runs_again_takes_the_same_steps() -> None:
    made = scenario("case5-step", 5)
    controller = om.Controller(made.problem)
    first, second = (om.simulate(controller, steps=5, initial=made.initial()) for _ in range(2))
    assert [p["iterations"] for p in first.plans] == [p["iterations"] for p in second.plans]
    assert first.cost == second.cost
    for name in ("pg", "e", "vm"):
        assert_array_equal(first.data[name], second.data[name])


def test_the_same_problem_again_takes_next_to_no_iterations() -> None:
    problem = scenario("case5-step", 1).problem
    first = problem.solve()
    again = problem.solve(previous=first)
    assert again.solution.iterations <= 2
    assert again.objective == pytest.approx(first.objective, rel=1e-7)


def test_options_of_the_user_win_over_those_of_the_situation() -> None:
    run = scenario("case5-step", 2, {"name": "ipopt", "options": {"max_iter": 1}}).simulate()
    assert run.status == "stopped"
    assert run.plans[0]["iterations"] == 1


def failing(problem: om.MultiStage, monkeypatch: pytest.MonkeyPatch, *starts: str, step: int = 1) -> None:
    """Make the solves of one step fail that begin in one of these ways."""
    solve = om.MultiStage.solve

    def flaky(self, time: int, state: dict, previous: Plan | None = None, **options) -> Plan:
        plan = solve(self, time, state, previous, **options)
        start = "cold" if previous is None else ("warm" if options.get("multipliers", True) else "other")
        if self is problem and time == step and start in starts:
            plan.solution = replace(plan.solution, status=SolutionStatus.NONE)
        return plan

    monkeypatch.setattr(om.MultiStage, "solve", flaky)


@pytest.mark.parametrize(
    ("starts", "climbed"),
    [
        ((), ["warm"]),
        (("warm",), ["warm", "cold"]),
        (("warm", "cold"), ["warm", "cold", "other"]),
    ],
)
def test_every_rung_of_the_ladder_is_recorded(
    starts: tuple, climbed: list, monkeypatch: pytest.MonkeyPatch
) -> None:
    grid = two_bus()
    grid.update("coal", ramp=40)
    problem = om.MultiStage(grid, 4, profiles=WAVE)
    failing(problem, monkeypatch, *starts)
    run = om.simulate(problem, steps=4)
    assert run.status == "done"
    record = run.plans[1]
    assert [attempt["start"] for attempt in record["attempts"]] == climbed
    assert [attempt["status"] for attempt in record["attempts"]][-1] == "locally_optimal"
    assert record["solve_seconds"] == pytest.approx(sum(a["seconds"] for a in record["attempts"]))
    retries = run.summary()["retries"]
    assert list(retries) == (["1"] if starts else [])
    monkeypatch.undo()
    reference = om.simulate(om.MultiStage(grid, 4, profiles=WAVE), steps=4)
    assert run.cost == pytest.approx(reference.cost, rel=1e-6)


def test_the_last_rung_is_elastic(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = om.MultiStage(two_bus(), 4, profiles=WAVE)
    failing(problem, monkeypatch, "warm", "cold", "other")
    run = om.simulate(problem, steps=3, on_infeasible="elastic")
    assert [a["start"] for a in run.plans[1]["attempts"]] == ["warm", "cold", "other", "elastic"]
    assert run.plans[1]["status"] == "elastic"
    assert [a["start"] for a in run.plans[2]["attempts"]] == ["cold"]  # nothing to start from


def test_a_start_that_was_moved_is_trusted_less() -> None:
    problem = om.MultiStage(two_bus(), 4, profiles=WAVE)
    solution = problem.solve().solution
    assert solution.start().moved == 0
    assert solution.shifted(2).moved == 2
    assert Start(solution.x).lam_g is None
