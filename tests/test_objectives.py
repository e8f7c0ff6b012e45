"""Objectives: values against formulas written out here, options, and refusals."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from conftest import demand, everything, two_bus
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import opfmodel as om
from opfmodel.errors import ModelError
from solvers import UnsupportedProgramError

STEPS = 5
LOADS = {"town.p": [70.0, 90, 110, 90, 80], "town.q": [20.0, 30, 40, 30, 25]}


def solve(objective: om.Objective, formulation: str = "ac", **options) -> om.Plan:
    grid = two_bus()
    grid.update("cell", initial=120)
    grid.update("coal", ramp=60)
    plan = om.MultiStage(
        grid, STEPS, objective=objective, formulation=formulation, profiles=LOADS, **options
    ).solve()
    assert plan.optimal, plan.termination
    return plan


def economic(d) -> float:
    pg = d["pg"].sel(generator="coal").values
    return float((0.01 * pg**2 + 15 * pg).sum())


SETPOINTS = {"coal.pg": [75, 95, 115, 95, 85], "coal.qg": 30, "cell.e": 100, "cell.ps": 0, "cell.qs": 1}

# Objectives, and the cost of a plan in $ from its data in physical units (base 100 MVA, steps of an hour).
CASES: dict[str, tuple[om.Objective, Callable]] = {
    "economic": (
        om.Economic(reactive_weight=2.0, energy_weight=3.0),
        lambda d: economic(d) + 2 * float((d["qg"] ** 2).sum()) / 1e4 + 3 * float((d["e"] ** 2).sum()) / 1e4,
    ),
    "state of charge": (
        om.StateOfChargeTracking(share=0.4, weight=2.0),
        lambda d: 2 * float(((d["e"] - 80) ** 2).sum()) / 1e4,
    ),
    "set-points": (
        om.SetpointTracking(om.Setpoints(SETPOINTS), state_weight=2.0, input_weight=0.5),
        lambda d: (
            sum(
                weight * float(((d[name].values[:, 0] - np.asarray(SETPOINTS[key])) ** 2).sum())
                for key, name, weight in (
                    ("coal.pg", "pg", 2.0),
                    ("coal.qg", "qg", 2.0),
                    ("cell.e", "e", 2.0),
                    ("cell.ps", "ps", 0.5),
                    ("cell.qs", "qs", 0.5),
                )
            )
            / 1e4
        ),
    ),
    "linear-quadratic": (
        om.LinearQuadratic(
            Q=[[2.0, 0.5, 0.0], [0.1, 1.0, 0.0], [0.0, 0.0, 1.0]], R={"ps": 0.5}, q={"pg": 15}, r=[3, 4]
        ),
        lambda d: float(
            (
                (2 * d["pg"] ** 2 + d["qg"] ** 2).values[:, 0]
                + 0.6 * (d["pg"] * d["qg"]).values[:, 0]
                + (d["e"] ** 2 + 0.5 * d["ps"] ** 2).values[:, 0]
            ).sum()
            / 1e4
            + (15 * d["pg"].values + 3 * d["ps"].values + 4 * d["qs"].values).sum() / 100
        ),
    ),
    "losses": (
        om.LossMinimisation(price=20.0),
        lambda d: 20 * float(d["pg"].sum() - d["pd"].sum() - d["ps"].sum()),
    ),
    "voltage": (
        om.VoltageDeviation(target=1.01, weight=500.0),
        lambda d: 500 * float(((d["vm"] - 1.01) ** 2).sum()),
    ),
    "stored energy": (
        om.Economic() + om.StoredEnergyValue(price=10.0),
        lambda d: economic(d) - 10 * float(d["e_next"].values[-1].sum()),
    ),
    "sum": (
        2 * om.Economic() + 300 * om.VoltageDeviation(1.0),
        lambda d: 2 * economic(d) + 300 * float(((d["vm"] - 1) ** 2).sum()),
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_cost_is_the_formula(name: str) -> None:
    objective, formula = CASES[name]
    plan = solve(objective)
    expected = formula(plan.data)
    assert plan.objective == pytest.approx(expected, rel=1e-9, abs=1e-9)
    # the solver minimised the same cost plus the regularisation
    extra = plan.problem.regularisation * float((plan.data["ps"] ** 2 + plan.data["qs"] ** 2).sum()) / 1e4
    assert plan.solution.objective == pytest.approx(expected + extra, rel=1e-9, abs=1e-9)


def test_each_objective_drives_the_plan_where_it_should() -> None:
    losses = {name: float(_losses(solve(CASES[name][0]))) for name in ("economic", "losses", "voltage")}
    assert losses["losses"] == min(losses.values())
    assert solve(om.VoltageDeviation(1.0)).objective <= solve(om.Economic()).data.pipe(
        lambda d: float(((d["vm"] - 1) ** 2).sum())
    )
    e = solve(om.StateOfChargeTracking(0.5)).data["e_next"].sel(storage="cell").values
    # discharging is limited to 10 MW; the final energy costs nothing; 0.05 MWh cost 2.5e-7 $
    assert_allclose(e[:-1], [110, 100, 100, 100], atol=0.05)
    left = {
        price: solve(om.Economic() + om.StoredEnergyValue(price)).data["e_next"].values[-1, 0]
        for price in (0.0, 1000.0)
    }
    assert left[0.0] == pytest.approx(70, abs=1e-3)  # 120 MWh less five hours of 10 MW
    assert left[1000.0] > 160  # and nearly as much more, except for the rating of the line


def _losses(plan: om.Plan) -> float:
    d = plan.data
    return d["pg"].sum() - d["pd"].sum() - d["ps"].sum()


def test_tracking_follows_what_can_be_followed() -> None:
    plan = solve(om.SetpointTracking(om.Setpoints({"cell.e": [120, 125, 120, 110, 100]})), "dc")
    assert_allclose(plan.data["e"].sel(storage="cell").values, [120, 125, 120, 110, 100], atol=2e-2)


def test_set_points_move_with_the_horizon() -> None:
    steps = np.arange(8.0)
    series = {"town.p": 80 + steps, "town.q": np.full(8, 25.0)}
    objective = om.SetpointTracking(om.Setpoints({"cell.e": 100 + steps, "coal.pg": 80 + steps}))
    problem = om.MultiStage(two_bus(), 3, objective=objective, profiles=series)
    run = om.simulate(problem, steps=6, initial={"e": [100], "pg": [80], "qg": [25]})
    assert run.status == "done"
    assert_allclose(run.data["e"].values[:, 0], 100 + steps[:6], atol=1.0)
    assert run.cost == pytest.approx(sum(run.cost_rate))
    with pytest.raises(ModelError, match="e_setpoint has 8 values; steps 6 to 8 need 9"):
        om.MultiStage(
            two_bus(), 3, objective=objective, profiles={"town.p": np.full(20, 80.0)}
        ).solve(6)  # fmt: skip


@pytest.mark.parametrize(
    ("setpoints", "message"),
    [
        ({}, "no set-points"),
        ({"coal.pq": 1}, "'coal.pq': no such quantity; did you mean 'pg' or 'ps'"),
        ({"cole.pg": 1}, "'cole.pg': no such generator in service; did you mean 'coal'"),
        ({"coal.pg": [1, 2], "cell.e": [1, 2, 3]}, "'cell.e' has 3 values, but 'coal.pg' has 2"),
        ({"coal.pg": [1, np.nan]}, "'coal.pg': step 1: nan: must be a finite number"),
        ({"coal.pg": "much"}, "'coal.pg': 'much': must be a number"),
        ({"coal.pg": [80] * 3}, "pg_setpoint has 3 values; steps 0 to 4 need 5"),
    ],
)
def test_set_points_that_do_not_fit(setpoints: dict, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        solve(om.SetpointTracking(om.Setpoints(setpoints)))


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        ({"Q": {"pq": 1.0}}, "Q has no quantity 'pq'; did you mean 'pg'"),
        ({"Q": [[1.0]]}, r"Q has shape \(1, 1\); .*\(3, 3\)"),
        ({"q": {"pg": [1, 2]}}, r"q of pg has shape \(2,\); .*\(1,\)"),
        ({"R": {"ps": "a"}}, "R of ps: must be numbers"),
        ({"r": {"ps": np.inf}}, "r of ps: must be finite"),
    ],
)
def test_weights_that_do_not_fit(weights: dict, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        solve(om.LinearQuadratic(**weights))


def test_options_out_of_range() -> None:
    for make, message in (
        (lambda: om.StateOfChargeTracking(share=1.5), "share = 1.5: .* at least 0 and at most 1"),
        (lambda: om.StateOfChargeTracking(weight=-1), "weight = -1: .* at least 0"),
        (lambda: om.VoltageDeviation(weight=float("nan")), "weight = nan: must be a finite number"),
        (lambda: om.LossMinimisation(price="dear"), "price = 'dear': must be a finite number"),
        (lambda: -1 * om.Economic(), "weight = -1: .* at least 0"),
    ):
        with pytest.raises(ModelError, match=message):
            make()


def test_what_a_formulation_lacks_is_refused_by_name() -> None:
    for objective, formulation, missing in (
        (om.VoltageDeviation(), "dc", "vm"),
        (om.Economic() + om.VoltageDeviation(), "soc", "vm"),
        (om.LossMinimisation(), "copperplate", "pf, pt"),
        (om.LinearQuadratic(Q={"qg": 1.0}), "dc", "qg"),
    ):
        with pytest.raises(ModelError, match=f"needs {missing}, which formulation '{formulation}'"):
            solve(objective, formulation)


def test_an_indefinite_cost_is_refused_by_convex_back_ends() -> None:
    indefinite = om.LinearQuadratic(Q={"pg": 1.0, "e": -1.0})
    with pytest.raises(UnsupportedProgramError, match=r"not convex.*ipopt"):
        solve(indefinite, "dc", solver="qp")
    coupled = [[1.0, 0.0, 0.9], [0.0, 1.0, 0.0], [0.9, 0.0, 1.0]]
    both = [
        solve(om.LinearQuadratic(Q=coupled), "soc", solver=solver).objective for solver in ("conic", "ipopt")
    ]
    assert both[0] == pytest.approx(both[1], rel=1e-5)


@given(seed=st.integers(0, 2**32 - 1))
def test_a_matrix_counts_with_its_symmetric_part(seed: int) -> None:
    rng = np.random.default_rng(seed)
    plan = _PLAN
    generators, storages = plan.data.sizes["generator"], plan.data.sizes["storage"]
    n = 2 * generators + storages
    matrix = rng.normal(size=(n, n))
    d = plan.data / 50  # base of the grid
    x = np.hstack([d["pg"].values, d["qg"].values, d["e"].values])
    expected = np.einsum("ti,ij,tj->t", x, matrix, x)
    found = om.LinearQuadratic(Q=matrix.tolist()).stage_cost(plan.stage)
    assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


_PLAN = om.MultiStage(everything(), 4, profiles=demand(4)).solve()


def test_the_single_stage_sequence_solves_equal_demands_once() -> None:
    series = {"town.p": [80.0, 100, 80, 100, 90], "town.q": [20.0, 30, 20, 30, 25]}
    problem = om.MultiStage(two_bus(), 2, profiles=series)
    sequence = om.single_stage_sequence(problem, 5)
    assert sequence.plan.problem.stages == 3
    alone = []
    for p, q in zip(series["town.p"], series["town.q"], strict=True):
        grid = two_bus()
        grid.remove("cell")
        grid.update("town", p=p, q=q)
        alone.append(om.MultiStage(grid).solve().objective)
    assert_allclose(sequence.cost_rate, alone, rtol=1e-7)
    assert sequence.cost == pytest.approx(sum(alone), rel=1e-7)
    setpoints = sequence.setpoints().values
    assert_allclose(setpoints["coal.pg"], sequence.data["pg"].values[:, 0])
    assert (setpoints["cell.e"], setpoints["cell.ps"]) == (100, 0)


def test_the_single_stage_sequence_follows_an_objective_that_changes_in_time() -> None:
    grid = two_bus()
    grid.gas = om.Generator("south", p=(0, 100))
    tracking = om.SetpointTracking({"coal.pg": [10, 20, 30, 20, 50]})
    problem = om.MultiStage(grid, formulation="dc", objective=tracking)
    sequence = om.single_stage_sequence(problem, 4, start=1)
    assert sequence.plan.problem.stages == 3
    assert_allclose(sequence.data["pg"].sel(generator="coal"), [20, 30, 20, 50], atol=1e-4)
    assert sequence.cost == pytest.approx(0, abs=1e-6)
    with pytest.raises(ModelError, match="pg_setpoint has 5 values; 5 single stages from step 1 need 6"):
        om.single_stage_sequence(problem, 5, start=1)


@pytest.mark.parametrize("weight", ["heavy", -1.0])
def test_weights_of_the_economic_objective_are_checked(weight: object) -> None:
    with pytest.raises(ModelError, match=r"economic: energy_weight = .*: must be"):
        om.Economic(energy_weight=weight)  # type: ignore[arg-type]


def test_a_step_without_an_optimum_is_named() -> None:
    series = {"town.p": [80.0, 500, 80], "town.q": [20.0, 30, 20]}
    with pytest.raises(ModelError, match="single-stage optimum of step 1: locally_infeasible"):
        om.single_stage_sequence(om.MultiStage(two_bus(), profiles=series), 3)
