"""The performance bound: a plan costs no more than the optimal steady states of its stages."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.analysis.finding import Finding, Verdict
from opfmodel.analysis.problems import convex_problem, nominal_problem
from opfmodel.analysis.subject import EXACT, TIGHT, Subject, free
from opfmodel.errors import IncompatibleError
from opfmodel.plan import End, MultiStage, Plan
from opfmodel.plan.request import Limits, Request
from solvers import dual_bound

__all__ = ["check_performance_bound"]

Array = npt.NDArray[np.float64]

_RELATIVE = 1e-7  # of the bound; the tolerance of IPOPT on a plan

STATEMENT = (
    "Proposition 4.3: from x(0) = x_s(d(0)) and without limits on inputs, "
    "V_N(x, t) <= the sum of l(x_s, u_s) at the demands d(k) of the N stages"
)

_PRICED = 1e-4  # $/MW, a smaller price of a ramp is tolerance
_ENDLESS = (-np.inf, np.inf)
_VARIANTS = ("as it is", "without ramps", "without storage", "without ramps and storage")


def check_performance_bound(subject: Subject) -> Finding:
    """Compare the cost of the plan from the steady state with the sum of the steady states' costs.

    With and without ramps, and with and without storage power. Nothing is asked of the end of the horizon,
    which is that of the data if these end before.
    """
    problem = nominal_problem(subject.problem, _stages(subject))
    problem.solver, problem.options = "ipopt", TIGHT
    steady = _steady_costs(subject, problem.stages)
    missing = np.flatnonzero(np.isnan(steady))
    if missing.size:
        name = problem.step_name(subject.step + int(missing[0]))
        why = f"{name}: no steady state was found"
        return Finding(Verdict.UNDECIDED, STATEMENT, why, _RELATIVE, {"stages": problem.stages})
    bound = float(steady.sum()) * problem.step
    tolerance = _RELATIVE * max(1.0, abs(bound))
    plans: dict[str, Plan] = {}
    for name in _VARIANTS:
        request = Request(subject.step, subject.initial(subject.rest), End(), None, problem.horizon)
        plans[name] = problem.solve_once(request, limits=_limits(problem, name))
        subject.advance(f"performance bound: plan {name}", len(plans), len(_VARIANTS))
    values = {name: plan.objective if plan.optimal else None for name, plan in plans.items()}
    own = plans["as it is"]
    ramps = [] if not own.optimal else _binding_ramps(own)
    figures: dict[str, Any] = {
        "bound": bound,
        "value": values["as it is"],
        "saving": (bound - own.objective) / abs(bound) if own.optimal and abs(bound) > tolerance else None,
        "variants": values,
        "binding_ramps": ramps,
        "stages": problem.stages,
    }
    if not own.optimal:
        return Finding(
            Verdict.UNDECIDED, STATEMENT, f"the plan is {own.status}: {own.termination}", tolerance, figures
        )
    saved = _compared(own.objective, bound, tolerance, problem.network.currency)
    if own.objective <= bound + tolerance:
        assumed = "" if not ramps else "; ramps bind, so that the proposition itself does not apply"
        return Finding(Verdict.HOLDS, STATEMENT, saved + assumed, tolerance, figures)
    free_of = values["without ramps"]
    if free_of is None:
        cause = ""
    elif free_of <= bound + tolerance:
        binding = f", and the ramps of {', '.join(ramps[:3])} bind" if ramps else ""
        cause = f"; without ramps it holds{binding}"
    else:
        cause = "; it fails without ramps too: stored energy must differ from one steady state to the next"
    proven = _least(own) > bound + tolerance
    verdict = Verdict.VIOLATED if proven else Verdict.UNDECIDED
    return Finding(verdict, STATEMENT, saved + cause, tolerance, figures)


def _stages(subject: Subject) -> int:
    """Return the number of stages of a plan, which ends with the data unless these repeat."""
    problem = subject.problem
    known = problem.profiles.length
    if not known or problem.at_end == "repeat":
        return subject.stages
    return min(subject.stages, known - subject.step)


def _compared(value: float, bound: float, tolerance: float, currency: str) -> str:
    """Return in words how V_N compares with the bound."""
    if abs(bound - value) <= tolerance:
        return "V_N equals the bound"
    side = "below" if value < bound else "above"
    far = (
        f"{abs(bound - value) / abs(bound):.3%}"
        if abs(bound) > tolerance
        else f"{abs(bound - value):.4g} {currency}"
    )
    return f"V_N is {far} {side} the bound"


def _steady_costs(subject: Subject, stages: int) -> Array:
    """Return the cost of the steady state of each step, $/h; NaN where none was found."""
    problem = nominal_problem(subject.problem, 1)
    problem.generator_delay, problem.regularisation = 0, 0.0
    problem.solver, problem.options = "ipopt", EXACT
    costs = []
    for time in range(subject.step, subject.step + stages):
        plan = problem.solve(time, initial=free(problem), end=End(cyclic=True))
        costs.append(plan.objective / problem.step)
        subject.advance("performance bound: steady states", len(costs), stages)
    return np.array(costs)


def _limits(problem: MultiStage, variant: str) -> Limits:
    """Return the bounds that leave out ramps and storage power."""
    program = problem.compile()
    limits: dict[str, Any] = {}
    if "ramps" in variant:
        limits |= {row: _ENDLESS for row in program.rows if row.endswith(("_ramp", "_ramp_first"))}
    if "storage" in variant:
        limits |= {name: (0.0, 0.0) for name in ("ps", "pc", "pdis") if name in program.variables}
    return limits


def _binding_ramps(plan: Plan) -> list[str]:
    """Return the generators whose ramp binds in some stage."""
    if "pg_ramp_price" not in plan.model.prices:
        return []
    names = plan.network.generator.names
    price = plan.price("pg_ramp_price").max(axis=1, initial=0.0) / plan.network.base_mva
    return [name for name, most in zip(names, price, strict=True) if most > _PRICED]


def _least(plan: Plan) -> float:
    """Return a lower bound on the cost of any plan of the same problem; minus infinity if none is known."""
    problem = plan.problem.variant(elastic=None)
    problem.regularisation = 0.0
    try:
        return dual_bound(convex_problem(problem).solve_once(plan.request).solution)
    except IncompatibleError:
        return -np.inf
