"""Checks of the theory on small systems whose answers are known, also where a property fails."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SCENARIOS, Call, two_bus

import opfmodel as om
from opfmodel.analysis.arcs import estimated_arc
from opfmodel.analysis.dissipativity import _Search, check_dissipativity
from opfmodel.analysis.figure import turnpike_figure
from opfmodel.analysis.finding import Verdict
from opfmodel.analysis.performance_bound import check_performance_bound
from opfmodel.analysis.practical_stability import check_practical_stability
from opfmodel.analysis.recursive_feasibility import Margins, check_recursive_feasibility
from opfmodel.analysis.steady_state import check_steady_state
from opfmodel.analysis.subject import NoSteadyStateError, Subject
from opfmodel.analysis.turnpike import check_turnpike
from opfmodel.errors import ModelError
from opfmodel.simulation import Outage, Outages

HOLDS, VIOLATED, UNDECIDED = Verdict.HOLDS, Verdict.VIOLATED, Verdict.UNDECIDED

# Two units, 0.02 p² + 10 p and 0.03 p² + 12 p, serve 150 MW at equal marginal cost: 110 and 40 MW.
PRICE, COST = 14.4, 1870.0  # $/MWh, $/h
# The cost of storage power P p.u. is c P² with 1 / c = 1 / (0.02 * 100²) + 1 / (0.03 * 100²).
CURVATURE = 120.0  # $/(h p.u.²) on 100 MVA


def one_bus(
    stages: int = 6,
    *,
    base: float = 100.0,
    demand: float | list[float] = 150.0,
    ramp: float | None = 50.0,
    coal: float = 200.0,
    target: float | None = 50.0,
    cell: Mapping[str, Any] | None = None,
    **options: Any,
) -> om.MultiStage:
    """Two units, a storage and a load; a half-full storage is worth ``target`` $/(h p.u.²)."""
    grid = om.Network("one-bus", base_mva=base)
    grid.a = om.Bus(vm=(0.9, 1.1), reference=True)
    grid.coal = om.Generator("a", p=(0, coal), q=(-100, 100), ramp=ramp, cost=om.Polynomial(0.02, 10, 0))
    grid.gas = om.Generator("a", p=(0, 200), q=(-100, 100), ramp=ramp, cost=om.Polynomial(0.03, 12, 0))
    if cell is not None:
        grid.cell = om.Storage("a", **{"energy": 100, "power": 40, "q": 10, **cell})
    first = demand[0] if isinstance(demand, list) else demand
    grid.town = om.Load("a", p=first)
    profiles = {"town.p": demand} if isinstance(demand, list) else None
    objective = om.Economic() if target is None else om.Economic() + om.StateOfChargeTracking(weight=target)
    options = {"formulation": "copperplate", "objective": objective, "profiles": profiles, **options}
    return om.MultiStage(grid, stages, **options)


def lossless(stages: int = 6, **options: Any) -> om.MultiStage:
    return one_bus(stages, **{"cell": {}, **options})


def bukhsh(most: float) -> om.MultiStage:
    """The 2-bus system WB2 of Bukhsh et al. (2013), whose feasible set is not convex, with a storage."""
    grid = om.Network("wb2", base_mva=100)
    grid.a = om.Bus(vm=(0.95, 1.05), reference=True)
    grid.b = om.Bus(vm=(0.95, most))
    grid.ab = om.Branch("a", "b", r=0.04, x=0.2)
    grid.coal = om.Generator("a", p=(0, 600), q=(-400, 400), cost=om.Polynomial(0.0, 2, 0))
    grid.cell = om.Storage("b", energy=100, power=40, q=0)
    grid.town = om.Load("b", p=350, q=-350)
    return om.MultiStage(grid, 3, objective=om.Economic(1e-3, 1e-3))


def triangle(formulation: str = "ac") -> om.MultiStage:
    """Three buses, two units, one storage, and a line at its rating when demand grows."""
    grid = om.Network("triangle", base_mva=100)
    for name in "abc":
        grid.add(name, om.Bus(vm=(0.95, 1.05), reference=name == "a"))
    grid.ab = om.Branch("a", "b", r=0.01, x=0.06, b=0.02, rating=70)
    grid.bc = om.Branch("b", "c", r=0.02, x=0.08, rating=60)
    grid.ac = om.Branch("a", "c", r=0.01, x=0.07, rating=80)
    grid.coal = om.Generator("a", p=(20, 150), q=(-80, 80), ramp=40, cost=om.Polynomial(0.02, 10, 0))
    grid.gas = om.Generator("b", p=(0, 80), q=(-60, 60), ramp=25, cost=om.Polynomial(0.03, 12, 0))
    grid.cell = om.Storage("c", energy=60, power=15, q=5, charge_efficiency=0.95, discharge_efficiency=0.9)
    grid.town, grid.mill = om.Load("c", p=70, q=20), om.Load("b", p=40, q=10)
    return om.MultiStage(grid, 2, formulation=formulation)


# Steady state -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("formulation", "base"), [("copperplate", 100.0), ("dc", 50.0), ("ac", 5000.0)], ids=str
)
def test_an_interior_steady_state(formulation: str, base: float) -> None:
    """Whatever the base; reactive power, if there is any, is held by a weight."""
    q = {"Q": {"qg": 10.0 * (base / 100) ** 2}} if formulation == "ac" else {}
    objective = om.Economic() + om.StateOfChargeTracking(weight=20.0 * (base / 100) ** 2)
    if q:
        objective = objective + om.LinearQuadratic(**q, R={"qs": 10.0 * (base / 100) ** 2})
    subject = Subject(lossless(base=base, formulation=formulation, objective=objective))
    start = subject.stored(0.0)
    start[:2] = 80 / base, 70 / base
    finding = check_steady_state(subject, start)
    found = finding.figures
    assert (finding.verdict, found["interior"], found["active"]) == (HOLDS, True, [])
    assert found["cost"] == pytest.approx(COST, rel=1e-8)
    assert found["lmp"]["a"] == pytest.approx(PRICE, rel=1e-7)
    assert found["state"]["coal.pg"] == pytest.approx(110, rel=1e-6)
    assert found["state"]["gas.pg"] == pytest.approx(40, rel=1e-6)
    assert found["state"]["cell.e"] == pytest.approx(50, rel=1e-5)
    assert found["storage_power"]["cell"] == pytest.approx(0, abs=1e-6)
    assert found["path"]["connected"]
    assert found["path"]["length"] == pytest.approx(np.linalg.norm([30, 30, 50]) / base, rel=1e-4)


def test_a_steady_state_on_the_boundary_names_the_limits() -> None:
    finding = check_steady_state(Subject(lossless(coal=100.0)))
    assert finding.verdict is VIOLATED
    assert finding.figures["active"] == ["coal: pg at its maximum of 100 MW"]
    assert "coal: pg at its maximum of 100 MW" in finding.explanation
    price = 12 + 2 * 0.03 * 50
    assert finding.figures["lmp"]["a"] == pytest.approx(price, rel=1e-7)


def test_a_constraint_on_the_boundary_is_named_whichever_component_it_holds_back() -> None:
    problem = lossless()
    problem.constrain("block", lambda stage: stage.generator.pg, at_least=[45.0])
    problem.constrain("loose", lambda stage: stage.generator.pg, at_most=[180.0])
    finding = check_steady_state(Subject(problem))
    assert finding.figures["state"]["gas.pg"] == pytest.approx(
        45, rel=1e-6
    )  # 40 MW without it, the second unit
    assert (finding.verdict, finding.figures["active"]) == (VIOLATED, ["constraint block"])


@pytest.mark.parametrize("formulation", ["copperplate", "ac"])
def test_that_no_steady_state_exists_is_proven(formulation: str) -> None:
    with pytest.raises(NoSteadyStateError, match=r"no steady state exists: bus a lacks 100\.0 MW") as none:
        Subject(lossless(demand=500.0, formulation=formulation)).steady  # noqa: B018
    assert none.value.proven


def test_a_steady_state_that_was_not_found_may_exist() -> None:
    """With an upper limit of 1.02 p.u. the solver fails, but every state of 1.00 p.u. is feasible."""
    assert Subject(bukhsh(1.0)).steady.cost == pytest.approx(905.73, abs=0.01)
    with pytest.raises(NoSteadyStateError, match="was found, nor a proof") as none:
        Subject(bukhsh(1.02)).steady  # noqa: B018
    assert not none.value.proven


def test_states_that_no_feasible_path_connects() -> None:
    """A unit may not run between 60 and 90 MW, so that the states below are cut off from x_s."""
    problem = lossless(ramp=None)
    problem.constrain("forbidden", lambda s: (s.generator.pg[[0]] - 75.0) ** 2, at_least=15.0**2)
    subject = Subject(problem)
    assert subject.physical(subject.steady.x)["coal.pg"] == pytest.approx(110, rel=1e-6)
    finding = check_steady_state(subject, np.array([0.4, 1.1, 0.5]))
    assert not finding.figures["path"]["connected"]
    assert (finding.verdict, finding.figures["interior"]) == (UNDECIDED, True)
    assert "no feasible path was found" in finding.explanation
    assert check_steady_state(subject, np.array([1.4, 0.1, 0.5])).verdict is HOLDS


def test_a_state_is_connected_with_itself() -> None:
    """Up to what the solver leaves undetermined: stored energy costs nothing here."""
    subject = Subject(triangle())
    path = check_steady_state(subject, subject.steady.x).figures["path"]
    assert (path["connected"], path["length"]) == (True, 0.0)


# Dissipativity ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("base", "weight", "least"),
    [(100.0, 20.0, 20.0), (50.0, 500.0, 50.0)],
    ids=str,
)
def test_alpha_is_the_smallest_eigenvalue_of_a_convex_system(
    base: float, weight: float, least: float
) -> None:
    """Of 0.02 and 0.03 $/MW²h on the base, and of the weight on stored energy."""
    finding = check_dissipativity(Subject(lossless(3, base=base, target=weight)))
    found = finding.figures
    assert finding.verdict is HOLDS
    assert found["curvature"] == pytest.approx(least, rel=1e-9)
    assert found["alpha"] == pytest.approx(least, rel=1e-5)
    assert found["alpha_certified"] == pytest.approx(least, rel=1e-5)
    assert found["storage_function"]["cell"] == pytest.approx(PRICE, rel=1e-7)
    assert found["along_closed_loop"]["least"] >= -finding.tolerance
    assert found["starts"] == 26


def test_a_storage_with_losses_is_worth_what_it_costs_to_charge() -> None:
    """In the steady state it is charged to cover the standing loss, which makes energy dearer."""
    losses = {"charge_efficiency": 0.9, "discharge_efficiency": 0.9, "standing_loss": 0.01}
    subject = Subject(lossless(3, cell=losses))
    finding = check_dissipativity(subject)
    marginal = subject.steady.plan.price("lmp")[0, 0] / 100
    assert finding.verdict is HOLDS
    assert subject.steady.plan.stage.storage.ps[0, 0] > 1e-3
    assert finding.figures["storage_function"]["cell"] == pytest.approx(marginal / 0.9, rel=1e-6)


def test_a_radial_feeder_is_certified_by_its_relaxation() -> None:
    problem = om.MultiStage(two_bus(), 3, objective=om.Economic(reactive_weight=1.0, energy_weight=1.0))
    finding = check_dissipativity(Subject(problem))
    assert (finding.verdict, finding.figures["relaxation"]) == (HOLDS, "soc")
    assert finding.figures["alpha_certified"] == pytest.approx(1.0, rel=1e-6)


def test_linear_costs_are_not_strictly_dissipative() -> None:
    """Generation may be exchanged for stored energy at the price of the steady state."""
    problem = lossless(3, target=None)
    problem.network.update("coal", cost=om.Polynomial(0, 10, 0))
    problem.network.update("gas", cost=om.Polynomial(0, 12, 0))
    finding = check_dissipativity(Subject(om.MultiStage(problem.network, 3, formulation="copperplate")))
    point = finding.figures["point"]
    assert (finding.verdict, finding.figures["alpha"]) == (VIOLATED, 0.0)
    assert "another stage is as cheap" in finding.explanation
    assert point["distance"] > 0.1
    assert abs(point["rotated_cost"]) <= finding.tolerance


def test_a_weight_below_the_tolerance_decides_nothing() -> None:
    finding = check_dissipativity(Subject(lossless(2, target=1e-7)))
    assert (finding.verdict, finding.figures["alpha_certified"]) == (UNDECIDED, None)
    assert "within the tolerance" in finding.explanation


def test_a_stage_that_beats_the_price_of_the_steady_state() -> None:
    """Its feasibility and cost follow from the equations of the line alone."""
    subject = Subject(bukhsh(1.0))
    finding = check_dissipativity(subject)
    point, price = finding.figures["point"], finding.figures["storage_function"]["cell"]
    assert (finding.verdict, finding.figures["alpha_certified"]) == (VIOLATED, None)
    state = {name: value / 100 for name, value in point["state"].items()}
    p, q, e = (state[name] for name in ("coal.pg", "coal.qg", "cell.e"))

    def received(v: float) -> tuple[complex, float]:
        current = np.conj((p + 1j * q) / v)
        across = v - (0.04 + 0.2j) * current
        return across * np.conj(current), abs(across)

    def excess(v: float) -> float:
        return received(v)[0].imag + 3.5  # the storage has no reactive power

    low, high = 0.95 - 1e-5, 1.05
    assert excess(low) * excess(high) < 0
    for _ in range(80):
        middle = (low + high) / 2
        low, high = (low, middle) if excess(low) * excess(middle) <= 0 else (middle, high)
    power, voltage = received((low + high) / 2)
    ps = power.real - 3.5
    assert 0.95 - 1e-6 <= low <= 1.05 + 1e-6
    assert power.imag == pytest.approx(-3.5, abs=1e-6)
    assert 0.95 - 1e-6 <= voltage <= 1.0 + 1e-6
    assert abs(ps) <= 0.4 + 1e-6
    assert -1e-6 <= e <= 1 + 1e-6
    assert -1e-6 <= e + ps <= 1 + 1e-6
    cost = 200 * p + 1e-3 * (q**2 + e**2)
    rotated = cost - subject.steady.cost - price * 100 * ps
    assert rotated == pytest.approx(point["rotated_cost"], abs=1e-3)
    assert rotated < -4
    assert point["distance"] == pytest.approx(np.linalg.norm([p, q, e] - subject.steady.x), rel=1e-6)


def test_the_five_bus_system_is_dissipative_up_to_its_smallest_weight() -> None:
    """No relaxation of a meshed grid certifies it; many starts find nothing below 1e-3, and something above."""
    subject = Subject(om.load_scenario(SCENARIOS / "case5-step.yaml").problem)
    search, tolerance = _Search(subject, starts=25), subject.tolerance
    alpha, _ = _Search(subject, starts=3).largest_alpha(1.5e-3, tolerance)
    assert alpha == pytest.approx(1e-3, rel=1e-2)
    assert search.lowest(1e-3).value(1e-3) >= -tolerance
    assert search.lowest(1.5e-3).value(1.5e-3) == pytest.approx(-0.01, rel=0.01)


@pytest.mark.parametrize(
    ("problem", "cause"),
    [
        (lossless(2, formulation="ac", cell={"charge_efficiency": 0.9, "exclusive": True}), "exclusive"),
        (lossless(2, objective=om.Economic() + om.LinearQuadratic(Q={"e": -5.0})), "concave cost"),
    ],
    ids=["exclusive", "concave"],
)
def test_without_a_convex_relaxation_nothing_is_certified(problem: om.MultiStage, cause: str) -> None:
    finding = check_dissipativity(Subject(problem))
    assert finding.verdict is not HOLDS, cause
    assert (finding.figures["lower"], finding.figures["alpha_certified"]) == (None, None)


def test_an_objective_without_a_cost_in_the_formulation() -> None:
    """Reactive power is not tracked without reactive power; every stage is as cheap."""
    problem = lossless(2, objective=om.SetpointTracking({"coal.qg": 3}))
    finding = check_dissipativity(Subject(problem))
    assert (finding.verdict, finding.figures["alpha"]) == (VIOLATED, 0.0)


def test_why_nothing_is_certified_with_a_linear_cost() -> None:
    problem = one_bus(2, target=None)
    problem.network.update("gas", cost=om.Polynomial(0, 12, 0))
    problem = om.MultiStage(problem.network, 2, formulation="copperplate")
    finding = check_dissipativity(Subject(problem))
    assert finding.verdict is UNDECIDED
    assert "Q is not positive definite" in finding.explanation


# Turnpike ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("base", [100.0, 50.0])
def test_the_rate_of_the_arcs(base: float) -> None:
    arc = estimated_arc(Subject(lossless(base=base)))
    assert arc.generation == pytest.approx(CURVATURE * (base / 100) ** 2, rel=1e-6)
    assert arc.energy == pytest.approx(50.0, rel=1e-9)
    assert arc.rate == pytest.approx(np.sqrt(50.0 / (CURVATURE * (base / 100) ** 2)), rel=1e-6)
    assert (arc.emptying, arc.round_trip) == (2.5, 0.0)


def test_standing_losses_do_not_change_the_rate() -> None:
    """The steady state has storage power, about which the curvature is taken."""
    losses = {"charge_efficiency": 0.9, "discharge_efficiency": 0.9, "standing_loss": 0.01}
    subject = Subject(lossless(cell=losses))
    arc = estimated_arc(subject)
    assert arc.generation == pytest.approx(CURVATURE, rel=1e-6)
    price = subject.steady.plan.price("lmp")[0, 0]
    assert arc.round_trip == pytest.approx(price * (1 / 0.9 - 0.9), rel=1e-9)
    assert estimated_arc(Subject(one_bus())) is None


def test_plans_settle_near_the_steady_state() -> None:
    finding = check_turnpike(Subject(lossless()), horizons=[3, 6, 12, 24])
    found = finding.figures
    assert (finding.verdict, found["horizons"]) == (HOLDS, [3, 6, 12, 24])
    assert found["outside"] == sorted(found["outside"])
    assert all(out <= stages for out, stages in zip(found["outside"], found["horizons"], strict=True))
    assert found["outside"][-1] == found["outside"][-2] < 12
    assert found["growth"] == 0.0
    for start in found["by_initial_state"].values():
        for out, before, after in zip(
            *(start[k] for k in ("outside", "approaching", "leaving")), strict=True
        ):
            assert before + after == out
    assert [len(found["distance"]["full"][str(n)]) for n in (3, 24)] == [3, 24]


def test_energy_that_costs_nothing_is_drawn_nowhere() -> None:
    finding = check_turnpike(Subject(lossless(target=None)), horizons=[8, 16])
    assert (finding.verdict, finding.figures["expected_arc"]) == (VIOLATED, None)
    assert "stored energy has no cost" in finding.explanation


def test_horizons_between_the_two_arcs_decide_nothing() -> None:
    """With steps of half an hour each arc takes 7: of 12 steps, all are outside the ball, of 48 only 15."""
    subject = Subject(lossless(step=0.5))
    finding = check_turnpike(subject, horizons=[11, 12])
    assert (finding.verdict, finding.figures["outside"]) == (UNDECIDED, [11, 12])
    finding = check_turnpike(subject)
    assert (finding.verdict, finding.figures["outside"][-1]) == (HOLDS, 15)


def test_losses_delay_a_turnpike() -> None:
    """Charging pays only over many hours, so that short plans leave an empty storage empty."""
    subject = Subject(lossless(cell={"charge_efficiency": 0.95}))
    early, whole = check_turnpike(subject, horizons=[12, 24]), check_turnpike(subject)
    assert (early.verdict, early.figures["outside"]) == (UNDECIDED, [12, 24])
    assert (whole.verdict, whole.figures["outside"][-1]) == (HOLDS, 7)


def test_arcs_of_unknown_length_deny_nothing() -> None:
    """A storage that can only charge has no arc whose curvature could be measured."""
    finding = check_turnpike(Subject(lossless(cell={"power": (0, 40)})), horizons=[3, 6])
    assert (finding.verdict, finding.figures["outside"]) == (UNDECIDED, [3, 6])
    assert "could not be estimated" in finding.explanation


def test_the_figure_without_plans_from_full_storages() -> None:
    """Full storages are the steady state."""
    objective = om.Economic() + om.StateOfChargeTracking(share=1.0, weight=50.0)
    finding = check_turnpike(Subject(lossless(objective=objective)), horizons=[3, 6])
    assert list(finding.figures["distance"]) == ["empty", "half full"]
    titles = [axis.get_title() for axis in turnpike_figure(finding, "one-bus").axes]
    assert titles[0] == "one-bus: half full storages"


# Practical stability ----------------------------------------------------------------------------


def test_closed_loops_end_near_the_steady_state_if_the_horizon_is_long_enough() -> None:
    """Short plans sell stored energy before their end, and settle away from the target."""
    subject = Subject(lossless())
    short = check_practical_stability(subject, horizons=[1, 2], steps=12)
    assert (short.verdict, short.figures["smallest_horizon"]) == (VIOLATED, None)
    assert short.figures["distance"][0] == pytest.approx(0.5, abs=1e-3)  # all is sold
    assert short.figures["distance"][1] > 0.3
    assert "the horizon is too short" in short.explanation
    both = check_practical_stability(subject, horizons=[2, 8], steps=16)
    assert (both.verdict, both.figures["smallest_horizon"]) == (HOLDS, 8)
    assert both.figures["distance"][1] < 0.02
    assert both.figures["failures"] == []


def test_loops_that_still_move_decide_nothing() -> None:
    finding = check_practical_stability(Subject(lossless()), horizons=[8], steps=1)
    assert finding.verdict is UNDECIDED
    assert "still on their way" in finding.explanation


@pytest.mark.parametrize(
    ("options", "cause"),
    [({"target": None}, "stored energy has no cost"), ({"end": om.End(price=20)}, "final energy")],
    ids=["no cost", "price"],
)
def test_why_loops_settle_elsewhere(options: dict[str, Any], cause: str) -> None:
    finding = check_practical_stability(Subject(lossless(2, **options)), horizons=[2], steps=4)
    assert finding.verdict is VIOLATED
    assert cause in finding.explanation


# Recursive feasibility --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("state", "up", "down"),
    [
        ({"pg": [110, 40], "e": [50]}, 50 + 50 + 40, 50 + 40 + 40),
        ({"pg": [180, 40], "e": [20]}, 20 + 50 + 20 + 70, 50 + 40 + 40 - 70),
        ({"pg": [110, 40], "e": [95]}, 50 + 50 + 40, 50 + 40 + 5),
    ],
    ids=["ramps", "capacity", "energy"],
)
def test_margins_of_one_bus(state: dict[str, list[float]], up: float, down: float) -> None:
    """Ramps, capacities, and power and energy of the storage add up; demand is 150 MW."""
    margins = Margins(lossless(1))
    for sign, margin in ((1.0, up), (-1.0, down)):
        found = margins.largest(0, state, np.array([sign * 100.0]), np.zeros(1))
        assert 100 * found == pytest.approx(margin, rel=1e-6)
        assert margins.bound(0, state, np.array([sign * 100.0]), np.zeros(1)) >= found - 1e-6


@pytest.mark.parametrize("formulation", ["ac", "dc"])
@pytest.mark.parametrize(
    "where", [{"town": (70, 20), "mill": (40, 10)}, {"town": (100, 0)}], ids=["all", "c"]
)
@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["up", "down"])
def test_margins_are_where_feasibility_ends(
    formulation: str, where: dict[str, tuple[float, float]], sign: float
) -> None:
    """A plan with the loads changed meets all equations just below, and none does just above."""
    problem = triangle(formulation)
    state = {"pg": [80.0, 32.0], "e": [30.0]}
    direction = np.zeros((2, 3))
    for load, bus in (("mill", 1), ("town", 2)):
        direction[:, bus] = np.array(where.get(load, (0, 0))) * sign
    largest = Margins(problem).largest(0, state, *direction)
    assert largest > 0.1
    for share, feasible in ((1 - 1e-6, True), (1 + 1e-6, False)):
        grid = problem.network.copy()
        for load, (p, q) in where.items():
            by = sign * share * largest
            at = grid[load]
            grid.update(load, p=at.p + by * p, q=at.q + by * q)
        changed = om.MultiStage(
            grid,
            formulation=formulation,
            solver="ipopt",
            options={"tol": 1e-9, "constr_viol_tol": 1e-9, "bound_relax_factor": 0.0, "acceptable_iter": 0},
        )
        solution = changed.solve(initial=state).solution
        assert (solution.status.is_optimal and solution.primal_residual < 1e-8) == feasible


def test_a_loop_that_breaks_off_is_not_reported_to_hold() -> None:
    """Its plans fail as soon as they see the last step; the steps before could all be served."""
    problem = lossless(3, demand=[150.0] * 5 + [900.0] + [150.0] * 3)
    run = om.simulate(problem, steps=6, initial={"pg": [110, 40], "e": [50]})
    finding = check_recursive_feasibility(problem, run)
    assert (len(run.steps), finding.verdict) == (3, UNDECIDED)
    assert "broke off in step 3" in finding.explanation


def test_wrong_arguments_are_named() -> None:
    with pytest.raises(om.OpfmodelError, match="must be a Scenario"):
        om.analyze("two-bus.yaml")  # type: ignore[arg-type]


@pytest.mark.parametrize("formulation", ["copperplate", "ac"])
def test_a_step_that_ramps_cannot_follow_is_proven_infeasible(formulation: str) -> None:
    """A plan of one stage sells 40 MWh, then the last 10 MWh, and leaves the units at 110 and 160 MW."""
    problem = lossless(1, demand=[150.0, 170.0, 500.0, 150.0], formulation=formulation)
    run = om.simulate(problem, steps=4, initial={"pg": [110, 40], "e": [50]})
    finding = check_recursive_feasibility(problem, run)
    found = finding.figures
    assert (finding.verdict, found["infeasible_steps"], found["undecided_steps"]) == (VIOLATED, [2], [])
    assert (len(run.steps), found["run"]) == (2, run.status)
    assert run.status != "done"
    assert "step 2 is proven infeasible" in finding.explanation
    assert found["up_mw"] == pytest.approx([110 + 100 + 10 - 170, 160 + 100 - 500], rel=1e-5)
    assert found["change"] == pytest.approx([220 / 20 - 150 / 20, (260 - 170) / 330], rel=1e-5)
    assert found["least_up"] == {"value": found["up_mw"][1], "step": 2}
    assert found["buses"]["up_mw"]["a"] == pytest.approx(found["up_mw"][1], rel=1e-5)


def test_a_step_with_too_little_demand_is_proven_infeasible() -> None:
    """Ramps lower the units by 50 and 40 MW, to 60 MW."""
    problem = one_bus(1, demand=[150.0, 20.0], target=None)
    run = om.simulate(problem, steps=2, initial={"pg": [110, 40]})
    finding = check_recursive_feasibility(problem, run)
    assert (finding.verdict, finding.figures["infeasible_steps"]) == (VIOLATED, [1])
    assert finding.figures["up_mw"][0] > 0
    assert finding.figures["down_mw"][0] == pytest.approx(20 - 60, rel=1e-5)


def test_a_margin_that_no_solve_found_decides_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Margins, "largest", lambda self, time, state, p, q: 0.5 if p[0] < 0 else None)
    problem = lossless(1)
    run = om.simulate(problem, steps=2, initial={"pg": [110, 40], "e": [50]})
    finding = check_recursive_feasibility(problem, run)
    assert (finding.verdict, finding.figures["undecided_steps"]) == (UNDECIDED, [1])
    assert finding.figures["least_up"] is None


def test_demand_between_two_margins_may_not_be_served(monkeypatch: pytest.MonkeyPatch) -> None:
    """Demand that can be served need not be an interval; here margins on both sides are pretended."""
    monkeypatch.setattr(Margins, "largest", lambda *_: 0.5)
    problem = lossless(1, demand=[150.0, 500.0])
    run = om.simulate(problem, steps=2, initial={"pg": [110, 40], "e": [50]})
    finding = check_recursive_feasibility(problem, run)
    assert (finding.verdict, finding.figures["infeasible_steps"]) == (VIOLATED, [1])


def test_reactive_demand_alone_can_be_infeasible() -> None:
    grid = one_bus(ramp=None).network
    problem = om.MultiStage(grid, 1, profiles={"town.p": [0, 0], "town.q": [10, 300]})
    finding = check_recursive_feasibility(problem, om.simulate(problem, steps=2))
    assert (finding.verdict, finding.figures["infeasible_steps"]) == (VIOLATED, [1])


def test_margins_without_a_component_that_is_out_of_service() -> None:
    """Coal can rise from 110 to 160 MW, and the storage gives 40 MW."""
    problem = lossless(1, demand=[150.0, 150.0], outages=["gas"])
    margins = Margins(problem, Outages((Outage("gas", 1, 1),)))
    state = {"pg": [110, 0], "e": [50]}
    for time, margin in ((0, 50 + 50 + 40 - 40), (1, 50 + 40 - 40)):
        found = margins.largest(time, state, np.array([100.0]), np.zeros(1))
        assert 100 * found == pytest.approx(margin, rel=1e-6)


# Performance bound ------------------------------------------------------------------------------


def test_plans_cost_no_more_than_the_steady_states() -> None:
    finding = check_performance_bound(Subject(lossless(4, demand=[150.0, 180.0, 170.0, 200.0], target=None)))
    found = finding.figures
    demand = np.array([150.0, 180.0, 170.0, 200.0])
    coal = (2 + 0.06 * demand) / 0.1
    gas = demand - coal
    bound = float((0.02 * coal**2 + 10 * coal + 0.03 * gas**2 + 12 * gas).sum())
    assert (finding.verdict, found["binding_ramps"], found["stages"]) == (HOLDS, [], 4)
    assert found["bound"] == pytest.approx(bound, rel=1e-8)
    assert found["variants"]["without ramps and storage"] == pytest.approx(bound, rel=1e-7)
    assert found["value"] < 0.99 * bound
    assert found["saving"] == pytest.approx(1 - found["value"] / bound)


@pytest.mark.parametrize("formulation", ["copperplate", "ac"])
def test_tight_ramps_break_the_bound(formulation: str) -> None:
    """From 150 to 260 MW the units should move by 66 and 44 MW, but each can move by 55.

    They share the difference of 11 MW between the two stages, at 0.02 + 0.03 $/MW²h.
    """
    problem = one_bus(2, demand=[150.0, 260.0], ramp=55.0, formulation=formulation, target=None)
    finding = check_performance_bound(Subject(problem))
    bound = COST + 0.02 * 176**2 + 10 * 176 + 0.03 * 84**2 + 12 * 84
    assert finding.verdict is VIOLATED
    assert finding.figures["value"] == pytest.approx(bound + 2 * 0.05 * 5.5**2, rel=1e-7)
    assert finding.figures["bound"] == pytest.approx(bound, rel=1e-7)
    assert finding.figures["variants"]["without ramps"] == pytest.approx(bound, rel=1e-7)
    assert finding.figures["binding_ramps"] == ["coal", "gas"]
    assert "above the bound" in finding.explanation
    assert "without ramps it holds, and the ramps of coal, gas bind" in finding.explanation


def test_a_bound_of_zero() -> None:
    """Tracking costs vanish in the steady state."""
    finding = check_performance_bound(Subject(lossless(2, objective=om.StateOfChargeTracking())))
    assert (finding.verdict, finding.figures["saving"]) == (HOLDS, None)
    assert "V_N equals the bound" in finding.explanation


def test_a_later_step_without_a_steady_state() -> None:
    finding = check_performance_bound(Subject(lossless(3, demand=[150.0, 150.0, 500.0])))
    assert finding.verdict is UNDECIDED
    assert "step 2: no steady state was found" in finding.explanation


@pytest.mark.parametrize(("at_end", "stages"), [("error", 2), ("shrink", 2), ("repeat", 3)])
def test_a_plan_that_reaches_the_end_of_the_data(at_end: str, stages: int) -> None:
    problem = lossless(3, demand=[150.0, 160.0, 170.0, 150.0], target=None, at_end=at_end)
    finding = check_performance_bound(Subject(problem, 2))
    assert (finding.verdict, finding.figures["stages"]) == (HOLDS, stages)
    assert finding.figures["variants"]["without ramps and storage"] == pytest.approx(
        finding.figures["bound"], rel=1e-7
    )


def test_a_bound_that_no_convex_problem_denies_is_undecided() -> None:
    """A storage that may not charge and discharge at once is not convex, and has no proven lower bound."""
    cell = {"power": 0.01, "charge_efficiency": 0.9, "exclusive": True}
    problem = one_bus(2, demand=[150.0, 260.0], ramp=55.0, target=None, cell=cell)
    finding = check_performance_bound(Subject(problem))
    assert finding.figures["value"] > finding.figures["bound"] + 1
    assert finding.verdict is UNDECIDED


# The function and the command -------------------------------------------------------------------

SCENARIO = """\
name: one-bus
network:
  base_mva: 100
  buses: {a: {vm: [0.9, 1.1], reference: true}}
  generators:
    coal: {bus: a, p: [0, 200], q: [-100, 100], ramp: 50, cost: {c2: 0.02, c1: 10}}
    gas: {bus: a, p: [0, 200], q: [-100, 100], ramp: 50, cost: {c2: 0.03, c1: 12}}
  storages: {cell: {bus: a, energy: 100, power: 40, q: 10}}
  loads: {town: {bus: a, p: 150}}
time: {step: 1.0, steps: 3}
profiles: [{step: {loads: [town], first: 1, last: 1, add: 10}}]
cost: [economic, {state-of-charge-tracking: {weight: 50}}]
controller: {horizon: 3, formulation: copperplate}
variants:
  beyond: {network: {loads: {town: {p: 500}}}}
"""


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    path = tmp_path / "one-bus.yaml"
    path.write_text(SCENARIO)
    return path


FIGURES = {
    "steady_state": {"cost", "state", "storage_power", "lmp", "interior", "active", "path"},
    "dissipativity": {
        "storage_function", "curvature", "quadratic", "alpha", "alpha_certified", "lower", "upper",
        "relaxation", "starts", "point", "along_closed_loop",
    },
    "turnpike": {
        "horizons", "outside", "epsilon", "by_initial_state", "base_steps_per_stage", "expected_arc",
        "curvature", "distance", "growth",
    },
    "practical_stability": {
        "horizons", "distance", "by_initial_state", "settled", "steps", "smallest_horizon", "failures",
    },
    "recursive_feasibility": {
        "steps", "change", "up_mw", "down_mw", "infeasible_steps", "undecided_steps", "run", "least_change",
        "least_up", "least_down", "buses",
    },
    "performance_bound": {"bound", "value", "saving", "variants", "binding_ramps", "stages"},
}  # fmt: skip


def test_the_command_runs_all_checks_in_the_order_of_the_paper(call: Call, scenario: Path) -> None:
    code, out, _ = call("analyze", scenario, "--json")
    found = json.loads(out)
    assert (found["scenario"], found["step"]) == ("one-bus", 0)
    assert list(found["checks"]) == list(FIGURES)
    for name, check in found["checks"].items():
        assert set(check) == FIGURES[name] | {"verdict", "statement", "explanation", "tolerance"}, name
    verdicts = {name: check["verdict"] for name, check in found["checks"].items()}
    stability = verdicts.pop("practical_stability")  # three stages are too short
    assert (stability, set(verdicts.values()), code) == ("violated", {"holds"}, 1)


def test_a_single_check_and_its_status(call: Call, scenario: Path) -> None:
    code, out, err = call("analyze", scenario, "--only", "performance_bound", "--json")
    assert (code, list(json.loads(out)["checks"]), err) == (0, ["performance_bound"], "")
    code, out, _ = call("analyze", scenario, "--only", "steady_state", "--step", "1", "--json")
    found = json.loads(out)
    assert (code, found["step"]) == (0, 1)
    assert found["checks"]["steady_state"]["lmp"]["a"] == pytest.approx(PRICE + 10 * 2 * 0.012, rel=1e-7)
    code, out, _ = call("analyze", scenario, "--only", "steady_state")
    assert code == 0
    assert "holds" in out


def test_a_steady_state_on_the_boundary_is_printed(call: Call, scenario: Path) -> None:
    limit = ("--set", "network.generators.coal.p=[0, 100]")
    code, out, _ = call("analyze", scenario, "--only", "steady_state", *limit)
    assert code == 1
    assert "limits that bind in the steady state\n  coal: pg at its maximum of 100 MW\n" in out


def test_without_a_steady_state_the_other_checks_are_undecided(
    call: Call, scenario: Path, tmp_path: Path
) -> None:
    only = [word for name in ("steady_state", "dissipativity", "turnpike") for word in ("--only", name)]
    code, out, _ = call("analyze", scenario, "--variant", "beyond", *only, "--json", "--out", tmp_path)
    checks = json.loads(out)["checks"]
    assert code == 1
    assert [check["verdict"] for check in checks.values()] == ["violated", "undecided", "undecided"]
    for check in checks.values():
        assert check["explanation"] == "step 0: no steady state exists: bus a lacks 100.0 MW at hour 0"
    assert json.loads((tmp_path / "analysis.json").read_text())["checks"] == checks


def test_results_are_written_beside_other_files(call: Call, scenario: Path, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    others = [folder / name for name in ("summary.json", "system.png", "notes.txt")]
    for other in others:
        other.write_text("kept")
    options = ("--only", "turnpike", "--horizons", "12,3,6,6", "--out", folder)
    code, out, _ = call("analyze", scenario, *options, "--json")
    assert code == 0
    assert json.loads((folder / "analysis.json").read_text()) == json.loads(out)
    assert json.loads(out)["checks"]["turnpike"]["horizons"] == [3, 6, 12]
    assert (folder / "turnpike.png").read_bytes().startswith(b"\x89PNG")
    assert (folder / "turnpike.pdf").read_bytes().startswith(b"%PDF")
    assert [other.read_text() for other in others] == ["kept"] * 3


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (("--only", "turnpik"), ("'turnpik'", "turnpike")),
        (("--step", "99"), ("step = 99", "0 to ")),
        (("--step=-1",), ("step", "-1")),
        (("--horizons", "48;96"), ("--horizons", "48;96")),
        (("--horizons", "1,2"), ("horizons", "1")),
    ],
    ids=str,
)
def test_bad_options_are_named(
    call: Call, scenario: Path, options: tuple[str, ...], named: tuple[str, str]
) -> None:
    code, out, err = call("analyze", scenario, *options)
    assert (code, out) == (2, "")
    assert all(word in err for word in named), err
    assert err.count("\n") == 1


def test_the_function_refuses_what_it_does_not_know(scenario: Path) -> None:
    loaded = om.load_scenario(scenario)
    with pytest.raises(ModelError, match="check 'turnpik': no such check"):
        om.analyze(loaded, ["turnpik"])
    with pytest.raises(ModelError, match="step = 99"):
        om.analyze(loaded, step=99)
    found = om.analyze(loaded, ["steady_state", "steady_state"])
    assert list(found.checks) == ["steady_state"]
    assert not found.violated
