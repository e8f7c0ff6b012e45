"""Certified optimality: a lower bound on what any plan can cost, or a proof that there is no plan."""

from __future__ import annotations

import time as clock
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from opfmodel.errors import IncompatibleError, ModelError, shown
from opfmodel.network.units import scale
from opfmodel.plan.result import Plan, status_word
from solvers import SolutionStatus, TerminationCondition, UnsupportedProgramError, dual_bound

if TYPE_CHECKING:
    from opfmodel.plan.multistage import MultiStage
    from opfmodel.plan.request import Request

__all__ = ["Certificate", "certify", "check_bounded"]

_EXACT = 1e-4  # relative; within it statuses are optimal, see solvers.certify


@dataclass(frozen=True)
class Certificate:
    r"""What is proven about a plan: no plan of its problem costs less than ``lower``.

    Attributes
    ----------
    lower
        Lower bound in $ on what the problem minimises, without regularisation; NaN if there is none.
    upper
        What the plan costs by the same measure: its objective, less the value of the final energy if the end
        of the horizon has a price. NaN unless the plan is optimal.
    status
        Status of the relaxation: ``globally_optimal``, ``proven_infeasible`` or ``stopped``. A bound is valid
        whatever it is.
    plan
        The plan; if it has found no optimum and the relaxation is proven infeasible, with the status
        ``proven_infeasible``.
    formulation
        Formulation of the relaxation.
    seconds
        What compiling and solving the relaxation took.
    """

    lower: float
    upper: float
    status: str
    plan: Plan
    formulation: str
    seconds: float

    @property
    def gap(self) -> float:
        """Gap between the two bounds, ``(upper - lower) / |upper|``; NaN if one is unknown."""
        if self.upper == 0.0:
            return 0.0 if self.lower == 0.0 else np.nan
        return (self.upper - self.lower) / abs(self.upper)

    @property
    def exact(self) -> bool:
        """Whether the plan is proven to be globally optimal, to a relative gap of 1e-4."""
        return abs(self.gap) <= _EXACT

    def as_dict(self) -> dict[str, Any]:
        """Return the certificate as plain data, without the plan; null where a number is unknown."""
        named = {"lower": self.lower, "upper": self.upper, "gap": self.gap}
        known = {name: value if np.isfinite(value) else None for name, value in named.items()}
        return {
            **known, "status": self.status, "formulation": self.formulation, "seconds": self.seconds
        }  # fmt: skip


def certify(plan: Plan) -> Certificate:
    """Return a lower bound on what any plan of the same problem costs, or the proof that there is none.

    The whole problem is solved in a formulation that admits every state of the plan's (``soc`` for ``ac``,
    ``ac-rectangular`` and itself), with the same data, initial state, end, ramps and custom constraints, and
    without regularisation. The bound is the value of its dual, see :func:`solvers.dual_bound`; infeasibility
    is proven by a certificate, see :func:`solvers.proves_infeasible`.

    Raises
    ------
    IncompatibleError
        The formulation has no relaxation, the relaxation lacks a quantity that the objective or a constraint
        uses or is not convex, or limits are soft.

    Examples
    --------
    >>> import opfmodel as om
    >>> grid = om.Network("two-bus")
    >>> grid.north, grid.south = om.Bus(vm=(0.95, 1.05), reference=True), om.Bus(vm=(0.95, 1.05))
    >>> grid.tie = om.Branch("north", "south", r=0.01, x=0.1, rating=120)
    >>> grid.coal = om.Generator("north", p=(0, 200), q=(-80, 80), cost=om.Polynomial(0.01, 15, 0))
    >>> grid.town = om.Load("south", p=90, q=30)
    >>> certificate = om.certify(om.MultiStage(grid).solve())
    >>> round(certificate.lower), certificate.exact
    (1446, True)
    """
    if not isinstance(plan, Plan):
        raise ModelError(f"plan = {shown(plan)}: must be a plan")
    began = clock.perf_counter()
    check_bounded(plan.problem)
    problem = plan.problem.relaxed_problem
    request = _without_settings(plan)
    if plan.solution.skipped:  # the plan ends with the data, before the end of its program
        problem = problem.variant(elastic=None, horizon=plan.horizon)
        request = replace(request, horizon=plan.horizon)
    with _refused(plan.problem):
        relaxed = problem.solve_once(request)
    status = relaxed.solution.status
    infeasible = status is SolutionStatus.PROVEN_INFEASIBLE
    return Certificate(
        lower=np.nan if infeasible else _known(dual_bound(relaxed.solution)),
        upper=_minimised(plan),
        status=status_word(status),
        plan=_disproved(plan, problem) if infeasible and not plan.optimal else plan,
        formulation=problem.formulation.name,
        seconds=clock.perf_counter() - began,
    )


def check_bounded(problem: MultiStage) -> None:
    """Raise :class:`IncompatibleError` if plans of a problem cannot be certified; compiles the relaxation."""
    name = problem.formulation.name
    if problem.formulation.relaxed_by is None:
        raise IncompatibleError(
            f"bound: formulation {name!r}: no relaxation of it is known, as there is of ac"
        )
    if problem.elastic is not None:
        raise IncompatibleError(
            "bound: soft limits: the relaxation would price what exceeds them differently; use hard limits"
        )
    with _refused(problem):
        problem.relaxed_problem.compile()


@contextmanager
def _refused(problem: MultiStage) -> Iterator[None]:
    """Raise what a relaxation cannot represent as an :class:`IncompatibleError` of the bound."""
    try:
        yield
    except UnsupportedProgramError as error:
        raise IncompatibleError(
            f"bound: the relaxation {problem.formulation.relaxed_by!r} is not convex: {error}"
        ) from error
    except IncompatibleError as error:
        raise IncompatibleError(f"bound: {error}") from error


def _without_settings(plan: Plan) -> Request:
    """Return the request of a plan for a relaxation, which has neither positions nor moves of settings."""
    given, own = plan.request.initial, plan.model.settings
    initial = None if given is None else {name: values for name, values in given.items() if name not in own}
    return replace(plan.request, settings=None, initial=initial)


def _known(bound: float) -> float:
    return bound if np.isfinite(bound) else np.nan


def _minimised(plan: Plan) -> float:
    """Return what a plan costs, less the value of its final energy; NaN unless optimal."""
    price = plan.request.end.price
    if not (price and plan.optimal):
        return plan.objective
    network, probability = plan.network, plan.horizon.probability[plan.horizon.leaves]
    left = sum(
        float((plan.solution.value(f"{name}_next")[:, plan.horizon.leaves] @ probability).sum())
        * scale(state.unit, network.base_mva)
        for name, state in plan.model.states.items()
        if state.ends
    )
    return plan.objective - price * left


def _disproved(plan: Plan, relaxed: MultiStage) -> Plan:
    """Return a plan without an optimum as one that is proven not to exist."""
    solution = replace(
        plan.solution,
        status=SolutionStatus.PROVEN_INFEASIBLE,
        termination=TerminationCondition.INFEASIBLE,
        message=f"{plan.solution.message}; proven by the relaxation {relaxed.formulation.name!r}",
    )
    return plan.with_solution(plan.problem, solution)
