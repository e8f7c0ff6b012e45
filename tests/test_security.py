"""Plans that survive the outage of any one component."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import extensive
import numpy as np
import pandapower as pp
import pandapower_tables  # noqa: F401 - makes what follows faster
import pytest
import xarray as xr

import opfmodel as om
from opfmodel.cli.app import app
from opfmodel.errors import IncompatibleError, ScenarioError, SecurityError
from opfmodel.plan.outages import splitting

ENERGY = {"cell": 60.0, "tank": 10.0}
BEFORE = {"coal": (80.0, 20.0), "gas": (60.0, 15.0)}
SHARES = {"low": 0.4, "high": 0.6}
# Multiples of the ratings after an outage, with which outages bind.
TIGHT = {"chain": 1.15, "uneven": 1.0, "tree": 1.15}


def grid() -> om.Network:
    """A triangle with two units, two storages and a radial line."""
    made = om.Network("triangle", base_mva=100)
    for name in ("a", "b", "c", "d"):
        made.add(name, om.Bus(vm=(0.92, 1.08), reference=name == "a"))
    made.add("ab", om.Branch("a", "b", r=0.01, x=0.05, b=0.02, rating=95))
    made.add("bc", om.Branch("b", "c", r=0.02, x=0.06, rating=80))
    made.add("ac", om.Branch("a", "c", r=0.015, x=0.07, rating=85))
    made.add("cd", om.Branch("c", "d", r=0.01, x=0.04, rating=60))
    made.add("coal", om.Generator("a", p=(0, 190), q=(-90, 90), ramp=60, cost=om.Polynomial(0.02, 14, 5)))
    made.add("gas", om.Generator("c", p=(0, 120), q=(-70, 70), ramp=100, cost=om.Polynomial(0.05, 32, 0)))
    made.add("cell", om.Storage("b", energy=120, power=30, q=10))
    made.add("tank", om.Storage("c", energy=20, power=8, q=4))
    made.add("town", om.Load("b", p=70, q=20))
    made.add("mill", om.Load("c", p=55, q=15))
    made.add("farm", om.Load("d", p=12, q=3))
    return made


def demand(steps: int, factor: float = 1.0) -> om.Profiles:
    shape = factor * (1.0 + 0.15 * np.sin(0.9 * np.arange(steps)))
    loads = grid().of(om.Load)
    return om.Profiles(
        {f"{n}.{key}": value * shape for n, d in loads.items() for key, value in (("p", d.p), ("q", d.q))}
    )


def solved(
    horizon: om.Horizon,
    security: om.Security | None,
    formulation: str = "ac",
    delay: int = 0,
    series: Iterable[om.Profiles] = (),
    **options: object,
) -> om.Plan:
    problem = om.MultiStage(
        grid(),
        horizon,
        formulation=formulation,
        generator_delay=delay,
        profiles=demand(horizon.steps),
        solver="ipopt",
        options={"tol": 1e-10},
        regularisation=0.0,
        security=security,
        **options,
    )
    initial = {"e": list(ENERGY.values()), "pg": [pg for pg, _ in BEFORE.values()]}
    if delay == 1 and formulation != "dc":
        initial["qg"] = [qg for _, qg in BEFORE.values()]
    given = list(series) or [demand(horizon.steps)]
    return problem.solve(initial=initial, expected=problem.expected(given))


def nodes(
    horizon: om.Horizon, series: list[om.Profiles], out: list[str], minutes: float, rating: float
) -> list[extensive.Node]:
    """The nodes of a horizon and the outages after each of them, for the extensive form."""
    made = []
    for k in range(len(horizon)):
        own = series[horizon.series[k] if len(series) > 1 else 0]
        first = horizon.step[k]
        last = first + round(horizon.hours[k] / horizon.base)
        power = {
            n: tuple(float(own[f"{n}.{key}"][first:last].mean()) for key in "pq") for n in grid().of(om.Load)
        }
        hours, probability = float(horizon.hours[k]), float(horizon.probability[k])
        made.append(extensive.Node(int(horizon.parent[k]), hours, probability, power))
    after = [
        replace(node, parent=k, hours=minutes / 60, probability=0.0, out=name, rating=rating)
        for k, node in enumerate(made)
        for name in out
    ]
    return [*made, *after]


HORIZONS = {
    "chain": om.Horizon.chain(3),
    "uneven": om.Horizon.grid([0.5, 1, 2]),
    "tree": om.Horizon.tree([1, 1, 2], SHARES, common=1),
}


FORMULATIONS = ("ac", "dc", "soc")
# Every formulation on every horizon; delayed dispatch and no screening once on each of them.
SECURED = [
    *((which, formulation, 0, True) for which in HORIZONS for formulation in FORMULATIONS),
    *((which, formulation, 1, True) for which, formulation in zip(HORIZONS, FORMULATIONS, strict=True)),
    *(
        (which, formulation, 0, False)
        for which, formulation in zip(HORIZONS, FORMULATIONS[::-1], strict=True)
    ),
]


@pytest.mark.parametrize(("which", "formulation", "delay", "screen"), SECURED)
def test_a_secure_plan_agrees_with_the_extensive_form(
    which: str, formulation: str, delay: int, screen: bool
) -> None:
    horizon = HORIZONS[which]
    series = [demand(horizon.steps, 0.95), demand(horizon.steps, 1.1)] if which == "tree" else []
    security = om.Security(minutes=30, rating=TIGHT[which], screen=screen)
    plan = solved(horizon, security, formulation, delay, series)
    assert plan.optimal, plan.termination
    assert bool(plan.rounds) == screen
    stated = nodes(horizon, series or [demand(horizon.steps)], ["ab", "bc", "ac"], 30, TIGHT[which])
    reference = extensive.solve(grid(), stated, ENERGY, formulation, dispatch=BEFORE, delay=delay)
    assert plan.objective == pytest.approx(reference["objective"], rel=1e-6)
    free = solved(horizon, None, formulation, delay, series)
    assert plan.objective > free.objective + 1.0  # security binds


def test_a_secure_plan_may_split_more_than_once() -> None:
    horizon = om.Horizon.branching([1, 1, 2], {1: 2, 2: 2})
    series = [demand(horizon.steps, factor) for factor in (0.95, 1.0, 1.05, 1.1)]
    plan = solved(horizon, om.Security(minutes=30, rating=1.1), series=series)
    stated = nodes(horizon, series, ["ab", "bc", "ac"], 30, 1.1)
    reference = extensive.solve(grid(), stated, ENERGY, dispatch=BEFORE)
    assert plan.objective == pytest.approx(reference["objective"], rel=1e-6)
    assert plan.objective > solved(horizon, None, series=series).objective + 1.0


def test_the_five_bus_system_agrees_with_the_extensive_form() -> None:
    made = om.load_scenario(CASE5, overrides={**SHORT, "time.steps": 4})
    five = made.network
    for name, branch in five.of(om.Branch).items():
        if branch.rating is None:
            five.update(name, rating=1000)
    energy = dict.fromkeys(five.of(om.Storage), 100.0)
    costs = []
    for own in (om.Security(rating=1.1, screen=True), om.Security(rating=1.1, screen=False), None):
        problem = om.MultiStage(
            five, 4, profiles=made.profiles, regularisation=0.0, security=own, options={"tol": 1e-10}
        )
        costs.append(problem.solve(initial={"e": list(energy.values())}).objective)
    demand = [
        {n: tuple(float(made.profiles[f"{n}.{key}"][k]) for key in "pq") for n in five.of(om.Load)}
        for k in range(4)
    ]
    regular = [extensive.Node(k - 1, 1.0, 1.0, demand[k]) for k in range(4)]
    after = [
        extensive.Node(k, 0.25, 0.0, demand[k], out=name, rating=1.1)
        for k in range(4)
        for name in five.of(om.Branch)
    ]
    reference = extensive.solve(five, [*regular, *after], energy)
    assert costs[:2] == pytest.approx([reference["objective"]] * 2, rel=1e-6)
    assert costs[0] > costs[2] + 1.0


@pytest.mark.parametrize(
    ("formulation", "participation"),
    [("ac", None), ("ac", {"coal": 1.0, "gas": 3.0}), ("dc", {"coal": 1.0, "gas": 3.0}), ("soc", None)],
)
def test_a_preventive_plan_agrees_with_the_extensive_form(
    formulation: str, participation: dict[str, float] | None
) -> None:
    horizon, out = HORIZONS["tree"], {"branches": ["ab", "bc", "ac"], "storages": ["tank"]}
    series = [demand(horizon.steps, 0.95), demand(horizon.steps, 1.02)]
    security = om.Security(out, "preventive", rating=1.3, participation=participation)
    plan = solved(horizon, security, formulation, series=series)
    assert plan.optimal, plan.termination
    shares = participation or {"coal": 190.0, "gas": 120.0}
    stated = [
        replace(node, held=shares) if node.out else node
        for node in nodes(horizon, series, ["ab", "bc", "ac", "tank"], 15, 1.3)
    ]
    reference = extensive.solve(grid(), stated, ENERGY, formulation, dispatch=BEFORE)
    assert plan.objective == pytest.approx(reference["objective"], rel=1e-6)
    corrective = solved(horizon, om.Security(out, minutes=60, rating=1.3), formulation, series=series)
    assert plan.objective > corrective.objective + 1.0


@pytest.mark.parametrize("formulation", ["ac", "dc", "soc"])
def test_outages_of_units_and_storages_agree_with_the_extensive_form(formulation: str) -> None:
    horizon, out = HORIZONS["chain"], {"generators": ["gas"], "storages": ["cell"], "branches": ["bc"]}
    security = om.Security(out, minutes=20, rating=1.3)
    plan = solved(horizon, security, formulation)
    stated = nodes(horizon, [demand(3)], ["gas", "cell", "bc"], 20, 1.3)
    reference = extensive.solve(grid(), stated, ENERGY, formulation, dispatch=BEFORE)
    assert plan.objective == pytest.approx(reference["objective"], rel=1e-6)
    assert plan.objective > solved(horizon, None, formulation).objective + 1.0


@pytest.mark.parametrize("formulation", ["ac", "ac-rectangular", "dc", "dc-matpower", "soc"])
def test_with_wide_limits_security_changes_nothing(formulation: str) -> None:
    loose = om.Security(minutes=60, rating=10)
    plan = solved(om.Horizon.chain(2), loose, formulation)
    free = solved(om.Horizon.chain(2), None, formulation)
    assert plan.objective == pytest.approx(free.objective, rel=1e-7)
    for name in ("pg", "ps", "lmp", "pf"):
        assert plan.data[name].values == pytest.approx(free.data[name].values, abs=0.02)
    assert plan.data.sizes == free.data.sizes
    assert plan.scenario_costs == pytest.approx(free.scenario_costs, rel=1e-7)


def test_the_price_of_demand_includes_the_cost_of_security() -> None:
    security = om.Security(minutes=30, rating=1.15)
    horizon = om.Horizon.chain(3)
    plan = solved(horizon, security)
    for bus, load in (("b", "town"), ("d", "farm")):
        changed = []
        for change in (-0.05, 0.05):
            series = dict(demand(3))
            key = next(k for k in series if str(k) == f"{load}.p")
            series[key] = series[key] + np.array([0.0, change, 0.0])
            changed.append(solved(horizon, security, series=[om.Profiles(series)]).objective)
        price = (changed[1] - changed[0]) / 0.1
        assert plan.data["lmp"].sel(bus=bus).values[1] == pytest.approx(price, rel=1e-3)
    free = solved(horizon, None).data["lmp"].sel(bus="d").values
    assert np.abs(plan.data["lmp"].sel(bus="d").values - free).max() > 1.0


@pytest.mark.parametrize("formulation", ["ac", "dc", "soc"])
def test_the_security_price_is_the_part_of_demand_after_outages(formulation: str) -> None:
    series = [demand(4, 0.95), demand(4, 1.1)]
    plan = solved(HORIZONS["tree"], om.Security(minutes=30, rating=1.15), formulation, series=series)
    prices, horizon = plan.contingency_prices(), plan.request.horizon
    owner = horizon.owner[horizon.contingencies]
    total = np.zeros((4, len(plan.horizon)))
    np.add.at(total.T, owner, prices.T)
    assert plan.data["security_price"].values == pytest.approx(total.T, abs=1e-9)
    load, base = plan.network.load, plan.network.base_mva
    one, k = np.unravel_index(np.argmax(np.abs(prices[load.bus])), (len(load), prices.shape[1]))
    price = prices[load.bus[one], k]
    assert abs(price) > 0.3
    cost = []
    for change in (-0.02, 0.02):
        changed = plan.whole.load.p.copy()
        changed[one, horizon.contingencies[k]] += change / base
        expected = {**plan.request.expected, ("load", "p"): changed}
        again = plan.problem.solve(initial=plan.request.initial, expected=expected)
        cost.append(again.objective)
    slope = (cost[1] - cost[0]) / 0.04 / horizon.influence[horizon.contingencies[k]]
    assert price == pytest.approx(slope, rel=2e-3)


@pytest.mark.parametrize("formulation", ["ac", "dc"])
def test_the_cost_of_security_as_a_whole_and_by_outage(formulation: str) -> None:
    horizon = om.Horizon.chain(3)
    plan = solved(horizon, om.Security(minutes=30, rating=1.15), formulation)
    cost = om.security_cost(plan)
    free = solved(horizon, None, formulation)
    assert cost.total == pytest.approx(plan.objective - free.objective, abs=1e-3)
    assert list(cost.by_outage) == ["ab", "bc", "ac"]
    for name, value in cost.by_outage.items():
        others = {"branches": [other for other in cost.by_outage if other != name]}
        without = solved(horizon, om.Security(others, minutes=30, rating=1.15), formulation)
        assert value == pytest.approx(plan.objective - without.objective, abs=1e-2)
    assert max(cost.by_outage.values()) > 1.0


def test_the_cost_of_security_needs_a_secure_plan() -> None:
    with pytest.raises(om.OpfmodelError, match="its problem has no security"):
        om.security_cost(solved(om.Horizon.chain(1), None))
    plan = solved(om.Horizon.chain(2), om.Security(minutes=5, rating=0.5))
    with pytest.raises(om.OpfmodelError, match="its security has no cost"):
        om.security_cost(plan)


@pytest.mark.parametrize("formulation", ["ac", "dc", "soc"])
def test_an_emergency_rating_takes_the_place_of_the_multiple(formulation: str) -> None:
    horizon, stated = om.Horizon.chain(2), grid()
    for name, branch in grid().of(om.Branch).items():
        stated.update(name, emergency_rating=1.15 * branch.rating)
    options = {"formulation": formulation, "profiles": demand(2), "options": {"tol": 1e-10}}
    state = {"e": list(ENERGY.values()), "pg": [80.0, 60.0]}

    def cost(network: om.Network, rating: float) -> float:
        security = om.Security(minutes=30, rating=rating)
        problem = om.MultiStage(network, horizon, security=security, solver="ipopt", **options)
        return problem.solve(initial=state).objective

    multiple = cost(grid(), 1.15)
    assert cost(stated, 9.0) == pytest.approx(multiple, rel=1e-8)
    assert cost(grid(), 9.0) < multiple - 1.0


def test_the_price_of_a_rating_leaves_emergency_ratings_out() -> None:
    def plan(change: float) -> om.Plan:
        made = grid()
        made.update("ab", rating=62.0 + change)
        for name in ("ab", "bc", "ac"):
            made.update(name, emergency_rating=97.0)
        security = om.Security(minutes=30)
        problem = om.MultiStage(
            made, 1, profiles=demand(1), security=security, regularisation=0.0, options={"tol": 1e-10}
        )
        return problem.solve(initial={"e": [0.0, 0.0]})

    price = plan(0.0).data["rating_price"].sel(branch="ab").item()
    slope = (plan(-0.01).objective - plan(0.01).objective) / 0.02
    assert price > 1.0
    assert price == pytest.approx(slope, rel=1e-3)


def test_a_warm_start_moves_contingencies_with_their_stages() -> None:
    security = om.Security(minutes=30, rating=1.15, screen=False)
    problem = om.MultiStage(grid(), 4, profiles=demand(8), security=security)
    state = {"e": list(ENERGY.values()), "pg": [80.0, 60.0]}
    first = problem.solve(initial=state)
    after = first.next_state()
    cold, warm = problem.solve(1, after), problem.solve(1, after, first)
    assert warm.objective == pytest.approx(cold.objective, rel=1e-6)
    assert warm.solution.iterations < 0.7 * cold.solution.iterations
    horizon = problem.horizon
    source = horizon.moved(1)
    for node in horizon.contingencies:
        assert horizon.out[source[node]] == horizon.out[node]
        assert horizon.owner[source[node]] == min(horizon.owner[node] + 1, 2 + (horizon.owner[node] == 3))


def test_an_objective_and_constraints_see_regular_stages_alone() -> None:
    security = om.Security(minutes=30, rating=1.15)
    seen = {}

    def reserve(stage: om.Stage) -> object:
        seen["stages"] = stage.generator.pg.stages
        return om.total(stage.generator.pg) - 0.0 * om.total(stage.bus.vm)

    problem = om.MultiStage(grid(), 3, profiles=demand(3), security=security)
    problem.constrain("reserve", reserve, at_least=[160.0, 0.0, 0.0])
    plan = problem.solve(initial={"e": list(ENERGY.values())})
    assert seen["stages"] == 3
    assert plan.data["pg"].sum("generator").values[0] == pytest.approx(160, abs=1e-3)
    assert plan.data["reserve_price"].values[0] > 1.0
    assert plan.data["reserve_price"].values[1:] == pytest.approx([0.0, 0.0], abs=1e-4)


# Where there is no secure plan ------------------------------------------------------------------------


def test_what_is_lacking_is_said_with_the_outage() -> None:
    problem = om.MultiStage(
        grid(), 3, profiles=demand(3), security=om.Security({"branches": ["ab"]}, minutes=5, rating=0.8)
    )
    state = {"e": [0.0, 0.0], "pg": [140.0, 10.0]}
    assert not problem.solve(initial=state).optimal
    plan = problem.elastic_twin().solve(initial=state)
    assert plan.shortages
    assert all("after the outage of ab" in str(shortage) for shortage in plan.shortages)
    assert plan.data["p_unserved"].values.max() < 1e-6  # no real load is shed


@pytest.mark.parametrize(
    ("contingencies", "message"),
    [
        ({"branches": ["abc"]}, "'abc': no branch in service has this name; did you mean"),
        ({"branches": ["cd"]}, "'cd': its outage splits the grid and cuts off 12 MW of demand"),
        ({"lines": ["ab"]}, r"contingencies: 'lines': did you mean 'dc_lines'\?"),
    ],
)
def test_contingencies_that_do_not_fit(contingencies: dict[str, list[str]], message: str) -> None:
    with pytest.raises(SecurityError, match=message):
        om.MultiStage(grid(), 2, security=om.Security(contingencies))


@pytest.mark.parametrize("value", [{"minutes": 0}, {"rating": -1}, {"rating": np.nan}])
def test_numbers_that_make_no_sense(value: dict[str, float]) -> None:
    with pytest.raises(om.OpfmodelError, match=f"security: {next(iter(value))}"):
        om.Security(**value)


def test_bridges_and_circuits_in_parallel() -> None:
    made = grid()
    assert splitting(om.MultiStage(made).arrays) == {"cd": 12.0}
    made.add("cd2", om.Branch("c", "d", r=0.01, x=0.04, rating=60))
    assert splitting(om.MultiStage(made).arrays) == {}
    plan = om.MultiStage(made, security=om.Security(rating=3)).solve()
    assert plan.optimal


# Scenario files -----------------------------------------------------------------------------------------

CASE5 = "scenarios/case5-step.yaml"
SHORT = {"time.steps": 2, "controller.horizon": 2, "controller.generator_delay": 0}


def test_security_is_a_key_of_a_scenario() -> None:
    out = {"branches": ["1-*"], "storages": ["cell1"]}
    stated = {"contingencies": out, "minutes": "1 h", "rating": 2, "screen": False}
    made = om.load_scenario(CASE5, overrides={**SHORT, "controller.security": stated})
    horizon = made.problem.horizon
    assert horizon.out[2:6] == (("1-2",), ("1-4",), ("1-5",), ("cell1",))
    assert horizon.hours.tolist() == [1.0] * 10
    run = made.simulate()
    assert run.status == "done"
    assert run.data.sizes["time"] == 2


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        (
            "contingencies",
            {"branches": ["1-7"]},
            "contingencies.branches: '1-7': no branch .* did you mean '1-",
        ),
        ("contingencies", {"lines": ["1-2"]}, r"unknown key; did you mean .dc_lines.\?"),
        ("contingencies", "none", "'none': must be 'all'"),
        ("minutes", 0, "security: minutes = 0.0: must be a finite number, above 0"),
        ("minutes", "2 MW", "minutes"),
    ],
)
def test_errors_in_a_scenario(key: str, value: object, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        om.load_scenario(CASE5, overrides={**SHORT, "controller.security": {key: value}})


# Which outages are not survived --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("formulation", "response"),
    [
        *((each, "corrective") for each in ("ac", "dc-matpower", "soc")),
        *((each, "preventive") for each in ("ac-rectangular", "dc")),
    ],
)
def test_a_secure_plan_survives_and_another_does_not(formulation: str, response: str) -> None:
    out = {"branches": ["ab", "bc", "ac"], "storages": ["cell"]}
    horizon = HORIZONS["tree"]
    security = om.Security(out, response, minutes=30, rating=1.15 if response == "corrective" else 1.3)
    options = {"formulation": formulation, "profiles": demand(4)}
    problems = [om.MultiStage(grid(), horizon, security=chosen, **options) for chosen in (None, security)]
    state = {"e": list(ENERGY.values()), "pg": [80.0, 60.0]}
    free, secured = (problem.solve(initial=state) for problem in problems)
    found = om.assess(free, security)
    assert not found.secure
    assert len(found.outcomes) == 4 * len(horizon)
    assert [outcome.stage for outcome in found.outcomes] == sorted(o.stage for o in found.outcomes)
    assert {o.status for o in found.outcomes} <= {"secure", "violated"}
    assert {o.scenario for o in found.violated} <= {"", "low", "high"}
    assert om.assess(secured).secure
    (bridge,) = found.islanding
    assert (bridge.out, bridge.generation_mw) == ("cd", 0.0)
    assert bridge.load_mw == pytest.approx(demand(4)["farm.p"].max())


@pytest.mark.parametrize("formulation", ["ac", "dc"])
def test_an_outage_is_survived_if_the_dispatch_can_be_kept_in_a_secure_plan(formulation: str) -> None:
    """Outage by outage, against the secure problem with the dispatch of the plan imposed on it."""
    horizon = om.Horizon.chain(2)
    state = {"e": list(ENERGY.values()), "pg": [80.0, 60.0]}
    options = {"formulation": formulation, "profiles": demand(2)}
    free = om.MultiStage(grid(), horizon, **options).solve(initial=state)
    power = free.data["pg"].values
    statuses = set()
    for out in ("ab", "bc", "ac"):
        security = om.Security({"branches": [out]}, minutes=30, rating=1.15)
        problem = om.MultiStage(grid(), horizon, security=security, **options)
        for k, unit in enumerate(("coal", "gas")):
            keep = lambda s, k=k: s.generator.pg[k]  # noqa: E731
            problem.constrain(unit, keep, at_least=power[:, k] - 1e-3, at_most=power[:, k] + 1e-3)
        possible = problem.solve(initial=state).optimal
        assert om.assess(free, security).secure == possible
        statuses.add(possible)
    assert statuses == {True, False}


def test_what_is_lacking_after_an_outage_is_named() -> None:
    free = solved(om.Horizon.chain(3), None)
    found = om.assess(free, om.Security({"branches": ["ab"]}, minutes=30, rating=1.15))
    worst = found.violated[0].worst
    assert worst is not None
    assert (worst.kind, worst.name, worst.quantity, worst.unit) == ("generator", "gas", "ramp", "MW")
    assert worst.text.endswith("at hour 2 after the outage of ab")
    plain = found.as_dict()
    assert plain["secure"] is False
    assert plain["contingencies"][2]["worst"] == {
        "kind": "generator", "name": "gas", "quantity": "ramp", "value": worst.value, "unit": "MW"
    }  # fmt: skip


def test_a_plan_that_ends_with_the_data_can_be_assessed() -> None:
    options = {"profiles": demand(4), "formulation": "dc"}
    shrinking = om.MultiStage(grid(), 3, at_end="shrink", **options)
    state = {"e": list(ENERGY.values()), "pg": [80.0, 60.0]}
    short, usual = shrinking.solve(2, state), om.MultiStage(grid(), 2, **options).solve(2, state)
    security = om.Security(minutes=30, rating=1.1)
    found, other = (om.assess(plan, security) for plan in (short, usual))
    assert [o[:4] for o in found.outcomes] == [o[:4] for o in other.outcomes]
    assert not found.secure


def test_a_power_flow_can_be_assessed() -> None:
    made = grid()
    made.update("coal", pg_set=70, vm_set=1.02)
    made.update("gas", pg_set=67, vm_set=1.02)
    made.update("town", p=70)
    flow = om.power_flow(made)
    assert om.assess(flow, om.Security(response="preventive", rating=2)).secure
    found = om.assess(flow, om.Security(response="preventive", rating=0.6))
    assert {outcome.out for outcome in found.violated} >= {"ab"}


def test_what_cannot_be_assessed_is_refused() -> None:
    problem = om.MultiStage(grid(), profiles={"town.p": [900.0]})
    with pytest.raises(om.OpfmodelError, match="there is nothing to assess"):
        om.assess(problem.solve())
    with pytest.raises(IncompatibleError, match="'dc-losses'"):
        om.assess(om.MultiStage(grid(), formulation="dc-losses").solve())


def command(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str]:
    code = app(["security", *map(str, arguments)], standalone_mode=False)
    return code, capsys.readouterr().out


def test_the_command_lists_the_outages_that_are_not_survived(capsys: pytest.CaptureFixture[str]) -> None:
    short = [text for key, value in SHORT.items() for text in ("--set", f"{key}={value}")]
    code, text = command(capsys, CASE5, *short, "--json")
    made = json.loads(text)
    assert code == 1
    assert not made["secure"]
    assert made["response"] == "corrective"
    assert len(made["contingencies"]) == 12
    assert {c["status"] for c in made["contingencies"]} == {"secure", "violated"}
    code, text = command(capsys, CASE5, *short)
    assert code == 1
    assert "after the outage of 1-5" in text
    code, text = command(capsys, CASE5, *short, "--rating", "9", "--json")
    assert (code, json.loads(text)["secure"]) == (0, True)


def test_the_command_assesses_the_dispatch_of_a_network_file(capsys: pytest.CaptureFixture[str]) -> None:
    code, text = command(capsys, "tests/data/pglib/pglib_opf_case14_ieee.m", "--json")
    made = json.loads(text)
    assert code == 1
    assert [c["out"] for c in made["contingencies"] if c["status"] == "violated"] == ["1-2"]
    assert made["islanding"] == [{"out": "7-8", "load_mw": 0.0, "generation_mw": 0.0}]


def test_the_command_says_why_there_is_nothing_to_assess(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    om.write_network(overloaded(), tmp_path / "one.m")
    code, text = command(capsys, tmp_path / "one.m", "--json")
    made = json.loads(text)
    assert (code, made["secure"], made["contingencies"]) == (1, False, [])
    assert made["failure"] == "the power flow at the set-points of the file diverged"
    code, text = command(capsys, tmp_path / "one.m")
    assert (code, "diverged" in text) == (1, True)


def overloaded() -> om.Network:
    made = om.Network("one")
    made.add("1", om.Bus(reference=True))
    made.add("2", om.Bus())
    made.add("1-2", om.Branch("1", "2", r=0.01, x=0.5))
    made.add("coal", om.Generator("1", p=(0, 900)))
    made.add("town", om.Load("2", p=800))
    return made


# Against another tool -------------------------------------------------------------------------------------


@pytest.mark.parametrize("rating", [1.0, 1.5])
def test_power_flows_of_pandapower_after_every_outage_are_within_limits(rating: float) -> None:
    made = om.load_scenario(CASE5, overrides=SHORT)
    grid = made.network
    security = om.Security(response="preventive", rating=rating)
    problem = om.MultiStage(
        grid, 1, profiles=made.profiles, objective=made.cost, security=security, options={"tol": 1e-9}
    )
    plan = problem.solve(initial={"e": [100.0] * 5})
    data = plan.data.isel(time=0)
    free = om.MultiStage(grid, 1, profiles=made.profiles, objective=made.cost).solve(
        initial={"e": [100.0] * 5}
    )
    without = _excess(grid, free.data.isel(time=0), rating)
    assert max(without.values()) > 1.0  # MVA: some outage overloads
    assert max(_excess(grid, data, rating).values()) < 1e-3  # 1e-5 p.u.
    found = {outcome.out: outcome.status for outcome in om.assess(free, security).outcomes}
    assert found == {out: "violated" if most > 1e-3 else "secure" for out, most in without.items() if out}
    assert om.assess(plan).secure


def _excess(grid: om.Network, data: xr.Dataset, rating: float) -> dict[str | None, float]:
    """The most by which each outage exceeds a limit, in MVA or in p.u. times 100, by pandapower."""
    net = pp.create_empty_network(sn_mva=grid.base_mva)
    at = {name: pp.create_bus(net, 1.0) for name in grid.of(om.Bus)}
    for name, bus in at.items():
        pp.create_load(net, bus, data["pd"].sel(bus=name).item(), data["qd"].sel(bus=name).item())
    for name, cell in grid.of(om.Storage).items():
        ps, qs = (data[key].sel(storage=name).item() for key in ("ps", "qs"))
        pp.create_load(net, at[cell.bus], ps, qs)
    for branch in grid.of(om.Branch).values():
        ohm = 1.0 / grid.base_mva  # at 1 kV
        pp.create_line_from_parameters(
            net, at[branch.from_bus], at[branch.to_bus], 1.0, branch.r * ohm, branch.x * ohm,
            branch.b / ohm / (2 * np.pi * net.f_hz) * 1e9, 1e6,
        )  # fmt: skip
    for name, unit in grid.of(om.Generator).items():
        pp.create_gen(
            net, at[unit.bus], data["pg"].sel(generator=name).item(), data["vm"].sel(bus=unit.bus).item(),
            slack=grid[unit.bus].reference, slack_weight=unit.p[1],
        )  # fmt: skip
    found = {}
    for out in (None, *net.line.index):
        worst = 0.0
        net.line["in_service"] = net.line.index != out
        pp.runpp(net, distributed_slack=True, tolerance_mva=1e-9, calculate_voltage_angles=True, numba=False)
        flows, units = net.res_line, net.res_gen
        ends = [np.hypot(flows[f"p_{end}_mw"], flows[f"q_{end}_mvar"]) for end in ("from", "to")]
        limits = np.array([branch.rating or np.inf for branch in grid.of(om.Branch).values()])
        worst = max(worst, (np.maximum(*ends) - (limits if out is None else rating * limits)).max())
        for column, key in (("p_mw", "p"), ("q_mvar", "q")):
            low, high = np.array([getattr(unit, key) for unit in grid.of(om.Generator).values()]).T
            worst = max(worst, (low - units[column]).max(), (units[column] - high).max())
        low, high = np.array([bus.vm for bus in grid.of(om.Bus).values()]).T
        vm = net.res_bus.vm_pu
        worst = max(worst, 100 * (low - vm).max(), 100 * (vm - high).max())
        found[None if out is None else list(grid.of(om.Branch))[out]] = float(worst)
    return found


# What an outage must not do -------------------------------------------------------------------------------


def test_a_rating_that_binds_only_after_an_outage_has_a_price() -> None:
    def cost(change: float) -> om.Plan:
        made = grid()
        made.update("ac", rating=65 + change)
        problem = om.MultiStage(
            made, 1, formulation="dc", security=om.Security({"branches": ["ab"]}, minutes=5, rating=1.2)
        )
        return problem.solve(initial={"e": [60.0, 10.0], "pg": [110.0, 30.0]})

    plan = cost(0.0)
    price = (cost(-0.5).objective - cost(0.5).objective) / 1.0
    assert price > 1.0
    assert plan.data["rating_price"].sel(branch="ac").values == pytest.approx([price], rel=1e-3)


def test_no_real_limit_is_violated_for_an_outage_that_has_not_happened() -> None:
    made = om.Network("one", base_mva=100)
    made.a = om.Bus(reference=True)
    made.slow = om.Generator("a", p=(0, 100), ramp=10, cost=om.Polynomial(0, 20, 0))
    made.gas = om.Generator("a", p=(0, 100), cost=om.Polynomial(0, 10, 0))
    made.town = om.Load("a", p=60)
    security = om.Security({"generators": ["gas"]}, minutes=6)
    problem = om.MultiStage(made, 3, formulation="dc", security=security, elastic=om.Elastic())
    plan = problem.solve(initial={"pg": [0.0, 60.0]})
    assert plan.data["pg"].sel(generator="slow").values[0] < 10 + 1e-3
    assert all(shortage.hypothetical for shortage in plan.shortages)
    assert str(plan.shortages[0]) == (
        "generator slow must rise 49.0 MW faster than its ramp allows at hour 0 after the outage of gas "
        "(and after 2 others)"
    )


def test_energy_does_not_limit_a_preventive_response() -> None:
    made = grid()
    made.update("cell", energy=90)
    security = om.Security({"branches": ["ab"]}, "preventive", rating=10)
    options = {"formulation": "dc", "end": om.End(minimum=1.0), "profiles": demand(2)}
    plans = [
        om.MultiStage(made, 2, security=chosen, **options).solve(initial={"e": [45.0, 10.0]})
        for chosen in (None, security)
    ]
    assert plans[0].optimal
    assert plans[1].objective == pytest.approx(plans[0].objective, rel=1e-6)


def test_what_security_cannot_do_is_refused() -> None:
    security = om.Security({"branches": ["ab"]})
    with pytest.raises(IncompatibleError, match="traded against cost"):
        om.MultiStage(grid(), security=security, elastic=om.Elastic(traded=True))
    with pytest.raises(IncompatibleError, match="'dc-losses': after an outage its losses cost nothing"):
        om.MultiStage(grid(), security=security, formulation="dc-losses")
    with pytest.raises(IncompatibleError, match="without scenarios and security"):
        om.MultiStage(grid(), 1, security=security, at_end="shrink")
    secured = om.Horizon.chain(1).with_contingencies([(0, ("gas",))], 15)
    with pytest.raises(om.OpfmodelError, match="has contingencies; state them by security"):
        om.MultiStage(grid(), secured)
    delayed = om.MultiStage(grid(), 1, security=security, generator_delay=1, formulation="dc")
    plan = delayed.solve(initial={"e": [60.0, 10.0], "pg": [80.0, 60.0]})
    with pytest.raises(IncompatibleError, match="at least 2 stages"):
        plan.next_state()


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ({"contingencies": "branches"}, "contingencies = 'branches': must be 'all' or lists of names"),
        (
            {"contingencies": ["ab"]},
            "must be 'all' or lists of names by branches, dc_lines, generators, renewables, storages",
        ),
        ({"contingencies": {"branches": "ab"}}, "branches: 'ab': must be a list of names"),
        ({"contingencies": {"branches": [1]}}, "branches: .*: must be a list of names"),
        ({"response": "brave"}, "response = 'brave': must be corrective or preventive"),
        ({"participation": {"coal": 1}}, "participation: applies to a preventive response only"),
        ({"response": "preventive", "participation": {"coal": -1}}, "participation: coal"),
    ],
)
def test_arguments_that_do_not_fit(stated: dict[str, object], message: str) -> None:
    with pytest.raises(SecurityError, match=message):
        om.Security(**stated)


def test_values_of_the_stages_are_those_of_contingencies_too() -> None:
    problem = om.MultiStage(
        grid(), 2, formulation="dc", profiles={"ab.rating": [95.0, 90.0]}, security=om.Security(rating=3)
    )
    ratings = np.full((4, 2), 2.0)
    plan = problem.solve(expected={("branch", "rating"): ratings})
    assert plan.optimal
    assert plan.network.branch.rating.tolist() == ratings.tolist()


def test_what_is_not_secured_is_noted() -> None:
    problem = om.MultiStage(grid(), 2, profiles={"farm.p": [50.0, 80.0]}, security=om.Security(rating=3))
    assert "not secured, because their outage splits the grid: cd (80 MW in all)" in problem.notes


def test_units_that_cannot_move_take_no_part_in_a_preventive_response() -> None:
    made = grid()
    made.must = om.Generator("b", p=(20, 20), q=(-10, 10))
    security = om.Security({"branches": ["ab", "bc"]}, "preventive", rating=3)
    plan = om.MultiStage(made, 1, security=security).solve(initial={"e": [60.0, 10.0], "pg": [80, 40, 20]})
    assert plan.optimal
