"""The contract of an objective."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel import plugins
from opfmodel.errors import ModelError, PluginError, QuantityError
from opfmodel.model import NumericStage, Quantities
from opfmodel.network.network import Network
from opfmodel.objectives.base import Objective, WeightedSum
from opfmodel.plan import MultiStage, Plan
from opfmodel.testing.grids import HORIZONS, demand, feeder
from opfmodel.testing.options import check_options
from opfmodel.testing.sampling import at_random
from solvers.testing import Contract

__all__ = ["check_objective"]

Array = npt.NDArray[np.float64]


def check_objective(
    objective: Objective,
    network: Network | None = None,
    profiles: Mapping[str, npt.ArrayLike] | None = None,
) -> None:
    """Raise :class:`ContractError` unless an objective satisfies its contract.

    - Its options are documented plain data.
    - Some formulation publishes all quantities in ``needs``; formulations that lack one reject the
      objective by name. The objective reads other quantities only after ``stage.has``.
    - At random points, the cost is the same when evaluated numerically and in the program.
    - The cost is finite, has one value per stage for one stage and for three, can be weighted and
      added, and is convex in the quantities unless ``convex`` is False.

    Parameters
    ----------
    network, profiles
        A grid with the names in the options of the objective; by default a feeder with all built-in
        devices. The time series cover at least three steps.
    """
    rules = Contract(f"objective {type(objective).__name__}")
    rules.require(isinstance(objective, Objective), "is an Objective")
    for _, part in objective.parts if isinstance(objective, WeightedSum) else [(1.0, objective)]:
        check_options(rules, type(part))
    plain = isinstance(objective.needs, tuple) and all(isinstance(name, str) for name in objective.needs)
    rules.require(plain, "needs is a tuple of names", repr(objective.needs))
    if network is None:
        network, profiles = feeder(), demand() if profiles is None else profiles
    formulation = _check_needs(rules, objective, network)
    rng = np.random.default_rng(1)
    for horizon in HORIZONS:
        problem = MultiStage(
            network,
            horizon,
            formulation=formulation,
            objective=objective,
            profiles=profiles,
            regularisation=0.0,
        )
        with rules.rule("compiles to a problem that can be solved"):
            plan = problem.solve()
        rules.require(plan.optimal, "compiles to a problem that can be solved", plan.termination)
        points = [at_random(plan, rng) for _ in range(4)]
        for point in points:
            _check_values(rules, objective, point, len(horizon))
        for one, other in pairwise(points):
            _check_convex(rules, objective, one.stage, other.stage)


def _check_needs(rules: Contract, objective: Objective, network: Network) -> str:
    """Formulations publish all needs or reject the objective; return one that publishes them."""
    able = []
    for name, plugin in plugins.plugins("formulation").items():
        try:
            formulation = plugin.load()()
        except PluginError:
            continue  # not the fault of this objective
        problem = MultiStage(network, formulation=formulation, objective=objective)
        try:
            published = problem.declare().published
        except ModelError:
            continue  # the formulation does not accept this grid
        missing = [need for need in objective.needs if need not in published]
        if not missing:
            able.append(name)
            continue
        rule = "is rejected by name by a formulation that lacks a quantity in needs"
        try:
            problem.compile()
        except ModelError as error:
            named = type(objective).__name__ in str(error) or missing[0] in str(error)
            rules.require(named, rule, str(error))
        else:
            rules.require(False, rule, f"formulation {name!r} compiles it without {missing[0]}")
    rules.require(able, "needs only quantities that some formulation publishes", ", ".join(objective.needs))
    return "ac" if "ac" in able else able[0]


def _check_values(rules: Contract, objective: Objective, plan: Plan, stages: int) -> None:
    """The numerical cost has one finite value per stage, and equals that of the program."""
    stage, rule = plan.stage, "reads only quantities in needs, or those confirmed by stage.has"
    with rules.rule(rule):
        try:
            least = _Needed(stage, objective.needs)
            objective.stage_cost(least)
            objective.terminal_cost(least)
        except QuantityError as error:
            found = f"{error.kind}.{error.quantity} is not in needs = {objective.needs}"
            rules.require(False, rule, found)
    with rules.rule("its cost can be evaluated numerically"):
        cost = objective.stage_cost(stage)
        value = plan.objective
    if cost is not None:
        shape = np.shape(cost)
        rules.require(
            shape in ((stages,), (1, stages)),
            "its cost has one value per stage, or is None",
            f"shape {shape} for {stages} stages",
        )
        weighted = (0.5 * objective + objective).stage_cost(stage)
        rules.require(np.allclose(weighted, 1.5 * cost, rtol=1e-12), "can be weighted and added")
    compiled = plan.solution.objective
    rules.require(np.isfinite(value), "its cost is finite", str(value))
    same = abs(value - compiled) <= 1e-9 * (1.0 + abs(value))
    rules.require(same, "has the same cost numerically and in the program", f"{value:.12g}, {compiled:.12g}")


def _check_convex(rules: Contract, objective: Objective, one: NumericStage, other: NumericStage) -> None:
    """The cost lies below the chord between two points."""
    if not objective.convex:
        return
    middle = copy(one)
    middle.values = {key: 0.5 * (one.values[key] + other.values[key]) for key in one.values}
    for cost in (objective.stage_cost, objective.terminal_cost):
        ends = [cost(stage) for stage in (one, other)]
        if ends[0] is None:
            continue
        chord = 0.5 * (np.asarray(ends[0]) + np.asarray(ends[1]))
        above = np.asarray(cost(middle)) - chord - 1e-9 * (1.0 + np.abs(chord))
        rules.require(
            (above <= 0).all(),
            "is convex in the quantities, or states convex = False",
            f"{cost.__name__} lies {above.max():.3g} above its chord",
        )


class _Needed:
    """A stage that publishes only what an objective needs."""

    def __init__(self, stage: NumericStage, needs: tuple[str, ...]) -> None:
        self._stage = stage
        self._hidden = {name for _, name in stage.values} - set(needs)

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._stage, name)
        if not isinstance(found, Quantities):
            return found

        def get(quantity: str) -> Any:
            return getattr(found, quantity) if quantity in found and quantity not in self._hidden else None

        return Quantities(name, get, lambda: [q for q in dir(found) if q not in self._hidden])

    def has(self, name: str) -> bool:
        """Return whether a quantity is published."""
        return name not in self._hidden and self._stage.has(name)
