"""The wheel, built from the source distribution, works in an environment of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest
from conftest import ROOT

pytestmark = pytest.mark.slow


def ran(*command: str | Path, cwd: Path) -> str:
    """What a command prints; it must succeed."""
    clean = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(
        list(map(str, command)), cwd=cwd, env=clean, check=False, capture_output=True, text=True
    )
    assert done.returncode == 0, f"{command}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel."""
    source, made = (tmp_path_factory.mktemp(name) for name in ("source", "made"))
    tracked = ran("git", "ls-files", "-z", cwd=ROOT).split("\0")
    for name in filter(None, tracked):  # without what is generated beside the sources
        if (ROOT / name).is_file():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            (source / name).write_bytes((ROOT / name).read_bytes())
    ran(sys.executable, "-m", "build", "--outdir", made, source, cwd=made)
    [found] = made.glob("*.whl")
    return found


def test_the_wheel_holds_the_packages_and_their_data(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    for needed in (
        "opfmodel/py.typed",
        "opfmodel/__init__.pyi",
        "opfmodel/network/__init__.pyi",
        "opfmodel/results/report/assets/page.js",
        "solvers/py.typed",
    ):
        assert needed in names
    assert {name.split("/")[0].split("-")[0] for name in names} == {"opfmodel", "solvers"}


def test_the_wheel_works_in_an_environment_of_its_own(wheel: Path, tmp_path: Path) -> None:
    venv.create(tmp_path / "env", with_pip=True)
    binaries = tmp_path / "env" / ("Scripts" if os.name == "nt" else "bin")
    ran(binaries / "python", "-m", "pip", "install", "--quiet", wheel, cwd=tmp_path)
    command = binaries / "opfmodel"
    case = ROOT / "tests" / "data" / "pglib" / "pglib_opf_case14_ieee.m"
    solved = json.loads(ran(command, "solve", case, "--json", cwd=tmp_path))
    assert solved["objective"] == pytest.approx(2178.08, rel=1e-5)
    plugins = json.loads(ran(command, "list", "--json", cwd=tmp_path))
    assert plugins
    ran(command, "doctor", cwd=tmp_path)
    ran(command, "init", "first.yaml", cwd=tmp_path)
    ran(command, "run", "first.yaml", "--out", "first", cwd=tmp_path)
    ran(command, "report", "first", cwd=tmp_path)
    assert (tmp_path / "first" / "report.html").stat().st_size > 1_000_000
