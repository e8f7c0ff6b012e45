"""The turnpike property: plans of any length spend all but a bounded time near the steady state."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.analysis.arcs import Arc, estimated_arc
from opfmodel.analysis.finding import Finding, Verdict
from opfmodel.analysis.subject import Subject

__all__ = ["STARTS", "check_turnpike", "radius"]

Array = npt.NDArray[np.float64]

STARTS = {"empty": 0.0, "half full": 0.5, "full": 1.0}
_EPSILON = 0.05  # of the norm of the capacities
_MOST = 40_000  # nodes times components of a plan; longer horizons have longer stages
_LONGEST = 20_000  # base steps
_BEFORE = 3  # horizons up to the arcs
_SETTLED, _GROWING = 0.1, 0.9  # further stages outside per further stage of the horizon
_BEYOND = 2.0  # estimated arcs, to the steady state and away from it, that the last horizon but one reaches
_FURTHER = 1.5  # the last horizon over the one before

STATEMENT = (
    "Theorem 2.1 rests on the turnpike property: the number of stages outside an epsilon-ball of x_s stays "
    "bounded as the horizon N grows"
)


@dataclass(frozen=True)
class _Count:
    """Base steps of a plan outside the ball: in all, before it is first entered and after it is last left."""

    outside: int
    approaching: int
    leaving: int


def radius(subject: Subject) -> float:
    """Return the radius of the ball around the steady state, p.u.: 5 % of the norm of the capacities."""
    size = float(np.linalg.norm(subject.capacity)) or float(np.linalg.norm(subject.steady.x)) or 1.0
    return _EPSILON * size


def check_turnpike(
    subject: Subject, horizons: Sequence[int] | None = None, epsilon: float | None = None
) -> Finding:
    """Count the stages outside a ball around the steady state for a sweep of horizons and initial states.

    Parameters
    ----------
    horizons
        Numbers of base steps, ascending; by default from the horizon of the problem to well beyond the
        estimated arcs.
    epsilon
        Radius of the ball, p.u.
    """
    ball = radius(subject) if epsilon is None else epsilon
    arc = estimated_arc(subject)
    starts = _starts(subject, ball)
    farthest = max(float(np.linalg.norm(x - subject.rest)) for x in starts.values())
    expected = _hours(arc, ball, farthest) / subject.problem.step
    swept = _sweep(subject.stages, expected) if horizons is None else list(horizons)
    counts: dict[str, list[_Count]] = {name: [] for name in starts}
    profiles: dict[str, dict[str, list[float]]] = {name: {} for name in starts}
    merged: list[int] = []
    done: list[int] = []
    for stages in swept:
        merge = -(-stages * subject.problem.arrays.n_components // _MOST)
        nodes = -(-stages // merge)
        problem = subject.problem_of(nodes, subject.problem.step * merge)
        found = {}
        for name, x in starts.items():
            plan = problem.solve(initial=subject.initial(x))
            if not plan.optimal:
                break
            found[name] = np.linalg.norm(subject.x(plan) - subject.rest[:, None], axis=0)
            number = len(done) * len(starts) + len(found)
            subject.advance(f"turnpike: {stages} steps, {name}", number, len(swept) * len(starts))
        if len(found) < len(starts):
            break
        done.append(nodes * merge)
        merged.append(merge)
        for name, away in found.items():
            counts[name].append(_count(away > ball, merge))
            profiles[name][str(nodes * merge)] = away.tolist()
    outside = [max(counts[name][k].outside for name in starts) for k in range(len(done))]
    figures: dict[str, Any] = {
        "horizons": done,
        "outside": outside,
        "epsilon": ball,
        "by_initial_state": {
            name: {
                "outside": [c.outside for c in of],
                "approaching": [c.approaching for c in of],
                "leaving": [c.leaving for c in of],
            }
            for name, of in counts.items()
        },
        "base_steps_per_stage": merged,
        "expected_arc": expected if np.isfinite(expected) else None,
        "curvature": None if arc is None else {"generation": arc.generation, "energy": arc.energy},
        "distance": profiles,
    }
    return _judged(figures, expected, subject.stages)


def _judged(figures: dict[str, Any], expected: float, own: int) -> Finding:
    done, outside = figures["horizons"], figures["outside"]
    if len(done) < 2:
        why = "fewer than two horizons were solved"
        return Finding(Verdict.UNDECIDED, STATEMENT, why, _SETTLED, figures)
    growth = (outside[-1] - outside[-2]) / (done[-1] - done[-2])
    figures["growth"] = growth
    what = (
        f"plans of {done[-2]} and {done[-1]} steps spend {outside[-2]} and {outside[-1]} of them farther "
        f"than {figures['epsilon']:.3g} p.u. from the steady state; the controller plans {own} steps ahead"
    )
    if growth <= _SETTLED:
        verdict = Verdict.HOLDS
    elif np.isinf(expected) or (growth >= _GROWING and done[-2] >= _BEYOND * expected):
        verdict = Verdict.VIOLATED
        if np.isinf(expected):
            what += "; stored energy has no cost, so that nothing draws it to one value"
    else:
        verdict = Verdict.UNDECIDED
        what += (
            "; the length of the arcs could not be estimated"
            if np.isnan(expected)
            else f"; the arcs are estimated to be {expected:.0f} steps long"
        )
    return Finding(verdict, STATEMENT, what, _SETTLED, figures)


def _starts(subject: Subject, ball: float) -> dict[str, Array]:
    """Return the initial states, without those that are the steady state, if others remain."""
    named = {name: subject.stored(share) for name, share in STARTS.items()}
    away = {name: x for name, x in named.items() if np.linalg.norm(x - subject.rest) > ball}
    return away or named


def _hours(arc: Arc | None, ball: float, farthest: float) -> float:
    """Return the estimated length of an arc, hours; NaN if it is unknown."""
    if farthest <= ball:
        return 0.0
    return np.nan if arc is None else arc.hours(farthest, ball)


def _sweep(stages: int, expected: float) -> list[int]:
    """Return the horizon of the problem and longer ones, the last two well beyond the estimated arcs."""
    first = max(stages, 2)
    beyond = min(
        _LONGEST // 2, max(math.ceil(_BEYOND * expected), 2 * first) if np.isfinite(expected) else 4 * first
    )
    between = [round(h) for h in np.geomspace(first, beyond, _BEFORE, endpoint=False)]
    return sorted({first, *between, beyond, math.ceil(_FURTHER * beyond)})


def _count(outside: npt.NDArray[np.bool_], merge: int) -> _Count:
    """Count the base steps outside the ball."""
    inside = np.flatnonzero(~outside)
    if not inside.size:
        return _Count(outside.size * merge, outside.size * merge, 0)
    return _Count(
        int(outside.sum()) * merge, int(inside[0]) * merge, int(outside.size - 1 - inside[-1]) * merge
    )
