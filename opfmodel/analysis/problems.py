"""The problems of the theory: without futures, contingencies and soft limits, with constant data or not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.data.series import Profiles
from opfmodel.errors import IncompatibleError
from opfmodel.horizon import Horizon
from opfmodel.model import CustomConstraint, Stage
from opfmodel.network.arrays import PerUnitNetwork
from opfmodel.objectives.base import Objective
from opfmodel.plan import End, MultiStage
from solvers import UnsupportedProgramError

__all__ = ["AtStep", "constant_problem", "convex_problem", "nominal_problem"]

Array = npt.NDArray[np.float64]


class AtStep(Objective):
    """An objective with the data that it has at one step.

    Parameters
    ----------
    step
        The step; None keeps the data of every step.
    terminal
        Whether its terminal cost counts.
    """

    def __init__(self, objective: Objective, step: int | None, terminal: bool = True) -> None:
        self.objective, self.step, self.terminal = objective, step, terminal
        self.needs, self.convex = objective.needs, objective.convex
        self.regularisation = objective.regularisation

    def series(self, network: PerUnitNetwork) -> Mapping[tuple[str, str], Array]:
        """Return the values of that step."""
        series = self.objective.series(network)
        if self.step is None:
            return series
        return {key: values[:, [min(self.step, values.shape[1] - 1)]] for key, values in series.items()}

    def stage_cost(self, stage: Stage) -> Any:
        """Return the cost of the objective."""
        return self.objective.stage_cost(stage)

    def terminal_cost(self, stage: Stage) -> Any:
        """Return the terminal cost of the objective, if it counts."""
        return self.objective.terminal_cost(stage) if self.terminal else None


def constant_problem(
    problem: MultiStage, step: int, stages: int = 1, hours: float | None = None
) -> MultiStage:
    """Return a problem with the data of one step for ever, without futures, contingencies and soft limits.

    Parameters
    ----------
    step
        The step whose demand, limits and costs hold in every stage.
    stages, hours
        Number of stages and their length; by default that of the problem.
    """
    made = problem.variant(
        elastic=None,
        objective=AtStep(problem.objective, step),
        horizon=Horizon.chain(stages, problem.step if hours is None else hours),
    )
    now = problem.profiles.steps(slice(step, step + 1)) if problem.profiles.length else problem.profiles
    made.profiles = Profiles(dict(now.items()))
    made.security, made.risk, made.outages = None, None, ()
    made.at_end = "repeat"
    made.constraints = {name: _at(constraint, step) for name, constraint in problem.constraints.items()}
    return made


def nominal_problem(problem: MultiStage, stages: int, objective: Objective | None = None) -> MultiStage:
    """Return a problem of equal stages with its own data, without futures, contingencies and soft limits.

    Parameters
    ----------
    objective
        The objective in place of that of the problem, whose terminal cost does not count.
    """
    made = problem.variant(
        elastic=None,
        objective=AtStep(problem.objective, None, terminal=False) if objective is None else objective,
        horizon=Horizon.chain(stages, problem.step),
    )
    made.security, made.risk, made.outages, made.end = None, None, (), End()
    return made


def convex_problem(problem: MultiStage, options: Mapping[str, Any] | None = None) -> MultiStage:
    """Return the relaxation of a problem, or the problem itself if no formulation relaxes its own.

    Parameters
    ----------
    options
        Options of Clarabel, which proves optimality and infeasibility.

    Raises
    ------
    IncompatibleError
        The relaxation lacks a quantity that the objective or a constraint uses, or is not convex.
    """
    if problem.formulation.relaxed_by is not None:
        made = problem.relaxed_problem
    else:
        made = problem.variant(elastic=None)
        made.solver, made.options = "clarabel", {}
    if options:
        made.options = {**made.options, **options}
    try:
        made.compile()
    except UnsupportedProgramError as error:
        raise IncompatibleError(f"relaxation {made.formulation.name!r}: not convex: {error}") from error
    return made


def _at(constraint: CustomConstraint, step: int) -> CustomConstraint:
    """Return a constraint with the limits of one step."""
    low, high = constraint.window(step, 1)
    return replace(constraint, at_least=low[0], at_most=high[0])
