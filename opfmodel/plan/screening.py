"""Screening: a secure plan from the few contingencies that it would not survive otherwise."""

from __future__ import annotations

import time as clock
from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from opfmodel.horizon import Horizon
from opfmodel.plan.request import Request
from opfmodel.plan.response import Outcome, Responses, stages_of
from opfmodel.plan.result import Plan
from solvers import SolutionStatus

if TYPE_CHECKING:
    from opfmodel.plan.multistage import MultiStage

__all__ = ["Contingency", "Round", "Screening", "worst_of"]

Contingency = tuple[int, tuple[str, ...]]  # a stage, and the components that go out after it


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


class Screening:
    """The secure plans of a problem, each from problems that include few contingencies.

    A problem is solved, and every contingency that it does not include is tested. Of those that the plan does
    not survive, the one that exceeds a limit of a component most is included, for every such component and
    stage, and the problem is solved again, until all are survived. What was included stays so in later plans.

    Parameters
    ----------
    problem
        The problem without contingencies.
    """

    def __init__(self, problem: MultiStage) -> None:
        assert problem.security is not None
        self.plain, self.security = problem, problem.security
        self.responses = Responses(problem, problem.security)
        self.begin()

    def begin(self) -> None:
        """Begin with no contingencies included, and no responses from which others start."""
        self.included: tuple[Contingency, ...] = ()
        self.problem = self.plain
        self.responses.last = {}

    def include(self, contingencies: Iterable[Contingency]) -> None:
        """Include more contingencies in the problem."""
        self.included = (*self.included, *contingencies)
        self.problem = self.plain.with_security(self.security, self.included)

    def solve(self, request: Request, previous: Plan | None, multipliers: bool) -> Plan:
        """Return the plan that survives every contingency.

        Parameters
        ----------
        previous
            An earlier plan to start from, with its multipliers or without.
        """
        rounds: list[Round] = []
        solved: list[Plan] = []
        self.responses.begin()
        while True:
            asked = replace(request, horizon=self._horizon(request))
            plan = self.problem.solve_included(asked, previous, multipliers)
            solved.append(plan)
            if rounds and plan.solution.status is SolutionStatus.NONE:  # from a start of our own making
                plan = self.problem.solve_included(asked, None, multipliers)
                solved.append(plan)
            began = clock.perf_counter()
            violated = self._violated(plan) if plan.optimal else None
            added = worst_of(violated or ())
            seconds = clock.perf_counter() - began
            rounds.append(Round(len(self.included), violated, added, plan.solution.iterations, seconds))
            if not added:
                break
            self.include((outcome.stage, (outcome.out,)) for outcome in added)
            previous, multipliers = plan, True
        self.responses.begin()
        return _with_rounds(plan, solved, rounds)

    def _horizon(self, request: Request) -> Horizon:
        """Return the horizon of a request with the contingencies that are included."""
        if request.horizon is self.plain.horizon:
            return self.problem.horizon
        return request.horizon.with_contingencies(self.included, self.security.response_minutes)

    def _violated(self, plan: Plan) -> tuple[Outcome, ...]:
        """Return what follows from the contingencies that a plan neither includes nor survives."""
        out, included = plan.request.out, set(self.included)
        possible = self.responses.possible(out)
        outcomes = (
            outcome
            for stage in stages_of(plan)
            for outcome in self.responses.outcomes(
                stage, [name for name in possible if (stage.number, (name,)) not in included], out
            )
        )
        return tuple(outcome for outcome in outcomes if outcome.status != "secure")


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
