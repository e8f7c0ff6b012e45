"""Recursive feasibility: the states that the next step can reach, and by how much demand may change."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.analysis.finding import Finding, Verdict
from opfmodel.analysis.growth import DIRECTIONS, GrowingDemand, LargestGrowth
from opfmodel.analysis.problems import convex_problem, nominal_problem
from opfmodel.analysis.progress import Advance, silent
from opfmodel.analysis.subject import EXACT
from opfmodel.errors import IncompatibleError
from opfmodel.plan import End, Initial, MultiStage, Plan
from opfmodel.plan.request import Limits, Request
from opfmodel.simulation import Outages, Run
from solvers import SolutionStatus, dual_bound

__all__ = ["Margins", "check_recursive_feasibility"]

Array = npt.NDArray[np.float64]

_TOLERANCE = 1e-6  # of the scaling
_EACH = 1.0  # p.u. on the base of the network, the direction of a margin of a single bus

STATEMENT = (
    "Lemma 4.2: A(x, d) is not empty, that is, from every state of the closed loop the demand of the next "
    "step can be served within ramps, limits and stored energy"
)


@dataclass(frozen=True, eq=False)
class Margins:
    """Largest scalings of a change of demand after which the next step is feasible.

    Parameters
    ----------
    problem
        The problem of the controller; its ramps, limits and storages count, not its costs.
    outages
        The outages that happen.
    """

    problem: MultiStage
    outages: Outages = field(default_factory=Outages)

    @cached_property
    def _next(self) -> MultiStage:
        made = nominal_problem(self.problem, 1, LargestGrowth(self.problem.objective))
        made.generator_delay, made.regularisation = 0, 0.0
        made.devices, made.outages = [*made.devices, GrowingDemand()], self.outages.components
        made.solver, made.options = "ipopt", EXACT
        return made

    def largest(self, time: int, state: Initial, p: Array, q: Array) -> float | None:
        """Return the largest s for which demand d + s (p, q) can be served; None if no solve succeeded.

        One problem with s as a variable. It is negative if d itself cannot be served.

        Parameters
        ----------
        time
            The next step, which provides the demand d.
        state
            State before it, in physical units.
        p, q
            Direction at the buses, MW and MVAr.
        """
        plan = self._solve(self._next, time, state, p, q)
        return -plan.objective / self.problem.step if plan.optimal else None

    def feasible(self, time: int, state: Initial) -> bool:
        """Return whether a state was found in which the demand of a step is served."""
        none = np.zeros(len(self.problem.arrays.bus))
        return self._solve(self._next, time, state, none, none, {"scaling": (0.0, 0.0)}).optimal

    def bound(self, time: int, state: Initial, p: Array, q: Array) -> float | None:
        """Return an upper bound on the largest scaling from a relaxation; -inf if it is proven infeasible."""
        try:
            plan = self._solve(convex_problem(self._next), time, state, p, q)
        except IncompatibleError:
            return None
        if plan.solution.status is SolutionStatus.PROVEN_INFEASIBLE:
            return -np.inf
        least = dual_bound(plan.solution)
        return -least / self.problem.step if np.isfinite(least) else None

    def _solve(
        self, problem: MultiStage, time: int, state: Initial, p: Array, q: Array, limits: Limits | None = None
    ) -> Plan:
        base = self.problem.arrays.base_mva
        direction = {key: values[:, None] / base for key, values in zip(DIRECTIONS, (p, q), strict=True)}
        out = self.outages.out(time, self.problem.step)
        request = Request(time, state, End(), direction, problem.horizon, out)
        return problem.solve_once(request, limits=limits)


def check_recursive_feasibility(problem: MultiStage, run: Run, advance: Advance = silent) -> Finding:
    """Check that the next step is feasible from every state of a closed loop, and by what margin.

    Parameters
    ----------
    run
        The closed loop.
    """
    margins = Margins(problem, run.outages)
    tried = len(run.steps) + (run.status != "done")  # the step at which a loop broke off counts too
    p, q = _demand(problem, tried)
    found = []
    for time in range(1, tried):
        state = _state(problem, run, time)
        change = p[time] - p[time - 1], q[time] - q[time - 1]
        found.append(
            _Step(
                time,
                _plus_one(margins.largest(time, state, *change)) if np.any(change) else None,
                margins.largest(time, state, p[time], q[time]),
                margins.largest(time, state, -p[time], -q[time]),
                float(np.abs(p[time]).sum()),
            )
        )
        advance("recursive feasibility: steps", time, tried - 1)
    return _judged(problem, run, margins, found, advance)


@dataclass(frozen=True)
class _Step:
    """Margins of one step.

    Attributes
    ----------
    change
        Largest multiple of the change of demand since the last step; None if it does not change.
    up, down
        Largest increase and decrease of all demand, as a share of it; None if no solve succeeded.
    total
        Sum of the magnitudes of active demand, MW.
    """

    time: int
    change: float | None
    up: float | None
    down: float | None
    total: float

    @property
    def up_mw(self) -> float | None:
        """Largest increase of demand, MW."""
        return _times(self.up, self.total)

    @property
    def down_mw(self) -> float | None:
        """Largest decrease of demand, MW."""
        return _times(self.down, self.total)


def _judged(problem: MultiStage, run: Run, margins: Margins, found: list[_Step], advance: Advance) -> Finding:
    p, q = _demand(problem, len(found) + 1)
    doubtful = [step.time for step in found if not _served(margins, step, _state(problem, run, step.time))]
    proven = []
    for time in doubtful:
        state = _state(problem, run, time)
        most = [margins.bound(time, state, sign * p[time], sign * q[time]) for sign in (1.0, -1.0)]
        if any(side is not None and side < -_TOLERANCE for side in most):
            proven.append(time)
    figures: dict[str, Any] = {
        "steps": len(found),
        "change": [step.change for step in found],
        "up_mw": [step.up_mw for step in found],
        "down_mw": [step.down_mw for step in found],
        "infeasible_steps": proven,
        "undecided_steps": [time for time in doubtful if time not in proven],
        "run": run.status,
    }
    for side, name in (("change", "change"), ("up", "up_mw"), ("down", "down_mw")):
        known = {step.time: getattr(step, name) for step in found if getattr(step, name) is not None}
        at = min(known, key=lambda time: known[time]) if known else None
        figures[f"least_{side}"] = None if at is None else {"value": known[at], "step": at}
    if figures["least_up"] is not None:
        at = figures["least_up"]["step"]
        figures["buses"] = {"step": at, **_by_bus(problem, margins, _state(problem, run, at), at, advance)}
    if proven:
        why = f"{problem.step_name(proven[0])} is proven infeasible from the state before it"
        return Finding(Verdict.VIOLATED, STATEMENT, why, _TOLERANCE, figures)
    if doubtful:
        first = problem.step_name(doubtful[0])
        why = f"for {first} no feasible state was found, nor a proof that there is none"
        return Finding(Verdict.UNDECIDED, STATEMENT, why, _TOLERANCE, figures)
    if run.status != "done":
        served = "; its own demand could be served, but not that of all stages of the plan" if found else ""
        why = f"the closed loop broke off in {run.termination}{served}"
        return Finding(Verdict.UNDECIDED, STATEMENT, why, _TOLERANCE, figures)
    if not found:
        return Finding(
            Verdict.UNDECIDED, STATEMENT, "the closed loop has fewer than two steps", _TOLERANCE, figures
        )
    up, down = (_least(problem, figures[f"least_{side}"]) for side in ("up", "down"))
    why = f"in all {len(found)} steps demand could have been up to {up} higher and {down} lower in total"
    return Finding(Verdict.HOLDS, STATEMENT, why, _TOLERANCE, figures)


def _least(problem: MultiStage, least: dict[str, Any]) -> str:
    """Return a smallest margin in words; below zero only within the tolerance."""
    return f"{max(0.0, round(least['value'], 3)):.4g} MW ({problem.step_name(least['step'])})"


def _served(margins: Margins, step: _Step, state: Initial) -> bool:
    """Return whether the demand of a step can be served.

    It lies between the largest and the smallest that can, and is one of them or can be served itself: what
    can be served need not be an interval.
    """
    if step.up is None or step.down is None or min(step.up, step.down) < -_TOLERANCE:
        return False
    return min(step.up, step.down) <= _TOLERANCE or margins.feasible(step.time, state)


def _by_bus(
    problem: MultiStage, margins: Margins, state: Initial, time: int, advance: Advance
) -> dict[str, Any]:
    """Return the margins of single buses, MW of active demand in either direction."""
    names, base = problem.arrays.bus.names, problem.network.base_mva
    found: dict[str, dict[str, float | None]] = {"up_mw": {}, "down_mw": {}}
    for number, name in enumerate(names):
        for side, sign in (("up_mw", 1.0), ("down_mw", -1.0)):
            direction = np.zeros(len(names))
            direction[number] = sign * base * _EACH
            largest = margins.largest(time, state, direction, np.zeros(len(names)))
            found[side][name] = _times(largest, base * _EACH)
        advance("recursive feasibility: buses", number + 1, len(names))
    return found


def _demand(problem: MultiStage, steps: int) -> tuple[Array, Array]:
    """Return active and reactive demand at the buses, ``(steps, buses)`` in MW and MVAr."""
    network = problem.window(0, steps)
    totals = []
    for which in ("p", "q"):
        values = network.at_buses("load", network.load.arrays[which]) * network.base_mva
        totals.append(np.broadcast_to(values, (len(network.bus), steps)).T)
    return totals[0], totals[1]


def _state(problem: MultiStage, run: Run, time: int) -> Initial:
    """Return the state of a closed loop before a step, in physical units."""
    step, base = run.steps[time - 1], problem.arrays.base_mva
    made = {}
    for name, state in problem.model.states.items():
        key = state.kind, f"{name}_next" if state.role == "stock" else name
        if key in step.values:
            made[name] = step.values[key] * base
    return made


def _plus_one(value: float | None) -> float | None:
    return None if value is None else 1.0 + value


def _times(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor
