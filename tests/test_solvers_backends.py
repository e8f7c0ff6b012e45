"""Back ends: what comes back, why they stopped, and what they refuse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import solvers
from solvers import ProgramBuilder, SolutionStatus, TerminationCondition, total
from solvers.backends.qp import QPSession
from solvers.certify import certified


def rosenbrock(**bounds) -> solvers.Program:
    build = ProgramBuilder("rosenbrock")
    x = build.variable("x", 2, start=[-1.2, 1.0], **bounds)
    build.minimize((1 - x[:1]) ** 2 + 100 * (x[1:] - x[:1] ** 2) ** 2)
    build.constrain("disc", total(x**2) <= 1.5)
    return build.build()


def test_a_solution_certifies_itself() -> None:
    solution = solvers.solve(rosenbrock())
    assert solution.status is SolutionStatus.LOCALLY_OPTIMAL
    assert solution.termination is TerminationCondition.CONVERGED
    assert solution.primal_residual < 1e-7
    assert solution.dual_residual < 1e-5
    assert solution.gap < 1e-5
    assert solution.iterations > 0
    wrong = solvers.solve(rosenbrock(), options={"max_iter": 2})
    assert wrong.termination is TerminationCondition.ITERATION_LIMIT
    assert wrong.status is SolutionStatus.NONE
    assert wrong.dual_residual > 1e-2


@pytest.mark.parametrize("name", ["x", "lam_x", "lam_g"])
def test_what_is_not_a_number_is_no_optimum(name: str) -> None:
    build = ProgramBuilder("two numbers")
    x = build.variable("x", 2, lower=0.0)
    build.minimize(total(x))
    build.constrain("enough", total(x) >= 1.0)
    solution = solvers.solve(build.build(), "qp")
    assert certified(solution).status is SolutionStatus.GLOBALLY_OPTIMAL
    broken = replace(solution, **{name: np.full_like(getattr(solution, name), np.nan)})
    assert certified(broken).status is SolutionStatus.NONE
    assert np.isnan(max(broken.primal_residual, broken.dual_residual, key=np.isnan))


def test_multipliers_have_the_documented_signs() -> None:
    build = ProgramBuilder()
    x = build.variable("x", 2, lower=[0.0, -10.0], upper=[10.0, 2.0])
    build.minimize(x**2 - np.array([-4.0, 12.0]) * x)
    build.constrain("low", x[1:] + x[:1] >= 1.0)
    solution = solvers.solve(build.build(), "ipopt", options={"tol": 1e-10})
    assert_allclose(solution.value("x").ravel(), [0.0, 2.0], atol=1e-8)
    assert_allclose(
        solution.bound_dual("x").ravel(), [-4.0, 8.0], atol=1e-6
    )  # lower negative, upper positive
    assert_allclose(solution.dual("low"), 0.0, atol=1e-6)
    assert solution.status is SolutionStatus.GLOBALLY_OPTIMAL


def test_a_multiplier_is_the_change_of_the_optimum() -> None:
    def optimum(demand: float) -> solvers.Solution:
        build = ProgramBuilder()
        x = build.variable("x", 1)
        d = build.parameter("d", 1, value=demand)
        build.minimize(3 * x**2)
        build.constrain("balance", x - d == 0.0)
        return solvers.solve(build.build(), "ipopt", options={"tol": 1e-10})

    slope = (optimum(2.001).objective - optimum(1.999).objective) / 0.002
    assert -optimum(2.0).dual("balance")[0, 0] == pytest.approx(slope, rel=1e-6)


def test_cones_reach_a_nonlinear_solver_and_their_multipliers_return() -> None:
    build = ProgramBuilder()
    x = build.variable("x", 2, 1)
    t = build.variable("t", 1)
    build.minimize(t)
    build.cone("norm", t, x[:1] - 3.0, x[1:] - 4.0)
    build.constrain("fixed", x == 0.0)
    solution = solvers.solve(build.build(), "ipopt", options={"tol": 1e-10})
    assert solution.objective == pytest.approx(5.0, abs=1e-7)
    assert_allclose(solution.cone_dual("norm").ravel(), [1.0, 0.6, 0.8], atol=1e-6)
    assert solution.dual_residual < 1e-6
    assert solution.primal_residual < 1e-7


def test_infeasible_is_a_status_and_not_an_exception() -> None:
    build = ProgramBuilder()
    x = build.variable("x", 1, lower=0.0, start=1.0)
    build.constrain("curve", np.exp(x) <= 0.5)
    solution = solvers.solve(build.build())
    assert solution.status is SolutionStatus.LOCALLY_INFEASIBLE
    assert solution.termination is TerminationCondition.INFEASIBLE


def test_shifted_moves_every_block_and_keeps_its_last_stage() -> None:
    build = ProgramBuilder()
    target = np.array([[1.0, 2.0, 3.0, 4.0]])
    x, s = build.variable("x", 1, 4), build.variable("static", 1)
    build.minimize((x - target) ** 2)
    build.minimize((s - 9.0) ** 2)
    build.constrain("cap", x <= 2.5)
    solution = solvers.solve(build.build())
    program = solution.program
    ahead = solution.shifted()
    assert_allclose(program.variables["x"].read(ahead.x), [[2, 2.5, 2.5, 2.5]], atol=1e-4)
    assert_allclose(program.variables["static"].read(ahead.x), [[9.0]], atol=1e-4)
    assert_allclose(program.rows["cap"].read(ahead.lam_g), [[0, 1, 1, 3]], atol=1e-2)
    assert_allclose(program.variables["x"].read(solution.shifted(3).x), [[2.5] * 4], atol=1e-4)


def test_a_warm_start_needs_fewer_iterations() -> None:
    session = solvers.prepare(rosenbrock())
    cold = session.solve(rosenbrock().default)
    warm = session.solve(cold.program.default, cold.start())
    assert warm.iterations < cold.iterations / 2
    assert warm.objective == pytest.approx(cold.objective, abs=1e-6)


def test_the_next_instance_reuses_the_session() -> None:
    build = ProgramBuilder()
    x = build.variable("x", 1, lower=0.0)
    d = build.parameter("d", 1, value=1.0)
    build.minimize((x - d) ** 2)
    session = solvers.prepare(build.build())
    program = build.build()
    for demand in (1.0, 5.0, -3.0):
        solution = session.solve(program.instance({"d": demand}))
        assert solution.value("x")[0, 0] == pytest.approx(max(demand, 0.0), abs=1e-5)


def test_options_reach_the_solver_and_bad_ones_are_named() -> None:
    assert solvers.solve(rosenbrock(), options={"max_iter": 1}).iterations == 1
    with pytest.raises(solvers.SolverOptionError, match="no_such_option"):
        solvers.solve(rosenbrock(), options={"no_such_option": 1})


def test_an_unknown_solver_is_refused_with_what_is_installed() -> None:
    with pytest.raises(
        solvers.UnknownSolverError, match=r"no solver 'nonsense' here; installed are: .*ipopt"
    ):
        solvers.solve(rosenbrock(), "nonsense")


@pytest.mark.parametrize(
    ("termination", "asked_again"),
    [
        (TerminationCondition.NUMERICAL_FAILURE, True),
        (TerminationCondition.ERROR, True),
        (TerminationCondition.TIME_LIMIT, False),
        (TerminationCondition.INTERRUPTED, False),
    ],
)
def test_auto_asks_another_back_end_where_the_first_finds_nothing(
    termination: TerminationCondition, asked_again: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    build = ProgramBuilder()
    x = build.variable("x", 2, lower=1.0, upper=4.0)
    build.minimize((x - 3.0) ** 2)
    program = build.build()
    sessions = {name: solvers.prepare(program, name) for name in ("auto", "qp")}
    solve = QPSession.solve

    def failing(self, *given) -> solvers.Solution:
        found = solve(self, *given)
        return replace(found, termination=termination, status=SolutionStatus.NONE, message="lost")

    monkeypatch.setattr(QPSession, "solve", failing)
    solution = sessions["auto"].solve(program.default)
    assert solution.status.is_optimal is asked_again
    assert ("clarabel failed: lost" in solution.message) is asked_again
    assert sessions["qp"].solve(program.default).status is SolutionStatus.NONE  # the user's own choice stands


def test_another_plugin_of_casadi_solves_the_same_program() -> None:
    reference = solvers.solve(rosenbrock())
    quiet = dict.fromkeys(("print_header", "print_status", "print_iteration"), False)
    other = solvers.solve(
        rosenbrock(), "ipopt:sqpmethod", options=quiet | {"qpsol_options": {"printLevel": "none"}}
    )
    assert other.solver == "sqpmethod"
    assert other.objective == pytest.approx(reference.objective, abs=1e-5)
