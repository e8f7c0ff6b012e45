"""The paths that programs and plugins import from."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from importlib.metadata import requires
from pathlib import Path

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


CASE14 = Path(__file__).parent / "data" / "pglib" / "pglib_opf_case14_ieee.m"
NEEDED = {"casadi", "numpy", "opfmodel", "powerio", "scipy", "solvers", "typer"}
"""What ``opfmodel solve`` of a network file takes, of the packages that opfmodel requires."""

LARGE = ("scipy.linalg", "scipy.optimize", "scipy.special", "scipy.sparse.linalg", "opfmodel.analysis")
"""Large parts of these packages that it does without."""


def test_to_solve_a_network_file_imports_only_what_it_needs() -> None:
    script = """
import sys
from opfmodel.cli import main
try:
    main()
except SystemExit as stop:
    print(stop.code, *sys.modules)
"""
    done = subprocess.run(
        [sys.executable, "-c", script, "solve", str(CASE14)], capture_output=True, text=True, check=True
    )
    status, *modules = done.stdout.splitlines()[-1].split()
    assert status == "0"
    required = {re.split(r"\W", line.replace("-", "_"))[0].lower() for line in requires("opfmodel") or ()}
    packages = {"pyyaml": "yaml"}
    unneeded = {packages.get(name, name) for name in required} - NEEDED - {"lazy_loader", "pydantic"}
    assert {"xarray", "networkx", "matplotlib", "yaml", "rich"} <= unneeded
    assert unneeded.isdisjoint(modules)
    assert {"pandas", *LARGE}.isdisjoint(modules)
    assert set(modules) >= NEEDED
