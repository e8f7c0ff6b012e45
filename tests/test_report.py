"""Reports: what the page holds is what the data say, in one file of bounded size."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from conftest import SCENARIOS, Call, two_bus

import opfmodel as om
from opfmodel.profiles.scale import Scale
from opfmodel.results.report.moments import Moments
from opfmodel.results.report.run import report_page
from opfmodel.study import read_study

MOST = 6_000_000  # bytes of a page


def demand(steps: int) -> dict[str, Any]:
    """A daily wave."""
    return {"town.p": 90 + 20 * np.sin(2 * np.pi * np.arange(steps) / 24)}


@pytest.fixture(scope="module")
def run() -> om.Run:
    """A closed loop of six steps."""
    return om.simulate(om.MultiStage(two_bus(), 12, profiles=demand(24)), steps=6)


def content(path: Path) -> dict[str, Any]:
    """What the page draws from."""
    text = path.read_text(encoding="utf-8")
    found = re.search(r'<script type="application/json" id="content">(.*?)</script>', text, re.DOTALL)
    assert found
    return json.loads(found[1])


def array(page: dict[str, Any], name: str) -> np.ndarray:
    """An array of the page."""
    known = page["arrays"][name]
    kind = {"f8": "<f8", "f4": "<f4"}[known["dtype"]]
    return np.frombuffer(base64.b64decode(known["bdata"]), dtype=kind).reshape(known["shape"])


def sections(page: dict[str, Any]) -> list[str]:
    """Titles of the sections."""
    return [section["title"] for section in page["sections"]]


def parts(page: dict[str, Any], title: str) -> list[dict[str, Any]]:
    """Parts of a section."""
    return next(section["parts"] for section in page["sections"] if section["title"] == title)


def test_the_page_of_a_run_has_its_numbers(run: om.Run, tmp_path: Path) -> None:
    path = run.report(tmp_path / "deep" / "report.html")
    assert path.stat().st_size < MOST
    page = content(path)
    assert sections(page) == [
        "In short", "Dispatch", "Prices", "Branch loading", "Voltages", "Storage", "Network",
        "Limits and redispatch", "Solver effort", "Provenance",
    ]  # fmt: skip
    data = run.data
    for name in ("vm", "lmp"):
        np.testing.assert_array_equal(array(page, name), data[name].values.T)
    flow = np.maximum(*(np.hypot(data[f"p{end}"].values, data[f"q{end}"].values) for end in "ft"))
    np.testing.assert_allclose(array(page, "loading"), 100 * flow.T / 120, rtol=1e-15)
    stored = array(page, "stored energy")[0]
    np.testing.assert_array_equal(stored, [*data["e"].values[:, 0], data["e_next"].values[-1, 0]])
    tiles = {tile["label"]: tile for tile in parts(page, "In short")[-1]["tiles"]}
    assert tiles["cost"]["value"] == f"{run.cost:,.2f} $"
    assert tiles["demand"]["value"] == f"{float(data['pd'].sum()):,.2f} MWh"


def test_areas_add_up_to_demand_and_losses(run: om.Run, tmp_path: Path) -> None:
    page = content(run.report(tmp_path / "report.html"))
    [chart] = parts(page, "Dispatch")
    for view in chart["views"]:
        areas = [trace["y"] for trace in view["traces"] if "stackgroup" in trace]
        data = run.data
        needed = data["pd"].sum("bus") + (data["pf"] + data["pt"]).sum("branch")
        np.testing.assert_allclose(np.sum(areas, axis=0)[:-1], needed.values, rtol=1e-6)


def test_names_cannot_break_the_page(tmp_path: Path) -> None:
    grid = om.Network("</script><b>{{ script }}", base_mva=100)
    grid.add("<i>", om.Bus(reference=True))
    grid.add("a & b", om.Generator("<i>", p=(0, 100), cost=om.Polynomial(0, 20, 0)))
    grid.add("l", om.Load("<i>", p=50))
    path = om.MultiStage(grid, 2).solve().report(tmp_path / "report.html")
    text = path.read_text(encoding="utf-8")
    assert "<title>&lt;/script&gt;&lt;b&gt;{{ script }}</title>" in text
    assert "<i>" not in text
    [chart] = parts(content(path), "Dispatch")
    assert chart["views"][0]["traces"][0]["name"] == "a & b"


def test_a_plan_that_failed_has_a_page_of_its_failure(tmp_path: Path) -> None:
    plan = om.MultiStage(two_bus(), 2, profiles={"town.p": [500.0, 500.0]}).solve()
    assert not plan.optimal
    page = content(plan.report(tmp_path / "report.html"))
    assert "infeasible" in parts(page, "In short")[0]["texts"][0]
    assert "Prices" not in sections(page)


def test_scenarios_are_fans(tmp_path: Path) -> None:
    cases = {"calm": om.Case(0.75, [Scale(0.95)]), "peak": om.Case(0.25, [Scale(1.05)])}
    scenarios = om.Scenarios(common=1, cases=cases)
    tree = om.MultiStage(two_bus(), scenarios.horizon([1, 1, 2]), profiles=demand(6))
    controller = om.Controller(tree, scenarios=scenarios)
    plan = controller.plan(0, None)
    page = content(plan.report(tmp_path / "report.html"))
    chart, table = parts(page, "Scenarios")
    assert [row[0] for row in table["rows"]] == list(plan.scenario_costs)
    assert [row[2] for row in table["rows"]] == list(plan.scenario_costs.values())
    view = next(view for view in chart["views"] if view["label"] == "demand")
    for trace, name in zip(view["traces"], plan.scenario_costs, strict=True):
        np.testing.assert_array_equal(trace["y"][:-1], plan.scenario(name)["pd"].sum("bus").values)


def synthetic(buses: int, branches: int, stages: int) -> xr.Dataset:
    """Trajectories of random numbers, as large as asked."""
    random = np.random.default_rng(1)
    names = [f"bus {n}" for n in range(buses)]
    ends = random.integers(0, buses, (2, branches))
    over = {"bus": buses, "branch": branches, "generator": 20, "storage": 5}
    made = {
        name: (("time", kind), random.uniform(low, high, (stages, over[kind])))
        for name, kind, low, high in (
            ("vm", "bus", 0.95, 1.05), ("lmp", "bus", 10, 50), ("pd", "bus", 0, 9), ("qd", "bus", 0, 3),
            ("pf", "branch", -90, 90), ("pt", "branch", -90, 90), ("qf", "branch", -9, 9),
            ("qt", "branch", -9, 9), ("pg", "generator", 0, 99), ("ps", "storage", -9, 9),
            ("e", "storage", 0, 99), ("e_next", "storage", 0, 99),
        )
    }  # fmt: skip
    data = xr.Dataset(
        {**made, "rating": ("branch", np.full(branches, 100.0)), "cost_rate": ("time", np.ones(stages))},
        coords={
            "time": np.arange(float(stages)),
            "bus": names,
            "branch": [f"line {n}" for n in range(branches)],
            "generator": [f"unit {n}" for n in range(20)],
            "storage": [f"cell {n}" for n in range(5)],
            "branch_from_bus": ("branch", [names[n] for n in ends[0]]),
            "branch_to_bus": ("branch", [names[n] for n in ends[1]]),
        },
    )
    for name, unit in (("lmp", "$/MWh"), ("vm", "p.u.")):
        data[name].attrs["units"] = unit
    return data


@pytest.mark.parametrize(
    ("buses", "branches", "stages"), [(118, 186, 8760), (1354, 1991, 24), (9241, 16049, 24)]
)
def test_pages_are_of_bounded_size(buses: int, branches: int, stages: int) -> None:
    data = synthetic(buses, branches, stages)
    page = report_page(data)
    assert len(page.html()) < MOST
    moments = Moments.of(data)
    assert (moments.note == "") == (moments.stride == 1)
    for name in ("vm", "lmp"):
        shown = data[name].values[:: moments.stride].T
        assert len(page.arrays[name]) in (buses, 100_000 // stages)
        assert {tuple(row) for row in page.arrays[name]} <= {tuple(row) for row in shown}


def test_moments_are_named_in_their_zone() -> None:
    stamps = np.array(["2025-03-29T23:00", "2025-03-30T00:00", "2025-03-30T01:00"], dtype="datetime64[ns]")
    data = xr.Dataset(coords={"time": ("time", stamps, {"zone": "Europe/Berlin"})}, attrs={"step_hours": 1.0})
    moments = Moments(data, 1)
    assert moments.labels == ["2025-03-30 00:00 CET", "2025-03-30 01:00 CET", "2025-03-30 03:00 CEST"]
    assert moments.axis[-1] == "2025-03-30 04:00:00"
    assert moments.title == "time [Europe/Berlin]"


def test_reports_of_folders(run: om.Run, tmp_path: Path, call: Call) -> None:
    one, other = tmp_path / "one", tmp_path / "other"
    run.save(one)
    om.load_run(one).save(other)
    code, out, _ = call("report", str(one))
    assert (code, out.strip()) == (0, str(one / "report.html"))
    assert array(content(one / "report.html"), "vm").shape == (2, 6)
    (one / "analysis.json").write_text(
        json.dumps({"checks": {"turnpike": {"verdict": "holds", "explanation": "it does"}}}), encoding="utf-8"
    )
    call("report", str(one), "--out", str(tmp_path / "with.html"))
    [table] = parts(content(tmp_path / "with.html"), "Theory")
    assert table["rows"] == [["turnpike", "holds", "it does"]]
    code, out, _ = call("report", str(one), str(other), "--out", str(tmp_path / "both.html"), "--json")
    assert code == 0
    assert json.loads(out)["report"] == str(tmp_path / "both.html")
    [table] = parts(content(tmp_path / "both.html"), "In short")
    assert table["columns"] == ["figure", "one", "other"]
    assert ["cost", run.cost, run.cost] in table["rows"]


def test_a_new_run_deletes_the_report_of_the_last(run: om.Run, tmp_path: Path) -> None:
    run.save(tmp_path)
    om.report([tmp_path])
    run.save(tmp_path)
    assert not (tmp_path / "report.html").exists()


@pytest.mark.parametrize(
    ("folders", "words"), [(["none"], "no such file"), (["none", "other"], "no such file")]
)
def test_folders_without_results_are_refused(
    folders: list[str], words: str, tmp_path: Path, call: Call
) -> None:
    code, _, err = call("report", *(str(tmp_path / folder) for folder in folders))
    assert code == 2
    assert words in err
    assert not list(tmp_path.iterdir())


def test_saved_runs_are_those_that_were_saved(run: om.Run, tmp_path: Path) -> None:
    run.save(tmp_path)
    saved = om.load_run(tmp_path)
    xr.testing.assert_identical(saved.data, run.data)
    assert saved.summary()["cost"] == run.cost
    assert saved.summary()["max_violation"] < 1e-6
    frame = saved.to_frame()
    assert list(frame.index) == list(run.data["time"].values)
    np.testing.assert_array_equal(frame["coal.pg"], run.data["pg"].sel(generator="coal").values)
    text = saved.to_csv(tmp_path / "stages.csv").read_text(encoding="utf-8")
    assert text.startswith("time,")
    xr.testing.assert_identical(
        xr.load_dataset(saved.to_netcdf(tmp_path / "again.nc"), engine="h5netcdf"), run.data
    )
    assert "two-bus" in run._repr_html_()
    assert run.plot().axes
    with pytest.raises(om.OpfmodelError, match="no such figure"):
        run.plot("sytem")


def test_what_units_do_in_a_plan() -> None:
    plan = om.MultiStage(two_bus(), 12, profiles=demand(12)).solve()
    table = plan.summary()
    assert list(table.index) == ["coal", "cell"]
    pg = plan.data["pg"].sel(generator="coal").values
    assert table.loc["coal", "energy_mwh"] == pytest.approx(pg.sum(), rel=1e-12)
    price = plan.data["lmp"].sel(bus="north").values
    assert table.loc["coal", "price"] == pytest.approx((price * pg).sum() / pg.sum(), rel=1e-12)
    bound = plan.data["ps"].values[:, 0]
    assert table.loc["cell", "stages_at_limit"] == np.count_nonzero(np.abs(np.abs(bound) - 10) < 0.01)


def test_solving_writes_what_it_found(tmp_path: Path, call: Call) -> None:
    code, out, _ = call(
        "solve", str(SCENARIOS / "case5-step.yaml"), "--horizon", "4", "--out", str(tmp_path / "plan")
    )
    assert code == 0
    assert re.search(r"^gen1 +1 ", out, re.MULTILINE)
    assert re.search(r"^prices +[\d.,]+ \$/MWh at bus", out, re.MULTILINE)
    plan = om.load_run(tmp_path / "plan")
    assert plan.data.sizes["time"] == 4
    assert "lmp" in plan.data
    assert (tmp_path / "plan" / "stages.csv").read_text(encoding="utf-8").startswith("time,")


def test_objects_show_themselves_in_a_notebook(run: om.Run) -> None:
    assert "<td>2</td>" in run.problem.network._repr_html_()
    assert "Economic" in run.problem._repr_html_()
    study = read_study(SCENARIOS / "studies" / "horizon.yaml")
    assert repr(study).startswith("Study('horizon': ")
    assert "controller.horizon" in study._repr_html_()


def test_what_happens_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("INFO", logger="opfmodel"):
        om.simulate(om.MultiStage(two_bus(), 2, profiles=demand(3)), steps=2)
    texts = [record.getMessage() for record in caplog.records]
    assert [text for text in texts if "compiled" in text]
    assert len([text for text in texts if text.startswith("Plan(")]) == 2
    assert texts[-1] == "step 2 of 2: plan locally_optimal, plant planned"


def test_a_secure_plan_lists_the_outages_that_it_includes(tmp_path: Path) -> None:
    grid = om.load_scenario(SCENARIOS / "case5-step.yaml").network
    secure = om.Security({"branches": ["1-2", "1-4"]}, screen=False)
    plan = om.MultiStage(grid, security=secure).solve()
    [table] = parts(content(plan.report(tmp_path / "report.html")), "Outages")
    assert [row[0] for row in table["rows"]] == ["1-2", "1-4"]


def test_a_plan_replaces_no_run(tmp_path: Path, call: Call) -> None:
    scenario = str(SCENARIOS / "case5-step.yaml")
    short = ("--set", "controller.horizon=4", "--set", "time.steps=1")
    call("run", scenario, *short, "--out", str(tmp_path))
    before = (tmp_path / "summary.json").read_bytes()
    code, _, err = call("solve", scenario, *short, "--out", str(tmp_path))
    assert code == 2
    assert f"--out {tmp_path}: holds a closed loop" in err
    assert (tmp_path / "summary.json").read_bytes() == before
