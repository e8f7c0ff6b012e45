"""Outages that happen: plans that take components as out of service, and loops in which they trip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import opfmodel as om
from opfmodel.check import Report, check
from opfmodel.errors import IncompatibleError, ModelError, ScenarioError, SecurityError
from opfmodel.formulations.base import Formulation, angles, publish_flows
from opfmodel.model import Model
from opfmodel.results import figures
from opfmodel.results.store import load, save

FORMULATIONS = ["ac", "ac-rectangular", "dc", "dc-matpower", "soc"]
OUT = [("ab",), ("gas",), ("cell",), ("ab", "tank"), ("bc", "gas")]
# Screening, which has tests of its own, compiles more than one problem for each plan.
CORRECTIVE = om.Security(
    {"branches": ["*"], "generators": ["oil"], "storages": ["cell"]}, minutes=30, rating=1.4, screen=False
)
PREVENTIVE = om.Security({"branches": ["*"], "generators": ["oil"]}, "preventive", rating=1.5, screen=False)


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


SECURITY = {"free": None, "corrective": CORRECTIVE, "preventive": PREVENTIVE}


@pytest.mark.parametrize(
    ("formulation", "security"),
    [
        pytest.param(each, SECURITY[name], id=f"{each}-{name}")
        for each, name in (
            *((each, "free") for each in FORMULATIONS),
            *(("ac", name) for name in ("corrective", "preventive")),
            ("dc", "corrective"),
            ("soc", "preventive"),
        )
    ],
)
def test_a_plan_of_an_outage_is_that_of_a_grid_without_the_component(
    formulation: str, security: om.Security | None
) -> None:
    every = problem(["ab", "bc", "gas", "cell", "tank"], security, formulation)
    whole = every.solve().objective
    assert whole == pytest.approx(problem((), security, formulation).solve().objective, rel=1e-7)
    for out in OUT if security is None else OUT[::2]:
        plan = every.solve(out=out)
        alone = problem((), security, formulation, without=out).solve()
        assert plan.status == alone.status
        if alone.optimal:
            assert check(grid(), plan.data, demand(3)).max_violation < 2e-6
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
    security = replace(CORRECTIVE, rating=1.1, screen=True)
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
    with pytest.raises(
        ModelError, match=r"outages: 'abc': no branch, dc_line, generator, .* in service .* 'a"
    ):
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


@pytest.mark.parametrize(
    ("formulation", "solver"),
    [("dc", "osqp"), ("dc", "clarabel"), ("dc", "conic"), ("dc", "qp"), ("soc", "clarabel"), ("soc", "conic"),
     ("soc", "ipopt"), ("dc-losses", "clarabel"), ("dc-losses", "ipopt"), ("copperplate", "clarabel")],
)  # fmt: skip
def test_every_back_end_takes_a_status_as_a_coefficient(formulation: str, solver: str) -> None:
    every = problem(["ab", "gas"], formulation=formulation, solver=solver)
    for out in ((), ("ab",), ("ab", "gas"), ()):
        plan = every.solve(out=out)
        expected = optimum_without(formulation, out)
        assert plan.objective == pytest.approx(expected, rel=1e-4 if solver == "osqp" else 1e-6)


@cache
def optimum_without(formulation: str, out: tuple[str, ...]) -> float:
    return problem((), formulation=formulation, without=out).solve().objective


class Rigid(Formulation):
    """Linear flows that do not heed outages."""

    name = "rigid"
    reactive = False
    publishes = ("va", "pf", "pt")

    def declare(self, model: Model) -> None:
        branch, va = model.network.branch, angles(model)
        flow = 10.0 * (va[branch.from_bus] - va[branch.to_bus])
        publish_flows(model, flow, None, -flow, None)
        model.inject(branch.from_bus, p=-flow)
        model.inject(branch.to_bus, p=flow)


def test_a_formulation_that_does_not_heed_outages_is_refused() -> None:
    assert om.MultiStage(grid(), formulation=Rigid(), outages=["gas"]).solve(out=["gas"]).optimal
    with pytest.raises(IncompatibleError, match="'rigid' does not take branches out of service"):
        om.MultiStage(grid(), formulation=Rigid(), outages=["ab"]).solve()


def test_a_storage_that_is_out_has_no_end() -> None:
    initial = {"e": [100.0, 5.0]}
    for end in (om.End(minimum=0.9), om.End(cyclic=True)):
        every = problem(["tank"], formulation="dc", end=end)
        assert not every.solve(out=["tank"], initial={"e": [10.0, 5.0]}, end=om.End(minimum=1.0)).optimal
        plan = every.solve(out=["tank"], initial=initial)
        assert plan.optimal
        alone = problem((), formulation="dc", without=["tank"], end=end).solve(initial={"e": [100.0]})
        assert plan.objective == pytest.approx(alone.objective, rel=1e-6)


# Closed loops ------------------------------------------------------------------------------------

STEPS = 6


def loop(
    plant: om.Plant,
    events: Sequence[om.Outage],
    formulation: str = "ac",
    security: om.Security | None = None,
    delay: int = 0,
    steps: int = STEPS,
    case: om.Network | None = None,
    **response: object,
) -> om.Run:
    """A closed loop in which components trip."""
    made = grid() if case is None else case
    series = demand(steps + 2)
    controlled = om.MultiStage(
        made, 3, formulation=formulation, profiles=series, security=security, generator_delay=delay,
        outages=[event.component for event in events],
    )  # fmt: skip
    plant = plant.with_outages(events, **response)
    return om.simulate(om.Controller(controlled, on_infeasible="elastic"), plant, steps)


def checked(run: om.Run) -> Report:
    return check(run.problem.network, run.data, run.problem.profiles)


@pytest.mark.parametrize(
    ("plant", "component"),
    [
        *((om.NominalPlant, name) for name in ("ab", "gas")),
        *((om.PowerFlow, name) for name in ("gas", "cell")),
        *((om.Redispatch, name) for name in ("cell", "ab")),
    ],
)
def test_what_is_out_carries_and_produces_nothing(plant: type[om.Plant], component: str) -> None:
    run = loop(plant(), [om.Outage(component, 2, 2)], rating=1.6)
    assert run.status == "done", run.termination
    kind = next(kind for kind, table in run.problem.arrays.tables.items() if component in table.names)
    data, power = run.data, {"branch": "pf", "generator": "pg", "storage": "ps"}[kind]
    assert data[f"{kind}_status"].sel({kind: component}).values.tolist() == [1, 1, 0, 0, 1, 1]
    assert data[f"{kind}_status"].sum() == 6 * data.sizes[kind] - 2
    flow = np.abs(data[power].sel({kind: component}).values)
    assert flow[2:4] == pytest.approx([0, 0], abs=1e-5)
    assert flow[[1, 4]].min() > 0.5
    known = [1] * 6 if plant is om.NominalPlant else [1, 1, 0, 1, 1, 1]
    assert data["outages_known"].values.tolist() == known
    assert run.summary()["outages"] == {component: [2, 3]}
    report = checked(run)
    limits = {"branch rating", "bus voltage", "generator p", "generator q", "ramp"}  # of a held dispatch
    families = set(report.violations) - (limits if plant is om.PowerFlow else set())
    assert max(report.violations[family].value for family in families) < 2e-6, str(report)
    assert report.cost == pytest.approx(run.cost, rel=1e-8)


@pytest.mark.parametrize("known", [0, 1, 2])
def test_the_controller_learns_of_a_trip_steps_later(known: int) -> None:
    run = loop(om.Redispatch(), [om.Outage("ab", 1, 3)], known=known, rating=2.0)
    assert run.status == "done"
    assert run.data["outages_known"].values.tolist() == [1.0] + [0.0] * known + [1.0] * (5 - known)
    assert run.data["branch_status"].sel(branch="ab").values.tolist() == [1, 0, 0, 0, 1, 1]
    assert checked(run).max_violation < 2e-6
    assert max(plan["iterations"] for plan in run.plans) < 200
    assert {attempt["start"] for plan in run.plans[1:] for attempt in plan["attempts"]} == {"warm"}


@pytest.mark.parametrize("known", [0, 1])
def test_the_ac_plants_find_the_planned_state_of_an_outage(known: int) -> None:
    """Once the controller knows, its AC plans of the outage are states of the grid."""
    events = [om.Outage("ab", 1, 3), om.Outage("gas", 2, 1), om.Outage("cell", 2, 3)]
    run = loop(om.PowerFlow(), events, known=known, rating=2.0)
    assert run.status == "done"
    moved = run.data["pg_redispatch"].sum("generator").values
    told = run.data["outages_known"].values > 0
    assert told.sum() == (6 if known == 0 else 4)
    assert moved[told].max() < 1e-3
    if known:
        assert moved[~told].min() > 0.1
        followed = loop(om.NominalPlant(), events)
        assert run.data["pg"].values[5] == pytest.approx(followed.data["pg"].values[5], abs=0.5)


@pytest.mark.parametrize(
    ("plant", "formulation", "delay"),
    [
        (om.NominalPlant, "ac", 1),
        (om.NominalPlant, "dc", 0),
        *((plant, *which) for plant in (om.PowerFlow, om.Redispatch) for which in (("ac", 0), ("dc", 1))),
    ],
)
def test_a_unit_returns_to_its_minimum_whatever_its_ramp(
    plant: type[om.Plant], formulation: str, delay: int
) -> None:
    case = grid()
    case.update("coal", p=(40, 190), ramp=15)
    run = loop(plant(), [om.Outage("coal", 2, 2)], formulation, delay=delay, case=case)
    assert run.status == "done", run.termination
    pg = run.data["pg"].sel(generator="coal").values
    assert pg[2:4] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert pg[[1, 4]].min() > (39.999 if plant is not om.PowerFlow else 38)
    if delay == 1:  # the units that are left were committed without the outage
        return
    assert run.summary()["elastic_steps"] == 0
    if plant is not om.NominalPlant and formulation == "ac":
        assert run.data["ramp_excess"].sel(generator="coal").max() < 1e-3
    if plant is not om.PowerFlow:
        assert checked(run).violations["ramp"].value < 1e-6


def test_units_move_within_minutes_of_a_trip_only() -> None:
    run = loop(om.Redispatch(), [om.Outage("cell", 2, 2)], minutes=6, rating=2.0)
    told = loop(om.Redispatch(), [om.Outage("cell", 2, 2)], known=0, rating=2.0)
    moved, free = (r.data["pg_redispatch"].isel(time=2).sum().item() for r in (run, told))
    assert free < 1e-3
    most = 0.1 * run.problem.arrays.generator.ramp[:, 0] * 100
    each = run.data["pg_redispatch"].isel(time=2).values
    assert (each <= most + 1e-4).all()
    assert moved > 1.0


def test_a_secured_loop_rides_through_an_outage_in_which_an_unsecured_one_sheds() -> None:
    events, minutes = [om.Outage("ab", 2, 2)], 12
    loops = [loop(om.Redispatch(), events, security=s, minutes=minutes, rating=1.0)
             for s in (None, om.Security({"branches": ["ab"]}, minutes=minutes))]  # fmt: skip
    free, secured = (run.summary() for run in loops)
    assert free["shed_mwh"] > 1.0
    assert secured["shed_mwh"] < 1e-3
    assert secured["largest_flow_excess"] < 1e-3 < free["largest_flow_excess"]
    assert loops[1].cost > loops[0].cost + 10


def test_an_outage_at_the_last_step_and_two_that_overlap() -> None:
    events = [om.Outage("ab", 1, 3), om.Outage("tank", 2, 9), om.Outage("ab", 5, 4)]
    run = loop(om.Redispatch(), events, rating=2.0)
    assert run.status == "done"
    assert run.summary()["outages"] == {"ab": [1, 2, 3, 5], "tank": [2, 3, 4, 5]}
    assert run.data["branch_status"].sel(branch="ab").values.tolist() == [1, 0, 0, 0, 1, 0]
    assert run.data["storage_status"].sel(storage="tank").values.tolist() == [1, 1, 0, 0, 0, 0]
    assert run.data["outages_known"].values.tolist() == [1, 0, 0, 1, 1, 0]
    assert checked(run).max_violation < 2e-6


@pytest.mark.parametrize(
    ("quantity", "kind", "name", "family"),
    [
        ("branch_status", "branch", "ab", "reported flow"),
        ("branch_status", "branch", "bc", "reported flow"),
        ("generator_status", "generator", "gas", "generator p"),
        ("storage_status", "storage", "cell", "storage power"),
    ],
)
def test_a_status_that_was_tampered_with_is_found(quantity: str, kind: str, name: str, family: str) -> None:
    events = [om.Outage("ab", 1, 1), om.Outage("gas", 3, 1), om.Outage("cell", 4, 1)]
    run = loop(om.NominalPlant(), events, steps=5)
    data = run.data.copy(deep=True)
    step = 1 if name == "ab" else 0
    data[quantity].loc[{kind: name, "time": data["time"][step]}] = 1.0 - (name != "ab")
    assert checked(run).max_violation < 2e-6
    assert check(run.problem.network, data, run.problem.profiles).violations[family].value > 1e-3


def test_ratings_of_an_emergency_end_when_the_controller_knows() -> None:
    case = grid()
    case.update("ad", emergency_rating=80)
    run = loop(om.Redispatch(), [om.Outage("ab", 1, 2)], rating=1.2, case=case)
    flow = np.hypot(run.data["pf"], run.data["qf"]).sel(branch="ad").values
    assert flow[1] > 46
    assert flow[2] < 45.001
    assert checked(run).violations["branch rating"].value < 1e-6
    data = run.data.assign(outages_known=("time", np.ones(STEPS)))
    assert check(run.problem.network, data, run.problem.profiles).violations["branch rating"].value > 0.01


class Deaf(om.Plant):
    """A plant that knows nothing of outages."""


def test_what_loops_refuse() -> None:
    trip = om.Outage("ab", 1, 2)
    with pytest.raises(IncompatibleError, match="outages: the plant Deaf does not realise any"):
        Deaf().with_outages([trip])
    with pytest.raises(IncompatibleError, match=r"known = 1: the plant follows plans.*known = 0"):
        om.NominalPlant().with_outages([trip], known=1)
    with pytest.raises(ModelError, match="known = -1: must be"):
        om.PowerFlow().with_outages([trip], known=-1)
    with pytest.raises(ModelError, match="outages: 'ab': must be an object of class Outage"):
        om.PowerFlow().with_outages(["ab"])
    with pytest.raises(ModelError, match="outages: ab: hours = 0"):
        om.Outage("ab", 1, 0)
    with pytest.raises(ModelError, match="outages: ab: step = -1"):
        om.Outage("ab", -1, 1)
    plant = om.Redispatch().with_outages([trip])
    with pytest.raises(ModelError, match=r"'ab': the problem does not declare this outage.*outages=\['ab'\]"):
        om.simulate(problem(), plant)
    for events, text in (
        ([om.Outage("ab", 1, 1.5)], "ab: hours = 1.5: must be a multiple of the step of 1 h"),
        ([trip, om.Outage("ab", 2, 1)], "ab: step = 2: it is already out in step 2"),
    ):
        with pytest.raises(ModelError, match=text):
            loop(om.PowerFlow(), events)
    with pytest.raises(SecurityError, match="these outages split the grid"):
        loop(om.PowerFlow(), [om.Outage("ad", 1, 2), om.Outage("cd", 2, 1)])


# Scenarios ---------------------------------------------------------------------------------------

SCENARIO = Path(__file__).parents[1] / "scenarios" / "case5-outage.yaml"


def test_a_scenario_states_outages_and_its_secured_variant_rides_through() -> None:
    short = {"time.steps": 14, "profiles": []}
    free, secured, told = (
        om.load_scenario(SCENARIO, variant, short).simulate() for variant in (None, "secured", "told")
    )
    for run in (free, secured, told):
        assert run.status == "done"
        assert run.data["branch_status"].sel(branch="1-4").values.tolist() == [1] * 12 + [0, 0]
        assert run.data.attrs["outage_rating"] == 1.2
        assert run.summary()["elastic_steps"] == 0
    assert free.data["outages_known"].values.tolist() == [1] * 12 + [0, 1]
    assert told.data["outages_known"].values.tolist() == [1] * 14
    assert free.summary()["shed_mwh"] > 10
    assert max(run.summary()["shed_mwh"] for run in (secured, told)) < 1e-2
    assert checked(free).violations["branch rating"].value > 1e-3
    assert checked(secured).max_violation < 1e-6
    assert secured.cost > free.cost * 1.02


def test_the_keys_of_outages() -> None:
    events = [
        {"generator": "gen3", "step": 2, "hours": "60 min"},
        {"storage": "cell1", "step": 1, "hours": 2},
    ]
    over = {"plant.outages": events, "plant.mode": "power-flow", "plant.known": 2, "plant.minutes": "0.1 h"}
    loaded = om.load_scenario(SCENARIO, None, over)
    plant = loaded.plant()
    assert loaded.problem.outages == ("gen3", "cell1")
    assert plant.outages.events == (om.Outage("gen3", 2, 1.0), om.Outage("cell1", 1, 2.0))
    assert (plant.outages.known, plant.outages.minutes, plant.outages.rating) == (2, 6.0, 1.2)
    nominal = om.load_scenario(
        SCENARIO,
        None,
        {"plant": {"mode": "nominal", "outages": events, "known": 0, "minutes": 5, "rating": 1}},
    )
    assert nominal.plant().outages.known == 0
    security = {"contingencies": "all", "minutes": 20, "rating": 1.4}
    secured = om.load_scenario(SCENARIO, None, {"controller.security": security})
    found = om.Redispatch().with_outages([om.Outage("1-4", 1, 1)]).outages.of(secured.problem)
    assert (found.known, found.minutes, found.rating) == (1, 20, 1.4)


OF = {"step": 1, "hours": 1}


@pytest.mark.parametrize(
    ("over", "text"),
    [
        ({"outages": [{"branch": "1-7", **OF}]}, r"plant\.outages\.0\.branch: '1-7': no branch in service .*'1-"),
        ({"outages": [{"connection": "grid", **OF}]}, r"^[^\n]*outages\.0\.connection: 'grid': no connection [^\n]*$"),
        ({"outages": [{"generator": "1-4", **OF}]}, r"outages\.0\.generator: '1-4': no generator in service"),
        ({"outages": [OF]}, r"plant\.outages\.0: names 0 components; must name one"),
        ({"outages": [{"branch": "1-4", "generator": "gen1", **OF}]}, r"outages\.0: names 2 components"),
        ({"outages": [{"line": "1-4", **OF}]}, r"plant\.outages\.0\.line: .*unknown key"),
        ({"outages": [{"branch": "1-4", "step": 1}]}, r"plant\.outages\.0.*hours"),
        ({"outages": [{"branch": "1-4", "step": 1, "hours": 0}]}, r"outages\.0\.hours"),
        ({"outages": [{"branch": "1-4", "step": -1, "hours": 1}]}, r"outages\.0\.step"),
        ({"outages": [{"branch": "1-4", "step": 1, "hours": 1.5}]}, r"hours = 1\.5: must be a multiple of the step"),
        ({"outages": [{"branch": "1-4", "step": 1, "hours": "3 MW"}]}, r"outages\.0\.hours.*MW"),
        ({"outages": [{"branch": "1-4", **OF}] * 2}, r"outages\.1.*already out in step 1"),
        (
            {"outages": [{"branch": "1-4", **OF}, {"branch": "4-5", **OF}, {"branch": "3-4", **OF}]},
            r"these outages split the grid and cut off",
        ),
        ({"known": -1}, r"plant\.known"),
        ({"known": 0.5}, r"plant\.known"),
        ({"mode": "nominal", "known": 1}, r"plant\.known: known = 1: the plant follows plans"),
        ({"minutes": 0}, r"minutes = 0"),
        ({"rating": -1}, r"rating = -1"),
        ({"knwon": 1}, r"plant 'redispatch' has no option 'knwon'; did you mean 'known'"),
    ],
)  # fmt: skip
def test_mistakes_in_outages(over: dict[str, object], text: str) -> None:
    with pytest.raises(ScenarioError, match=text):
        om.load_scenario(SCENARIO, None, {f"plant.{key}": value for key, value in over.items()})


def test_figures_mark_what_is_out(tmp_path: Path) -> None:
    run = loop(om.NominalPlant(), [om.Outage("ab", 1, 2), om.Outage("gas", 3, 1)], "dc")
    figure = figures.system(run.data)
    assert [text.get_text().strip() for text in figure.axes[0].texts] == ["ab out", "gas out"]
    save(run.data, run.summary(), tmp_path)
    kept = load(tmp_path)
    assert kept["branch_status"].equals(run.data["branch_status"])
    assert len(figures.save_figures(kept, tmp_path, figures=["system"])) == 2
