"""Reports in a browser: Chromium without a window draws them and their controls work."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SCENARIOS

import opfmodel as om

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
pytestmark = pytest.mark.slow

CHROMIUM = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    if CHROMIUM is None:
        pytest.skip("Chromium is not installed")
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield opened
        opened.close()


@pytest.fixture(scope="module")
def run() -> om.Run:
    return om.load_scenario(SCENARIOS / "case5-step.yaml", overrides={"time.steps": 8}).simulate()


class Opened:
    """A page that is open, what it logged, and what it asked of the network."""

    def __init__(self, browser: Any, path: Path, **options: Any) -> None:
        self.context = browser.new_context(**options)
        self.page = self.context.new_page()
        self.faults: list[str] = []
        self.requests: list[str] = []
        self.page.on(
            "console",
            lambda message: (
                self.faults.append(message.text) if message.type in ("error", "warning") else None
            ),
        )
        self.page.on("pageerror", lambda error: self.faults.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.goto(path.as_uri())
        self.page.wait_for_selector("html[data-ready]")

    def show(self, section: str) -> Any:
        """Scroll to a section, wait until it is drawn, and return it."""
        found = self.page.locator(f"#{section}")
        for plot in found.locator(".plot").all():
            plot.scroll_into_view_if_needed()
            plot.locator(".main-svg").first.wait_for()
        return found

    def traces(self, plot: Any) -> list[dict[str, Any]]:
        """What a chart draws."""
        return plot.evaluate(
            "e => e.data.map(t => ({name: t.name, type: t.type, visible: t.visible, "
            "x: Array.from(t.x ?? []), y: Array.from(t.y ?? [], v => v), "
            "z: t.z ? Array.from(t.z, r => Array.from(r)) : null, "
            "color: t.marker?.color?.length ? Array.from(t.marker.color) : null}))"
        )


@pytest.fixture
def opened(browser: Any, run: om.Run, tmp_path: Path) -> Iterator[Opened]:
    page = Opened(browser, run.report(tmp_path / "report.html"), viewport={"width": 1200, "height": 900})
    yield page
    assert page.faults == []
    assert [url for url in page.requests if not url.startswith(("file:", "data:", "blob:"))] == []
    page.context.close()


def test_every_section_is_drawn_without_a_fault(opened: Opened) -> None:
    names = opened.page.eval_on_selector_all(
        "#menu a", "all => all.map(a => a.getAttribute('href').slice(1))"
    )
    assert len(names) >= 9
    for name in names:
        assert opened.show(name).is_visible()
    assert opened.page.evaluate("document.querySelectorAll('.plot').length") >= 8


def test_numbers_in_the_page_are_those_of_the_data(opened: Opened, run: om.Run) -> None:
    prices = opened.traces(opened.show("prices").locator(".plot").first)[0]
    assert prices["type"] == "heatmap"
    np.testing.assert_array_equal(prices["z"], run.data["lmp"].values.T)
    assert (
        opened.page.locator(".tile", has_text="cost").first.locator(".value").inner_text()
        == f"{run.cost:,.2f} $"
    )
    dispatch = opened.traces(opened.show("dispatch").locator(".plot").first)
    by_name: dict[str, Any] = {}
    for trace in dispatch:
        by_name[trace["name"]] = by_name.get(trace["name"], 0.0) + np.array(trace["y"])
    for unit in run.data["generator"].values:
        np.testing.assert_array_equal(by_name[unit][:-1], run.data["pg"].sel(generator=unit).values)


def test_the_slider_moves_the_network_in_time(opened: Opened, run: om.Run) -> None:
    section = opened.show("network")
    plot, slider = section.locator(".plot"), section.locator("input[type=range]")
    values = run.data["vm"].values
    for moment in (0, 5, 7):
        slider.fill(str(moment))
        assert section.locator("output").inner_text() == f"hour {moment}"
        np.testing.assert_array_equal(opened.traces(plot)[-1]["color"], values[moment])
    slider.focus()
    opened.page.keyboard.press("ArrowLeft")
    assert section.locator("output").inner_text() == "hour 6"
    section.locator("select").select_option(label="price")
    np.testing.assert_array_equal(opened.traces(plot)[-1]["color"], run.data["lmp"].values[6])
    section.locator("select").select_option(label="loading")
    flow = np.maximum(*(np.hypot(run.data[f"p{e}"].values, run.data[f"q{e}"].values) for e in "ft"))
    rating = np.broadcast_to(run.data["rating"].values, flow.shape)[6]
    shown = opened.traces(plot)[-2]["color"]
    expected = np.where(np.isfinite(rating), 100 * flow[6] / rating, np.nan)
    np.testing.assert_allclose(np.array(shown, dtype=float), expected, rtol=1e-12)


def test_choices_and_legends_filter(opened: Opened, run: om.Run) -> None:
    section = opened.show("voltages")
    plot = section.locator(".plot")
    section.locator("select").select_option(label="bus 3")
    assert opened.traces(plot)[0]["y"][:-1] == run.data["vm"].sel(bus="3").values.tolist()
    dispatch = opened.show("dispatch")
    first = dispatch.locator(".legendtoggle").first
    before = opened.traces(dispatch.locator(".plot"))[0]["visible"]
    first.click()
    opened.page.wait_for_function(
        "document.querySelector('#dispatch .plot').data.some(t => t.visible === 'legendonly')"
    )
    assert before is not False


def test_tables_sort(opened: Opened) -> None:
    table = opened.show("branch-loading").locator("table")
    table.locator("th button", has_text="peak").click()
    cells = [
        float(text.replace(",", "")) for text in table.locator("tbody tr td:nth-child(4)").all_inner_texts()
    ]
    assert cells == sorted(cells)


def test_dark_and_light(opened: Opened) -> None:
    background = "getComputedStyle(document.body).backgroundColor"
    light = opened.page.evaluate(background)
    opened.show("dispatch")
    opened.page.locator("#theme").click()
    assert opened.page.evaluate(background) != light
    ink = opened.page.evaluate("document.querySelector('#dispatch .plot').layout.font.color")
    assert ink == opened.page.evaluate(
        "getComputedStyle(document.documentElement).getPropertyValue('--ink').trim()"
    )


@pytest.mark.parametrize("width", [360, 1200])
def test_nothing_is_wider_than_the_screen(browser: Any, run: om.Run, tmp_path: Path, width: int) -> None:
    page = Opened(browser, run.report(tmp_path / "report.html"), viewport={"width": width, "height": 800})
    for name in ("dispatch", "network", "provenance"):
        page.show(name)
    assert page.page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.faults == []
    page.context.close()


def test_every_control_has_a_name(opened: Opened) -> None:
    nameless = opened.page.evaluate(
        """[...document.querySelectorAll('button, input, select, [role=img]')].filter(e => !e.closest('.modebar')
           && !(e.textContent.trim() && e.tagName === 'BUTTON') && !e.getAttribute('aria-label')
           && !(e.id && document.querySelector(`label[for="${e.id}"]`))).map(e => e.outerHTML.slice(0, 80))"""
    )
    assert nameless == []
    headings = opened.page.eval_on_selector_all("h1, h2", "all => all.map(h => h.textContent)")
    assert len(headings) == len(set(headings))


def test_a_study_is_explored(browser: Any, tmp_path: Path) -> None:
    from opfmodel.study import read_study, run_study

    (tmp_path / "study.yaml").write_text(
        f"name: small\nscenario: {SCENARIOS / 'case5-step.yaml'}\nkeep: trajectories\n"
        "set: {time.steps: 2}\nvary:\n  controller.horizon: [4, 6]\n  controller.formulation: [ac, dc]\n"
        "  plant.mode: [redispatch]\n",
        encoding="utf-8",
    )
    folder = tmp_path / "results"
    run_study(read_study(tmp_path / "study.yaml"), folder, workers=1)
    page = Opened(browser, om.report([folder]), viewport={"width": 1200, "height": 900})
    section = page.show("results")
    plot = section.locator(".plot")
    assert len(page.traces(plot)[0]["x"]) == 4
    section.get_by_label("only controller.horizon").select_option(label="6")
    assert page.traces(plot)[0]["x"] == [6, 6]
    section.get_by_label("colour").select_option(label="controller.formulation")
    assert sorted(trace["name"] for trace in page.traces(plot)) == ["ac", "dc"]
    section.get_by_label("only controller.horizon").select_option(label="all")
    section.get_by_label("compare run 1").check()
    section.get_by_label("compare run 2").check()
    assert section.get_by_text("Runs side by side").is_visible()
    with page.page.expect_navigation():
        section.get_by_role("link", name="report").first.click()
    page.page.wait_for_selector("html[data-ready]")
    assert page.faults == []
    page.context.close()
