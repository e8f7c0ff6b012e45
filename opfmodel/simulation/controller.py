"""The controller, which plans at every step from a warm or cold start."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property, partial
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from opfmodel.data.series import Profiles
from opfmodel.errors import ModelError, ProfileError, listed, shown
from opfmodel.forecasts.base import Forecast
from opfmodel.forecasts.perfect import Perfect
from opfmodel.forecasts.scenarios import Futures, Scenarios
from opfmodel.model import Elastic
from opfmodel.network.series import check_finite
from opfmodel.plan import Initial, MultiStage, Plan
from opfmodel.plan.attempt import Attempt, attempts
from opfmodel.plan.recall import Memory, plan_memory, problem_memory, recall_problem, recalled_plan
from solvers import SolutionStatus

__all__ = ["Commit", "Controller", "OnInfeasible"]

Array = npt.NDArray[np.float64]
Commit = Literal["declared", "milp"]
OnInfeasible = Literal["stop", "elastic"]


class Controller:
    """A controller that solves the same compiled problem at every step, warm-started from its last plan.

    A failed solve is repeated from other starting points before the failure is accepted: warm,
    cold, other and, if requested, elastic. :attr:`attempts` records them all, and the solves in expanded form
    that the solver made itself.

    Parameters
    ----------
    problem
        The multi-stage problem solved at every step. Its profiles are the realised values.
    forecast
        Forecast of the profiles; their realised values by default.
    on_infeasible
        Response to an infeasible problem: ``stop``, or ``elastic`` to plan with soft limits.
    elastic
        Penalty prices of the soft limits.
    scenarios
        Futures around the forecast; the horizon of the problem is their tree, see :meth:`Scenarios.horizon`.
    commit
        Which units run: ``declared``, or ``milp`` for a first plan by
        :func:`opfmodel.plan.commitment.plan_with_commitment`. Closed loops need declared ones.

    Attributes
    ----------
    attempts
        The solves that the last plan took.
    futures
        The futures of the last plan; None without scenarios.
    """

    def __init__(
        self,
        problem: MultiStage,
        forecast: Forecast | None = None,
        on_infeasible: OnInfeasible = "stop",
        elastic: Elastic | None = None,
        scenarios: Scenarios | None = None,
        commit: Commit = "declared",
    ) -> None:
        if commit not in get_args(Commit):
            raise ModelError(f"commit = {commit!r}: must be 'declared' or 'milp'")
        if on_infeasible not in get_args(OnInfeasible):
            raise ModelError(f"on_infeasible = {on_infeasible!r}: must be 'stop' or 'elastic'")
        if not isinstance(problem, MultiStage):
            raise ModelError(f"problem = {shown(problem)}: must be a MultiStage")
        for name, value, kind in (
            ("forecast", forecast, Forecast),
            ("elastic", elastic, Elastic),
            ("scenarios", scenarios, Scenarios),
        ):
            if not (value is None or isinstance(value, kind)):
                raise ModelError(
                    f"{name} = {shown(value)}: must be None or an object of class {kind.__name__}"
                )
        self.problem = problem
        self.forecast = forecast
        self.on_infeasible = on_infeasible
        self.elastic = Elastic() if elastic is None else elastic
        self.scenarios = scenarios
        self.commit = commit
        self.attempts: list[Attempt] = []
        self.futures: Futures | None = None
        self._last: Plan | None = None
        self._repeated = problem.profiles

    def begin(self) -> None:
        """Start a run and discard the history of the last one."""
        self._last, self.attempts = None, []
        recall_problem(self.problem, {})
        if "_twin" in vars(self):
            recall_problem(self._twin, {})

    def memory(self) -> Memory:
        """Return what later plans depend on besides their arguments, as plain data.

        This is the last plan, from which the next one starts, and what solves leave behind, see
        :mod:`opfmodel.plan.recall`.
        """
        problem, last = self.problem, self._last
        made = {
            "last": None if last is None else plan_memory(problem, last),
            "problem": problem_memory(problem),
        }
        return made | ({"twin": problem_memory(self._twin)} if "_twin" in vars(self) else {})

    def recall(self, memory: Memory) -> None:
        """Put back what :meth:`memory` returned, after :meth:`begin`, in another process for instance."""
        recall_problem(self.problem, memory["problem"])
        if memory.get("twin"):
            recall_problem(self._twin, memory["twin"])
        last = memory["last"]
        self._last = None if last is None else recalled_plan(self.problem, last)

    def plan(self, time: int, state: Initial | None, out: Sequence[str] = ()) -> Plan:
        """Plan from ``state`` at step ``time``; a failure is reported by the plan's status.

        Parameters
        ----------
        out
            Components that are known to be out of service; see :meth:`MultiStage.solve`.
        """
        asked, last = self.request(time), self._last
        if out:
            asked["out"] = out
        if last is not None and last.time > time:  # another run has begun
            last = None
        solve = partial(self.problem.solve, time, state, **asked)
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
            plan = self._attempt("elastic", partial(self._twin.solve, time, state, **asked))
        return plan

    def _attempt(self, start: str, solve: Callable[[], Plan]) -> Plan:
        plan = solve()
        self.attempts += attempts(plan, start)
        return plan

    @cached_property
    def _twin(self) -> MultiStage:
        return self.problem.elastic_twin(self.elastic)

    def request(self, time: int) -> dict[str, Any]:
        """Return the keyword arguments of :meth:`MultiStage.solve` that hold what is expected at a step."""
        expected, horizon = self.expected(time), self.problem.horizon
        if self.futures is None or not horizon.varying:
            return {"expected": expected}
        shares = self.futures.probability.tolist()
        return {"expected": expected, "horizon": horizon.with_probabilities(shares)}

    def expected(self, time: int) -> dict[tuple[str, str], Array] | None:
        """Return the forecast of the stages ahead, in per unit; None for the realised values.

        Raises
        ------
        ProfileError, ModelError
            There is no forecast, it is not finite, or it does not cover the series.
        """
        if self.forecast is None and self.scenarios is None:
            return None
        problem, forecast = self.problem, self.forecast or Perfect()
        horizon = problem.horizon_from(time)
        actual = self._actual(time + horizon.steps)
        expected = Profiles.of(forecast.expected(actual, time, horizon.steps))
        where = f"forecast {type(forecast).__name__} at step {time}"
        self._check_expected(expected, where)
        futures = [expected]
        if self.scenarios is not None:
            self.futures = self.scenarios.futures(
                expected,
                time,
                horizon,
                actual=actual,
                forecast=forecast,
                network=problem.network,
            )
            futures = list(self.futures.series)
            for name, future in zip(horizon.scenarios, futures, strict=True):
                self._check_expected(future, f"{where}, scenario {name!r}")
        ahead = problem.expected(futures, horizon, time)
        if ("generator", "p_max") in ahead:  # never below minimum output
            least = ahead.get(("generator", "p_min"), problem.arrays.generator.p_min)
            ahead["generator", "p_max"] = np.maximum(ahead["generator", "p_max"], least)
        return ahead

    def _check_expected(self, expected: Profiles, where: str) -> None:
        """Raise an error unless expected series cover those of the problem with finite values."""
        problem = self.problem
        differing = sorted(map(str, expected.keys() ^ problem.profiles.keys()))
        if differing:
            raise ModelError(
                f"{where}: must cover the series of the profiles and no others; differs in "
                f"{listed(differing)}"
            )
        try:
            check_finite(expected, problem.network)
        except ProfileError as error:
            raise ModelError(f"{where}: {error}") from error

    def _actual(self, steps: int) -> Profiles:
        """Return the realised series; with at least ``steps`` values if they repeat."""
        if self.problem.at_end == "repeat" and (self._repeated.length or steps) < steps:
            self._repeated = self.problem.profiles.repeated(steps)
        return self._repeated
