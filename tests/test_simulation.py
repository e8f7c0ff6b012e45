"""The closed loop: the paper's 5-bus system, failures, and the records of a run."""

from __future__ import annotations

import signal
import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from conftest import SCENARIOS, two_bus

import opfmodel as om
from opfmodel.check import check, losses
from opfmodel.errors import ModelError
from opfmodel.simulation import Run
from opfmodel.study.comparison import compare

WAVE = {"town.p": [60, 80, 100, 100, 70, 60, 80, 90], "town.q": [20, 30, 35, 35, 22, 20, 25, 30]}


def problem(horizon: int, series: dict = WAVE) -> om.MultiStage:
    grid = two_bus()
    grid.update("coal", ramp=40)
    return om.MultiStage(grid, horizon, profiles=series)


@pytest.fixture(scope="module")
def step() -> tuple[om.Scenario, Run]:
    scenario = om.load_scenario(SCENARIOS / "case5-step.yaml")
    return scenario, scenario.simulate()


def series(scenario: om.Scenario) -> dict[str, np.ndarray]:
    return scenario.profiles


def test_the_cost_of_the_5_bus_step_system(step: tuple[om.Scenario, Run]) -> None:
    _, run = step
    assert run.status == "done"
    assert len(run.steps) == 49
    assert run.cost == pytest.approx(972.61e3, rel=5e-4)


def test_every_limit_holds_in_every_step(step: tuple[om.Scenario, Run]) -> None:
    scenario, run = step
    report = check(scenario.network, run.data, series(scenario))
    assert report.max_violation <= 1e-6, str(report)
    data = run.data
    assert data["e"].values.min() >= -1e-5
    assert data["e"].values.max() <= 200 + 1e-5
    ramp = np.array([g.ramp for g in scenario.network.of(om.Generator).values()])
    assert (np.abs(np.diff(data["pg"].values, axis=0)) <= ramp + 1e-5).all()


def test_energy_is_conserved_in_every_step(step: tuple[om.Scenario, Run]) -> None:
    scenario, run = step
    d = run.data
    balance = d["pg"].sum("generator") - d["pd"].sum("bus") - d["ps"].sum("storage")
    assert losses(scenario.network, d) == pytest.approx(balance.values, abs=1e-4)


def test_storage_discharges_when_demand_is_high_and_charges_when_it_is_low(step) -> None:
    _, run = step
    power = run.data["ps"].sum("storage").values
    assert (power[8:16] < -1).all()
    assert (power[30:41] > 1).all()


def test_the_loop_is_the_sequence_of_its_plans() -> None:
    made = problem(4)
    run = om.simulate(made, steps=3)
    assert run.data["pd"].sel(bus="south").values == pytest.approx(WAVE["town.p"][:3])
    assert run.data["e"].values[1:] == pytest.approx(run.data["e_next"].values[:-1], abs=1e-9)
    state = None
    for time in range(3):
        plan = made.solve(time, state)
        assert run.data["pg"].values[time] == pytest.approx(plan.data["pg"].values[0], abs=2e-3)
        state = plan.next_state()
    assert run.cost == pytest.approx(float(run.data["cost_rate"].sum()))


def test_one_program_serves_the_whole_run() -> None:
    made = problem(4)
    program = made.compile()
    om.simulate(made, steps=5)
    assert made.compile() is program


def test_a_controller_can_be_run_again() -> None:
    controller = om.Controller(problem(4))
    first, second = (om.simulate(controller, steps=3) for _ in range(2))
    assert second.cost == pytest.approx(first.cost, rel=1e-6)


def test_a_failure_ends_the_run_and_keeps_what_was_done() -> None:
    hopeless = {**WAVE, "town.p": [60, 60, 60, 60, 60, 400, 60, 60]}
    run = om.simulate(problem(3, hopeless), steps=6)
    assert run.status == "locally_infeasible"
    assert run.termination.startswith("step 3: infeasible")
    assert len(run.steps) == 3
    assert run.data.sizes["time"] == 3
    assert run.summary()["steps"] == 3


def test_a_running_loop_shows_what_has_happened_so_far() -> None:
    seen: list[tuple[str, float, int]] = []

    def look(run: Run) -> None:
        seen.append((run.status, run.cost, run.data.sizes["time"]))
        assert run.data["pg"].sizes["time"] == len(run.steps)
        repr(run), run.summary()

    run = om.simulate(problem(4), steps=4, on_step=look)
    assert [size for _, _, size in seen] == [1, 2, 3, 4]
    assert {status for status, _, _ in seen} == {"running"}
    assert [cost for _, cost, _ in seen] == pytest.approx(np.cumsum(run.data["cost_rate"].values))
    assert run.status == "done"
    assert run.cost == pytest.approx(om.simulate(problem(4), steps=4).cost, rel=1e-9)


def test_an_interrupt_keeps_what_was_done(monkeypatch: pytest.MonkeyPatch) -> None:
    def press(run: Run) -> None:
        if len(run.steps) == 2:
            raise KeyboardInterrupt

    run = om.simulate(problem(3), steps=5, on_step=press)
    assert (run.status, run.termination) == ("stopped", "interrupted after 2 steps")
    assert run.data.sizes["time"] == 2


class Lost(ca.SX):
    """A symbol during whose conversion the user presses Ctrl-C, which CasADi swallows."""

    def __DM__(self) -> None:
        signal.raise_signal(signal.SIGINT)


class Refused:
    """Another, which CasADi reports as an argument of a wrong type."""

    def __DM__(self) -> None:
        signal.raise_signal(signal.SIGINT)


@pytest.mark.parametrize("late", [Lost(1), Refused()])
def test_an_interrupt_is_not_lost_while_a_problem_is_compiled(late: object) -> None:
    made = problem(3)

    def rule(stage: om.Stage) -> object:
        ca.jacobian(late, ca.SX.sym("x"))
        return om.total(stage.generator.pg) >= 0

    made.constrain("rule", rule)
    with pytest.raises(KeyboardInterrupt):
        made.solve()
    run = om.simulate(made, steps=2)
    assert (run.status, run.termination) == ("stopped", "interrupted after 0 steps")
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_interrupt_is_not_lost_while_a_plant_responds(monkeypatch: pytest.MonkeyPatch) -> None:
    apply = om.NominalPlant.apply

    def pressed(plant: om.NominalPlant, plan: om.Plan) -> object:
        if plan.time == 1:
            ca.jacobian(Lost(1), ca.SX.sym("x"))
        return apply(plant, plan)

    monkeypatch.setattr(om.NominalPlant, "apply", pressed)
    run = om.simulate(problem(3), steps=5)
    assert (run.status, run.termination) == ("stopped", "interrupted after 1 steps")


def test_an_interrupt_is_not_lost_in_a_destructor(capsys: pytest.CaptureFixture[str]) -> None:
    class Dying:
        def __del__(self) -> None:
            signal.raise_signal(signal.SIGINT)

    made = problem(3)

    def rule(stage: om.Stage) -> object:
        Dying()
        return om.total(stage.generator.pg) >= 0

    made.constrain("rule", rule)
    hook = sys.unraisablehook
    with pytest.raises(KeyboardInterrupt):
        made.solve()
    assert sys.unraisablehook is hook
    assert capsys.readouterr().err == ""


def test_series_that_are_too_short_are_said_before_anything_is_solved() -> None:
    with pytest.raises(
        ModelError, match="7 steps with a horizon of 3 need time series of 9 values; the shortest has 8"
    ):
        om.simulate(problem(3), steps=7)
    with pytest.raises(ModelError, match="steps = 0"):
        om.simulate(om.MultiStage(two_bus()), steps=0)


def test_single_stage_is_without_storage_and_ramps() -> None:
    sequence = om.single_stage_sequence(problem(4), steps=1, start=2)
    assert "ps" not in sequence.data
    assert sequence.data["pd"].sel(bus="south").values == pytest.approx([100])
    assert sequence.data["pg"].values[0, 0] > 100


# Economic and tracking control ----------------------------------------------------------------------


def test_a_cost_that_cannot_be_had_leaves_the_others(tmp_path: Path) -> None:
    path = tmp_path / "short.yaml"
    path.write_text(
        "network:\n  buses: {a: {}}\n  generators: {g: {bus: a, p: [0, 40], cost: {c1: 10}}}\n"
        "  loads: {l: {bus: a, p: 50}}\n  storages: {s: {bus: a, energy: 40, power: 20, q: 20}}\n"
    )
    found = compare(path)
    assert found.costs["J_e"] is not None
    assert found.costs["J_s"] is None
    assert set(found.failures) == {"J_s"}


def test_ctrl_c_ends_a_comparison(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(plant: om.NominalPlant, plan: om.Plan) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(om.NominalPlant, "apply", interrupted)
    with pytest.raises(KeyboardInterrupt):
        compare(SCENARIOS / "case5-step.yaml")


def test_a_controller_checks_its_parts() -> None:
    with pytest.raises(ModelError, match="forecast = 'noisy': must be None or an object of class Forecast"):
        om.Controller(problem(2), forecast="noisy")
    with pytest.raises(ModelError, match="elastic = 5000: must be None or an object of class Elastic"):
        om.Controller(problem(2), elastic=5000)
