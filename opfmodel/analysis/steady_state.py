"""The optimal steady state: whether it exists, whether it is interior, and whether it can be reached."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.analysis.active import NEAR
from opfmodel.analysis.finding import Finding, Verdict
from opfmodel.analysis.subject import Subject, free
from opfmodel.model import Stage
from opfmodel.network.arrays import PerUnitNetwork
from opfmodel.network.units import scale
from opfmodel.objectives.base import Objective
from solvers import total

__all__ = ["check_steady_state"]

Array = npt.NDArray[np.float64]

_PIECES = 20  # of the path from the initial state
_DETOUR = 3.0  # pieces of the straight line that one piece of the path may be long
_ACCURATE = 1e-3  # of the norm of x_s: interior-point methods leave states that cost nothing that uncertain

STATEMENT = (
    "Assumption 4.2: the optimal steady state (x_s, u_s)(d) exists and lies in the interior of the "
    "constraints; Proposition 4.2: the initial state and x_s are connected by feasible states"
)


def check_steady_state(subject: Subject, initial: Array | None = None) -> Finding:
    """Find the optimal steady state, the limits that bind there, and a feasible path to it.

    Parameters
    ----------
    initial
        The initial state, p.u.; by default half-full storages.
    """
    steady, base = subject.steady, subject.problem.network.base_mva
    path = feasible_path(subject, subject.stored(0.5) if initial is None else initial)
    prices = steady.plan.price("lmp")[:, 0] * scale("$/MWh", subject.problem.arrays.base_mva)
    figures: dict[str, Any] = {
        "cost": steady.cost,
        "state": subject.physical(steady.x),
        "storage_power": {
            name: float(value * subject.unit * base)
            for name, value in zip(
                subject.problem.arrays.storage.names, steady.plan.stage.storage.ps[:, 0], strict=True
            )
        }
        if steady.plan.stage.has("ps")
        else {},
        "lmp": dict(zip(subject.problem.arrays.bus.names, map(float, prices), strict=True)),
        "interior": not steady.active,
        "active": list(steady.active),
        "path": path,
    }
    connected = path["connected"]
    reached = (
        "a feasible path from the initial state was found" if connected else "no feasible path was found"
    )
    if steady.active:
        many = len(steady.active)
        limits = f"{many} limit{'s' if many > 1 else ''}, such as {steady.active[0]}"
        return Finding(Verdict.VIOLATED, STATEMENT, f"on the boundary: {limits}; {reached}", NEAR, figures)
    verdict = Verdict.HOLDS if connected else Verdict.UNDECIDED
    return Finding(verdict, STATEMENT, f"in the interior; {reached}", NEAR, figures)


def feasible_path(subject: Subject, x: Array) -> dict[str, Any]:
    """Return evidence that feasible states connect a state with the steady state.

    The straight line between them is followed from the steady state in small pieces; at each point, the
    nearest feasible state is found from the last one. Pieces of a length that does not vanish with their
    number are jumps, and so is what remains at the end.
    """
    target = subject.steady.x
    length = float(np.linalg.norm(x - target))
    nearest = _Nearest(subject)
    problem = subject.problem_of(1, exact=True, objective=nearest)
    found: list[Array] = []
    plan = None
    for share in np.linspace(0.0, 1.0, _PIECES + 1):
        wanted = nearest.fields(target + share * (x - target))
        plan = problem.solve(initial=free(problem), expected=wanted, previous=plan)
        if not plan.optimal:
            break
        found.append(subject.x(plan)[:, 0])
        subject.advance("path to the steady state", len(found), _PIECES + 1)
    steps = np.linalg.norm(np.diff(found, axis=0), axis=1) if len(found) > 1 else np.zeros(0)
    whole = len(found) == _PIECES + 1
    longest = float(steps.max(initial=0.0))
    away = float(np.linalg.norm(found[-1] - x)) if whole else np.inf
    astray = float(np.linalg.norm(found[0] - target)) if found else np.inf
    allowed = max(_DETOUR * length / _PIECES, _ACCURATE * float(np.linalg.norm(target)))
    return {
        "connected": bool(max(longest, away, astray) <= allowed),
        "length": length,
        "longest_piece": longest,
        "longest_allowed": allowed,
        "pieces": _PIECES,
        "initial_state_infeasible_by": away,
    }


class _Nearest(Objective):
    """The squared distance of the state from a point, which every solve states, p.u.²."""

    def __init__(self, subject: Subject) -> None:
        self.subject = subject

    def fields(self, x: Array) -> dict[tuple[str, str], Array]:
        """Return a point, p.u., as fields of the components."""
        return {
            (state.kind, f"{state.name}_point"): x[state.where][:, None] / self.subject.unit
            for state in self.subject.states
        }

    def series(self, _: PerUnitNetwork) -> Mapping[tuple[str, str], Array]:
        """Return the steady state."""
        return self.fields(self.subject.steady.x)

    def stage_cost(self, stage: Stage) -> Any:
        """Return the sum of squares."""
        cost: Any = 0.0
        for state in self.subject.states:
            of = getattr(stage, state.kind)
            away = getattr(of, state.name) - getattr(of, f"{state.name}_point")
            cost = cost + self.subject.unit**2 * total(away**2)
        return cost
