"""Multi-stage plans: timing, states, terminal conditions, profiles, and one program for all solves."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import demand, everything, two_bus
from numpy.testing import assert_allclose

import opfmodel as om
from opfmodel.check import check
from opfmodel.errors import ComponentError, IncompatibleError, ModelError, PluginError, ProfileError

WAVE = {"town.p": [60, 90, 110, 110, 70, 60, 80, 100], "town.q": [20, 30, 35, 35, 22, 20, 25, 30]}


def problem(horizon: int = 6, ramp: float | None = 25, **keywords) -> om.MultiStage:
    grid = two_bus()
    grid.update("coal", ramp=ramp)
    return om.MultiStage(grid, horizon, profiles=WAVE, **keywords)


def test_a_plan_has_labelled_quantities_in_physical_units() -> None:
    data = problem().solve().data
    assert dict(data.sizes) == {"time": 6, "bus": 2, "branch": 1, "generator": 1, "storage": 1}
    assert data["pg"].dims == ("time", "generator")
    assert data["pg"].attrs["units"] == "MW"
    assert data["e"].attrs["units"] == "MWh"
    assert_allclose(data["pd"].sel(bus="south"), WAVE["town.p"][:6])
    assert_allclose(data["e"][0], 100)
    assert_allclose(data["e"][1:], data["e_next"][:-1])
    assert_allclose(data["e_next"] - data["e"], data["ps"], atol=1e-9)
    assert list(data["storage_bus"].values) == ["south"]


def test_every_constraint_and_the_cost_hold_by_an_independent_check() -> None:
    grid, series = everything(), demand(12)
    plan = om.MultiStage(grid, 12, profiles=series).solve()
    report = check(grid, plan.data, series)
    assert plan.optimal
    assert report.max_violation <= 1e-6, str(report)
    assert report.simultaneous <= 1e-5
    assert report.cost == pytest.approx(plan.objective, rel=1e-8)


def test_a_horizon_of_one_is_no_special_case() -> None:
    grid = two_bus()
    plan = om.MultiStage(grid).solve()
    assert plan.optimal
    assert check(grid, plan.data).max_violation <= 1e-6
    assert plan.data.sizes["time"] == 1


def test_without_delay_the_first_stage_is_ramp_limited_from_the_last_dispatch() -> None:
    made = problem()
    free = made.solve().data["pg"].values[0, 0]
    limited = made.solve(initial={"pg": [free + 30.0]}).data["pg"].values[:, 0]
    assert limited[0] == pytest.approx(free + 5.0, abs=1e-4)
    assert np.abs(np.diff(limited)).max() <= 25 + 1e-5


def test_with_delay_the_first_dispatch_is_given_and_storage_acts() -> None:
    made = problem(generator_delay=1)
    start = made.solve().data
    pg, qg = start["pg"].values[0] + 4.0, start["qg"].values[0]
    plan = made.solve(initial={"pg": pg, "qg": qg})
    assert_allclose(plan.data["pg"].values[0], pg, atol=1e-9)
    assert_allclose(plan.data["qg"].values[0], qg, atol=1e-9)
    assert plan.data["ps"].values[0, 0] == pytest.approx(start["ps"].values[0, 0] + 4.0, abs=0.3)
    assert_allclose(plan.next_state()["pg"], plan.data["pg"].values[1], rtol=1e-12)


def test_a_free_initial_state_costs_no_more() -> None:
    made = problem()
    given = made.solve(initial={"e": [20.0]})
    free = made.solve(initial={"e": None})
    assert_allclose(given.data["e"].values[0], 20.0, atol=1e-9)
    assert free.objective < given.objective - 100


def test_states_are_handed_on() -> None:
    made = problem()
    plan = made.solve()
    state = plan.next_state()
    assert set(state) == {"pg", "qg", "e"}
    after = made.solve(1, state, plan)
    assert_allclose(after.data["e"].values[0], plan.data["e_next"].values[0], atol=1e-9)
    assert after.data["time"].values.tolist() == [1, 2, 3, 4, 5, 6]
    assert_allclose(after.data["pd"].sel(bus="south"), WAVE["town.p"][1:7])


def test_ends_of_the_horizon() -> None:
    def left(end: om.End | None) -> float:
        plan = problem(ramp=None, end=end).solve(initial={"e": [100.0]})
        return float(plan.data["e_next"].values[-1, 0])

    assert left(None) == pytest.approx(40, abs=1e-3)
    assert left(om.End(cyclic=True)) == pytest.approx(100, abs=1e-6)
    assert left(om.End(minimum=0.3)) == pytest.approx(60, abs=1e-3)
    assert left(om.End(price=5.0)) == pytest.approx(40, abs=1e-3)
    assert left(om.End(price=50.0)) > 140
    with pytest.raises(ModelError, match=r"minimum = 1\.5: .* at least 0 and at most 1"):
        om.End(minimum=1.5)


def test_a_cyclic_end_with_a_free_start() -> None:
    plan = problem(end=om.End(cyclic=True)).solve(initial={"e": None})
    assert_allclose(plan.data["e_next"].values[-1], plan.data["e"].values[0], atol=1e-5)


def test_numbers_change_and_the_program_does_not() -> None:
    made = problem()
    program = made.compile()
    made.solve(0)
    made.solve(2, {"pg": [80.0], "e": [50.0]}, end=om.End(minimum=0.1, price=3.0))
    assert made.compile() is program
    cyclic = made.solve(initial={"e": [50.0]}, end=om.End(cyclic=True))
    assert made.compile() is program
    assert cyclic.data["e_next"].values[-1, 0] == pytest.approx(50, abs=1e-6)


def test_time_series_of_limits_and_costs() -> None:
    grid = two_bus()
    grid.update("coal", ramp=None)
    grid.wind = om.Generator("south", p=(0, 50), q=(0, 0))
    series = {
        **WAVE,
        "wind.p_max": [0, 10, 20, 30, 40, 50, 5, 5],
        "coal.c1": [15, 15, 90, 90, 15, 15, 15, 15],
    }
    made = om.MultiStage(grid, 6, profiles=series)
    plan = made.solve()
    assert_allclose(plan.data["pg"].sel(generator="wind"), series["wind.p_max"][:6], atol=1e-4)
    assert check(grid, plan.data, series).max_violation < 1e-6
    assert check(grid, plan.data, series).cost == pytest.approx(plan.objective, rel=1e-8)
    later = made.solve(2)
    assert_allclose(later.data["pg"].sel(generator="wind"), series["wind.p_max"][2:], atol=1e-4)


def test_time_series_of_ratings_and_capacity() -> None:
    grid = two_bus()
    grid.update("coal", ramp=None)
    series = {
        **WAVE,
        "tie.rating": [120, 120, 113, 120, 120, 120],
        "cell.energy": [200, 95, 200, 200, 200, 200],
    }
    plan = om.MultiStage(grid, 6, profiles=series, end=om.End(price=50.0)).solve(initial={"e": [90.0]})
    assert plan.optimal
    assert check(grid, plan.data, series).max_violation < 1e-6
    assert plan.data["e_next"].values[1, 0] == pytest.approx(95, abs=1e-4)
    constant = om.MultiStage(grid, 6, profiles=WAVE, end=om.End(price=50.0)).solve(initial={"e": [90.0]})
    assert np.hypot(constant.data["pf"], constant.data["qf"]).values[2, 0] > 113.5


@pytest.mark.parametrize(("formulation", "rating"), [("ac", 112), ("soc", 112), ("dc", 105)])
def test_a_series_limits_what_has_no_limit_otherwise(formulation: str, rating: float) -> None:
    grid = two_bus()
    grid.update("coal", ramp=None)
    grid.update("tie", rating=None)
    series = {**WAVE, "tie.rating": [200, 200, rating, 200, 200, 200], "coal.ramp": [90, 90, 90, 90, 30, 90]}
    plan = om.MultiStage(grid, 6, profiles=series, formulation=formulation).solve(initial={"pg": [60.0]})
    assert plan.optimal
    pg = plan.data["pg"].values[:, 0]
    assert pg[2] <= rating
    assert pg[4] - pg[3] >= -30 - 1e-4
    report = check(grid, plan.data, series, previous_pg={"coal": 60.0})
    assert report.max_violation < 1e-6
    assert {"ramp", "branch rating"} <= set(report.violations)


def test_the_first_stage_has_the_ramp_of_the_first_step() -> None:
    grid = two_bus()
    series = {**WAVE, "coal.ramp": [1, 100, 100, 100, 100, 100]}
    plan = om.MultiStage(grid, 6, profiles=series).solve(initial={"pg": [58.0]})
    assert plan.data["pg"].values[0, 0] == pytest.approx(57, abs=1e-4)


@pytest.mark.parametrize("formulation", ["ac-rectangular", "soc"])
def test_series_of_voltage_limits(formulation: str) -> None:
    grid = two_bus()
    series = {
        **WAVE,
        "north.vm_min": [1.1, 0.95],
        "north.vm_max": [1.12, 1.05],
        "south.vm_max": [1.12, 1.05],
    }
    plan = om.MultiStage(grid, 2, profiles=series, formulation=formulation).solve()
    polar = om.MultiStage(grid, 2, profiles=series).solve()
    assert plan.optimal
    assert plan.objective == pytest.approx(polar.objective, rel=1e-4)
    assert check(grid, plan.data, series).max_violation < 1e-5


def test_series_of_the_capacity_of_an_inverter() -> None:
    grid = two_bus()
    grid.update("cell", charge_efficiency=0.95, power=(-10, 10))
    series = {**WAVE, "cell.rating": [11, 2], "cell.power_min": [-30, -10]}
    plan = om.MultiStage(grid, 2, profiles=series, end=om.End(price=-50.0)).solve()
    apparent = np.hypot(plan.data["ps"], plan.data["qs"]).values[:, 0]
    assert apparent == pytest.approx([11, 2], abs=1e-3)
    assert check(grid, plan.data, series).max_violation < 1e-6


def test_losses_of_storage_and_the_inverter_circle() -> None:
    grid = everything()
    plan = om.MultiStage(grid, 12, profiles=demand(12)).solve()
    d = plan.data.sel(storage="battery")
    ps, e, e_next = d["ps"].values, d["e"].values, d["e_next"].values
    expected = (1 - 0.002) * e + np.where(ps > 0, 0.92 * ps, ps / 0.95)
    assert_allclose(e_next, expected, atol=1e-3)
    assert np.hypot(ps, d["qs"].values).max() <= 11 + 1e-5


def test_charging_and_discharging_at_once_is_detected_and_can_be_forbidden() -> None:
    grid = two_bus()
    grid.remove("cell")
    grid.cell = om.Storage(
        "south", energy=20, power=10, q=10, charge_efficiency=0.8, discharge_efficiency=0.8
    )
    # demand that must be served at a negative price: wasting energy earns money
    grid.update("coal", cost=om.Polynomial(0.0, -30.0, 0.0), p=(0, 200))
    wasteful = om.MultiStage(grid, 4, profiles=WAVE).solve()
    assert check(grid, wasteful.data, WAVE).simultaneous > 0.005
    grid.update("cell", exclusive=True)
    tight = om.MultiStage(grid, 4, profiles=WAVE).solve()
    assert tight.optimal
    assert check(grid, tight.data, WAVE).simultaneous < 1e-3
    assert tight.objective > wasteful.objective


def test_a_constraint_of_ones_own() -> None:
    made = problem()
    made.constrain("reserve", lambda s: om.total(s.generator.p_max - s.generator.pg) <= 142)
    made.constrain("export", lambda s: s.branch.pf[[0]] >= 60.0)
    free = problem().solve().data
    assert free["pg"].values.min() < 57  # each constraint would bind on its own
    data = made.solve().data
    assert data["pf"].values.min() == pytest.approx(60, abs=1e-3)  # the tighter of the two
    assert data["pg"].values.min() >= 58 - 1e-4
    with pytest.raises(ModelError, match=r"'late': .* compiled"):
        made.constrain("late", lambda s: s.generator.pg >= 0)
    wrong = problem()
    wrong.constrain("nothing", lambda s: 3)
    with pytest.raises(ModelError, match="must return a comparison"):
        wrong.solve()


def test_regularisation_is_not_reported() -> None:
    with_it, without = (problem(regularisation=r).solve() for r in (1.0, 0.0))
    assert with_it.objective >= without.objective - 1e-4
    assert with_it.solution.objective > with_it.objective + 1e-4
    assert without.solution.objective == pytest.approx(without.objective, rel=1e-9)


def test_an_infeasible_problem_is_a_status() -> None:
    grid = two_bus()
    grid.update("town", p=500)
    plan = om.MultiStage(grid).solve()
    assert plan.status == "locally_infeasible"
    assert not plan.optimal
    assert "infeasible" in plan.termination


@pytest.mark.parametrize(
    ("formulation", "options"), [("ac", {}), ("dc", {}), ("soc", {}), ("ac", {"max_iter": 1})]
)
def test_there_is_no_value_without_an_optimum(formulation: str, options: dict) -> None:
    grid = two_bus()
    grid.update("town", p=90 if options else 500)
    solver = "ipopt" if options else "auto"
    plan = om.MultiStage(grid, 2, formulation=formulation, solver=solver, options=options).solve()
    assert not plan.optimal
    assert np.isnan(plan.objective)
    assert plan.shortages == ()
    known = {"pd", "qd", "rating", *(name for name in plan.data if name.endswith(("_min", "_max")))}
    for name, values in plan.data.drop_vars("pg_ramp").items():
        assert np.isfinite(values).all() if name in known else np.isnan(values).all(), name
    assert np.isnan(plan.data.attrs["cost"])
    with pytest.raises(ModelError, match=f"from step 0 is {plan.status}"):
        plan.next_state()
    assert np.isfinite(plan.solution.x).all()


def test_a_plan_without_solution_shows_no_cost(grid: om.Network) -> None:
    grid.update("town", p=900)
    text = repr(om.MultiStage(grid).solve())
    assert "infeasible" in text
    assert "$" not in text


def test_islands_are_solved_together() -> None:
    grid = two_bus()
    grid.far = om.Bus()
    grid.hydro = om.Generator("far", p=(0, 50), q=(-20, 20), cost=om.Polynomial(0, 3, 0))
    grid.village = om.Load("far", p=30, q=5)
    made = om.MultiStage(grid, 2)
    plan = made.solve()
    assert plan.data["pg"].sel(generator="hydro").values.tolist() == pytest.approx([30, 30], abs=1e-5)
    assert "2 islands" in " ".join(made.notes)


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: problem(0), ModelError, "horizon = 0: must be an integer, at least 1"),
        (lambda: problem(2.5), ModelError, r"horizon = 2\.5"),
        (lambda: problem(step=0), ModelError, "step = 0: .* at least 1e-06 and at most 1e"),
        (lambda: problem(generator_delay=2), ModelError, "must be 0 or 1"),
        (lambda: problem(formulation="acc"), PluginError, r"no formulation 'acc'; did you mean 'ac'"),
        (lambda: problem(step=True), ModelError, "step = True: must be a finite number"),
        (lambda: problem(formulation=None), ModelError, "formulation = None: must be a name such as 'ac'"),
        (lambda: problem(objective=om.Economic), ModelError, "objective = <class .*: must be .*Objective"),
        (lambda: problem(regularisation=-1), ModelError, "regularisation = -1: .* at least 0"),
        (lambda: om.End(minimum="half"), ModelError, "minimum = 'half': .* at most 1"),
        (lambda: om.End(price="5"), ModelError, "price = '5': must be a finite number"),
        (lambda: problem().solve(-1), ModelError, "time = -1: must be an integer, at least 0"),
        (lambda: problem(2).solve(previous=problem(3).solve()), ModelError, "previous: "),
        (lambda: problem().solve(initial={"e": "full"}), ModelError, "initial e: 'full': must be one number per"),
        (lambda: problem(9).solve(), ProfileError, "has 8 values; steps 0 to 8 need 9"),
        (lambda: problem().solve(5), ProfileError, "has 8 values; steps 5 to 10 need 11"),
        (lambda: problem().solve(initial={"x": [1]}), ModelError, "no state is named 'x'; states: pg, qg, e"),
        (lambda: problem().solve(initial={"e": [1, 2]}), ModelError, "initial e: must be one number per storage, 1 "),
        (lambda: problem().solve(initial={"e": [np.nan]}), ModelError, "initial e: must be one number per storage, 1 "),
        (lambda: om.MultiStage(two_bus(), profiles={"town": [1]}), ProfileError, r"must be 'component\.field'"),
        (lambda: om.MultiStage(two_bus(), profiles={"twn.p": [1]}), ProfileError, "no component 'twn'; did you mean 'town'"),
        (lambda: om.MultiStage(two_bus(), profiles={"town.x": [1]}), ProfileError, "a load has no number 'x'"),
        (lambda: om.MultiStage(two_bus(), profiles={"tie.x": [1]}), ProfileError, "the x of a branch is constant"),
        (lambda: om.MultiStage(two_bus(), profiles={"tie.angle_max": [9]}), ProfileError, "angle_max of a branch is constant"),
        (lambda: om.MultiStage(two_bus(), profiles={"coal.in_service": [1]}), ProfileError, "cannot have a time series"),
        (lambda: om.MultiStage(two_bus(), profiles={"town.bus": [1]}), ProfileError, "the bus of a load is constant"),
        (lambda: om.MultiStage(two_bus(), profiles=[1, 2]), ProfileError, r"profiles = \[1, 2\]: must be a mapping"),
        (lambda: om.MultiStage(everything(), profiles={"dear.c1": [1]}), ProfileError, "the cost of 'dear' is piecewise linear"),
        (lambda: problem(objective=om.SetpointTracking(5)).solve(), ModelError, "set-points 5: must be a mapping"),
        (lambda: om.MultiStage(two_bus(), profiles={"town.p": ["a"]}), ProfileError, "the values must be numbers"),
        (lambda: om.MultiStage(two_bus(), profiles={"town.p": [1, np.nan]}), ProfileError, "step 1: nan: must be a number"),
    ],
)  # fmt: skip
def test_misuse_is_said(make, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        make()


def test_numbers_of_numpy_are_numbers() -> None:
    assert problem(np.int64(2), step=np.float32(0.5)).solve().data.sizes["time"] == 2


def test_a_store_cannot_lose_more_than_it_has() -> None:
    grid = two_bus()
    grid.update("cell", standing_loss=0.6)
    assert om.MultiStage(grid, 2).solve().optimal
    with pytest.raises(
        ModelError, match=r"cell: standing_loss = 0\.6: .* stage of 2 h; must be at most 0\.5"
    ):
        om.MultiStage(grid, 2, step=2.0).solve()


def test_a_branch_without_reactance_is_open_in_a_dc_flow_and_noted() -> None:
    grid = two_bus()
    grid.spare = om.Branch("north", "south", r=0.02, x=0.0)
    made = om.MultiStage(grid, formulation="dc")
    assert any("reactance" in note and "spare" in note for note in made.notes)
    assert float(np.abs(made.solve().data["pf"].sel(branch="spare")).max()) < 1e-9
    grid.remove("spare")
    alone = om.MultiStage(grid, formulation="dc")
    assert made.solve().objective == pytest.approx(alone.solve().objective, rel=1e-6)
    assert not any("reactance" in note for note in alone.notes)
    assert not any("reactance" in note for note in om.MultiStage(grid, formulation="ac").notes)


@pytest.mark.parametrize("formulation", ["dc-losses", "dc-matpower"])
def test_a_branch_without_reactance_is_named_with_formulations_that_accept_it(formulation: str) -> None:
    grid = two_bus()
    grid.update("tie", x=0.0)
    with pytest.raises(IncompatibleError, match=f"tie: x = 0: formulation '{formulation}'") as caught:
        om.MultiStage(grid, formulation=formulation).solve()
    for other in ("ac", "ac-rectangular", "soc", "copperplate"):
        assert repr(other) in str(caught.value)
        assert om.MultiStage(grid, formulation=other).solve().optimal


def test_a_dangling_component_is_found_when_the_problem_is_made() -> None:
    grid = two_bus()
    grid.ghost = om.Load("nowhere", p=1)
    with pytest.raises(ComponentError, match="ghost: bus = 'nowhere'"):
        om.MultiStage(grid)


def test_a_ramp_has_its_price_in_a_horizon_of_one_stage() -> None:
    problem = om.MultiStage(two_bus())  # 90 MW of demand, 10 of which storage would serve for free
    plan, lower = (problem.solve(initial={"pg": [pg], "e": [100.0]}) for pg in (108.0, 107.0))
    price = float(plan.data["pg_ramp_price"].values[0, 0])
    assert price == pytest.approx(plan.objective - lower.objective, rel=1e-2)
    assert price > 15


@pytest.mark.parametrize("formulation", ["ac", "soc", "dc", "copperplate"])
def test_a_network_without_generators_is_diagnosed_and_costs_nothing(formulation: str) -> None:
    grid = two_bus()
    grid.remove("coal")
    grid.update("cell", initial=200.0, power=100, q=100)
    objective = om.Economic(reactive_weight=1.0, energy_weight=0.0)
    served = om.MultiStage(grid, 2, formulation=formulation, objective=objective).solve()
    assert served.optimal
    assert served.objective == pytest.approx(0.0)
    assert served.data.sizes["generator"] == 0
    grid.update("cell", in_service=False)
    problem = om.MultiStage(grid, 2, formulation=formulation, objective=objective)
    assert problem.solve().infeasible
    assert problem.elastic_twin().solve().shortages[0].worst == pytest.approx(90.0, rel=1e-4)
    run = om.simulate(problem, om.Redispatch(), 2, on_infeasible="elastic")
    assert run.summary()["shed_mwh"] == pytest.approx(180.0, rel=1e-4)


def test_an_objective_of_absent_storage_costs_nothing() -> None:
    grid = two_bus()
    grid.remove("cell")
    objective = om.Economic() + om.StateOfChargeTracking()
    plan = om.MultiStage(grid, objective=objective).solve()
    assert plan.objective == pytest.approx(om.MultiStage(grid).solve().objective)


def test_a_problem_is_shown_by_its_parts() -> None:
    assert repr(problem(6)) == "MultiStage('two-bus': 6 stages of 1 h, ac, Economic)"
    assert "1 stage of 0.5 h, dc" in repr(om.MultiStage(two_bus(), step=0.5, formulation="dc"))
