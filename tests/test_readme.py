"""The code of the documentation runs, and its tables match the code."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from dataclasses import MISSING, Field
from pathlib import Path
from typing import Any, get_args

import pytest
from conftest import ROOT, SCENARIOS
from pydantic import BaseModel
from pydantic.fields import FieldInfo

import opfmodel as om
from opfmodel.network import Component
from opfmodel.network.components import BUILT_IN
from opfmodel.plugins.catalogue import catalogue
from opfmodel.scenario.declarations import Declarations
from opfmodel.scenario.schema import ScenarioFile

PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").glob("*.md")])


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p, "python")], ids=lambda p: p.name)
def test_python_of_a_page_runs(page: Path, capsys: pytest.CaptureFixture[str]) -> None:
    namespace: dict[str, object] = {}
    for block in blocks(page, "python"):
        exec(compile(block, str(page), "exec"), namespace)
    if page.name == "README.md":
        printed = capsys.readouterr().out
        assert "locally_optimal" in printed
        assert "24 steps, done" in printed
        assert len(blocks(page, "python")[0].strip().splitlines()) <= 15


def test_the_closed_loops_of_the_readme_cost_what_it_states(tmp_path: Path) -> None:
    readme = ROOT / "README.md"
    (tmp_path / "two-bus.yaml").write_text(blocks(readme, "yaml")[0])
    stated = re.findall(
        r"opfmodel run two-bus\.yaml.*# .*?([\d,]+\.\d\d) \$", readme.read_text(encoding="utf-8")
    )
    for variant, cost in zip((None, "dc"), stated, strict=True):
        run = om.load_scenario(tmp_path / "two-bus.yaml", variant).simulate()
        assert run.status == "done", variant
        assert run.cost == pytest.approx(float(cost.replace(",", "")), rel=1e-5), variant


def test_the_page_on_architecture_lists_the_folders() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| `(\w[\w/]*)/` \|", page, flags=re.MULTILINE)
    packages = [
        init.parent for name in ("opfmodel", "solvers") for init in (ROOT / name).rglob("__init__.py")
    ]
    assert sorted([*listed, "opfmodel"]) == sorted(p.relative_to(ROOT).as_posix() for p in packages)


def test_the_example_of_the_scenario_page_is_a_scenario(tmp_path: Path) -> None:
    (tmp_path / "my-case.m").write_text((ROOT / "tests/data/matpower/case5.m").read_text())
    block, _ = blocks(ROOT / "docs" / "scenarios.md", "yaml")
    (tmp_path / "s.yaml").write_text(block)
    scenario = om.load_scenario(tmp_path / "s.yaml")
    assert scenario.network["cella"].energy == 20
    assert scenario.network["gen1"].ramp == pytest.approx(4)


def test_the_full_scenario_of_the_page_and_its_variants_run(tmp_path: Path) -> None:
    _, block = blocks(ROOT / "docs" / "scenarios.md", "yaml")
    (tmp_path / "s.yaml").write_text(block)
    for variant in (None, *om.load_scenario(tmp_path / "s.yaml").settings.variants):
        run = om.load_scenario(tmp_path / "s.yaml", variant, {"time.steps": 2}).simulate()
        assert run.status == "done", variant


def fields_of_components() -> str:
    """The table of the scenario page, from the classes."""
    lines = ["| field | unit | default | series | meaning |", "| --- | --- | --- | --- | --- |"]
    for kind in BUILT_IN:
        meanings = meanings_of(kind)
        lines.append(f"| **`{kind.plural}`** | | | | |")
        for name, item in kind.fields().items():
            rules = item.metadata
            series = {
                "number": f"`{name}`",
                "span": f"`{name}_min`, `{name}_max`",
                "cost": "`c2`, `c1`, `c0`",
            }.get(rules["form"] if rules.get("series", True) else "", "")
            unit = {"bus": "name", "flag": "", "cost": "$/h"}.get(rules["form"], rules["unit"])
            lines.append(f"| `{name}` | {unit} | {default_of(item)} | {series} | {meanings[name]} |")
    return "\n".join(lines) + "\n"


def meanings_of(kind: type[Component]) -> dict[str, str]:
    """What the documentation of a class says about each of its parameters, in one line."""
    text = inspect.getdoc(kind) or ""
    parameters = text.partition("Parameters\n----------\n")[2]
    found = {"in_service": "false leaves it out"}
    for names, meaning in re.findall(r"^(\w[\w, ]*)\n((?:    .*\n?)+)", parameters, flags=re.MULTILINE):
        plain = " ".join(meaning.split()).replace("``", "`").replace("None", "none")
        plain = plain if plain.endswith("p.u.") else plain.removesuffix(".")
        plain = re.sub(r":class:`(\w+)`", r"\1", plain)
        found |= dict.fromkeys(names.split(", "), plain)
    return found


def default_of(item: Field[Any]) -> str:
    if item.default is MISSING:
        return "required"
    if isinstance(item.default, om.Polynomial):
        return "`{c2: 0, c1: 0, c0: 0}`"
    if isinstance(item.default, tuple):
        return f"`[{', '.join(f'{end:g}'.replace('inf', '.inf') for end in item.default)}]`"
    if isinstance(item.default, bool) or item.default is None:
        return {True: "true", False: "false", None: "none"}[item.default]
    return f"{item.default:g}"


def test_the_scenario_page_has_the_fields_of_the_components() -> None:
    assert fields_of_components() in (ROOT / "docs" / "scenarios.md").read_text(encoding="utf-8")


def rows_of(page: Path, *headings: str) -> list[list[str]]:
    """The cells of all tables of a page that begin with these columns."""
    text = page.read_text(encoding="utf-8")
    begin = re.escape(f"| {' | '.join(headings)} |")
    bodies = re.findall(rf"^{begin}.*\n\| ---.*\n((?:\|.*\n)+)", text, flags=re.MULTILINE)
    lines = [line for body in bodies for line in body.splitlines()]
    return [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]


def words(cell: str) -> list[str]:
    return re.findall(r"`([^`]+)`", cell)


def keys(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, FieldInfo]]:
    """The dotted keys of a schema; of a section those inside, and its own if it can be something else."""
    for name, item in model.model_fields.items():
        kinds = [k for k in (item.annotation, *get_args(item.annotation)) if k is not type(None)]
        sections = [k for k in kinds if isinstance(k, type) and issubclass(k, BaseModel)]
        for section in sections:
            yield from keys(section, f"{prefix}{name}.")
        if not sections or str in kinds:
            yield f"{prefix}{name}", item


def test_the_scenario_page_has_every_key_with_its_default() -> None:
    rows = rows_of(ROOT / "docs" / "scenarios.md", "key", "type", "unit", "default")
    defaults = {key: row[3] for row in rows for key in words(row[0])}
    for key, item in keys(ScenarioFile):
        assert key in defaults
        if item.is_required():
            assert defaults[key].startswith("required"), key
        elif isinstance(item.default, bool | int | float | str) and item.default != "":
            shown = str(item.default).lower() if isinstance(item.default, bool) else f"{item.default}"
            assert defaults[key].strip("`") == shown.removesuffix(".0"), key
    sections = {*Declarations._OWN, *(kind.plural for kind in BUILT_IN)}
    assert {f"network.{section}" for section in sections} <= set(defaults)


@pytest.mark.parametrize("sort", ["profile", "objective", "forecast", "plant"])
def test_the_scenario_page_has_every_option_of_the_plugins_with_its_default(sort: str) -> None:
    found: dict[str, dict[str, str]] = {}
    for names, options, _, _, default, _ in rows_of(
        ROOT / "docs" / "scenarios.md", {"profile": "rule"}.get(sort, sort), "option"
    ):
        name = next(iter(words(names)), None) or list(found)[-1]
        found.setdefault(name, {}).update(dict.fromkeys(words(options), default.strip("`")))
    known = {e.name: e.options for e in catalogue() if (e.sort, e.origin) == (sort, "opfmodel")}
    assert set(found) == set(known)
    for name, options in known.items():
        stated = dict(option.partition("=")[::2] for option in options)
        assert set(found[name]) == set(stated), name
        for option, default in stated.items():
            if default != "null":  # the page says in words what it means
                assert found[name][option] == (default or "required"), f"{name}: {option}"


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)", page.read_text(encoding="utf-8")):
        if "://" not in target:
            assert (page.parent / target).exists(), target


@pytest.mark.parametrize("path", sorted(SCENARIOS.glob("*.yaml")), ids=lambda p: p.stem)
def test_every_scenario_loads_and_its_series_cover_its_loop(path: Path) -> None:
    scenario = om.load_scenario(path)
    needed = scenario.steps + scenario.problem.horizon.steps - 1
    assert scenario.name == path.stem
    assert {len(values) for values in scenario.profiles.series.values()} == {needed}
