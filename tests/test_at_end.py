"""The end of the data: plans that are refused, repeat the data, or end with them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import opfmodel as om
from opfmodel.check import check
from opfmodel.errors import IncompatibleError, ModelError
from opfmodel.forecasts import Noisy, Perfect, Persistence
from opfmodel.objectives.base import Objective, WeightedSum
from solvers import total

HORIZON, STEPS = 4, 6
DEMAND = [60.0, 75, 90, 70, 95, 80]
PRICES = [20.0, 18, 25, 30, 22, 27]
ENDS = {"free": {}, "cyclic": {"cyclic": True}, "minimum": {"minimum": 0.6}, "price": {"price": 24.0}}


def grid() -> om.Network:
    """Three buses in a ring with ramps, a storage with losses and an inverter circle, and ratings."""
    made = om.Network("ring")
    for number, bus in enumerate("abc"):
        made.add(bus, om.Bus(vm=(0.95, 1.05), reference=number == 0))
    for f, t, rating in (("a", "b", 60), ("b", "c", 45), ("a", "c", None)):
        made.add(f + t, om.Branch(f, t, r=0.01, x=0.08, b=0.02, rating=rating))
    made.coal = om.Generator("a", p=(10, 80), q=(-60, 60), ramp=12, cost=om.Polynomial(0.02, 20, 5))
    made.gas = om.Generator("b", p=(0, 60), q=(-60, 60), cost=om.Polynomial(0.05, 35, 0))
    made.cell = om.Storage(
        "c", energy=40, power=15, q=(-10, 10), rating=16, initial=22,
        charge_efficiency=0.95, discharge_efficiency=0.9, standing_loss=0.01,
    )  # fmt: skip
    made.town = om.Load("c", p=70, q=20)
    return made


def problem(horizon: int = HORIZON, **options: Any) -> om.MultiStage:
    series = {"town.p": DEMAND, "coal.c1": PRICES, "gas.p_max": [60.0, 50, 55, 60, 45, 60]}
    return om.MultiStage(grid(), horizon, **{"profiles": series, **options})


def same(short: om.Plan, alone: om.Plan, rel: float = 1e-6) -> None:
    """Compare a plan that ends with the data to one of an independent problem of that horizon."""
    assert alone.optimal, alone.termination
    assert short.optimal, short.termination
    assert short.objective == pytest.approx(alone.objective, rel=rel)
    assert short.data.sizes == alone.data.sizes
    assert short.data["time"].equals(alone.data["time"])
    assert set(short.data) == set(alone.data) - {"end_price"}  # of a single stage, the last one is each
    assert short.data["pg"].values == pytest.approx(
        alone.data["pg"].values, abs=5e-3
    )  # costs are strictly convex


PRECISE = {"qp:osqp": {"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iter": 1_000_000}}
BACK_ENDS = [
    ("ac", "ipopt"),
    ("dc", "ipopt"),
    ("dc", "clarabel"),
    ("dc", "qp:osqp"),
    ("soc", "clarabel"),
    ("soc", "ipopt"),
]


# Every end and delay on one back end; every other back end with two ends, every end with two back ends.
SHRUNK = [
    (*back_end, end, delay)
    for i, back_end in enumerate(BACK_ENDS)
    for j, end in enumerate(ENDS)
    for delay in (0, 1)
    if back_end == ("dc", "clarabel") or ((i + j) % 2 == 0 and delay == (i + j) // 2 % 2)
]


@pytest.mark.parametrize(("formulation", "solver", "end", "delay"), SHRUNK)
def test_a_shrunk_plan_is_that_of_a_shorter_problem(
    formulation: str, solver: str, end: str, delay: int
) -> None:
    options: dict[str, Any] = {
        "formulation": formulation,
        "solver": solver,
        "end": om.End(**ENDS[end]),
        "generator_delay": delay,
        "regularisation": 1e-3,
        "options": PRECISE.get(solver),
    }
    shrinks = problem(at_end="shrink", **options)
    previous = None
    for time in range(STEPS - HORIZON, STEPS):
        initial = {"e": [25.0], "pg": [DEMAND[time] - 35, 30.0]}
        if formulation != "dc":
            initial["qg"] = [10.0, 10.0]
        alone = problem(STEPS - time, **options).solve(time, initial)
        previous = shrinks.solve(time, initial, previous)
        assert previous.stages == STEPS - time
        if delay == 1 and time == STEPS - 1 and end in ("cyclic", "minimum"):
            assert alone.infeasible  # the only stage is committed
            assert previous.infeasible
            continue
        same(previous, alone)
        report = check(shrinks.network, previous.data, shrinks.profiles, time)
        assert report.max_violation < 1e-5
    assert shrinks.build_seconds > 0


def test_nothing_changes_for_problems_that_do_not_shrink() -> None:
    for at_end in ("error", "repeat", "shrink"):
        program = problem(at_end=at_end).compile()
        ramps = program.rows["pg_ramp_first"]
        assert ramps.stages == (HORIZON if at_end == "shrink" else 1)
        sizes = {name: block.shape for name, block in program.rows.items() if name != ramps.name}
        assert sizes == {
            name: block.shape for name, block in problem().compile().rows.items() if name != ramps.name
        }
    assert problem(1, at_end="shrink").compile().n_rows == problem(1).compile().n_rows


def test_a_shrunk_elastic_plan_is_that_of_a_shorter_problem() -> None:
    tight = {"town.p": [60.0, 75, 90, 170, 95, 180], "town.q": [20.0, 20, 20, 20, 90, 20]}
    options: dict[str, Any] = {"elastic": om.Elastic(), "profiles": tight, "end": om.End(cyclic=True)}
    shrinks = problem(at_end="shrink", **options)
    for time in range(STEPS - HORIZON, STEPS):
        initial = {"e": [25.0], "pg": [40.0, 30.0], "qg": [10.0, 10.0]}
        short, alone = shrinks.solve(time, initial), problem(STEPS - time, **options).solve(time, initial)
        same(short, alone)
        assert short.penalty == pytest.approx(alone.penalty, rel=1e-5)
        found, expected = ([(str(s), s.worst) for s in plan.shortages] for plan in (short, alone))
        assert [text for text, _ in found] == [text for text, _ in expected]
        assert [most for _, most in found] == pytest.approx([most for _, most in expected], rel=1e-3)
        assert found


CONSTRAINTS: dict[str, Any] = {
    "every stage": {"constraint": lambda s: total(s.generator.pg), "at_least": [50.0, 70, 95, 68, 96, 75]},
    "change": {"constraint": lambda s: s.generator.pg[1:, 1:] - s.generator.pg[1:, :-1] <= 2.0},
    "end": {"constraint": lambda s: s.storage.e_next[:, -1:] >= 23.5},
}


@pytest.mark.parametrize("name", CONSTRAINTS)
@pytest.mark.parametrize("objective", ["economic", "tracking"])
def test_shrunk_plans_obey_custom_constraints_and_objectives(name: str, objective: str) -> None:
    cost = om.Economic()
    if objective == "tracking":
        cost = WeightedSum([(1.0, cost), (5.0, om.StateOfChargeTracking(0.7))])
    shrinks = problem(at_end="shrink", formulation="dc", solver="clarabel", objective=cost)
    shrinks.constrain(name, **CONSTRAINTS[name])
    for time in range(STEPS - HORIZON, STEPS):
        initial = {"e": [25.0], "pg": [DEMAND[time] - 35, 30.0]}
        alone = problem(STEPS - time, formulation="dc", solver="clarabel", objective=cost)
        if name != "change" or time < STEPS - 1:  # a single stage has no change
            alone.constrain(name, **CONSTRAINTS[name])
        same(shrinks.solve(time, initial), alone.solve(time, initial))


@pytest.mark.parametrize(
    ("constraint", "named"),
    [
        (lambda s: s.generator.pg[:, :1] >= 11, "constraint own"),
        (lambda s: s.generator.pg[:, :1] - s.generator.pg[:, -1:] <= 5, "constraint own"),
        (lambda s: s.storage.e_next[:, -1:] - s.storage.e[:, :1] >= 0, "constraint own"),
    ],
)
def test_a_constraint_between_distant_stages_cannot_shrink(constraint: Any, named: str) -> None:
    shrinks = problem(at_end="shrink", formulation="dc")
    shrinks.constrain("own", constraint)
    with pytest.raises(IncompatibleError, match=f"at_end = 'shrink': '{named}' .*every stage"):
        shrinks.compile()


class Smooth(Objective):
    """Price of changes from stage to stage."""

    def stage_cost(self, stage: Any) -> Any:
        """Return the cost."""
        pg = stage.generator.pg
        return total((pg[:, 1:] - pg[:, :-1]) ** 2)


def test_a_cost_between_stages_cannot_shrink() -> None:
    with pytest.raises(IncompatibleError, match=r"at_end = 'shrink': a cost .* several stages"):
        problem(at_end="shrink", formulation="dc", objective=Smooth()).compile()
    assert problem(formulation="dc", objective=Smooth()).solve().optimal


def test_a_shrunk_plan_needs_the_stored_energy() -> None:
    shrinks = problem(at_end="shrink", formulation="dc")
    with pytest.raises(ModelError, match=r"initial e: must be given .*shrink"):
        shrinks.solve(STEPS - 1, {"e": None})
    with pytest.raises(ModelError, match=r"step 6: the data end after 6 steps"):
        shrinks.solve(STEPS)
    with pytest.raises(ModelError, match=r"at_end = 'stop': must be 'error', 'repeat', 'shrink'"):
        problem(at_end="stop")


# Closed loops ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize("plant", [om.NominalPlant, om.PowerFlow, om.Redispatch])
def test_a_run_may_last_as_long_as_the_data(plant: type, delay: int) -> None:
    shrinks = problem(at_end="shrink", generator_delay=delay, end=om.End(price=20.0))
    with pytest.raises(ModelError, match="7 steps need time series of 7 values; the shortest has 6"):
        om.simulate(shrinks, plant(), STEPS + 1)
    run = om.simulate(shrinks, plant(), STEPS)
    assert run.status == "done", run.termination
    assert run.data.sizes["time"] == STEPS
    assert check(shrinks.network, run.data, shrinks.profiles).max_violation < 1e-5
    with pytest.raises(ModelError, match=r"6 steps with a horizon of 4 need time series of 9 values.*at_end"):
        om.simulate(problem(generator_delay=delay), plant(), STEPS)


def test_the_last_plans_are_warm_started() -> None:
    controller = om.Controller(problem(at_end="shrink", formulation="dc", solver="clarabel"))
    run = om.simulate(controller, steps=STEPS)
    assert [plan["attempts"][0]["start"] for plan in run.plans] == ["cold"] + ["warm"] * (STEPS - 1)


@pytest.mark.parametrize(
    "forecast", [None, Perfect(), Persistence(2), Noisy(0.02, seed=3)], ids=lambda f: type(f).__name__
)
@pytest.mark.parametrize("at_end", ["repeat", "shrink"])
def test_forecasts_end_or_repeat_with_the_data(forecast: Any, at_end: str) -> None:
    controlled = problem(at_end=at_end, formulation="dc", solver="clarabel")
    controller = om.Controller(controlled, forecast)
    last = STEPS - 1
    expected = controller.expected(last)
    stages = HORIZON if at_end == "repeat" else 1
    assert controlled.horizon_from(last).steps == stages
    if expected is not None:
        assert expected["load", "p"].shape[1] == stages
        if isinstance(forecast, Perfect):
            assert expected["load", "p"][0] * 100 == pytest.approx((DEMAND * 2)[last : last + stages])
    run = om.simulate(controller, om.PowerFlow(), STEPS)
    assert run.status == "done", run.termination


def test_repeated_data_follow_once_more() -> None:
    repeats = problem(at_end="repeat", formulation="dc", solver="clarabel")
    repeats.constrain("enough", lambda s: total(s.generator.pg), at_least=[50.0, 70, 80, 68, 80, 75])
    twice = problem(
        formulation="dc", solver="clarabel",
        profiles={str(key): np.tile(values, 3) for key, values in repeats.profiles.items()},
    )  # fmt: skip
    twice.constrain("enough", lambda s: total(s.generator.pg), at_least=[50.0, 70, 80, 68, 80, 75] * 3)
    run, expected = om.simulate(repeats, steps=2 * STEPS), om.simulate(twice, steps=2 * STEPS)
    assert run.cost == pytest.approx(expected.cost, rel=1e-7)
    assert run.data["pd"].values == pytest.approx(expected.data["pd"].values)
    assert repeats.horizon_from(100).steps == HORIZON


def test_only_data_of_one_length_repeat() -> None:
    repeats = problem(at_end="repeat", formulation="dc", profiles={"town.p": DEMAND, "town.q": [20.0, 21]})
    with pytest.raises(ModelError, match=r"'town\.p' has 6 values and profile 'town\.q' has 2"):
        om.simulate(repeats, steps=2)
