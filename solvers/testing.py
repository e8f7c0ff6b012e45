"""Contract checks for back ends, with small problems whose solutions are known.

    >>> from solvers.backends.ipopt import Ipopt
    >>> check_back_end(Ipopt())

In the spirit of scikit-learn's ``check_estimator``: a check passes silently or raises a
:class:`ContractError` that names the broken rule.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from solvers.builder import ProgramBuilder
from solvers.errors import SolverOptionError
from solvers.expression import total
from solvers.program import Program
from solvers.solution import Solution
from solvers.solve import BackEnd, recall_session, session_memory
from solvers.status import SolutionStatus, TerminationCondition
from solvers.structure import classify

__all__ = ["Contract", "ContractError", "SmallProblem", "check_back_end", "small_problems"]


_SAME = 1e-9


class ContractError(AssertionError):
    """A class breaks a rule of its contract; the message names the class and the rule."""


@dataclass(frozen=True)
class Contract:
    """Rules for one subject; a broken rule raises :class:`ContractError`.

    Attributes
    ----------
    subject
        Object under test, for messages: ``objective Economic``.
    """

    subject: str

    def require(self, holds: object, rule: str, found: str = "") -> None:
        """Raise unless the rule ``holds``; ``found`` describes the actual result."""
        if not holds:
            raise ContractError(f"{self.subject} breaks the rule '{rule}'{found and f': {found}'}")

    @contextmanager
    def rule(self, rule: str) -> Iterator[None]:
        """Report any exception in the block as a broken rule."""
        try:
            yield
        except ContractError:
            raise
        except Exception as error:  # any exception breaks the rule
            reason = f"{type(error).__name__}: {error}".partition("\n")[0]
            raise ContractError(f"{self.subject} breaks the rule '{rule}': {reason}") from error


# Problems -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SmallProblem:
    """A program with a known optimum.

    Attributes
    ----------
    primal
        Optimal values by variable block, ``(items, stages)``.
    dual, bound_dual, cone_dual
        Multipliers by row block, variable block and cone block, signed as in
        :class:`solvers.Solution`.
    """

    name: str
    program: Program
    objective: float
    primal: Mapping[str, npt.ArrayLike]
    dual: Mapping[str, npt.ArrayLike] = field(default_factory=dict)
    bound_dual: Mapping[str, npt.ArrayLike] = field(default_factory=dict)
    cone_dual: Mapping[str, npt.ArrayLike] = field(default_factory=dict)


def small_problems() -> list[SmallProblem]:
    """Return problems of every kind, each with a unique optimum and unique multipliers."""
    return [_bounds_only(), _dispatch(), _projection(), _tracking(), _disc(), _hyperbola()]


def _bounds_only() -> SmallProblem:
    """Minimise x - 2 y subject to 1 <= x and y <= 3, without rows."""
    build = ProgramBuilder("bounds only")
    x = build.variable("x", 1, lower=1.0, upper=9.0)
    y = build.variable("y", 1, lower=-9.0, upper=3.0)
    build.minimize(x - 2.0 * y)
    return SmallProblem(
        "bounds only", build.build(), -5.0, {"x": [[1.0]], "y": [[3.0]]}, {}, {"x": [[-1.0]], "y": [[2.0]]}
    )


def _dispatch() -> SmallProblem:
    """Two units and a fixed one serve demand over two stages: equations, ranges, fixed variables."""
    build = ProgramBuilder("dispatch")
    demand = build.parameter("demand", 1, 2, [[8.0, 4.0]])
    power = build.variable("power", 2, 2, 0.0, [5.0, 20.0])
    fixed = build.variable("fixed", 1, 2, 1.0, 1.0)
    build.minimize(np.array([10.0, 20.0]) * power)
    build.minimize(3.0 * fixed)
    build.constrain("balance", total(power) + fixed - demand == 0.0)
    rows = build.rows("range", 1, 2, -10.0, 10.0)
    build.add(power[:1], into=rows)
    return SmallProblem(
        "dispatch",
        build.build(),
        50.0 + 40.0 + 30.0 + 6.0,
        {"power": [[5.0, 3.0], [2.0, 0.0]], "fixed": [[1.0, 1.0]]},
        {"balance": [[-20.0, -10.0]], "range": [[0.0, 0.0]]},
        {"power": [[10.0, 0.0], [0.0, -10.0]], "fixed": [[17.0, 7.0]]},
    )


def _projection() -> SmallProblem:
    """The point of a half-plane nearest to (1, 2)."""
    build = ProgramBuilder("projection")
    x = build.variable("x", 2)
    build.minimize((x - np.array([1.0, 2.0])) ** 2)
    build.constrain("half-plane", total(x) <= 2.0)
    return SmallProblem("projection", build.build(), 0.5, {"x": [[0.5], [1.5]]}, {"half-plane": [[1.0]]})


def _tracking() -> SmallProblem:
    """A state follows a target and rises by at most 1 per stage."""
    build = ProgramBuilder("tracking")
    target = build.parameter("target", 1, 3, [[0.0, 2.0, 2.0]])
    x = build.variable("x", 1, 3)
    build.minimize((x - target) ** 2)
    build.constrain("rate", x[:, 1:] - x[:, :-1] <= 1.0)
    return SmallProblem("tracking", build.build(), 0.5, {"x": [[0.5, 1.5, 2.0]]}, {"rate": [[1.0, 0.0]]})


def _disc() -> SmallProblem:
    """Minimise x + y on the unit disc."""
    build = ProgramBuilder("disc")
    x, y = build.variable("x", 1), build.variable("y", 1)
    build.minimize(x + y)
    build.cone("disc", 1.0, x, y)
    root = np.sqrt(2.0)
    optimum = {"x": [[-1 / root]], "y": [[-1 / root]]}
    return SmallProblem(
        "disc", build.build(), -root, optimum, cone_dual={"disc": [[[root]], [[1.0]], [[1.0]]]}
    )


def _hyperbola() -> SmallProblem:
    """Minimise x + y above the hyperbola x y = 4."""
    build = ProgramBuilder("hyperbola")
    x, y = (build.variable(name, 1, lower=0.1, start=3.0) for name in "xy")
    build.minimize(x + y)
    build.constrain("above", x * y >= 4.0)
    return SmallProblem("hyperbola", build.build(), 4.0, {"x": [[2.0]], "y": [[2.0]]}, {"above": [[-0.5]]})


def _impossible() -> Program:
    """Two variables between 0 and 1 must sum to at least 3."""
    build = ProgramBuilder("impossible")
    x = build.variable("x", 2, lower=0.0, upper=1.0)
    build.minimize(x)
    build.constrain("above", total(x) >= 3.0)
    return build.build()


def _endless() -> Program:
    """Minimise -x, which is unbounded."""
    build = ProgramBuilder("endless")
    x = build.variable("x", 1, lower=0.0)
    build.minimize(-x)
    return build.build()


# The contract -------------------------------------------------------------------------------------


def check_back_end(end: BackEnd, solver: str | None = None, tolerance: float = 1e-4) -> None:
    """Raise :class:`ContractError` unless a back end keeps its contract.

    It must state its name, the kind it accepts and its installed solvers; solve small programs of
    all kinds that it accepts, with the correct optimum, multipliers and certificate; solve further
    instances; report programs that cannot be solved as a status; and reject an unknown option.

    Parameters
    ----------
    solver
        One of its solvers; None selects the default.
    tolerance
        Allowed error of values and multipliers.
    """
    rules = Contract(f"back end {type(end).__name__}")
    rules.require(isinstance(getattr(end, "name", None), str) and end.name, "has a name")
    with rules.rule("names its installed solvers"):
        offered = list(end.solvers())
    rules.require(offered and all(isinstance(name, str) for name in offered), "names its installed solvers")
    solver = offered[0] if solver is None else solver
    problems = [p for p in small_problems() if classify(p.program).kind <= end.accepts]
    rules.require(problems, "accepts a kind of program")
    for problem in problems:
        with rules.rule(f"solves '{problem.name}'"):
            solution = end.prepare(problem.program, solver, {}, False).solve(problem.program.default)
        _check_optimum(rules, problem, solution, tolerance)
        called = solution.solver.rpartition(":")[2]  # "windows:ipopt"
        rules.require(called in offered, "reports which solver it called", repr(solution.solver))
    _check_instances(rules, end, solver, tolerance)
    _check_failures(rules, end, solver)


def _check_optimum(rules: Contract, problem: SmallProblem, solution: Solution, tolerance: float) -> None:
    name = problem.name
    found = f"{solution.status.value} ({solution.termination.value}: {solution.message})"
    rules.require(solution.status.is_optimal, f"solves '{name}'", found)
    right = abs(solution.objective - problem.objective) <= tolerance * (1.0 + abs(problem.objective))
    rules.require(
        right, f"finds the optimum of '{name}'", f"{solution.objective:g} is not {problem.objective:g}"
    )
    answers: tuple[tuple[str, Any, Mapping[str, npt.ArrayLike]], ...] = (
        ("values", solution.value, problem.primal),
        ("multipliers of rows", solution.dual, problem.dual),
        ("multipliers of bounds", solution.bound_dual, problem.bound_dual),
        ("multipliers of cones", solution.cone_dual, problem.cone_dual),
    )
    for what, read, expected in answers:
        for block, wanted in expected.items():
            wrong = np.abs(read(block) - np.asarray(wanted)).max() > tolerance * (1.0 + np.abs(wanted).max())
            rules.require(
                not wrong,
                f"returns the {what} of '{name}'",
                f"{block} = {read(block).tolist()} is not {np.asarray(wanted).tolist()}",
            )
    residual = max(solution.primal_residual, solution.dual_residual)
    rules.require(residual <= 10 * tolerance, f"certifies '{name}'", f"the residual is {residual:.1e}")
    effort = (solution.iterations is None or solution.iterations >= 0) and solution.seconds >= 0.0
    rules.require(effort, "reports its effort", f"{solution.iterations} iterations, {solution.seconds} s")


def _check_instances(rules: Contract, end: BackEnd, solver: str, tolerance: float) -> None:
    """One session solves successive instances, with other parameters and bounds, cold and warm."""
    program = _dispatch().program
    session = end.prepare(program, solver, {}, False)
    before: Solution | None = None
    for demand, most, objective in (
        ([8.0, 4.0], 5.0, 126.0),
        ([3.0, 2.0], 5.0, 36.0),
        ([8.0, 4.0], 1.0, 186.0),
    ):
        instance = program.instance({"demand": [demand]}, upper={"power": [most, 20.0]})
        for start in (None, None if before is None else before.start()):
            with rules.rule("solves the next instance"):
                solution = session.solve(instance, start)
            found = f"objective {solution.objective:g} is not {objective:g}"
            right = abs(solution.objective - objective) <= tolerance * (1.0 + objective)
            rules.require(solution.status.is_optimal and right, "solves the next instance", found)
            rules.require(solution.instance is instance, "returns the instance that it solved")
        before = solution
    with rules.rule("solves in a new session, with the memory of another, as that one would"):
        resumed = end.prepare(program, solver, {}, False)
        recall_session(resumed, session_memory(session))
        instance = program.instance({"demand": [[6.0, 4.0]]})
        start = None if before is None else before.start()
        one, other = (each.solve(instance, start) for each in (session, resumed))
    same = one.iterations == other.iterations and np.allclose(one.x, other.x, rtol=_SAME, atol=_SAME)
    rule = "solves in a new session, with the memory of another, as that one would"
    rules.require(same, rule, f"{one.iterations} and {other.iterations} iterations")


def _check_failures(rules: Contract, end: BackEnd, solver: str) -> None:
    """A program that cannot be solved gives a status; an unknown option raises an error."""
    program = _impossible()
    with rules.rule("reports infeasibility as a status"):
        solution = end.prepare(program, solver, {}, False).solve(program.default)
    able = (SolutionStatus.LOCALLY_INFEASIBLE, SolutionStatus.PROVEN_INFEASIBLE)
    infeasible = solution.termination is TerminationCondition.INFEASIBLE and solution.status in able
    rules.require(
        infeasible, "reports infeasibility as a status", f"{solution.termination}, {solution.status}"
    )
    program = _endless()
    with rules.rule("reports unboundedness as a status"):
        solution = end.prepare(program, solver, {}, False).solve(program.default)
    claimed = solution.status is not SolutionStatus.NONE
    rules.require(not claimed, "reports unboundedness as a status", f"it is {solution.status.value}")
    rule = "raises SolverOptionError for an unknown option"
    program = _dispatch().program
    try:
        end.prepare(program, solver, {"no_such_option": 1}, False).solve(program.default)
    except SolverOptionError:
        return
    except Exception as error:
        rules.require(False, rule, f"{type(error).__name__}: {error}")
    rules.require(False, rule)
