"""The paths that programs and plugins import from."""

from __future__ import annotations

import importlib

import pytest

import opfmodel

PATHS = {
    "opfmodel.components": (
        "BUILT_IN Branch Budget Bus Component Connection Cost DCLine FlexibleLoad Generator Load "
        "Network PiecewiseLinear Polynomial Renewable Reserve Shunt Storage adjustable at_bus "
        "choice flag in_service number points span weights"
    ),
    "opfmodel.network": (
        "Array Branch Budget Bus Component Connection Cost DCLine FlexibleLoad Generator Index Load "
        "Network PerUnitNetwork PiecewiseLinear Polynomial Renewable Reserve Shunt Storage Table "
        "adjustable at_bus choice flag number per_unit points read_network span weights "
        "write_network"
    ),
    "opfmodel.model": (
        "Bound BoundSource Device Elastic Injection Model NumericStage Price Published Quantities Stage State"
    ),
    "opfmodel.check": "Report Violation check economic_cost losses",
    "opfmodel.simulation": "Controller NominalPlant Plant PowerFlow Redispatch Run simulate",
    "opfmodel.scenario": "Scenario load_scenario",
    "opfmodel.plan": "End MultiStage Plan",
    "opfmodel.results": "dataset load save",
    "solvers": "Program Solution largest solve total",
}


@pytest.mark.parametrize("module", PATHS)
def test_the_public_paths_import(module: str) -> None:
    home = importlib.import_module(module)
    missing = [name for name in PATHS[module].split() if not hasattr(home, name)]
    assert missing == []


def test_a_component_is_one_class_under_every_path() -> None:
    old, new = importlib.import_module("opfmodel.components"), importlib.import_module("opfmodel.network")
    for name in ("Bus", "Component", "Network", "Storage"):
        assert getattr(old, name) is getattr(new, name)
    assert opfmodel.Network is new.Network


def test_every_name_of_the_stub_is_there() -> None:
    assert {name for name in opfmodel.__all__ if getattr(opfmodel, name, None) is None} == set()
