"""Small grids for contract checks, and time series for them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from opfmodel.horizon import Horizon
from opfmodel.network.components import Branch, Bus, Generator, Load, Shunt, Storage
from opfmodel.network.costs import PiecewiseLinear, Polynomial
from opfmodel.network.network import Network

__all__ = ["EDGE_GRIDS", "HORIZONS", "demand", "feeder", "ring"]

Array = npt.NDArray[np.float64]

HORIZONS = (
    Horizon.chain(1),
    Horizon.chain(3),
    Horizon.tree([1, 2], {"low": 0.4, "high": 0.6}, common=1),
)
"""Horizons on which every device and objective must work."""


def feeder(name: str = "feeder") -> Network:
    """Build a radial grid with all built-in devices: both kinds of cost, ideal and lossy storage, a shunt."""
    grid = Network(name, base_mva=50)
    for bus in ("station", "street", "close"):
        grid.add(bus, Bus(vm=(0.9, 1.1), reference=bus == "station"))
    grid.add("cable", Branch("station", "street", r=0.01, x=0.04, rating=60))
    grid.add("line", Branch("street", "close", r=0.02, x=0.05, rating=50, angle=(-30, 30)))
    grid.add("coal", Generator("station", p=(0, 80), q=(-60, 60), ramp=60, cost=Polynomial(0.02, 15, 5)))
    points = ((0, 0), (20, 800), (40, 1800))
    grid.add("gas", Generator("close", p=(0, 40), q=(-40, 40), cost=PiecewiseLinear(points)))
    grid.add("tank", Storage("street", energy=40, power=8, q=6))
    grid.add(
        "battery",
        Storage(
            "close",
            energy=20,
            power=6,
            q=5,
            rating=7,
            charge_efficiency=0.9,
            discharge_efficiency=0.95,
            standing_loss=0.01,
        ),
    )
    grid.add("town", Load("street", p=30, q=8))
    grid.add("mill", Load("close", p=20, q=6))
    grid.add("capacitor", Shunt("close", g=0.2, b=2))
    return grid


def ring() -> Network:
    """Build the feeder with a branch that closes a loop."""
    grid = feeder("ring")
    grid.add("tie", Branch("station", "close", r=0.03, x=0.09, rating=40))
    return grid


def _unrated() -> Network:
    grid = feeder()
    for name in ("cable", "line"):
        grid.update(name, rating=None, angle=(-360, 360))
    return grid


def _no_shunts() -> Network:
    grid = feeder()
    grid.remove("capacitor")
    return grid


def _no_branches() -> Network:
    grid = Network("no-branches")
    grid.add("here", Bus())
    grid.add("unit", Generator("here", p=(0, 50), q=(-20, 20), cost=Polynomial(0.01, 20, 0)))
    grid.add("town", Load("here", p=30, q=5))
    return grid


def _islands() -> Network:
    grid = feeder()
    grid.add("isle", Bus())
    grid.add("shore", Bus())
    grid.add("sea-cable", Branch("isle", "shore", r=0.01, x=0.05))
    grid.add("hydro", Generator("isle", p=(0, 30), q=(-20, 20), cost=Polynomial(0.0, 5, 0)))
    grid.add("village", Load("shore", p=9, q=2))
    return grid


def _out_of_service() -> Network:
    grid = feeder()
    grid.add("dark", Bus(in_service=False))
    grid.add("dead", Branch("close", "dark", r=0.01, x=0.1))
    grid.add("spare", Branch("station", "close", r=0.01, x=0.1, in_service=False))
    grid.add("old", Generator("street", p=(5, 9), in_service=False))
    return grid


EDGE_GRIDS: dict[str, Callable[[], Network]] = {
    "branches without ratings": _unrated,
    "no shunts": _no_shunts,
    "no branches": _no_branches,
    "islands": _islands,
    "equipment out of service": _out_of_service,
}


def demand(steps: int = 4) -> dict[str, Array]:
    """Return time series of demand, a cost and a rating for :func:`feeder`."""
    wave = 1.0 + 0.2 * np.sin(np.arange(steps))
    return {
        "town.p": 30 * wave,
        "town.q": 8 * wave,
        "coal.c1": 15 + 5 * wave,
        "line.rating": np.where(np.arange(steps) % 2, 12.0, 50.0),
    }
