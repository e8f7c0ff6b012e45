"""Messages: every fault of a file at once, each with its position, an excerpt and the nearest name."""

from __future__ import annotations

import json
import pickle
import re
import unicodedata
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from conftest import Call, examples
from hypothesis import given
from hypothesis import strategies as st

import opfmodel as om
from opfmodel.cli.inspect import validate
from opfmodel.data.source import Source
from opfmodel.data.yaml import parse
from opfmodel.errors import MOST_FAULTS, Fault, OpfmodelError, ProfileWarning, ScenarioError, nearest
from opfmodel.study import read_study

WHOLE = """\
description: a scenario with every section
network:
  base_mva: 50
  buses:
    north: {vm: [0.95, 1.05], reference: true}
    south: {base_kv: 110}
    harbour: {}
  branches:
    line: {from_bus: north, to_bus: south, r: 0.01, x: 0.1, rating: 80, angle: [-30, 30]}
    cable: {from_bus: south, to_bus: harbour, r: 0.01, x: 0.05}
  generators:
    coal: {bus: north, p: [0, 90], q: [-50, 50], ramp: 40% of p_max, cost: {c2: 0.01, c1: 20}}
    peaker: {bus: south, p: [0, 40], cost: {points: [[0, 0], [20, 800], [40, 2000]]}}
  storages:
    cell*: {bus: "*", energy: 20, power: [-5, 5], charge_efficiency: 0.9}
  loads:
    town: {bus: south, p: 50, q: 10}
    mill: {bus: harbour, p: 12}
  shunts:
    capacitor: {bus: harbour, b: 4}
  update:
    cellnorth: {rating: 6}
  remove: [cellsouth]
time: {step: 0.5, steps: 3}
profiles:
  - scale: {factor: 1.1}
  - power-factor: {value: 0.95, loads: [town]}
  - step: {loads: [mill], first: 1, last: 2, add: 3}
  - noise: {deviation: 0.02, correlation: 0.5, seed: 1}
  - table: {file: series.csv}
cost:
  - {economic: {reactive_weight: 0.01}, weight: 2}
  - voltage-deviation
controller:
  horizon: 2
  formulation: ac
  objective: {setpoint-tracking: {setpoints: {coal.pg: 40, cellnorth.e: 8}, state_weight: 1}}
  initial_dispatch: free
  end: {cyclic: false, minimum: 0.2, price: 10}
  on_infeasible: elastic
  solver: {name: ipopt, options: {max_iter: 200}}
forecast: {noisy: {deviation: 0.03, seed: 7, fields: [p, q]}}
plant: {mode: redispatch, price: 50, shedding_price: 5000}
constraints:
  reserve: {terms: {generator.p_max: 1, generator.pg: -1}, at_least: 5}
  mix: {terms: {coal.pg: 0.4, peaker.pg: -0.6}, at_most: [50, 50, 50, 50]}
variants:
  linear: {controller: {formulation: dc, objective: economic, solver: auto}}
"""
SERIES = "town.p,coal.p_max,line.rating\n" + "50,80,inf\n55,90,60\n" * 2

# A fault by the text in which it is planted, the text with it, and a part of its message. Each text occurs
# once, and the fault is where it begins.
PLANTS = (
    ("vm: [0.95, 1.05]", "vmm: [0.95, 1.05]", "did you mean 'vm'"),
    ("base_kv: 110", "base_kv: high", "'high': must be"),
    ("harbour: {}", "harbour: 7", "7: must be a mapping"),
    ("to_bus: south", "to_bus: soth", "did you mean 'south'"),
    ("rating: 80", "rating: -80", "-80: must be at least 0"),
    ("angle: [-30", "angle: [60", "the minimum 60 is above"),
    ("bus: north, p", "bus: nort, p", "did you mean 'north'"),
    ("ramp: 40% of p_max", "ramp: 40% of p_mx", "did you mean 'p_max'"),
    ("cost: {c2: 0.01", "cost: {c2: -1", "must be convex"),
    ("bus: harbour, p: 12", "bus: harbor, p: 12", "did you mean 'harbour'"),
    ("power: [-5", "pwer: [-5", "did you mean 'power'"),
    ("charge_efficiency: 0.9", "charge_efficiency: 9", "must be at most 1"),
    ("cellnorth: {rating", "celnorth: {rating", "did you mean 'cellnorth'"),
    ("cellsouth]", "celsouth]", "did you mean 'cellsouth'"),
    ("step: 0.5", "step: -1", "must be at least"),
    ("steps: 3", "steps: 3.5", "must be an integer"),
    ("factor: 1.1", "factr: 1.1", "did you mean 'factor'"),
    ("town]", "twon]", "did you mean 'town'"),
    ("first: 1", "first: soon", "'soon': must be an integer"),
    ("noise: {dev", "nose: {dev", "did you mean 'noise'"),
    ("economic: {", "econmic: {", "did you mean 'economic'"),
    ("weight: 2", "weight: -2", "weight = -2"),
    ("voltage-deviation", "voltage-deviatoin", "did you mean 'voltage-deviation'"),
    ("horizon: 2", "horizn: 2", "did you mean 'horizon'"),
    ("formulation: ac", "formulation: acc", "did you mean 'ac'"),
    ("coal.pg: 40", "cual.pg: 40", "did you mean 'coal'"),
    ("cellnorth.e: 8", "cellnorth.ee: 8", "'cellnorth.ee'"),
    ("state_weight: 1", "state_wait: 1", "did you mean 'state_weight'"),
    ("initial_dispatch: free", "initial_dispatch: fre", "'free' or 'single-stage'"),
    ("minimum: 0.2", "minimum: 2", "must be at most 1"),
    ("name: ipopt", "nme: ipopt", "did you mean 'name'"),
    ("seed: 7", "sead: 7", "did you mean 'seed'"),
    ("mode: redispatch", "mode: redispach", "did you mean 'redispatch'"),
    ("generator.p_max: 1", "generator.p_mux: 1", "did you mean 'p_max'"),
    ("peaker.pg: -0.6", "peeker.pg: -0.6", "did you mean 'peaker'"),
    ("at_least: 5", "at_lest: 5", "did you mean 'at_least'"),
    ("variants:", "extra: 1\nvariants:", "unknown key"),
)  # fmt: skip


def written(folder: Path, text: str = WHOLE) -> Path:
    """Write a scenario and the table it refers to."""
    (folder / "series.csv").write_text(SERIES)
    path = folder / "scenario.yaml"
    path.write_text(text)
    return path


def refused(path: Path, **arguments: Any) -> tuple[Fault, ...]:
    """Return the faults for which a scenario is refused."""
    with pytest.raises(ScenarioError) as caught:
        om.load_scenario(path, **arguments)
    assert str(caught.value).splitlines() == [str(fault) for fault in caught.value.faults]
    return caught.value.faults


def position(text: str, part: str) -> tuple[int, int]:
    """Line and column of the only occurrence of a part of a text."""
    at = text.index(part)
    assert text.count(part) == 1, part
    return text.count("\n", 0, at) + 1, at - text.rfind("\n", 0, at)


def test_the_scenario_without_faults_is_valid(tmp_path: Path) -> None:
    assert validate(written(tmp_path)) == 0


@given(plants=st.sets(st.sampled_from(PLANTS), min_size=1, max_size=12))
@examples(15)
def test_every_planted_fault_is_reported_where_it_is_and_nothing_else(
    plants: set[tuple[str, str, str]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    text = WHOLE
    for old, new, _ in plants:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    faults = refused(written(tmp_path_factory.mktemp("planted"), text))
    planted = sorted((*position(text, new), message) for _, new, message in plants)
    assert [(fault.line, fault.column) for fault in faults] == [(line, column) for line, column, _ in planted]
    for fault, (_, _, message) in zip(faults, planted, strict=True):
        assert message in fault.message


# Nearest names --------------------------------------------------------------------------------------

# What is not looked up: text, names of files, and names that are declared.
FREE = re.compile(
    r"description|network\.(buses|branches|generators|storages|loads|shunts)\.[^.]*|constraints\.[^.]*"
    r"|profiles\.\d+\.table\.file|.*solver\.options.*|variants.*"
)


def names(content: Any, path: str = "") -> Iterator[tuple[Any, Any, str, str, bool]]:
    """Yield every name in nested data: its container and key, its path, the name, and whether it is a key."""
    for key, value in list(content.items() if isinstance(content, dict) else enumerate(content)):
        inner = f"{path}.{key}".lstrip(".")
        if isinstance(content, dict) and not FREE.fullmatch(inner):
            yield content, key, inner, key, True
        if isinstance(value, str) and value != "*" and not FREE.fullmatch(inner):
            yield content, key, inner, value, False
        if isinstance(value, dict | list):
            yield from names(value, inner)


NAMES = [(path, is_key) for _, _, path, _, is_key in names(parse(WHOLE, "")[0])]


@pytest.mark.parametrize(("path", "is_key"), NAMES)
def test_a_misspelt_name_is_answered_with_the_right_one(path: str, is_key: bool, tmp_path: Path) -> None:
    content, _ = parse(WHOLE, "")
    found = ((c, k, name) for c, k, at, name, of_key in names(content) if (at, of_key) == (path, is_key))
    container, key, name = next(found)
    letters = [number for number, letter in enumerate(name) if letter.isalpha()]
    at = letters[len(letters) // 2]
    wrong = name[:at] + "z" + name[at + 1 :]
    if is_key:
        renamed = {wrong if k == key else k: v for k, v in container.items()}
        container.clear()
        container.update(renamed)
    else:
        container[key] = wrong
    faults = refused(written(tmp_path, json.dumps(content)))
    (fault,) = faults
    for part, right in zip(re.split("[. ]", wrong), re.split("[. ]", name), strict=True):
        assert part == right or re.search(rf"(?<![\w-]){re.escape(right)}(?![\w-])", fault.message), fault


def test_the_nearest_of_many_names_is_found_quickly() -> None:
    known = [f"bus{number}" for number in range(100_000)]
    assert "'bus12345'" in nearest("bsu12345", known)
    assert "'bus12345'" in nearest("bus1234x5", known)
    assert nearest("pq", ["pg", "e"]) == "did you mean 'pg'?"


# What follows from a fault is not reported ----------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "messages"),
    [
        ("  generators:", "  genrators:", ["genrators"]),
        ("  buses:", "  busses:", ["busses"]),
        ("base_mva: 50", "file: none.m", ["none.m: no such file"]),
        ("time: {step: 0.5, steps: 3}", "tiem: {step: 0.5, steps: 3}", ["tiem"]),
        ("network:", "netwrk:", ["netwrk"]),
        ("horizon: 2", "horizon: [2]", ["horizon"]),
        ("controller:", "controler:", ["controler"]),
        ("cost:\n  - {eco", "cost:\n  - 5\n  - {eco", ["cost.0: 5"]),
        ("profiles:\n", "profiles:\n  - 5\n  - 6\n", ["profiles.0: 5", "profiles.1: 6"]),
        ("    north: {vm: [0.95, 1.05], reference: true}", "    north: {vm: 3}", ["north.vm"]),
        ("town: {bus: south, p: 50, q: 10}", "town: {bus: south, q: 10}", ["town.p: required"]),
        ("reactive_weight: 0.01", "reactive_weight: .nan", ["reactive_weight: nan"]),
        ("steps: 3", "steps: 3, steps: 4", ["duplicate key 'steps'"]),
        ("p: [0, 90]", "p: [!x 0, 90]", ["the tag '!x'"]),
        ("rating: 80", "rating: [80", None),
    ],
)  # fmt: skip
def test_no_fault_follows_from_another(
    old: str, new: str, messages: list[str] | None, tmp_path: Path
) -> None:
    with warnings.catch_warnings(action="error"):
        faults = refused(written(tmp_path, WHOLE.replace(old, new, 1)))
    if messages is None:
        assert [("not YAML" in fault.message) for fault in faults] == [True]
        return
    assert len(faults) == len(messages), faults
    for fault, message in zip(faults, messages, strict=True):
        assert message in str(fault)


def test_faults_of_a_variant_are_reported_with_those_of_the_file(tmp_path: Path) -> None:
    text = WHOLE.replace("horizon: 2", "horizn: 2").replace("formulation: dc,", "formulation: dcc,")
    with pytest.raises(ScenarioError) as caught:
        validate(written(tmp_path, text))
    one, other = map(str, caught.value.faults)
    assert "controller.horizn" in one
    assert re.search(r"controller.formulation: .*'dcc'.* \(variant 'linear'\)", other)


def test_faults_are_limited_in_number(tmp_path: Path) -> None:
    loads = "".join(f"    l{number}: {{bus: nowhere, p: 1}}\n" for number in range(2 * MOST_FAULTS))
    faults = refused(written(tmp_path, WHOLE.replace("  loads:\n", "  loads:\n" + loads)))
    assert len(faults) == MOST_FAULTS + 1
    assert faults[-1].message == f"more than {MOST_FAULTS} errors; the rest is not checked"


def test_an_error_is_pickled_with_its_faults(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError) as caught:
        om.load_scenario(written(tmp_path, WHOLE.replace("horizon: 2", "horizn: 2\n  horizn2: 3")))
    twin = pickle.loads(pickle.dumps(caught.value))
    assert (twin.faults, str(twin)) == (caught.value.faults, str(caught.value))


# Excerpts -------------------------------------------------------------------------------------------


def cells(text: str) -> list[str]:
    """The character of each column of a terminal."""
    made: list[str] = []
    for letter in text:
        if unicodedata.combining(letter):
            made[-1] += letter
        else:
            made += [letter, ""][: 2 if unicodedata.east_asian_width(letter) in "WF" else 1]
    return made


@given(data=st.data())
def test_the_caret_is_below_the_column(data: st.DataObject) -> None:
    letters = st.sampled_from("abc: {}[]\t電圧éü\x1b\u202e")
    line = data.draw(st.text(letters, min_size=1, max_size=300).filter(str.strip))
    at = data.draw(st.integers(0, len(line) - 1))
    excerpt = Source("f", f"first\n{line}\nlast").excerpt(2, at + 1)
    shown, caret = excerpt.split("\n")
    assert (shown[:8], caret[:8]) == ("    2 | ", "      | ")
    assert shown.isprintable()
    assert len(cells(shown)) <= 8 + 100 + 2 * len("...")
    letter = line[at]
    below = "".join(cells(shown)[caret.index("^") :])
    if letter in " \t":
        assert below[:1] in ("", " ")
    else:
        assert below.startswith(letter if letter.isprintable() else "\\")


def test_a_line_of_many_megabytes_is_cut() -> None:
    text = "x" * 5_000_000 + "!" + "y" * 5_000_000
    shown, caret = Source("f", text).excerpt(1, 5_000_001).split("\n")
    assert len(shown) < 120
    assert shown[caret.index("^")] == "!"


# YAML's own errors ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "where", "words"),
    [
        ("a:\n\tb: 2\n", "2:1", "a tab indents"),
        ("a: 1\n\tb: 2\n", "2:1", "a tab indents"),
        ("a:\n  b:1\n  c: 2\n", "2:5", "a space is missing after the colon in 'b:1'"),
        ("- a:1\n  b: 2\n", "1:5", "a space is missing after the colon in 'a:1'"),
        ("a: 1\nb: 2\na: 3\n", "3:1", "duplicate key 'a'; the first is in line 1"),
        ("a: 'b\nc: 2\n", "1:4", "quotation mark opened here is not closed"),
        ('a: 1\nb: "c\n', "2:4", "quotation mark opened here is not closed"),
        ("a: 'it's'\n", "1:8", "behind a closing quotation mark"),
        ("a: [1, 2\nb: 3\n", "1:4", "'[' opened here is not closed by ']'"),
        ("a: {b: 1\n", "1:4", "'{' opened here is not closed by '}'"),
        ("a: [1, 2}\n", "1:9", "expected ',' or ']'"),
        ("a: {b: 1}}\n", "1:10", "'}' closes no bracket"),
        ("a:\n    b: 1\n  c: 2\n", "3:3", "begins in another column"),
        ("a: 1\n  b: 2\n", "2:3", "indented further than the one above"),
        ("- a\nb: 1\n", "2:1", "expected an item '- '"),
        ("a: 1\n- b\n", "2:1", "an item '- ' where a key is expected"),
        ("a: b: c\n", "1:5", "a second ': ' on one line"),
        ("a: @b\n", "1:4", "a value cannot begin with '@'; put it in quotes"),
        ("a: 1\nb\nc: 2\n", "2:1", "a key without ': '"),
        ('a: "\\q"\n', "1:5", "a backslash with 'q' has no meaning"),
        ("a: *\n", "1:4", "'*' is not followed by a name"),
        ("a: - b\n", "1:4", "an item '- ' begins behind other text"),
        ("a: ]\n", "1:4", "a value cannot begin with ']'"),
    ],
)  # fmt: skip
def test_what_is_not_yaml_is_explained(text: str, where: str, words: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        parse(text, "f")
    (fault,) = caught.value.faults
    assert f"{fault.line}:{fault.column}" == where
    assert words in fault.message
    assert fault.excerpt


def test_every_fault_that_leaves_the_text_readable_is_reported() -> None:
    with pytest.raises(ScenarioError) as caught:
        parse(f"a: 1\na: 2\nb: !t 3\nc: *d\ne: {2**64}\nf: [g", "f")
    assert [fault.line for fault in caught.value.faults] == [2, 3, 4, 5, 6]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("horizon: 2\n", "horizon:2\n"),
        ("{cyclic: false, ", "{cyclic:false, "),
        ("town: {bus: south, p: 50, q: 10}", "town: {bus:south, p: 50, q: 10}"),
        ("  update:\n    cellnorth: {rating: 6}", "  update:\n    cellnorth:rating"),
    ],
)
def test_a_missing_space_is_suspected(old: str, new: str, tmp_path: Path) -> None:
    (first, *_) = refused(written(tmp_path, WHOLE.replace(old, new, 1)))
    assert "a space is missing after the colon" in first.message


# Columns of files -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("heading", "message"),
    [
        ("twon.p", "no component 'twon'; did you mean 'town'"),
        ("town.pp", "no number 'pp'; did you mean 'p'"),
        ("line.r", "the r of a branch is constant"),
        ("coal.in_service", "is constant"),
        ("peaker.c1", "the cost of 'peaker' is piecewise linear"),
    ],
)  # fmt: skip
def test_all_columns_of_a_table_are_checked(heading: str, message: str, tmp_path: Path) -> None:
    path = written(tmp_path)
    (tmp_path / "series.csv").write_text(f"town.p,{heading},nobody.q\n" + "50,1,1\n" * 4)
    one, other = refused(path)
    assert re.search(f"series.csv: column '{heading}': .*{re.escape(message)}", one.message)
    assert "column 'nobody.q'" in other.message
    assert one.line == other.line == position(WHOLE, "table: {file")[0]


@pytest.mark.parametrize("command", ["scenario", "study"])
def test_the_columns_of_a_forecast_are_checked_before_a_run(command: str, tmp_path: Path) -> None:
    forecast = "forecast: {file: {file: ahead.csv}}"
    text = re.sub("forecast: .*", forecast, WHOLE)
    (tmp_path / "ahead.csv").write_text("twon.p,town.p\n" + "50,50\n" * 4)
    path = written(tmp_path, text)
    (fault,) = refused(path)
    assert re.search("column 'twon.p': .* did you mean 'town.p'", fault.message)
    assert (fault.line, fault.column) == position(text, forecast)
    if command == "study":
        (tmp_path / "study.yaml").write_text("scenario: scenario.yaml\nvary: {time.step: [1, 2]}\n")
        with pytest.raises(ScenarioError, match=r"study.yaml:1:1: scenario: .*scenario.yaml:.*'twon.p'"):
            read_study(tmp_path / "study.yaml")


def test_the_columns_of_set_points_are_checked(tmp_path: Path) -> None:
    text = WHOLE.replace("{coal.pg: 40, cellnorth.e: 8}", "{file: points.csv}")
    (tmp_path / "points.csv").write_text("coal.pg,col.pg,coal.ps\n" + "50,50,1\n" * 4)
    one, other = refused(written(tmp_path, text))
    assert "did you mean 'coal'" in one.message
    assert "'coal.ps': no such storage" in other.message


# Options, studies, warnings -------------------------------------------------------------------------


def test_the_command_line_prints_each_fault_with_an_excerpt(tmp_path: Path, call: Call) -> None:
    text = WHOLE.replace("horizon: 2", "horizn: 2").replace("bus: north, p", "bus: nort, p")
    path = written(tmp_path, text)
    code, out, err = call("validate", path, "--json")
    assert code == 2
    faults = refused(path)
    expected = [line for fault in faults for line in (f"error: {fault}", *fault.excerpt.splitlines())]
    assert err.splitlines() == expected
    assert len(expected) == 6
    printed = json.loads(out)
    assert printed["error"] == "\n".join(map(str, faults))
    assert printed["faults"][1] == {
        "file": str(path),
        "line": position(text, "horizn")[0],
        "column": 3,
        "key": "controller.horizn",
        "message": "unknown key; did you mean 'horizon'?",
    }


def test_the_command_line_prints_twenty_faults(tmp_path: Path, call: Call) -> None:
    loads = "".join(f"    l{number}: {{bus: nowhere, p: 1}}\n" for number in range(25))
    path = written(tmp_path, WHOLE.replace("  loads:\n", "  loads:\n" + loads))
    code, out, err = call("solve", path, "--json")
    assert (code, err.count("nowhere'"), len(json.loads(out)["faults"])) == (2, 20, 25)
    assert err.splitlines()[-1] == "error: and 5 more"


def test_an_error_of_another_kind_has_one_fault_without_a_position(call: Call) -> None:
    code, out, err = call("solve", "none.m", "--json")
    (fault,) = json.loads(out)["faults"]
    assert (code, fault["line"], fault["message"]) == (2, None, json.loads(out)["error"])
    assert err == f"error: {fault['message']}\n"


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("controller.horizon=abc", "controller.horizon: 'abc': must be an integer"),
        ("controller={horizon: abc}", "controller.horizon: 'abc': must be an integer"),
        ("time.steps=90", "series.csv: 4 rows; 91 are needed"),
    ],
)
def test_a_value_of_an_option_is_blamed_on_the_option(
    option: str, message: str, tmp_path: Path, call: Call
) -> None:
    path = written(tmp_path, WHOLE.replace("weight: 2", "weight: -2"))
    code, _, err = call("validate", path, "--set", "time.step=1", "--set", option)
    first, _, _, second, line, caret = err.splitlines()[:6]
    assert code == 2
    assert first.startswith(f"error: {path}:{position(WHOLE, 'weight: 2')[0]}:")
    assert second.startswith(f"error: --set {option}: ")
    assert message in second
    assert line == f"  --set {option}"
    assert line[: caret.index("^")].endswith(("=", "{"))


def test_overrides_in_python_are_cited_as_such(tmp_path: Path) -> None:
    path = written(tmp_path)
    (fault,) = refused(path, overrides={"controller.horizon": "abc"})
    assert str(fault).startswith(f"{path}: overrides: controller.horizon: 'abc': must be an integer")
    (fault,) = refused(path, overrides={"controller": {"horizn": 3}})
    assert (fault.line, fault.key) == (None, ("controller", "horizn"))


def test_all_points_of_a_study_are_checked(tmp_path: Path) -> None:
    written(tmp_path)
    lines = [
        "scenario: scenario.yaml",
        "set: {time.stps: 3}",
        "vary:",
        "  controller.horizon: [1, 0, many]",
        "  plan:",
        "    usual: {}",
        "    other: {controller.formulation: dcc, cost: econmic}",
    ]
    (tmp_path / "study.yaml").write_text("\n".join(lines))
    with pytest.raises(ScenarioError) as caught:
        read_study(tmp_path / "study.yaml")
    found = [(fault.line, fault.dotted_key, fault.message) for fault in caught.value.faults]
    assert [line for line, _, _ in found] == [2, 4, 4, 7, 7]
    assert found[0][1:] == ("set", "time.stps: unknown key; did you mean 'steps' or 'step'?")
    assert found[1][1:] == ("vary.controller.horizon.1", "controller.horizon: 0: must be at least 1")
    assert "'dcc'" in found[3][2] + found[4][2]
    assert all(fault.excerpt.splitlines()[0].endswith(lines[fault.line - 1]) for fault in caught.value.faults)


def test_a_warning_has_a_position(tmp_path: Path) -> None:
    text = WHOLE.replace("first: 1, last: 2", "first: 8, last: 9")
    line, column = position(text, "step: {loads")
    path = written(tmp_path, text)
    with pytest.warns(ProfileWarning, match=re.escape(f"{path}:{line}:{column}: profiles.2.step: ")):
        om.load_scenario(path)


def test_errors_in_python_carry_the_others() -> None:
    grid = om.Network()
    with pytest.raises(OpfmodelError, match="vmm") as caught:
        om.Bus.from_mapping("a", {"vmm": 1, "base_kv": "high"})
    assert [error.field for error in (caught.value, *caught.value.others)] == ["vmm", "base_kv"]
    grid.bus = om.Bus()
    for name in ("one", "two"):
        grid.add(name, om.Load("nowhere", p=1))
    with pytest.raises(OpfmodelError, match=r"^one: bus = 'nowhere'") as caught:
        om.MultiStage(grid)
    assert [str(error)[:3] for error in caught.value.others] == ["two"]
