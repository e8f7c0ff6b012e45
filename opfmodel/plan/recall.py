"""What solves leave behind for later ones, as plain data: to be stored, and put back in another process.

The next solve of a problem depends on its arguments, and besides on

- the plan that it starts from (:func:`plan_memory`),
- the contingencies that screening has found so far, and the plans of responses to outages from which the next
  ones start,
- what the sessions of the back ends remember, see :func:`solvers.session_memory`; those of the problems that
  were made from it as well.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from opfmodel.plan.request import Request
from opfmodel.plan.result import Plan
from solvers import Evaluator, Solution, SolutionStatus, TerminationCondition, recall_session, session_memory

if TYPE_CHECKING:
    from opfmodel.plan.multistage import MultiStage

__all__ = ["Memory", "plan_memory", "problem_memory", "recall_problem", "recalled_plan"]

Memory = Mapping[str, Any]  # nested mappings, lists, numbers, texts and arrays

# Problems that are made from another one when they are first needed: by name, the cached attribute of the
# other that shows whether this has happened, and how to get there.
_MADE: dict[str, tuple[str, Callable[[Any], MultiStage]]] = {
    "expected": ("expected_problem", lambda problem: problem.expected_problem),
    "shortage": ("shortage_problems", lambda problem: problem.shortage_problems[0]),
    "rationed": ("shortage_problems", lambda problem: problem.shortage_problems[1]),
    "shedding": ("split_shedding_problem", lambda problem: problem.split_shedding_problem),
    "short": ("_short", lambda problem: problem._short),
    "screened": ("screening", lambda problem: problem.screening.problem),
    "responses": ("screening", lambda problem: problem.screening.responses.problem),
}


def problem_memory(problem: MultiStage) -> dict[str, Any]:
    """Return what later solves of a problem depend on, besides their arguments; empty if on nothing."""
    found = {}
    for path, made in _kin(problem):
        own: dict[str, Any] = {}
        if "screening" in vars(made):
            own["screening"] = _screening_memory(made)
        if "_compiled" in vars(made) and (remembered := session_memory(made.session)):
            own["session"] = remembered
        if own:
            found[path] = own
    return found


def recall_problem(problem: MultiStage, memory: Memory) -> None:
    """Put back what :func:`problem_memory` returned; an empty memory is that of a new problem."""
    for _, made in _kin(problem):
        if "screening" in vars(made):
            made.screening.begin()
        if "_compiled" in vars(made):
            recall_session(made.session, {})
    for path, own in memory.items():
        made = _at(problem, path)
        if "screening" in own:
            _recall_screening(made, own["screening"])
        if "session" in own:
            recall_session(made.session, own["session"])


def plan_memory(problem: MultiStage, plan: Plan) -> dict[str, Any]:
    """Return what an optimal plan must have to be the start of another.

    Parameters
    ----------
    problem
        The problem of the plan, or the one from which that was made.
    """
    solution, request = plan.solution, plan.request
    program = solution.program
    compiled = ((path, made) for path, made in _kin(problem) if "_compiled" in vars(made))
    return {
        "of": next(path for path, made in compiled if made.compile() is program),
        "time": request.time,
        "out": request.out,
        "probability": request.horizon.probability,
        "contingencies": request.horizon.out,
        "skipped": solution.skipped,
        "x": solution.x,
        "lam_x": solution.lam_x,
        "lam_g": solution.lam_g,
        "z": solution.z,
        "status": solution.status.value,
        "solver": solution.solver,
        "iterations": solution.iterations,
    }


def recalled_plan(problem: MultiStage, memory: Memory) -> Plan:
    """Return a plan from which another can start as it could from the one of :func:`plan_memory`.

    Its data are those that are realised; it took no time.
    """
    made = _at(problem, memory["of"])
    horizon, probability = made.horizon, memory["probability"]
    out = tuple(tuple(names) for names in memory["contingencies"])
    if out != horizon.out or not np.array_equal(probability, horizon.probability):
        horizon = replace(horizon, probability=probability, out=out)
    request = Request(memory["time"], None, made.end, None, horizon, tuple(memory["out"]))
    instance, network = made.pose(request)
    program = made.compile()
    solution = Solution(
        program=program,
        evaluator=Evaluator(program),
        instance=instance,
        **{name: memory[name] for name in ("x", "lam_x", "lam_g", "z", "skipped", "solver", "iterations")},
        termination=TerminationCondition.CONVERGED,
        status=SolutionStatus(memory["status"]),
        message="recalled",
        seconds=0.0,
    )
    return Plan(made, made.model, solution, network, request)


def _kin(problem: MultiStage, path: str = "") -> Iterator[tuple[str, MultiStage]]:
    """Yield a problem and those that were made from it, with the names that lead there."""
    yield path, problem
    for name, (attribute, get) in _MADE.items():
        if attribute in vars(problem) and (made := get(problem)) is not problem:
            yield from _kin(made, f"{path}/{name}")


def _at(problem: MultiStage, path: str) -> MultiStage:
    for name in path.split("/")[1:]:
        _, get = _MADE[name]
        problem = get(problem)
    return problem


def _screening_memory(problem: MultiStage) -> dict[str, Any]:
    screening = problem.screening
    last = {
        out: plan_memory(screening.responses.problem, plan) for out, plan in screening.responses.last.items()
    }
    return {"included": screening.included, "responses": last}


def _recall_screening(problem: MultiStage, memory: Memory) -> None:
    screening = problem.screening
    if memory["included"]:
        screening.include((stage, tuple(out)) for stage, out in memory["included"])
    responses = screening.responses
    responses.last = {
        out: recalled_plan(responses.problem, plan) for out, plan in memory["responses"].items()
    }
