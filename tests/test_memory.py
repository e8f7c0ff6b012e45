"""Sizes: a problem that does not fit into memory is refused before anything is allocated."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import SCENARIOS, two_bus

import opfmodel as om
from opfmodel.errors import ScenarioError, SizeError
from opfmodel.forecasts import Noisy
from opfmodel.plan import memory
from opfmodel.plan.memory import check_memory, machine_bytes, problem_bytes

CASE5 = SCENARIOS / "case5-step.yaml"
BILLION = 10**9


@pytest.fixture
def laptop(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "machine_bytes", lambda: 8 * 10**9)


def test_what_fits_is_accepted(laptop: None) -> None:
    check_memory("this", 8 * 10**9)
    with pytest.raises(SizeError, match="this: needs about 9 GB of memory; this machine has 8 GB"):
        check_memory("this", 9 * 10**9)


@pytest.mark.parametrize("horizon", [BILLION, np.int64(BILLION), 10**30])
@pytest.mark.parametrize("formulation", ["ac", "dc", "copperplate"])
def test_a_horizon_in_python(laptop: None, horizon: int, formulation: str) -> None:
    with pytest.raises(SizeError, match=f"horizon = {horizon:,}: needs about"):
        om.MultiStage(two_bus(), horizon, formulation=formulation)


def test_steps_in_python(laptop: None) -> None:
    with pytest.raises(SizeError, match="steps = 1,000,000,000: needs about"):
        om.simulate(om.MultiStage(two_bus()), steps=BILLION)


@pytest.mark.parametrize(
    ("key", "message"),
    [
        ("time.steps", "overrides: time.steps: 1,000,000,000: needs about"),
        ("controller.horizon", "overrides: controller.horizon: 1,000,000,000 with 49 steps: needs about"),
    ],
)
def test_a_scenario(laptop: None, key: str, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        om.load_scenario(CASE5, overrides={key: BILLION})


def test_a_problem_that_is_larger_than_its_series(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "machine_bytes", lambda: 8 * 10**8)
    with pytest.raises(ScenarioError, match="controller: horizon = 100,000: needs about"):
        om.load_scenario(CASE5, overrides={"controller.horizon": 10**5})


def test_nothing_is_allocated_before(tmp_path: Path) -> None:
    """A process limited to 4 GB stands for a small machine."""
    script = (
        "import json, resource, sys; resource.setrlimit(resource.RLIMIT_AS, (4 * 10**9, 4 * 10**9))\n"
        "from opfmodel import cli\n"
        "for command in json.loads(sys.argv[1]):\n"
        "    sys.argv = ['opfmodel', *command]\n"
        "    try:\n"
        "        cli.main()\n"
        "    except SystemExit as stop:\n"
        "        print('exit', stop.code, file=sys.stderr)\n"
    )
    commands = (
        ("validate", CASE5, "--set", f"time.steps={BILLION}"),
        ("run", CASE5, "--out", tmp_path, "--set", f"controller.horizon={BILLION}"),
        ("solve", CASE5, "--horizon", BILLION),
        ("solve", SCENARIOS / "data" / "case118.m", "--horizon", BILLION),
    )
    stated = json.dumps([[str(word) for word in command] for command in commands])
    done = subprocess.run(
        [sys.executable, "-c", script, stated], capture_output=True, text=True, check=False, timeout=120
    )
    *said, nothing = done.stderr.split("exit 2\n")
    assert (done.returncode, len(said), nothing) == (0, len(commands), ""), done.stderr
    for text in said:
        assert text.count("error: ") == 1
        assert "of memory; this machine has 4 GB" in text


def test_sizes_that_are_usual_are_accepted() -> None:
    om.MultiStage(two_bus(), 8760)
    assert problem_bytes(589, 48, reactive=True) == pytest.approx(48 * 2.0e6, rel=0.1)  # as measured
    assert problem_bytes(589, 768, reactive=False) == pytest.approx(459e6, rel=0.1)


def test_the_memory_of_the_machine_and_of_its_container(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    limit = tmp_path / "memory.max"
    monkeypatch.setattr(memory, "_LIMITS_OF_CONTAINERS", (str(limit),))
    whole = machine_bytes()
    assert 10**9 < whole < 10**14
    for text, expected in (("max\n", whole), ("500000000\n", 500_000_000)):
        limit.write_text(text)
        assert machine_bytes() == expected
    monkeypatch.setattr(memory, "_physical", lambda: None)
    monkeypatch.setattr(memory, "_limit_of_process", lambda: None)
    limit.unlink()
    assert machine_bytes() == 32 * 10**9


def test_noise_needs_no_more_memory_than_the_horizon() -> None:
    actual = om.Profiles({"town.p": np.ones(200_000)})
    assert Noisy(0.1, seed=1).expected(actual, 0, 200_000)["town.p"].shape == (200_000,)
