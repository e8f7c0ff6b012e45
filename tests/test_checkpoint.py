"""Runs that resume: kills at random moments, what belongs to a checkpoint, and what is refused."""

from __future__ import annotations

import errno
import io
import json
import os
import pty
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from conftest import SCENARIOS, two_bus
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import opfmodel as om
from opfmodel.data.archive import packed, unpacked
from opfmodel.errors import ResultError, ResultWarning
from opfmodel.forecasts.noisy import Noisy
from opfmodel.simulation import Run, checkpoint, inputs
from opfmodel.simulation.inputs import digest
from solvers.interrupt import deferred, interruptible

# A ring whose line trips, with a budget, a tree of noisy forecasts, and a plant that redispatches.
RING = """
network:
  buses: {a: {reference: true}, b: {}, c: {}}
  branches:
    ab: {from_bus: a, to_bus: b, r: 0.01, x: 0.1, rating: 120}
    bc: {from_bus: b, to_bus: c, r: 0.01, x: 0.1, rating: 120}
    ac: {from_bus: a, to_bus: c, r: 0.01, x: 0.1, rating: 120}
  generators:
    coal: {bus: a, p: [0, 150], q: [-90, 90], ramp: 40, cost: {c1: 20, c2: 0.01}}
    gas: {bus: c, p: [0, 120], q: [-90, 90], ramp: 60, cost: {c1: 50}}
  loads:
    town: {bus: b, p: 80, q: 20, shed_cost: 3000}
  storages:
    cell: {bus: b, energy: 60, power: 15, q: 10, discharge_efficiency: 0.95}
  budgets:
    limit: {amount: 500, uses: {coal: 1}, hours: 6, over_cost: 5}
time: {steps: 5}
profiles:
  - step: {loads: [town], first: 1, last: 3, factor: 1.3}
controller:
  horizon: 3
  on_infeasible: elastic
  scenarios: {common: 1, draw: {number: 20, keep: 2, seed: 1}}
forecast: {noisy: {deviation: 0.04, seed: 5}}
plant: {mode: redispatch, outages: [{branch: ab, step: 2, hours: 1}], known: 1}
"""
CHAIN: dict[str, Any] = {"controller.scenarios": None, "plant.outages": []}
LOOPS = {
    "redispatch": {},
    "power flow": {**CHAIN, "plant.mode": "power-flow", "time.at_end": "shrink"},
    "osqp": {
        "file": SCENARIOS / "case5-step.yaml",
        "time.steps": 5,
        "controller.formulation": "dc",
        "controller.solver": "osqp",
    },
    "elastic": {**CHAIN, "controller.limits": "soft", "network.loads.town.p": 260},
    "secured": {
        "file": SCENARIOS / "case5-outage.yaml",
        "profiles": [],
        "time.steps": 5,
        "controller.horizon": 3,
        "controller.security": {"contingencies": "all", "rating": 1.2},
    },
}


@pytest.fixture
def ring(tmp_path: Path) -> Callable[..., om.Scenario]:
    path = tmp_path / "ring.yaml"
    path.write_text(RING)
    return lambda file=path, **changes: om.load_scenario(file, overrides=changes)


def same(one: Run, other: Run) -> bool:
    """Whether two runs have the same steps, to the last bit, and took the same iterations."""
    return len(one.steps) == len(other.steps) and all(
        (mine.values.keys(), mine.status, mine.solved) == (theirs.values.keys(), theirs.status, theirs.solved)
        and all(np.array_equal(v, theirs.values[key], equal_nan=True) for key, v in mine.values.items())
        and all(np.array_equal(v, theirs.state[key]) for key, v in mine.state.items())
        and plan["iterations"] == again["iterations"]
        for mine, theirs, plan, again in zip(one.steps, other.steps, one.plans, other.plans, strict=True)
    )


def stop_after(steps: int) -> Callable[[Run], None]:
    def press(run: Run) -> None:
        if len(run.steps) == steps:
            raise KeyboardInterrupt

    return press


@pytest.mark.parametrize(
    "name", ["redispatch", *(pytest.param(name, marks=pytest.mark.slow) for name in [*LOOPS][1:])]
)
def test_a_run_that_is_resumed_is_the_same(
    name: str, ring: Callable[..., om.Scenario], tmp_path: Path
) -> None:
    def run(steps: int | None = None, **options: Any) -> tuple[Run, bytes]:
        """Make everything anew, as in another process; return what is remembered at the end, too."""
        loop = ring(**LOOPS[name]).loop()
        done = om.simulate(**loop, on_step=None if steps is None else stop_after(steps), **options)
        return done, packed({part: loop[part].memory() for part in ("controller", "plant")})

    whole, remembered = run()
    assert whole.status == "done"
    assert run(3, checkpoint=tmp_path / "kept")[0].status == "stopped"
    resumed, again = run(checkpoint=tmp_path / "kept")
    assert same(whole, resumed)
    assert again == remembered
    assert (resumed.status, resumed.cost) == ("done", whole.cost)
    both = [{k: v for k, v in each.summary().items() if "seconds" not in k} for each in (whole, resumed)]
    assert both[0] == both[1]


def test_a_run_that_was_complete_is_returned_without_a_solve(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = om.simulate(town(), steps=3, checkpoint=tmp_path)
    monkeypatch.setattr(om.Controller, "plan", None)
    second = om.simulate(town(), steps=3, checkpoint=tmp_path)
    assert (second.status, same(first, second)) == ("done", True)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["osqp", "secured"])
def test_a_run_that_is_repeated_is_the_same(name: str, ring: Callable[..., om.Scenario]) -> None:
    loop = ring(**LOOPS[name]).loop()
    first, second = (om.simulate(**loop | {"steps": 3}) for _ in range(2))
    assert same(first, second)


# Kills ----------------------------------------------------------------------------------------------


def child(work: Callable[[], None]) -> int:
    """Start a copy of this process that does some work and ends."""
    pid = os.fork()
    if pid == 0:
        try:
            for number in (signal.SIGTERM, signal.SIGHUP):
                signal.signal(number, signal.default_int_handler)
            work()
            os._exit(0)
        finally:
            os._exit(1)
    return pid


def kill_after(pid: int, seconds: float, number: signal.Signals) -> int:
    """Send a signal to a process that has used some seconds of a processor; return how it ended."""
    process = psutil.Process(pid)
    while process.status() != psutil.STATUS_ZOMBIE:
        used = process.cpu_times()
        if used.user + used.system >= seconds:
            os.kill(pid, number)
            break
        time.sleep(0.005)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


@pytest.mark.slow
def test_twenty_kills_lose_nothing(ring: Callable[..., om.Scenario], tmp_path: Path) -> None:
    kept, log, moments = om.Checkpoint(tmp_path / "kept", steps=2), tmp_path / "log", random.Random(1)
    scenario = ring(**{"time.steps": 80})
    loop, began, ends = scenario.loop(), time.process_time(), list[float]()
    # what is compiled here is so in all processes, which therefore are killed in the midst of their steps
    whole = om.simulate(**loop, on_step=lambda _: ends.append(time.process_time() - began))
    step = (ends[-1] - ends[0]) / 79  # in seconds of a processor

    def run() -> None:
        with log.open("ab", buffering=0) as file:
            done = om.simulate(**loop, checkpoint=kept, on_step=lambda r: file.write(bytes([len(r.steps)])))
        assert done.status == ("stopped" if done.interrupted else "done")

    statuses, reached = [], 0
    for _ in range(20):
        number = moments.choice([signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGHUP])
        statuses.append(kill_after(child(run), moments.uniform(0.0, 6 * step), number))
        told = max(log.read_bytes() if log.exists() else b"", default=0)
        held = len(saved.steps) if (saved := kept.load()) else 0
        assert held >= told - 1  # one step may have followed the last checkpoint
        assert held >= reached
        reached = held
    assert statuses.count(-signal.SIGKILL) >= 5
    assert 4 < reached < 80  # the kills came in the midst of it
    assert same(om.simulate(**loop, checkpoint=kept), whole)


@pytest.mark.parametrize("number", [1, 2, 3, 4, 5, 8, 11])
@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_a_kill_in_the_midst_of_writing_loses_nothing(
    call: str, number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept, log, problem = om.Checkpoint(tmp_path / "kept", steps=1), tmp_path / "log", town()
    problem.compile()
    original, left = getattr(os, call), iter(range(number - 1, -1, -1))

    def killed(*arguments: Any, **options: Any) -> None:  # at the last moment before
        if next(left) == 0:
            os.kill(os.getpid(), signal.SIGKILL)
        original(*arguments, **options)

    def run() -> None:
        monkeypatch.setattr(os, call, killed)
        with log.open("ab", buffering=0) as file:
            om.simulate(problem, steps=5, checkpoint=kept, on_step=lambda _: file.write(b"."))

    assert os.waitstatus_to_exitcode(os.waitpid(child(run), 0)[1]) == -signal.SIGKILL
    saved, told = kept.load(), log.read_bytes() if log.exists() else b""
    assert (0 if saved is None else len(saved.steps)) >= len(told)


# Signals --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals_are_deferred(number: signal.Signals) -> None:
    before, done = signal.signal(number, signal.default_int_handler), []
    try:
        with pytest.raises(KeyboardInterrupt), deferred():
            signal.raise_signal(number)
            done.append("whole")
        assert (done, signal.getsignal(number)) == (["whole"], signal.default_int_handler)

        with pytest.raises(KeyboardInterrupt), interruptible():
            try:
                signal.raise_signal(number)
            except KeyboardInterrupt:
                raise RuntimeError("as CasADi turns it") from None
    finally:
        signal.signal(number, before)


def test_a_signal_during_saving_does_not_tear_a_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    replace, kept = checkpoint.replace, om.Checkpoint(tmp_path / "kept", steps=1)

    def pressed(contents: dict[Path, bytes]) -> None:
        if len(contents) == 2:
            signal.raise_signal(signal.SIGINT)
        replace(contents)

    monkeypatch.setattr(checkpoint, "replace", pressed)
    run = om.simulate(town(), steps=4, checkpoint=kept)
    assert (run.status, len(run.steps)) == ("stopped", 1)
    saved = kept.load()
    assert saved is not None
    assert len(saved.steps) == 1


# What is refused ------------------------------------------------------------------------------------


def town(cost: float = 20.0, demand: float = 60.0, **options: Any) -> om.MultiStage:
    grid = two_bus()
    grid.update("coal", cost=om.Polynomial(0.0, cost, 0.0))
    series = {"town.p": [demand, 80, 100, 100, 70, 60], "town.q": [20.0] * 6}
    return om.MultiStage(grid, 2, **{"formulation": "dc", "profiles": series, **options})


def constrained(most: float) -> om.MultiStage:
    made = town()
    made.constrain("cap", lambda stage: om.total(stage.generator.pg) <= most)
    return made


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"controller": town(cost=21.0)}, "network generators"),
        ({"controller": town(demand=61.0)}, "series p"),
        ({"controller": town(formulation="copperplate")}, "formulation"),
        ({"controller": town(at_end="shrink")}, "at end"),
        ({"controller": town(options={"max_iter": 77}, solver="clarabel")}, "solver, options"),
        ({"controller": constrained(400.0)}, "constraints"),
        ({"controller": om.Controller(town(), on_infeasible="elastic")}, "on infeasible"),
        (
            {"controller": om.Controller(town(), Noisy(0.1, seed=1)), "plant": om.PowerFlow()},
            "plant, forecast, expected",
        ),
        ({"plant": om.Redispatch()}, "plant"),
        ({"steps": 3}, "steps"),
        ({"objective": om.Economic(energy_weight=1.0)}, "cost"),
        ({"initial": {"pg": [60.0, 0.0]}}, "initial"),
    ],
    ids=lambda value: value if isinstance(value, str) else None,
)
def test_other_inputs_are_refused_by_name(change: dict[str, Any], named: str, stopped: Path) -> None:
    loop = {"controller": town(), "plant": om.NominalPlant(), "steps": 4} | change
    with pytest.raises(ResultError, match=f"of other inputs, which differ in {named}; ") as error:
        om.simulate(**loop, checkpoint=stopped)
    assert "\n" not in str(error.value)


def test_another_version_of_a_package_is_refused_by_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    om.simulate(town(), steps=1, checkpoint=tmp_path)
    module = sys.modules["opfmodel.simulation.inputs"]
    known = module.versions()
    monkeypatch.setattr(module, "versions", lambda: {**known, "casadi": "9.9"})
    with pytest.raises(ResultError, match="differ in package casadi;"):
        om.simulate(town(), steps=1, checkpoint=tmp_path)


def test_functions_count_by_their_code_and_data() -> None:
    def limit(most: float) -> Callable[[Any], Any]:
        return lambda stage: stage.pg <= most

    class Mine(om.Economic):
        pass

    class Other(om.Economic):
        def stage_cost(self, stage: Any) -> Any:
            return None

    Other.__qualname__ = Mine.__qualname__
    assert digest(limit(1.0)) == digest(limit(1.0)) != digest(limit(2.0))
    assert digest(Mine()) == digest(Mine()) != digest(Other())
    problem = town()
    before = digest((problem.formulation, problem.objective, problem.devices))
    problem.solve()  # what is cached does not count
    assert digest((problem.formulation, problem.objective, problem.devices)) == before
    assert digest({"a": [1, np.nan]}) == digest({"a": (1, np.nan)}) != digest({"a": [1, np.inf]})


LIMIT = 5.0


def _within(value: float) -> float:
    return LIMIT * value


def _of_helper(value: float) -> float:
    return _within(value) + 1.0


def test_functions_count_by_what_they_refer_to(monkeypatch: pytest.MonkeyPatch) -> None:
    before = digest(_within), digest(_of_helper)
    monkeypatch.setitem(globals(), "LIMIT", 7.0)
    assert digest(_within) != before[0]
    monkeypatch.setitem(globals(), "_within", lambda value: value)
    assert digest(_of_helper) != before[1]
    assert digest(np.sin) != digest(np.cos)
    assert digest(np.random.default_rng(1)) != digest(np.random.default_rng(2))


@pytest.mark.slow
def test_digests_are_the_same_in_every_process(ring: Callable[..., om.Scenario], tmp_path: Path) -> None:
    script = (
        "import json, opfmodel as om; from opfmodel.simulation import inputs; "
        "loop = om.load_scenario('ring.yaml').loop(); del loop['initial']; print(json.dumps(inputs(**loop)))"
    )
    found = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, capture_output=True, check=True
    ).stdout
    loop = ring().loop()
    del loop["initial"]
    assert json.loads(found) == inputs(**loop)
    assert {"steps", "network generators", "series p", "package casadi"} <= json.loads(found).keys()


# Files ----------------------------------------------------------------------------------------------

numbers = st.one_of(st.none(), st.booleans(), st.integers(-(2**70), 2**70), st.floats(), st.text())
vectors = arrays(st.sampled_from([np.float64, np.int64, np.bool_]), st.sampled_from([(0,), (3,), (2, 2), ()]))
nested = st.recursive(
    st.one_of(numbers, vectors),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3), st.dictionaries(st.text(max_size=3), inner, max_size=3)
    ),
    max_leaves=8,
)


def equal(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and one.shape == other.shape and one.tobytes() == other.tobytes()
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(equal(value, other[key]) for key, value in one.items())
    if isinstance(one, list):
        return len(one) == len(other) and all(map(equal, one, other))
    return type(one) is type(other) and (one == other or repr(one) == repr(other) == "nan")


@settings(max_examples=40, deadline=None)
@given(content=st.dictionaries(st.text(max_size=3), nested, max_size=4))
def test_what_is_packed_is_read_back_exactly(
    content: dict[str, Any], tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / "archive.npz"
    path.write_bytes(packed(content))
    assert equal(content, unpacked(path, "a test"))


def test_archives_take_no_objects(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="a PosixPath cannot be stored"):
        packed({"path": tmp_path})
    with pytest.raises(TypeError, match="arrays of object"):
        packed({"objects": np.array([tmp_path])})
    stream = io.BytesIO()
    np.savez(stream, content=np.array([print], dtype=object), numbers=np.zeros(1))  # pickled
    (tmp_path / "evil.npz").write_bytes(stream.getvalue())
    with pytest.raises(ResultError, match="not a checkpoint of opfmodel, or damaged: "):
        unpacked(tmp_path / "evil.npz", "a checkpoint")


@pytest.fixture(scope="module")
def stopped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stopped")
    om.simulate(town(), steps=4, on_step=stop_after(2), checkpoint=folder)
    return folder


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_damage_is_reported_in_one_line(stopped: Path, data: st.DataObject) -> None:
    kept = om.Checkpoint(stopped)
    path = stopped / data.draw(st.sampled_from(["state.npz", "steps-0.npz"]))
    before, whole = path.read_bytes(), kept.load()
    assert whole is not None
    at = data.draw(st.integers(0, len(before) - 1))
    flipped = before[:at] + bytes([before[at] ^ data.draw(st.integers(1, 255))]) + before[at + 1 :]
    try:
        path.write_bytes(data.draw(st.sampled_from([before[:at], flipped])))
        read = kept.load()
    except ResultError as error:
        assert str(error).startswith(str(stopped))
        assert "\n" not in str(error)
    else:  # a byte that means nothing
        assert read is not None
        assert packed(read._asdict() | {"steps": []}) == packed(whole._asdict() | {"steps": []})
    finally:
        path.write_bytes(before)


def test_a_missing_part_is_reported(tmp_path: Path) -> None:
    om.simulate(town(), steps=4, on_step=stop_after(2), checkpoint=tmp_path)
    (tmp_path / "steps-0.npz").unlink()
    with pytest.raises(ResultError, match=r"steps-0\.npz: no such file"):
        om.simulate(town(), steps=4, checkpoint=tmp_path)


def test_the_loop_goes_on_if_the_disk_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    replace, kept = checkpoint.replace, om.Checkpoint(tmp_path, steps=1)

    def full(contents: dict[Path, bytes]) -> None:
        if tmp_path / "steps-1.npz" in contents:
            raise OSError(errno.ENOSPC, "No space left on device")
        replace(contents)

    monkeypatch.setattr(checkpoint, "replace", full)
    with pytest.warns(ResultWarning, match="No space left on device; it holds the first 1 steps") as warned:
        run = om.simulate(town(), steps=4, checkpoint=kept)
    assert (run.status, len(warned)) == ("done", 1)
    monkeypatch.undo()
    saved = kept.load()
    assert saved is not None
    assert len(saved.steps) == 1
    assert same(om.simulate(town(), steps=4, checkpoint=kept), run)


def test_a_folder_that_cannot_be_written_is_reported_before_the_loop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(om.Controller, "plan", None)
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(ResultError, match="the checkpoint cannot be written: "):
        om.simulate(town(), steps=2, checkpoint=tmp_path / "file")


@pytest.mark.parametrize(
    ("often", "files"),
    [
        ({"steps": 2}, [0, 2, 4]),
        ({"seconds": 0.0}, [0, 1, 2, 3, 4]),
        ({"steps": 3, "seconds": 1e6}, [0, 3]),
        ({}, [0]),
    ],
)
def test_how_often_checkpoints_are_written(often: dict[str, Any], files: list[int], tmp_path: Path) -> None:
    kept = om.Checkpoint(tmp_path / "kept", **often)
    om.simulate(town(), steps=5, checkpoint=kept)
    assert sorted(p.name for p in kept.path.iterdir()) == [
        "lock",
        "state.npz",
        *(f"steps-{n}.npz" for n in files),
    ]
    kept.remove()
    assert not kept.path.exists()


def test_two_processes_do_not_write_one_checkpoint(tmp_path: Path) -> None:
    kept = om.Checkpoint(tmp_path)
    with kept.locked(), pytest.raises(ResultError, match="a run in another process writes"):
        om.simulate(town(), steps=1, checkpoint=kept)
    assert om.simulate(town(), steps=1, checkpoint=kept).status == "done"


# The command ----------------------------------------------------------------------------------------

Call = Callable[..., tuple[int, str, str]]
PAIR = """
network:
  buses: {north: {reference: true}, south: {}}
  branches: {tie: {from_bus: north, to_bus: south, r: 0.01, x: 0.1, rating: 120}}
  generators: {coal: {bus: north, p: [0, 200], q: [-80, 80], cost: {c1: 15}}}
  loads: {town: {bus: south, p: 90, q: 30}}
time: {steps: 3}
controller: {horizon: 2, formulation: dc}
"""


@pytest.fixture
def pair(tmp_path: Path) -> Path:
    path = tmp_path / "pair.yaml"
    path.write_text(PAIR)
    return path


def test_results_of_other_inputs_are_kept(call: Call, pair: Path, tmp_path: Path) -> None:
    run = ("run", pair, "--out", tmp_path / "out", "--no-figures", "--json")
    other = ("--set", "network.loads.town.p=80")
    assert call(*run)[0] == 0
    before = (tmp_path / "out" / "summary.json").read_bytes()
    for option in ((), ("--resume",)):
        code, _, err = call(*run, *other, *option)
        assert (code, err.count("\n")) == (2, 1)
        assert "holds results of other inputs, which differ in network loads; " in err
    code, out, err = call(*run, "--resume")
    assert (code, json.loads(out), "has ended" in err) == (0, json.loads(before), True)
    assert (tmp_path / "out" / "summary.json").read_bytes() == before
    assert call(*run)[0] == 0  # the same once more
    assert call(*run, *other, "--force")[0] == 0
    assert (
        json.loads((tmp_path / "out" / "summary.json").read_text())["inputs"] != json.loads(before)["inputs"]
    )
    (tmp_path / "out" / "summary.json").write_text("{}")
    assert "differ in inputs that are not recorded" in call(*run)[2]
    assert "exclude each other" in call(*run, "--resume", "--force")[2]


def test_a_run_that_can_be_continued_is_kept(call: Call, pair: Path, tmp_path: Path) -> None:
    run = ("run", pair, "--out", tmp_path, "--no-figures", "--json")
    scenario = om.load_scenario(pair)
    om.simulate(**scenario.loop(), on_step=stop_after(2), checkpoint=tmp_path / "checkpoint")
    code, _, err = call(*run)
    assert (code, "holds a run that has not ended; continue it with --resume" in err) == (2, True)
    damaged = tmp_path / "checkpoint" / "state.npz"
    whole = damaged.read_bytes()
    damaged.write_bytes(whole[:-9])
    code, _, err = call(*run, "--resume")
    assert (code, err.count("\n"), "--force starts again" in err) == (2, 1, True)
    damaged.write_bytes(whole)
    code, out, _ = call(*run, "--resume")
    assert (code, json.loads(out)["cost"]) == (0, scenario.simulate().cost)
    assert not (tmp_path / "checkpoint").exists()


def test_a_folder_is_tested_before_the_loop(
    call: Call, pair: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(om.Scenario, "loop", None)
    (tmp_path / "file").write_text("in the way")
    code, _, err = call("run", pair, "--out", tmp_path / "file" / "out")
    assert (code, "results cannot be written: " in err) == (2, True)


def take_terminal() -> None:
    """Make standard input the controlling terminal of the session."""
    os.close(os.open(os.ttyname(0), os.O_RDWR))


def started(arguments: list[str], terminal: int | None = None) -> subprocess.Popen[str]:
    """Start a command, in a session of its own with a terminal if one is given."""
    # nohup, under which tests may run, has its children ignore SIGHUP
    code = "import signal; signal.signal(signal.SIGHUP, signal.SIG_DFL); from opfmodel import cli; cli.main()"
    return subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        stdin=terminal,
        stdout=subprocess.PIPE if terminal is None else terminal,
        stderr=subprocess.PIPE if terminal is None else terminal,
        text=True,
        start_new_session=True,
        preexec_fn=None if terminal is None else take_terminal,  # noqa: PLW1509 - no threads are running
    )


def wait_for(path: Path, process: subprocess.Popen[str]) -> None:
    while not path.exists():
        assert process.poll() is None
        time.sleep(0.02)


@pytest.mark.slow
def test_sigterm_and_a_lost_terminal_end_a_run_as_ctrl_c_does(pair: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    run = ["run", str(pair), "--out", str(out), "--no-figures", "--set", "checkpoint.steps=1"]
    run += ["--set", "time.steps=3000"]
    process = started([*run, "--json"])
    wait_for(out / "checkpoint" / "steps-0.npz", process)
    process.terminate()
    summary = json.loads(process.communicate()[0])
    assert (process.returncode, summary["status"]) == (1, "stopped")
    assert json.loads((out / "summary.json").read_text()) == summary

    ours, theirs = pty.openpty()
    process = started([*run, "--resume"], theirs)
    os.close(theirs)
    wait_for(out / "checkpoint" / f"steps-{summary['steps']}.npz", process)
    os.close(ours)  # hangs up
    assert process.wait() == 1
    later = json.loads((out / "summary.json").read_text())
    assert (later["status"], later["steps"] > summary["steps"]) == ("stopped", True)
    assert later["termination"] == f"interrupted after {later['steps']} steps"
    assert (out / "checkpoint" / "state.npz").exists()
