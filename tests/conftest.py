"""Grids and helpers that several tests share."""

from __future__ import annotations

import csv
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from distributions import install
from hypothesis import settings

import opfmodel as om
from opfmodel import cli

os.environ.setdefault("NUMBA_DISABLE_JIT", "1")  # compiling pandapower takes longer than running it

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in background jobs of a shell; tests press Ctrl-C
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Machines are shared and noisy: no deadline. Every run draws other examples.
settings.register_profile("opfmodel", deadline=None, max_examples=20)
settings.register_profile("thorough", deadline=None, max_examples=200)  # --hypothesis-profile thorough
if settings.get_current_profile_name() != "thorough":
    settings.load_profile("opfmodel")


def examples(number: int) -> settings:
    """Limit the examples of an expensive property; ten times as many in the profile ``thorough``."""
    return settings(max_examples=number * settings.default.max_examples // 20)


collect_ignore = ["plugins"]  # a distribution of its own, which test_plugins installs

DATA = Path(__file__).parent / "data"
ROOT = Path(__file__).parent.parent
SCENARIOS = ROOT / "scenarios"

Call = Callable[..., tuple[int, str, str]]


def two_bus() -> om.Network:
    """The smallest grid with a line, a generator, a load and a storage."""
    grid = om.Network("two-bus", base_mva=100)
    grid.north = om.Bus(vm=(0.95, 1.05), reference=True)
    grid.south = om.Bus(vm=(0.95, 1.05))
    grid.tie = om.Branch("north", "south", r=0.01, x=0.1, rating=120)
    grid.coal = om.Generator("north", p=(0, 200), q=(-80, 80), ramp=20, cost=om.Polynomial(0.01, 15, 0))
    grid.cell = om.Storage("south", energy=200, power=10, q=(-10, 10))
    grid.town = om.Load("south", p=90, q=30)
    return grid


def everything() -> om.Network:
    """A grid with one of every feature: taps, shifts, charging, limits, all costs, lossy storage."""
    grid = om.Network("everything", base_mva=50)
    for name in "abcd":
        grid.add(name, om.Bus(vm=(0.9, 1.1), reference=name == "b"))
    grid.line = om.Branch("a", "b", r=0.01, x=0.08, b=0.04, rating=60, angle=(-25, 25))
    grid.transformer = om.Branch("b", "c", r=0.002, x=0.05, tap=0.97, shift=3, rating=70)
    grid.cable = om.Branch("c", "d", r=0.02, x=0.06, b=0.2, g=0.001, b_from=0.01, b_to=0.02)
    grid.ring = om.Branch("a", "d", r=0.03, x=0.11, b=0.02, g_from=0.002, rating=40, angle=(-20, 30))
    grid.cheap = om.Generator("a", p=(5, 60), q=(-30, 30), ramp=15, cost=om.Polynomial(0.02, 12, 5))
    grid.dear = om.Generator(
        "c", p=(0, 50), q=(-25, 25), cost=om.PiecewiseLinear([(0, 0), (20, 500), (50, 1700)])
    )
    grid.battery = om.Storage(
        "d",
        energy=40,
        power=(-12, 10),
        q=8,
        charge_efficiency=0.92,
        discharge_efficiency=0.95,
        standing_loss=0.002,
        rating=11,
        initial=15,
    )
    grid.tank = om.Storage("b", energy=30, power=6, q=3, energy_min=3)
    grid.town = om.Load("b", p=40, q=12)
    grid.mill = om.Load("d", p=25, q=8)
    grid.sun = om.Load("c", p=-6, q=1)
    grid.capacitor = om.Shunt("d", g=0.4, b=9)
    return grid


def demand(steps: int, seed: int = 1) -> dict[str, np.ndarray]:
    """A demand that moves, for the grid of :func:`everything`."""
    noise = np.random.default_rng(seed).normal(0, 0.05, (2, steps))
    wave = 1 + 0.25 * np.sin(2 * np.pi * np.arange(steps) / 12)
    return {
        "town.p": 40 * (wave + noise[0]),
        "town.q": 12 * (wave + noise[0]),
        "mill.p": 25 * (wave + noise[1]),
        "mill.q": 8 * (wave + noise[1]),
    }


def pglib_baseline() -> dict[str, dict[str, str]]:
    """Published reference values by case."""
    with (DATA / "pglib" / "baseline.csv").open() as stream:
        return {row["case"]: row for row in csv.DictReader(stream)}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest of the slow tests, which would else keep one process at the end."""
    items.sort(
        key=lambda item: -max((m.kwargs.get("minutes", 0) for m in item.iter_markers("slow")), default=0)
    )


@pytest.fixture(scope="session")
def example_plugins(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder into which the distribution of ``tests/plugins`` is installed."""
    target = tmp_path_factory.mktemp("site")
    install(ROOT / "tests" / "plugins", target)
    return target


@pytest.fixture
def grid() -> om.Network:
    return two_bus()


@pytest.fixture
def rich_grid() -> om.Network:
    return everything()


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Call:
    """Run a command in this process: exit status, standard output, standard error."""

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["opfmodel", *map(str, arguments)])
        with pytest.raises(SystemExit) as stop:
            cli.main()
        out, err = capsys.readouterr()
        return int(stop.value.code or 0), out, err

    return run
