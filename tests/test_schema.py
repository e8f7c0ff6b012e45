"""The JSON Schemas of scenarios and studies, and what is generated from declarations."""

from __future__ import annotations

import importlib.util
import json
import random
import re
import warnings
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from conftest import DATA, ROOT, SCENARIOS
from fuzz import scenarios as texts
from fuzz.mutate import OPERATORS
from jsonschema import Draft202012Validator
from typer.testing import CliRunner

import opfmodel as om
from opfmodel.cli.app import app
from opfmodel.data.yaml import parse
from opfmodel.errors import OpfmodelError, ScenarioError
from opfmodel.network.components import BUILT_IN
from opfmodel.network.describe import documented
from opfmodel.plugins import plugins
from opfmodel.plugins.catalogue import described
from opfmodel.scenario.reference import scenario_schema, section_keys
from opfmodel.study.managed import ClusterFile
from opfmodel.study.reference import study_schema

PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").glob("*.md")])
BLOCKS = [
    pytest.param(block, id=f"{page.name}-{number}")
    for page in PAGES
    for number, block in enumerate(
        re.findall(r"```yaml\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    )
    if page.name != "extending.md"  # its scenario needs plugins
]
FILES = {"case.m": (DATA / "matpower" / "case9.m").read_text(), "series.csv": texts.SERIES} | {
    "demand.csv": texts.DEMAND,
    "forecast.csv": texts.FORECAST,
}
# What the structure of a file decides, without its network.
STRUCTURAL = re.compile(
    "unknown key|must be (a mapping|a list|text|a number|true or false|a pair)|this key is missing"
    "|has no option|requires the option|unknown field|required for a"
)


@cache
def validator(study: bool = False) -> Draft202012Validator:
    return Draft202012Validator(study_schema() if study else scenario_schema())


def faults(content: Any) -> list[str]:
    """What the schema of a scenario, or of a study, rejects."""
    errors = validator(study=isinstance(content, dict) and "vary" in content).iter_errors(content)
    return [f"{'.'.join(map(str, error.absolute_path))}: {error.message}" for error in errors]


# What is generated --------------------------------------------------------------------------------------


def generated() -> dict[Path, str]:
    """What ``docs/generate.py`` writes."""
    spec = importlib.util.spec_from_file_location("generate", ROOT / "docs" / "generate.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    files: dict[Path, str] = module.generated()
    return files


def test_generated_files_are_current() -> None:
    files = generated()
    assert {path.name for path in files} == {
        *("scenario.schema.json", "study.schema.json", "scenarios.md", "studies.md")
    }
    for path, text in files.items():
        assert path.read_text(encoding="utf-8") == text, f"{path}: run python docs/generate.py"


@pytest.mark.parametrize("kind", BUILT_IN, ids=lambda kind: kind.kind)
def test_the_docstring_of_a_component_describes_its_fields(kind: type[om.network.Component]) -> None:
    stated = described(kind)
    assert stated == {name: item.metadata["description"] for name, item in kind.fields().items()}
    assert all(text.endswith(".") and len(text) > 8 for text in stated.values())


def test_a_docstring_that_describes_parameters_is_left_alone() -> None:
    written = "A thing.\n\n    Parameters\n    ----------\n    p\n        Power.\n"
    assert documented(written, om.Load.fields()) == written
    assert documented(None, om.Load.fields()) is None


def test_every_key_field_and_option_is_described() -> None:
    schema = scenario_schema()
    keys = section_keys(schema, schema["properties"])
    assert {"time.step", "controller.end.price", "network.generators", "published.J_e"} <= set(keys)
    silent = [key for key, value in keys.items() if not value.get("description")]
    for name, part in schema["$defs"].items():
        silent += [f"{name}.{key}" for key, value in part.get("properties", {}).items() if not _text(value)]
    assert not silent


def _text(value: dict[str, Any]) -> bool:
    return bool(value.get("description") or value.get("$ref") or value.get("anyOf") or "const" in value)


# The schemas --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("study", [False, True])
def test_the_schema_is_valid_and_its_references_resolve(study: bool) -> None:
    schema = validator(study).schema
    Draft202012Validator.check_schema(schema)
    assert schema["$schema"].endswith("2020-12/schema")
    text = json.dumps(schema)
    names = set(re.findall(r'"#/\$defs/([\w-]+)', text))
    assert names == set(schema["$defs"])
    assert not re.findall(r'"x-\w+"', text)


@pytest.mark.parametrize("path", sorted(SCENARIOS.rglob("*.yaml")), ids=lambda path: path.stem)
def test_the_files_of_the_repository_validate(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    content, _ = parse(text, str(path))
    assert faults(content) == []
    named = re.search(r"# yaml-language-server: \$schema=(.*)", text)
    assert named is not None
    assert (path.parent / named[1]).resolve() == SCENARIOS / (
        "study.schema.json" if "vary" in content else "scenario.schema.json"
    )


@pytest.mark.parametrize("block", BLOCKS)
def test_the_examples_of_the_documentation_validate(block: str) -> None:
    content, _ = parse(block, "")
    if isinstance(content, dict) and ("network" in content or "vary" in content):
        assert faults(content) == []
    elif isinstance(content, dict) and content.keys() & {"slurm", "ssh"}:
        ClusterFile.model_validate(content)
    else:  # keys of a scenario, or of its network
        assert [] in [faults({"network": {}, **content}), faults({"network": content})]


@pytest.mark.parametrize("text", [texts.DECLARED, texts.FROM_FILE, texts.TINY, texts.STUDY])
def test_scenarios_with_every_section_validate(text: str) -> None:
    assert faults(parse(text, "")[0]) == []


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        ({"network": {"loads": {"town": {"bus": "a", "p": 3, "x": 1}}}}, "network.loads.town.*'x'"),
        ({"network": {"loads": {"town": {"bus": "a"}}}}, "network.loads.town.*'p' is a required"),
        ({"network": {"loads": {"town": {"bus": "a", "p": "3"}}}}, "network.loads.town.p"),
        ({"network": {"loads": {"town": {"bus": "a", "p": [3, 4]}}}}, "network.loads.town.p"),
        ({"network": {"branches": {"l": {"from_bus": "a", "to_bus": "b", "r": 0, "x": 1, "tap": 0}}}}, "l.tap: 0"),
        ({"network": {"storage": {}}}, "network: .*'storage'"),
        ({"network": {}, "time": {"step": "15"}}, "time.step"),
        ({"network": {}, "time": {"steps": 0}}, "time.steps"),
        ({"network": {}, "cost": {"economic": {"wight": 1}}}, "cost"),
        ({"network": {}, "cost": "stored-energy-value"}, "cost"),
        ({"network": {}, "profiles": [{"scale": {}}]}, "profiles.0"),
        ({"network": {}, "plant": {"mode": "redispatch", "participation": {}}}, "plant"),
        ({"network": {}, "controller": {"formulation": "acdc"}}, "controller.formulation"),
        ({"network": {}, "controller": {"objective": []}}, "controller.objective"),
        ({"network": {}, "constraints": {"c": {"at_most": 3}}}, "constraints.c.*'terms'"),
        ({"network": {}, "variants": {"v": {"contoller": {}}}}, "variants.v.*'contoller'"),
        ({"network": {}, "variants": {"v": {"network": {"update": {"x": {"pp": 1}}}}}}, "variants.v.network"),
        ({}, "'network' is a required"),
        ({"vary": {"controller.horizon": [1, 0]}}, "vary.controller.horizon"),
        ({"vary": {"timing": {"a": 3}}}, "vary.timing"),
        ({"vary": {}, "set": {"time.step": []}}, "set.time.step"),
        ({"vary": {}, "scenaro": "x"}, "'scenaro'"),
    ],
)  # fmt: skip
def test_the_schema_rejects(content: Any, fault: str) -> None:
    assert re.search(fault, "\n".join(faults(content)))


@pytest.mark.parametrize(
    "content",
    [
        {"network": {"loads": {"town": {"bus": 3, "p": "2.5 MW", "q": "10% of p"}}, "storages": None}},
        {"network": {"generators": {"old": {"bus": "a", "p": [9, 1], "ramp": -3, "in_service": False}}}},
        {"network": {"update": {"gen*": {"ramp": "10% of p_max"}}, "remove": ["a", 3]}},
        {"network": {}, "variants": {"v": {"forecast": {"noisy": {"seed": 3}}, "plant": {"price": "3 $/MWh"}}}},
        {"network": {}, "variants": {"v": {"network": {"loads": {"town": {"p": 3}}}, "cost": "stored-energy-value"}}},
        {"network": {}, "controller": {"objective": None, "solver": "conic:scs"}},
        {"vary": {"variant": [None, "dc"], "network.loads.town.p": [1, 2], "x": {"a": {"time.step": "15 min"}}}},
    ],
)  # fmt: skip
def test_the_schema_accepts(content: Any) -> None:
    assert faults(content) == []


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the files that the scenarios refer to."""
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    return tmp_path


def refusals(path: Path, text: bytes) -> Iterator[str]:
    """The messages with which a scenario and each of its variants are refused."""
    path.write_bytes(text)
    names: list[str | None] = [None]
    for name in names:
        try:
            with warnings.catch_warnings(action="ignore"):
                scenario = om.load_scenario(path, name)
        except OpfmodelError as error:
            yield str(error)
            return
        if name is None:
            names += scenario.settings.variants


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("text", [texts.DECLARED, texts.FROM_FILE], ids=["declared", "from-file"])
def test_schema_and_reader_agree_on_structure(text: str, seed: int, folder: Path) -> None:
    """Whatever the schema rejects is refused, and whatever is refused for its structure it rejects."""
    rng = random.Random(f"{seed} {text}")
    counts = {True: 0, False: 0}
    for _ in range(60):
        changed = OPERATORS[rng.choice(("yaml value", "yaml value", "yaml key"))](rng, text.encode())
        try:
            content, _ = parse(changed.decode(), "")  # type: ignore[union-attr]
        except (OpfmodelError, UnicodeError):
            continue
        if isinstance(content, dict) and ("network" not in content and "scenario" in content):
            continue  # a study
        rejected = faults(content)
        messages = list(refusals(folder / "s.yaml", changed))  # type: ignore[arg-type]
        assert messages or not rejected, (rejected, changed)
        counts[bool(messages)] += 1
        # of patterns the schema does not know the kind, and of variants not what they are laid over
        if messages and STRUCTURAL.search(messages[0]) and "network.update" not in messages[0]:
            assert rejected or "variants" in messages[0] or _of_variant(folder / "s.yaml"), (
                messages,
                changed,
            )
    assert min(counts.values()) >= 1


def _of_variant(path: Path) -> bool:
    """Whether a scenario itself is read, so that a variant is refused."""
    try:
        with warnings.catch_warnings(action="ignore"):
            om.load_scenario(path)
    except OpfmodelError:
        return False
    return True


# The reader, where the schema found it too lax ----------------------------------------------------------


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("network.loads", [], "network.loads: .*must be a mapping"),
        ("network.remove", "town", "network.remove: 'town': must be a list"),
        ("network.default_cost", "dear", "network.default_cost: 'dear': must be a number"),
        ("network.lossy", "yes", "network.lossy: 'yes': must be true or false"),
        ("profiles", [{"scale": {"factor": "1.06"}}], "factor = '1.06': must be a number"),
        ("profiles", [{"scale": {"factor": True}}], "factor = True: must be a number"),
        ("plant", {"mode": "redispatch", "price": "90"}, "price = '90': must be a number"),
        ("controller.objective", {"setpoint-tracking": {"setpoints": {"unit.pg": [1, True]}}}, "unit.pg.*number"),
        ("network.loads.town.p", "10% of p", "network.loads.town.p: '10% of p': is a share of itself"),
    ],
)  # fmt: skip
def test_values_of_the_wrong_type_are_refused(key: str, value: Any, message: str, folder: Path) -> None:
    (folder / "tiny.yaml").write_text(texts.TINY.replace("profiles: [{table: {file: demand.csv}}]\n", ""))
    om.load_scenario(folder / "tiny.yaml")
    with pytest.raises(ScenarioError, match=message):
        om.load_scenario(folder / "tiny.yaml", overrides={key: value})


# The command --------------------------------------------------------------------------------------------


def test_the_command_prints_the_schemas() -> None:
    for arguments, schema in ((["schema"], scenario_schema()), (["schema", "--study"], study_schema())):
        assert json.loads(CliRunner().invoke(app, arguments).stdout) == schema
        (line,) = CliRunner().invoke(app, [*arguments, "--json"]).stdout.splitlines()
        assert json.loads(line) == schema


def test_plugins_of_others_are_known_unless_they_are_left_out() -> None:
    names = {plugin.name for plugin in plugins("objective").values() if plugin.origin == "opfmodel"}
    schema = scenario_schema({"opfmodel"})
    assert {
        name.removeprefix("objective-") for name in schema["$defs"] if name.startswith("objective-")
    } == names
