"""Time stamps: calendars, time series that came with a network, and the end of the data."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import opfmodel as om
from opfmodel.check import check
from opfmodel.data.calendar import Calendar
from opfmodel.data.series import Profiles
from opfmodel.errors import ModelError, ProfileError, ScenarioError
from opfmodel.results import load, save
from opfmodel.results.figures import FIGURES
from opfmodel.scenario import declarations

BERLIN = Calendar(np.datetime64("2025-03-28T23:00"), 0.25, "Europe/Berlin")
STAMPED = "network: {file: case.nc}\n"


def one_bus(**load: Any) -> om.Network:
    grid = om.Network("one-bus")
    grid.bus = om.Bus()
    grid.unit = om.Generator("bus", p=(0, 100), cost=om.Polynomial(0.01, 20, 0))
    grid.cell = om.Storage("bus", energy=10, power=5)
    grid.town = om.Load("bus", **{"p": 50, **load})
    grid.works = om.Load("bus", p=5)
    return grid


def with_series(**series: Any) -> om.Network:
    grid = one_bus()
    values = series or {"town.p": [10.0, 20, 30, 40, 50, 60], "works.p": np.arange(6.0)}
    grid.attach(Profiles(values, BERLIN))
    return grid


@pytest.fixture
def stamped_case(monkeypatch: pytest.MonkeyPatch) -> om.Network:
    """Scenarios that read ``case.nc`` get a network with time series."""
    grid = with_series()
    monkeypatch.setattr(declarations, "read_network", lambda *_, **__: grid.copy())
    return grid


def scenario(tmp_path: Path, text: str) -> om.Scenario:
    path = tmp_path / "scenario.yaml"
    path.write_text(text)
    return om.load_scenario(path)


def test_a_problem_uses_the_series_of_its_network() -> None:
    problem = om.MultiStage(with_series(), 3, formulation="dc")
    assert problem.step == 0.25
    assert problem.profiles.calendar == BERLIN
    assert problem.solve(1).data["pd"].values.ravel() == pytest.approx([21, 32, 43])


def test_given_series_override_those_of_the_network_one_by_one() -> None:
    problem = om.MultiStage(with_series(), 3, formulation="dc", profiles={"town.p": [7.0, 8, 9]})
    assert problem.solve().data["pd"].values.ravel() == pytest.approx([7, 9, 11])
    assert problem.profiles.calendar == BERLIN


def test_the_series_of_a_network_that_begin_earlier_are_cut() -> None:
    later = Profiles({"town.p": [7.0, 8, 9]}, BERLIN.later(2))
    problem = om.MultiStage(with_series(), 3, formulation="dc", profiles=later)
    assert problem.profiles.calendar == BERLIN.later(2)
    assert problem.solve().data["pd"].values.ravel() == pytest.approx([9, 11, 13])


@pytest.mark.parametrize(
    ("calendar", "words"),
    [
        (BERLIN.later(-1), "later than the first step"),
        (BERLIN.later(6), "must overlap"),
        (Calendar(BERLIN.start, 1.0), "15 min, not of 1 h"),
        (Calendar(BERLIN.start + np.timedelta64(1, "m"), 0.25), "2025-03-29 00:15 CET"),
    ],
)
def test_series_that_do_not_fit_those_of_the_network_are_refused(calendar: Calendar, words: str) -> None:
    with pytest.raises(ProfileError, match=words):
        om.MultiStage(with_series(), profiles=Profiles({"town.p": [7.0]}, calendar))


def test_a_stated_step_must_be_that_of_the_series() -> None:
    assert om.MultiStage(with_series(), step=0.25).step == 0.25
    assert om.MultiStage(one_bus()).step == 1.0
    with pytest.raises(ModelError, match=r"step = 1\.0: .*15 min"):
        om.MultiStage(with_series(), step=1.0)


def test_a_changed_field_has_no_longer_the_series_of_the_network() -> None:
    grid = with_series(**{"town.p": [1.0], "town.q": [2.0], "unit.p_max": [3.0], "unit.c1": [4.0]})
    grid.update("town", p=9)
    assert set(map(str, grid.profiles)) == {"town.q", "unit.p_max", "unit.c1"}
    grid.update("unit", p=(0, 50))
    grid.update("unit", ramp=1)
    assert set(map(str, grid.profiles)) == {"town.q", "unit.c1"}
    grid.update("unit", cost=om.Polynomial(0, 1, 0))
    twin = grid.copy()
    grid.remove("town")
    assert not grid.profiles
    assert set(map(str, twin.profiles)) == {"town.q"}
    assert grid.profiles.calendar == BERLIN


def test_single_stages_and_plants_use_the_series_of_the_problem_alone() -> None:
    problem = om.MultiStage(with_series(), 2, profiles={"town.p": [1.0, 2, 3, 4]})
    singles = om.single_stage_sequence(problem, 3)
    assert singles.data["pd"].values.ravel() == pytest.approx([1, 3, 5])
    run = om.simulate(problem, om.Redispatch(), 2)
    assert run.status == "done", run.termination
    assert run.data["pd"].values.ravel() == pytest.approx([1, 3])


def test_a_scenario_takes_time_and_series_of_its_network(tmp_path: Path, stamped_case: om.Network) -> None:
    read = scenario(
        tmp_path,
        STAMPED + "controller: {horizon: 2}\nprofiles: [{scale: {factor: 2, loads: [town]}}]",
    )
    assert read.steps == 5  # 6 values, and the last plan looks one step further
    assert read.problem.step == 0.25
    assert read.profiles.calendar == BERLIN
    assert read.profiles["town.p"].tolist() == [20, 40, 60, 80, 100, 120]
    assert read.profiles["works.p"].tolist() == list(stamped_case.profiles["works.p"])


def test_a_scenario_may_begin_within_the_series_of_its_network(
    tmp_path: Path, stamped_case: om.Network
) -> None:
    read = scenario(tmp_path, STAMPED + "time: {start: 2025-03-29T00:30, steps: 2}")
    assert read.profiles.calendar == BERLIN.later(2)
    assert read.profiles["town.p"].tolist() == [30, 40]
    assert stamped_case.profiles["town.p"].size == 6
    shown = scenario(tmp_path, STAMPED + "time: {zone: America/New_York}")
    assert shown.profiles.calendar == Calendar(BERLIN.start, 0.25, "America/New_York")


def test_updates_of_a_scenario_replace_the_series_of_its_network(
    tmp_path: Path, stamped_case: om.Network
) -> None:
    del stamped_case
    read = scenario(tmp_path, "network: {file: case.nc, update: {town: {p: 3}}, remove: [works]}")
    assert not read.profiles
    assert read.profiles.calendar == BERLIN


@pytest.mark.parametrize(
    ("time", "words"),
    [
        ("{steps: 7}", r":2:8: time\.steps: .*end at 2025-03-29 01:30 CET; 7 from 2025-03-29 00:00 CET on"),
        ("{step: 1.0}", r"time\.step: .*15 min, not of 1 h"),
        ("{start: 2025-03-28T23:45}", r":2:8: time\.start: .*2025-03-29 00:00 CET"),
        ("{start: 2025-03-29T00:01}", r"time\.start: .*00:00 CET and 2025-03-29 00:15 CET"),
        ("{start: 2025-04-29T00:00}", r"the data end at 2025-03-29 01:30 CET"),
        ("{start: noon}", r"time\.start: 'noon': must be a time in ISO 8601"),
        ("{start: 2025-03-30T02:30}", r"2025-03-30 02:30:00: does not exist in Europe/Berlin"),
        ("{start: 2025-10-26T02:30}", r"exists twice in Europe/Berlin.*02:30:00\+02:00 or .*02:30:00\+01:00"),
        ("{start: 9999-12-31}", r"9999-12-31: must be from the years"),
        ("{zone: Europe/Berlim}", r"time\.zone: .*Europe/Berlim.*no such time zone"),
        ("{zone: ../../etc/passwd}", r"time\.zone: .*no such time zone"),
    ],
)
def test_a_time_that_does_not_fit_the_series_of_the_network_is_refused(
    tmp_path: Path, stamped_case: om.Network, time: str, words: str
) -> None:
    del stamped_case
    with pytest.raises(ScenarioError, match=words):
        scenario(tmp_path, f"{STAMPED}time: {time}")


# Results --------------------------------------------------------------------------------------------


def test_results_have_times_in_utc_and_the_zone(tmp_path: Path) -> None:
    problem = om.MultiStage(with_series(), 3, formulation="dc")
    expected = np.datetime64("2025-03-28T23:15") + np.arange(3) * np.timedelta64(15, "m")
    data = problem.solve(1).data
    assert data["time"].dtype == "datetime64[ns]"
    assert (data["time"].values == expected).all()
    assert data["time"].attrs["zone"] == "Europe/Berlin"
    run = om.simulate(problem, steps=3)
    assert (run.data["time"].values == expected - np.timedelta64(15, "m")).all()
    singles = om.single_stage_sequence(problem, 3, start=1)
    assert (singles.data["time"].values == expected).all()
    assert singles.data["time"].attrs == data["time"].attrs
    save(run.data, run.summary(), tmp_path)
    loaded = load(tmp_path)
    xr.testing.assert_equal(loaded, run.data)
    assert loaded["time"].dtype == "datetime64[ns]"
    assert loaded["time"].attrs["zone"] == "Europe/Berlin"
    report = check(problem.network, loaded, problem.profiles)
    assert report.max_violation < 1e-5


def test_results_without_stamps_have_hours() -> None:
    data = om.MultiStage(one_bus(), 2, 0.5, formulation="dc", profiles={"town.p": [1.0, 2, 3]}).solve(1).data
    assert data["time"].values.tolist() == [0.5, 1.0]
    assert data["time"].attrs["units"] == "h"


def test_violations_and_shortages_are_dated() -> None:
    grid = with_series(**{"town.p": [10.0, 20, 130, 40]})
    problem = om.MultiStage(grid, 4, formulation="dc")
    (shortage,) = problem.elastic_twin().solve().shortages
    assert "2025-03-29 00:30 CET" in str(shortage)
    run = om.simulate(om.MultiStage(grid, 2, formulation="dc"), steps=3)
    assert "step 1 (2025-03-29 00:15 CET)" in run.termination
    data = om.MultiStage(with_series(), 4, formulation="dc").solve().data
    data["pg"][2] = 111.0
    worst = check(problem.network, data, with_series().profiles).worst
    assert worst is not None
    assert (worst.time, worst.moment) == (0.5, "2025-03-29 00:30 CET")


def test_figures_have_dates_in_the_zone() -> None:
    start = Calendar(np.datetime64("2025-03-29T23:00"), 1.0, "Europe/Berlin")  # midnight in Berlin
    grid = one_bus()
    grid.attach(Profiles({"town.p": np.full(23, 20.0)}, start))
    data = om.MultiStage(grid, 23, formulation="dc").solve().data
    for figure in FIGURES.values():
        drawn = figure(data)
        drawn.draw_without_rendering()
        axis = drawn.axes[-1]
        assert axis.get_xlabel() == "time [Europe/Berlin]"
        assert (
            "30-Mar" in axis.get_xticklabels()[0].get_text()
            or "Mar-30" in axis.get_xticklabels()[0].get_text()
        )
        assert "02:00" not in [label.get_text() for label in axis.get_xticklabels()]  # does not exist
