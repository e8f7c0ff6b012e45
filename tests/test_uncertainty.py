"""Uncertain futures: cases, drawn paths and their reduction, in plans and closed loops."""

from __future__ import annotations

import json
from itertools import combinations, permutations
from pathlib import Path

import numpy as np
import pytest
from conftest import two_bus
from hypothesis import given
from hypothesis import strategies as st

import opfmodel as om
from opfmodel.check import check
from opfmodel.cli.app import app
from opfmodel.errors import HorizonError, ProfileError, ScenarioError
from opfmodel.forecasts import Noisy, Perfect
from opfmodel.forecasts.reduction import backward_construction, fast_forward_selection
from opfmodel.forecasts.scenarios import Draw, Futures
from opfmodel.profiles.scale import Scale

ACTUAL = om.Profiles.of({"town.p": 90.0 + np.arange(12.0), "town.q": np.full(12, 30.0)})
CASES = {"low": om.Case(0.5, [Scale(0.9)]), "high": om.Case(0.5, [Scale(1.1)])}
NOISY = Noisy(deviation=0.05, correlation=0.8, seed=3, common_share=0.5)


def futures(
    scenarios: om.Scenarios,
    hours: tuple[int, ...] = (1, 1, 2),
    forecast: om.Forecast | None = None,
    actual: om.Profiles = ACTUAL,
) -> Futures:
    """The futures at step 2 of a forecast that is perfect."""
    horizon = scenarios.horizon(hours)
    issued = om.Profiles({key: ACTUAL[key][2 : 2 + horizon.steps] for key in ACTUAL})
    return scenarios.futures(
        issued, 2, horizon, actual=actual, forecast=forecast or Perfect(), network=two_bus()
    )


@pytest.mark.parametrize("common", [0, 1, 2])
@pytest.mark.parametrize("cases", [CASES, {"high": om.Case(1.0, [Scale(1.1)])}])
def test_rules_act_after_the_common_stages_also_on_a_single_case(common: int, cases: dict) -> None:
    made = futures(om.Scenarios(common, cases))
    high = made.series[-1]["town.p"] / ACTUAL["town.p"][2:6]
    assert high.tolist() == pytest.approx([1.0] * common + [1.1] * (4 - common))
    assert made.probability.sum() == pytest.approx(1.0)


def test_a_single_case_may_be_common_to_its_end() -> None:
    made = futures(om.Scenarios(3, {"high": om.Case(1.0, [Scale(1.1)])}))
    assert made.series[0]["town.p"].tolist() == ACTUAL["town.p"][2:6].tolist()


@pytest.mark.parametrize("keep", [1, 4])
def test_drawn_paths_leave_the_common_stages_and_never_see_what_happens(keep: int) -> None:
    scenarios = om.Scenarios(common=2, draw=Draw(number=40, keep=keep, seed=7))
    made = futures(scenarios, forecast=NOISY)
    assert len(made.series) == keep
    assert sum(made.stands_for) == 40
    assert made.probability.tolist() == pytest.approx([many / 40 for many in made.stands_for])
    for series in made.series:
        assert series["town.p"][:2].tolist() == ACTUAL["town.p"][2:4].tolist()
        assert (series["town.p"][2:] != ACTUAL["town.p"][4:6]).all()
        assert series["town.p"] / series["town.q"] == pytest.approx(ACTUAL["town.p"][2:6] / 30.0)
    other = om.Profiles({key: 0.5 * values for key, values in ACTUAL.items()})
    again = futures(scenarios, forecast=NOISY, actual=other)
    assert all((a["town.p"] == b["town.p"]).all() for a, b in zip(made.series, again.series, strict=True))
    differs = futures(om.Scenarios(common=2, draw=Draw(40, keep, seed=8)), forecast=NOISY)
    assert differs.series[0]["town.p"].tolist() != made.series[0]["town.p"].tolist()


@given(
    st.lists(st.integers(0, 50), min_size=3, max_size=9, unique=True),
    st.integers(1, 3),
    st.integers(0, 2**32 - 1),
)
def test_the_selection_is_greedy_and_close_to_the_best(points: list[int], keep: int, seed: int) -> None:
    paths = np.array(points, dtype=float)[:, None]
    probability = np.random.default_rng(seed).dirichlet(np.ones(len(paths)))
    made = fast_forward_selection(paths, probability, keep)

    def distance(kept: tuple[int, ...]) -> float:
        return float(probability @ np.abs(paths - paths[list(kept), 0]).min(axis=1))

    assert made.probability.sum() == pytest.approx(1.0)
    own = distance(tuple(made.kept))
    best = min(map(distance, combinations(range(len(paths)), keep)))
    assert best - 1e-9 <= own
    for count in range(1, keep + 1):  # every step adds the path that lowers the distance most
        before = tuple(made.kept[: count - 1])
        left = set(range(len(paths))) - set(before)
        least = min(distance((*before, path)) for path in left)
        assert distance(tuple(made.kept[:count])) == pytest.approx(least, abs=1e-9)
    if keep == 1:
        assert own == pytest.approx(best, abs=1e-9)


def test_paths_with_the_same_beginning_become_the_tree_that_they_are() -> None:
    """Two beginnings, each of which goes on in two ways and in two more, at steps 1, 2 and 4."""
    numbers = np.array(list(np.ndindex(2, 2, 2)))  # of the eight paths
    rise = numbers * [40.0, 10.0, 3.0] + [1.0, 2.0, 4.0]
    stretches = [np.repeat(rise[:, [split]], length, axis=1) for split, length in enumerate((1, 2, 2))]
    mixed = np.random.default_rng(5).permutation(np.repeat(np.arange(8), [1, 2, 3, 4, 5, 6, 7, 8]))
    made = backward_construction([part[mixed] for part in stretches], np.full(36, 1 / 36), [2, 2, 2])
    for leaf, carried in enumerate(made.carried):  # in the order of what they carry
        assert [numbers[mixed[path]][split] for split, path in enumerate(carried)] == list(numbers[leaf])
    assert made.probability == pytest.approx(np.arange(1, 9) / 36)
    assert made.stands_for.tolist() == mixed.tolist()
    for split, shared in enumerate((4, 2, 1)):  # paths are one node until they split
        groups = made.carried[:, split].reshape(-1, shared)
        assert (groups == groups[:, :1]).all()


@given(
    number=st.integers(12, 30),
    children=st.sampled_from([[2], [3], [2, 2], [3, 2], [2, 3], [2, 2, 3]]),
    size=st.sampled_from([1, 3, 1000]),
    seed=st.integers(0, 2**32 - 1),
)
def test_a_tree_of_paths_is_well_formed_and_near_to_them(
    number: int, children: list[int], size: int, seed: int
) -> None:
    random = np.random.default_rng(seed)
    values = random.integers(-size, size + 1, (number, len(children), 2)).astype(float)  # also equal ones
    stretches = list(values.transpose(1, 0, 2))
    made = backward_construction(stretches, np.full(number, 1 / number), children)
    leaves = int(np.prod(children))
    assert made.carried.shape == (leaves, len(children))
    assert made.probability.sum() == pytest.approx(1.0)
    many = np.bincount(made.stands_for, minlength=leaves)
    assert (many >= 1).all()
    assert made.probability == pytest.approx(many / number)
    kept = made.carried[:, -1]
    assert made.stands_for[kept].tolist() == list(range(leaves))  # each stands for itself
    distance = np.linalg.norm((values[:, None] - values[kept]).reshape(number, leaves, -1), axis=2)
    assert distance[np.arange(number), made.stands_for] == pytest.approx(distance.min(axis=1), abs=1e-4)
    for split in range(len(children)):
        below = int(np.prod(children[split + 1 :]))
        groups = made.carried[:, split].reshape(-1, below)
        assert (groups == groups[:, :1]).all()
        nodes = groups[:, 0]
        assert len(set(nodes.tolist())) == nodes.size
        assert all(node in kept[k * below : (k + 1) * below] for k, node in enumerate(nodes))
        totals = stretches[split][nodes].sum(axis=1).reshape(-1, children[split])
        assert (np.diff(totals, axis=1) >= 0).all()
    if len(children) > 1 and leaves <= 6:  # no other allotment of the leaves is nearer to the nodes
        nodes = made.carried[:: children[-1], -2]
        until = values[:, :-1].reshape(number, -1)
        cost = np.linalg.norm(until[kept][:, None] - until[nodes], axis=2) * made.probability[:, None]
        others = [k for k, path in enumerate(kept) if path not in nodes]
        own = dict(zip(kept.tolist(), made.carried[:, -2].tolist(), strict=True))
        found = sum(cost[k, nodes.tolist().index(own[kept[k]])] for k in others)
        slots = np.repeat(np.arange(nodes.size), children[-1] - 1)
        best = min(
            sum(cost[k, slot] for k, slot in zip(others, chosen, strict=True))
            for chosen in set(permutations(slots.tolist()))
        )
        assert found == pytest.approx(best, abs=1e-4)


SPLITS = om.Scenarios(draw=Draw(60, seed=4, splits={1: 3, 2: 2}))


def test_futures_have_equal_data_where_they_share_a_node() -> None:
    made = futures(SPLITS, hours=(1, 1, 2, 1), forecast=NOISY)
    horizon = SPLITS.horizon((1, 1, 2, 1))
    issued = ACTUAL["town.p"][2:7]
    for series in made.series:
        assert series["town.p"][:1].tolist() == issued[:1].tolist()
        assert series["town.p"] / series["town.q"] == pytest.approx(issued / 30.0)
    data = np.array([series["town.p"] for series in made.series])
    for node in range(len(horizon)):
        sharing = [n for n, path in enumerate(horizon.paths) if node in path]
        steps = slice(horizon.step[node], horizon.step[node] + horizon.lengths[node])
        assert (data[sharing, steps] == data[horizon.series[node], steps]).all()
    assert len(set(data[:, 1].tolist())) == 3
    assert len(set(data[:, 2].tolist())) == 6
    drawn = NOISY.paths(
        om.Profiles({key: ACTUAL[key][2:7] for key in ACTUAL}), 2, 60, 4, None
    )  # each stretch is one of the drawn paths
    paths = next(values for key, values in drawn.items() if str(key) == "town.p")
    for row in data:
        assert any((row[1:2] == path[1:2]).all() for path in paths)
        assert any((row[2:] == path[2:]).all() for path in paths)
    assert sum(made.stands_for) == len(made.drawn) == 60
    assert np.bincount(made.drawn).tolist() == list(made.stands_for)
    assert made.probability.tolist() == pytest.approx([many / 60 for many in made.stands_for])


def test_a_single_split_gives_the_futures_of_a_common_part() -> None:
    one, other = (
        futures(om.Scenarios(common, draw=draw), hours=(1, 1, 2, 1), forecast=NOISY)
        for common, draw in ((2, Draw(40, 3, seed=7)), (None, Draw(40, seed=7, splits={2: 3})))
    )
    assert one.probability.tolist() == other.probability.tolist()
    assert list(one.stands_for) == list(other.stands_for)
    for a, b in zip(one.series, other.series, strict=True):
        assert all((a[key] == b[key]).all() for key in a)


def test_paths_without_errors_are_equally_probable_or_nearly() -> None:
    """Equal paths: each that is kept stands at least for itself."""
    exact = Noisy(deviation=0.0, seed=3)
    for draw in (Draw(8, 3), Draw(8, splits={1: 2, 2: 2})):
        made = futures(om.Scenarios(draw=draw), forecast=exact)
        assert min(made.stands_for) >= 1
        assert made.probability.sum() == pytest.approx(1.0)


def test_a_forecast_without_an_error_model_draws_no_paths() -> None:
    with pytest.raises(ProfileError, match="Perfect: cannot draw paths"):
        futures(om.Scenarios(draw=Draw(10, 2)))


def problem(scenarios: om.Scenarios, **options: object) -> om.MultiStage:
    return om.MultiStage(two_bus(), scenarios.horizon([1, 1, 2]), profiles=ACTUAL, **options)


@pytest.mark.parametrize(
    "scenarios", [om.Scenarios(cases=CASES), om.Scenarios(draw=Draw(30, 3, seed=1)), SPLITS]
)
def test_a_closed_loop_plans_for_all_futures_and_meets_the_actual_one(scenarios: om.Scenarios) -> None:
    made = problem(scenarios, risk=om.Risk(0.5, 0.3))
    run = om.simulate(om.Controller(made, NOISY, scenarios=scenarios), om.Redispatch(), steps=4)
    assert run.status == "done"
    report = check(two_bus(), run.data, {key: ACTUAL[key][:4] for key in ACTUAL})
    assert report.max_violation < 1e-6
    for plan in run.plans:
        assert len(plan["scenarios"]) == len(made.horizon.leaves)
        assert sum(found["probability"] for found in plan["scenarios"].values()) == pytest.approx(1.0)
    starts = [[attempt["start"] for attempt in plan["attempts"]] for plan in run.plans]
    assert starts == [["cold"], ["warm"], ["warm"], ["warm"]]


def test_a_closed_loop_needs_a_common_first_stage() -> None:
    scenarios = om.Scenarios(common=0, cases=CASES)
    controller = om.Controller(problem(scenarios), scenarios=scenarios)
    assert controller.plan(0, None).optimal  # a single plan does not
    with pytest.raises(HorizonError, match="common = 0: must be at least 1 in a closed loop"):
        om.simulate(controller, steps=2)


FILE = """
network: {{file: n.m}}
time: {{step: 1, steps: 4}}
controller:
  horizon: 4
  scenarios: {0}
"""


@pytest.mark.parametrize(
    ("section", "message"),
    [
        (
            "{common: 0, cases: {a: {probability: 0.5}, b: {probability: 0.5}}}",
            r"s.yaml:6:\d+: controller.scenarios.common: .*common = 0: must be at least 1",
        ),
        (
            "{cases: {a: {probability: 0.5}, b: {probability: 0.4}}}",
            r"s.yaml:6:\d+: controller.scenarios.cases: .*sum to 0.9; must sum to 1",
        ),
        (
            "{common: 4, cases: {a: {probability: 0.5}, b: {probability: 0.5}}}",
            r"s.yaml:6:\d+: controller.scenarios.common: .*below the number of stages, 4",
        ),
        (
            "{draw: {number: 3, keep: 5}}",
            r"s.yaml:6:\d+: controller.scenarios.draw.keep: .*at most number = 3",
        ),
        (
            "{draw: {number: 9, splits: {2: 3, 4: 2}}}",
            r"s.yaml:6:\d+: controller.scenarios.draw.splits.4: .*below the number of stages, 4",
        ),
        (
            "{draw: {number: 9, splits: {0: 3}}}",
            r"s.yaml:6:\d+: controller.scenarios.draw.splits.0: .*must be an integer, at least 1",
        ),
        (
            "{draw: {number: 9, splits: {late: 3}}}",
            r"s.yaml:6:\d+: controller.scenarios.draw.splits.late: .*must be an integer, at least 1",
        ),
        (
            "{draw: {number: 9, splits: {1: 3, 2: 1}}}",
            r"s.yaml:6:\d+: controller.scenarios.draw.splits.2: .*children = 1: must be an integer, at least 2",
        ),
        (
            "{draw: {number: 9, splits: {1: many}}}",
            r"s.yaml:6:\d+: controller.scenarios.draw.splits.1: .*integer",
        ),
        (
            "{draw: {number: 9, splits: {1: 3, 2: 4}}}",
            r"s.yaml:6:\d+: controller.scenarios.draw.splits: .*at most number = 9",
        ),
        ("{draw: {number: 9, splits: {}}}", r"controller.scenarios.draw.splits: .*a mapping such as"),
        ("{draw: {number: 9, keep: 2, splits: {1: 2}}}", r"scenarios.draw: .*either keep or splits"),
        ("{draw: {number: 9}}", r"scenarios.draw: .*either keep or splits"),
        ("{common: 1, draw: {number: 9, splits: {1: 2}}}", r"scenarios.common: .*common = 1: .*splits"),
        ("{common: 1}", r"s.yaml:6:\d+: controller.scenarios: .*give either cases or a draw"),
    ],
)
def test_scenarios_that_do_not_fit_are_refused_with_their_key(
    tmp_path: Path, section: str, message: str
) -> None:
    case = Path(__file__).parent / "data" / "matpower" / "case5.m"
    (tmp_path / "n.m").write_bytes(case.read_bytes())
    path = tmp_path / "s.yaml"
    path.write_text(FILE.format(section), encoding="utf-8")
    with pytest.raises(ScenarioError, match=message):
        om.load_scenario(path).simulate()


def test_a_scenario_file_states_splits(tmp_path: Path) -> None:
    case = Path(__file__).parent / "data" / "matpower" / "case5.m"
    (tmp_path / "n.m").write_bytes(case.read_bytes())
    path = tmp_path / "s.yaml"
    rest = "forecast: {noisy: {deviation: 0.03, seed: 1}}\nplant: {mode: redispatch}\n"
    path.write_text(FILE.format("{draw: {number: 9, splits: {1: 2, 3: 2}}}") + rest, encoding="utf-8")
    loaded = om.load_scenario(path)
    assert loaded.problem.horizon.scenarios == ("path 1.1", "path 1.2", "path 2.1", "path 2.2")
    for key, value in (("splits.3", 3), ("splits", {3: 3})):  # keys are text in a file, numbers in Python
        other = om.load_scenario(path, overrides={f"controller.scenarios.draw.{key}": value})
        assert len(other.problem.horizon.leaves) == 6


def test_where_errors_meet_scarcity_the_plan_for_the_expected_demand_costs_more() -> None:
    """The example of docs/uncertainty.md: the first hour of one plan, and the best that can follow it."""
    grid = om.Network("two-bus")
    grid.north, grid.south = om.Bus(reference=True), om.Bus()
    grid.tie = om.Branch("north", "south", r=0.01, x=0.1, rating=120)
    grid.coal = om.Generator("north", p=(0, 100), q=(-80, 80), ramp=15, cost=om.Polynomial(0.01, 15, 0))
    grid.peaker = om.Generator("south", p=(0, 80), q=(-80, 80), cost=om.Polynomial(0.02, 80, 0))
    grid.cell = om.Storage("south", energy=60, power=20, q=10)
    grid.town = om.Load("south", p=80, q=20)
    scenarios = om.Scenarios(1, {"calm": om.Case(0.8, [Scale(0.95)]), "peak": om.Case(0.2, [Scale(1.35)])})
    hours, state = [1, 1, 1, 2, 2], {"e": [30.0], "pg": [80.0, 0.0]}
    series = om.Profiles.of({"town.p": np.full(9, 80.0), "town.q": np.full(9, 20.0)})
    factor = np.where(np.arange(9) < 1, 1.0, 0.8 * 0.95 + 0.2 * 1.35)
    expected = om.Profiles.of({key: values * factor for key, values in series.items()})
    chain = om.MultiStage(grid, om.Horizon.grid(hours), profiles=expected).solve(initial=state)
    assert chain.data["pg"].values[0] == pytest.approx([78.3, 0.0], abs=0.05)
    assert chain.data["ps"].values[0] == pytest.approx([-2.2], abs=0.05)

    def cost(first: om.Plan | None) -> float:
        tree = om.MultiStage(grid, scenarios.horizon(hours), profiles=series)
        if first is not None:
            pg, ps = first.data["pg"].values[0, 0], first.data["ps"].values[0]
            root = np.array([0])
            tree.constrain("pg", lambda stage: stage.generator.pg[:1][:, root] == pg)
            tree.constrain("ps", lambda stage: stage.storage.ps[:, root] == ps[:, None])
        plan = om.Controller(tree, scenarios=scenarios).plan(0, state)
        assert plan.optimal
        return plan.expected_cost

    assert cost(None) == pytest.approx(8_774, abs=1)
    assert cost(chain) - cost(None) == pytest.approx(285, abs=1)


@pytest.mark.filterwarnings("ignore::opfmodel.errors.ProfileWarning")
@pytest.mark.parametrize("command", ["solve", "security"])
def test_a_plan_of_drawn_futures_is_solved_alone(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    stated = {
        "controller.horizon": 3,
        "time.steps": 3,
        "controller.generator_delay": 0,
        "controller.scenarios": "{draw: {number: 20, keep: 2, seed: 1}}",
        "forecast": "{noisy: {deviation: 0.02, seed: 1}}",
        "plant": "{mode: redispatch}",
    }
    options = [part for key, value in stated.items() for part in ("--set", f"{key}={value}")]
    assert app([command, "scenarios/case5-step.yaml", *options, "--json"], standalone_mode=False) in (0, 1)
    printed = json.loads(capsys.readouterr().out)
    if command == "solve":
        assert printed["status"] == "locally_optimal"
    else:
        assert {each["scenario"] for each in printed["contingencies"]} == {"", "path 1", "path 2"}
