"""What the documentation says was run: here it is run again."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from conftest import ROOT, SCENARIOS

import opfmodel as om

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


def test_the_example_of_the_scenario_page_is_a_scenario(tmp_path: Path) -> None:
    (tmp_path / "my-case.m").write_text((ROOT / "tests/data/matpower/case5.m").read_text())
    (block,) = blocks(ROOT / "docs" / "scenarios.md", "yaml")
    (tmp_path / "s.yaml").write_text(block)
    scenario = om.load_scenario(tmp_path / "s.yaml")
    assert scenario.network["cella"].energy == 20
    assert scenario.network["gen1"].ramp == pytest.approx(4)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)", page.read_text(encoding="utf-8")):
        if "://" not in target:
            assert (page.parent / target).exists(), target


@pytest.mark.parametrize("path", sorted(SCENARIOS.glob("*.yaml")), ids=lambda p: p.stem)
def test_every_scenario_loads(path: Path) -> None:
    assert om.load_scenario(path).steps >= 1
