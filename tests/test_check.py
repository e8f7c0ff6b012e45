"""The independent check finds what is wrong: every family of violations, planted one by one."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from conftest import demand, everything

import opfmodel as om
from opfmodel.check import check, economic_cost, losses

SERIES = demand(5)


@pytest.fixture(scope="module")
def solved() -> tuple[om.Network, xr.Dataset]:
    grid = everything()
    return grid, om.MultiStage(grid, 5, profiles=SERIES).solve().data


def test_a_sound_plan_has_no_violation(solved: tuple[om.Network, xr.Dataset]) -> None:
    report = check(*solved, SERIES)
    assert report.max_violation < 1e-6
    assert set(report.violations) >= {
        "voltage",
        "branch rating",
        "active balance",
        "ramp",
        "storage dynamics",
    }
    assert "active balance" in str(report)


PLANTED = [
    ("voltage", "vm", "a", 0.3, None),
    ("generator p", "pg", "cheap", 70.0, None),
    ("generator q", "qg", "dear", 60.0, None),
    ("ramp", "pg", "cheap", 30.0, None),
    ("active balance", "pg", "dear", 5.0, 5.0 / 50),
    ("reactive balance", "qs", "tank", 1.0, 1.0 / 50),
    ("storage power", "ps", "battery", 30.0, None),
    ("storage q", "qs", "tank", 9.0, None),
    ("storage rating", "qs", "battery", 20.0, None),
    ("storage energy", "e_next", "tank", 100.0, None),
    ("storage dynamics", "e_next", "tank", 2.0, 2.0 / 50),
    ("storage dynamics", "e_next", "battery", 2.0, None),
    ("energy continuity", "e", "tank", 4.0, None),
    ("reported flow", "pf", "line", 1.0, 1.0 / 50),
    ("reported flow", "qt", "cable", 1.0, 1.0 / 50),
    ("branch rating", "va", "a", 30.0, None),
    ("angle difference", "va", "a", 30.0, None),
]


@pytest.mark.parametrize(("family", "quantity", "component", "amount", "expected"), PLANTED)
def test_a_planted_violation_is_found(
    solved, family: str, quantity: str, component: str, amount: float, expected
):
    grid, data = solved
    wrong = data.copy(deep=True)
    dimension = wrong[quantity].dims[1]
    wrong[quantity].loc[{dimension: component, "time": 2.0}] += amount
    found = check(grid, wrong, SERIES).violations[family]
    assert found.value > 1e-3
    assert found.time in (1.0, 2.0, 3.0)
    if expected is not None:
        assert found.value == pytest.approx(expected, rel=0.35)


def test_a_missing_number_is_a_violation(solved: tuple[om.Network, xr.Dataset]) -> None:
    grid, data = solved
    wrong = data.copy(deep=True)
    wrong["vm"][2, 0] = np.nan
    assert check(grid, wrong, SERIES).max_violation == np.inf


def test_the_demand_is_taken_from_the_declaration_not_from_the_plan(solved) -> None:
    grid, data = solved
    assert check(grid, data).violations["active balance"].value > 1e-2  # without the series


def test_the_ramp_from_the_dispatch_before(solved: tuple[om.Network, xr.Dataset]) -> None:
    grid, data = solved
    first = float(data["pg"].sel(generator="cheap")[0])
    report = check(grid, data, SERIES, previous_pg={"cheap": first - 20, "dear": 0.0})
    assert report.violations["ramp"].value == pytest.approx(5 / 50)


def test_losses_are_generation_minus_demand_minus_charging_minus_shunts(solved) -> None:
    grid, data = solved
    balance = (
        data["pg"].sum("generator")
        - data["pd"].sum("bus")
        - data["ps"].sum("storage")
        - grid.capacitor.g * data["vm"].sel(bus="d") ** 2
    )
    assert losses(grid, data) == pytest.approx(balance.values, abs=1e-5)
    assert losses(grid, data).min() > 0


def test_reactive_power_counts_where_there_is_no_generator() -> None:
    grid = om.Network("off grid")
    grid.bus = om.Bus()
    grid.cell = om.Storage("bus", energy=100, power=20, q=50)
    grid.town = om.Load("bus", p=10, q=5)
    data = om.MultiStage(grid, 2, objective=om.StateOfChargeTracking()).solve().data
    assert check(grid, data).max_violation < 1e-6
    data["qs"][1] += 3.0
    assert check(grid, data).violations["reactive balance"].value == pytest.approx(0.03, abs=1e-6)
    assert losses(grid, data).tolist() == [0.0, 0.0]


def test_costs_of_all_kinds(solved: tuple[om.Network, xr.Dataset]) -> None:
    grid, data = solved
    cheap, dear = (data["pg"].sel(generator=g).values for g in ("cheap", "dear"))
    expected = 0.02 * cheap**2 + 12 * cheap + 5 + np.interp(dear, [0, 20, 50], [0, 500, 1700])
    assert economic_cost(grid, data, SERIES) == pytest.approx(expected, rel=1e-6)
