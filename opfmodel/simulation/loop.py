"""The closed loop: a controller plans, a plant responds, time advances."""

from __future__ import annotations

import logging
import time as clock
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from opfmodel.errors import HorizonError, IncompatibleError, ModelError
from opfmodel.forecasts.base import Forecast
from opfmodel.network.bounds import integer
from opfmodel.objectives.base import Objective
from opfmodel.plan import Initial, MultiStage, Plan
from opfmodel.plan.memory import check_memory, run_bytes
from opfmodel.simulation.checkpoint import Checkpoint, Keeper
from opfmodel.simulation.controller import Controller, OnInfeasible
from opfmodel.simulation.inputs import inputs
from opfmodel.simulation.outages import Outages
from opfmodel.simulation.plants.base import Plant, Step
from opfmodel.simulation.plants.nominal import NominalPlant
from opfmodel.simulation.run import Run
from solvers.interrupt import interruptible

__all__ = ["check_commitment", "check_first_stage", "check_response", "simulate"]

_log = logging.getLogger(__name__)


def simulate(
    controller: Controller | MultiStage,
    plant: Plant | None = None,
    steps: int = 1,
    *,
    initial: Initial | None = None,
    objective: Objective | None = None,
    on_infeasible: OnInfeasible | None = None,
    progress: bool = False,
    on_step: Callable[[Run], None] | None = None,
    checkpoint: str | Path | Checkpoint | None = None,
) -> Run:
    """Run the closed loop: plan, apply the first stage, advance by one step.

    Parameters
    ----------
    controller
        A controller, or a problem for which one is created.
    plant
        The plant that responds to the plans; the nominal plant by default.
    steps
        Number of steps.
    initial
        State at the first step, in physical units; see :meth:`MultiStage.solve`.
    objective
        Objective that measures the realised cost; the controller's own by default.
    on_infeasible
        ``stop``, the default, or ``elastic``; only if ``controller`` is a problem.
    progress
        Whether to show a progress bar on standard error.
    on_step
        Function called with the run after every step.
    checkpoint
        Folder, or a :class:`Checkpoint` that also states how often, in which the loop keeps what it needs
        to resume. If the folder holds a checkpoint of the same inputs, the loop continues after its last
        step as if it had never ended, with the same trajectories; a loop that was complete is returned
        without a solve. One is written before the first step, after some of the others, and when the loop
        ends, however it does.

    Returns
    -------
    Run
        Also if a plan fails or the user presses Ctrl-C, with the steps completed so far.

    Raises
    ------
    ModelError
        The time series are too short, or the forecast is imperfect and the plant nominal.
    SizeError
        The results of the steps need more memory than the machine has.
    ResultError
        The checkpoint is of other inputs, which the message names, damaged, or cannot be written before the
        first step. If it cannot be written later, a :class:`ResultWarning` tells, and the loop goes on.
    """
    if isinstance(controller, MultiStage):
        controller = Controller(controller, on_infeasible=on_infeasible or "stop")
    elif on_infeasible is not None:
        raise ModelError(f"on_infeasible = {on_infeasible!r}: belongs to the controller; set it there")
    check_commitment(controller)
    steps = integer("steps", steps, at_least=1)
    plant = NominalPlant() if plant is None else plant
    if not isinstance(plant, Plant):
        raise ModelError(f"plant = {plant!r}: must be a plant, such as PowerFlow()")
    check_response(controller.forecast, plant)
    problem = controller.problem
    check_first_stage(problem)
    check_memory(f"steps = {steps:,}", run_bytes(problem.arrays.n_components, steps))
    metered = problem.objective if objective is None else objective
    problem.check_lengths(steps, metered)
    outages = plant.outages.of(problem)
    keeper = _keeper(checkpoint, controller, plant, steps, initial, metered)
    if keeper is not None:
        initial = keeper.initial
    run = Run(problem, metered, initial=initial, outages=outages)
    with _progress(steps) if progress else nullcontext(lambda _: None) as advance:
        try:
            with interruptible():  # what is lost between the blocks of a step is raised in the next one
                controller.begin()
                plant.begin(problem, initial)
                problem.compile()
                run.build_seconds = problem.build_seconds
                _loop(run, controller, plant, steps, keeper, advance, on_step)
        except KeyboardInterrupt:
            run.interrupted = True
            run.status, run.termination = "stopped", f"interrupted after {len(run.steps)} steps"
        finally:
            if keeper is not None:
                keeper.end(run)
    return run


def _loop(
    run: Run,
    controller: Controller,
    plant: Plant,
    steps: int,
    keeper: Keeper | None,
    advance: Callable[[int], None],
    on_step: Callable[[Run], None] | None,
) -> None:
    """Run the steps of a loop that a checkpoint does not hold."""
    problem, outages = run.problem, run.outages
    begin, state = (0, run.initial) if keeper is None else keeper.begin(run, controller, plant)
    advance(begin)
    for time in range(begin, steps):
        began = clock.perf_counter()
        with interruptible():
            plan = controller.plan(time, state, outages.told(time, problem.step))
        run.plans.append(_record(plan, controller, clock.perf_counter() - began))
        if not plan.optimal:
            run.status, run.infeasible = plan.status, plan.infeasible
            run.termination = f"{problem.step_name(time)}: {plan.termination}"
            break
        with interruptible():
            step = plant.apply(plan)
        run.steps.append(_recorded(step, outages, problem, time))
        state = outages.resumed(problem, time, step.state)
        if keeper is not None:
            keeper.step(run, state, controller, plant)
        _log.info("step %d of %d: plan %s, plant %s", time + 1, steps, run.plans[-1]["status"], step.status)
        advance(1)
        if on_step is not None:
            on_step(run)
    else:
        run.finish()


def _keeper(
    checkpoint: str | Path | Checkpoint | None,
    controller: Controller,
    plant: Plant,
    steps: int,
    initial: Initial | None,
    metered: Objective,
) -> Keeper | None:
    """Return what writes the checkpoints of a run; None if there are none."""
    if checkpoint is None:
        return None
    given = checkpoint if isinstance(checkpoint, Checkpoint) else Checkpoint(checkpoint)
    return Keeper(given, inputs(controller, plant, steps, metered), initial)


def _recorded(step: Step, outages: Outages, problem: MultiStage, time: int) -> Step:
    """Return a step with what was out of service."""
    if not outages.events:
        return step
    return replace(
        step,
        values={**step.values, **outages.record(problem, time)},
        described={**step.described, **outages.described},
    )


def check_commitment(controller: Controller) -> None:
    """Raise :class:`IncompatibleError` if the controller commits units, which closed loops do not hand on."""
    if controller.commit != "declared":
        raise IncompatibleError(
            f"commit = {controller.commit!r}: must be 'declared' in a closed loop; commit the units before "
            "it by opfmodel.commit and state the series that it returns",
            "commit",
        )


def check_first_stage(problem: MultiStage) -> None:
    """Raise :class:`ModelError` unless the first stage of a plan can be applied for one step."""
    horizon = problem.horizon
    if len(horizon.roots) > 1:
        raise HorizonError(
            "common = 0: must be at least 1 in a closed loop, which applies the first stage: all futures "
            "share it",
            "scenarios", "common",
        )  # fmt: skip
    if horizon.lengths[0] != 1:
        raise HorizonError(
            f"hours: {horizon.hours[0]:g}: the first stage of a closed loop must be one step of "
            f"{horizon.base:g} h long",
            "horizon", "hours", 0,
        )  # fmt: skip


def check_response(forecast: Forecast | None, plant: Plant) -> None:
    """Raise :class:`IncompatibleError` if the plant needs a perfect forecast and has an imperfect one."""
    if plant.needs_perfect_forecast and not (forecast is None or forecast.perfect):
        raise IncompatibleError(
            f"forecast {type(forecast).__name__} with {type(plant).__name__}: the balance would not hold; "
            "an imperfect forecast needs a plant that responds: power-flow or redispatch"
        )


def _record(plan: Plan, controller: Controller, seconds: float) -> dict[str, Any]:
    attempts = controller.attempts
    elastic = plan.optimal and (
        plan.problem.elastic is not controller.problem.elastic or bool(plan.shortages)
    )
    counted = [attempt.iterations for attempt in attempts if attempt.iterations is not None]
    return {
        "status": "elastic" if elastic else plan.status,
        "diagnosis": [str(shortage) for shortage in plan.shortages] if elastic else [],
        "termination": plan.termination,
        "solve_seconds": sum(attempt.seconds for attempt in attempts),
        "step_seconds": seconds,
        "iterations": sum(counted) if counted else None,
        "attempts": [asdict(attempt) for attempt in attempts],
        "plan_objective": plan.objective,
        "scenarios": _scenarios(controller),
        "screening": [each.as_dict() for each in plan.rounds],
    }


def _scenarios(controller: Controller) -> dict[str, dict[str, Any]]:
    """Probability of each scenario of the last plan, and the number of paths for which it stands."""
    futures = controller.futures
    if futures is None:
        return {}
    names = controller.problem.horizon.scenarios
    return {
        name: {"probability": float(share), "stands_for": int(many)}
        for name, share, many in zip(names, futures.probability, futures.stands_for, strict=True)
    }


@contextmanager
def _progress(steps: int) -> Iterator[Callable[[int], None]]:
    """Show a progress bar on standard error, while there is one; yield a function that advances it."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("closed loop"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    bar = Progress(*columns, console=Console(stderr=True), transient=True)
    task = bar.add_task("", total=steps)

    def advance(done: int) -> None:
        with suppress(OSError):  # a terminal may be lost before its signal arrives
            bar.advance(task, done)

    with suppress(OSError):
        bar.start()
    try:
        yield advance
    finally:
        with suppress(OSError):
            bar.stop()
