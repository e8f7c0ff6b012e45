"""What the documentation says was run: here it is run again."""

from __future__ import annotations

import inspect
import re
from dataclasses import MISSING, Field
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT, SCENARIOS

import opfmodel as om
from opfmodel.network import Component
from opfmodel.network.components import BUILT_IN

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


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)", page.read_text(encoding="utf-8")):
        if "://" not in target:
            assert (page.parent / target).exists(), target


@pytest.mark.parametrize("path", sorted(SCENARIOS.glob("*.yaml")), ids=lambda p: p.stem)
def test_every_scenario_loads_and_its_series_cover_its_loop(path: Path) -> None:
    scenario = om.load_scenario(path)
    needed = scenario.steps + scenario.problem.horizon - 1
    assert scenario.name == path.stem
    assert {len(values) for values in scenario.profiles.series.values()} == {needed}
