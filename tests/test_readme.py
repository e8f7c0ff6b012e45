"""The code of the documentation runs, and its tables match the code."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from conftest import ROOT, SCENARIOS, Call

import opfmodel as om
from opfmodel.plugins.catalogue import catalogue

PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)


def with_short_studies(code: str, folder: Path) -> str:
    """The code of a page with studies of short loops, whose results go to a folder."""
    for name in re.findall(r"scenarios/studies/(\S+)\.yaml", code):
        text = (SCENARIOS / "studies" / f"{name}.yaml").read_text(encoding="utf-8")
        assert "\nset:" not in text
        text = text.replace("scenario: ..", f"scenario: {SCENARIOS}") + "\nset: {time.steps: 3}\n"
        (folder / f"{name}.yaml").write_text(text)
        code = code.replace(f"scenarios/studies/{name}.yaml", str(folder / f"{name}.yaml"))
    return code.replace('"results/', f'"{folder}/results/')


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p, "python")], ids=lambda p: p.name)
def test_python_of_a_page_runs(page: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    namespace: dict[str, object] = {}
    for block in blocks(page, "python"):
        exec(compile(with_short_studies(block, tmp_path), str(page), "exec"), namespace)
    if page.name == "README.md":
        printed = capsys.readouterr().out
        assert "locally_optimal" in printed
        assert "24 steps, done" in printed
        assert len(blocks(page, "python")[0].strip().splitlines()) <= 15


def test_the_closed_loops_of_the_quick_start_cost_what_it_states(tmp_path: Path) -> None:
    page = ROOT / "docs" / "quick-start.md"
    (tmp_path / "two-bus.yaml").write_text(blocks(page, "yaml")[0])
    stated = re.findall(
        r"opfmodel run two-bus\.yaml.*# .*?([\d,]+\.\d\d) \$", page.read_text(encoding="utf-8")
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


def rows_of(page: Path, *headings: str) -> list[list[str]]:
    """The cells of all tables of a page that begin with these columns."""
    text = page.read_text(encoding="utf-8")
    begin = re.escape(f"| {' | '.join(headings)} |")
    bodies = re.findall(rf"^{begin}.*\n\| ---.*\n((?:\|.*\n)+)", text, flags=re.MULTILINE)
    lines = [line for body in bodies for line in body.splitlines()]
    return [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]


def words(cell: str) -> list[str]:
    return re.findall(r"`([^`]+)`", cell)


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


def test_the_grid_that_is_infeasible_lacks_what_the_page_states(tmp_path: Path, call: Call) -> None:
    page = ROOT / "docs" / "troubleshooting.md"
    (tmp_path / "tight.yaml").write_text(blocks(page, "yaml")[0])
    [stated] = re.findall(r"^ +(diagnosis: .*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    _, out, _ = call("solve", str(tmp_path / "tight.yaml"), "--on-infeasible", "elastic")
    assert stated in out.splitlines()
    _, out, _ = call("solve", str(tmp_path / "tight.yaml"), "--bound")
    assert "proven_infeasible" in out.splitlines()[0]


def test_the_reference_has_every_public_name() -> None:
    pages = (ROOT / "docs" / "reference").glob("*.md")
    named = {
        name
        for page in pages
        for name in re.findall(r"^::: opfmodel\.(\w+)$", page.read_text(), re.MULTILINE)
    }
    assert named == {*om.__all__, "study"}


def test_the_list_of_decisions_is_complete() -> None:
    folder = ROOT / "docs" / "decisions"
    listed = re.findall(r"\]\((\S+\.md)\)", (folder / "index.md").read_text(encoding="utf-8"))
    assert listed == sorted(page.name for page in folder.glob("0*.md"))


def test_every_page_is_in_the_menu_of_the_site() -> None:
    menu = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:\n")[2]
    pages = {page.relative_to(ROOT / "docs").as_posix() for page in (ROOT / "docs").rglob("*.md")}
    assert set(re.findall(r": (\S+\.md)$", menu, re.MULTILINE)) == {
        page for page in pages if not page.startswith("decisions/0")
    }
