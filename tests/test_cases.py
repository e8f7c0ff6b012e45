"""Network files: formats, diagnostics, errors and round trips."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from conftest import DATA, SCENARIOS

import opfmodel as om
from opfmodel.errors import CaseError, CaseWarning
from opfmodel.network.cases.pandapower.write import write_pandapower

CASES = sorted([*DATA.glob("pglib/*.m"), *DATA.glob("matpower/*.m"), SCENARIOS / "data" / "case33bw.m"])


def contents(network: om.Network) -> dict:
    return {name: network[name] for name in network}


@pytest.mark.parametrize("path", CASES, ids=lambda p: p.stem)
def test_a_written_case_is_read_back_unchanged(path: Path, tmp_path: Path) -> None:
    network = om.read_network(path)
    again = om.read_network(om.write_network(network, tmp_path / "copy.m"))
    assert contents(again) == contents(network)
    assert again.base_mva == network.base_mva


def test_storage_survives_a_round_trip(tmp_path: Path) -> None:
    network = om.read_network(DATA / "matpower" / "case9.m")
    network.storage5 = om.Storage(
        "5", energy=80, power=(-20, 15), q=(-5, 6), charge_efficiency=0.9, initial=10,
        ps_set=3, qs_set=-1,
    )  # fmt: skip
    again = om.read_network(om.write_network(network, tmp_path / "copy.m"))
    assert again.storage5.resolved() == network.storage5


def test_emergency_ratings_are_those_of_the_file_and_survive_a_round_trip(tmp_path: Path) -> None:
    text = (DATA / "matpower" / "case9.m").read_text()
    rows = re.findall(r"^\t\d.*;$", text[text.index("mpc.branch") :], re.MULTILINE)[:3]
    plain = om.read_network(DATA / "matpower" / "case9.m")  # whose ratings B and C equal A
    assert {branch.emergency_rating for branch in plain.of(om.Branch).values()} == {None}
    for row, (second, third) in zip(rows, [(300, 0), (300, 350), (0, 0)], strict=False):
        cells = row.split("\t")
        assert cells[6] == cells[7] == cells[8]
        cells[7:9] = [str(second), str(third)]
        text = text.replace(row, "\t".join(cells), 1)
    (tmp_path / "case9.m").write_text(text)
    network = om.read_network(tmp_path / "case9.m")
    found = [branch.emergency_rating for branch in network.of(om.Branch).values()]
    assert found[:3] == [300, 350, None]
    assert found[3:] == [branch.rating for branch in network.of(om.Branch).values()][3:]
    again = om.read_network(om.write_network(network, tmp_path / "copy.m"))
    assert again.of(om.Branch) == network.of(om.Branch)
    with pytest.raises(CaseError, match=r"emergency ratings of 1-4, 4-5"):
        write_pandapower(network, tmp_path / "copy.json")


def test_numpy_numbers_are_written_as_plain_numbers(tmp_path: Path) -> None:
    grid = om.Network()
    grid.add("1", om.Bus(reference=True))
    grid.cell = om.Storage("1", energy=np.float64(20), power=np.int64(5))
    again = om.read_network(om.write_network(grid, tmp_path / "cell.m"))
    assert again.storage1.energy == 20
    assert again.storage1.power == (-5, 5)


def test_names_that_are_not_numbers_are_numbered(grid: om.Network, tmp_path: Path) -> None:
    with pytest.warns(CaseWarning, match="buses are numbered from 1"):
        again = om.read_network(om.write_network(grid, tmp_path / "copy.m"))
    assert list(again.of(om.Bus)) == ["1", "2"]
    assert again["1-2"].rating == 120


def test_data_that_matpower_cannot_represent_give_warnings(rich_grid: om.Network, tmp_path: Path) -> None:
    with pytest.warns(CaseWarning) as caught:
        om.write_network(rich_grid, tmp_path / "copy.m")
    messages = " ".join(str(w.message) for w in caught)
    assert "cable: MATPOWER has no branch shunt conductance or uneven charging" in messages
    assert "battery: standing_loss and energy_min are left out" in messages


@pytest.fixture
def other_formats(tmp_path: Path) -> dict[str, Path]:
    """The 14-bus case in other formats, written by powerio."""
    import powerio

    module = powerio.parse(str(DATA / "pglib" / "pglib_opf_case14_ieee.m"))
    paths = {
        "psse": tmp_path / "c.raw",
        "pandapower-json": tmp_path / "c.json",
        "pypsa-csv": tmp_path / "folder",
    }
    for name, path in paths.items():
        powerio.emit(module, name, str(path))
    return paths


def test_pandapower_and_pypsa_give_the_optimum_of_the_original(other_formats: dict[str, Path]) -> None:
    original = om.read_network(DATA / "pglib" / "pglib_opf_case14_ieee.m")
    for name in ("pandapower-json", "pypsa-csv"):
        network = om.read_network(other_formats[name])
        for generator, source in zip(
            network.of(om.Generator), original.of(om.Generator).values(), strict=True
        ):
            # PyPSA has no reactive limits, and the set-points that powerio writes fix the power there
            network.update(generator, p=source.p, q=source.q)
        found, expected = (om.MultiStage(n).solve().objective for n in (network, original))
        assert found == pytest.approx(expected, rel=1e-6)


def test_a_format_without_cost_needs_one(other_formats: dict[str, Path]) -> None:
    with pytest.raises(
        CaseError, match=r"c\.raw: no cost data for gen1, gen2, gen3, gen4, gen5; .*default_cost"
    ):
        om.read_network(other_formats["psse"])
    network = om.read_network(other_formats["psse"], default_cost=om.Polynomial(0, 30, 0))
    assert network.gen1.cost == om.Polynomial(0, 30, 0)
    assert om.MultiStage(network).solve().optimal


def test_piecewise_linear_costs_are_read() -> None:
    network = om.read_network(DATA / "matpower" / "case30pwl.m")
    assert network.gen1.cost.points == ((0, 0), (12, 144), (36, 1008), (60, 2832))
    assert om.MultiStage(network).solve().optimal


def case5(**replace: str) -> str:
    text = (DATA / "matpower" / "case5.m").read_text()
    for old, new in replace.values():
        assert old in text
        text = text.replace(old, new, 1)
    return text


def case5_cost(first: str) -> str:
    """The case with another first row of costs; the other rows are padded to its length."""
    text = (DATA / "matpower" / "case5.m").read_text()
    head, rest = text.split("mpc.gencost = [\n")
    rows = [row.rstrip(";").split() for row in rest.split("\n];")[0].split("\n")]
    width = len(first.split())
    table = [first, *(" ".join(row + ["0"] * (width - len(row))) for row in rows[1:])]
    return head + "mpc.gencost = [\n" + ";\n".join(table) + ";\n];\n"


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("missing.m", None, "no such file"),
        ("truncated.m", case5()[:900], "cannot be read as a network"),
        ("plain.json", "{}", "network: the format cannot be inferred; accepted are MATPOWER"),
        ("short.raw", "text", "cannot be read as a network: (?!.*[A-Z]+[.][A-Z]+).*SBASE"),
        ("unknown.xyz", "hello", "network: the format cannot be inferred; accepted are MATPOWER"),
        ("empty.m", "", "cannot be read as a network"),
        ("no_cost.m", case5().split("%%-----  OPF Data")[0], "no cost data for gen1"),
        ("cubic.m", case5_cost("2 0 0 4 1 0 14 0"), "cubic.m:57: gen1: cost: a polynomial of degree 3"),
        ("concave.m", case5_cost("2 0 0 3 -1 14 0"), "concave.m:57: gen1: cost = .*must be convex"),
        (
            "zero.m",
            case5(a=("0.00281	0.0281", "0	0")),
            "zero.m:44: 1-2: r, x = .*the impedance must be at least",
        ),
        (
            "limits.m",
            case5(a=("170	0	127.5	-127.5", "170	0	-127.5	127.5")),
            "limits.m:35: gen2: q = .*the minimum 127.5 is above",
        ),
    ],
)
def test_a_bad_file_gets_one_clear_error(name: str, text: str | None, message: str, tmp_path: Path) -> None:
    path = tmp_path / name
    if text is not None:
        path.write_text(text)
    with pytest.raises(CaseError, match=message) as caught:
        om.read_network(path)
    assert str(caught.value).startswith(str(path))


def test_symbolic_links_are_followed(other_formats: dict[str, Path], tmp_path: Path) -> None:
    for number, path in enumerate([DATA / "matpower" / "case5.m", *other_formats.values()]):
        link = tmp_path / f"link{number}{path.suffix}"
        link.symlink_to(path)
        cost = om.Polynomial(0, 30, 0)
        read, linked = (om.read_network(p, default_cost=cost) for p in (path, link))
        assert contents(linked) == contents(read)


READ_STRANGE_FILES = """
import os, sys
from pathlib import Path
import opfmodel as om

folder = Path(sys.argv[1])
paths = []
for suffix in (".m", ".raw"):
    os.mkfifo(folder / f"pipe{suffix}")
    for device in ("zero", "stdin"):
        (folder / f"{device}{suffix}").symlink_to(f"/dev/{device}")
    with (folder / f"endless{suffix}").open("wb") as stream:
        stream.truncate(10**12)
    paths += [folder / f"{n}{suffix}" for n in ("pipe", "zero", "stdin", "endless", "0\\0", "n" * 5000)]
(folder / "pypsa").mkdir()
os.mkfifo(folder / "pypsa" / "buses.csv")
for path in (*paths, folder / "pypsa"):
    try:
        om.read_network(path, format="pypsa-csv" if path.name == "pypsa" else None)
    except om.OpfmodelError as error:
        print(type(error).__name__)
"""


def test_devices_pipes_endless_files_and_strange_names_are_errors(tmp_path: Path) -> None:
    found = subprocess.run(
        [sys.executable, "-c", READ_STRANGE_FILES, str(tmp_path)],
        stdin=subprocess.PIPE, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert found.stderr == ""
    assert found.stdout.split() == ["CaseError"] * 13


def test_a_name_with_control_characters_is_refused_and_shown_escaped(tmp_path: Path) -> None:
    path = tmp_path / "red\x1b[31m.m"
    path.write_text(case5())
    with pytest.raises(CaseError, match="visible characters only") as caught:
        om.read_network(path)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("suffix", [".m", ".raw"])
def test_a_name_that_is_not_utf8_is_an_error(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / (os.fsdecode(b"caf\xe9") + suffix)
    path.write_text(case5())
    with pytest.raises(CaseError) as caught:
        om.read_network(path)
    assert str(caught.value).isprintable()


def test_messages_of_the_reader_are_shown_escaped(tmp_path: Path) -> None:
    path = tmp_path / "case.\x1b[31m"
    path.write_text("what the reader quotes")
    with pytest.raises(CaseError) as caught:
        om.read_network(path)
    assert str(caught.value).isprintable()


def test_a_path_that_cannot_be_written_is_an_error(grid: om.Network, tmp_path: Path) -> None:
    for name in ("nul\0.m", "n" * 5000 + ".m", "missing/case.m"):
        with pytest.raises(CaseError, match="cannot be written"), warnings.catch_warnings():
            warnings.simplefilter("ignore", CaseWarning)
            om.write_network(grid, tmp_path / name)


@pytest.mark.parametrize("names", [("²", "1"), ("01", "1"), ("٣", "1")])
def test_names_that_only_look_like_numbers_are_numbered(names: tuple[str, str], tmp_path: Path) -> None:
    grid = om.Network()
    for name in names:
        grid.add(name, om.Bus(reference=name == "1"))
    grid.tie = om.Branch(*names, r=0, x=1)
    with pytest.warns(CaseWarning, match="numbered from 1"):
        path = om.write_network(grid, tmp_path / "copy.m")
    assert list(om.read_network(path)) == ["1", "2", "1-2"]


def test_a_cost_without_its_numbers_is_an_error_in_every_format(tmp_path: Path) -> None:
    import json

    import powerio

    module = powerio.parse(str(DATA / "pglib" / "pglib_opf_case14_ieee.m"))
    path = tmp_path / "case.json"
    powerio.emit(module, "powermodels-json", str(path))
    tables = json.loads(path.read_text())
    tables["gen"]["2"]["cost"] = []
    path.write_text(json.dumps(tables))
    with pytest.raises(CaseError, match=r"case\.json: gen2: cost: "):
        om.read_network(path)


RESERVES = "\nmpc.reserves = [\n1 3 10;\n];\n"


def test_what_is_lost_is_an_error_unless_it_is_accepted(tmp_path: Path) -> None:
    path = tmp_path / "case.m"
    path.write_text(case5() + RESERVES)
    with pytest.raises(CaseError, match=r"case\.m: contains .*mpc\.reserves is not represented.*lossy=True"):
        om.read_network(path)
    with pytest.warns(CaseWarning, match=r"case\.m: lost: line \d+: mpc\.reserves is not represented"):
        network = om.read_network(path, lossy=True)
    assert contents(network) == contents(om.read_network(DATA / "matpower" / "case5.m"))


def test_statements_that_are_not_evaluated_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "program.m"
    path.write_text(case5() + "\nmpc.bus(:, 3) = 2 * mpc.bus(:, 3);\n")
    with pytest.raises(CaseError, match=r"program\.m: .*line 64: 'mpc\.bus\(:, 3\) = .*' is not evaluated"):
        om.read_network(path)


def test_a_clean_case_gives_no_warning() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        om.read_network(SCENARIOS / "data" / "case118.m")
