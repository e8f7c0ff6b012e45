"""Custom constraints: in Python and in scenario files, under every formulation, with prices."""

from __future__ import annotations

import re
import textwrap
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, examples
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import opfmodel as om
from opfmodel import plugins
from opfmodel.errors import ConstraintError, ModelError, ScenarioError
from opfmodel.model import Linear

DEMAND = {"town.p": [90, 100, 80, 95], "town.q": [20, 25, 15, 20]}
FORMULATIONS = [n for n, p in plugins.plugins("formulation").items() if p.origin == "opfmodel"]


def two_units() -> om.Network:
    """A cheap unit behind a line and an expensive one at the demand."""
    grid = om.Network("two-units")
    grid.north = om.Bus(vm=(0.95, 1.05), reference=True)
    grid.south = om.Bus(vm=(0.95, 1.05))
    grid.tie = om.Branch("north", "south", r=0.01, x=0.1, rating=120)
    grid.coal = om.Generator("north", p=(0, 120), q=(-80, 80), cost=om.Polynomial(0.01, 15, 0))
    grid.gas = om.Generator("south", p=(0, 80), q=(-80, 80), cost=om.Polynomial(0.02, 60, 0))
    grid.town = om.Load("south", p=90, q=20)
    return grid


def problem(formulation: str = "ac", grid: om.Network | None = None, **keywords) -> om.MultiStage:
    grid = two_units() if grid is None else grid
    return om.MultiStage(grid, 3, formulation=formulation, profiles=DEMAND, **keywords)


def reserve(stage):
    return om.total(stage.generator.p_max - stage.generator.pg)


def test_the_formulations_are_all_here() -> None:
    assert len(FORMULATIONS) >= 7


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_a_reserve_requirement_holds_under_every_formulation(formulation: str) -> None:
    free = problem(formulation).solve().data
    assert free["pg"].sel(generator="coal").values.min() > 75
    made = problem(formulation)
    made.constrain("reserve", lambda s: s.generator.p_max[[0]] - s.generator.pg[[0]] >= 45)
    plan = made.solve()
    assert plan.optimal
    assert_allclose(plan.data["pg"].sel(generator="coal"), 75, atol=1e-3)
    # one more MW of reserve moves one MW from coal to gas; losses change the figure a little
    dear = 60 + 0.04 * plan.data["pg"].sel(generator="gas").values
    cheap = 15 + 0.02 * plan.data["pg"].sel(generator="coal").values
    assert_allclose(plan.data["reserve_price"], dear - cheap, rtol=0.1)


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_an_export_limit_holds_where_flows_are_published_and_is_refused_elsewhere(formulation: str) -> None:
    made = problem(formulation)
    made.constrain("export", lambda s: s.branch.pf[[0]], at_most=[70, 60, 50])
    if "pf" in plugins.load("formulation", formulation).publishes:
        plan = made.solve()
        assert_allclose(plan.data["pf"].sel(branch="tie"), [70, 60, 50], atol=1e-3)
        assert (plan.data["export_price"].values < -30).all()
    else:
        message = (
            f"constraint 'export': formulation '{formulation}' does not publish branch.pf; "
            "formulations that do: ac, ac-rectangular, dc, dc-losses, dc-matpower"
        )
        with pytest.raises(ModelError, match=message):
            made.solve()


def test_a_price_is_the_slope_of_the_cost() -> None:
    def cost(asked: float, allowed: float) -> om.Plan:
        made = problem("dc", step=0.5, solver="qp")
        made.constrain("reserve", lambda s: s.generator.pg[[1]], at_least=[asked, -9, -9])
        made.constrain("export", lambda s: s.branch.pf[[0]], at_most=[200, 200, allowed])
        return made.solve()

    plan, more = cost(30, 50), 0.01
    asked = (cost(30 + more, 50).objective - cost(30 - more, 50).objective) / (2 * more)
    allowed = (cost(30, 50 + more).objective - cost(30, 50 - more).objective) / (2 * more)
    assert_allclose(plan.data["reserve_price"], [asked / 0.5, 0, 0], atol=1e-3)
    assert_allclose(plan.data["export_price"], [0, 0, allowed / 0.5], atol=1e-3)
    assert asked > 10
    assert allowed < -10
    assert plan.data["export_price"].dims == ("time",)


def test_a_constraint_by_component_has_a_price_by_item() -> None:
    made = problem("dc")
    made.constrain("each", lambda s: s.generator.pg <= 60)
    data = made.solve().data
    assert data["each_price"].dims == ("time", "each_item")
    assert (data["each_price"].values[:, 0] < -10).all()
    assert om.simulate(made, steps=1).data["each_price"].shape == (1, 2)


def test_limits_move_with_the_horizon() -> None:
    made = problem("dc", grid=two_units())
    made.constrain("export", lambda s: s.branch.pf[[0]], at_most=[70, 60, 50, 40])
    run = om.simulate(om.MultiStage(two_units(), 2, formulation="dc", profiles=DEMAND), steps=3)
    assert run.data["pf"].values.min() > 75
    assert_allclose(made.solve(1).data["pf"].sel(branch="tie"), [60, 50, 40], atol=1e-4)
    with pytest.raises(ModelError, match="'export': at_most has 4 values; steps 2 to 4 need 5"):
        om.MultiStage.solve(_longer(made), 2)


def _longer(made: om.MultiStage) -> om.MultiStage:
    series = {key: [*values, values[-1]] for key, values in DEMAND.items()}
    longer = om.MultiStage(made.network, 3, formulation="dc", profiles=series)
    longer.constrain("export", lambda s: s.branch.pf[[0]], at_most=[70, 60, 50, 40])
    return longer


def test_nonlinear_constraints() -> None:
    made = problem("ac")
    made.constrain("apparent", lambda s: s.generator.pg[[0]] ** 2 + s.generator.qg[[0]] ** 2 <= 70.0**2)
    data = made.solve().data
    apparent = np.hypot(data["pg"], data["qg"]).sel(generator="coal").values
    assert_allclose(apparent, 70, atol=1e-2)


def test_a_constraint_of_some_stages_only_has_no_price() -> None:
    made = problem("dc")
    made.constrain("last", lambda s: s.generator.pg[[1], -1:] >= 25)
    made.constrain("steady", lambda s: s.generator.pg[:, 1:] - s.generator.pg[:, :-1] <= 7)
    data = made.solve().data
    assert_allclose(data["pg"].sel(generator="gas"), [11, 18, 25], atol=1e-4)  # 7 apart, up to 25
    assert not {"last_price", "steady_price"} & set(data)
    made = problem("dc")
    made.constrain("last", lambda s: s.generator.pg[[1], -1:], at_least=25)
    with pytest.raises(ModelError, match="'last': at_least and at_most"):
        made.solve()


@pytest.mark.parametrize(
    ("state", "limits", "message"),
    [
        (lambda s: 3, {}, "'own': must return a comparison of quantities, not 3"),
        (lambda s: s.generator.pg, {}, "'own': must return a comparison"),
        (lambda s: 3, {"at_most": 3}, "'own': must return a quantity .*, not 3"),
        (lambda s: s.generator.pg <= 3, {"at_most": 3}, "'own': .* comparison; omit at_least and at_most"),
        (lambda s: s.generators.pg <= 3, {}, "'own': .* kind 'generators'; did you mean 'gen"),
        (lambda s: s.generator.pk <= 3, {}, "'own': generator has no quantity 'pk' here; did you mean|available"),
        (lambda s: om.total(s.generator.pg) ** 2 <= 3, {}, "'own': a sum cannot be raised to a power"),
        (lambda s: om.total(s.generator.pg) / om.total(s.generator.pg) <= 3, {}, "'own': a sum .* divided by numbers"),
        (lambda s: s.generator.pg < 3, {}, "'own': .* write <= or >="),
        (lambda s: om.total(s.generator.pg) > 3, {}, "'own': .* write <= or >="),
        (lambda s: max(0, s.generator.pg) <= 3, {}, r"'own': .* largest\(0, x\)"),
        (lambda s: s.generator.pg[[7]] <= 3, {}, r"'own': \[7\]: there are 2 items"),
        (lambda s: s.generator.pg["coal"] <= 3, {}, "'own': 'coal': there are 2 items .* positions"),
        (lambda s: s.generator.pg[0, 0, 0] <= 3, {}, "'own': .* not 3 axes"),
        (lambda s: abs(s.generator.pg) <= 3, {}, r"'own': an absolute value is not smooth; write largest\(x, -x\)"),
        (lambda s: om.total(s.generator.pg) <= np.inf, {}, "'own': an array .* finite"),
        (lambda s: s.generator.pg, {"at_most": "3"}, "'own': at_most = '3': must be a number or one number per"),
        (lambda s: s.generator.pg, {"at_least": [[1]]}, "must be a number or one number per time step"),
        (lambda s: s.generator.pg, {"at_least": np.nan}, "must be a number or one number per time step"),
    ],
)  # fmt: skip
def test_misuse_is_said(state, limits, message: str) -> None:
    made = problem("dc")
    with pytest.raises(ModelError, match=message):
        made.constrain("own", state, **limits)
        made.solve()


@pytest.mark.parametrize(("name", "fault"), [("a/b", "'/'"), ("", "empty"), (3, "text"), ("a\n", "visible")])
def test_a_name_is_checked_when_it_is_stated(name: str, fault: str) -> None:
    with pytest.raises(ModelError, match=fault):
        problem("dc").constrain(name, lambda s: s.generator.pg <= 3)


def test_what_is_returned_in_place_of_a_comparison_is_named_by_its_kind() -> None:
    made = problem("dc")
    made.constrain("own", lambda s: 100 * s.generator.pg - 3)
    with pytest.raises(ModelError) as caught:
        made.compile()
    assert str(caught.value).endswith("must return a comparison of quantities, not a quantity")


def test_quantities_can_be_iterated() -> None:
    one, other = problem("dc"), problem("dc")
    one.constrain("own", lambda s: om.total(sum(s.generator.pg)) <= 70)
    other.constrain("own", lambda s: om.total(s.generator.pg) <= 70)
    assert one.solve().status == other.solve().status


def test_a_price_of_that_name_is_there_already() -> None:
    made = problem("ac")
    made.constrain("rating", lambda s: s.generator.pg <= 3)
    with pytest.raises(ModelError, match=r"'rating': .*'rating_price'"):
        made.solve()


# Scenario files ---------------------------------------------------------------------------------

SCENARIO = """
network:
  buses: {north: {vm: [0.95, 1.05], reference: true}, south: {vm: [0.95, 1.05]}}
  branches: {tie: {from_bus: north, to_bus: south, r: 0.01, x: 0.1, rating: 120}}
  generators:
    coal: {bus: north, p: [0, 120], q: [-80, 80], cost: {c2: 0.01, c1: 15}}
    gas1: {bus: south, p: [0, 40], q: [-40, 40], cost: {c1: 60}}
    gas2: {bus: south, p: [0, 40], q: [-40, 40], cost: {c1: 60.5}}
    old: {bus: south, p: [0, 500], in_service: false}
  loads: {town: {bus: south, p: 90, q: 30}}
time: {steps: 3}
controller: {horizon: 2, formulation: dc}
constraints:
  export: {terms: {tie.pf: 1}, at_most: [80, 70, 60, 50]}
  reserve: {terms: {generator.p_max: 1, generator.pg: -1, old.pg: 5}, at_least: 100}
  mix: {terms: {"gas*.pg": 1, gas2.pg: -2}, equal: 0}
"""


def scenario(tmp_path: Path, text: str = SCENARIO, **keywords) -> om.Scenario:
    path = tmp_path / "scenario.yaml"
    path.write_text(text)
    return om.load_scenario(path, **keywords)


def test_constraints_of_a_scenario_hold_in_its_closed_loop(tmp_path: Path) -> None:
    run = scenario(tmp_path).simulate()
    assert run.status == "done"
    assert_allclose(run.data["pf"].sel(branch="tie"), [80, 70, 60], atol=1e-4)
    pg = run.data["pg"]
    assert_allclose(pg.sel(generator="gas1"), pg.sel(generator="gas2"), atol=1e-4)
    assert (run.data["export_price"].values < -10).all()
    assert_allclose(run.data["reserve_price"], 0, atol=1e-3)
    assert run.data["export_price"].attrs["units"] == "$/h"


def test_the_reserve_of_a_scenario_equals_that_in_python(tmp_path: Path) -> None:
    text = SCENARIO.replace("at_least: 100", "at_least: 111")
    listed = scenario(tmp_path, text)
    plan = listed.problem.solve()
    same = om.MultiStage(listed.network, 2, formulation="dc")
    same.constrain("export", lambda s: s.branch.pf[[0]], at_most=[80, 70])
    same.constrain("reserve", lambda s: reserve(s) >= 111)
    same.constrain("mix", lambda s: s.generator.pg[[1]] - s.generator.pg[[2]] == 0)
    assert plan.status == same.solve().status == "proven_infeasible"  # 200 MW of 90 leave 110
    override = {"constraints.reserve.at_least": 110.0}
    assert scenario(tmp_path, text, overrides=override).problem.solve().optimal


def test_a_number_of_the_network_follows_its_time_series(tmp_path: Path) -> None:
    (tmp_path / "wind.csv").write_text("gas2.p_max\n40\n30\n20\n10\n")
    text = SCENARIO.replace("at_least: 100", "at_least: 90").replace("mix:", "mox:")
    text = text.replace("gas2.pg: -2", "gas2.pg: 0").replace("equal: 0", "at_least: 0")
    text += "profiles: [{table: {file: wind.csv}}]\n"
    plans = [scenario(tmp_path, text).problem.solve(time) for time in (0, 2)]
    assert [plan.status for plan in plans] == ["globally_optimal", "proven_infeasible"]  # 200 - 90, 180 - 90


def test_a_limit_from_a_file(tmp_path: Path) -> None:
    (tmp_path / "limits.csv").write_text("# MW\nhour,export\n0,80\n1,70\n2,60\n3,50\n")
    text = SCENARIO.replace("[80, 70, 60, 50]", "{file: limits.csv, column: export}")
    assert scenario(tmp_path, text).problem.constraints["export"].at_most.tolist() == [80, 70, 60, 50]
    for old, new, message in (
        ("column: export", "column: expert", ":14:32: constraints.export.at_most: .*no column 'expert'"),
        ("limits.csv", "none.csv", "none.csv: no such file"),
        ("file:", "fiel:", r":14:\d+: constraints.export.at_most.(fiel: .*'file'|file: )"),
    ):
        with pytest.raises(ScenarioError, match=message):
            scenario(tmp_path, text.replace(old, new))


def test_limits_over_time_may_be_of_different_lengths(tmp_path: Path) -> None:
    text = SCENARIO.replace(
        "at_most: [80, 70, 60, 50]", "at_least: [0, 0, 0, 0, 0, 0], at_most: [80, 70, 60, 50, 40]"
    )
    export = scenario(tmp_path, text).problem.constraints["export"]
    assert (export.at_least.tolist(), export.at_most.tolist()) == ([0, 0, 0, 0], [80, 70, 60, 50])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("tie.pf", "tei.pf", ":14:20: constraints.export.terms.tei.pf: .*'tei'; did you mean 'tie'"),
        ("tie.pf", "branches.pf", "constraints.export.terms.branches.pf: .*'branches'; did you mean 'branch'"),
        ("tie.pf", "pf", "write kind.quantity"),
        ("tie.pf", "tie.ps", "branch has no quantity 'ps' here; did you mean 'pf' or 'pt'"),
        ("tie.pf", '"t*.vm"', "formulation 'dc' does not publish .*vm; formulations that do: ac, ac-rectangular$"),
        ("tie.pf", "bus.vm", ":14:20: .*formulation 'dc' does not publish bus.vm; formulations that do: ac, ac-"),
        ("tie.pf: 1", "tie.pf: x", ":14:20: constraints.export.terms.tie.pf: 'x': must be a number"),
        ("tie.pf: 1", "tie.pf: .nan", "must be a finite number"),
        ("tie.pf: 1", "coal.p_max: 1", ":14:12: constraints.export.terms: .*fixed data"),
        ("tie.pf: 1", "coal.ramp: 1", "coal.ramp is unlimited"),
        ("tie.pf: 1", "generator.bus: 1", "generator.bus is not a numeric quantity"),
        ("{tie.pf: 1}", "{}", "needs at least one term"),
        ("{tie.pf: 1}", "[tie.pf]", ":14:12: constraints.export.terms: must be a mapping"),
        ("terms: {tie.pf: 1}, ", "", "constraints.export.terms: .*missing"),
        ("[80, 70, 60, 50]", "[80, 70]", ":14:32: constraints.export.at_most: has 2 values; 4 are needed"),
        ("[80, 70, 60, 50]", "[80, a, 1, 1]", ":14:46: constraints.export.at_most.1: 'a': must be a number"),
        ("[80, 70, 60, 50]", "true", "at_most: True: must be a number or a list or a mapping; accepted keys are file, column"),
        (", at_most: [80, 70, 60, 50]", "", "needs a limit: at_least, at_most or equal"),
        ("equal: 0", "equal: 0, at_most: 3", "equal: .*at_most"),
        ("equal: 0", "equals: 0", "equals: unknown key; did you mean 'equal'"),
        ("at_least: 100", "at_least: 100, at_most: [200, 200, 90, 200]", "at_least = 100 is above at_most = 90"),
        ("{terms: {tie.pf: 1}, at_most: [80, 70, 60, 50]}", "3", "must be a mapping; .*terms"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_with_its_place(old: str, new: str, message: str, tmp_path: Path) -> None:
    assert old in SCENARIO
    with pytest.raises(ScenarioError, match=message) as caught:
        scenario(tmp_path, SCENARIO.replace(old, new, 1))
    assert str(caught.value).startswith(str(tmp_path))
    assert "\n" not in str(caught.value)


def test_the_constraints_of_the_page_are_read(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "scenarios.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^    constraints:\n(?:      .*\n)+", page, flags=re.MULTILINE)
    (tmp_path / "contract.csv").write_text("tie\n50\n50\n50\n50\n")
    text = SCENARIO.partition("constraints:")[0] + textwrap.dedent(block)
    constraints = scenario(tmp_path, text).problem.constraints
    assert set(constraints) == {"reserve", "export", "mix", "contract"}
    assert constraints["contract"].at_least.tolist() == [50.0] * 4


@given(
    factors=st.dictionaries(
        st.sampled_from(["generator.pg", "gas*.pg", "coal.pg", "tie.pf", "load.p", "*.pt", "coal.p_max"]),
        st.floats(-1e3, 1e3).map(lambda factor: round(factor, 3)),  # smaller ones spoil the scaling
        min_size=1,
    )
)
@examples(5)
def test_a_linear_total_is_the_sum_of_its_terms(factors: dict[str, float]) -> None:
    grid = two_units()
    grid.add("gas2", om.Generator("south", p=(0, 9), cost=om.Polynomial(0, 5, 0)))
    made = problem("dc", grid=grid)
    made.constrain("own", Linear({"coal.pg": 0.0} | factors), at_least=-1e7)
    plan = made.solve()
    pg = plan.data["pg"].transpose("generator", "time")
    values = {
        "generator.pg": pg.sum("generator").values,
        "gas*.pg": pg.sel(generator=["gas", "gas2"]).sum("generator").values,
        "coal.pg": pg.sel(generator="coal").values,
        "tie.pf": plan.data["pf"].values[:, 0],
        "load.p": np.array(DEMAND["town.p"][:3]),
        "*.pt": plan.data["pt"].values[:, 0],
        "coal.p_max": 120.0,
    }
    expected = sum(factor * values[key] for key, factor in factors.items()) + np.zeros(3)
    rows = plan.solution.program.rows["constraint own"].read(plan.solution.rows)
    assert_allclose(rows[0], expected, atol=1e-6 * (1 + np.abs(expected).max()))


def test_a_linear_constraint_in_python() -> None:
    made = problem("dc")
    made.constrain("export", Linear({"tie.pf": 0.5, "tie.pt": -0.5}), at_most=70)
    assert_allclose(made.solve().data["pf"].values[:, 0], 70, atol=1e-4)
    with pytest.raises(ConstraintError, match="the factor must be a finite number"):
        Linear({"tie.pf": True})
