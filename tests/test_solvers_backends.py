"""Back ends: what comes back, why they stopped, and what they refuse."""

from __future__ import annotations

import os
import signal
import threading
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import solvers
from solvers import ProgramBuilder, SolutionStatus, TerminationCondition, total
from solvers.backends import clarabel, conic, osqp, qp
from solvers.backends.clarabel import ClarabelSession
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
    with pytest.raises(solvers.UnknownSolverError, match=r"'nonsense'; available: .*ipopt"):
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
    solve = ClarabelSession.solve

    def failing(self, *given) -> solvers.Solution:
        found = solve(self, *given)
        return replace(found, termination=termination, status=SolutionStatus.NONE, message="lost")

    monkeypatch.setattr(ClarabelSession, "solve", failing)
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


# OSQP from one instance to the next -------------------------------------------------------------


def storage(stages: int = 24) -> solvers.Program:
    """A storage between a cheap unit and a dear one; the demand is a parameter."""
    build = ProgramBuilder("storage")
    hours = np.arange(stages)
    demand = build.parameter("demand", 1, stages, [20.0 + 8.0 * np.sin(hours / 3.0)])
    power = build.variable("power", 2, stages, 0.0, [18.0, 40.0])
    stored = build.variable("stored", 1, stages, 0.0, 20.0)
    build.minimize(np.array([10.0, 30.0]) * power + 0.05 * power**2)
    charge = power[:1, 1:] + power[1:, 1:] - demand[:, 1:]
    build.constrain("balance", stored[:, 1:] - stored[:, :-1] - charge == 0.0)
    build.constrain("first", stored[:, :1] - (power[:1, :1] + power[1:, :1] - demand[:, :1]) == 0.0)
    build.constrain("ramp", power[:, 1:] - power[:, :-1] <= 3.0)
    return build.build()


def moved(program: solvers.Program, stages: int) -> solvers.Instance:
    hours = np.arange(program.parameters["demand"].stages) + stages
    return program.instance({"demand": [20.0 + 8.0 * np.sin(hours / 3.0)]})


def test_multipliers_of_a_start_save_osqp_most_of_its_iterations() -> None:
    program = storage()
    session = solvers.prepare(program, "osqp")
    cold = session.solve(program.default)
    again = session.solve(program.default, cold.start())
    values_alone = session.solve(program.default, solvers.Start(cold.x))
    assert again.iterations <= cold.iterations / 4
    assert again.iterations <= values_alone.iterations / 4
    ahead = moved(program, 1)
    warm, fresh = session.solve(ahead, cold.shifted()), session.solve(ahead)
    assert warm.iterations <= fresh.iterations
    assert warm.status is fresh.status is SolutionStatus.GLOBALLY_OPTIMAL
    assert warm.objective == pytest.approx(fresh.objective, rel=1e-5)


@given(iterations=st.lists(st.none() | st.integers(0, 30), min_size=1, max_size=4))
@settings(max_examples=8, deadline=None)
def test_what_ipopt_finds_depends_on_its_start_alone(iterations: list[int | None]) -> None:
    program = storage()
    used = solvers.prepare(program, "ipopt")
    solution = used.solve(program.default)
    for step, count in enumerate(iterations, start=1):
        start, ahead = replace(solution.shifted(), iterations=count), moved(program, step)
        solution = used.solve(ahead, start)
        fresh = solvers.prepare(program, "ipopt").solve(ahead, start)
        assert solution.iterations == fresh.iterations
        for vector in ("x", "lam_x", "lam_g"):
            assert_array_equal(getattr(solution, vector), getattr(fresh, vector))


def test_ipopt_keeps_multipliers_close_to_zero_after_an_easy_solve() -> None:
    program = storage()
    start = solvers.prepare(program, "ipopt").solve(program.default).shifted()

    def result(count: int | None, options: dict[str, float] | None = None) -> solvers.Solution:
        session = solvers.prepare(program, "ipopt", options)
        return session.solve(moved(program, 1), replace(start, iterations=count))

    close, far = (result(None, {"warm_start_mult_bound_push": push}) for push in (1e-4, 1e-2))
    assert not np.array_equal(close.lam_x, far.lam_x)
    for count, like in ((None, far), (30, far), (9, far), (8, close), (1, close)):
        assert_array_equal(result(count).lam_x, like.lam_x)
    assert close.objective == pytest.approx(far.objective, rel=1e-6)


def test_ipopt_goes_on_from_multipliers_far_from_zero_if_a_solve_is_not_as_easy_as_the_last() -> None:
    program = storage()
    first = solvers.prepare(program, "ipopt").solve(program.default)
    start, ahead = replace(first.shifted(), iterations=1), moved(program, 7)
    found = solvers.prepare(program, "ipopt").solve(ahead, start)
    assert found.iterations > 12
    assert found.objective == pytest.approx(solvers.solve(program, "ipopt", ahead).objective, rel=1e-6)
    stopped = solvers.prepare(program, "ipopt", {"max_iter": 3}).solve(ahead, start)
    assert stopped.termination is TerminationCondition.ITERATION_LIMIT
    assert stopped.iterations == 3


def test_what_osqp_finds_does_not_depend_on_what_it_solved_before() -> None:
    program = storage()
    session = solvers.prepare(program, "osqp", {"adaptive_rho_tolerance": 1.1})
    first = session.solve(program.default)
    for stages in (1, 7):
        session.solve(moved(program, stages), first.start())
    last = session.solve(program.default)
    assert last.iterations == first.iterations
    assert_allclose(last.x, first.x, atol=1e-9)
    assert_allclose(last.lam_g, first.lam_g, atol=1e-9)


def test_osqp_prints_nothing_unless_asked(capfd: pytest.CaptureFixture[str]) -> None:
    build = ProgramBuilder()
    x = build.variable("x", 1)
    build.minimize((x - 1.0) ** 2)
    solvers.solve(build.build(), "osqp")  # it has a line for an optimum without active limits
    assert capfd.readouterr().out == ""
    solvers.solve(build.build(), "osqp", verbose=True)
    assert "OSQP" in capfd.readouterr().out


def test_a_program_that_osqp_cannot_set_up_is_a_status() -> None:
    build = ProgramBuilder("not convex")
    x = build.variable("x", 1, lower=-1.0, upper=2.0)
    build.minimize(-1.0 * x**2)
    program = build.build()
    solution = osqp.OSQP().prepare(program, "osqp", {}, False).solve(program.default)
    assert solution.termination is TerminationCondition.INVALID_PROGRAM
    assert solution.status is SolutionStatus.NONE
    assert "OSQP_NONCVX_ERROR" in solution.message


@pytest.mark.parametrize(("solver", "option"), [("osqp", "max_iter"), ("qp:scs", "max_iters")])
def test_an_interrupt_is_not_lost_in_a_solver_that_takes_it(solver: str, option: str) -> None:
    if solver == "qp:scs":
        pytest.importorskip("scs")
    program = storage(200)
    endless = {option: 10**9, "eps_abs": 1e-300, "eps_rel": 0.0}
    session = solvers.prepare(program, solver, endless)
    timer = threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        session.solve(program.default)
    timer.join()


# Statuses are tables ----------------------------------------------------------------------------


def test_tables_have_every_status_of_their_solver() -> None:
    import clarabel as library
    from osqp import SolverError, SolverStatus

    names = {name for name in dir(library.SolverStatus) if name[0].isupper()}
    assert names - set(clarabel._TERMINATION) == {"Unsolved", "CallbackTerminated"}  # nothing calls back
    assert set(clarabel._TERMINATION) <= names
    names = set(SolverStatus.__members__)
    assert names - set(osqp._TERMINATION) == {"OSQP_UNSOLVED"}
    assert set(osqp._TERMINATION) <= names | set(SolverError.__members__)


def test_the_table_of_piqp_has_its_statuses() -> None:
    piqp = pytest.importorskip("piqp")
    names, table = set(piqp.Status.__members__), set(qp._KNOWN["piqp"].statuses)
    assert names - table == {"PIQP_SOLVED", "PIQP_UNSOLVED", "PIQP_INVALID_SETTINGS"}
    assert table <= names


@pytest.mark.parametrize(
    ("solver", "table"), [("clarabel", clarabel._TERMINATION), ("osqp", osqp._TERMINATION)]
)
def test_a_status_that_is_in_no_table_is_an_error_with_the_solvers_words(
    solver: str, table: dict[str, TerminationCondition], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in list(table):
        monkeypatch.delitem(table, name)
    solution = solvers.solve(storage(), solver)
    assert solution.termination is TerminationCondition.ERROR
    assert solution.status is SolutionStatus.NONE
    assert solution.message.lower() == "solved"


def test_words_of_a_message_are_no_status(monkeypatch: pytest.MonkeyPatch) -> None:
    import qpsolvers

    def refuse(*given, **options) -> None:
        raise qpsolvers.exceptions.SolverError("no time to see whether it is infeasible or unbounded")

    monkeypatch.setattr(qpsolvers, "sparse_solvers", [*qpsolvers.sparse_solvers, "mine"])
    monkeypatch.setattr(qpsolvers, "solve_problem", refuse)
    solution = solvers.solve(storage(), "qp:mine")
    assert solution.termination is TerminationCondition.ERROR
    assert "no time" in solution.message


def test_a_solver_without_a_table_has_found_an_optimum_or_not(monkeypatch: pytest.MonkeyPatch) -> None:
    import qpsolvers

    monkeypatch.setattr(qpsolvers, "sparse_solvers", [*qpsolvers.sparse_solvers, "mine"])
    for found, termination in ((True, TerminationCondition.CONVERGED), (False, TerminationCondition.ERROR)):

        def solve(problem, solver, found=found, **options) -> qpsolvers.Solution:
            return qpsolvers.Solution(
                problem, found=found, x=np.array([0.5, 1.5]), y=np.zeros(0), z=np.ones(1), z_box=np.zeros(2)
            )

        monkeypatch.setattr(qpsolvers, "solve_problem", solve)
        build = ProgramBuilder("projection")
        x = build.variable("x", 2)
        build.minimize((x - np.array([1.0, 2.0])) ** 2)
        build.constrain("half-plane", total(x) <= 2.0)
        solution = solvers.solve(build.build(), "qp:mine")
        assert solution.termination is termination
        assert solution.status.is_optimal is found


@pytest.mark.parametrize(
    ("solver", "found", "termination"),
    [
        ("ecos", {"info": {"exitFlag": -1}}, TerminationCondition.ITERATION_LIMIT),
        ("gurobi", {"model": SimpleNamespace(Status=9)}, TerminationCondition.TIME_LIMIT),
        ("gurobi", {"model": SimpleNamespace(Status=10)}, TerminationCondition.LIMIT),
        ("scs", {"info": {"status_val": -3}}, TerminationCondition.NUMERICAL_FAILURE),
        ("moreau", object(), TerminationCondition.LIMIT),
    ],
)
def test_a_limit_behind_cvxpy_is_the_solvers_own_where_it_is_passed_on(
    solver: str, found: object, termination: TerminationCondition
) -> None:
    chain = SimpleNamespace(solve_via_data=lambda *given, **options: found)
    problem = SimpleNamespace(
        get_problem_data=lambda name, solver_opts: ({}, chain, []),
        unpack_results=lambda found, chain, inverse: None,
        status="user_limit",
    )
    session = conic.ConicSession(storage(), solver, {}, False)
    assert session._call(problem) == (termination, "user_limit")


def test_a_plugin_that_reached_a_limit_says_no_more_than_that() -> None:
    quiet = dict.fromkeys(("print_header", "print_status", "print_iteration"), False)
    options = quiet | {"max_iter": 1, "qpsol_options": {"printLevel": "none"}}
    solution = solvers.solve(rosenbrock(), "ipopt:sqpmethod", options=options)
    assert solution.termination is TerminationCondition.LIMIT
    assert solution.status is SolutionStatus.NONE
