"""Practical stability: closed loops under constant demand end near the steady state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.analysis.arcs import estimated_arc
from opfmodel.analysis.finding import Finding, Verdict
from opfmodel.analysis.subject import Loop, Subject
from opfmodel.analysis.turnpike import radius
from opfmodel.plan import End

__all__ = ["check_practical_stability"]

Array = npt.NDArray[np.float64]

_STARTS = {"empty": 0.0, "full": 1.0}
_STEPS = 4  # times the horizon of the problem: how long the loops are
_SHARES = (0.25, 0.5, 1.0)  # of the horizon of the problem: the horizons
_STILL = 1e-3  # of the tolerance: a state that moves by less in a step has settled
_MOVES = 0.01  # a loop whose distance fell by less in its last quarter has settled

STATEMENT = (
    "Theorem 2.1 and Proposition 4.2: for a sufficiently long horizon N the closed loop ends in a "
    "neighbourhood of x_s, which shrinks with N"
)


def check_practical_stability(
    subject: Subject,
    horizons: Sequence[int] | None = None,
    tolerance: float | None = None,
    steps: int | None = None,
) -> Finding:
    """Run closed loops under constant demand from several initial states, for several horizons.

    Parameters
    ----------
    horizons
        Horizons of the plans, ascending; the verdict is that of the last one, by default the horizon of
        the problem.
    tolerance
        Distance from the steady state at the end that is near, p.u.
    steps
        Length of the loops.
    """
    near = radius(subject) if tolerance is None else tolerance
    least = 1 + subject.problem.generator_delay
    own = subject.stages
    shares = sorted({max(least, round(own * share)) for share in _SHARES})
    swept = shares if horizons is None else list(horizons)
    length = _STEPS * max(swept) if steps is None else steps
    starts = {name: subject.stored(share) for name, share in _STARTS.items()}
    ends: dict[str, list[float]] = {name: [] for name in starts}
    settled: dict[str, list[bool]] = {name: [] for name in starts}
    failures: list[str] = []
    for stages in swept:
        for name, x in starts.items():
            loop = subject.loop(stages, x, length, _STILL * near)
            if loop.cost.size < length and not loop.settled:
                failures.append(f"horizon {stages}, {name}: {loop.status} after {loop.cost.size} steps")
            away = _away(subject, loop)
            ends[name].append(float(away[-1]))
            settled[name].append(loop.settled or _has_settled(away))
    worst = [max(ends[name][k] for name in starts) for k in range(len(swept))]
    close = [k for k in range(len(swept)) if all(distance <= near for distance in worst[k:])]
    figures: dict[str, Any] = {
        "horizons": swept,
        "distance": worst,
        "by_initial_state": ends,
        "settled": settled,
        "steps": length,
        "smallest_horizon": swept[close[0]] if close else None,
        "failures": failures,
    }
    if failures:
        return Finding(Verdict.UNDECIDED, STATEMENT, f"a loop broke off: {failures[0]}", near, figures)
    if close:
        why = (
            f"with a horizon of {swept[close[0]]} or more stages all loops end within {near:.3g} p.u. of the "
            f"steady state within {length} steps; with that of {swept[-1]}, {worst[-1]:.3g} p.u. away"
        )
        return Finding(Verdict.HOLDS, STATEMENT, why, near, figures)
    outside = [name for name in starts if ends[name][-1] > near]
    if any(settled[name][-1] for name in outside):
        why = (
            f"with a horizon of {swept[-1]} stages the loop from {outside[0]} storages settles "
            f"{worst[-1]:.3g} p.u. away from the steady state{_cause(subject)}"
        )
        return Finding(Verdict.VIOLATED, STATEMENT, why, near, figures)
    why = f"after {length} steps the loops are still on their way, {worst[-1]:.3g} p.u. away"
    return Finding(Verdict.UNDECIDED, STATEMENT, why, near, figures)


def _cause(subject: Subject) -> str:
    """Return why a loop settles elsewhere."""
    if subject.problem.end != End():
        return "; its plans have a condition or price on their final energy"
    arc = estimated_arc(subject)
    if arc is not None and arc.rate == 0.0:
        return "; stored energy has no cost, so that nothing draws it to one value"
    return ": the horizon is too short"


def _away(subject: Subject, loop: Loop) -> Array:
    return np.asarray(np.linalg.norm(loop.x - subject.rest[:, None], axis=0))


def _has_settled(away: Array) -> bool:
    before = away[-max(2, len(away) // 4)]
    return bool(away[-1] >= (1 - _MOVES) * before)
