"""Every back end and solver on programs whose primal and dual answers are known."""

from __future__ import annotations

import functools

import numpy as np
import numpy.typing as npt
import pytest
from conformance import CASES, Answer, Case
from hypothesis import given
from hypothesis import strategies as st

import solvers
from solvers import Kind, ProgramBuilder, SolutionStatus, TerminationCondition, total
from solvers.backends.clarabel import ClarabelSession
from solvers.backends.osqp import OSQPSession

# Largest error, relative to the size of an answer or to 1. Interior-point methods stop at 1e-6 to 1e-8 of
# residuals and complementarity, which is what these programs' answers inherit. First-order methods
# stop at 1e-6 to 1e-7 of residuals scaled by themselves, and more where polishing finds no active set.
INTERIOR, FIRST_ORDER = 1e-6, 1e-4
TOLERANCE = {"osqp": FIRST_ORDER, "scs": FIRST_ORDER}
# On the round side of a cone a gap of 1e-8 leaves its square root to directions along the surface.
ROUND = 1e-3

LOCAL = (
    "expanded:expanded",
    "ipopt:ipopt",
    "windows:ipopt",
)  # solve nonlinear programs, without certificates


def installed() -> list[str]:
    """Every solver of every back end; of the plugins of CasADi, and of windows, IPOPT alone is tested here."""
    return [
        f"{end.name}:{solver}"
        for end in solvers.back_ends().values()
        for solver in end.solvers()
        if end.name not in ("ipopt", "windows") or solver == "ipopt"
    ]


@functools.cache
def built(name: str) -> Case:
    return CASES[name]()


def accepted() -> list[tuple[str, str]]:
    ends = solvers.back_ends()
    return [
        (label, name)
        for label in installed()
        for name in CASES
        if ends[label.partition(":")[0]].accepts >= built(name).kind
    ]


SOLVED = [(label, name) for label, name in accepted() if built(name).answers]
UNSOLVABLE = [(label, name) for label, name in accepted() if built(name).without]


def assert_near(found: npt.ArrayLike, wanted: npt.ArrayLike, tolerance: float, what: str) -> None:
    want, got = np.asarray(wanted, dtype=float).ravel(), np.ravel(np.asarray(found), order="F")
    assert got.shape == want.shape, what
    error = np.abs(got - want).max() / max(1.0, np.abs(want).max())
    assert error <= tolerance, f"{what}: {got} is not {want} (error {error:.1e})"


def assert_answer(solution: solvers.Solution, answer: Answer, label: str, kind: Kind) -> None:
    tolerance = TOLERANCE.get(label.partition(":")[2], INTERIOR)
    duals = max(tolerance, ROUND) if kind == Kind.CONIC else tolerance
    assert solution.termination is TerminationCondition.CONVERGED
    assert_near(solution.objective, answer.objective, tolerance, "objective")
    for found, by_block, allowed in (
        (solution.value, answer.values, duals),
        (solution.dual, answer.duals, duals),
        (solution.bound_dual, answer.bound_duals, duals),
        (solution.cone_dual, answer.cone_duals, duals),
    ):
        for block, wanted in by_block.items():
            assert_near(found(block), wanted, allowed, f"{found.__name__} {block}")
    size = 1 + abs(answer.objective)
    assert solution.primal_residual <= tolerance * size
    assert solution.dual_residual <= tolerance * size
    assert solution.gap <= 10 * tolerance * size


@pytest.mark.parametrize("name", CASES)
def test_the_kind_of_a_case_is_derived(name: str) -> None:
    assert solvers.classify(built(name).program).kind is built(name).kind


@pytest.mark.parametrize(("label", "name"), SOLVED)
def test_primal_and_dual_answers(label: str, name: str) -> None:
    case = built(name)
    session = solvers.prepare(case.program, label)  # one for all instances
    for answer in case.answers:
        solution = session.solve(case.program.instance(answer.parameters))
        assert solution.status is case.status
        assert_answer(solution, answer, label, case.kind)


@pytest.mark.parametrize(("label", "name"), SOLVED)
def test_a_start_at_the_answer_changes_nothing_but_effort(label: str, name: str) -> None:
    case = built(name)
    session = solvers.prepare(case.program, label)
    instance = case.program.instance(case.answers[0].parameters)
    cold = session.solve(instance)
    warm = session.solve(instance, cold.start())
    assert_answer(warm, case.answers[0], label, case.kind)
    if label.endswith(":osqp") or label in LOCAL:  # that take starts; OSQP counts in steps of 25
        assert warm.iterations is not None
        assert cold.iterations is not None
        assert warm.iterations <= cold.iterations


@pytest.mark.parametrize("label", [label for label in installed() if label not in LOCAL])
def test_an_instance_may_have_entries_where_the_last_had_none(label: str) -> None:
    """min c x²/2 - 6x with x <= 10: x = 6/c, and 10 where there is no curvature."""
    program = built("parameter_in_the_hessian").program
    session = solvers.prepare(program, label)
    for c, x in ((0.0, 10.0), (2.0, 3.0), (0.0, 10.0), (3.0, 2.0)):
        solution = session.solve(program.instance({"c": c}))
        tolerance = TOLERANCE.get(label.partition(":")[2], INTERIOR)
        assert_near(solution.value("x"), [x], tolerance, f"x for c = {c}")
        assert_near(
            solution.bound_dual("x"), [6.0 if c == 0.0 else 0.0], tolerance, f"multiplier for c = {c}"
        )


@pytest.mark.parametrize(("label", "name"), UNSOLVABLE)
def test_why_there_is_no_answer(label: str, name: str) -> None:
    case = built(name)
    solution = solvers.solve(case.program, label, options={"max_iter": 500} if label in LOCAL else {})
    assert not solution.status.is_optimal
    if label == "qp:highs":  # qpsolvers passes on neither its status nor a certificate
        assert solution.termination is TerminationCondition.ERROR
        assert "no reason" in solution.message
    elif label in LOCAL:  # has no certificates, and need not notice that a cost falls for ever
        assert solution.termination in (case.without, TerminationCondition.ITERATION_LIMIT)
        local = solution.termination is TerminationCondition.INFEASIBLE
        assert solution.status is (SolutionStatus.LOCALLY_INFEASIBLE if local else SolutionStatus.NONE)
        assert local or case.without is TerminationCondition.UNBOUNDED
    else:
        assert solution.termination is case.without
        assert solution.status is case.status


LIMITS = {"clarabel": TerminationCondition.ITERATION_LIMIT, "osqp": TerminationCondition.ITERATION_LIMIT}


@pytest.mark.parametrize("label", [label for label in installed() if label not in LOCAL])
def test_limits_are_statuses(label: str) -> None:
    """A solver that is stopped early says so and claims nothing."""
    limit = {
        "qp:scs": {"max_iters": 1}, "conic:scs": {"max_iters": 1},
        "qp:highs": {"simplex_iteration_limit": 0, "qp_iteration_limit": 0, "presolve": "off"},
    }.get(label, {"max_iter": 1})  # fmt: skip
    solution = solvers.solve(built("nocedal_wright").program, label, options=limit)
    assert solution.status is SolutionStatus.NONE
    wanted = LIMITS.get(label.partition(":")[2])
    if wanted is None:
        assert solution.termination is not TerminationCondition.CONVERGED
    else:
        assert solution.termination is wanted


@pytest.mark.parametrize(
    ("label", "options"),
    [
        ("clarabel", {"max_iter": "many"}),
        ("clarabel", {"direct_solve_method": "no_such"}),
        ("osqp", {"eps_abs": -1.0}),
        ("osqp", {"max_iter": "many"}),
        ("osqp", {"solver_type": "no_such"}),
    ],
)
def test_a_value_that_an_option_cannot_have_is_refused_before_anything_is_solved(
    label: str, options: dict[str, object]
) -> None:
    with pytest.raises(solvers.SolverOptionError, match=f"{label} .*{next(iter(options.values()))}"):
        solvers.prepare(built("box").program, label, options)


@pytest.mark.parametrize("label", installed())
def test_an_option_that_does_not_exist_is_named(label: str) -> None:
    with pytest.raises(solvers.SolverOptionError, match="no_such"):
        solvers.solve(built("box").program, label, options={"no_such": 1})


@pytest.mark.skipif("qp:piqp" not in installed(), reason="PIQP is not installed")
def test_an_enumeration_of_piqp_is_given_by_name() -> None:
    program = built("storage").program
    solution = solvers.solve(program, "qp:piqp", options={"kkt_solver": "sparse_ldlt_eq_cond"})
    assert_answer(solution, built("storage").answers[0], "qp:piqp", Kind.QUADRATIC)
    with pytest.raises(solvers.SolverOptionError, match="'kkt_solver'"):
        solvers.solve(program, "qp:piqp", options={"kkt_solver": "sparse"})


# Refusals --------------------------------------------------------------------------------------


@pytest.mark.parametrize("label", [label for label in installed() if label not in LOCAL])
def test_a_nonconvex_quadratic_is_refused_by_convex_back_ends(label: str) -> None:
    with pytest.raises(
        solvers.UnsupportedProgramError,
        match=r"the quadratic block 'cost 1' of 'nonconvex quadratic' is not convex; .* accept it: expanded, ipopt, windows$",
    ):
        solvers.prepare(built("nonconvex_quadratic").program, label)


@pytest.mark.parametrize("label", ["qp", "conic"])
def test_an_instance_that_is_not_convex_is_refused_when_it_is_solved(label: str) -> None:
    program = built("parameter_in_the_hessian").program
    session = solvers.prepare(program, label)
    assert session.solve(program.instance({"c": 2.0})).status is SolutionStatus.GLOBALLY_OPTIMAL
    with pytest.raises(solvers.UnsupportedProgramError, match=r"'cost 1' .* is not convex"):
        session.solve(program.instance({"c": -2.0}))


def test_an_optimum_of_a_nonconvex_instance_is_called_local() -> None:
    build = ProgramBuilder()
    x, c = build.variable("x", 1, lower=-1.0, upper=2.0, start=1.0), build.parameter("c", 1, value=2.0)
    build.minimize(c * x**2)
    program = build.build()
    session = solvers.prepare(program, "ipopt")
    assert session.solve(program.default).status is SolutionStatus.GLOBALLY_OPTIMAL
    assert session.solve(program.instance({"c": -1.0})).status is SolutionStatus.LOCALLY_OPTIMAL


def test_auto_leaves_what_is_not_convex_to_ipopt() -> None:
    for name, solver in (
        ("nonconvex_quadratic", "ipopt"),
        ("convex_in_pieces", "clarabel"),
        ("disc", "clarabel"),
    ):
        assert solvers.solve(built(name).program).solver == solver


@given(
    diagonal=st.lists(st.floats(-1.0, 3.0), min_size=2, max_size=6),
    couplings=st.lists(st.floats(-1.5, 1.5), min_size=5, max_size=5),
)
def test_convexity_is_that_of_the_sum(diagonal: list[float], couplings: list[float]) -> None:
    """A tridiagonal Hessian stated term by term is convex when its eigenvalues say so."""
    n = len(diagonal)
    build = ProgramBuilder()
    x = build.variable("x", n)
    build.minimize(0.5 * np.array(diagonal) * x**2)
    build.minimize(np.array(couplings[: n - 1]) * x[:-1] * x[1:])
    matrix = np.diag(diagonal) + np.diag(couplings[: n - 1], 1) + np.diag(couplings[: n - 1], -1)
    smallest = np.linalg.eigvalsh(matrix).min()
    if abs(smallest) > 1e-6:
        assert (solvers.nonconvex_cost(*_at_default(build.build())) is None) == (smallest > 0)


def _at_default(program: solvers.Program) -> tuple[solvers.Program, solvers.Instance]:
    return program, program.default


def test_cones_and_curves_are_refused_with_their_names() -> None:
    with pytest.raises(
        solvers.UnsupportedProgramError,
        match=r"'qp' solves at most a convex quadratic program, but block 'disc' of 'disc' makes it a "
        r"second-order cone program; back ends that accept it: clarabel, conic, expanded, ipopt, windows$",
    ):
        solvers.prepare(built("disc").program, "qp")
    with pytest.raises(
        solvers.UnsupportedProgramError,
        match=r"blocks 'product', 'sphere', 'cost 1' .* nonlinear program; .*: expanded, ipopt, windows$",
    ):
        solvers.prepare(built("hock_schittkowski_71").program, "conic:clarabel")


@pytest.mark.parametrize("name", ["gurobi", "qp:gurobi", "conic:nonsense", "nonsense:clarabel"])
def test_a_solver_that_is_not_installed_is_refused_with_what_is(name: str) -> None:
    with pytest.raises(solvers.UnknownSolverError) as error:
        solvers.prepare(built("box").program, name)
    assert f"{name!r}; available: " in str(error.value)
    for end in ("clarabel (clarabel)", "osqp (osqp)", "qp (clarabel", "conic (clarabel", "ipopt (ipopt"):
        assert end in str(error.value)


@pytest.mark.parametrize(
    ("name", "session"),
    [
        ("clarabel", ClarabelSession),
        ("qp", ClarabelSession),
        ("qp:clarabel", ClarabelSession),
        ("conic", ClarabelSession),
        ("conic:clarabel", ClarabelSession),
        ("osqp", OSQPSession),
        ("qp:osqp", OSQPSession),
    ],
)
def test_every_name_of_a_solver_means_its_own_back_end(name: str, session: type) -> None:
    assert isinstance(solvers.prepare(built("box").program, name), session)


# A solver is held to its word -------------------------------------------------------------------


@pytest.mark.skipif("qp:highs" not in installed(), reason="HiGHS is not installed")
def test_a_point_that_is_not_optimal_is_not_called_so() -> None:
    """Without regularisation HiGHS 1.15 stops beside the optimum of a singular Hessian and calls it one."""
    options = {"qp_regularization_value": 0.0}
    solution = solvers.solve(built("singular_hessian").program, "qp:highs", options=options)
    right = abs(solution.value("y")[0, 0] - 1.0) < 1e-5
    assert solution.status.is_optimal == right
    if not right:
        assert solution.termination is TerminationCondition.NUMERICAL_FAILURE
        assert "residual" in solution.message


@pytest.mark.parametrize("solver", ["osqp", "scs"])
def test_loose_tolerances_are_called_acceptable_or_nothing(solver: str) -> None:
    if f"qp:{solver}" not in installed():
        pytest.skip(f"{solver} is not installed")
    loose: dict[str, object] = {"eps_abs": 3e-2, "eps_rel": 3e-2}
    if solver == "osqp":
        loose["polishing"] = False
    build = ProgramBuilder()
    p = build.variable("p", 20, lower=0.0, upper=np.linspace(1, 4, 20))
    build.minimize(np.linspace(10, 40, 20) * p + p**2)
    build.constrain("balance", total(p) == 21.0)
    program = build.build()
    solution = solvers.solve(program, f"qp:{solver}", options=loose)
    assert solution.termination is not TerminationCondition.CONVERGED
    assert "residual" in solution.message
    exact = solvers.solve(program, "qp:clarabel")
    assert exact.termination is TerminationCondition.CONVERGED
    assert abs(solution.objective / exact.objective - 1) > 1e-6
