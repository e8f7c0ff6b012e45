"""The contract of a plant."""

from __future__ import annotations

from tempfile import TemporaryDirectory

import numpy as np

from opfmodel.check import check
from opfmodel.errors import ModelError
from opfmodel.forecasts.noisy import Noisy
from opfmodel.network.arrays import PerUnitNetwork
from opfmodel.network.components import Storage
from opfmodel.network.network import Network
from opfmodel.network.units import UNITS
from opfmodel.plan import MultiStage, Plan
from opfmodel.simulation import Controller, Outage, Plant, Run, Step, simulate
from opfmodel.testing.grids import EDGE_GRIDS, demand, feeder
from opfmodel.testing.options import check_options
from solvers.testing import Contract

__all__ = ["check_plant"]

_VIOLATION = 1e-6  # p.u.
_REPEATED = 1e-6  # relative
_STEPS = 3
# Equations that hold even where limits are exceeded.
_PHYSICS = ("active balance", "reactive balance", "reported flow", "storage dynamics", "energy continuity")


def check_plant(plant: Plant) -> None:
    """Raise :class:`ContractError` unless a plant satisfies its contract.

    - Its options are documented plain data.
    - It responds to plans of any formulation, with either dispatch delay, on grids without storage,
      with islands, and with equipment out of service.
    - Reported quantities are described, free of NaN unless the step is unsolved, and satisfy the
      physical equations.
    - It returns the complete state, does not modify plans, and is reproducible.
    - Unless it needs a perfect forecast, it balances the actual demand under any forecast.
    - If it takes outages, what is out of service produces nothing.
    - A run that is resumed, with what the plant remembers, has the same steps; see :meth:`Plant.memory`.

    Parameters
    ----------
    plant
        A plant with the options to check.
    """
    rules = Contract(f"plant {type(plant).__name__}")
    rules.require(isinstance(plant, Plant), "is a Plant")
    check_options(rules, type(plant))
    for formulation, delay in (("dc", 1), ("ac", 0)):
        _check_loop(rules, plant, feeder(), formulation, delay)
    for what, make in EDGE_GRIDS.items():
        grid = make()
        problem = MultiStage(grid, formulation="dc")
        with rules.rule(f"responds to a plan of a grid with {what}"):
            try:
                plant.check(problem.arrays)
            except ModelError:
                continue  # its options are for another grid
            plan = problem.solve()
            step = plant.apply(plan)
        _check_step(rules, step, problem.arrays, plan)
    _check_resumed(rules, plant)
    if not plant.needs_perfect_forecast:
        _check_surprise(rules, plant)
    if plant.takes_outages:
        _check_outage(rules, plant)


def _check_loop(rules: Contract, plant: Plant, grid: Network, formulation: str, delay: int) -> None:
    """A closed loop is physical, complete and reproducible."""
    series = demand(_STEPS + 1)
    problem = MultiStage(grid, 2, formulation=formulation, generator_delay=delay, profiles=series)
    with rules.rule("responds to every plan"):
        plant.check(problem.arrays)
        first, again = (
            simulate(Controller(problem, on_infeasible="elastic"), plant, _STEPS) for _ in range(2)
        )
    rules.require(len(first.steps) == _STEPS, "responds to every plan", first.termination)
    plan = problem.solve()
    for step in first.steps:
        _check_step(rules, step, problem.arrays, plan)
    before = plan.solution.x.copy()
    plant.apply(plan)
    rules.require(np.array_equal(plan.solution.x, before), "does not modify plans")
    rules.require(_same_steps(first, again), "returns the same values in another run")
    _check_physics(rules, grid, first, series)


def _check_resumed(rules: Contract, plant: Plant) -> None:
    """A run that is resumed from what the plant remembers has the same steps."""
    problem = MultiStage(feeder(), 2, formulation="dc", profiles=demand(_STEPS + 1))
    controller = Controller(problem, on_infeasible="elastic")

    def stop(run: Run) -> None:
        if len(run.steps) == _STEPS - 1:
            raise KeyboardInterrupt

    with rules.rule("resumes a run"), TemporaryDirectory() as folder:
        whole = simulate(controller, plant, _STEPS)
        simulate(controller, plant, _STEPS, on_step=stop, checkpoint=folder)
        resumed = simulate(controller, plant, _STEPS, checkpoint=folder)
    rules.require(_same_steps(whole, resumed), "resumes a run from its memory, with the same values")


def _same_steps(one: Run, other: Run) -> bool:
    return len(one.steps) == len(other.steps) and all(
        mine.values.keys() == theirs.values.keys()
        and all(
            np.allclose(values, theirs.values[key], rtol=_REPEATED, atol=_REPEATED, equal_nan=True)
            for key, values in mine.values.items()
        )
        for mine, theirs in zip(one.steps, other.steps, strict=True)
    )


def _check_step(rules: Contract, step: Step, network: PerUnitNetwork, plan: Plan) -> None:
    """Reported quantities are described, complete and free of NaN."""
    rules.require(isinstance(step, Step), "returns a Step", repr(type(step)))
    for (kind, name), values in step.values.items():
        where = f"{kind}.{name}"
        unit, _ = step.described.get(name, (None, None))
        rules.require(unit in UNITS, "describes reported quantities, with units", where)
        if kind in network.tables:
            right = np.shape(values) == (len(network.tables[kind]),)
            rules.require(right, "reports one value per component", f"{where}: shape {np.shape(values)}")
        known = not step.solved or not np.isnan(values).any()
        rules.require(known, "reports no NaN in solved steps", where)
    wanted = plan.next_state() if plan.problem.generator_delay == 0 or plan.problem.stages > 1 else {}
    for name, values in wanted.items():
        given = step.state.get(name)
        complete = given is not None and np.shape(given) == values.shape and np.isfinite(given).all()
        rules.require(complete, "returns every state of the plan", name)


def _check_physics(rules: Contract, grid: Network, run: Run, series: dict[str, np.ndarray]) -> None:
    """The independent check confirms balances and storage dynamics."""
    if not all(step.solved for step in run.steps):
        return
    with rules.rule("reports results that can be checked"):
        report = check(grid, run.data, series)
    for family in _PHYSICS:
        violation = report.violations.get(family)
        if violation is not None:
            rules.require(
                violation.value <= _VIOLATION, "satisfies the physical equations", f"{family}: {violation}"
            )


def _check_outage(rules: Contract, plant: Plant) -> None:
    """A storage that trips draws nothing, and the equations hold."""
    grid, series = feeder(), demand(_STEPS + 1)
    name = next(iter(grid.of(Storage)))
    problem = MultiStage(grid, 2, formulation="dc", profiles=series, outages=[name])
    with rules.rule("responds to an outage"):
        tripping = plant.with_outages([Outage(name, 1, problem.step)])
        run = simulate(Controller(problem, on_infeasible="elastic"), tripping, _STEPS)
    drawn = np.abs(run.data["ps"].sel(storage=name).values[1])
    rules.require(bool(drawn <= _VIOLATION), "realises outages", f"{name} draws {drawn:g} MW")
    _check_physics(rules, grid, run, series)


def _check_surprise(rules: Contract, plant: Plant) -> None:
    """The actual demand is reported and balanced when the forecast differs."""
    grid, series = feeder(), demand(_STEPS + 1)
    for name in grid.of(Storage):
        grid.remove(name)
    problem = MultiStage(grid, 2, formulation="dc", profiles=series)
    controller = Controller(problem, Noisy(0.05, seed=1), on_infeasible="elastic")
    with rules.rule("responds under an imperfect forecast"):
        run = simulate(controller, plant, _STEPS)
    found = run.data["pd"].sel(bus="street").values
    happened = np.allclose(found, series["town.p"][:_STEPS])
    rules.require(happened, "reports the actual demand", str(found))
    _check_physics(rules, grid, run, series)
