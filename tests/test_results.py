"""Files of a run: round trips, and detection of damage with a one-line error."""

from __future__ import annotations

import errno
import gc
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import xarray as xr
from conftest import SCENARIOS
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import opfmodel as om
from opfmodel.errors import ResultError
from opfmodel.results import load, save
from opfmodel.results.figures import save_figures


@pytest.fixture(scope="module")
def run() -> om.Run:
    changes = {"time.steps": 2, "controller.horizon": 2, "controller.formulation": "dc", "profiles": []}
    return om.load_scenario(SCENARIOS / "case5-step.yaml", overrides=changes).simulate()


@pytest.fixture
def folder(run: om.Run, tmp_path: Path) -> Path:
    """A folder with a saved run."""
    save(run.data, run.summary(), tmp_path)
    return tmp_path


def test_saved_results_are_read_back(run: om.Run, folder: Path) -> None:
    for path in (folder, folder / "trajectories.nc"):
        xr.testing.assert_identical(load(path), run.data)


def test_the_summary_has_the_checksum_of_the_trajectories(run: om.Run, folder: Path) -> None:
    saved = save(run.data, run.summary(), folder)
    assert (
        json.loads((folder / "summary.json").read_text())["trajectories_sha256"]
        == saved["trajectories_sha256"]
    )
    (folder / "summary.json").unlink()
    assert load(folder).sizes["time"] == 2


def zeroed(content: bytes) -> bytes:
    """The content with one block lost by the disk."""
    return content[:3200] + bytes(64) + content[3264:]


DAMAGE: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda content: b"",
    "a text": lambda content: b"time,bus\n1,2\n",
    "cut early": lambda content: content[:100],
    "cut in the middle": lambda content: content[: len(content) // 2],
    "cut at the end": lambda content: content[:-1],
    "other bytes": lambda content: bytes(len(content)),
    "without links": lambda content: content.replace(b"FRHP", b"XXXX"),
    "zeroed": zeroed,
}


@pytest.mark.parametrize("summary", ["with a summary", "without"])
@pytest.mark.parametrize("damage", DAMAGE)
def test_damaged_trajectories_give_a_one_line_error(
    damage: str, summary: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = folder / "trajectories.nc"
    path.write_bytes(DAMAGE[damage](path.read_bytes()))
    if summary == "without":
        (folder / "summary.json").unlink()
        if damage == "zeroed":
            pytest.skip("without a checksum, detection depends on the library")
    printed: list[object] = []  # errors in destructors, which Python would print
    monkeypatch.setattr(sys, "unraisablehook", printed.append)
    with pytest.raises(ResultError) as caught:
        load(folder)
    gc.collect()
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    assert printed == []


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=st.integers(0, 1_000_000), bit=st.integers(0, 7))
def test_any_flipped_bit_is_detected(place: int, bit: int, folder: Path) -> None:
    path = folder / "trajectories.nc"
    sound = path.read_bytes()
    damaged = bytearray(sound)
    damaged[place % len(sound)] ^= 1 << bit
    path.write_bytes(damaged)
    try:
        with pytest.raises(ResultError, match=r"trajectories\.nc: .*checksum"):
            load(folder)
    finally:
        path.write_bytes(sound)


def test_only_regular_files_are_read(folder: Path) -> None:
    path = folder / "trajectories.nc"
    path.unlink()
    with pytest.raises(ResultError, match=r"trajectories\.nc: no such file; 'opfmodel run'"):
        load(folder)
    os.mkfifo(path)
    with pytest.raises(ResultError, match=r"trajectories\.nc: is a pipe"):
        load(folder)
    with pytest.raises(ResultError, match="zero: is a device"):
        load("/dev/zero")
    for name in ("a\0b", "a" * 5000):
        with pytest.raises(ResultError, match="a"):
            load(name)


def test_a_damaged_summary_gives_an_error(folder: Path) -> None:
    (folder / "summary.json").write_text("{")
    with pytest.raises(ResultError, match=r"summary\.json: not JSON"):
        load(folder)


def test_other_data_are_refused(run: om.Run, tmp_path: Path) -> None:
    path = tmp_path / "other.nc"
    run.data.drop_vars("pd").to_netcdf(path, engine="h5netcdf")
    with pytest.raises(ResultError, match=r"other\.nc: not a result of opfmodel: 'pd'"):
        load(path)


def test_replacing_a_run_removes_the_old_summary(
    run: om.Run, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Killed(Exception):
        pass

    rename = Path.replace

    def killed(self: Path, target: Path) -> None:
        rename(self, target)
        raise Killed

    monkeypatch.setattr(Path, "replace", killed)
    with pytest.raises(Killed):
        save(run.data.assign(pd=run.data["pd"] + 1), run.summary(), folder)
    assert not (folder / "summary.json").exists()
    assert float(load(folder)["pd"].sum()) != float(run.data["pd"].sum())


def test_a_run_leaves_nothing_of_an_earlier_run(run: om.Run, folder: Path) -> None:
    save_figures(run.data, folder)
    (folder / "notes.txt").write_text("mine")
    save(run.data, run.summary(), folder)
    assert sorted(p.name for p in folder.iterdir()) == ["notes.txt", "summary.json", "trajectories.nc"]
    save(None, {"status": "locally_infeasible", "cost": None}, folder)
    assert sorted(p.name for p in folder.iterdir()) == ["notes.txt", "summary.json"]
    assert json.loads((folder / "summary.json").read_text()) == {"status": "locally_infeasible", "cost": None}


def test_a_full_disk_keeps_the_earlier_run(
    run: om.Run, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save_figures(run.data, folder, figures=["system"])
    before = {path: path.read_bytes() for path in folder.iterdir()}
    write = Path.write_bytes

    def full(self: Path, content: bytes) -> int:
        if self.name.startswith((".summary", ".system.png")):
            write(self, content[:10])
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(self, content)

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(ResultError, match=r"results cannot be written: No space left on device"):
        save(run.data.assign(pd=run.data["pd"] + 1), {}, folder)
    with pytest.raises(ResultError, match=r"figures cannot be written: No space left on device"):
        save_figures(run.data.assign(pd=run.data["pd"] + 1), folder, figures=["system"])
    assert {path: path.read_bytes() for path in folder.iterdir()} == before


def test_figures_are_pdf_and_png(run: om.Run, tmp_path: Path) -> None:
    written = save_figures(run.data, tmp_path / "new", figures=["system"])
    assert [path.name for path in written] == ["system.pdf", "system.png"]
    assert written[0].read_bytes().startswith(b"%PDF")
    assert written[1].read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("content", [b"network: {}\n", b"", b"CDF\x01" + bytes(100)])
def test_a_file_of_another_format_is_refused_in_plain_words(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "other.nc"
    path.write_bytes(content)
    with pytest.raises(ResultError, match=r"other\.nc: not a result of opfmodel: is not a NetCDF 4 file$"):
        load(path)


def test_a_figure_does_not_write_through_a_link(run: om.Run, tmp_path: Path) -> None:
    (tmp_path / "far").write_text("text")
    (tmp_path / "system.png").symlink_to(tmp_path / "far")
    save_figures(run.data, tmp_path, figures=["system"])
    assert (tmp_path / "far").read_text() == "text"
    assert not (tmp_path / "system.png").is_symlink()
