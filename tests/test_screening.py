"""Secure plans from few contingencies, and the flows after outages that tell which are survived."""

from __future__ import annotations

from itertools import pairwise

import networkx as nx
import numpy as np
import pytest
from test_security import ENERGY, HORIZONS, TIGHT, demand, grid, solved

import opfmodel as om
from opfmodel.network.arrays import per_unit
from opfmodel.network.branch_outages import ACOutages, DCOutages, Reserve
from opfmodel.network.shares import divide
from opfmodel.plan.response import Outcome, Responses, Worst, stages_of
from opfmodel.plan.screening import worst_of

PGLIB = "tests/data/pglib/pglib_opf_{}.m"
STATE = {"e": list(ENERGY.values()), "pg": [80.0, 60.0]}


def series_of(horizon: om.Horizon, most: float) -> list[om.Profiles]:
    if horizon.is_chain:
        return []
    return [demand(horizon.steps, 0.95), demand(horizon.steps, most)]


# Screened plans -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("which", "formulation", "response"),
    [
        *(("tree", each, "corrective") for each in ("ac", "dc-matpower", "soc")),
        *(("tree", each, "preventive") for each in ("ac", "ac-rectangular", "dc")),
        ("chain", "ac", "preventive"),
        ("uneven", "dc", "corrective"),
    ],
)
def test_a_screened_plan_is_that_of_all_contingencies(which: str, formulation: str, response: str) -> None:
    horizon, corrective = HORIZONS[which], response == "corrective"
    series = series_of(horizon, 1.1 if corrective else 1.02)
    rating = TIGHT[which] if corrective else 1.4
    made = {
        screen: solved(
            horizon,
            om.Security("all", response, minutes=30, rating=rating, screen=screen),
            formulation,
            series=series,
        )
        for screen in (True, False)
    }
    assert made[True].optimal, made[True].termination
    assert made[True].objective == pytest.approx(made[False].objective, rel=1e-6)
    # the dispatch of a linear optimum need not be unique
    for name in ("lmp",) if formulation.startswith("dc") else ("pg", "ps", "lmp"):
        ours, theirs = made[True].data[name].values, made[False].data[name].values
        assert ours == pytest.approx(theirs, abs=0.02)
    rounds = made[True].rounds
    assert not rounds[-1].violated
    assert rounds[0].included == 0
    assert all(later.included == former.included + len(former.added) for former, later in pairwise(rounds))
    assert 0 < rounds[-1].included < made[False].request.horizon.contingencies.size
    assert made[True].request.horizon.contingencies.size == rounds[-1].included


def test_the_worst_outage_of_each_component_and_stage_is_added() -> None:
    def outcome(out: str, stage: int, name: str | None, value: float = 0.0) -> Outcome:
        worst = None if name is None else Worst("branch", name, "rating", value, "MVA", "")
        return Outcome(out, "", stage, "violated", worst)

    mild, bad = outcome("ab", 0, "cd", 2.0), outcome("bc", 0, "cd", 5.0)
    later, other, unknown = outcome("ab", 1, "cd", 1.0), outcome("ab", 0, "ac", 1.0), outcome("ac", 0, None)
    assert set(worst_of([mild, bad, later, other, unknown])) == {bad, later, other, unknown}


def test_units_and_storages_are_screened_too() -> None:
    out = {"generators": ["gas"], "storages": ["cell"], "branches": ["bc"]}
    horizon = om.Horizon.chain(3)
    costs = [
        solved(horizon, om.Security(out, minutes=20, rating=1.3, screen=screen)).objective
        for screen in (True, False)
    ]
    assert costs[0] == pytest.approx(costs[1], rel=1e-6)
    assert costs[0] > solved(horizon, None).objective + 1.0


def test_a_loop_keeps_what_it_has_found() -> None:
    security = om.Security(minutes=30, rating=1.15)
    runs = {}
    for screen in (True, False):
        own = om.Security(minutes=30, rating=1.15, screen=screen)
        problem = om.MultiStage(grid(), 3, profiles=demand(8), security=own)
        runs[screen] = om.simulate(problem, steps=4, initial=STATE)
        assert runs[screen].status == "done"
    assert runs[True].cost == pytest.approx(runs[False].cost, rel=1e-5)
    recorded = [plan["screening"] for plan in runs[True].plans]
    included = [rounds[-1]["included"] for rounds in recorded]
    assert included == sorted(included)
    assert recorded[0][0]["included"] == 0
    assert all(
        rounds[0]["included"] == former for rounds, former in zip(recorded[1:], included, strict=False)
    )
    assert not any(plan["screening"] for plan in runs[False].plans)
    assert {plan["status"] for plan in runs[True].plans} == {"locally_optimal"}
    problem = om.MultiStage(grid(), 3, profiles=demand(8), security=security)
    first = problem.solve(initial=STATE)
    cold, warm = problem.solve(1, first.next_state()), problem.solve(1, first.next_state(), first)
    assert warm.objective == pytest.approx(cold.objective, rel=1e-6)
    assert warm.solution.iterations < cold.solution.iterations


def test_what_is_lacking_is_said_with_the_outage() -> None:
    security = om.Security({"branches": ["ab"]}, minutes=5, rating=0.8)
    problem = om.MultiStage(grid(), 3, profiles=demand(3), security=security)
    state = {"e": [0.0, 0.0], "pg": [140.0, 10.0]}
    plan = problem.solve(initial=state)
    assert not plan.optimal
    assert plan.rounds[-1].included > 0
    twin = problem.elastic_twin().solve(initial=state)
    assert twin.optimal
    assert all("after the outage of ab" in str(shortage) for shortage in twin.shortages)
    assert twin.shortages


def test_an_infeasible_plan_is_not_screened() -> None:
    problem = om.MultiStage(grid(), 2, profiles=demand(2, 3.0), security=om.Security(rating=2))
    plan = problem.solve(initial=STATE)
    assert plan.infeasible
    assert [each.added for each in plan.rounds] == [()]


def test_effort_counts_every_round() -> None:
    plan = solved(om.Horizon.chain(3), om.Security(minutes=30, rating=1.15))
    assert len(plan.rounds) > 1
    assert plan.solution.iterations == sum(each.iterations for each in plan.rounds)
    assert plan.solution.seconds > sum(each.seconds for each in plan.rounds)


@pytest.mark.parametrize(
    ("formulation", "available"),
    [
        *((each, [0.0, 100.0]) for each in ("ac", "dc", "soc")),
        *(("ac", available) for available in ([0.01, 100.0], [100.0, 0.0])),
    ],
)
def test_a_unit_that_is_not_available_takes_no_part(formulation: str, available: list[float]) -> None:
    made = grid()
    made.sun = om.Generator("c", p=(0, 100), q=(-20, 20), cost=om.Polynomial(0, 100, 0))
    out = {"branches": ["ab", "bc", "ac"], "generators": ["gas"]}
    costs = []
    for screen in (True, False):
        security = om.Security(out, "preventive", rating=2, screen=screen)
        problem = om.MultiStage(
            made, 2, formulation=formulation, profiles={"sun.p_max": available}, security=security
        )
        plan = problem.solve(initial={"e": [0.0, 0.0]})
        assert plan.optimal, plan.termination
        costs.append(plan.objective)
    assert costs[0] == pytest.approx(costs[1], rel=1e-6)
    made.remove("sun")
    alone = om.MultiStage(made, 2, formulation=formulation, security=security)
    assert costs[1] <= alone.solve(initial={"e": [0.0, 0.0]}).objective + 1e-3


def test_a_loop_begins_with_nothing_included() -> None:
    problem = om.MultiStage(grid(), 3, profiles=demand(8), security=om.Security(minutes=30, rating=1.15))
    first, second = (om.simulate(problem, steps=2, initial=STATE) for _ in range(2))
    assert first.cost == second.cost
    assert second.plans[0]["screening"][0]["included"] == 0


# Responses ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("formulation", "response"), [("ac", "corrective"), ("ac", "preventive"), ("dc", "preventive")]
)
def test_flows_pass_no_outage_that_its_own_problem_does_not(formulation: str, response: str) -> None:
    plan = solved(om.Horizon.chain(3), None, formulation)
    passed, refused = 0, 0
    for rating in (0.9, 1.15, 1.5, 2.5):
        responses = Responses(plan.problem, om.Security("all", response, minutes=30, rating=rating))
        for stage in stages_of(plan):
            central = responses._response(stage, "", ())
            survived = responses._survived(central, responses.outages)
            for out in responses.outages:
                outcome = responses._outcome(stage, out, (), central)
                # a response that is held in everything has no interior: IPOPT may find none, and names no limit
                assert out not in survived or outcome.worst is None
                passed += out in survived and outcome.status == "secure"
                refused += outcome.worst is not None
    assert passed > 5
    assert refused > 5


def test_a_known_response_is_kept_while_it_is_one() -> None:
    security = om.Security("all", minutes=30, rating=1.3)
    plan = solved(om.Horizon.chain(2), security)
    stage = stages_of(plan)[0]
    responses = Responses(plan.problem, security)
    found = responses._response(stage, "ab", ())
    again = responses._response(stage, "ab", ())
    assert found.solution.iterations > 0
    assert again.solution.iterations == 0

    def elsewhere(name: str) -> object:
        values = stage.state(name)
        return values + 0.5 if name == "pg" else values

    moved = responses._response(stage._replace(state=elsewhere), "ab", ())
    assert moved.solution.iterations > 0  # its ramps do not lead there


# Flows after outages ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("case", "factor"), [("case14_ieee", 0.7), ("case14_ieee", 1.0), ("case30_as", 1.0)])
def test_ac_flows_after_outages_are_those_of_the_power_flow(case: str, factor: float) -> None:
    network = om.read_network(PGLIB.format(case))
    for name, branch in network.of(om.Branch).items():
        network.update(name, rating=factor * branch.rating)
    plan = om.MultiStage(network, 1, elastic=om.Elastic()).solve()
    for name, unit in network.of(om.Generator).items():
        bus = plan.data["vm"].sel(bus=unit.bus).item()
        network.update(name, pg_set=plan.data["pg"].sel(generator=name).item(), vm_set=bus, regulates=True)
    arrays = per_unit(network)
    units, base = arrays.generator, arrays.base_mva
    shares = {name: float(p) for name, p in zip(units.names, units.p_max[:, 0] * base, strict=True) if p > 0}
    before = om.power_flow(network, slack="distributed", participation=shares)
    state = before.per_unit()
    wide = np.full(len(units), np.inf)
    share = divide(units.p_max[:, 0], arrays.island[units.bus])
    reserve = Reserve(wide, wide, share, wide, wide, droop=0.0)
    status = np.ones(len(arrays.branch))
    flows = ACOutages(arrays, status, state["vm"], state["va"], reserve)
    graph = nx.MultiGraph(zip(arrays.branch.from_bus.tolist(), arrays.branch.to_bus.tolist(), strict=True))
    bridges = {frozenset(pair) for pair in nx.bridges(nx.Graph(graph)) if graph.number_of_edges(*pair) == 1}
    ends = zip(arrays.branch.from_bus.tolist(), arrays.branch.to_bus.tolist(), strict=True)
    out = np.array([i for i, pair in enumerate(ends) if frozenset(pair) not in bridges])
    survived = flows.survived(out)
    verdicts = []
    for branch in out:
        changed = network.copy()
        changed.update(arrays.branch.names[branch], in_service=False)
        after = om.power_flow(changed, slack="distributed", participation=shares)
        verdicts.append(after.converged and _within(after, network))
    assert survived.tolist() == verdicts
    if factor == 1.0:
        assert 0 < sum(verdicts) < len(verdicts)


def _within(flow: om.PowerFlowResult, network: om.Network) -> bool:
    """Whether voltages without a unit, flows and angles are within limits."""
    data = flow.data
    held = {unit.bus for unit in network.of(om.Generator).values()}
    good = all(
        bus.vm[0] - 1e-6 <= data["vm"].sel(bus=name).item() <= bus.vm[1] + 1e-6
        for name, bus in network.of(om.Bus).items()
        if name not in held
    )
    for name in data["branch"].values:
        branch, at = network[name], data.sel(branch=name)
        apparent = max(np.hypot(at[f"p{end}"].item(), at[f"q{end}"].item()) for end in "ft")
        va = (data["va"].sel(bus=bus).item() for bus in (branch.from_bus, branch.to_bus))
        angle = next(va) - next(va)
        good &= apparent <= branch.rating + 1e-4
        good &= branch.angle is None or branch.angle[0] <= angle <= branch.angle[1]
    return good


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_unlimited_reserves_and_islands_without_units_are_no_obstacle() -> None:
    made = grid()
    for name in ("coal", "gas"):
        made.update(name, q=(-np.inf, np.inf))
    for name in "xyz":
        made.add(name, om.Bus())
    for ends in ("xy", "yz", "zx"):
        made.add(ends, om.Branch(*ends, r=0.01, x=0.1, rating=10))
    plan = om.MultiStage(made, 1).solve(initial={"e": [60.0, 10.0]})
    responses = Responses(plan.problem, om.Security(rating=5))
    (stage,) = stages_of(plan)
    central = responses._response(stage, "", ())
    assert responses._survived(central, responses.outages) == set(responses.outages) >= {"ab", "xy"}


def test_droop_lets_voltages_follow_reactive_power() -> None:
    network = om.read_network(PGLIB.format("case14_ieee"))
    plan = om.MultiStage(network, 1).solve()
    arrays = per_unit(network)
    units = arrays.generator
    vm, va = (plan.solution.value(name)[:, 0] for name in ("vm", "va"))
    wide, half = np.full(len(units), np.inf), np.full(len(units), 0.5)
    share = divide(units.p_max[:, 0], arrays.island[units.bus])
    out = np.arange(1, len(arrays.branch))[[0, 1, 2, 3]]
    status = np.ones(len(arrays.branch))
    tight = Reserve(wide, wide, share, np.full(len(units), 1e-3), np.full(len(units), 1e-3), droop=0.0)
    loose = Reserve(wide, wide, share, half, half, droop=0.02)
    ratings = np.full((len(arrays.branch), 1), np.inf)
    limits = {("bus", "vm_min"): np.full((14, 1), 0.8), ("bus", "vm_max"): np.full((14, 1), 1.2)}
    free = arrays.with_series({("branch", "rating"): ratings, **limits})
    assert not ACOutages(free, status, vm, va, tight).survived(out).any()
    assert ACOutages(free, status, vm, va, loose).survived(out).all()


@pytest.mark.parametrize("scale", [0.75, 0.85])
def test_dc_flows_after_outages_are_those_of_a_linear_solve(scale: float) -> None:
    rng = np.random.default_rng(3)
    network = om.read_network(PGLIB.format("case30_as"))
    arrays = per_unit(network)
    branch, count = arrays.branch, len(arrays.bus)
    slope = (1.0 / branch.x)[:, 0]
    injected = rng.normal(0.0, 0.1, count)
    injected -= injected.mean()
    wide = {("branch", "rating"): scale * np.full((len(branch), 1), 0.3)}
    arrays = arrays.with_series(wide)
    rest = np.setdiff1d(np.arange(count), arrays.reference)

    def flows(kept: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        matrix = np.zeros((len(branch), count))
        matrix[np.arange(len(branch)), branch.from_bus] += 1.0
        matrix[np.arange(len(branch)), branch.to_bus] -= 1.0
        susceptance = np.where(kept, slope, 0.0)
        laplacian = matrix.T @ (susceptance[:, None] * matrix)
        angle = np.zeros(count)
        angle[rest] = np.linalg.solve(laplacian[np.ix_(rest, rest)], injected[rest])
        across = matrix @ angle
        return susceptance * across, np.where(kept, across, 0.0)

    every = np.ones(len(branch), dtype=bool)
    before, angle = flows(every)
    graph = nx.Graph(zip(branch.from_bus.tolist(), branch.to_bus.tolist(), strict=True))
    bridges = {frozenset(pair) for pair in nx.bridges(graph)}
    ends = list(zip(branch.from_bus.tolist(), branch.to_bus.tolist(), strict=True))
    out = np.array([i for i, pair in enumerate(ends) if frozenset(pair) not in bridges])
    survived = DCOutages(arrays, before, slope, angle).survived(out)
    for k, passes in zip(out, survived, strict=True):
        kept = every.copy()
        kept[k] = False
        flow, across = flows(kept)
        low, high = branch.angle_min[:, 0], branch.angle_max[:, 0]
        good = (np.abs(flow) <= 0.3 * scale + 1e-6).all() and ((low <= across) & (across <= high)).all()
        assert passes == good
    assert 0 < survived.sum() < survived.size
