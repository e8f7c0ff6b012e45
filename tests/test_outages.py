"""Outages that happen: plans that take components as out of service, and loops in which they trip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

import opfmodel as om
from opfmodel.errors import ModelError, SecurityError

FORMULATIONS = ["ac", "ac-rectangular", "dc", "dc-matpower", "soc"]
OUT = [("ab",), ("gas",), ("cell",), ("ab", "tank"), ("bc", "gas")]
CORRECTIVE = om.Security(
    {"branches": ["*"], "generators": ["oil"], "storages": ["cell"]}, minutes=30, rating=1.4
)
PREVENTIVE = om.Security({"branches": ["*"], "generators": ["oil"]}, "preventive", rating=1.5)


def grid() -> om.Network:
    """A ring with a chord, three units and two storages."""
    made = om.Network("ring", base_mva=100)
    for name in ("a", "b", "c", "d"):
        made.add(name, om.Bus(vm=(0.9, 1.1), reference=name == "a"))
    made.add("ab", om.Branch("a", "b", r=0.01, x=0.05, b=0.02, rating=75))
    made.add("bc", om.Branch("b", "c", r=0.02, x=0.06, rating=60))
    made.add("ac", om.Branch("a", "c", r=0.015, x=0.07, rating=50))
    made.add("cd", om.Branch("c", "d", r=0.01, x=0.04, rating=60))
    made.add("ad", om.Branch("a", "d", r=0.02, x=0.05, rating=45))
    made.add("coal", om.Generator("a", p=(0, 190), q=(-90, 90), ramp=60, cost=om.Polynomial(0.02, 14, 5)))
    made.add("gas", om.Generator("c", p=(10, 120), q=(-70, 70), ramp=100, cost=om.Polynomial(0.05, 32, 80)))
    made.add("oil", om.Generator("b", p=(5, 60), q=(-40, 40), ramp=20, cost=om.Polynomial(0.05, 45, 20)))
    made.add("cell", om.Storage("b", energy=120, power=30, q=10))
    made.add("tank", om.Storage("c", energy=20, power=8, q=4, standing_loss=0.01))
    made.add("town", om.Load("b", p=60, q=15))
    made.add("mill", om.Load("c", p=45, q=10))
    made.add("farm", om.Load("d", p=30, q=5))
    return made


def demand(steps: int) -> om.Profiles:
    shape = 1.0 + 0.1 * np.sin(0.9 * np.arange(steps))
    return om.Profiles({f"{name}.p": load.p * shape for name, load in grid().of(om.Load).items()})


def problem(
    out: Sequence[str] = (),
    security: om.Security | None = None,
    formulation: str = "ac",
    without: Sequence[str] = (),
    horizon: om.Horizon | int = 3,
    **options: object,
) -> om.MultiStage:
    """The problem of the grid, without components that are not in service."""
    made = grid()
    for name in without:
        made.update(name, in_service=False)
    if security is not None:
        lost = {
            kind: [n for n in names if n not in without] for kind, names in security.contingencies.items()
        }
        security = replace(security, contingencies=lost)
    steps = horizon if isinstance(horizon, int) else horizon.steps
    series = {key: values for key, values in demand(steps).items() if key.component in made}
    return om.MultiStage(
        made, horizon, formulation=formulation, profiles=om.Profiles(series), security=security, outages=out,
        regularisation=0.0, **options,
    )  # fmt: skip


# Plans -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("security", [None, CORRECTIVE, PREVENTIVE], ids=["free", "corrective", "preventive"])
@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_a_plan_of_an_outage_is_that_of_a_grid_without_the_component(
    formulation: str, security: om.Security | None
) -> None:
    every = problem(["ab", "bc", "gas", "cell", "tank"], security, formulation)
    whole = every.solve().objective
    assert whole == pytest.approx(problem((), security, formulation).solve().objective, rel=1e-7)
    for out in OUT:
        plan = every.solve(out=out)
        alone = problem((), security, formulation, without=out).solve()
        assert plan.status == alone.status
        if alone.optimal:
            assert plan.objective == pytest.approx(alone.objective, rel=1e-6)
            assert plan.objective != pytest.approx(whole, rel=1e-4)
    assert every.solve().objective == pytest.approx(whole, rel=1e-7)  # nothing of it stays


def test_a_plan_starts_from_one_without_the_outage() -> None:
    every = problem(["ab", "gas"], CORRECTIVE)
    plan = every.solve()
    for out in (["ab"], ["ab", "gas"], []):
        cold = every.solve(out=out)
        plan = every.solve(out=out, previous=plan)
        assert plan.objective == pytest.approx(cold.objective, rel=1e-6)


def test_security_during_an_outage_covers_the_next_one() -> None:
    security = replace(CORRECTIVE, rating=1.1)
    free, secure = problem(["ab"]), problem(["ab"], security)
    plan, secured = free.solve(out=["ab"]), secure.solve(out=["ab"])
    assert secured.objective > plan.objective + 10
    lacking = {outcome.out for outcome in om.assess(plan, security).violated}
    assert lacking
    found = om.assess(secured)
    assert found.secure
    assert "ab" not in {outcome.out for outcome in found.outcomes}


def test_a_tree_and_soft_limits_take_outages() -> None:
    tree = om.Horizon.tree([1, 1, 2], {"low": 0.4, "high": 0.6}, common=1)
    stated = problem(["ab", "gas"], CORRECTIVE, horizon=tree).solve(out=["ab", "gas"])
    alone = problem((), CORRECTIVE, without=["ab", "gas"], horizon=tree).solve()
    assert stated.objective == pytest.approx(alone.objective, rel=1e-6)
    short = problem(["coal", "gas"], elastic=om.Elastic()).solve(out=["coal", "gas"])
    lonely = problem((), without=["coal", "gas"], elastic=om.Elastic()).solve()
    assert short.penalty == pytest.approx(lonely.penalty, rel=1e-5)
    assert short.penalty > 1e5


def test_a_piecewise_cost_of_a_unit_that_is_out_is_nothing() -> None:
    cost = om.PiecewiseLinear([(0, 300), (50, 1800), (120, 4500)])
    made = []
    for out, without in ((["gas"], []), ([], ["gas"])):
        case = grid()
        case.update("gas", cost=cost, p=(0, 120))
        for name in without:
            case.update(name, in_service=False)
        made.append(om.MultiStage(case, outages=out, formulation="dc").solve(out=out).objective)
    assert made[0] == pytest.approx(made[1], rel=1e-8)


def test_what_solves_refuse() -> None:
    with pytest.raises(ModelError, match=r"outages: 'abc': no branch, generator or storage in service .* 'a"):
        problem(["abc"])
    with pytest.raises(ModelError, match="outages = 'ab': must be a list of names"):
        problem("ab")
    with pytest.raises(ModelError, match="out: 'bc': the problem does not declare this outage; declared: ab"):
        problem(["ab"]).solve(out=["bc"])
    with pytest.raises(SecurityError, match=r"'ad', 'cd': these outages split the grid and cut off 3.* MW"):
        problem(["ad", "cd"]).solve(out=["ad", "cd"])
    case = grid()
    case.remove("ad")
    with pytest.raises(SecurityError, match="outages: 'cd': its outage splits the grid and cuts off 30 MW"):
        om.MultiStage(case, outages=["cd"])
