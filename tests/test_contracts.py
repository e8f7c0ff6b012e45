"""Every plugin of this package and of ``tests/plugins`` satisfies its contract."""

from __future__ import annotations

import configparser
from collections.abc import Iterator
from pathlib import Path

import pytest
from conftest import ROOT
from distributions import visible

import opfmodel as om
import solvers
from opfmodel import plugins
from opfmodel.network import Component
from opfmodel.objectives.setpoint_tracking import Setpoints
from opfmodel.testing import (
    check_back_end,
    check_device,
    check_forecast,
    check_formulation,
    check_objective,
    check_plant,
    check_profile,
)

CONFIG = configparser.ConfigParser()
CONFIG.read(ROOT / "tests" / "plugins" / "setup.cfg")


def names(sort: str) -> list[str]:
    """Return the names of the plugins of this package and of ``tests/plugins``."""
    group = plugins.GROUPS.get(sort, "solvers.backends")
    own = (
        [p.name for p in plugins.plugins(sort).values()] if sort in plugins.GROUPS else [*solvers.back_ends()]
    )
    lines = CONFIG["options.entry_points"][group].strip().splitlines()
    return [*own, *(line.partition("=")[0].strip() for line in lines)]


# Required options, and options worth checking, for the grid of the contract.
OPTIONS: dict[tuple[str, str], dict[str, object]] = {
    ("objective", "economic"): {"reactive_weight": 0.1, "energy_weight": 0.2},
    ("objective", "emissions"): {"factors": {"coal": 0.9, "gas": 0.4}, "price": 30.0, "limit": 20.0},
    ("objective", "linear-quadratic"): {
        "Q": {"pg": 2.0, "e": [[1.0, 0.5], [0.5, 1.0]]},
        "R": {"ps": 0.1},
        "q": {"pg": [3.0, 4.0]},
    },
    ("objective", "setpoint-tracking"): {"setpoints": Setpoints({"coal.pg": [20, 30, 40], "tank.e": 10})},
    ("objective", "stored-energy-value"): {"price": 30.0},
    ("profile", "noise"): {"deviation": 0.1, "correlation": 0.5, "seed": 1},
    ("profile", "power-factor"): {"value": 0.9, "loads": ["town"]},
    ("profile", "shape"): {"file": "series.csv", "column": "wind", "loads": ["town"]},
    ("profile", "scale"): {"factor": 1.1, "loads": ["mill"]},
    ("profile", "step"): {"loads": ["town"], "first": 2, "last": 3, "add": 4.0},
    ("profile", "table"): {"file": "series.csv"},
    ("forecast", "noisy"): {"deviation": 0.1, "seed": 3},
    ("plant", "power-flow"): {"participation": {"coal": 1.0, "gas": 2.0}},
    ("plant", "redispatch"): {"price": 50.0},
    ("plant", "inexact"): {"deviation": 0.03, "seed": 2},
    ("profile", "repeat"): {"component": "coal", "field": "p_max", "values": [50.0, 60.0, 70.0]},
}


EXAMPLES = {
    "generator": lambda: om.Generator(
        "x", p=(0, 30), q=(-5, 5), ramp=4, cost=om.PiecewiseLinear(((0, 0), (10, 200), (30, 900))),
        capability=((0, -5), (30, -3), (30, 3), (0, 5)),
    ),
    "storage": lambda: om.Storage(
        "x", energy=10, energy_min=6, initial=5, power=2, q=1, rating=2,
        capability=((-2, -0.5), (0, -1), (2, -0.5), (2, 1), (-2, 1)), charge_efficiency=0.9, standing_loss=0.01,
        throughput_cost=2, wanted=8, wanted_at=2, wanted_every=2, recovery_cost=90,
    ),
    "load": lambda: om.Load("x", p=3, q=1, shed_cost=40),
    "flexible_load": lambda: om.FlexibleLoad(
        "x", energy=2, power=(0, 2), hours=1, every=3, efficiency=0.9, power_factor=0.95, unserved_cost=50
    ),
    "renewable": lambda: om.Renewable(
        "x", available=3, q=(-2, 2), power_factor=0.9, rating=3.1, curtail_cost=5,
        capability=((0, -2), (4, -2), (4, 1), (2, 2), (0, 2)),
    ),
    "connection": lambda: om.Connection(
        "x", p=(-4, 20), q=(-5, 5), buy=50, sell=20, peak_cost=300, peak_hours=2, peak=1
    ),
    "dc_line": lambda: om.DCLine(
        "x", "y", p=(-6, 9), loss=0.05, loss_fixed=0.2, q_from=(-2, 3), q_to=1, cost=1.5
    ),
    "reserve": lambda: om.Reserve(
        5, "down", hours=0.5, units={"slack": 30}, cost={"slack": 2}, lacking_cost=400
    ),
    "budget": lambda: om.Budget(amount=9, uses={"slack": 0.5}, hours=2, left=6, over_cost=3),
}  # fmt: skip


def example(kind: str) -> Component:
    """Return a component of a kind with as many features as possible."""
    if kind == "fleet":
        from example_plugins.fleet import Fleet

        return Fleet("x", power=3, energy=10, energy_min=1, initial=4, driving=0.5, wear=2.0)
    return EXAMPLES[kind]()


@pytest.fixture(autouse=True)
def installed(example_plugins: Path) -> Iterator[None]:
    with visible(example_plugins):
        yield


@pytest.mark.parametrize("name", names("objective"))
def test_an_objective_satisfies_its_contract(name: str) -> None:
    check_objective(plugins.make("objective", name, OPTIONS.get(("objective", name), {})))


@pytest.mark.parametrize("name", names("formulation"))
def test_a_formulation_satisfies_its_contract(name: str) -> None:
    formulation = plugins.load("formulation", name)()
    assert formulation.name == name
    check_formulation(formulation)


@pytest.mark.parametrize("name", names("device"))
def test_a_device_satisfies_its_contract(name: str) -> None:
    device = plugins.load("device", name)()
    assert device.component.kind == name
    check_device(device, example(name))


@pytest.mark.parametrize("name", names("profile"))
def test_a_profile_rule_satisfies_its_contract(name: str, tmp_path: Path) -> None:
    (tmp_path / "series.csv").write_text(
        "wind,town.p,coal.p_max\n" + "".join(f"{k + 1},{k},9\n" for k in range(24))
    )
    check_profile(plugins.make("profile", name, OPTIONS.get(("profile", name), {})), folder=tmp_path)


@pytest.mark.parametrize("name", names("forecast"))
def test_a_forecast_satisfies_its_contract(name: str, tmp_path: Path) -> None:
    file = tmp_path / "forecast.csv"
    file.write_text("town.p,town.q\n" + "".join(f"{30 + k},{8 + k}\n" for k in range(24)))
    options = {"file": file} if name == "file" else OPTIONS.get(("forecast", name), {})
    check_forecast(plugins.make("forecast", name, options))


@pytest.mark.parametrize("name", names("plant"))
def test_a_plant_satisfies_its_contract(name: str) -> None:
    check_plant(plugins.make("plant", name, OPTIONS.get(("plant", name), {})))


@pytest.mark.parametrize("name", names("back end"))
def test_a_back_end_satisfies_its_contract(name: str) -> None:
    end = solvers.back_ends()[name]
    assert end.name == name
    check_back_end(end)


def test_plugins_of_all_kinds_are_found() -> None:
    assert len(names("formulation")) >= 8
    for sort in (*plugins.GROUPS, "back end"):
        assert len(names(sort)) >= 2
