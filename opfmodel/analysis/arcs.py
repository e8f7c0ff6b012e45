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
    """

    generation: float
    energy: float
    rate: float
    emptying: float

    def hours(self, ratio: float) -> float:
        """Return the hours in which the distance from the steady state decreases to a share of its value."""
        if self.rate == 0.0:
            return math.inf
        return max(self.emptying, math.log(max(1.0 / ratio, 1.0)) / self.rate)


def estimated_arc(subject: Subject) -> Arc | None:
    """Return an estimate of the arcs of a system; None if it has no storages with power."""
    stage = subject.steady.plan.stage
    if not stage.has("ps") or not len(subject.problem.arrays.storage):
        return None
    plan = subject.steady.plan
    program, instance = plan.solution.program, plan.solution.instance
    block, power = program.variables["e"], program.variables["ps"]
    low, high = (power.read(side)[:, 0] for side in (instance.lower, instance.upper))
    upper = plan.solution.evaluator.hessian(
        plan.solution.x, instance.parameters, 1.0, np.zeros(program.n_rows)
    )
    unit, step = subject.unit, plan.problem.step
    weights = np.asarray(upper.diagonal())[block.offset : block.offset + block.items] / (2 * unit**2 * step)
    spread = _spread(weights)
    energy = float(weights @ spread**2)
    most = min(-low[spread > 0].max(initial=-np.inf), high[spread > 0].min(initial=np.inf))
    swing = _SHARE * most / spread.max() if most > 0 else 0.0
    if not swing or not np.isfinite(swing):
        return None
    costs = [_cost(subject, share * swing * spread) for share in (-1.0, 1.0)]
    if None in costs:
        return None
    total = sum(cost for cost in costs if cost is not None)
    generation = max(0.0, (total - 2 * subject.steady.cost) / (2 * (unit * swing) ** 2))
    moving = np.maximum(np.minimum(-low, high), 1e-12)
    emptying = float((subject.capacity[_energy(subject)] / unit / moving).max(initial=0.0))
    rate = 0.0 if energy < _FLAT else np.sqrt(energy / max(generation, _FLAT))
    return Arc(generation, energy, float(rate), emptying)


def _energy(subject: Subject) -> slice:
    return next(state.where for state in subject.states if state.name == "e")


def _spread(weights: Array) -> Array:
    """Return the shares of the storages in total energy that have the lowest weighted sum of squares."""
    free_of_cost = weights < _FLAT
    inverse = free_of_cost.astype(float) if free_of_cost.any() else 1.0 / weights
    return np.asarray(inverse / inverse.sum())


def _cost(subject: Subject, power: Array) -> float | None:
    """Return the cost of the cheapest stage with given power of the storages, less that of its energy."""
    problem = subject.stage_problem
    request = Request(0, free(problem), End(), None, problem.horizon)
    plan = problem.solve_once(request, limits={"ps": (power[:, None], power[:, None])})
    if not plan.optimal:
        return None
    energy = plan.stage.storage.e[:, 0]
    at_rest = subject.steady.plan.stage.storage.e[:, 0]
    upper = subject.steady.plan.solution
    block = upper.program.variables["e"]
    diagonal = upper.evaluator.hessian(
        upper.x, upper.instance.parameters, 1.0, np.zeros(upper.program.n_rows)
    ).diagonal()
    weight = np.asarray(diagonal)[block.offset : block.offset + block.items] / 2
    return float(plan.objective - weight @ (energy**2 - at_rest**2)) / problem.step
