"""Mutated scenario files are either accepted or rejected with one line for each fault."""

from __future__ import annotations

import json
import random
import warnings
from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
from conftest import DATA

from opfmodel.data.yaml import parse
from opfmodel.errors import MOST_FAULTS, Fault, OpfmodelError
from opfmodel.scenario import load_scenario

SEED = 20261124
NUMBER = 100  # mutations per scenario and kind of change

DECLARED = """\
name: declared
description: every section of a scenario
network:
  base_mva: 50
  buses: {a: {vm: [0.95, 1.05], reference: true}, b: {base_kv: 110}, 3: {}}
  branches:
    line: {from_bus: a, to_bus: b, r: 0.01, x: 0.1, b: 0.02, rating: 80, tap: 0.98, shift: 2, angle: [-30, 30]}
    cable: {from_bus: b, to_bus: 3, r: 0.01, x: 0.05}
  generators:
    coal: {bus: a, p: [0, 90], q: [-50, 50], ramp: 40% of p_max, cost: {c2: 0.01, c1: 20, c0: 5}}
    peaker: {bus: b, p: [0, 40], cost: {points: [[0, 0], [20, 800], [40, 2000]]}}
  storages: {cell*: {bus: "*", energy: 20, power: [-5, 5], q: 2, initial: 8, charge_efficiency: 0.9, standing_loss: 0.001}}
  loads: {town: {bus: b, p: 50, q: 10}, mill: {bus: 3, p: 12}}
  shunts: {capacitor: {bus: 3, b: 4}}
  update: {"cell*": {rating: 6}}
  remove: [cell3]
time: {step: 0.5, steps: 3}
profiles:
  - scale: {factor: 1.1, loads: [town]}
  - step: {loads: [mill], first: 1, last: 2, add: 3}
  - noise: {deviation: 0.02, correlation: 0.5, seed: 1}
  - power-factor: {value: 0.95}
  - table: {file: series.csv}
  - shape: {file: series.csv, column: curve}
cost: [{economic: {reactive_weight: 0.01}, weight: 2}, voltage-deviation]
controller:
  horizon: 2
  formulation: ac
  objective: {setpoint-tracking: {setpoints: {coal.pg: 40, cella.e: [8, 9, 10, 11]}, state_weight: 1}}
  generator_delay: 1
  initial_dispatch: free
  end: {cyclic: false, minimum: 0.2, price: 10}
  regularisation: 0.001
  on_infeasible: elastic
  solver: {name: ipopt, options: {max_iter: 200}}
forecast: {noisy: {deviation: 0.03, seed: 7, fields: [p, q]}}
plant: {mode: redispatch, price: 50, shedding_price: 5000}
constraints:
  reserve: {terms: {generator.p_max: 1, generator.pg: -1}, at_least: 5}
  mix: {terms: {"c*.pg": 0.4, peaker.pg: -0.6}, at_most: [50, 50, 50, 50]}
  contract: {terms: {line.pf: 1}, at_most: {file: series.csv, column: limit}}
published: {source: nobody, J_e: 1000.0}
variants:
  dc: {controller: {formulation: dc, objective: economic, solver: auto}}
"""
FROM_FILE = """\
network:
  file: case.m
  default_cost: 30
  update: {"gen*": {ramp: 50% of p_max}, gen1: {p: [10, 200]}}
  storages: &cells {cell*: {bus: "*", energy: 20, power: 5}}
time: &time {steps: 4}
profiles: [table: {file: demand.csv}]
cost: economic
controller: {horizon: 3, formulation: dc-losses, objective: [economic, {linear-quadratic: {Q: {pg: 1.0}, r: {ps: 0.5}}}]}
forecast: {file: {file: forecast.csv}}
plant: {mode: power-flow, participation: {gen1: 1, gen2: 2}}
variants:
  short: {time: {<<: *time, step: 0.25}, forecast: persistence}
  blind: {forecast: persistence, controller: {objective: loss-minimisation}}
"""
SERIES = "curve,limit,town.p,coal.p_max,line.rating\n" + "1,70,50,80,inf\n2,70,55,90,60\n" * 3
DEMAND = "# MW\nload5.p,load5.q\n" + "90,30\n95,31\n" * 4
FORECAST = "issued,load5.p\n" + "0,91\n" * 8 + "2,92\n" * 8
SCENARIOS = {"declared": DECLARED, "from-file": FROM_FILE}

# Replacements of values, as YAML.
VALUES = (
    *("null", "true", "false", "0", "1", "2", "-1", "3.5", "-0.5", "0.25", "100", "1000000", "1_000"),
    *("1e308", "-1e308", "1e-308", "1e31", "1e29", "5e-324", "1e400", ".inf", "-.inf", ".nan", "0x10", "012", "1000000000"),
    *("9223372036854775807", "-9223372036854775808", "99999999999999999999", "1" * 400, "1" * 5000),
    *('""', '" "', "a", "b", "coal", "line", "town", '"*"', '"**"', '"c*"', "on", "2019-07-22", "12:30:45", "2019-07-22T10:00:00Z"),
    *('"\\0"', '"a\\0b"', '"\\e[31m"', '"a\\nb"', '"\\u202e"', '"\\x85"', f'"{"x" * 5000}"', '"[/red]"', '"%s{}"', '"../x"'),
    *("10% of p_max", "1e400% of p_max", "50% of bus", "300% of energy", "single-stage", "none.csv", "/dev/zero", "/", "series.csv"),
    *("[]", "{}", "[[]]", "[{}]", "[null]", "[1]", "[1, 2]", "[2, 1]", "[1, 2, 3]", "[.inf, -.inf]", "[.nan, .nan]", "[a, b]"),
    *("[1e308, 1e308]", "[[0, 0], [1, 1]]", "[[1, 2], [1, 3]]", "[[0, 0], [5e-324, 1]]", "{a: 1}", "{a: {b: {c: 1}}}", "{1: 2}"),
    *("{file: series.csv}", "{file: none.csv}", "{file: /dev/zero}", "{file: series.csv, column: curve}", "{file: series.csv, column: x}"),
    *("{c2: -1}", "{c1: 1e308}", "{points: [[0, 0]]}", "{points: 3}", "{points: [1, 2]}", "{c3: 1}", "{name: osqp}", "{mode: nominal}"),
    *("!!omap [a: 1]", "!!set {a}", "!!binary aGVsbG8=", "!!python/object:os.system {}", "!t 1", "{[a]: 1}", "{{a: 1}: 1}", "{? a}"),
    *("*none", "&a [*a]", "&x {<<: *x}", "{<<: 3}", "{<<: {a: 1}}", "[" * 60 + "]" * 60, "[" * 3000, "{a: " * 3000, '"'),
    *("economic", "loss-minimisation", "state-of-charge-tracking", "stored-energy-value", "{stored-energy-value: {price: 1}}"),
    *("ac", "dc", "soc", "copperplate", "lindistflow", "perfect", "persistence", "noisy", "{file: {file: series.csv}}"),
    *("power-flow", "redispatch", "nominal", "elastic", "stop", "auto", "ipopt", "conic", "qp:highs", "gurobi"),
)  # fmt: skip
KEYS = (
    *("a", "coal", "line", "network", "controller", "variants", "file", "name", "bus", "p", "weight", "terms", "options", "<<"),
    *("", " ", "a.b", "controller.horizon", "*", "x" * 5000, "a/b", "..", "1", "é", "\x1b[1m", "\n", "\u2028", "__class__", "self"),
)  # fmt: skip
TEXTS = (
    *("\t", "\n", " ", "  ", ":", ": ", "-", "- ", "[", "]", "{", "}", ",", "#", "&a ", "*a", "!", "!!map ", "|\n", ">\n", "'", '"'),
    *("%YAML 1.1\n---\n", "\n%YAML 1.2\n---\n", "\n---\n", "\n...\n", "%TAG ! tag:x:\n---\n", "? ", "<<: ", "@", "`", "\\", "~", "\r"),
    *("\x00", "\x1b", "\x7f", "\x85", "\ufeff", "\u2028", "\ud800", "\U0001f600", "9" * 30, "e999", "1e400", "[" * 100, "{" * 2000),
)  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the files that the scenarios refer to."""
    (tmp_path / "case.m").write_text((DATA / "matpower" / "case9.m").read_text())
    for name, text in (("series", SERIES), ("demand", DEMAND), ("forecast", FORECAST)):
        (tmp_path / f"{name}.csv").write_text(text)
    return tmp_path


def places(content: Any) -> Iterator[tuple[Any, Any]]:
    """Yield every container in nested data with each of its keys."""
    for key, value in list(content.items() if isinstance(content, dict) else enumerate(content)):
        yield content, key
        if isinstance(value, dict | list):
            yield from places(value)


def changed_value(rng: random.Random, text: str) -> str:
    """Replace one or two values, by an odd one or by another value of the scenario."""
    content, _ = parse(text, "")
    for _ in range(rng.choice((1, 1, 1, 2))):
        parent, key = rng.choice(list(places(content)))
        other, there = rng.choice(list(places(content)))
        parent[key] = rng.choice((deepcopy(other[there]), f"@{rng.randrange(len(VALUES))}@"))
    return dumped(content)


def changed_key(rng: random.Random, text: str) -> str:
    """Rename, remove, add or move a key of the scenario."""
    content, _ = parse(text, "")
    parent, key = rng.choice([place for place in places(content) if isinstance(place[0], dict)])
    known = [k for place, k in places(content) if isinstance(place, dict)]
    sort = rng.choice(("rename", "remove", "add", "move"))
    value = deepcopy(parent[key])
    if sort == "add":
        parent[rng.choice((*KEYS, *known))] = rng.choice((value, f"@{rng.randrange(len(VALUES))}@"))
    elif sort == "rename":
        renamed = {rng.choice((*KEYS, *known)) if k == key else k: v for k, v in parent.items()}
        parent.clear()
        parent.update(renamed)
    else:
        del parent[key]
    if sort == "move":
        rng.choice([content, *(place for place, _ in places(content) if isinstance(place, dict))])[key] = (
            value
        )
    return dumped(content)


def dumped(content: Any) -> str:
    """Return the content as JSON, which is YAML, with placeholders replaced by odd values."""
    text = json.dumps(content, ensure_ascii=False)
    for number, value in enumerate(VALUES):
        text = text.replace(f'"@{number}@"', value)
    return text


def changed_text(rng: random.Random, text: str) -> str:
    """Change characters or lines of the scenario."""
    for _ in range(rng.choice((1, 1, 2, 5))):
        at = rng.randrange(len(text))
        sort = rng.randrange(6)
        if sort == 0:
            text = text[:at] + text[at + rng.choice((1, 1, 5, 40)) :]
        elif sort in (1, 2):
            text = text[:at] + rng.choice(TEXTS) + text[at + (sort == 2) :]
        elif sort == 3:
            text = text[:at] + rng.choice(VALUES) + text[at + 1 :]
        else:
            lines = text.splitlines(keepends=True)
            one, other = rng.randrange(len(lines)), rng.randrange(len(lines))
            if sort == 4:
                lines.insert(one, lines[other])
            else:
                lines[one], lines[other] = lines[other], lines[one]
            text = "".join(lines)
        if not text:
            break
    return text or "\n"


CHANGES = {"values": changed_value, "keys": changed_key, "text": changed_text}


def outcome(path: Path, text: str) -> tuple[Fault, ...]:
    """Return the faults for which a text is rejected; none if it is accepted."""
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            scenario = load_scenario(path)
            for variant in scenario.settings.variants:
                load_scenario(path, variant)
    except OpfmodelError as error:
        return error.faults
    return ()


@pytest.mark.parametrize("name", SCENARIOS)
def test_unmodified_scenarios_are_accepted(name: str, folder: Path) -> None:
    assert outcome(folder / "s.yaml", SCENARIOS[name]) == ()
    assert outcome(folder / "s.yaml", dumped(parse(SCENARIOS[name], "")[0])) == ()


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("name", SCENARIOS)
def test_mutations_are_accepted_or_rejected_fault_by_fault(name: str, change: str, folder: Path) -> None:
    rng = random.Random(f"{SEED} {name} {change}")
    refused = 0
    for number in range(NUMBER):
        text = CHANGES[change](rng, SCENARIOS[name])
        try:
            faults = outcome(folder / "s.yaml", text)
        except Exception as error:
            raise AssertionError(f"mutation {number}: {type(error).__name__}: {error}\n{text}") from error
        for fault in faults:
            message = str(fault)
            assert message.splitlines() == [message], (number, message)
            assert "nput should be" not in message, (number, message)  # the words of a library
            assert len(message) < 20_000, (number, message[:500])
            assert len(fault.excerpt.splitlines()) in (0, 2), (number, fault.excerpt)
            assert fault.excerpt.replace("\n", "").isprintable(), (number, fault.excerpt)
        assert len(set(faults)) == len(faults) < MOST_FAULTS, (number, faults)
        refused += bool(faults)
    assert NUMBER / 4 < refused < NUMBER  # some mutations are accepted, many rejected
