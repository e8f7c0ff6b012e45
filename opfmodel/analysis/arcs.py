"""How long the arcs of a turnpike are: an estimate from the curvature of the costs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from opfmodel.analysis.subject import Subject, free
from opfmodel.plan import End
from opfmodel.plan.request import Request

__all__ = ["Arc", "estimated_arc"]

Array = npt.NDArray[np.float64]

_SHARE = 0.5  # of the power of the storages, for the difference quotient
_FLAT = 1e-9  # $/(h p.u.²), a smaller curvature is none


@dataclass(frozen=True)
class Arc:
    r"""What determines the length of the arcs of stored energy.

    Near the steady state total stored energy E follows the linear-quadratic problem

    .. math::
        \min \int w E^2 + c \dot E^2 \, dt, \qquad E(t) = E(0) e^{-t \sqrt{w / c}}

    A loss of b for every unit that is bought and sold again pays only over a time t with :math:`2 w E t > b`.

    Attributes
    ----------
    generation
        c, the curvature of the stage cost in the total power of the storages, $/(h p.u.²).
    energy
        w, the weight on total stored energy if it is spread at the lowest cost, $/(h p.u.²).
    rate
        The rate of decay, 1/h; infinite if generation costs are linear, zero if energy costs nothing.
    emptying
        Hours that it takes to empty full storages at their full power.
    round_trip
        b, what is lost if energy is bought and sold again, per distance from the steady state, $/p.u.
    """

    generation: float
    energy: float
    rate: float
    emptying: float
    round_trip: float

    def hours(self, first: float, last: float) -> float:
        """Return the hours in which the distance from the steady state decreases to a smaller one."""
        if self.rate == 0.0:
            return math.inf
        moving = max(self.emptying, math.log(max(first / last, 1.0)) / self.rate)
        return moving + self.round_trip / (2.0 * self.energy * last)


def estimated_arc(subject: Subject) -> Arc | None:
    """Return an estimate of the arcs of a system; None if it has no storages that can move energy."""
    where = next((state.where for state in subject.states if state.name == "e"), slice(0))
    plan = subject.steady.plan
    if where.start == where.stop or not plan.stage.has("ps"):
        return None
    weights = subject.q.diagonal()[where]
    spread = _spread(weights)
    power, instance = plan.solution.program.variables["ps"], plan.solution.instance
    low, high = (subject.unit * power.read(side)[:, 0] for side in (instance.lower, instance.upper))
    at_rest = subject.unit * plan.stage.storage.ps[:, 0]
    able = np.minimum(at_rest - low, high - at_rest)[spread > 0]
    swing = _SHARE * float((able / spread[spread > 0]).min())
    if not 0.0 < swing < np.inf:
        return None
    costs = [_generation(subject, at_rest + swing * direction * spread, where) for direction in (-1, 0, 1)]
    if None in costs:
        return None
    less, same, more = (cost for cost in costs if cost is not None)
    generation = max(0.0, (less - 2 * same + more) / (2 * swing**2))
    energy = float(weights @ spread**2)
    rate = 0.0 if energy < _FLAT else math.sqrt(energy / max(generation, _FLAT))
    emptying = float((subject.capacity[where] / np.maximum(np.minimum(-low, high), 1e-12)).max())
    return Arc(generation, energy, rate, emptying, _round_trip(subject, spread))


def _round_trip(subject: Subject, spread: Array) -> float:
    """Return the value of the energy lost in storages that are charged and discharged again."""
    plan = subject.steady.plan
    storage = plan.network.storage
    price = np.abs(plan.price("lmp")[storage.bus, 0]) / subject.unit
    lost = price * (1.0 / storage.charge_efficiency - storage.discharge_efficiency)[:, 0]
    return float(spread @ lost * np.linalg.norm(spread))


def _spread(weights: Array) -> Array:
    """Return the shares of the storages in total energy that have the lowest weighted sum of squares."""
    costless = weights < _FLAT
    inverse = costless.astype(float) if costless.any() else 1.0 / weights
    return np.asarray(inverse / inverse.sum())


def _generation(subject: Subject, power: Array, where: slice) -> float | None:
    """Return the cost of the cheapest stage with given storage power, less that of its energy, $/h."""
    problem, given = subject.stage_problem, power[:, None] / subject.unit
    request = Request(0, free(problem), End(), None, problem.horizon)
    plan = problem.solve_once(request, limits={"ps": (given, given)})
    if not plan.optimal:
        return None
    away = (subject.x(plan)[:, 0] - subject.steady.x)[where]
    of_energy = subject.slope[where] @ away + away @ subject.q[where, where] @ away
    return plan.objective / problem.step - float(of_energy)
