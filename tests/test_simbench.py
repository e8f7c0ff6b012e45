"""Grids of SimBench with their time series."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SCENARIOS

import opfmodel as om
from opfmodel.errors import CaseError

simbench = pytest.importorskip("simbench")

CODE = "1-LV-rural1--2-sw"


@pytest.fixture(scope="module")
def grid() -> om.Network:
    with warnings.catch_warnings(action="ignore"):
        return om.read_network(f"simbench:{CODE}")


@pytest.fixture(scope="module")
def net() -> Any:
    return simbench.get_simbench_net(CODE)


def test_series_are_those_of_simbench(grid: om.Network, net: Any) -> None:
    values = simbench.get_absolute_values(net, profiles_instead_of_study_cases=True)
    assert grid.profiles.length == len(net.profiles["load"]) == 366 * 96
    for table, column, field in (("load", "p_mw", "p"), ("load", "q_mvar", "q"), ("sgen", "p_mw", "p_max")):
        for index, name in net[table]["name"].items():
            expected = values[table, column][index].to_numpy()
            expected = np.maximum(expected, 0) if field == "p_max" else expected
            np.testing.assert_array_equal(grid.profiles[name, field], expected)


def test_stamps_are_those_of_simbench(grid: om.Network, net: Any) -> None:
    calendar = grid.profiles.calendar
    stated = net.profiles["load"]["time"]
    pandas = pytest.importorskip("pandas")
    local = pandas.DatetimeIndex(calendar.stamps(len(stated))).tz_localize("UTC").tz_convert(calendar.zone)
    assert local.strftime("%d.%m.%Y %H:%M").tolist() == stated.tolist()


def test_storages_and_generators_are_decided(grid: om.Network, net: Any) -> None:
    for _, row in net.storage.iterrows():
        battery = grid[row["name"]]
        assert battery.power == (-row.sn_mva, row.sn_mva)
        assert (battery.energy, battery.charge_efficiency) == (row.max_e_mwh, row.efficiency_percent)
    assert len(grid.of(om.Storage)) == len(net.storage) > 0
    for name in net.sgen["name"]:
        assert (grid[name].p[0], grid[name].q) == (0.0, (0.0, 0.0))


def test_the_scenario_runs(tmp_path: Path) -> None:
    with warnings.catch_warnings(action="ignore"):
        scenario = om.load_scenario(
            SCENARIOS / "simbench-rural.yaml", overrides={"time.steps": 2, "controller.horizon": 4}
        )
        run = scenario.simulate()
    assert run.status == "done"
    assert len(scenario.network.of(om.Storage)) == 90


def test_an_unknown_grid_is_refused() -> None:
    with pytest.raises(CaseError, match=r"has no grid '1-MV-rurall--2-sw'; did you mean '1-MV-rural--2-sw'"):
        om.read_network("simbench:1-MV-rurall--2-sw")


def test_without_the_package_a_grid_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "simbench", None)
    with pytest.raises(CaseError, match=r"needs the package simbench.*pip install 'opfmodel\[simbench\]'"):
        om.read_network(f"simbench:{CODE}")
