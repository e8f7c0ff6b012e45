"""Elastic problems: the same optimum if there is one, and the shortfalls if there is none."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import demand, everything, examples, two_bus
from hypothesis import example, given
from hypothesis import strategies as st

import opfmodel as om
from opfmodel.check import check
from opfmodel.errors import ModelError
from opfmodel.plugins import plugins
from solvers import TerminationCondition

FORMULATIONS = [name for name, plugin in plugins("formulation").items() if plugin.origin == "opfmodel"]
NETWORKED = [name for name in FORMULATIONS if name != "copperplate"]


def one_bus(capacity: float) -> om.Network:
    grid = om.Network("one-bus")
    grid.add("4", om.Bus())
    grid.unit = om.Generator("4", p=(0, capacity), cost=om.Polynomial(0, 20, 0))
    grid.town = om.Load("4", p=50)
    return grid


def sentences(problem: om.MultiStage, **options: object) -> list[str]:
    return [str(shortage) for shortage in problem.elastic_twin().solve(**options).shortages]


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_where_there_is_a_solution_it_is_the_same(formulation: str) -> None:
    problem = om.MultiStage(everything(), 4, formulation=formulation, profiles=demand(4))
    plan, elastic = problem.solve(), problem.elastic_twin().solve()
    assert plan.optimal
    assert elastic.optimal
    assert elastic.shortages == ()
    assert elastic.objective == pytest.approx(plan.objective, rel=1e-6)


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_a_lack_of_capacity(formulation: str) -> None:
    problem = om.MultiStage(
        one_bus(40), 4, formulation=formulation, profiles={"town.p": [35, 50, 72.1, 40]}, step=2
    )
    assert not problem.solve().optimal
    assert sentences(problem) == ["bus 4 lacks 32.1 MW at hour 4 (in 2 stages, 84.2 MWh in all)"]


@pytest.mark.parametrize("formulation", ["dc", "dc-matpower"])
def test_a_rating_that_is_too_small_without_losses(formulation: str) -> None:
    grid = two_bus()
    grid.remove("cell")
    problem = om.MultiStage(grid, 2, formulation=formulation, profiles={"town.p": [120, 132]})
    assert sentences(problem) == ["branch tie exceeds its rating by 12.0 MVA at hour 1"]


@pytest.mark.parametrize("formulation", NETWORKED)
def test_what_is_said_of_a_branch_is_what_the_check_finds(formulation: str) -> None:
    grid = two_bus()
    grid.update("coal", ramp=100)
    series = {"town.p": [80, 150, 160, 90]}
    problem = om.MultiStage(grid, 4, formulation=formulation, profiles=series)
    assert not problem.solve().optimal
    plan = problem.elastic_twin().solve()
    report = check(grid, plan.data, series)
    (shortage,) = plan.shortages
    assert (shortage.kind, shortage.component, shortage.unit) == ("branch", "tie", "MVA")
    assert shortage.worst / 100 == pytest.approx(report.violations["branch rating"].value, rel=1e-4)
    assert report.worst.family == "branch rating"
    assert report.violations["active balance"].value < 1e-6


@pytest.mark.parametrize("formulation", ["ac", "ac-rectangular"])
def test_voltages(formulation: str) -> None:
    grid = two_bus()
    grid.update("coal", q=(-10, 200))
    grid.update("tie", rating=None, x=0.3)
    grid.update("town", p=90, q=45)
    grid.remove("cell")
    problem = om.MultiStage(grid, formulation=formulation)
    assert not problem.solve().optimal
    plan = problem.elastic_twin().solve()
    (shortage,) = plan.shortages
    assert str(shortage).endswith("p.u. above its maximum voltage at hour 0")
    assert shortage.worst == pytest.approx(check(grid, plan.data).violations["voltage"].value, rel=1e-4)


def test_ramps() -> None:
    series = {"town.p": [40, 90, 90]}
    grid = two_bus()
    grid.remove("cell")
    plan = om.MultiStage(grid, 3, profiles=series).elastic_twin().solve()
    report = check(grid, plan.data, series)
    (shortage,) = plan.shortages
    assert str(shortage).startswith("generator coal must rise")
    assert shortage.worst / 100 == pytest.approx(report.violations["ramp"].value, rel=1e-4)
    assert int(np.argmax(shortage.amounts)) == 1


def test_the_ramp_from_the_dispatch_before() -> None:
    problem = om.MultiStage(two_bus(), formulation="dc", profiles={"town.p": [90]})
    (said,) = sentences(problem, initial={"pg": [200.0], "e": [200.0]})
    assert said == "generator coal must fall 90.0 MW faster than its ramp allows at hour 0"


def test_energy_and_the_end_of_the_horizon() -> None:
    grid = two_bus()
    full = om.MultiStage(grid, 2, formulation="dc", end=om.End(minimum=0.9))
    assert sentences(full, initial={"e": [140.0]}) == ["storage cell is 20.0 MWh below its minimum at hour 1"]
    grid.update("cell", standing_loss=0.2)
    cyclic = om.MultiStage(grid, 1, formulation="dc", end=om.End(cyclic=True))
    assert sentences(cyclic, initial={"e": [150.0]}) == [
        "storage cell ends 20.0 MWh short of where it began at hour 0"
    ]


def test_generation_that_nobody_takes() -> None:
    grid = one_bus(40)
    grid.update("unit", p=(20, 40))
    grid.update("town", p=5)
    assert sentences(om.MultiStage(grid)) == ["bus 4 has 15.0 MW too much at hour 0"]
    grid.update("unit", p=(0, 40))
    grid.update("town", p=-30)
    assert sentences(om.MultiStage(grid)) == ["bus 4 has 30.0 MW too much at hour 0"]


def test_without_a_network_the_island_is_short() -> None:
    problem = om.MultiStage(two_bus(), formulation="copperplate", profiles={"town.p": [250]})
    assert sentences(problem) == ["island of bus north lacks 40.0 MW at hour 0"]


def test_constraints_of_ones_own() -> None:
    problem = om.MultiStage(one_bus(60))
    problem.constrain("reserve", lambda s: om.total(s.generator.p_max - s.generator.pg) >= 30)
    assert sentences(problem) == ["constraint reserve is missed by 20.0 at hour 0"]


def test_a_twin_has_constraints_of_its_own() -> None:
    made = om.MultiStage(two_bus(), formulation="dc")
    assert made.solve().optimal
    made.elastic_twin().constrain("little", lambda s: s.generator.pg, at_most=10)
    assert made.solve().optimal


def test_constraints_with_limits_of_each_step_and_of_some_stages() -> None:
    problem = om.MultiStage(one_bus(60), 2)
    problem.constrain("floor", lambda s: s.generator.pg, at_least=[50, 58])
    problem.constrain("later", lambda s: s.generator.pg[:, -1:] <= 30)
    said = sentences(problem)
    assert said[0] == "constraint later is exceeded by 20.0"
    assert said[1:] == ["constraint floor is missed by 8 at hour 1"]


def test_a_rating_with_a_time_series() -> None:
    grid = two_bus()
    series = {"tie.rating": [120, 60, 60]}
    plan = om.MultiStage(grid, 3, profiles=series).elastic_twin().solve()
    found = check(grid, plan.data, series).violations["branch rating"].value
    assert plan.shortages[0].worst / 100 == pytest.approx(found, rel=1e-4)


@examples(5)
@given(st.lists(st.floats(1, 120), min_size=1, max_size=5))
def test_what_is_short_is_demand_above_capacity(series: list[float]) -> None:
    problem = om.MultiStage(one_bus(60), len(series), profiles={"town.p": series})
    plan = problem.elastic_twin().solve()
    short = np.maximum(np.array(series) - 60, 0)
    assert plan.data["p_unserved"].values[:, 0] == pytest.approx(short, abs=1e-3)
    if short.max() > 1e-2:
        (shortage,) = plan.shortages
        assert shortage.amounts == pytest.approx(short, abs=1e-3)
        assert shortage.cost == pytest.approx(10_000 * short.sum(), rel=1e-3)


@example(
    "soc",
    0.2,
    126.92151917313754,
    98.02304372213497,
    17.54214598888343,
    (0.9544439685273385, 1.080071982122675),
    1.75,
)
@examples(7)
@given(
    formulation=st.sampled_from(FORMULATIONS),
    town=st.floats(-200, 300),
    mill=st.floats(-150, 200),
    rating=st.floats(0, 100),
    angle=st.floats(0.5, 30),
    vm=st.tuples(st.floats(0.9, 1.0), st.floats(1.0, 1.1)),
    stored=st.floats(0, 40),
)
def test_there_is_always_a_solution(
    formulation: str,
    town: float,
    mill: float,
    rating: float,
    angle: float,
    vm: tuple[float, float],
    stored: float,
) -> None:
    grid = everything()
    for bus in "abcd":
        grid.update(bus, vm=vm)
    grid.update("line", rating=rating, angle=(-angle, angle))
    series = {"town.p": [town, mill], "mill.p": [mill, town], "mill.q": [town / 3, 5]}
    problem = om.MultiStage(grid, 2, formulation=formulation, profiles=series)
    plan = problem.elastic_twin().solve(initial={"pg": [30, 20], "e": [stored, stored / 2]})
    assert plan.optimal, plan.termination
    data = plan.data.copy()
    for (kind, name), lacking in plan.exceeded().items():
        if name in ("p_shortage", "p_surplus"):
            data[name] = (("time", kind), lacking.T * plan.network.base_mva)
    violations = check(grid, data, series).violations
    # Clarabel may stop at an acceptable point, and the plan says so: then the check finds what it admits
    acceptable = plan.solution.termination is TerminationCondition.ACCEPTABLE
    admitted = plan.solution.primal_residual * plan.network.base_mva / grid.base_mva if acceptable else 0.0
    assert violations["active balance"].value < max(1e-5, 1.01 * admitted)
    assert violations["generator p"].value < max(1e-5, 1.01 * admitted)


# No cost outbids a shortfall --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("formulation", "price"),
    [
        *((each, 12_000.0) for each in FORMULATIONS),
        *((each, price) for each in ("ac", "dc") for price in (20.0, 1e6)),
    ],
)
def test_a_cost_above_the_price_of_shedding_sheds_no_more(formulation: str, price: float) -> None:
    grid = one_bus(40)
    grid.update("unit", cost=om.Polynomial(0, price, 0))
    problem = om.MultiStage(grid, 4, formulation=formulation, profiles={"town.p": [30, 60, 35, 40]})
    plan = problem.elastic_twin().solve()
    assert [str(s) for s in plan.shortages] == ["bus 4 lacks 20.0 MW at hour 1"]
    assert plan.data["pg"].values[:, 0] == pytest.approx([30, 40, 35, 40], abs=1e-2)
    assert plan.objective == pytest.approx(145 * price, rel=1e-4)


@pytest.mark.parametrize("formulation", ["dc", "copperplate"])
def test_a_cost_at_which_the_solver_fails_does_not_hide_the_shortage(formulation: str) -> None:
    grid = one_bus(100)
    grid.update("unit", cost=om.Polynomial(0, 1e8, 0))
    problem = om.MultiStage(grid, 4, formulation=formulation, profiles={"town.p": [80, 120, 80, 80]})
    plan = problem.elastic_twin().solve()
    assert plan.optimal
    (shortage,) = plan.shortages
    np.testing.assert_allclose(shortage.amounts, [0, 20, 0, 0], atol=1e-3)


def test_among_the_plans_with_the_least_shortage_the_cheapest_is_taken() -> None:
    grid = one_bus(40)
    grid.update("unit", cost=om.Polynomial(0, 30_000, 0))
    grid.cheaper = om.Generator("4", p=(0, 30), cost=om.Polynomial(0, 15_000, 0))
    plan = om.MultiStage(grid, 2, profiles={"town.p": [90, 50]}, formulation="dc").elastic_twin().solve()
    assert [str(s) for s in plan.shortages] == ["bus 4 lacks 20.0 MW at hour 0"]
    assert plan.data["pg"].sel(generator="cheaper").values == pytest.approx([30, 30], abs=1e-2)
    assert plan.data["pg"].sel(generator="unit").values == pytest.approx([40, 20], abs=1e-2)


def test_a_loop_of_expensive_units_sheds_what_it_must() -> None:
    grid = two_bus()
    grid.update("coal", ramp=None, p=(0, 100), cost=om.Polynomial(0, 12_000, 0))
    grid.remove("cell")
    problem = om.MultiStage(grid, 2, formulation="dc", profiles={"town.p": [60, 80, 120, 80, 60]})
    run = om.simulate(problem, steps=4, on_infeasible="elastic")
    assert run.data["p_unserved"].values[:, 0] == pytest.approx([0, 0, 20, 0], abs=1e-2)
    assert run.summary()["elastic_steps"] == 2


def test_the_effort_of_all_phases_counts() -> None:
    grid = one_bus(40)
    plain = om.MultiStage(grid, formulation="dc").elastic_twin().solve()
    grid.update("unit", cost=om.Polynomial(0, 12_000, 0))
    outbid = om.MultiStage(grid, formulation="dc").elastic_twin().solve()
    assert outbid.solution.iterations > plain.solution.iterations


@pytest.mark.parametrize(
    ("formulation", "price", "served"),
    [
        *((each, 12_000.0, [0, 0]) for each in FORMULATIONS),
        *((each, 20.0, [30, 40]) for each in ("ac", "dc")),
    ],
)
def test_a_shortage_that_is_traded_saves_cost_above_its_price(
    formulation: str, price: float, served: list[float]
) -> None:
    grid = one_bus(40)
    grid.update("unit", cost=om.Polynomial(0, price, 0))
    traded = om.Elastic(traded=True)
    problem = om.MultiStage(grid, 2, formulation=formulation, profiles={"town.p": [30, 60]}, elastic=traded)
    plan = problem.solve()
    assert plan.data["pg"].values[:, 0] == pytest.approx(served, abs=1e-2)
    shed = 90 - sum(served)
    assert plan.expected_cost == pytest.approx(price * sum(served), rel=1e-4, abs=0.1 * price)
    assert plan.penalty == pytest.approx(traded.shedding * shed, rel=1e-4)
    assert plan.objective == pytest.approx(plan.expected_cost + plan.penalty)


@pytest.mark.parametrize("formulation", ["ac", "dc", "soc"])
def test_a_shortage_that_is_traded_is_reported(formulation: str) -> None:
    grid = one_bus(40)
    grid.dear = om.Generator("4", p=(0, 100), cost=om.Polynomial(0, 15_000, 0))
    grid.update("town", p=60, q=10)
    problem = om.MultiStage(grid, formulation=formulation, elastic=om.Elastic(traded=True))
    assert "bus 4 lacks 20.0 MW at hour 0" in [str(shortage) for shortage in problem.solve().shortages]


def test_traded_shortages_of_scenarios_count_with_their_probabilities() -> None:
    cases = {"calm": 0.9, "peak": 0.1}
    demand = np.array([[30.0, 40.0, 60.0]])
    horizon = om.Horizon.tree([1, 1], cases, common=1)
    problem = om.MultiStage(
        one_bus(40), horizon, profiles={"town.p": [30, 40]}, formulation="dc", elastic=om.Elastic(traded=True)
    )
    plan = problem.solve(expected={("load", "p"): demand / problem.arrays.base_mva})
    assert plan.expected_cost == pytest.approx(20 * (30 + 0.9 * 40 + 0.1 * 40), rel=1e-6)
    assert plan.penalty == pytest.approx(10_000 * 0.1 * 20, rel=1e-6)
    assert plan.objective == pytest.approx(plan.expected_cost + plan.penalty)


# Shortfalls and their causes -------------------------------------------------------------------


@pytest.mark.parametrize("formulation", ["ac", "ac-rectangular", "soc"])
def test_a_lack_of_reactive_power_is_called_so(formulation: str) -> None:
    grid = one_bus(200)
    grid.update("unit", q=(0, 0))
    grid.update("town", p=80, q=60)
    problem = om.MultiStage(grid, formulation=formulation)
    assert not problem.solve().optimal
    assert sentences(problem) == ["bus 4 lacks 60.0 MVAr of reactive power at hour 0"]
    grid.update("unit", q=(0, 30))
    half = om.MultiStage(grid, formulation=formulation).elastic_twin().solve()
    assert [str(s) for s in half.shortages] == ["bus 4 lacks 30.0 MVAr of reactive power at hour 0"]
    assert half.data["p_unserved"].values[0, 0] == pytest.approx(40, abs=1e-2)


def test_a_lack_of_both_is_reported_as_such() -> None:
    grid = one_bus(20)
    grid.update("unit", q=(0, 50))
    grid.update("town", p=80, q=60)
    active, reactive = om.MultiStage(grid).elastic_twin().solve().shortages
    assert (active.unit, active.worst) == ("MW", pytest.approx(60, abs=1e-2))
    assert (reactive.unit, reactive.worst) == ("MVAr", pytest.approx(10, abs=1e-2))


def lacking(p: float, q: float) -> om.Network:
    """A line with a generator of p MW and q MVAr, which may be too small for 50 MW and 20 MVAr."""
    grid = om.Network("lacking")
    grid.a = om.Bus(vm=(0.8, 1.2), reference=True)
    grid.b = om.Bus(vm=(0.8, 1.2))
    grid.line = om.Branch("a", "b", r=0.01, x=0.1)
    grid.unit = om.Generator("a", p=(0, p), q=(-q, q), cost=om.Polynomial(0, 20, 0))
    grid.town = om.Load("b", p=50, q=20)
    return grid


@pytest.mark.parametrize("formulation", ["ac", "soc"])
@pytest.mark.parametrize(("p", "q", "units"), [(30, 5, 2), (45, 15, 2), (10, 5, 2), (10, 0, 2), (30, 25, 1)])
def test_neither_shortage_hides_the_other(formulation: str, p: float, q: float, units: int) -> None:
    plan = om.MultiStage(lacking(p, q), formulation=formulation).elastic_twin().solve()
    worst = {shortage.unit: shortage.worst for shortage in plan.shortages if shortage.component == "b"}
    assert len(worst) == units
    assert worst["MW"] == pytest.approx(float(plan.data["p_unserved"].max()), rel=0.01)


@examples(5)
@given(p=st.floats(0, 70), q=st.floats(0, 40), formulation=st.sampled_from(["ac", "soc"]))
def test_with_what_is_reported_the_hard_problem_is_feasible(p: float, q: float, formulation: str) -> None:
    grid = lacking(p, q)
    dear_limits = om.Elastic(limit=1e6)  # what remains is a lack of power
    plan = om.MultiStage(grid, formulation=formulation).elastic_twin(dear_limits).solve()
    assert plan.optimal
    for number, shortage in enumerate(plan.shortages):
        field = {"MW": "p", "MVAr": "q"}[shortage.unit]
        added = {"p": (0.0, 0.0), "q": (0.0, 0.0)} | {field: (0.0, shortage.worst + 1e-2)}
        grid.add(f"added {number}", om.Generator(shortage.component, **added))
    assert om.MultiStage(grid, formulation=formulation).solve().optimal


@pytest.mark.parametrize("formulation", ["ac", "soc", "dc"])
def test_demand_less_what_is_short_can_be_served(formulation: str) -> None:
    grid = two_bus()
    grid.update("tie", rating=None)
    grid.update("town", p=230, q=10)
    problem = om.MultiStage(grid, 2, formulation=formulation)
    assert not problem.solve().optimal
    data = problem.elastic_twin(om.Elastic(limit=100_000, balance=100_000)).solve().data
    short = float(data["p_unserved"].max())
    assert short > 15
    for shed, served in ((short + 0.01, True), (short - 0.1, False)):
        series = {"town.p": [230 - shed] * 2, "town.q": [10 * (1 - shed / 230)] * 2}
        assert om.MultiStage(grid, 2, formulation=formulation, profiles=series).solve().optimal is served


def test_the_check_shows_what_is_not_served_and_balances_it() -> None:
    grid = one_bus(40)
    plan = om.MultiStage(grid).elastic_twin().solve()
    report = check(grid, plan.data)
    assert report.max_violation < 1e-6
    assert "p unserved" in str(report)
    assert report.violations["active balance"].value < 1e-6
    assert report.unserved["p unserved"].value == pytest.approx(0.1, abs=1e-5)
    assert report.unserved["p unserved"].component == "town"


@pytest.mark.parametrize(("unserved", "excess"), [(60.0, 10.0), (-5.0, 5.0)])
def test_no_more_than_the_demand_can_be_unserved(unserved: float, excess: float) -> None:
    grid = one_bus(40)
    data = om.MultiStage(grid).elastic_twin().solve().data
    data["p_unserved"][:] = unserved
    found = check(grid, data).violations["p unserved range"]
    assert (found.physical, found.component) == (pytest.approx(excess), "town")


def test_power_without_a_source_is_a_violation() -> None:
    grid = one_bus(40)
    prices = om.Elastic(shedding=10_000, balance=1_000)  # cheaper than shedding
    report = check(grid, om.MultiStage(grid).elastic_twin(prices).solve().data)
    assert report.worst.family == "active balance"
    assert report.max_violation == pytest.approx(0.1, abs=1e-5)


@pytest.mark.parametrize("price", [0.0, -1.0, float("inf"), "much"])
def test_prices_are_positive(price: object) -> None:
    with pytest.raises(ModelError, match=r"elastic: shedding = .*: must be a finite number, above 0"):
        om.Elastic(shedding=price)  # type: ignore[arg-type]


SHORT_AT_4 = [60, 60, 60, 60, 260, 60, 60, 60]


def looped(on_infeasible: str) -> om.Run:
    grid = two_bus()
    grid.update("coal", ramp=200)
    problem = om.MultiStage(grid, 2, profiles={"town.p": SHORT_AT_4})
    return om.simulate(problem, steps=7, on_infeasible=on_infeasible)


def test_the_loop_goes_on_with_elastic_plans() -> None:
    run = looped("elastic")
    assert run.status == "done"
    assert [str(word) for word in run.data["plan_status"].values] == [
        *["locally_optimal"] * 3, "elastic", "elastic", *["locally_optimal"] * 2,
    ]  # fmt: skip
    summary = run.summary()
    assert summary["elastic_steps"] == 2
    assert set(summary["diagnosis"]) == {"3", "4"}
    assert all("at hour 4" in text for texts in summary["diagnosis"].values() for text in texts)
    unserved = run.data["p_unserved"].values[:, 0]
    excess = run.data["rating_from_above"].values[:, 0]
    assert np.flatnonzero(np.maximum(unserved, excess) > 0.1).tolist() == [4]


def test_or_it_stops() -> None:
    run = looped("stop")
    assert run.status == "locally_infeasible"
    assert len(run.steps) == 3
    assert run.summary()["diagnosis"] == {}


def test_only_stop_and_elastic_are_accepted() -> None:
    problem = om.MultiStage(two_bus())
    with pytest.raises(ModelError, match="on_infeasible = 'pray': must be 'stop' or 'elastic'"):
        om.simulate(problem, on_infeasible="pray")  # type: ignore[arg-type]
    with pytest.raises(ModelError, match=r"on_infeasible = 'elastic': .*controller"):
        om.simulate(om.Controller(problem), on_infeasible="elastic")


def test_one_stage_is_a_stage() -> None:
    assert om.MultiStage(one_bus(40)).compile().name == "one-bus, 1 stage of 1 h"
    assert om.MultiStage(one_bus(40), 2, 0.5).compile().name == "one-bus, 2 stages of 0.5 h"
