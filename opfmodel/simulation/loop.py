"""The closed loop: a controller that plans, a plant that answers, and what happened."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from opfmodel.elastic import Elastic
from opfmodel.errors import IncompatibleError, ModelError
from opfmodel.forecasts.base import Forecast
from opfmodel.forecasts.perfect import Perfect
from opfmodel.model import NumericStage
from opfmodel.objectives.base import Objective
from opfmodel.plan import Initial, MultiStage, Plan
from opfmodel.results import dataset
from opfmodel.simulation.plants import NominalPlant, Plant, Step
from opfmodel.simulation.records import summarise
from solvers import SolutionStatus

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Attempt", "Controller", "OnInfeasible", "Run", "check_answer", "simulate"]

Array = npt.NDArray[np.float64]
OnInfeasible = Literal["stop", "elastic"]


@dataclass(frozen=True)
class Attempt:
    """One solve on the way to a plan.

    Attributes
    ----------
    start
        ``warm`` (the last plan moved ahead, with its multipliers), ``cold``, ``other`` (the last plan
        moved ahead, without multipliers) or ``elastic`` (the twin whose limits give way).
    """

    start: str
    status: str
    termination: str
    iterations: int | None
    seconds: float


class Controller:
    """Plans at every step with the same compiled problem, starting from its last plan.

    A solve that fails is repeated from other starting points before the failure is accepted: warm,
    cold, other, and, if asked for, elastic; :attr:`attempts` has them all.

    Parameters
    ----------
    problem
        The multi-stage problem that is solved at every step. Its profiles are what happens.
    forecast
        What is expected of the profiles instead; what happens by default.
    on_infeasible
        What to do when a problem has no solution: ``stop``, or ``elastic``: plan with limits that give
        way at a price.
    elastic
        Those prices.

    Attributes
    ----------
    attempts
        The solves that the last plan took.
    """

    def __init__(
        self,
        problem: MultiStage,
        forecast: Forecast | None = None,
        on_infeasible: OnInfeasible = "stop",
        elastic: Elastic | None = None,
    ) -> None:
        if on_infeasible not in get_args(OnInfeasible):
            raise ModelError(f"on_infeasible = {on_infeasible!r}: must be 'stop' or 'elastic'")
        self.problem = problem
        self.forecast = forecast
        self.on_infeasible = on_infeasible
        self.elastic = Elastic() if elastic is None else elastic
        self.attempts: list[Attempt] = []
        self._last: Plan | None = None

    def plan(self, time: int, state: Initial | None) -> Plan:
        """Plan from ``state`` at step ``time``; a plan that failed says so by its status."""
        expected, last = self._expected(time), self._last
        if last is not None and last.time > time:  # another run has begun
            last = None
        solve = partial(self.problem.solve, time, state, expected=expected)
        ladder: dict[str, Callable[[], Plan]] = {"cold": solve}
        if last is not None:
            ladder = {
                "warm": partial(solve, last),
                "cold": solve,
                "other": partial(solve, last, multipliers=False),
            }
        self.attempts = []
        for start, attempt in ladder.items():
            plan = self._attempt(start, attempt)
            if plan.optimal or plan.solution.status is SolutionStatus.PROVEN_INFEASIBLE:
                break
        self._last = plan if plan.optimal else None
        if not plan.optimal and self.on_infeasible == "elastic":
            plan = self._attempt("elastic", partial(self._twin.solve, time, state, expected=expected))
        return plan

    def _attempt(self, start: str, solve: Callable[[], Plan]) -> Plan:
        plan = solve()
        solution = plan.solution
        self.attempts.append(
            Attempt(start, plan.status, plan.termination, solution.iterations, solution.seconds)
        )
        return plan

    @cached_property
    def _twin(self) -> MultiStage:
        return self.problem.elastic_twin(self.elastic)

    def _expected(self, time: int) -> dict[tuple[str, str], Array] | None:
        """What is expected of the stages ahead, in per unit; None for what happens."""
        if self.forecast is None:
            return None
        problem = self.problem
        expected = self.forecast.expected(problem.profiles, time, problem.horizon)
        window = expected.window(problem.arrays, 0, problem.horizon)
        if ("generator", "p_max") in window:  # a unit that runs can at least do that
            least = window.get(("generator", "p_min"), problem.arrays.generator.p_min[:, None])
            window["generator", "p_max"] = np.maximum(window["generator", "p_max"], least)
        return window


@dataclass
class Run:
    """A closed loop, finished or not.

    Attributes
    ----------
    status
        ``done``; or the status of the plan that failed, or ``stopped``; finished steps are kept.
    termination
        Why it ended.
    interrupted
        Whether that was Ctrl-C.
    """

    problem: MultiStage
    objective: Objective
    plans: list[dict[str, Any]] = field(default_factory=list)
    steps: list[Step] = field(default_factory=list)
    status: str = "done"
    termination: str = "all steps done"
    interrupted: bool = False
    build_seconds: float = 0.0

    def __repr__(self) -> str:
        return (
            f"Run({self.problem.network.name!r}: {len(self.steps)} steps, {self.status}, {self.cost:.6g} $)"
        )

    @cached_property
    def _stage(self) -> NumericStage:
        """The realised quantities as numbers in per unit."""
        network = self.problem.window(0, len(self.steps))
        # what limits are exceeded by is there only in the steps of an elastic plan
        absent = {key: np.zeros_like(value) for step in self.steps for key, value in step.values.items()}
        values = {
            key: np.column_stack([step.values.get(key, zero) for step in self.steps])
            for key, zero in absent.items()
        }
        return NumericStage(network, self.problem.step, values, self.problem.devices)

    @property
    def cost_rate(self) -> Array:
        """Stage cost of the realised trajectory, $/h."""
        if not self.steps:
            return np.zeros(0)
        cost = self.objective.stage_cost(self._stage)
        return np.zeros(len(self.steps)) if cost is None else np.asarray(cost, dtype=float)

    @property
    def cost(self) -> float:
        """Realised cost over all steps, $."""
        return float(self.cost_rate.sum()) * self.problem.step

    @cached_property
    def data(self) -> xr.Dataset:
        """Realised trajectories in physical units and the effort of each step."""
        stage = self._stage
        described = {name: text for step in self.steps for name, text in step.described.items()}
        quantities = {name: (kind, *described[name], stage.values[kind, name]) for kind, name in stage.values}
        made = dataset(stage.network, quantities, np.arange(len(self.steps), dtype=float) * self.problem.step)
        made["cost_rate"] = ("time", self.cost_rate, {"units": "$/h", "long_name": "stage cost"})
        for key, unit in (("solve_seconds", "s"), ("iterations", ""), ("plan_objective", "$")):
            values = np.array([plan[key] for plan in self.plans[: len(self.steps)]], dtype=float)
            made[key] = ("time", values, {"units": unit, "long_name": key.replace("_", " ")})
        for key, words in (
            ("plan_status", [plan["status"] for plan in self.plans[: len(self.steps)]]),
            ("plant_status", [step.status for step in self.steps]),
        ):
            made[key] = ("time", np.array(words, dtype=str), {"long_name": key.replace("_", " ")})
        controller = self.problem.formulation.name
        made.attrs |= {
            "network": self.problem.network.name,
            "formulation": self.steps[-1].formulation if self.steps else controller,
            "controller_formulation": controller,
            "objective": type(self.problem.objective).__name__,
            "status": self.status,
            "termination": self.termination,
            "step_hours": self.problem.step,
            "cost": self.cost,
        }
        return made

    def summary(self) -> dict[str, Any]:
        """The run in a few numbers; None for a cost without steps and for iterations nobody counted."""
        seconds = [plan["solve_seconds"] for plan in self.plans]
        iterations = [plan["iterations"] for plan in self.plans if plan["iterations"] is not None]
        return {
            "status": self.status,
            "termination": self.termination,
            "cost": self.cost if self.steps else None,
            "steps": len(self.steps),
            "build_seconds": self.build_seconds,
            "solve_seconds_mean": float(np.mean(seconds)) if seconds else 0.0,
            "solve_seconds_max": float(np.max(seconds)) if seconds else 0.0,
            "iterations_mean": float(np.mean(iterations)) if iterations else None,
            "retries": {
                str(step): [f"{a['start']}: {a['status']}" for a in plan["attempts"]]
                for step, plan in enumerate(self.plans)
                if len(plan["attempts"]) > 1
            },
            "elastic_steps": sum(plan["status"] == "elastic" for plan in self.plans),
            "diagnosis": {
                str(step): plan["diagnosis"] for step, plan in enumerate(self.plans) if plan["diagnosis"]
            },
            **summarise(self.problem, self.steps),
        }


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
) -> Run:
    """Run the closed loop: plan, apply the first stage, move on.

    Parameters
    ----------
    controller
        A controller, or the problem it is to solve.
    plant
        What answers the plans; the nominal plant by default.
    steps
        Number of steps.
    initial
        State at the first step, in physical units; see :meth:`MultiStage.solve`.
    objective
        What the realised cost is metered with; the controller's own objective by default.
    on_infeasible
        ``stop``, the default, or ``elastic``, where a problem is given in place of a controller.
    progress
        Whether to show a progress bar on standard error.
    on_step
        Called after every step with the run so far.

    Returns
    -------
    Run
        Also if a plan failed or the user pressed Ctrl-C: then with the steps done so far.

    Raises
    ------
    ModelError
        The time series are too short, or the forecast is imperfect and the plant nominal.
    """
    if isinstance(controller, MultiStage):
        controller = Controller(controller, on_infeasible=on_infeasible or "stop")
    elif on_infeasible is not None:
        raise ModelError(f"on_infeasible = {on_infeasible!r}: a controller has its own; state it there")
    if isinstance(steps, bool) or not isinstance(steps, int) or steps < 1:
        raise ModelError(f"steps = {steps!r}: must be a whole number, at least 1")
    plant = NominalPlant() if plant is None else plant
    check_answer(controller.forecast, plant)
    problem = controller.problem
    needed, length = steps + problem.horizon - 1, problem.profiles.length
    if length is not None and length < needed:
        raise ModelError(
            f"{steps} steps with a horizon of {problem.horizon} need time series of {needed} values; "
            f"the shortest has {length}; give longer series, or less horizon or steps"
        )
    run = Run(problem, problem.objective if objective is None else objective)
    state = initial
    with _progress(steps) if progress else nullcontext(lambda: None) as advance:
        try:
            problem.compile()
            run.build_seconds = problem.build_seconds
            for time in range(steps):
                began = clock.perf_counter()
                plan = controller.plan(time, state)
                run.plans.append(_record(plan, controller.attempts, clock.perf_counter() - began))
                if not plan.optimal:
                    run.status = plan.status
                    run.termination = f"step {time}: {plan.termination}"
                    break
                step = plant.apply(plan)
                run.steps.append(step)
                state = step.state
                advance()
                if on_step is not None:
                    on_step(run)
        except KeyboardInterrupt:
            run.interrupted = True
            run.status, run.termination = "stopped", f"interrupted after {len(run.steps)} steps"
    return run


def check_answer(forecast: Forecast | None, plant: Plant) -> None:
    """Raise :class:`IncompatibleError` if plans for demand that does not come would count as what happens."""
    if isinstance(plant, NominalPlant) and not (forecast is None or isinstance(forecast, Perfect)):
        raise IncompatibleError(
            f"forecast {type(forecast).__name__} with the nominal plant: the balance would not hold; "
            "an imperfect forecast needs a plant that answers: power-flow or redispatch"
        )


def _record(plan: Plan, attempts: list[Attempt], seconds: float) -> dict[str, Any]:
    elastic = plan.problem.elastic is not None and plan.optimal
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
    }


class _progress:  # noqa: N801 - used like a function
    """A progress bar; entering gives a function that advances it."""

    def __init__(self, steps: int) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        columns = (TextColumn("closed loop"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        self._bar = Progress(*columns, console=Console(stderr=True), transient=True)
        self._steps = steps

    def __enter__(self) -> Callable[[], None]:
        self._bar.start()
        task = self._bar.add_task("", total=self._steps)
        return lambda: self._bar.advance(task)

    def __exit__(self, *_: object) -> None:
        self._bar.stop()
