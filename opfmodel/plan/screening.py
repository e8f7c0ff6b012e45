"""Screening: a secure plan from the few contingencies that it would not survive otherwise."""

from __future__ import annotations

import time as clock
from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from opfmodel.plan.request import Request
from opfmodel.plan.response import Outcome, stages_of
from opfmodel.plan.result import Plan
from solvers import SolutionStatus

if TYPE_CHECKING:
    from opfmodel.plan.multistage import MultiStage

__all__ = ["Round", "screened", "worst_of"]


class Round(NamedTuple):
    """One round of screening.

    Attributes
    ----------
    included
        Contingencies in the problem that was solved.
    violated
        Outcomes of the others that the plan did not survive, or that are not known; None if there is no plan.
    added
        Those of them that the next problem included.
    iterations, seconds
        Effort of the solver, and time that testing the plan took.
    """

    included: int
    violated: tuple[Outcome, ...] | None
    added: tuple[Outcome, ...]
    iterations: int | None
    seconds: float

    def as_dict(self) -> dict[str, Any]:
        """Return the round as plain data."""
        named = [{"out": o.out, "scenario": o.scenario, "stage": o.stage} for o in self.added]
        violated = None if self.violated is None else len(self.violated)
        return {**self._asdict(), "violated": violated, "added": named}


def screened(problem: MultiStage, request: Request, previous: Plan | None, multipliers: bool) -> Plan:
    """Return the plan that survives every contingency, from problems that include few of them.

    A plan without contingencies is solved, and every contingency tested. Of those that it does not survive,
    the one that exceeds a limit of a component most is included, for every such component and stage, and
    the problem is solved again, until all are survived. What was included stays so in later plans.

    Parameters
    ----------
    previous
        An earlier plan to start from, with its multipliers or without.
    """
    security = problem.security
    assert security is not None
    responses, rounds, solved = problem.responses, list[Round](), list[Plan]()
    responses.begin()
    possible = responses.possible(request.out)
    while True:
        secured, horizon = problem.secured, request.horizon
        if horizon is problem.horizon:
            horizon = secured.horizon
        elif problem.included:
            horizon = horizon.with_contingencies(problem.included, security.response_minutes)
        asked = replace(request, horizon=horizon)
        plan = secured.solve_included(asked, previous, multipliers)
        solved.append(plan)
        if rounds and plan.solution.status is SolutionStatus.NONE:  # from a start of our own making
            plan = secured.solve_included(asked, None, multipliers)
            solved.append(plan)
        began = clock.perf_counter()
        violated = None
        if plan.optimal:
            included = set(problem.included)
            violated = tuple(
                outcome
                for stage in stages_of(plan)
                for outcome in responses.outcomes(
                    stage, [out for out in possible if (stage.number, (out,)) not in included], request.out
                )
                if outcome.status != "secure"
            )
        added = worst_of(violated or ())
        seconds = clock.perf_counter() - began
        rounds.append(Round(len(problem.included), violated, added, plan.solution.iterations, seconds))
        if not added:
            break
        problem.include((outcome.stage, (outcome.out,)) for outcome in added)
        previous, multipliers = plan, True
    responses.begin()
    return _with_rounds(plan, solved, rounds)


def worst_of(violated: Iterable[Outcome]) -> tuple[Outcome, ...]:
    """Return the worst outcome of each component and stage, and all without a shortfall that is known."""
    made: dict[object, Outcome] = {}
    for outcome in violated:
        worst = outcome.worst
        key = (outcome.stage, outcome.out if worst is None else (worst.kind, worst.name))
        held = made.get(key)
        if held is None or (worst and held.worst and worst.value > held.worst.value):
            made[key] = outcome
    return tuple(made.values())


def _with_rounds(plan: Plan, solved: list[Plan], rounds: list[Round]) -> Plan:
    """Return a plan with the rounds that led to it, and their effort."""
    counted = [p.solution.iterations for p in solved if p.solution.iterations is not None]
    solution = replace(
        plan.solution,
        iterations=sum(counted) if counted else None,
        seconds=sum(p.solution.seconds for p in solved) + sum(r.seconds for r in rounds),
    )
    made = plan.with_solution(plan.problem, solution)
    made.rounds = tuple(rounds)
    return made
