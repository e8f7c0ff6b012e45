"""Studies: the file, the key, the folder, and recovery from killed processes and full disks."""

from __future__ import annotations

import json
import os
import random
import re
import resource
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pyarrow.parquet as pq
import pytest
import xarray as xr
from conftest import SCENARIOS, Call
from distributed import Client
from filelock import FileLock
from hypothesis import given, settings
from hypothesis import strategies as st

from opfmodel.errors import ResultError, ResultWarning, ScenarioError, StudyError
from opfmodel.results import load
from opfmodel.study import (
    aggregate,
    document,
    execution,
    provenance,
    read_run,
    read_study,
    read_table,
    run_study,
    runner,
    shown_columns,
    specification,
    store,
)
from opfmodel.study.sealed import sealed, unsealed
from opfmodel.study.specification import Snapshot
from solvers.cluster import local_cluster

CASE5 = SCENARIOS / "case5-step.yaml"

# One unit and one town: the smallest scenario with a data file.
TINY = """\
network:
  buses: {a: {}}
  generators: {unit: {bus: a, p: [0, 100], cost: {c1: 20}}}
  loads: {town: {bus: a, p: 50}}
time: {steps: 2}
profiles: [{table: {file: demand.csv}}]
controller: {formulation: copperplate}
variants: {heavy: {profiles: [{table: {file: demand.csv}}, {scale: {factor: 3}}]}}
"""
DEMAND = "town.p\n10\n20\n30\n40\n"
GRID = """\
scenario: tiny.yaml
vary:
  controller.horizon: [1, 2, 3]
  demand:
    measured: {}
    forecast: {profiles: [{table: {file: other.csv}}]}
"""
# 24 runs with different results.
CASE5_GRID = f"""\
scenario: {CASE5}
keep: trajectories
set: {{time.steps: 3, controller.generator_delay: 0}}
vary:
  controller.formulation: [ac, dc]
  controller.horizon: [2, 3, 4, 5, 6, 8]
  end: {{free: {{}}, cyclic: {{controller.end.cyclic: true}}}}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a tiny study."""
    (tmp_path / "tiny.yaml").write_text(TINY)
    (tmp_path / "demand.csv").write_text(DEMAND)
    (tmp_path / "other.csv").write_text(DEMAND.replace("20", "25"))
    (tmp_path / "study.yaml").write_text(GRID)
    return tmp_path


def figures(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows without timings and provenance."""
    return [{k: v for k, v in row.items() if not k.startswith(("time_", "provenance_"))} for row in rows]


def results(folder: Path) -> list[dict[str, Any]]:
    """The figures of a finished study from its Parquet file, checked against its records."""
    rows = figures(pq.read_table(folder / "results.parquet").to_pylist())
    assert rows == figures(read_table(folder))
    return rows


def keys(study: Path) -> list[str]:
    return [run.key for run in Snapshot().specifications(read_study(study))]


# The file ---------------------------------------------------------------------------------------


def test_a_grid_is_the_product_of_its_axes(folder: Path) -> None:
    study = read_study(folder / "study.yaml")
    runs = list(study.variations())
    assert len(study) == len(runs) == 6
    assert [tuple(run.labels.values()) for run in runs[:3]] == [
        (1, "measured"),
        (1, "forecast"),
        (2, "measured"),
    ]
    assert runs[1].overrides == {"controller.horizon": 1, "profiles": [{"table": {"file": "other.csv"}}]}


@settings(max_examples=20)
@given(sizes=st.lists(st.integers(1, 4), min_size=1, max_size=4))
def test_every_point_of_a_grid_is_one_run(sizes: list[int], tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("grid")
    (folder / "tiny.yaml").write_text(TINY.replace("profiles: [{table: {file: demand.csv}}]\n", ""))
    axes = dict(zip(("controller.horizon", "time.step", "cost", "controller.end.price"), sizes, strict=False))
    values = {"cost": [{"economic": {"energy_weight": w}} for w in range(4)]}
    lines = "".join(f"  {key}: {json.dumps(values.get(key, [1, 2, 3, 4])[:n])}\n" for key, n in axes.items())
    (folder / "study.yaml").write_text("scenario: tiny.yaml\nvary:\n" + lines)
    found = keys(folder / "study.yaml")
    count = 1
    for size in sizes:
        count *= size
    assert len(found) == len(set(found)) == count


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("vary:", "varied:", r"study.yaml:2:1: varied: unknown key; did you mean 'variant' or 'vary'\?"),
        ("scenario: tiny.yaml", "scenario: 3", r"study.yaml:1:1: scenario: 3: must be text"),
        ("scenario: tiny.yaml\n", "", r"study.yaml:1:1: scenario: this key is missing"),
        ("scenario: tiny.yaml", "scenario: none.yaml", r"study.yaml:1:1: scenario: .*none.yaml: no such file"),
        ("scenario: tiny.yaml", "set: {variant: heavy}", r"set.variant: is a key of the study"),
        ("controller.horizon: [1", "controller.horizn: [1", r"study.yaml:3:23: .*did you mean 'horizon'\?"),
        ("[1, 2, 3]", "[1, 2, many]", r"study.yaml:3:30: .*'many': must be an integer"),
        ("[1, 2, 3]", "[1, 2, 2]", r"study.yaml:3:30: vary.controller.horizon.2: 2 is .*twice"),
        ("[1, 2, 3]", "[]", r"study.yaml:3:3: .*needs at least one value"),
        ("[1, 2, 3]", "4", r"study.yaml:3:3: .*must be a list of values, or a mapping from names to sets of keys"),
        ("measured: {}", "measured: 5", r"study.yaml:5:5: vary.demand.measured: must be a mapping"),
        ("measured: {}", "measured: {controller.horizon: 5}", r"'controller.horizon' is .* by 'controller.horizon'"),
        ("other.csv", "nosuch.csv", r"study.yaml:6:5: vary.demand.forecast: .*nosuch.csv: no such file"),
        ("measured: {}", "measured: {variant: hevy}", r"study.yaml:5:5: .*no variant 'hevy'; did you mean 'heavy'"),
        ("[1, 2, 3]", "!!python/object:os.system [1]", r"the tag .* is not accepted"),
        ("[1, 2, 3]", "[1, 2020-01-01]", r"study.yaml:3:27: vary.controller.horizon.1: .*must be an integer"),
        ("controller.horizon: [1", "cost: [{economic: {since: 2020-01-01}}", r"study.yaml:3:10: .*no option 'since'"),
        ("measured: {}", "measured: {controller: {horizon: 5}}", r"study.yaml:4:3: vary.demand: 'controller.horizon' is .* by"),
        ("measured: {}", "measured: {controller.horizon.a: 5}", r"'controller.horizon' is .* by 'controller.horizon'"),
        ("scenario:", "name: \"a\\e[2J\"\nscenario:", r"study.yaml:1:1: name: 'a\\x1b\[2J': .*visible characters only"),
        ("measured: {}", "\"a\\rb\": {}", r"study.yaml:5:5: vary.demand: the key 'a\\rb' has the character .*visible characters only"),
        ("demand:", "\"a\\u202Eb\":", r"study.yaml:4:3: vary: the key 'a\\u202eb' has the character .*visible characters only"),
        ("controller.horizon: [1", "description: [\"\\uD800\"", r"study.yaml:3:20: not YAML: found invalid Unicode character"),
    ],
)  # fmt: skip
def test_errors_are_located(old: str, new: str, message: str, folder: Path) -> None:
    path = folder / "study.yaml"
    assert old in GRID
    path.write_text(GRID.replace(old, new, 1))
    with pytest.raises(ScenarioError, match=message) as caught:
        read_study(path)
    assert all(line.startswith(str(path)) for line in str(caught.value).splitlines())


# A grid with voltages and a storage, whose objective and plant a study may choose.
PAIR = """\
network:
  buses: {a: {}, b: {}}
  branches: {line: {from_bus: a, to_bus: b, r: 0.01, x: 0.1}}
  generators: {unit: {bus: a, p: [0, 100], q: [-50, 50], cost: {c1: 20}}}
  storages: {cell: {bus: b, energy: 20, power: 5, initial: 10}}
  loads: {town: {bus: b, p: 50, q: 10}}
time: {steps: 2}
controller: {horizon: 2}
"""
TOO_FULL = "{state-of-charge-tracking: {share: 3}}"
NOISY = "{noisy: {deviation: 0.1, seed: 1}}"
VOLTAGE = "{terms: {bus.vm: 1}, at_most: 6}"  # not published by formulations without voltages
NOBODY = "{mode: power-flow, participation: {nobody: 1}}"


@pytest.fixture
def pair(tmp_path: Path) -> Path:
    """A folder with the pair."""
    (tmp_path / "pair.yaml").write_text(PAIR)
    return tmp_path


@pytest.mark.parametrize(
    ("fixed", "vary", "blamed", "said"),
    [
        ("{}", f"{{cost: [economic, {TOO_FULL}]}}", TOO_FULL, "share = 3"),
        ("{}", f"{{cost: [{TOO_FULL}, economic]}}", TOO_FULL, "share = 3"),
        ("{}", f"{{weights: {{one: {{}}, two: {{cost: {TOO_FULL}}}}}}}", "two", "share = 3"),
        (f"{{cost: {TOO_FULL}}}", "{time.steps: [1, 2]}", "set", "share = 3"),
        ("{}", "{cost: [economic, {economic: {energy_weight: -1}}]}", "{economic", "energy_weight = -1"),
        ("{}", "{cost: [{linear-quadratic: {Q: {pgg: 1}}}]}", "{linear", "'pgg'"),
        ("{}", "{cost: [{setpoint-tracking: {setpoints: {unit.pq: 1}}}]}", "{setpoint", "'unit.pq'"),
        ("{}", f"{{plant: [{{mode: power-flow}}, {NOBODY}]}}", NOBODY, "'nobody'"),
        ("{}", "{constraints.c: [{terms: {bus.v: 1}, at_most: 1}]}", "{terms", "'v'"),
        ("{}", "{constraints.c: [{terms: {nobody.vm: 1}, at_most: 1}]}", "{terms", "'nobody'"),
        ("{}", "{constraints.c: [{terms: {bus.vm: 1}}]}", "{terms", "needs a limit"),
        # an incompatibility elsewhere hides no error
        (
            f"{{controller.formulation: dc, constraints.a: {VOLTAGE}}}",
            "{constraints.b: [{terms: {bus.v: 1}, at_most: 1}]}",
            "{terms: {bus.v:",
            "'v'",
        ),
        (
            f"{{controller.formulation: dc, constraints.a: {VOLTAGE}}}",
            "{constraints.b: [{terms: {generator.p_max: 1}, at_most: 1}]}",
            "{terms: {generator",
            "fixed data",
        ),
        (f"{{controller.formulation: dc, constraints.a: {VOLTAGE}}}", f"{{plant: [{NOBODY}]}}", NOBODY, "'nobody'"),
    ],
)  # fmt: skip
def test_an_invalid_option_is_rejected_at_its_location(
    fixed: str, vary: str, blamed: str, said: str, pair: Path
) -> None:
    path, lines = pair / "study.yaml", ["scenario: pair.yaml", f"set: {fixed}", f"vary: {vary}"]
    path.write_text("\n".join(lines))
    line = next(n for n, text in enumerate(lines) if blamed in text)
    with pytest.raises(ScenarioError, match=re.escape(said)) as caught:
        read_study(path)
    assert str(caught.value).startswith(f"{path}:{line + 1}:{lines[line].index(blamed) + 1}: ")


@pytest.mark.parametrize(
    ("fixed", "vary", "lacking"),
    [
        ("{cost: voltage-deviation}", "{controller.formulation: [ac, dc]}", "vm"),
        (f"{{constraints.c: {VOLTAGE}}}", "{controller.formulation: [ac, dc]}", "bus.vm"),
        ("{constraints.c: {terms: {generator.qg: 1}, at_most: 90}}", "{controller.formulation: [ac, dc]}", "generator.qg"),
        ("{}", f"{{forecast: [perfect, {NOISY}]}}", "power-flow or redispatch"),
        ("{controller.generator_delay: 1}", "{controller.horizon: [2, 1]}", "at least 2 stages"),
    ],
)  # fmt: skip
def test_incompatible_parts_are_accepted_and_become_a_row(
    fixed: str, vary: str, lacking: str, pair: Path
) -> None:
    (pair / "study.yaml").write_text(f"scenario: pair.yaml\nset: {fixed}\nvary: {vary}\n")
    outcome = run_study(read_study(pair / "study.yaml"), pair / "out", workers=0)
    assert (outcome.done, outcome.failed) == (1, 1)
    assert lacking in results(pair / "out")[1]["error"]


def test_a_grid_with_too_many_runs_is_rejected_before_any_is_checked(folder: Path) -> None:
    points = ", ".join(f"p{number}: {{}}" for number in range(100))
    axes = "".join(f"  {name}: {{{points}}}\n" for name in "abcdefghijkl")
    (folder / "study.yaml").write_text(f"scenario: nowhere.yaml\nvary:\n{axes}")
    with pytest.raises(ScenarioError, match=f"study.yaml:2:1: vary: .*{10**24:,} runs"):
        read_study(folder / "study.yaml")


def test_a_file_name_that_serves_as_name_is_checked(folder: Path) -> None:
    for file, text in (("a\x1b[2J.yaml", GRID), ("b\x07.yaml", TINY)):
        (folder / file).write_text(text)
    with pytest.raises(ScenarioError, match=r"name: 'a\\x1b\[2J': .*visible characters only"):
        read_study(folder / "a\x1b[2J.yaml")
    (folder / "study.yaml").write_text('scenario: "b\\a.yaml"\nvary: {time.steps: [1]}\n')
    with pytest.raises(
        ScenarioError, match=r"study.yaml:1:1: scenario: .*name: 'b\\x07': .*visible characters only"
    ):
        read_study(folder / "study.yaml")


@pytest.mark.parametrize("text", ["", "- 1\n", "3\n"])
def test_a_study_is_a_mapping(text: str, tmp_path: Path) -> None:
    (tmp_path / "study.yaml").write_text(text)
    with pytest.raises(ScenarioError, match="a study is a mapping"):
        read_study(tmp_path / "study.yaml")


def test_a_scenario_is_not_a_study(folder: Path) -> None:
    with pytest.raises(ScenarioError, match=r"tiny.yaml:\d+:1: network: .*'opfmodel run'"):
        read_study(folder / "tiny.yaml")


def test_files_are_named_relative_to_the_scenario(folder: Path) -> None:
    text = TINY.replace("file: demand.csv", f"file: {folder / 'demand.csv'}")
    (folder / "tiny.yaml").write_text(text)
    with pytest.raises(ScenarioError, match=r"tiny.yaml:6:.*demand.csv': must be relative"):
        keys(folder / "study.yaml")


# The key ----------------------------------------------------------------------------------------


def test_a_comment_a_name_or_another_variant_changes_no_key(folder: Path) -> None:
    before = keys(folder / "study.yaml")
    text = TINY.replace("variants:", "variants: {} # of old:").replace("time:", "# hours\ntime:")
    (folder / "tiny.yaml").write_text("name: other\n" + text)
    (folder / "study.yaml").write_text(GRID.replace("measured", "renamed"))
    assert keys(folder / "study.yaml") == before


def test_a_changed_file_changes_the_keys_that_depend_on_it(folder: Path) -> None:
    before = keys(folder / "study.yaml")
    (folder / "other.csv").write_text(DEMAND.replace("10", "11"))
    after = keys(folder / "study.yaml")
    assert [old == new for old, new in zip(before, after, strict=True)] == 3 * [True, False]
    (folder / "tiny.yaml").write_text(TINY.replace("c1: 20", "c1: 21"))
    assert not set(after) & set(keys(folder / "study.yaml"))


def test_a_folder_of_tables_belongs_to_the_key(folder: Path) -> None:
    (folder / "grid").mkdir()
    (folder / "grid" / "buses.csv").write_text("name\n")
    run = Snapshot().specifications(read_study(folder / "study.yaml"))[0]
    content = {"network": {"file": "grid"}}
    reader = Snapshot()
    inputs = reader._inputs(specification.read_document(folder / "tiny.yaml"), content)
    assert list(inputs.data) == ["grid/buses.csv"]
    changed = replace(inputs, files={**inputs.files, "grid/buses.csv": b"name\nx\n"})
    assert replace(run, inputs=inputs).key != replace(run, inputs=changed).key


def test_a_moved_study_keeps_its_keys(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    moved = tmp_path_factory.mktemp("moved") / "deep"
    shutil.copytree(folder, moved)
    assert keys(moved / "study.yaml") == keys(folder / "study.yaml")


def test_a_new_version_changes_every_key(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = keys(folder / "study.yaml")
    monkeypatch.setattr(specification, "versions", lambda: {"casadi": "0.0"})
    assert not set(before) & set(keys(folder / "study.yaml"))


def test_a_worker_with_other_versions_is_refused(folder: Path) -> None:
    from opfmodel.study import execute

    run = Snapshot().specifications(read_study(folder / "study.yaml"))[0]
    record = execute(replace(run, versions={**run.versions, "casadi": "0.0"}))
    assert record.failed
    assert re.search(rf"casadi {run.versions['casadi']}.* 0\.0$", record.result["error"])


# The folder -------------------------------------------------------------------------------------


def test_a_study_is_run_once(folder: Path) -> None:
    study, out = read_study(folder / "study.yaml"), folder / "out"
    first = run_study(study, out, workers=0)
    assert (first.total, first.done, first.failed, first.skipped) == (6, 6, 0, 0)
    rows = results(out)
    assert [row["cost"] for row in rows] == pytest.approx(
        [600, 700] * 3
    )  # 20 $/MWh for 10 + 20 or 10 + 25 MWh
    assert all(row["status"] == "done" and row["error"] is None for row in rows)
    assert list(rows[0])[:3] == ["controller.horizon", "demand", "key"]
    made = {path: path.stat().st_mtime_ns for path in (out / "runs").iterdir()}
    again = run_study(study, out, workers=0)
    assert (again.done, again.skipped, again.complete) == (0, 6, True)
    assert {path: path.stat().st_mtime_ns for path in (out / "runs").iterdir()} == made


# Trajectories -----------------------------------------------------------------------------------


@pytest.fixture
def kept(folder: Path) -> Path:
    """A folder with a study of two runs that keeps trajectories, which has run."""
    vary = "vary: {demand: {low: {}, high: {profiles: [{table: {file: other.csv}}]}}}"
    (folder / "kept.yaml").write_text(f"scenario: tiny.yaml\nkeep: trajectories\n{vary}\n")
    assert run_study(read_study(folder / "kept.yaml"), folder / "out", workers=0).done == 2
    return folder


def test_trajectories_are_those_of_the_run(kept: Path, call: Call) -> None:
    out, rows = kept / "out", read_table(kept / "out")
    for row, demand in zip(rows, ([10, 20], [10, 25]), strict=True):
        data = read_run(out, {"demand": row["demand"]})
        assert data["pg"].values[:, 0] == pytest.approx(demand)
        assert data.attrs["cost"] == row["cost"]
        xr.testing.assert_identical(data, read_run(out, row["key"]))
    code, printed, _ = call("run", kept / "tiny.yaml", "--out", kept / "alone", "--json")
    assert code == 0
    summary = json.loads((out / "runs" / rows[0]["key"] / "summary.json").read_text())
    assert {*summary, "inputs"} == json.loads(printed).keys()
    timed = ["solve_seconds"]
    xr.testing.assert_identical(
        load(kept / "alone").drop_vars(timed), read_run(out, rows[0]["key"]).drop_vars(timed)
    )
    code, printed, _ = call("plot", out / "runs" / rows[0]["key"], "--paper", "--json")
    assert code == 0
    assert all(Path(path).exists() for path in json.loads(printed)["figures"])


def _delete(folders: list[Path]) -> None:
    (folders[0] / "trajectories.nc").unlink()


def _shorten(folders: list[Path]) -> None:
    path = folders[0] / "trajectories.nc"
    path.write_bytes(path.read_bytes()[:-1])


def _swap(folders: list[Path]) -> None:
    one, other = folders
    one.rename(one.with_name("aside"))
    other.rename(one)
    one.with_name("aside").rename(other)


@pytest.mark.parametrize(("damage", "repeated"), [(_delete, 1), (_shorten, 1), (_swap, 2)])
def test_a_run_without_its_trajectories_is_repeated(damage: Any, repeated: int, kept: Path) -> None:
    study, out = read_study(kept / "kept.yaml"), kept / "out"
    before = {row["key"]: read_run(out, row["key"])["pg"] for row in read_table(out)}
    folders = [out / "runs" / key for key in before]
    damage(folders)
    (folders[0] / ".trajectories.nc.4711").write_text("left by a killed process")
    with pytest.raises(ResultError, match=f"{folders[0].name}: .* missing or damaged; .*repeats the run"):
        read_run(out, folders[0].name)
    again = run_study(study, out, workers=0)
    assert (again.done, again.skipped) == (repeated, 2 - repeated)
    assert all(read_run(out, key)["pg"].identical(pg) for key, pg in before.items())
    assert sorted(path.name for path in folders[0].iterdir()) == ["summary.json", "trajectories.nc"]
    assert run_study(study, out, workers=0).skipped == 2


def test_a_study_keeps_trajectories_from_the_next_start_on(kept: Path) -> None:
    out, with_them = kept / "out", kept / "kept.yaml"
    without = kept / "without.yaml"
    without.write_text(with_them.read_text().replace("keep: trajectories", "keep: figures"))
    assert keys(without) == keys(with_them)
    assert run_study(read_study(without), out, workers=0).skipped == 2
    assert run_study(read_study(without), out, workers=0, retry="all").done == 2
    assert not list((out / "runs").glob("*/*"))  # of the earlier records
    with pytest.raises(ResultError, match=r"kept no trajectories; with 'keep: trajectories' .* repeats it"):
        read_run(out, {"demand": "low"})
    assert run_study(read_study(with_them), out, workers=0).done == 2
    assert read_run(out, {"demand": "low"}).sizes["time"] == 2


def test_a_run_without_steps_keeps_none_and_is_not_repeated(folder: Path) -> None:
    (folder / "tiny.yaml").write_text(TINY.replace("p: [0, 100]", "p: [0, 5]"))
    (folder / "study.yaml").write_text("scenario: tiny.yaml\nkeep: trajectories\n")
    study, out = read_study(folder / "study.yaml"), folder / "out"
    assert run_study(study, out, workers=0).failed == 1
    made = next((out / "runs").glob("*.json")).stat().st_mtime_ns
    assert run_study(study, out, workers=0).failed == 1
    assert next((out / "runs").glob("*.json")).stat().st_mtime_ns == made
    with pytest.raises(ResultError, match="completed no step"):
        read_run(out, {})


@pytest.mark.parametrize(
    ("run", "message"),
    [
        ({}, "2 runs fit"),
        ({"demand": "mid"}, "no run fits"),
        ({"town": 1}, "no run fits"),
        ("0" * 32, "no run"),
    ],
)
def test_a_run_is_named_by_its_key_or_its_point(run: Any, message: str, kept: Path) -> None:
    with pytest.raises(ResultError, match=f"{message}.*; give a key or points on the axes: demand"):
        read_run(kept / "out", run)


def test_no_trajectories_are_written_through_a_link(kept: Path) -> None:
    out, far = kept / "out", kept / "far"
    linked = out / "runs" / read_table(out)[0]["key"]
    linked.rename(far)
    linked.symlink_to(far)
    (far / "trajectories.nc").write_text("text")
    with pytest.raises(ResultError, match="is a symbolic link; must be a folder"):
        run_study(read_study(kept / "kept.yaml"), out, workers=0)
    assert (far / "trajectories.nc").read_text() == "text"


# Repetition -------------------------------------------------------------------------------------


def test_a_changed_data_file_repeats_its_runs(folder: Path) -> None:
    out = folder / "out"
    run_study(read_study(folder / "study.yaml"), out, workers=0)
    (folder / "other.csv").write_text(DEMAND)
    again = run_study(read_study(folder / "study.yaml"), out, workers=0)
    assert (again.done, again.skipped) == (3, 3)
    assert [row["cost"] for row in results(out)] == pytest.approx(6 * [600])


def test_a_failed_run_is_a_row_and_is_repeated_on_demand(folder: Path) -> None:
    text = GRID + "  load: {light: {}, heavy: {network.update: {town: {p: 500}}, profiles: []}}\n"
    (folder / "study.yaml").write_text(
        text.replace("    forecast: {profiles: [{table: {file: other.csv}}]}\n", "")
    )
    study, out = read_study(folder / "study.yaml"), folder / "out"
    outcome = run_study(study, out, workers=0)
    assert (outcome.done, outcome.failed, outcome.complete) == (3, 3, False)
    assert next(iter(outcome.failures)) == "controller.horizon=1 demand=measured load=heavy"
    failed = results(out)[1]
    assert failed["status"] == "proven_infeasible"
    assert failed["error"].startswith("proven_infeasible: step 0: ")
    again = run_study(study, out, workers=0)
    assert (again.done, again.failed, again.skipped) == (0, 3, 3)
    made = {path.name: path.stat().st_mtime_ns for path in (out / "runs").iterdir()}
    run_study(study, out, workers=0, retry="failed")
    repeated = {p.name for p in (out / "runs").iterdir() if p.stat().st_mtime_ns != made[p.name]}
    assert repeated == {f"{row['key']}.json" for row in results(out) if row["status"] != "done"}
    assert run_study(study, out, workers=0, retry="all").done == 3


def test_failed_runs_with_the_same_description_are_counted_separately(folder: Path) -> None:
    (folder / "tiny.yaml").write_text(TINY.replace("heavy:", "None:"))
    (folder / "study.yaml").write_text(
        "scenario: tiny.yaml\nset: {network.update: {unit: {p: [0, 1]}}}\nvary: {variant: [null, None]}\n"
    )
    study = read_study(folder / "study.yaml")
    outcome = run_study(study, folder / "out", workers=0)
    assert (outcome.total, outcome.failed, outcome.waiting) == (2, 2, 0)


def test_an_incompatible_solver_is_a_row(folder: Path) -> None:
    (folder / "study.yaml").write_text(
        f"scenario: {CASE5}\nset: {{time.steps: 1, controller.horizon: 2}}\nvary: {{controller.solver: [ipopt, osqp]}}\n"
    )
    outcome = run_study(read_study(folder / "study.yaml"), folder / "out", workers=0)
    assert (outcome.done, outcome.failed) == (1, 1)
    row = results(folder / "out")[1]
    assert (row["status"], row["cost"]) == ("error", None)
    assert "osqp" in row["error"]


def test_a_rejected_combination_is_a_row_that_names_the_users_files(folder: Path) -> None:
    (folder / "study.yaml").write_text(
        "scenario: tiny.yaml\nvary: {time.steps: [2, 4], controller.horizon: [1, 3]}\n"
    )
    run_study(read_study(folder / "study.yaml"), folder / "out", workers=0)
    *fine, refused = results(folder / "out")
    assert [row["status"] for row in fine] == ["done", "done", "done"]
    assert refused["error"].startswith(f"{folder / 'tiny.yaml'}:6:")
    assert refused["error"].endswith(f"{folder / 'demand.csv'}: 4 rows; 6 are needed")


def test_a_variant_that_only_one_scenario_has_is_a_row(folder: Path) -> None:
    (folder / "plain.yaml").write_text(TINY[: TINY.index("variants:")])
    (folder / "study.yaml").write_text(
        "scenario: tiny.yaml\nset: {network.update: {unit: {p: [0, 200]}}}\n"
        "vary: {scenario: [tiny.yaml, plain.yaml], variant: [null, heavy]}\n"
    )
    outcome = run_study(read_study(folder / "study.yaml"), folder / "out", workers=0)
    assert (outcome.done, outcome.failed) == (3, 1)
    assert outcome.failures["scenario=plain.yaml variant=heavy"].endswith(
        "no variant 'heavy'; available: none"
    )


def test_an_axis_named_like_a_figure_of_some_rows_is_one_column(folder: Path) -> None:
    (folder / "study.yaml").write_text(
        "scenario: tiny.yaml\nvary: {elastic_steps: {few: {}, all: {cost: voltage-deviation}}}\n"
    )
    run_study(read_study(folder / "study.yaml"), folder / "out", workers=0)
    rows = results(folder / "out")
    assert [row["status"] for row in rows] == ["done", "error"]
    assert [row["vary.elastic_steps"] for row in rows] == ["few", "all"]


def test_a_varied_key_named_like_a_figure_is_a_separate_column(folder: Path) -> None:
    (folder / "study.yaml").write_text(
        "scenario: tiny.yaml\nvary: {cost: [economic, {economic: {energy_weight: 1}}]}\n"
    )
    run_study(read_study(folder / "study.yaml"), folder / "out", workers=0)
    rows = results(folder / "out")
    assert [row["vary.cost"] for row in rows] == ["economic", '{"economic": {"energy_weight": 1}}']
    assert [row["cost"] for row in rows] == pytest.approx([600, 600])


@given(
    st.lists(
        st.none()
        | st.booleans()
        | st.integers(-9, 9)
        | st.integers()
        | st.floats(allow_nan=False)
        | st.text(max_size=3),
        min_size=1,
    )
)
def test_a_column_takes_values_of_any_types(values: list[Any]) -> None:
    back = store._column(values).to_pylist()
    mixed = len({float if type(v) is int else type(v) for v in values if v is not None}) > 1
    large = any(isinstance(v, int) and abs(v) > 2**53 for v in values)
    as_json = [None if v is None else json.dumps(v) for v in values]
    assert back == as_json if mixed else back == values or (large and back == as_json)


def test_integers_beyond_64_bits_are_refused(folder: Path) -> None:
    (folder / "study.yaml").write_text(
        f"scenario: tiny.yaml\nvary: {{controller.regularisation: [1, {10**30}]}}\n"
    )
    with pytest.raises(ScenarioError, match=r"study.yaml:2:39: .*integers of more than 64 bits"):
        read_study(folder / "study.yaml")


def test_nested_figures_become_columns() -> None:
    figures = {
        "cost": np.float64(1.5),
        "plant": {"shed": np.int64(2)},
        "diagnosis": {"3": ["short"]},
        "none": {},
    }
    flat = execution._flat(figures)
    assert flat == {"cost": 1.5, "plant.shed": 2, "diagnosis": '{"3": ["short"]}', "none": None}
    assert [type(value) for value in flat.values()][:2] == [float, int]


def test_every_study_of_the_package_is_valid() -> None:
    counts = {path.stem: len(read_study(path)) for path in (SCENARIOS / "studies").glob("*.yaml")}
    assert counts == {"ac-versus-dc": 80, "horizon": 8, "uncertainty": 140}


def resealed(text: str, **changes: Any) -> str:
    """A record with changed content and a matching checksum."""
    content = {k: v for k, v in json.loads(text).items() if k != "checksum"}
    return sealed({**content, **changes})


def forged(text: str) -> str:
    return json.dumps({"key": "zzz", "result": {"status": "done", "cost": -1}, "times": {}, "provenance": {}})


def other_cost(text: str) -> str:
    assert '"cost": 6' in text or '"cost": 7' in text
    return text.replace('"cost": 6', '"cost": 2').replace('"cost": 7', '"cost": 3')


def flipped(text: str) -> str:
    place = text.index('"status": "done"') + len('"status": "don')
    return text[:place] + chr(ord(text[place]) ^ 1) + text[place + 1 :]


DAMAGE = {
    "cut": lambda text: text[:50],
    "empty": lambda text: "",
    "not JSON": lambda text: "junk",
    "a list": lambda text: "[1]",
    "nested deeply": lambda text: "[" * 100_000,
    "an endless number": lambda text: '{"schema": ' + "9" * 10_000 + "}",
    "forged": forged,
    "another cost": other_cost,
    "a flipped bit": flipped,
    "no checksum": lambda text: re.sub(r',\n "checksum".*', "\n}", text),
    "another key": lambda text: resealed(text, key="0" * 32),
    "no key": lambda text: resealed(text, key=None),
    "another schema": lambda text: resealed(text, schema=0),
    "a field more": lambda text: resealed(text, extra=1),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_record_is_repeated_and_reported(damage: str, folder: Path) -> None:
    study, out = read_study(folder / "study.yaml"), folder / "out"
    run_study(study, out, workers=0)
    before = results(out)
    records = sorted((out / "runs").iterdir())
    for record in records[:2]:
        record.write_text(DAMAGE[damage](record.read_text()))
    with pytest.warns(ResultWarning) as caught:
        rows = read_table(out)
    (warning,) = caught
    assert "2 records cannot be trusted" in str(warning.message)
    assert [row["key"] for row in rows] == [row["key"] for row in before]
    by_key = {row["key"]: row for row in rows}
    assert [by_key[record.stem]["status"] for record in records] == 2 * ["waiting"] + 4 * ["done"]
    assert by_key[records[0].stem]["cost"] is None
    outcome = run_study(study, out, workers=0)
    assert (outcome.done, outcome.skipped) == (2, 4)
    (note,) = outcome.notes
    assert "2 records" in note
    assert all((record.name in note) == (record in records[:2]) for record in records)
    assert "\n" not in note
    assert results(out) == before
    assert run_study(study, out, workers=0).notes == ()


def test_swapped_records_are_repeated(folder: Path) -> None:
    study, out = read_study(folder / "study.yaml"), folder / "out"
    run_study(study, out, workers=0)
    before = results(out)
    one, other = sorted((out / "runs").iterdir())[:2]
    first = one.read_text()
    one.write_text(other.read_text())
    other.write_text(first)
    assert run_study(study, out, workers=0).done == 2
    assert results(out) == before


@pytest.mark.parametrize(
    "put", [os.mkfifo, lambda path: path.symlink_to("/dev/zero"), lambda path: path.symlink_to("x")]
)
def test_a_pipe_or_a_device_in_place_of_a_record_is_replaced(put: Any, folder: Path) -> None:
    study, out = read_study(folder / "study.yaml"), folder / "out"
    run_study(study, out, workers=0)
    before = results(out)
    for path in (next((out / "runs").iterdir()), out / "study.json"):
        path.unlink()
        put(path)
    with pytest.raises(ResultError, match=r"study\.json: "):
        read_table(out)
    outcome = run_study(study, out, workers=0)
    assert (outcome.done, outcome.skipped, len(outcome.notes)) == (1, 5, 2)
    assert results(out) == before
    assert all(path.is_file() and not path.is_symlink() for path in (out / "runs").iterdir())


@pytest.mark.parametrize(
    "damage",
    [
        name
        for name in DAMAGE
        if name not in ("another cost", "a flipped bit", "another key", "no key", "a field more")
    ],
)
def test_a_damaged_list_of_runs_is_reported_and_rewritten(damage: str, folder: Path) -> None:
    study, out = read_study(folder / "study.yaml"), folder / "out"
    run_study(study, out, workers=0)
    before = results(out)
    index = out / "study.json"
    index.write_text(DAMAGE[damage](index.read_text()))
    with pytest.raises(ResultError, match=r"study\.json: ") as caught:
        read_table(out)
    assert "\n" not in str(caught.value)
    (note,) = run_study(study, out, workers=0).notes
    assert "study.json" in note
    assert results(out) == before


@pytest.mark.parametrize(("old", "new"), [('"measured"', '"measurer"'), ('.horizon": 1', '.horizon": 2')])
def test_changed_labels_in_the_list_of_runs_are_detected(old: str, new: str, folder: Path) -> None:
    study, out = read_study(folder / "study.yaml"), folder / "out"
    run_study(study, out, workers=0)
    text = (out / "study.json").read_text()
    assert old in text
    (out / "study.json").write_text(text.replace(old, new, 1))
    with pytest.raises(ResultError, match=r"study\.json: the checksum"):
        read_table(out)


@given(
    content=st.dictionaries(
        st.text(),
        st.recursive(
            st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.dates(),
            lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
            max_leaves=8,
        ),
    )
)
def test_sealed_content_is_read_back(
    content: dict[str, Any], tmp_path_factory: pytest.TempPathFactory
) -> None:
    content = {key: value for key, value in content.items() if key not in ("schema", "checksum")}
    path = tmp_path_factory.mktemp("sealed") / "file.json"
    path.write_text(sealed(content), encoding="utf-8")
    assert repr(unsealed(path)) == repr(json.loads(json.dumps(content, default=str)))


def test_the_table_of_a_damaged_study_is_printed_with_a_warning(folder: Path) -> None:
    out = folder / "out"
    run_study(read_study(folder / "study.yaml"), out, workers=0)
    record = next((out / "runs").iterdir())
    record.write_text("junk")
    code, printed, err = finish("table", out, "--json")
    assert code == 0
    assert [row["status"] for row in json.loads(printed)["rows"]].count("waiting") == 1
    assert re.fullmatch(rf"warning: 1 record.*{record.name}.*\n", err)


def test_a_folder_without_a_study_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ResultError, match=r"study.json: no such file; 'opfmodel study run' creates it"):
        read_table(tmp_path)


def test_a_folder_that_cannot_be_written_is_an_error(folder: Path) -> None:
    (folder / "out").write_text("in the way")
    with pytest.raises(ResultError, match="out: results cannot be written: "):
        run_study(read_study(folder / "study.yaml"), folder / "out", workers=0)


def test_only_own_temporaries_are_deleted(folder: Path) -> None:
    study, out = read_study(folder / "study.yaml"), folder / "out"
    run_study(study, out, workers=0)
    key = next((out / "runs").iterdir()).stem
    own = [out / ".study.json.4711", out / ".results.parquet.4711", out / "runs" / f".{key}.json.4711"]
    others = [
        *(out / name for name in (".env", ".study.json.bak", ".other.json.4711", ".study.json.4711.old")),
        *(
            out / "runs" / name
            for name in (".gitignore", ".nfs0001", f".{key}.json.x", ".a.json.4711", f".{key}.json")
        ),
    ]
    for path in (*own, *others):
        path.write_text("text")
    far = folder / "far"
    far.write_text("text")
    links = [out / ".study.json.4712", out / "runs" / f".{key}.json.4712"]
    for link in links:
        link.symlink_to(far)
    (out / "runs" / f".{key}.json.4713").mkdir()
    run_study(study, out, workers=0)
    assert not any(path.exists() for path in own)
    assert all(path.read_text() == "text" for path in (*others, far))
    assert all(link.is_symlink() for link in links)
    assert (out / "runs" / f".{key}.json.4713").is_dir()


def test_a_linked_folder_of_records_is_refused_and_left_alone(folder: Path) -> None:
    study, out = read_study(folder / "study.yaml"), folder / "out"
    home = folder / "home"
    home.mkdir()
    (home / ".profile").write_text("text")
    out.mkdir()
    (out / "runs").symlink_to(home)
    with pytest.raises(ResultError, match="runs: is a symbolic link"):
        run_study(study, out, workers=0)
    assert [path.name for path in home.iterdir()] == [".profile"]


@pytest.mark.parametrize(
    "name", ["study.json", "results.parquet", "lock", ".study.json.{pid}", ".results.parquet.{pid}"]
)
def test_nothing_is_written_through_a_link(name: str, folder: Path) -> None:
    study, out = read_study(folder / "study.yaml"), folder / "out"
    far = folder / "far"
    far.write_text("text")
    out.mkdir()
    (out / name.format(pid=os.getpid())).symlink_to(far)
    if name == "lock":
        with pytest.raises(ResultError, match="out: results cannot be written: "):
            run_study(study, out, workers=0)
    else:
        assert run_study(study, out, workers=0).done == 6
        assert results(out)
    assert far.read_text() == "text"


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may write everywhere")
def test_a_folder_without_permission_is_an_error(folder: Path) -> None:
    (folder / "out").mkdir(mode=0o500)
    with pytest.raises(ResultError, match="out: results cannot be written: Permission denied"):
        run_study(read_study(folder / "study.yaml"), folder / "out", workers=0)


def test_a_file_edited_during_a_study_is_used_as_read(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    study, out = read_study(folder / "study.yaml"), folder / "out"
    run_study(study, folder / "undisturbed", workers=0)
    undisturbed = runner.in_this_process

    def edited(*arguments: Any) -> Iterator[Any]:
        for number, record in enumerate(undisturbed(*arguments)):
            if number == 1:
                (folder / "other.csv").write_text("junk")
                (folder / "tiny.yaml").write_text("junk")
            yield record

    monkeypatch.setattr(runner, "in_this_process", edited)
    outcome = run_study(study, out, workers=0)
    assert outcome.done == 6
    assert [note.split()[0] for note in outcome.notes] == [
        str(folder / n) for n in ("tiny.yaml", "other.csv")
    ]
    assert "changed after the study had read it" in outcome.notes[0]
    assert results(out) == results(folder / "undisturbed")


def test_a_scenario_edited_while_it_is_read_is_rejected(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise a run would have the key of one version and the results of the other."""
    study = read_study(folder / "study.yaml")
    undisturbed = specification.read_document

    def edited(path: Path) -> Any:
        path.write_text(TINY.replace("c1: 20", "c1: 21"))
        return undisturbed(path)

    monkeypatch.setattr(specification, "read_document", edited)
    with pytest.raises(ScenarioError, match=r"tiny\.yaml: changed while it was being read"):
        run_study(study, folder / "out", workers=0)


def test_a_plugin_that_exits_fails_only_its_run(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(execution, "_figures", lambda _: sys.exit(0))
    outcome = run_study(read_study(folder / "study.yaml"), folder / "out", workers=0)
    assert (outcome.failed, outcome.waiting) == (6, 0)
    assert results(folder / "out")[0]["error"] == "SystemExit: 0"


@pytest.mark.skipif(shutil.which("git") is None, reason="needs git")
def test_the_file_monitor_of_a_repository_does_not_run(tmp_path: Path) -> None:
    def git(*arguments: str) -> None:
        subprocess.run(["git", "-C", str(tmp_path), *arguments], check=True, capture_output=True)

    git("init")
    (tmp_path / "study.yaml").write_text(GRID)
    git("add", "study.yaml")
    git("-c", "user.name=a", "-c", "user.email=a@example.org", "commit", "-m", "a")
    watcher = tmp_path / "watch"
    watcher.write_text(f"#!/bin/sh\ntouch {tmp_path / 'ran'}\n")
    watcher.chmod(0o755)
    git("config", "core.fsmonitor", str(watcher))
    found = provenance.revision(tmp_path)
    assert found is not None
    assert re.fullmatch("[0-9a-f]{40}", found)
    assert not (tmp_path / "ran").exists()
    (tmp_path / "study.yaml").write_text(GRID + "# more\n")
    assert provenance.revision(tmp_path) == found + "+"


@pytest.mark.parametrize(
    "options",
    [
        {"workers": -1},
        {"workers": 2, "scheduler": "tcp://127.0.0.1:1"},
        {"workers": 0, "memory": "much"},
        {"workers": 0, "memory": "0"},
        {"workers": 0, "memory": "10MB"},
        {"scheduler": "nonsense"},
        {"workers": 2, "cluster": "cluster.yaml"},
        {"scheduler": "tcp://127.0.0.1:1", "cluster": "cluster.yaml"},
    ],
)
def test_invalid_options_are_rejected(options: dict[str, Any], folder: Path) -> None:
    with pytest.raises(StudyError, match=r"workers|memory = |scheduler = |exclude each other"):
        run_study(read_study(folder / "study.yaml"), folder / "out", **options)


# A cluster that Dask starts ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("3", r"cluster.yaml:1:1: must be a mapping with one key: slurm or ssh"),
        ("{}", r"cluster.yaml:1:1: must have one key: slurm or ssh"),
        ("{slurm: {workers: 2}, ssh: {}}", r"must have one key"),
        ("slum: {workers: 2}", r"cluster.yaml:1:1: slum: .*did you mean 'slurm'"),
        ("slurm: {queue: short}", r"slurm.workers: must be the number of workers, at least 1"),
        (
            "slurm: {workers: 0}",
            r"cluster.yaml:1:9: slurm.workers: must be the number of workers, at least 1",
        ),
        ("ssh: [a, b]", r"cluster.yaml:1:1: ssh: .*must be a mapping"),
    ],
)
def test_errors_of_a_cluster_file_are_located(text: str, message: str, folder: Path) -> None:
    (folder / "cluster.yaml").write_text(text)
    with pytest.raises(ScenarioError, match=message):
        run_study(read_study(folder / "study.yaml"), folder / "out", cluster=folder / "cluster.yaml")
    assert not (folder / "out").exists()


def test_a_missing_package_is_reported_before_the_study_begins(
    folder: Path, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "dask_jobqueue", None)
    (folder / "cluster.yaml").write_text("slurm: {workers: 2}")
    code, out, err = call("study", "run", folder / "study.yaml", "--cluster", folder / "cluster.yaml")
    assert (code, out) == (2, "")
    assert re.fullmatch(r"error: .*cluster.yaml: slurm: needs the package dask-jobqueue .*\n", err)


# Dask's cluster of this machine in the place of SLURM's, in a module that replaces the handler of Ctrl-C as that does.
JOBQUEUE = """
import signal, sys
import distributed

signal.signal(signal.SIGINT, lambda *_: sys.exit())

class SLURMCluster(distributed.LocalCluster):
    def __init__(self, queue, cores):
        if queue != "short":
            raise ValueError(f"no queue\\n{queue}")
        super().__init__(n_workers=0, threads_per_worker=cores, processes=False, dashboard_address=None)
"""


@pytest.mark.slow
def test_a_study_runs_on_a_cluster_that_dask_starts(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "dask_jobqueue.py").write_text(JOBQUEUE)
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setitem(sys.modules, "dask_jobqueue", None)  # forgotten afterwards
    del sys.modules["dask_jobqueue"]
    handler = signal.getsignal(signal.SIGINT)
    cluster, study = folder / "cluster.yaml", read_study(folder / "study.yaml")
    for queue, said in (("long", "no queue long"), ("short, walltime: 1", "walltime")):
        cluster.write_text(f"slurm: {{workers: 2, cores: 1, queue: {queue}}}")
        with pytest.raises(StudyError, match=rf"cluster.yaml: slurm: .*could not be started: .*{said}"):
            run_study(study, folder / "out", cluster=cluster)
    cluster.write_text("slurm: {workers: 2, cores: 1, queue: short}")
    assert run_study(study, folder / "out", cluster=cluster).done == 6
    assert [row["cost"] for row in results(folder / "out")] == pytest.approx([600, 700] * 3)
    assert signal.getsignal(signal.SIGINT) is handler


# The table --------------------------------------------------------------------------------------


def seeded(costs: list[float | None], seeds: int = 3) -> list[dict[str, Any]]:
    """The table of a study of two horizons and some seeds; None is the cost of a failed run."""
    points = [(horizon, seed) for horizon in (6, 12) for seed in range(seeds)]
    return [
        {
            "controller.horizon": horizon,
            "forecast.noisy.seed": seed,
            "controller.end.price": 5.0,
            "key": f"{number:032x}",
            "status": "stopped" if cost is None else "done",
            "error": "stopped: no plan" if cost is None else None,
            "cost": cost,
            "iterations": None,
            "time_total_seconds": 2.0,
        }
        for number, ((horizon, seed), cost) in enumerate(zip(points, costs, strict=True))
    ]


@given(
    costs=st.lists(st.none() | st.floats(-1e6, 1e6), min_size=2, max_size=40).filter(
        lambda c: len(c) % 2 == 0
    )
)
def test_statistics_are_those_of_the_standard_library(costs: list[float | None]) -> None:
    groups = aggregate(seeded(costs, len(costs) // 2), "seed")
    assert [group.labels["controller.horizon"] for group in groups] == [6, 12]
    for group, half in zip(groups, (costs[: len(costs) // 2], costs[len(costs) // 2 :]), strict=True):
        known = sorted(cost for cost in half if cost is not None)
        assert (group.done, len(group.failed), group.waiting) == (len(known), half.count(None), 0)
        assert "iterations" not in group.figures  # no run has any
        if not known:
            assert not group.figures
            continue
        found = group.figures["cost"]
        assert found.runs == len(known)
        assert found.mean == pytest.approx(statistics.fmean(known), rel=1e-9, abs=1e-6)
        assert found.q50 == pytest.approx(statistics.median(known), rel=1e-9, abs=1e-6)
        if len(known) == 1:
            assert found.deviation is None
            assert found.q05 == found.q95 == known[0]
        else:
            assert found.deviation == pytest.approx(statistics.stdev(known), rel=1e-6, abs=1e-6)
            cuts = statistics.quantiles(known, n=20, method="inclusive")
            assert (found.q05, found.q95) == pytest.approx((cuts[0], cuts[-1]), rel=1e-9, abs=1e-6)


def test_failed_runs_are_named_and_left_out() -> None:
    rows = seeded([1.0, None, 3.0, None, None, None])
    one, other = aggregate(rows, ["forecast.noisy.seed"])
    assert (one.done, other.done, other.figures) == (2, 0, {})
    assert one.figures["cost"].mean == 2.0
    assert one.failed == {
        "controller.horizon=6 forecast.noisy.seed=1 controller.end.price=5.0": "stopped: no plan"
    }
    (whole,) = aggregate(rows, ["seed", "horizon"])
    assert (whole.labels, whole.done, len(whole.failed)) == ({"controller.end.price": 5.0}, 2, 4)


def test_a_table_shows_what_varies_and_the_main_figures() -> None:
    rows = seeded([1.0] * 6)
    assert shown_columns(rows) == [
        "controller.horizon", "forecast.noisy.seed", "status", "cost", "time_total_seconds",
    ]  # fmt: skip
    assert shown_columns(seeded([1.0] * 5 + [None]))[-1] == "error"
    assert shown_columns(rows, every=True) == [n for n in rows[0] if n not in ("error", "iterations")]
    assert shown_columns(rows, ["error"]) == ["error"]


def test_a_study_is_tabulated_over_an_axis(folder: Path, call: Call) -> None:
    units = "{large: {}, small: {network.generators.unit.p: [0, 15]}}"  # the demand is 10, then 20 MW
    (folder / "study.yaml").write_text(
        f"scenario: tiny.yaml\nvary:\n  controller.horizon: [1, 2]\n  unit: {units}\n"
    )
    assert run_study(read_study(folder / "study.yaml"), folder / "out", workers=0).failed == 2
    code, out, err = call("study", "table", folder / "out", "--over", "unit", "--column", "cost")
    assert code == 0
    lines = [line.split() for line in out.splitlines()]
    assert lines[0][:4] == ["controller.horizon", "figure", "runs", "mean"]
    assert [line[:6] for line in lines[1:]] == [[n, "cost", "1", "of", "2", "600"] for n in "12"]
    assert [line.split(" unit=")[0] for line in err.splitlines()] == [
        f"failed: controller.horizon={n}" for n in "12"
    ]
    code, out, _ = call("study", "table", folder / "out", "--over", "horizon", "--json")
    printed = json.loads(out)
    assert (code, printed["over"]) == (0, ["horizon"])
    large, small = printed["groups"]
    assert (large["labels"], large["done"], large["failed"]) == ({"unit": "large"}, 2, {})
    assert large["figures"]["cost"]["mean"] == pytest.approx(600)
    assert (small["done"], small["figures"], len(small["failed"])) == (0, {}, 2)
    for options, said in (
        (("--over", "unt"), "did you mean 'unit'"),
        (("--over", "seed"), "no axis 'seed'; axes: controller.horizon, unit"),
        (("--over", "unit", "--column", "status"), "column 'status' has no numbers"),
    ):
        code, _, err = call("study", "table", folder / "out", *options)
        assert code == 2
        assert said in err


# The command and its interruptions ----------------------------------------------------------------


def start(*arguments: object, **options: Any) -> subprocess.Popen[str]:
    """Start ``opfmodel study`` in a separate process group, as from a terminal."""
    code = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); from opfmodel import cli; cli.main()"
    return subprocess.Popen(
        [sys.executable, "-c", code, "study", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        **options,
    )


def finish(*arguments: object, **options: Any) -> tuple[int, str, str]:
    process = start(*arguments, **options)
    out, err = process.communicate()
    return process.returncode, out, err


def records_in(out: Path) -> int:
    return len(list((out / "runs").glob("*.json")))


def wait_for_records(out: Path, count: int, process: subprocess.Popen[str]) -> None:
    while records_in(out) < count:
        assert process.poll() is None
        time.sleep(0.01)


def test_the_command_prints_counts_and_a_table(folder: Path, call: Call) -> None:
    run = ("run", folder / "study.yaml", "--out", folder / "out", "--workers", 0)
    code, out, err = finish(*run, "--json")
    assert (code, err) == (0, "")
    counts = json.loads(out)
    assert {k: counts[k] for k in ("total", "done", "failed", "skipped")} == {
        "total": 6,
        "done": 6,
        "failed": 0,
        "skipped": 0,
    }
    code, out, err = call("study", *run)
    assert (code, err) == (0, "")
    assert "runs    6: 0 done, 0 failed, 6 skipped" in out
    code, out, err = call("study", "table", folder / "out", "--json")
    assert [row["cost"] for row in json.loads(out)["rows"]] == pytest.approx([600, 700] * 3)
    code, out, err = call("study", "table", folder / "out")
    assert out.splitlines()[0].split()[:4] == ["controller.horizon", "demand", "status", "cost"]
    assert out.splitlines()[2].split()[:4] == ["1", "forecast", "done", "700"]
    code, out, err = call("study", "table", folder / "out", "--column", "demand", "--column", "steps")
    assert out.splitlines()[1].split() == ["measured", "2"]
    code, out, err = call("study", "table", folder / "out", "--column", "csot")
    assert (code, err) == (2, "error: the table has no column 'csot'; did you mean 'cost'?\n")


def test_a_study_is_validated_without_running(folder: Path, call: Call) -> None:
    code, out, _ = call("validate", folder / "study.yaml", "--json")
    assert code == 0
    assert json.loads(out) == {"valid": True, "runs": 6, "axes": {"controller.horizon": 3, "demand": 2}}


def test_a_folder_is_locked_until_its_holder_dies(folder: Path) -> None:
    (folder / "slow.yaml").write_text(
        f"scenario: {CASE5}\nset: {{time.steps: 20}}\nvary: {{controller.regularisation: {list(range(1, 13))}}}\n"
    )
    out = folder / "out"
    holder = start("run", folder / "slow.yaml", "--out", out, "--workers", 0)
    wait_for_records(out, 1, holder)
    code, _, err = finish("run", folder / "study.yaml", "--out", out, "--workers", 0)
    assert code == 2
    assert f"error: {out}: a study is running in this folder (process {holder.pid} on " in err
    os.kill(holder.pid, signal.SIGKILL)
    holder.communicate()
    code, _, err = finish("run", folder / "study.yaml", "--out", out, "--workers", 0)
    assert (code, err) == (0, "")
    assert len(results(out)) == 6


@pytest.mark.slow
@pytest.mark.parametrize("workers", [0, 2])
def test_ctrl_c_keeps_finished_runs(workers: int, folder: Path) -> None:
    (folder / "slow.yaml").write_text(
        f"scenario: {CASE5}\nset: {{time.steps: 20}}\nvary: {{controller.regularisation: [1, 2, 3, 4, 5, 6, 7, 8]}}\n"
    )
    run = ("run", folder / "slow.yaml", "--out", folder / "out", "--workers", workers, "--json")
    process = start(*run)
    wait_for_records(folder / "out", 2, process)
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=60)
    counts = json.loads(out)
    assert (process.returncode, counts["interrupted"], err) == (1, True, "")
    assert 2 <= counts["done"] < 8
    assert counts["waiting"] == 8 - counts["done"]
    assert [row["status"] for row in read_table(folder / "out")].count("done") == counts["done"]
    code, out, _ = finish(*run)
    assert (code, json.loads(out)["skipped"]) == (0, counts["done"])


def test_a_file_size_limit_stops_the_study_and_keeps_finished_runs(folder: Path) -> None:
    run = ("run", folder / "study.yaml", "--out", folder / "out", "--workers", 0)
    assert finish(*run)[0] == 0
    (folder / "other.csv").write_text(DEMAND.replace("10", "15"))
    for name in ("notes.json", f"{'0' * 32}.json"):  # neither is a finished run
        (folder / "out" / "runs" / name).write_text("{}")

    def small() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))  # less than study.json needs

    code, _, err = finish(*run, preexec_fn=small)
    assert code == 2
    assert "results cannot be written: File too large; the 6 finished runs in" in err
    assert err.count("\n") == 1
    assert len(results(folder / "out")) == 6
    assert not list((folder / "out").glob(".*"))
    code, out, _ = finish(*run, "--json")
    assert (code, json.loads(out)["done"], json.loads(out)["skipped"]) == (0, 3, 3)


FULL_DISK = """
set -e
mount -t tmpfs -o size=20k none "$1"
"$2" -c "$3" study run "$4" --out "$1" --workers 0 && exit 9
ls "$1/runs" | wc -l
mount -o remount,size=10m "$1"
"$2" -c "$3" study run "$4" --out "$1" --workers 0 --json
"$2" -c "$3" study table "$1" --json
"""


def in_own_mounts(*command: str) -> list[str]:
    return ["unshare", "--user", "--map-root-user", "--mount", *command]


@pytest.mark.slow
@pytest.mark.skipif(
    shutil.which("unshare") is None
    or subprocess.run(in_own_mounts("true"), check=False, capture_output=True).returncode != 0,
    reason="needs a mount namespace for a separate disk",
)
def test_a_full_disk_stops_the_study_and_keeps_finished_runs(folder: Path) -> None:
    (folder / "disk").mkdir()
    run_study(read_study(folder / "study.yaml"), folder / "undisturbed", workers=0)
    code = "from opfmodel import cli; cli.main()"
    done = subprocess.run(
        in_own_mounts(
            "sh",
            "-c",
            FULL_DISK,
            "sh",
            str(folder / "disk"),
            sys.executable,
            code,
            str(folder / "study.yaml"),
        ),
        check=False,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    kept, counts, table = done.stdout.splitlines()
    assert f"results cannot be written: No space left on device; the {kept} finished runs in" in done.stderr
    assert 1 <= int(kept) < 6
    assert json.loads(counts)["skipped"] == int(kept)
    expected = results(folder / "undisturbed")
    assert [{k: row[k] for k in expected[0]} for row in json.loads(table)["rows"]] == expected


# Workers ----------------------------------------------------------------------------------------


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[dict[str, Any]]]:
    """A study of 24 runs, and its results from an undisturbed serial execution; one for all processes of the tests."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    folder /= "undisturbed"
    with FileLock(f"{folder}.lock"):
        if not folder.exists():
            folder.mkdir()
            (folder / "study.yaml").write_text(CASE5_GRID)
            outcome = run_study(read_study(folder / "study.yaml"), folder / "out", workers=0)
            assert (outcome.total, outcome.done) == (24, 24)
    return folder / "study.yaml", results(folder / "out")


@pytest.mark.slow
def test_killed_processes_lose_no_finished_run(
    undisturbed: tuple[Path, list[dict[str, Any]]], tmp_path: Path
) -> None:
    study, expected = undisturbed
    chance = random.Random(1)
    out = tmp_path / "out"
    run = ("run", study, "--out", out, "--workers", 2, "--json")
    resumed = workers_killed = 0
    for _ in range(9):
        before = records_in(out)
        worker_dies_at, all_die_at = sorted(before + chance.randint(0, 8) for _ in range(2))
        process = start(*run)
        worker_died = 0
        while process.poll() is None and records_in(out) < all_die_at:
            if not worker_died and records_in(out) >= worker_dies_at:
                worker_died = kill_a_worker(process.pid, chance)
            time.sleep(0.01)
        workers_killed += worker_died
        time.sleep(chance.uniform(0.0, 3.0) if all_die_at == before else 0.0)  # during the start
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        if (out / "study.json").exists():
            done = [row for row in figures(read_table(out)) if row["status"] != "waiting"]
            assert all(row in expected for row in done)
            assert all(read_run(out, row["key"]).attrs["cost"] == row["cost"] for row in done)
            resumed += 0 < len(done) < 24
            if len(done) == 24:
                assert done == expected
                shutil.rmtree(out)
    code, printed, _ = finish(*run)
    assert (code, json.loads(printed)["failed"]) == (0, 0)
    assert results(out) == expected
    assert resumed >= 3
    assert workers_killed >= 3


def spawned(pid: int) -> list[psutil.Process]:
    """The worker processes of a study."""
    found = []
    for child in psutil.Process(pid).children(recursive=True):
        with suppress(psutil.NoSuchProcess):
            if "spawn_main" in " ".join(child.cmdline()):
                found.append(child)
    return found


def kill_a_worker(pid: int, chance: random.Random) -> int:
    """Kill one worker process, if any; return how many were killed."""
    try:
        workers = spawned(pid)
        if not workers:
            return 0
        chance.choice(workers).kill()
    except psutil.NoSuchProcess:
        return 0
    return 1


@contextmanager
def running_scheduler(
    folder: Path, *options: str, env: dict[str, str] | None = None
) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Start a scheduler with two workers on the loopback device; yield its address and process.

    One at a time: with several beside each other, a machine of few processors is too slow for their timeouts.
    """
    file, started = folder / "scheduler.json", []
    alone = FileLock(Path(tempfile.gettempdir()) / f"opfmodel-tests-scheduler-{os.getuid()}.lock")

    def dask(*arguments: str) -> None:
        command = [sys.executable, "-m", "dask", *arguments, "--no-dashboard"]
        started.append(subprocess.Popen(command, cwd=folder, stderr=subprocess.DEVNULL, env=env))

    alone.acquire()
    try:
        dask("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file), *options)
        while not file.exists() or not file.read_text().endswith("}"):  # written in place, not renamed
            assert started[0].poll() is None
            time.sleep(0.05)
        address = json.loads(file.read_text())["address"]
        for name in ("one", "two"):
            dask("worker", address, "--name", name, "--nthreads", "1", "--death-timeout", "5")
        yield address, started[0]
    finally:
        for process in reversed(started):
            process.terminate()
            process.wait()
        alone.release()


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """A scheduler to which anybody on this machine can connect."""
    with running_scheduler(tmp_path) as running:
        yield running


# What a user without the keys and, if the tests are run by the superuser, without privileges can do at a port:
# send an HTTP request, or ask Dask to run a function, without TLS or with other keys.
STRANGER = """
import asyncio, json, os, pickle, socket, sys
import distributed.comm.tcp
from distributed import Security
from distributed.core import connect

strange = Security.temporary()
if os.geteuid() == 0:  # after the imports, since Python itself may be in a home that others cannot enter
    os.setgroups([])
    os.setgid(65534)
    os.setuid(65534)

def web(port):
    with socket.create_connection(("127.0.0.1", port), timeout=10) as line:
        line.sendall(b"GET / HTTP/1.0\\r\\n\\r\\n")
        try:
            return line.recv(100).decode("latin-1")
        except OSError as error:
            return type(error).__name__

async def dask(address, security, operation):
    arguments = security.get_connection_args("client")
    try:
        comm = await asyncio.wait_for(connect(address, timeout=5, **arguments), 10)
    except (OSError, TimeoutError, ValueError) as error:  # ValueError: TLS where there is none
        return f"refused: {type(error).__name__}"
    try:
        await comm.write({"op": operation, "function": pickle.dumps(os.getpid), "wait": True, "reply": True})
        return f"answered: {await asyncio.wait_for(comm.read(), 10)}"
    except (OSError, TimeoutError):
        return "connected"
    finally:
        comm.abort()

async def tried(port):
    return {
        "user": os.getuid(),
        "web": web(port),
        **{
            f"{keys} {operation}": await dask(f"{scheme}://127.0.0.1:{port}", security, operation)
            for keys, scheme, security in (("no", "tcp", Security(require_encryption=False)), ("other", "tls", strange))
            for operation in ("run", "run_function")  # of workers, and of schedulers
        },
    }

print(json.dumps({port: asyncio.run(tried(int(port))) for port in sys.argv[1:]}))
"""


def listening(pid: int) -> dict[int, str]:
    """Return the addresses, by port, on which a process and its children listen."""
    process = psutil.Process(pid)
    found = [c for p in (process, *process.children(recursive=True)) for c in p.net_connections("inet")]
    return {c.laddr.port: c.laddr.ip for c in found if c.status == psutil.CONN_LISTEN}


def tried_by_a_stranger(ports: list[int]) -> dict[str, dict[str, Any]]:
    command = [sys.executable, "-c", STRANGER, *map(str, ports)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    found: dict[str, dict[str, Any]] = json.loads(done.stdout)
    assert all(tries["user"] != 0 for tries in found.values())
    return found


@pytest.mark.slow
def test_connections_to_a_local_cluster_need_its_keys(folder: Path) -> None:
    (folder / "slow.yaml").write_text(
        f"scenario: {CASE5}\nset: {{time.steps: 20}}\nvary: {{controller.regularisation: {list(range(1, 40))}}}\n"
    )
    (folder / "tmp").mkdir()
    own = {**os.environ, "TMPDIR": str(folder / "tmp")}
    process = start("run", folder / "slow.yaml", "--out", folder / "out", "--workers", 2, env=own)
    try:
        wait_for_records(folder / "out", 1, process)
        files = list((folder / "tmp").iterdir())
        modes = {path.name: path.stat().st_mode & 0o777 for path in files}
        ports = listening(process.pid)
        found = tried_by_a_stranger(list(ports))
        assert process.poll() is None
    finally:
        os.killpg(process.pid, signal.SIGINT)
        _, err = process.communicate(timeout=120)
    assert err == ""

    assert modes
    assert all(mode == 0o700 for mode in modes.values()), modes  # processes import from there
    assert len(ports) == 5  # a scheduler, two workers and their nannies; no web server
    assert set(ports.values()) == {"127.0.0.1"}
    for port, tries in found.items():
        assert "HTTP" not in tries["web"], port
        answers = [answer for name, answer in tries.items() if name not in ("user", "web")]
        assert len(answers) == 4
        assert all(answer.startswith("refused: ") for answer in answers), (port, answers)


@pytest.mark.slow
def test_a_stranger_would_be_noticed(scheduler: tuple[str, subprocess.Popen[bytes]]) -> None:
    """The test above finds what it looks for on an unprotected scheduler."""
    ports = listening(scheduler[1].pid)
    found = tried_by_a_stranger(list(ports))
    assert any("HTTP" in tries["web"] for tries in found.values())
    ran = f"answered: {{'status': 'OK', 'result': {scheduler[1].pid}}}"
    assert any(tries["no run_function"] == ran for tries in found.values()), found


@pytest.mark.slow
def test_a_running_scheduler_with_two_workers_reproduces_the_serial_results(
    undisturbed: tuple[Path, list[dict[str, Any]]],
    scheduler: tuple[str, subprocess.Popen[bytes]],
    tmp_path: Path,
) -> None:
    study, expected = undisturbed
    code, out, err = finish("run", study, "--out", tmp_path / "out", "--scheduler", scheduler[0], "--json")
    assert (code, err) == (0, "")
    assert json.loads(out)["done"] == 24
    assert results(tmp_path / "out") == expected
    processes = {row["provenance_process"] for row in read_table(tmp_path / "out")}
    assert len(processes) == 2
    assert not processes & {os.getpid()}
    for row in expected:
        here, there = (read_run(out, row["key"]) for out in (study.parent / "out", tmp_path / "out"))
        timed = ["solve_seconds"]
        xr.testing.assert_identical(here.drop_vars(timed), there.drop_vars(timed))


@pytest.mark.slow
def test_a_running_scheduler_can_take_keys_from_the_configuration_of_dask(folder: Path) -> None:
    from distributed import Security

    keys, env = Security.temporary(), dict(os.environ)
    (folder / "key.pem").write_text(keys.tls_client_key)
    (folder / "cert.pem").write_text(keys.tls_client_cert)
    env["DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION"] = "True"
    env["DASK_DISTRIBUTED__COMM__TLS__CA_FILE"] = str(folder / "cert.pem")
    for role in ("CLIENT", "SCHEDULER", "WORKER"):
        env[f"DASK_DISTRIBUTED__COMM__TLS__{role}__KEY"] = str(folder / "key.pem")
        env[f"DASK_DISTRIBUTED__COMM__TLS__{role}__CERT"] = str(folder / "cert.pem")
    with running_scheduler(folder, "--protocol", "tls", env=env) as (address, _):
        assert address.startswith("tls://")
        run = ("run", folder / "study.yaml", "--out", folder / "out", "--scheduler", address, "--json")
        process = start(*run, env=env)
        out, err = process.communicate(timeout=300)
        assert (process.returncode, err) == (0, "")
        assert json.loads(out)["done"] == 6
        for scheme in ("tls", "tcp"):  # without the keys
            other = address.replace("tls", scheme)
            code, _, err = finish(*run[:4], "--scheduler", other, "--retry", "all")
            assert code == 2
            assert re.fullmatch(rf"error: no scheduler answers at '{other}': .*\n", err)


@pytest.mark.slow
def test_a_lost_scheduler_is_reported_and_finished_runs_are_kept(
    undisturbed: tuple[Path, list[dict[str, Any]]],
    scheduler: tuple[str, subprocess.Popen[bytes]],
    tmp_path: Path,
) -> None:
    study, expected = undisturbed
    out = tmp_path / "out"
    process = start("run", study, "--out", out, "--scheduler", scheduler[0])
    wait_for_records(out, 3, process)
    scheduler[1].kill()
    _, err = process.communicate(timeout=120)
    assert process.returncode == 2
    assert re.fullmatch(rf"error: .*scheduler at {re.escape(scheduler[0])}.*\n", err)
    done = [row for row in results(out) if row["status"] != "waiting"]
    assert 3 <= len(done) < 24
    assert all(row in expected for row in done)


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer_is_an_error(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("solvers.cluster._PATIENCE", 1.0)
    for address, said in (
        ("tcp://127.0.0.1:9", "no scheduler answers at 'tcp://127.0.0.1:9'"),
        ("nonsense", "scheduler = 'nonsense': must be an address such as tcp://"),
    ):
        with pytest.raises(StudyError, match=said):
            run_study(read_study(folder / "study.yaml"), folder / "out", scheduler=address)


@pytest.mark.slow
@pytest.mark.parametrize("end", ["os.kill(os.getpid(), signal.SIGKILL)", "os._exit(3)"])
def test_workers_that_die_at_start_are_reported_in_one_line(end: str, folder: Path) -> None:
    lines = ["import os, signal, sys", "if 'spawn_main' in ' '.join(sys.orig_argv):", f"    {end}", ""]
    (folder / "sitecustomize.py").write_text("\n".join(lines))
    run = ("run", folder / "study.yaml", "--out", folder / "out", "--workers", 2)
    process = start(*run, env={**os.environ, "PYTHONPATH": str(folder)})
    out, err = process.communicate(timeout=300)
    assert (process.returncode, out) == (2, "")
    assert re.fullmatch(r"error: the workers could not be started: .*\n", err)
    assert {row["status"] for row in read_table(folder / "out")} == {"waiting"}
    code, out, err = finish(*run)
    assert (code, err) == (0, "")


@pytest.mark.slow
def test_workers_that_die_whenever_they_start_end_the_study(folder: Path) -> None:
    code = "from opfmodel.study import workers; workers._SECONDS_IDLE = 5.0; from opfmodel import cli; cli.main()"
    run = ["study", "run", str(folder / "study.yaml"), "--out", str(folder / "out"), "--workers", "1"]
    command = [sys.executable, "-c", code, *run, "--memory", "100MB"]  # less than an idle worker needs
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert re.fullmatch(r"error: no worker .* 5 s.*--memory.*\n", done.stderr)


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [0.0, 2.0])
def test_ctrl_c_while_the_workers_start_leaves_nothing(seconds: float, folder: Path) -> None:
    (folder / "tmp").mkdir()
    (folder / "long.yaml").write_text(  # longer than the workers take to start
        f"scenario: {CASE5}\nvary: {{controller.regularisation: [1, 2, 3, 4, 5, 6, 7, 8]}}\n"
    )
    run = ("run", folder / "long.yaml", "--out", folder / "out", "--workers", 2, "--json")
    process = start(*run, env={**os.environ, "TMPDIR": str(folder / "tmp")})
    while not (workers := spawned(process.pid)):
        assert process.poll() is None
        time.sleep(0.01)
    time.sleep(seconds)
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=120)
    assert (process.returncode, err) == (1, "")
    assert json.loads(out)["interrupted"]
    assert list((folder / "tmp").iterdir()) == []
    assert psutil.wait_procs(workers, timeout=60)[1] == []


def test_the_environment_of_workers_is_restored() -> None:
    from solvers.cluster import _one_thread

    before = dict(os.environ)
    with _one_thread():
        assert os.environ["OPENBLAS_NUM_THREADS"] == "1"
        os.environ["MALLOC_TRIM_THRESHOLD_"] = "65536"
    assert dict(os.environ) == before


@pytest.mark.slow
def test_workers_that_run_out_of_memory_fail_only_their_run(folder: Path) -> None:
    (folder / "study.yaml").write_text(
        f"scenario: {CASE5}\nset: {{time.steps: 1, controller.generator_delay: 0}}\n"
        "vary: {controller.horizon: [2, 60000, 3, 4]}\n"
    )
    run = ("run", folder / "study.yaml", "--out", folder / "out", "--workers", 1, "--memory", "600MB")
    code, out, err = finish(*run)
    assert code == 1, err
    assert re.search(r"failed: controller.horizon=60000: 3 workers died .* memory", err)
    assert [row["status"] for row in read_table(folder / "out")] == ["done", "error", "done", "done"]
    assert "4: 3 done, 1 failed" in out


@pytest.mark.slow
def test_workers_that_die_again_and_again_are_replaced() -> None:
    """Dask looks for a worker 15 s after its death; at that time its second successor is starting."""
    with local_cluster(1, None) as cluster, Client(cluster) as client:
        for seconds in (0, 14.7):
            time.sleep(seconds)
            (process,) = client.run(os.getpid).values()
            os.kill(process, signal.SIGKILL)
        time.sleep(5)
        assert client.submit(os.getpid).result(timeout=60) != process


def test_a_misspelt_vary_is_reported_as_a_key_of_a_study(folder: Path, call: Call) -> None:
    path = folder / "study.yaml"
    path.write_text("scenario: tiny.yaml\nvarry: {time.steps: [1, 2]}\n")
    for command in (("validate",), ("study", "run")):
        code, _, err = call(*command, path)
        message, line, _ = err.splitlines()
        assert (code, message) == (2, f"error: {path}:2:1: varry: unknown key; did you mean 'vary'?")
        assert line.endswith("varry: {time.steps: [1, 2]}")
    code, _, err = call("run", path)
    assert (code, "this file is a study" in err) == (2, True)


def test_reading_a_study_refuses_absolute_paths_of_data(folder: Path) -> None:
    table, path = folder / "table.csv", folder / "study.yaml"
    table.write_text("town.p\n1\n2\n3\n4\n")
    rule = f"{{profiles: [{{table: {{file: {table}}}}}]}}"
    for text, place in (
        (f"set: {rule}\nvary: {{time.steps: [1, 2]}}\n", "2:1: set: "),
        (f"vary: {{data: {{own: {{}}, far: {rule}}}}}\n", "2:24: vary.data.far: "),
    ):
        path.write_text(f"scenario: tiny.yaml\n{text}")
        with pytest.raises(ScenarioError) as caught:
            read_study(path)
        assert str(caught.value).startswith(f"{path}:{place}")
        assert f"{str(table)!r}: must be relative" in str(caught.value)
    path.write_text(
        f"scenario: tiny.yaml\nset: {rule.replace(str(table), table.name)}\nvary: {{time.steps: [1]}}\n"
    )
    read_study(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "set: {time: {steps: 4}, time.steps: 2}\nvary: {controller.horizon: [1]}",
            r":2:25: set.time.steps: ",
        ),
        (
            "vary:\n  both:\n    a: {controller.horizon: 1, controller: {horizon: 2}}",
            r":4:32: vary.both.a.controller: 'controller.horizon' is already set by 'controller.horizon'",
        ),
    ],
)
def test_a_key_is_set_once(folder: Path, text: str, message: str) -> None:
    (folder / "study.yaml").write_text(f"scenario: tiny.yaml\n{text}\n")
    with pytest.raises(ScenarioError, match=message):
        read_study(folder / "study.yaml")


def test_two_axes_do_not_set_parts_of_the_same_mapping(folder: Path) -> None:
    (folder / "study.yaml").write_text(
        "scenario: tiny.yaml\nvary:\n  a: {x: {time: {steps: 1}}}\n  b: {y: {time: {step: 1}}}\n"
    )
    with pytest.raises(ScenarioError, match=r":4:3: vary.b: 'time' is already varied by 'a'"):
        read_study(folder / "study.yaml")


def test_an_axis_overrides_what_is_set(folder: Path) -> None:
    (folder / "study.yaml").write_text(
        "scenario: tiny.yaml\nset: {time.steps: 1}\nvary: {time: {short: {time.steps: 2}}}\n"
    )
    (variation,) = read_study(folder / "study.yaml").variations()
    assert variation.overrides == {"time.steps": 2}


def test_axes_of_many_points_are_checked_in_linear_time(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The labels are compared by hash, never with each other."""

    class Label(str):
        __hash__ = str.__hash__
        compared = 0

        def __eq__(self, other: object) -> bool:
            Label.compared += 1
            return str.__eq__(self, other)

    monkeypatch.setattr(document, "_label", Label)
    monkeypatch.setattr(document._Trial, "check", lambda self: None)
    (folder / "study.yaml").write_text(
        f"scenario: tiny.yaml\nvary: {{controller.regularisation: {list(range(1000))}}}\n"
    )
    assert len(read_study(folder / "study.yaml")) == 1000
    assert Label.compared < 10_000


def test_columns_of_waiting_runs_can_be_selected(folder: Path, call: Call) -> None:
    """A table shows no error before the first run has finished, and lists every column that a run adds."""
    (folder / "study.yaml").write_text(
        "scenario: tiny.yaml\nset: {plant.mode: redispatch}\nvary: {time.steps: [1, 2]}\n"
    )
    run_study(read_study(folder / "study.yaml"), folder / "out", workers=0)
    complete = read_table(folder / "out")
    for record in (folder / "out" / "runs").glob("*.json"):
        record.unlink()
    waiting = read_table(folder / "out")
    figures = [name for name in complete[0] if not name.startswith("provenance_")]
    assert "redispatched_mwh" in figures
    assert shown_columns(waiting, figures) == figures
    for rows in (waiting, complete):
        with pytest.raises(ResultError, match=r"no column 'redispatch_mwh'.*'redispatched_mwh'"):
            shown_columns(rows, ["redispatch_mwh"])
    code, out, err = call("study", "table", folder / "out", "--column", "redispatched_mwh")
    assert (code, err) == (0, "")
    assert out.split() == ["redispatched_mwh"]
