"""The contract of a plant."""

from __future__ import annotations

import numpy as np

from opfmodel.check import check
from opfmodel.errors import ModelError
from opfmodel.forecasts.noisy import Noisy
from opfmodel.network.arrays import PerUnitNetwork
from opfmodel.network.components import Storage
from opfmodel.network.network import Network
from opfmodel.network.units import UNITS
from opfmodel.plan import MultiStage, Plan
from opfmodel.simulation import Controller, Plant, Run, Step, simulate
from opfmodel.testing.grids import EDGE_GRIDS, demand, feeder
from opfmodel.testing.options import check_options
from solvers.testing import Contract

__all__ = ["check_plant"]

_VIOLATION = 1e-6  # p.u.
_REPEATED = 1e-6  # relative
_STEPS = 3
# What has to hold whatever the limits of the grid are.
_PHYSICS = ("active balance", "reactive balance", "reported flow", "storage dynamics", "energy continuity")


def check_plant(plant: Plant) -> None:
    """Raise :class:`ContractError` unless a plant keeps its contract.

    Its options are documented and plain data; it responds to plans of any formulation, with either timing
    of the dispatch, on grids without storage, with islands, and with parts out of service; what it says
    happened is described, finite unless it found no state, and obeys the physics that it names; the state
    that it hands on is complete; it leaves plans as they are and repeats itself; and unless it needs a
    perfect forecast it balances the demand that happens, whatever was expected.

    Parameters
    ----------
    plant
        An object with the options that are to be checked.
    """
    rules = Contract(f"plant {type(plant).__name__}")
    rules.require(isinstance(plant, Plant), "is a Plant")
    check_options(rules, type(plant))
    for formulation in ("dc", "ac"):
        for delay in (0, 1):
            _check_loop(rules, plant, feeder(), formulation, delay)
    for what, make in EDGE_GRIDS.items():
        grid = make()
        problem = MultiStage(grid, formulation="dc")
        with rules.rule(f"copes with {what}"):
            try:
                plant.check(problem.arrays)
            except ModelError:
                continue  # its options are for another grid
            step = plant.apply(problem.solve())
        _check_step(rules, step, problem.arrays, problem.solve())
    if not plant.needs_perfect_forecast:
        _check_surprise(rules, plant)


def _check_loop(rules: Contract, plant: Plant, grid: Network, formulation: str, delay: int) -> None:
    """A closed loop is physical, complete, and the same when it is run again."""
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
    rules.require(np.array_equal(plan.solution.x, before), "leaves plans as they are")
    for one, other in zip(first.steps, again.steps, strict=True):
        same = one.values.keys() == other.values.keys() and all(
            np.allclose(values, other.values[key], rtol=_REPEATED, atol=_REPEATED, equal_nan=True)
            for key, values in one.values.items()
        )
        rules.require(same, "repeats itself in another run")
    _check_physics(rules, grid, first, series)


def _check_step(rules: Contract, step: Step, network: PerUnitNetwork, plan: Plan) -> None:
    """What is said to have happened is labelled, complete and finite."""
    rules.require(isinstance(step, Step), "returns a Step", repr(type(step)))
    for (kind, name), values in step.values.items():
        where = f"{kind}.{name}"
        unit, _ = step.described.get(name, (None, None))
        rules.require(unit in UNITS, "describes what it reports, with its unit", where)
        if kind in network.tables:
            right = np.shape(values) == (len(network.tables[kind]),)
            rules.require(right, "reports one value per component", f"{where}: shape {np.shape(values)}")
        known = not step.solved or not np.isnan(values).any()
        rules.require(known, "reports numbers wherever it found a state", where)
    wanted = plan.next_state() if plan.problem.generator_delay == 0 or plan.problem.horizon > 1 else {}
    for name, values in wanted.items():
        given = step.state.get(name)
        complete = given is not None and np.shape(given) == values.shape and np.isfinite(given).all()
        rules.require(complete, "hands on every state of the plan", name)


def _check_physics(rules: Contract, grid: Network, run: Run, series: dict[str, np.ndarray]) -> None:
    """The independent check finds the balances and the dynamics in order."""
    if not all(step.solved for step in run.steps):
        return
    with rules.rule("reports what happened so that it can be checked"):
        report = check(grid, run.data, series)
    for family in _PHYSICS:
        violation = report.violations.get(family)
        if violation is not None:
            rules.require(violation.value <= _VIOLATION, "obeys the physics", f"{family}: {violation}")


def _check_surprise(rules: Contract, plant: Plant) -> None:
    """The demand that happens is served and balanced where another one was expected."""
    grid, series = feeder(), demand(_STEPS + 1)
    for name in grid.of(Storage):
        grid.remove(name)
    problem = MultiStage(grid, 2, formulation="dc", profiles=series)
    controller = Controller(problem, Noisy(0.05, seed=1), on_infeasible="elastic")
    with rules.rule("responds to what was not expected"):
        run = simulate(controller, plant, _STEPS)
    found = run.data["pd"].sel(bus="street").values
    happened = np.allclose(found, series["town.p"][:_STEPS])
    rules.require(happened, "reports the demand that happens", str(found))
    _check_physics(rules, grid, run, series)
