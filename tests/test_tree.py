"""Horizons that are uneven or trees, against an extensive form stated elsewhere."""

from __future__ import annotations

import extensive
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import opfmodel as om
from opfmodel.check import check
from opfmodel.errors import HorizonError, ModelError
from solvers import ProgramError

ENERGY = {"cell": 60.0, "tank": 10.0}
BEFORE = {"coal": (95.0, 20.0), "gas": (30.0, 15.0)}
FACTORS = {"low": 0.85, "mid": 1.0, "high": 1.2}
SHARES = {"low": 0.3, "mid": 0.45, "high": 0.25}


def grid() -> om.Network:
    """A radial grid on which the cone relaxation is exact, with two units of different cost and two storages."""
    made = om.Network("tree", base_mva=100)
    for name in ("a", "b", "c"):
        made.add(name, om.Bus(vm=(0.94, 1.06), reference=name == "a"))
    made.add("ab", om.Branch("a", "b", r=0.01, x=0.05, b=0.02, rating=140))
    made.add("bc", om.Branch("b", "c", r=0.02, x=0.06, rating=90))
    made.add("coal", om.Generator("a", p=(0, 150), q=(-80, 80), ramp=25, cost=om.Polynomial(0.02, 14, 5)))
    made.add("gas", om.Generator("c", p=(0, 120), q=(-60, 60), ramp=60, cost=om.Polynomial(0.05, 32, 0)))
    made.add("cell", om.Storage("b", energy=120, power=30, q=10))
    made.add("tank", om.Storage("c", energy=20, power=8, q=4))
    made.add("town", om.Load("b", p=70, q=20))
    made.add("mill", om.Load("c", p=55, q=15))
    return made


def demand(steps: int, factor: float, after: int) -> om.Profiles:
    """Demand that rises and falls, times a factor after the common part."""
    hours = np.arange(steps)
    shape = (1.0 + 0.18 * np.sin(0.9 * hours)) * np.where(hours >= after, factor, 1.0)
    loads = {"town": (70, 20), "mill": (55, 15)}
    return om.Profiles(
        {
            f"{name}.{key}": value * shape
            for name, pq in loads.items()
            for key, value in zip("pq", pq, strict=True)
        }
    )


def futures(horizon: om.Horizon, common: int) -> list[om.Profiles]:
    if "path 1.1" in horizon.scenario:
        return branching_futures(horizon)
    names = [name for name in horizon.scenarios if name] or ["mid"]
    return [demand(horizon.steps, FACTORS[name], common) for name in names]


def branching_futures(horizon: om.Horizon) -> list[om.Profiles]:
    """The demand of two splits, each of which changes it from its step on."""
    made = []
    for name in horizon.scenarios:
        numbers = name.removeprefix("path ").split(".")
        series = demand(horizon.steps, 1.0, 0)
        for split, number in enumerate(numbers):
            at = min(k for k, own in enumerate(horizon.scenario) if own.count(".") == split and own)
            rise = (0.9, 1.15)[int(number) - 1]
            later = demand(horizon.steps, rise, horizon.step[at])
            plain = demand(horizon.steps, 1.0, 0)
            series = om.Profiles({key: series[key] * later[key] / plain[key] for key in series})
        made.append(series)
    return made


def nodes(horizon: om.Horizon, series: list[om.Profiles]) -> list[extensive.Node]:
    """The nodes of a horizon for the extensive form, each with the mean demand of its steps."""
    made = []
    for k in range(len(horizon)):
        own = series[horizon.series[k] if len(series) > 1 else 0]
        first = horizon.step[k]
        last = first + round(horizon.hours[k] / horizon.base)
        power = {
            name: tuple(float(own[f"{name}.{key}"][first:last].mean()) for key in "pq")
            for name in ("town", "mill")
        }
        made.append(
            extensive.Node(
                int(horizon.parent[k]), float(horizon.hours[k]), float(horizon.probability[k]), power
            )
        )
    return made


def solved(
    horizon: om.Horizon, series: list[om.Profiles], formulation: str = "ac", delay: int = 0, **options: object
) -> om.Plan:
    precise = {"ac": {"tol": 1e-10}, "soc": {"tol": 1e-10}, "dc": {"tol": 1e-10}}[formulation]
    problem = om.MultiStage(
        grid(),
        horizon,
        formulation=formulation,
        generator_delay=delay,
        profiles=demand(horizon.steps, 1.0, 0),
        solver="ipopt",
        options=precise,
        regularisation=0.0,
        **options,
    )
    initial = {"e": list(ENERGY.values()), "pg": [pg for pg, _ in BEFORE.values()]}
    if delay == 1 and formulation != "dc":
        initial["qg"] = [None] and [qg for _, qg in BEFORE.values()]
    plan = problem.solve(initial=initial, expected=problem.expected(series))
    assert plan.optimal, plan.termination
    return plan


HORIZONS = {
    "even chain": om.Horizon.chain(5),
    "uneven": om.Horizon.grid([0.5, 0.5, 1, 2, 2]),
    "tree": om.Horizon.tree([1, 1, 1, 1], SHARES, common=2),
    "uneven tree": om.Horizon.tree([0.5, 0.5, 1, 2], SHARES, common=1),
    "two splits": om.Horizon.branching([1, 1, 1, 1], {1: 2, 2: 2}).with_probabilities([0.1, 0.4, 0.3, 0.2]),
    "uneven splits": om.Horizon.branching([0.5, 0.5, 1, 2], {1: 2, 3: 2}),
}


@pytest.mark.parametrize(
    ("which", "formulation", "delay"),
    [
        *((which, each, 0) for which in HORIZONS for each in ("ac", "dc")),
        *((which, "soc", 0) for which in ("uneven", "tree", "two splits")),
        *((which, "ac", 1) for which in ("even chain", "uneven tree", "uneven splits")),
        ("tree", "dc", 1),
        ("uneven splits", "soc", 1),
    ],
)
def test_a_plan_agrees_with_the_extensive_form(which: str, formulation: str, delay: int) -> None:
    horizon = HORIZONS[which]
    series = futures(horizon, 2)
    plan = solved(horizon, series, formulation, delay)
    reference = extensive.solve(
        grid(), nodes(horizon, series), ENERGY, formulation, dispatch=BEFORE, delay=delay
    )
    assert plan.objective == pytest.approx(reference["objective"], rel=1e-6)
    if delay == 0:  # otherwise the multipliers of a first stage that is given need not be unique
        for bus, price in reference["lmp"].items():
            weights = np.array([n.probability * n.hours for n in nodes(horizon, series)])
            found = plan.data["lmp"].sel(bus=bus).values
            assert found == pytest.approx(np.abs(price) / weights, rel=1e-3)


@pytest.mark.parametrize("formulation", ["ac", "dc"])
@pytest.mark.parametrize(
    ("which", "level", "weight"),
    [("tree", 0.7, 0.5), ("tree", 0.5, 0.9), ("tree", 0.0, 0.5), ("two splits", 0.7, 0.5)],
)
def test_risk_agrees_with_the_extensive_form(
    which: str, formulation: str, level: float, weight: float
) -> None:
    horizon = HORIZONS[which]
    series = futures(horizon, 2)
    plan = solved(horizon, series, formulation, risk=om.Risk(level, weight))
    reference = extensive.solve(
        grid(), nodes(horizon, series), ENERGY, formulation, dispatch=BEFORE, risk=(level, weight)
    )
    assert plan.objective == pytest.approx(reference["objective"], rel=1e-6)
    shares = horizon.probability[horizon.leaves]
    costs = np.array(list(plan.scenario_costs.values()))
    assert plan.expected_cost == pytest.approx(float(shares @ costs), rel=1e-9)
    if level == 0:  # CVaR is then the mean
        assert plan.objective == pytest.approx(plan.expected_cost, rel=1e-9)


def test_equal_scenarios_are_the_deterministic_plan() -> None:
    chain = solved(om.Horizon.chain(4), [demand(4, 1.0, 0)])
    tree = solved(HORIZONS["tree"], [demand(4, 1.0, 0)] * 3)
    assert tree.objective == pytest.approx(chain.objective, rel=1e-8)
    assert list(tree.scenario_costs.values()) == pytest.approx([chain.objective] * 3, rel=1e-7)
    for name in SHARES:
        assert tree.scenario(name)["pg"].values == pytest.approx(chain.data["pg"].values, abs=1e-3)


@pytest.mark.parametrize("formulation", ["ac", "dc"])
def test_the_value_of_information_is_ordered(formulation: str) -> None:
    """Wait-and-see ≤ stochastic ≤ expected cost of the plan for the mean demand."""
    tree = HORIZONS["tree"]
    series = futures(tree, 2)
    stochastic = solved(tree, series, formulation)
    alone = [solved(om.Horizon.chain(4), [own], formulation).objective for own in series]
    wait_and_see = float(np.dot(list(SHARES.values()), alone))
    mean = om.Profiles(
        {key: sum(s * own[key] for s, own in zip(SHARES.values(), series, strict=True)) for key in series[0]}
    )
    expected = solved(om.Horizon.chain(4), [mean], formulation)
    problem = om.MultiStage(
        grid(),
        tree,
        formulation=formulation,
        profiles=demand(4, 1.0, 0),
        solver="ipopt",
        options={"tol": 1e-10},
        regularisation=0.0,
    )
    first = expected.data["pg"].values[:2].T  # the common part is that of the plan for the mean
    problem.constrain("held", lambda s: s.generator.pg[:, [0, 1]] <= first + 1e-4)
    problem.constrain("held too", lambda s: s.generator.pg[:, [0, 1]] >= first - 1e-4)
    initial = {"e": list(ENERGY.values()), "pg": [pg for pg, _ in BEFORE.values()]}
    naive = problem.solve(initial=initial, expected=problem.expected(series))
    assert naive.optimal
    assert wait_and_see <= stochastic.objective + 1e-4
    assert stochastic.objective <= naive.objective + 1e-2
    assert naive.objective - wait_and_see > 0.1  # the futures differ enough for the order to mean something


@pytest.mark.parametrize("formulation", ["ac", "dc"])
def test_prices_are_derivatives_given_the_node(formulation: str) -> None:
    horizon = HORIZONS["uneven tree"]
    series = futures(horizon, 1)
    plan = solved(horizon, series, formulation)
    node = 3  # of the second future, one hour long
    future, step = int(horizon.series[node]), int(horizon.step[node])
    steps = horizon.lengths[node]
    for bus, name in (("b", "town"), ("c", "mill")):
        objectives = []
        for change in (1e-2, -1e-2):
            moved = {key: values.copy() for key, values in series[future].items()}
            for key, values in moved.items():
                if str(key) == f"{name}.p":
                    values[step : step + steps] += change
            changed = [*series]
            changed[future] = om.Profiles(moved)
            objectives.append(solved(horizon, changed, formulation).objective)
        slope = (objectives[0] - objectives[1]) / 2e-2
        weight = horizon.probability[node] * horizon.hours[node]
        assert plan.data["lmp"].sel(bus=bus).values[node] == pytest.approx(slope / weight, rel=1e-4)


def test_the_dispatch_of_siblings_is_shared_with_a_delay() -> None:
    horizon = HORIZONS["tree"]
    plan = solved(horizon, futures(horizon, 2), delay=1)
    first = [horizon.paths[s][2] for s in range(3)]
    later = [horizon.paths[s][3] for s in range(3)]
    pg = plan.data["pg"].values
    assert np.ptp(pg[first], axis=0) == pytest.approx([0, 0], abs=1e-6)
    assert np.ptp(pg[later], axis=0).max() > 1.0


def test_the_dispatch_is_shared_after_every_split_with_a_delay() -> None:
    horizon = HORIZONS["two splits"]  # 0; 1, 2; 3, 4 and 5, 6; 7 to 10
    pg = solved(horizon, futures(horizon, 2), delay=1).data["pg"].values
    for siblings in ([1, 2], [3, 4], [5, 6]):
        assert np.ptp(pg[siblings], axis=0) == pytest.approx([0, 0], abs=1e-6)
    for apart in ([3, 5], [7, 8], [9, 10]):
        assert np.ptp(pg[apart], axis=0).max() > 1.0


def test_probabilities_may_vary_from_solve_to_solve() -> None:
    fixed, varying = (
        om.Horizon.tree([1, 1, 1], SHARES, common=1, varying=varying) for varying in (False, True)
    )
    series = futures(fixed, 1)
    other = [0.6, 0.3, 0.1]
    expected = solved(om.Horizon.tree([1, 1, 1], dict(zip(SHARES, other, strict=True)), common=1), series)
    problem = om.MultiStage(
        grid(), varying, profiles=demand(3, 1.0, 0), options={"tol": 1e-10}, regularisation=0.0
    )
    initial = {"e": list(ENERGY.values()), "pg": [pg for pg, _ in BEFORE.values()]}
    ahead = problem.expected(series)
    assert problem.solve(initial=initial, expected=ahead).objective == pytest.approx(
        solved(fixed, series).objective, rel=1e-8
    )
    plan = problem.solve(initial=initial, expected=ahead, horizon=varying.with_probabilities(other))
    assert plan.objective == pytest.approx(expected.objective, rel=1e-8)
    assert plan.data["lmp"].values == pytest.approx(expected.data["lmp"].values, rel=1e-4)
    with pytest.raises(ModelError, match="probabilities alone"):
        om.MultiStage(grid(), fixed).solve(horizon=fixed.with_probabilities(other))


@pytest.mark.parametrize("solver", ["clarabel", "osqp", "ipopt"])
def test_a_dc_tree_reaches_every_back_end(solver: str) -> None:
    horizon = HORIZONS["uneven tree"]
    problem = om.MultiStage(
        grid(), horizon, formulation="dc", profiles=demand(horizon.steps, 1.0, 0), solver=solver
    )
    plan = problem.solve(initial={"e": list(ENERGY.values())}, expected=problem.expected(futures(horizon, 1)))
    assert plan.optimal
    other = om.MultiStage(
        grid(), horizon, formulation="dc", profiles=demand(horizon.steps, 1.0, 0), solver="clarabel"
    )
    exact = other.solve(initial={"e": list(ENERGY.values())}, expected=other.expected(futures(horizon, 1)))
    assert plan.objective == pytest.approx(exact.objective, rel=1e-5)


# Results ------------------------------------------------------------------------------------------


def test_results_of_a_tree_are_over_nodes() -> None:
    horizon = HORIZONS["uneven tree"]
    plan = solved(horizon, futures(horizon, 1))
    assert plan.data["pg"].dims == ("node", "generator")
    assert plan.data["parent"].values.tolist() == horizon.parent.tolist()
    high = plan.scenario("high")
    assert high["time"].values.tolist() == [0, 0.5, 1, 2]
    assert high["hours"].values.tolist() == [0.5, 0.5, 1, 2]
    assert high.attrs["cost"] == pytest.approx(plan.scenario_costs["high"])
    assert (high["e"].values[1:] == high["e_next"].values[:-1]).all()
    along = plan.data.isel(node=horizon.paths[horizon.scenarios.index("high")])
    assert set(high.data_vars) == set(along.data_vars)
    assert all((high[name].values == along[name].values).all() for name in high.data_vars)
    with pytest.raises(ModelError, match="high"):
        plan.scenario("hihg")


def test_a_shortage_names_scenario_and_time() -> None:
    horizon = om.Horizon.tree([1, 1], {"calm": 0.9, "storm": 0.1}, common=1)
    lost = om.Profiles({"town.p": [70, 400], "mill.p": [55, 55]})
    calm = om.Profiles({"town.p": [70, 70], "mill.p": [55, 55]})
    problem = om.MultiStage(grid(), horizon, formulation="dc", profiles=calm)
    plan = problem.elastic_twin().solve(initial={"e": [60.0, 10.0]}, expected=problem.expected([calm, lost]))
    text = str(plan.shortages[0])
    assert "hour 1" in text
    assert "'storm'" in text
    assert "calm" not in text


def test_a_shortage_before_the_second_split_names_the_futures_that_share_it() -> None:
    horizon = om.Horizon.branching([1, 1, 1], {1: 2, 2: 2})
    calm = om.Profiles({"town.p": [70.0] * 3, "mill.p": [55.0] * 3})
    lost = om.Profiles({"town.p": [70.0, 400, 70], "mill.p": [55.0] * 3})
    problem = om.MultiStage(grid(), horizon, formulation="dc", profiles=calm)
    ahead = problem.expected([calm, calm, lost, lost])
    plan = problem.elastic_twin().solve(initial={"e": [60.0, 10.0]}, expected=ahead)
    assert "hour 1 of scenario 'path 2'" in str(plan.shortages[0])


def test_slices_of_time_have_no_meaning_on_a_tree() -> None:
    def state(stage: om.Stage) -> object:
        return om.total(stage.generator.pg[:, 1:]) <= 200

    chain = om.MultiStage(grid(), 3, formulation="dc")
    chain.constrain("late", state)
    assert chain.solve().optimal
    tree = om.MultiStage(grid(), HORIZONS["tree"], formulation="dc")
    tree.constrain("late", state)
    with pytest.raises((ModelError, ProgramError), match="nodes of a tree"):
        tree.solve()


def test_end_conditions_hold_in_every_scenario() -> None:
    horizon = HORIZONS["tree"]
    series = futures(horizon, 2)
    for end, reached in ((om.End(cyclic=True), [60.0, 10.0]), (om.End(minimum=0.5), [60.0, 10.0])):
        plan = solved(horizon, series, end=end)
        for name in SHARES:
            last = plan.scenario(name)["e_next"].values[-1]
            assert (last >= np.array(reached) - 1e-4).all()
    worth = solved(horizon, series, end=om.End(price=25.0))
    valued = solved(horizon, series, objective=om.Economic() + om.StoredEnergyValue(25.0))
    stored = sum(share * worth.scenario(name)["e_next"].values[-1].sum() for name, share in SHARES.items())
    assert worth.objective - 25.0 * stored == pytest.approx(valued.objective, rel=1e-6)


# Horizons -----------------------------------------------------------------------------------------


@given(
    hours=st.lists(st.integers(1, 4), min_size=1, max_size=6),
    number=st.integers(1, 5),
    common=st.integers(0, 5),
    steps=st.integers(0, 4),
)
def test_a_tree_is_well_formed(hours: list[int], number: int, common: int, steps: int) -> None:
    names = {f"s{n}": 1 / number for n in range(number)}
    if common > len(hours) or (common == len(hours) and number > 1):
        with pytest.raises(HorizonError, match="common"):
            om.Horizon.tree(hours, names, common, step=1)
        return
    tree = om.Horizon.tree(hours, names, common, step=1)
    assert (tree.parent < np.arange(len(tree))).all()
    assert len(tree.leaves) == number
    assert tree.probability[tree.leaves].sum() == pytest.approx(1.0)
    for path in tree.paths:
        assert tree.hours[path].tolist() == hours
        assert tree.step[path].tolist() == [sum(hours[:k]) for k in range(len(hours))]
    for k in range(len(tree)):  # the children of a node are as probable as it is
        children = np.flatnonzero(tree.parent == k)
        if children.size:
            assert tree.probability[children].sum() == pytest.approx(tree.probability[k])
    moved = tree.moved(steps)
    assert (moved[tree.leaves] == tree.leaves).all()
    for path in tree.paths:
        late = [k for k in path if tree.scenario[k]]
        assert all(tree.scenario[moved[k]] in ("", tree.scenario[k]) for k in late)


@pytest.mark.parametrize(
    ("hours", "names", "options", "words"),
    [
        ([1, 1.5], {"a": 1}, {}, "1.5"),
        ([1, -1], {"a": 1}, {}, "positive"),
        ([], {"a": 1}, {}, "positive"),
        ([1, 1], {"a": 0.5, "b": 0.4}, {}, "0.9"),
        ([1, 1], {"a": 1.0, "b": 0.0}, {}, "b: probability"),
        ([1, 1], {"a": 0.5, "b": 0.5}, {"common": 3}, "common = 3"),
        ([1, 1], {}, {}, "at least one"),
    ],
)
def test_a_tree_that_does_not_fit_is_refused(hours: list, names: dict, options: dict, words: str) -> None:
    with pytest.raises(HorizonError, match=words):
        om.Horizon.tree(hours, names, **options)


@given(
    hours=st.lists(st.integers(1, 3), min_size=2, max_size=6),
    data=st.data(),
    steps=st.integers(0, 4),
)
def test_a_tree_that_splits_more_than_once_is_well_formed(
    hours: list[int], data: st.DataObject, steps: int
) -> None:
    depths = st.integers(1, len(hours) - 1)
    splits = data.draw(st.dictionaries(depths, st.integers(2, 3), min_size=1, max_size=3))
    tree = om.Horizon.branching(hours, splits, step=1, varying=True)
    shares = data.draw(st.permutations([float(k) for k in range(1, len(tree.leaves) + 1)]))
    tree = tree.with_probabilities([share / sum(shares) for share in shares])
    assert len(tree.leaves) == np.prod(list(splits.values()))
    assert len(set(tree.scenarios)) == len(tree.leaves)
    for depth in range(len(hours)):
        assert tree.probability[tree.depth == depth].sum() == pytest.approx(1.0)
    for k in range(len(tree)):
        children = np.flatnonzero(tree.parent == k)
        if k not in tree.leaves:
            assert children.size == splits.get(int(tree.depth[k]) + 1, 1)
            assert tree.probability[children].sum() == pytest.approx(tree.probability[k])
            assert all(tree.scenario[child].startswith(tree.scenario[k]) for child in children)
    moved = tree.moved(steps)
    assert (moved[tree.leaves] == tree.leaves).all()
    for number, path in enumerate(tree.paths):
        assert tree.hours[path].tolist() == hours
        assert tree.step[path].tolist() == [sum(hours[:k]) for k in range(len(hours))]
        # a node has the data of one of its futures, and moves along the most likely of them
        own = {k: [n for n, other in enumerate(tree.paths) if k in other] for k in path}
        assert all(tree.series[k] in own[k] for k in path)
        for k in path[:-1]:
            likely = max(own[k], key=lambda n: tree.probability[tree.leaves[n]])
            assert moved[k] in tree.paths[likely]
        assert tree.series[path[-1]] == number


def test_a_single_split_is_the_tree_with_a_common_part() -> None:
    split = om.Horizon.branching([1, 1, 2, 3], {2: 3})
    tree = om.Horizon.tree([1, 1, 2, 3], {f"path {n}": 1 / 3 for n in (1, 2, 3)}, common=2)
    for name in ("parent", "hours", "probability", "step", "series", "scenario"):
        assert list(getattr(split, name)) == list(getattr(tree, name)), name


@pytest.mark.parametrize(
    ("splits", "words"),
    [
        ({4: 2}, "splits: 4: must be below the number of stages, 4"),
        ({0: 2}, "splits: stages = 0: must be an integer, at least 1"),
        ({-1: 2}, "splits: stages = -1"),
        ({1.5: 2}, "splits: stages = 1.5"),
        ({1: 2, 2: 1}, "splits: 2: children = 1: must be an integer, at least 2"),
        ({1: 2.0}, "splits: 1: children = 2.0"),
        ({}, "must be a mapping such as"),
        ([2, 3], "must be a mapping such as"),
    ],
)
def test_splits_that_do_not_fit_are_refused(splits: object, words: str) -> None:
    with pytest.raises(HorizonError, match=words):
        om.Horizon.branching([1, 1, 1, 1], splits)


@pytest.mark.parametrize("which", ["tree", "two splits"])
def test_starts_on_a_tree_keep_the_optimum(which: str) -> None:
    """From the shifted last plan, and from the plan for the expected future."""
    horizon = HORIZONS[which]
    problem = om.MultiStage(grid(), horizon, profiles=demand(8, 1.0, 0), regularisation=0.0)
    initial = {"e": list(ENERGY.values()), "pg": [pg for pg, _ in BEFORE.values()]}
    ahead = problem.expected(futures(horizon, 2))
    plan = problem.solve(initial=initial, expected=ahead)
    reference = extensive.solve(grid(), nodes(horizon, futures(horizon, 2)), ENERGY, dispatch=BEFORE)
    assert plan.objective == pytest.approx(reference["objective"], rel=1e-6)
    bare = problem.session.solve(plan.solution.instance)
    assert plan.solution.objective == pytest.approx(bare.objective, rel=1e-6)
    assert plan.solution.iterations < bare.iterations  # that of the expected future is a good start
    state = plan.next_state()
    cold, warm = problem.solve(1, state, expected=ahead), problem.solve(1, state, plan, expected=ahead)
    assert warm.objective == pytest.approx(cold.objective, rel=1e-6)
    assert warm.solution.iterations < bare.iterations


@pytest.mark.parametrize("which", ["uneven tree", "uneven splits"])
@pytest.mark.parametrize("formulation", ["ac", "dc", "soc"])
def test_the_independent_check_verifies_every_scenario(formulation: str, which: str) -> None:
    horizon = HORIZONS[which]
    series = futures(horizon, 1)
    plan = solved(horizon, series, formulation)
    for name, own in zip(horizon.scenarios, series, strict=True):
        path = plan.scenario(name)
        before = {name: pg for name, (pg, _) in BEFORE.items()}
        report = check(grid(), path, own, previous_pg=before)
        assert report.max_violation < 1e-6, report
        assert check(grid(), plan.trajectory(name), own, previous_pg=before) == report
        assert report.cost == pytest.approx(plan.scenario_costs[name], rel=1e-9)
        broken = path.copy(deep=True)
        broken["e_next"][2] += 1.0  # the check can fail
        assert check(grid(), broken, own).max_violation > 1e-3


def test_limits_of_a_long_stage_are_the_tightest_of_its_steps() -> None:
    horizon = om.Horizon.grid([1, 3])
    series = {
        "ab.rating": [140, 60, 90, 80],
        "gas.p_max": [120, 120, 60, 90],
        "cell.energy": [120, 90, 120, 120],
    }
    problem = om.MultiStage(grid(), horizon, formulation="dc", profiles=series)
    data = problem.ahead(0)
    assert data["branch", "rating"][0].tolist() == [1.4, 0.6]
    assert data["generator", "p_max"][1].tolist() == pytest.approx([1.2, 0.9])
    assert data["storage", "energy"][0].tolist() == pytest.approx([1.2, 0.9])
    assert problem.solve().optimal


def test_a_constraint_may_name_a_node_of_one_scenario() -> None:
    horizon = HORIZONS["tree"]
    last = int(horizon.leaves[-1])
    series = futures(horizon, 2)
    problem = om.MultiStage(grid(), horizon, profiles=demand(8, 1.0, 0))
    problem.constrain("gas at the end", lambda s: s.generator.pg[:, [last]] >= [[0.0], [40.0]])
    free = om.MultiStage(grid(), horizon, profiles=demand(8, 1.0, 0))
    ahead = problem.expected(series)
    before = free.solve(expected=ahead)
    plan = problem.solve(expected=ahead)
    assert plan.optimal
    assert before.data["pg"].values[last, 1] < 39.0
    assert plan.data["pg"].values[last, 1] == pytest.approx(40.0, abs=1e-4)
    assert plan.objective > before.objective


@pytest.mark.parametrize("kind", ["grid", "tree"])
def test_a_soft_constraint_on_one_stage_costs_what_the_first_stage_does(kind: str) -> None:
    horizon = {
        "grid": om.Horizon.grid([1, 2, 3]),
        "tree": om.Horizon.tree([1, 2, 3], {"low": 0.5, "high": 0.5}, common=2),
    }[kind]
    problem = om.MultiStage(grid(), horizon, formulation="dc", profiles=demand(6, 1.0, 0))
    problem.constrain("impossible", lambda s: s.generator.pg[:, [2]] >= [[200.0], [0.0]])
    plan = problem.elastic_twin(om.Elastic(limit=100.0, shedding=1000.0)).solve()
    assert plan.optimal
    (short,) = plan.shortages
    assert str(short) == "constraint impossible is missed by 60.0"  # the rating of the only line is 140
    assert short.cost == pytest.approx(60 * 100.0)
