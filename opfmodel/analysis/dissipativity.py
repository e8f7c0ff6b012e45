"""Strict dissipativity: no stage buys or sells energy at better prices than those of the steady state."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.analysis.finding import Finding, Verdict
from opfmodel.analysis.problems import convex_problem
from opfmodel.analysis.rotated import Rotated
from opfmodel.analysis.subject import State, Subject, again, free, random_starts
from opfmodel.errors import IncompatibleError
from opfmodel.network.quantities import in_currency
from opfmodel.network.units import scale
from opfmodel.plan import Plan
from solvers import SolutionStatus, dual_bound

__all__ = ["check_dissipativity"]

Array = npt.NDArray[np.float64]

_STARTS = 25
_ROUNDS = 12
_CERTIFIED = {"tol_gap_rel": 1e-10, "tol_gap_abs": 1e-10}  # of Clarabel
_APART = 1e-2  # p.u.², a stage that differs from the steady state
_ROUNDING = 1e-12  # of the largest eigenvalue of Q, a smaller one is zero

STATEMENT = (
    "Proposition 4.1: the system is strictly dissipative with a linear storage function, "
    "l(x, u) - l(x_s, u_s) + lambda(x) - lambda(x+) >= alpha |x - x_s|^2 for every feasible stage"
)


@dataclass(frozen=True, eq=False)
class _Stage:
    """A feasible stage, or one of the relaxation.

    Attributes
    ----------
    x
        State, p.u.
    rotated
        Rotated cost, $/h.
    distance
        Squared distance of the state from the steady state, p.u.².
    bound
        Lower bound on what was minimised, $/h, if the problem is convex.
    """

    x: Array
    rotated: float
    distance: float
    bound: float = -np.inf

    def value(self, alpha: float) -> float:
        """Rotated cost less alpha times the squared distance, $/h."""
        return self.rotated - alpha * self.distance


class _Search:
    """Minimises the rotated cost less alpha times the squared distance over the stages of a problem.

    Parameters
    ----------
    relaxed
        Whether over the stages of the relaxation of its formulation, which is convex.
    starts
        Number of random starts, besides the default one.
    """

    def __init__(self, subject: Subject, relaxed: bool = False, starts: int = 0) -> None:
        self.subject, self.relaxed, self.starts = subject, relaxed, starts

    @property
    def formulation(self) -> str:
        """Name of the formulation over whose stages it minimises."""
        own = self.subject.problem.formulation
        return own.relaxed_by if self.relaxed and own.relaxed_by is not None else own.name

    def lowest(self, alpha: float) -> _Stage | None:
        """Return the stage with the lowest value that was found; None if no solve succeeded."""
        problem = self.subject.problem_of(1, exact=True, objective=Rotated(self.subject, alpha))
        if self.relaxed:
            try:
                problem = convex_problem(problem, _CERTIFIED)
            except IncompatibleError:
                return None
        plan = problem.solve(initial=free(problem))
        plans = [plan]
        for number, start in enumerate(random_starts(plan, self.starts), start=1):
            plans.append(again(plan, start))
            self.subject.advance(f"rotated cost for alpha = {alpha:.3g}", number, self.starts)
        found = [self._stage(each, alpha) for each in plans if each.optimal]
        return min(found, key=lambda stage: stage.value(alpha), default=None)

    def _stage(self, plan: Plan, alpha: float) -> _Stage:
        subject, solution = self.subject, plan.solution
        x = subject.x(plan)[:, 0]
        distance = float(np.sum((x - subject.steady.x) ** 2))
        step = plan.problem.step
        value = solution.objective / step - subject.steady.cost
        convex = solution.status is SolutionStatus.GLOBALLY_OPTIMAL
        bound = dual_bound(solution) / step - subject.steady.cost if convex else -np.inf
        return _Stage(x, value + alpha * distance, distance, bound)

    def largest_alpha(self, alpha: float, tolerance: float) -> tuple[float, _Stage | None]:
        """Return the largest alpha for which no stage has a value below zero, and the stage that limits it.

        With the stage that is lowest for one alpha, the next one is the ratio of its rotated cost to its
        distance (Dinkelbach 1967); the sequence decreases to the minimum of the ratio.
        """
        limiting = None
        for _ in range(_ROUNDS):
            stage = self.lowest(alpha)
            if stage is None or stage.value(alpha) >= -tolerance:
                break
            limiting = stage
            if stage.rotated <= tolerance:
                return 0.0, stage
            alpha = stage.rotated / stage.distance
        return alpha, limiting


def check_dissipativity(subject: Subject) -> Finding:
    """Check strict dissipativity of a system under constant demand.

    The minimum of the rotated cost less alpha times the squared distance from the steady state has an upper
    bound from solves with many starts, and a lower bound from a convex relaxation.
    """
    tolerance = subject.tolerance
    eigenvalues, quadratic = np.linalg.eigvalsh(subject.q), subject.quadratic
    definite = eigenvalues[0] > _ROUNDING * eigenvalues[-1]
    least = float(eigenvalues[0]) if definite else 0.0
    money = in_currency("$/h", subject.problem.network.currency)
    search = _Search(subject, starts=_STARTS)
    alpha, limiting = search.largest_alpha(1.5 * least or 1.0, tolerance)
    at = min(alpha, least)
    upper = search.lowest(at)
    convex = _Search(subject, relaxed=True)
    lower = convex.lowest(at)
    certified = _certified(convex, at, lower, tolerance)
    reach = float(np.sum(subject.capacity**2)) or float(np.sum(subject.steady.x**2)) or 1.0
    if certified is not None and certified * reach <= tolerance:
        certified = None  # the tolerance alone would certify it
    along = _along(subject, at)
    figures: dict[str, Any] = {
        "storage_function": {
            name: float(price * scale("$/MWh", subject.problem.network.base_mva))
            for state, prices in _priced(subject)
            for name, price in zip(subject.problem.arrays.tables[state.kind].names, prices, strict=True)
        },
        "curvature": float(eigenvalues[0]),
        "quadratic": quadratic,
        "alpha": alpha,
        "alpha_certified": certified,
        "lower": None if lower is None else lower.bound,
        "upper": None if upper is None else upper.value(at),
        "relaxation": convex.formulation,
        "starts": _STARTS + 1,
        "point": None,
        "along_closed_loop": along,
    }
    broken = limiting if limiting is not None and limiting.rotated <= tolerance else None
    if broken is not None and (broken.rotated < -tolerance or broken.distance > _APART):
        figures["point"] = {
            "rotated_cost": broken.rotated,
            "distance": float(np.sqrt(broken.distance)),
            "state": subject.physical(broken.x),
        }
        what = (
            f"a feasible stage is {-broken.rotated:.3g} {money} cheaper than the steady state at its prices"
            if broken.rotated < -tolerance
            else "another stage is as cheap as the steady state at its prices"
        )
        verdict, why = Verdict.VIOLATED, f"{what}, {np.sqrt(broken.distance):.3g} p.u. away"
    elif certified:
        verdict = Verdict.HOLDS
        unit = in_currency("$/(h p.u.²)", subject.problem.network.currency)
        why = f"the relaxation certifies alpha = {certified:.4g} {unit}"
    else:
        verdict = Verdict.UNDECIDED
        if alpha == 0.0:
            why = "alpha = 0: stages beside the steady state are as cheap, to the tolerance"
        else:
            why = f"no start violates alpha = {alpha:.4g}, but {_doubt(lower, upper, at, tolerance, money)}"
    return Finding(verdict, STATEMENT, why, tolerance, figures)


def _doubt(lower: _Stage | None, upper: _Stage | None, alpha: float, tolerance: float, money: str) -> str:
    """Return why the relaxation certifies nothing."""
    if lower is None or upper is None:
        return "no relaxation could be solved"
    if alpha == 0.0:
        return "Q is not positive definite, so that no relaxation is convex"
    if lower.bound >= -tolerance:
        return "what it adds to the rotated cost is within the tolerance"
    return (
        f"the relaxation leaves a gap: the minimum is between {lower.bound:.4g} and "
        f"{upper.value(alpha):.4g} {money}"
    )


def _certified(convex: _Search, alpha: float, lowest: _Stage | None, tolerance: float) -> float | None:
    """Return the largest alpha up to a given one that the relaxation certifies; None if it certifies none."""
    if alpha <= 0.0 or lowest is None:
        return None
    if lowest.bound >= -tolerance:
        return alpha
    if lowest.rotated <= tolerance:
        return None
    alpha, _ = convex.largest_alpha(lowest.rotated / lowest.distance, tolerance)
    confirmed = convex.lowest(alpha)
    return alpha if alpha > 0.0 and confirmed is not None and confirmed.bound >= -tolerance else None


def _along(subject: Subject, alpha: float) -> dict[str, Any]:
    """Return the least value of the dissipation inequality along a closed loop, and the step of it."""
    loop = subject.loop(subject.stages, subject.stored(1.0), subject.stages)
    gained = [
        float(sum(prices @ (after - before)[state.where] for state, prices in _priced(subject)))
        for before, after in pairwise(loop.x.T)
    ]
    away = np.sum((loop.x[:, :-1] - subject.steady.x[:, None]) ** 2, axis=0)
    margin = loop.cost - subject.steady.cost - np.array(gained) / subject.problem.step - alpha * away
    if not margin.size:
        return {"steps": 0, "least": None, "step": None}
    worst = int(np.argmin(margin))
    return {"steps": int(margin.size), "least": float(margin[worst]), "step": worst}


def _priced(subject: Subject) -> Iterator[tuple[State, Array]]:
    for state in subject.states:
        if state.name in subject.storage_function:
            yield state, subject.storage_function[state.name]
