"""Scenario files: their meaning, and errors with line and column."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import DATA, SCENARIOS
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

import opfmodel as om
from opfmodel.errors import OpfmodelError, ProfileWarning, ScenarioError
from opfmodel.network import arrays
from opfmodel.network.arrays import per_unit
from opfmodel.network.network import name_pattern
from opfmodel.objectives.base import WeightedSum
from opfmodel.scenario import declarations
from opfmodel.scenario.schema import ScenarioFile

CASE5 = (SCENARIOS / "case5-step.yaml").read_text()
MINIMAL = "network:\n  buses: {a: {}}\n  generators: {g: {bus: a, p: [0, 9]}}\n"


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "scenario.yaml"
    path.write_text(text)
    return path


def test_a_scenario_is_read(tmp_path: Path) -> None:
    scenario = om.load_scenario(SCENARIOS / "case5-step.yaml")
    assert repr(scenario.network).startswith(
        "Network('case5-step': 5 buses, 6 branches, 4 generators, 5 storages"
    )
    assert scenario.network.gen5.ramp == pytest.approx(60)
    assert list(scenario.network.of(om.Storage)) == ["cell1", "cell2", "cell3", "cell4", "cell5"]
    demand = scenario.profiles.series["load4", "p"]
    assert demand.size == 96
    assert demand[[0, 7, 8, 15, 16, 30, 40, 41]] == pytest.approx([424, 424, 474, 474, 424, 374, 374, 424])
    reactive = scenario.profiles.series["load4", "q"]
    assert reactive / demand == pytest.approx(np.full(96, 131.47 / 400))


def by_dsl() -> om.Network:
    grid = om.Network("case5-step")
    for number in range(1, 6):
        grid.add(str(number), om.Bus(vm=(0.9, 1.1), reference=number == 4))
    for f, t, r, x, b, rating in (
        (1, 2, 0.00281, 0.0281, 0.00712, 400),
        (1, 4, 0.00304, 0.0304, 0.00658, None),
        (1, 5, 0.00064, 0.0064, 0.03126, None),
        (2, 3, 0.00108, 0.0108, 0.01852, None),
        (3, 4, 0.00297, 0.0297, 0.00674, None),
        (4, 5, 0.00297, 0.0297, 0.00674, 240),
    ):
        grid.add(f"{f}-{t}", om.Branch(str(f), str(t), r=r, x=x, b=b, rating=rating))
    for bus, p, q, c2, c1 in ((1, 210, 157.5, 10, 15), (3, 520, 390, 11, 30), (4, 200, 150, 12, 40), (5, 600, 450, 13, 10)):  # fmt: skip
        cost = om.Polynomial(c2 / 100**2, c1, 0)
        grid.add(f"gen{bus}", om.Generator(str(bus), p=(0, p), q=(-q, q), ramp=0.1 * p, cost=cost))
    for bus, p, q in ((2, 300, 98.61), (3, 300, 98.61), (4, 400, 131.47)):
        grid.add(f"load{bus}", om.Load(str(bus), p=p, q=q))
    for bus in range(1, 6):
        grid.add(f"cell{bus}", om.Storage(str(bus), energy=200, power=10, q=10))
    return grid


def test_a_grid_from_python_yaml_or_a_file_has_the_same_optimum(tmp_path: Path) -> None:
    declared = by_dsl()
    om.write_network(declared, tmp_path / "case.m")
    from_file = om.load_scenario(
        write(
            tmp_path,
            "network: {file: case.m, update: {'gen*': {ramp: 10% of p_max}}}\ncontroller: {horizon: 12}",
        )
    ).network
    from_yaml = om.load_scenario(SCENARIOS / "case5-step.yaml").network
    optima = [om.MultiStage(n, 12).solve().objective for n in (declared, from_yaml, from_file)]
    assert optima[1] == pytest.approx(optima[0], rel=1e-8)
    assert optima[2] == pytest.approx(optima[0], rel=1e-8)


def test_an_absent_limit_can_have_a_series(tmp_path: Path) -> None:
    (tmp_path / "limits.csv").write_text("g.ramp\n5\n3\n")
    text = MINIMAL + "time: {steps: 2}\nprofiles: [{table: {file: limits.csv}}]\n"
    assert om.load_scenario(write(tmp_path, text)).profiles.series["g", "ramp"].tolist() == [5, 3]


def test_a_minimal_scenario(tmp_path: Path) -> None:
    scenario = om.load_scenario(write(tmp_path, MINIMAL))
    assert (scenario.name, scenario.steps) == ("scenario", 1)
    assert scenario.simulate().status == "done"


def test_a_network_file_can_be_changed(tmp_path: Path) -> None:
    text = f"""
network:
  file: {DATA / "matpower" / "case9.m"}
  storages: {{cell*: {{bus: "*", energy: 20, power: 5}}}}
  update: {{"gen*": {{ramp: 50% of p_max}}, gen1: {{p: [10, 200]}}}}
  remove: [load5]
"""
    network = om.load_scenario(write(tmp_path, text)).network
    assert len(network.of(om.Storage)) == 9
    assert (network.gen1.ramp, network.gen2.ramp, network.gen1.p) == (125, 150, (10, 200))
    assert "load5" not in network


def test_overrides_and_variants(tmp_path: Path) -> None:
    text = MINIMAL + "controller: {horizon: 3}\nvariants:\n  long: {controller: {horizon: 9}}\n"
    path = write(tmp_path, text)
    assert om.load_scenario(path).settings.controller.horizon == 3
    assert om.load_scenario(path, "long").settings.controller.horizon == 9
    assert om.load_scenario(path, "long").name == "scenario:long"
    assert om.load_scenario(path, overrides={"controller.horizon": 5}).settings.controller.horizon == 5
    with pytest.raises(ScenarioError, match=r"variants: no variant 'lon'; did you mean 'long'\?"):
        om.load_scenario(path, "lon")


def test_objectives_in_a_list_may_be_plain_names(tmp_path: Path) -> None:
    text = MINIMAL + "cost: [economic, {voltage-deviation: {}, weight: 2}]\n"
    made = om.load_scenario(write(tmp_path, text)).cost
    assert isinstance(made, WeightedSum)
    assert [weight for weight, _ in made.parts] == [1, 2]


def test_an_error_in_a_variant_is_located(tmp_path: Path) -> None:
    path = write(tmp_path, MINIMAL + "variants:\n  long: {controller: {horizn: 9}}\n")
    with pytest.raises(ScenarioError, match=r":5:23: controller.horizn: unknown key"):
        om.load_scenario(path, "long")


def test_series_from_a_table(tmp_path: Path) -> None:
    (tmp_path / "demand.csv").write_text("# source\nhour,l.p,g.p_max\n0,1,9\n1,2,8\n2,3,7\n")
    text = (
        MINIMAL + "  loads: {l: {bus: a, p: 5}}\ntime: {steps: 3}\nprofiles: [{table: {file: demand.csv}}]\n"
    )
    series = om.load_scenario(write(tmp_path, text)).profiles.series
    assert series["l", "p"].tolist() == [1, 2, 3]
    assert series["g", "p_max"].tolist() == [9, 8, 7]
    for wrong, message in (
        ("hour,l.p\n0,1\n", "1 rows; 3 are needed"),
        ("hour,x.p\n0,1\n0,1\n0,1\n", "the network has no component 'x'"),
        ("hour,l.x\n0,1\n0,1\n0,1\n", "a load has no number 'x'"),
        ("hour,l.p\n0,1\n0,one\n0,1\n", "line 3, column 'l.p': 'one' is not a number"),
        ("hour,l.p\n0,1\n0,nan\n0,1\n", "line 3, column 'l.p': 'nan' is not a number"),
        ("hour,g.p\n0,1\n0,1\n0,1\n", "a generator has no number 'p'; it has p_min and p_max"),
        ("hour,g.cost\n0,1\n0,1\n0,1\n", "a generator has no number 'cost'"),
        ("hour,g.bus\n0,1\n0,1\n0,1\n", "the bus of a generator is constant"),
        (
            "hour,g.pmax\n0,1\n0,1\n0,1\n",
            "demand.csv: column 'g.pmax': a generator has .*did you mean 'p_max'",
        ),
        (
            "hour,a.p\n0,1\n0,1\n0,1\n",
            "demand.csv: column 'a.p': a bus has no number 'p'; available: .*vm_max",
        ),
        ("hour;l.p\n0;1\n0;1\n0;1\n", "demand.csv: .*'0;1' is not a number.*separated by ';'"),
        ("hour;load\n0;1\n0;1\n0;1\n", "demand.csv: no column .* separated by ';'"),
        ("hour;l.p\n0;1,5\n0;1,5\n0;1,5\n", "line 2: 2 cells for 1 headings.* separated by ';'"),
        ("hour,ll.p\n0,1\n0,1\n0,1\n", "no component 'll'"),
        ("", "the file is empty"),
        ("hour,l.p,l.p\n0,1,2\n0,1,2\n0,1,2\n", "line 1: duplicate column 'l.p'"),
        ("hour,load\n0,1\n0,1\n0,1\n", "no column is named 'component.field'.* columns are: hour, load"),
        ("hour,l.p\n0,1\n0,1,5\n0,1\n", "line 3: 3 cells for 2 headings"),
        (
            "#\nhour,g.p_max\n0,1\n0,1\n0,-4\n",
            r"demand.csv: line 5, column 'g.p_max': .* step 2: -4: must be at least p_min = 0",
        ),
    ):
        (tmp_path / "demand.csv").write_text(wrong)
        with pytest.raises(ScenarioError, match=message):
            om.load_scenario(write(tmp_path, text))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("horizon: 48", "horizn: 48", r":48:3: controller.horizn: unknown key; did you mean 'horizon'\?"),
        ("horizon: 48", "horizon: many", ":48:3: controller.horizon: 'many': must be an integer"),
        ("horizon: 48", "horizon: 0", ":48:3: controller.horizon: 0: must be at least 1"),
        ("horizon: 48", "horizon: 4.5", ":48:3: controller.horizon: 4.5: must be an integer"),
        ("horizon: 48", "generator_delay: 3", ":50:3: .*not YAML: found duplicate key .* line 48"),
        ("network:", "netwrk:", r"netwrk: unknown key; did you mean 'network'\?|network: this key is missing"),
        ("ramp: 10% of p_max", "rmap: 5", r":25:53: network.generators.gen1.rmap: 5: unknown field of a generator; did"),
        ("ramp: 10% of p_max", "ramp: 10% of pmax", r":25:53: .*'10% of pmax': a generator has no number 'pmax'"),
        ("p: [0, 210]", "p: [10, 2]", r":25:20: .*gen1.p: \(10, 2\): the minimum 10 is above the maximum 2"),
        ("p: [0, 210]", "p: 210", r":25:20: .*gen1.p: 210: must be a pair"),
        ("bus: 3, p: [0, 520]", "bus: 33, p: [0, 520]", r":26:12: .*gen3.bus: '33': no such bus"),
        ('bus: "*"', 'bus: "9"', r":34:13: network.storages.cell\*.bus: '9': no such bus"),
        ("cell*:", "cell:", r"cell.bus: '\*': .*must contain one \*"),
        ("r: 0.00281, x: 0.0281", "r: 0, x: 0", r":18:5: network.branches.1-2.*impedance must be at least"),
        ("{bus: 2, p: 300", "{bus: 2, p: .nan", ":30:21: network.loads.load2.p: nan: must be a finite number"),
        ("cost: {c2: 0.0010, c1: 15}", "cost: {c2: -1}", ":25:73: .*must be convex"),
        ("cost: {c2: 0.0010, c1: 15}", "cost: 15", r"gen1.cost: 15: must be a Polynomial .* in a file \{c2"),
        ("  buses:\n", "  busses:\n", r":11:3: network.busses: unknown key; did you mean 'buses'"),
        ("first: 8", "first: 20", ":40:5: profiles.1.step: a step needs 0 <= first <= last"),
        ("loads: [load4], first: 8", "loads: [load9], first: 8", "no load is named 'load9'; did you mean 'load"),
        ("- scale:", "- scael:", ":39:5: profiles.0.scael: there is no profile rule 'scael'; did you mean 'scale'"),
        ("factor: 1.06", "factr: 1.06", ":39:13: profiles.0.scale.factr: profile rule 'scale' has no option 'factr'"),
        ("factor: 1.06", "factor: big", ":39:13: profiles.0.scale.factor: .*'big': must be a number"),
        ("economic:", "economics:", ":45:3: cost.economics: there is no objective 'economics'; did you mean"),
        ("reactive_weight:", "reactive_wait:", ":45:14: .*has no option 'reactive_wait'; did you mean"),
        ("formulation: ac", "formulation: acc", ":49:3: controller.formulation: there is no formulation 'acc'"),
        ("formulation: ac", "solver: nosuch", ":49:3: controller.solver: .*'nosuch'; available: .*ipopt"),
        ("formulation: ac", "solver: {nam: x}", ":49:12: controller.solver.nam: unknown key; did you mean 'name'"),
        ("base_mva: 100", "base_mva: -1", ":10:3: network.base_mva: .*base_mva = -1.0: must be a number from 1e-06 to"),
        ("base_mva: 100", "file: nofile.m", ":10:3: network.file: .*nofile.m: no such file"),
        ("ramp: 10% of p_max, cost: {c2: 0.0010", "ramp: 1.2.3% of p_max, cost: {c2: 0.0010", ":25:.*gen1.ramp: '1.2.3% of p_max': must be a number"),
        ("10% of p_max, cost: {c2: 0.0010", "10% of q, cost: {c2: 0.0010", ":25:.*gen1.ramp: .* no number 'q'; it has q_min and q_max"),
        ("10% of p_max, cost: {c2: 0.0010", "10% of bus, cost: {c2: 0.0010", ":25:.*gen1.ramp: .* a generator has no number 'bus'"),
        ("ramp: 10% of p_max", "ramp: 10% of ramp", r":25:53: .*gen1.ramp: '10% of ramp': is a share of itself"),
        ("ramp: 10% of p_max", f"ramp: {400 * '1'}% of p_max", r":25:53: .*gen1.ramp: '1+\.\.\.: is inf; must be a finite number"),
        ("base_mva: 100", "base_mva: 100\n  update: {'gn*': {ramp: 5}}", r":11:12: network.update.gn\*: no component matches; available"),
        ("base_mva: 100", "base_mva: 100\n  update: {gn1: {ramp: 5}}", r":11:12: network.update.gn1: no such component; did you mean 'gen1'"),
        ("base_mva: 100", "base_mva: 100\n  remove: [cell1, load44]", r":11:19: network.remove.1: .*'load44'; did you mean 'load4'"),
        ("controller:", "controller.formulation: dc\ncontroller:", r":47:1: controller.formulation: unknown key; nest it: controller: {formulation: \.\.\.}"),
        ("base_mva: 100", "file: a.m\n  default_cost: dear", ":11:3: network.default_cost: 'dear': must be a number"),
        ("base_mva: 100", "file: a.m\n  lossy: 1", ":11:3: network.lossy: 1: must be true or false"),
        ("factor: 1.06", "factor: -1", ":39:5: profiles.0.scale: scale: factor = -1.0: must be at least 0"),
        ("factor: 1.06", "factor: .nan", ":39:13: profiles.0.scale.factor: nan: must be a finite number"),
        ("factor: 1.06", "factor: .inf", ":39:13: profiles.0.scale.factor: .*finite number"),
        ("factor: 1.06", "factor: 1e400", ":39:13: profiles.0.scale.factor: .*finite number"),
        ("factor: 1.06", "factor: 1e31", ":39:13: profiles.0.scale.factor: 1e.31: .*at most 1e.30"),
        ("factor: 1.06", "factor: 1e29", ":39:5: profiles.0.scale: profile 'load2.p': step 0: 3e.31: must be a finite number"),
        ("base_mva: 100", "base_mva: 1e308", ":10:3: network.base_mva: 1e.308: must be a finite number of at most"),
        ("base_mva: 100", "base_mva: 1e-300", ":10:3: network.base_mva: .* 1e-300: must be a number from 1e-06 to"),
        ("base_mva: 100", "name: [a]", r":10:3: network.name: must be text"),
        ("step: 1.0", "step: 0", ":36:8: time.step: 0: must be at least"),
        ("step: 1.0", "step: 1e300", ":36:8: time.step: 1e.300: must be a finite number of at most"),
        ("step: 1.0", "step: .inf", ":36:8: time.step: inf: must be a finite number"),
        ("r: 0.00281, x: 0.0281", "r: 0, x: 1e-200", r":18:5: network.branches.1-2.*impedance must be at least"),
        ("cost: {c2: 0.0010, c1: 15}", "cost: {c1: .inf}", ":25:73: .*finite numbers"),
        ("cost: {c2: 0.0010, c1: 15}", "cost: {points: [[0, 0], [1.0e-320, 1]]}", ":25:73: .*slopes must be at most"),
        ("formulation: ac", "regularisation: .inf", ":49:3: controller.regularisation: inf: must be a finite number"),
        ("formulation: ac", "end: {price: .inf}", ":49:9: controller.end.price: inf: must be a finite number"),
        ("formulation: ac", "objective: [{economic: {}, weight: .inf}]", ":49:30: controller.objective.0.weight: weight = inf: must be a finite number"),
        ("time: {", "time: !!python/object:os.system {", ":36:7: time: the tag .* is not accepted"),
        ("  buses:", "  buses: [", "not YAML"),
        ("name: case5-step", "name: a\nname: b", "not YAML: found duplicate key"),
    ],
)  # fmt: skip
def test_errors_are_located(old: str, new: str, message: str, tmp_path: Path) -> None:
    assert old in CASE5
    path = write(tmp_path, CASE5.replace(old, new, 1))
    with pytest.raises(ScenarioError, match=message) as caught:
        om.load_scenario(path)
    faults = sorted(map(str, caught.value.faults), key=lambda fault: not re.search(message, fault))
    assert all(fault.startswith(str(path)) for fault in faults)
    assert all("no such file" in other for other in faults[1:])
    assert sorted(faults) == sorted(str(caught.value).splitlines())


def test_a_step_beyond_the_series_is_a_warning(tmp_path: Path) -> None:
    text = (
        MINIMAL
        + "  loads: {l: {bus: a, p: 5}}\nprofiles: [{step: {loads: [l], first: 4, last: 5, add: 1}}]\n"
    )
    with pytest.warns(ProfileWarning, match="first = 4: .* 1 values"):
        om.load_scenario(write(tmp_path, text))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "a scenario is a mapping"),
        ("- 1\n- 2\n", "a scenario is a mapping"),
        ("network: 3\n", "network: 3: must be a mapping"),
        (
            MINIMAL + "controller: {end: cyclic}\n",
            r"controller.end: 'cyclic': must be a mapping; .* cyclic, minimum",
        ),
        (MINIMAL + "time: 3\n", "time: 3: must be a mapping; .* step, steps"),
        (MINIMAL + "plant: 3\n", "plant: 3: must be a mapping; .* mode"),
        (MINIMAL + "plant: redispach\n", ":4:1: plant.mode: .*'redispach'; did you mean 'redispatch'"),
        (MINIMAL + "name: ../x\n", r":4:1: name: '../x': .*contain / or"),
        (MINIMAL + "name: ..\n", ":4:1: name: '..': must not be empty"),
        (MINIMAL + "variants: {a/b: {}}\n", ":4:12: variants.a/b: 'a/b': .*contain / or"),
        (MINIMAL + 'name: "a\\e[1m"\n', ":4:1: name: 'a.x1b.1m': .*visible"),
        (MINIMAL + 'variants: {"a\\n": {}}\n', ":4:12: .*'a.n'.*visible"),
        (MINIMAL + '  loads: {"a\\u202e": {bus: a, p: 1}}\n', ":4:11: .*'a.u202e'.*visible"),
        (MINIMAL + 'constraints: {"a\\0": {terms: {g.pg: 1}, at_least: 0}}\n', ":4:15: .*'a.x00'.*visible"),
        (MINIMAL + "constraints: {a/b: {terms: {g.pg: 1}, at_least: 0}}\n", ":4:15: constraints.a/b: .*'/'"),
        (MINIMAL + 'constraints: {"": {terms: {g.pg: 1}, at_least: 0}}\n', ":4:15: .*empty"),
        (
            MINIMAL.replace("[0, 9]", "[0, 9], ramp: 1")
            + "constraints: {pg_ramp: {terms: {g.pg: 1}, at_least: 0}}\n",
            ":4:15: constraints.pg_ramp: .*'pg_ramp_price'",
        ),
        ("scenario: a.yaml\nvary: {}\n", ":2:1: vary: .*'opfmodel study run'"),
        ("network: {}\n", "has no bus in service"),
        ("network: {buses: [a, b]}\n", "must be a mapping from names to fields"),
        ("network: {buses: {a: 3}}\n", "must be a mapping from fields to values"),
        (MINIMAL + "cost: [1]\n", r":4:8: cost.0: 1: must be text or a mapping"),
        (
            MINIMAL + "controller: {solver: 1}\n",
            "controller.solver: 1: must be text or a mapping; .* name, options",
        ),
        (MINIMAL + "forecast: {persistence: {fields: p}}\n", r":4:26: .*fields = 'p': must be a list"),
        (
            MINIMAL + "forecast: {noisy: {deviation: 0.1, seed: 1, fields: [pmax]}}\n",
            ":4:12: .*'pmax'.*'p_max'",
        ),
        (MINIMAL + "cost: []\n", "needs at least one objective"),
        (MINIMAL + "profiles: [{a: 1, b: 2}]\n", "one name with its options, not 2 keys"),
        (MINIMAL + "a: &a [1,1]\nb: &b [*a,*a]\n", "unknown key"),
        (MINIMAL + f"variants: {{x: {500 * '['}{500 * ']'}}}\n", "nested too deeply"),
        (
            MINIMAL + "plant: {mode: redispatch, shedding_price: .inf}\n",
            ":.:27: plant.shedding_price: .* inf: must be a finite number",
        ),
    ],
)
def test_odd_documents(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=message):
        om.load_scenario(write(tmp_path, text))


@pytest.mark.parametrize("key", ["cost", "profiles", "controller.objective"])
def test_of_many_invalid_entries_only_the_first_is_examined(key: str) -> None:
    content: Any = {"network": {}, "controller": {}}
    section, _, last = key.rpartition(".")
    (content[section] if section else content)[last] = [200.5] * 1000
    with pytest.raises(ValidationError) as caught:
        ScenarioFile.model_validate(content)
    assert caught.value.error_count() <= 4  # one per branch of the types


def test_literal_names_are_updated_without_a_search(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    searched = []

    def counted(name: str) -> Any:
        searched.append(name)
        return name_pattern(name)

    monkeypatch.setattr(declarations, "name_pattern", counted)
    text = MINIMAL + "  update: {a: {vm: [0.8, 1]}, 'g*': {ramp: 4}}\n"
    network = om.load_scenario(write(tmp_path, text)).network
    assert (network.a.vm, network.g.ramp) == ((0.8, 1), 4)
    assert searched == ["g*"]


def test_an_unreadable_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="no such file"):
        om.load_scenario(tmp_path / "none.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ScenarioError, match="not UTF-8 text"):
        om.load_scenario(tmp_path / "binary.yaml")


@given(data=st.data())
@settings(max_examples=60)
def test_a_damaged_file_gives_an_error_of_opfmodel_or_a_valid_scenario(
    data: st.DataObject, tmp_path_factory
) -> None:
    lines = CASE5.splitlines(keepends=True)
    number = data.draw(st.integers(6, len(lines) - 1))
    line = lines[number]
    at = data.draw(st.integers(0, max(len(line) - 1, 0)))
    junk = data.draw(
        st.sampled_from(["", "x", "-", ":", "[", "{", "1e9", "null", "'", "\t", "&a", "*b", "!t "])
    )
    lines[number] = line[:at] + junk + line[at + 1 :]
    path = tmp_path_factory.mktemp("damaged") / "scenario.yaml"
    path.write_text("".join(lines))
    try:
        om.load_scenario(path)
    except OpfmodelError as error:
        assert str(path.name) in str(error)


def test_random_demand_does_not_depend_on_the_horizon() -> None:
    short, long = (
        om.load_scenario(SCENARIOS / "case5-random.yaml", overrides={"controller.horizon": horizon})
        for horizon in (2, 48)
    )
    for key, values in short.profiles.series.items():
        assert long.profiles.series[key][: len(values)] == pytest.approx(values, rel=1e-12), key


@pytest.mark.parametrize("variant", [None, "setpoint-tracking"])
def test_loading_builds_the_network_and_the_problem_once(
    monkeypatch: pytest.MonkeyPatch, variant: str | None
) -> None:
    made = {"arrays": 0, "problems": 0}

    def counted(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            made[name] += 1
            return function(*args, **kwargs)

        return call

    monkeypatch.setattr(arrays, "PerUnitNetwork", counted("arrays", arrays.PerUnitNetwork))
    monkeypatch.setattr(om.MultiStage, "__init__", counted("problems", om.MultiStage.__init__))
    scenario = om.load_scenario(SCENARIOS / "case5-step.yaml", variant)
    assert made == {"arrays": 1, "problems": 1}
    assert scenario.problem is scenario.problem


def test_arrays_are_rebuilt_when_the_network_changes() -> None:
    scenario = om.load_scenario(SCENARIOS / "case5-step.yaml")
    network, before = scenario.network, per_unit(scenario.network)
    assert per_unit(network) is before
    name = next(iter(network.of(om.Load)))
    network.update(name, p=7.0)
    after = per_unit(network)
    assert after.load.p[after.load.position[name], 0] * after.base_mva == pytest.approx(7.0)
    with pytest.raises(ValueError, match="read-only"):
        after.load.p[0] = 1.0


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({"energy": "400% of power_max", "power": 5}, 20),  # of a required field
        ({"energy": 10, "power": 5, "energy_min": "20% of energy"}, 10),
        ({"energy": "50% of power_max", "power": "50% of energy"}, "energy: '50% of power_max': is a share of a share"),
        ({"energy": 10, "power": 5, "energy_min": "1% of energy", "initial": "9% of energy_min"}, "initial: .*of a share"),
        ({"energy": "400% of power_max", "power": "x"}, "power: 'x': must be a pair"),
        ({"energy": "400% of power_max", "power": 1, "energy_min": 5}, "energy_min: 5: must be at most energy = 4"),
        ({"energy": "400% of pwer", "power": 1}, "energy: '400% of pwer': a storage has no number 'pwer'"),
    ],
)  # fmt: skip
def test_a_share_of_a_required_field_and_of_other_shares(fields, expected, tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(
        "network: {buses: {a: {}}, generators: {g: {bus: a, p: [0, 9], cost: {c1: 1}}}}\n"
        "controller: {formulation: copperplate}\n"
    )
    overrides = {"network.storages": {"cell": {"bus": "a", **fields}}}
    if isinstance(expected, str):
        with pytest.raises(ScenarioError, match=expected) as caught:
            om.load_scenario(tmp_path / "s.yaml", overrides=overrides)
        assert "required for a" not in str(caught.value)
    else:
        assert om.load_scenario(tmp_path / "s.yaml", overrides=overrides).network["cell"].energy == expected
