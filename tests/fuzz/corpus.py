"""What is mutated: seeds from the scenarios and the test data of the repository, by kind of input."""

from __future__ import annotations

import csv
import io
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cache
from pathlib import Path

from . import scenarios

__all__ = ["KINDS", "OUT", "Seed", "seeds"]

ROOT = Path(__file__).parents[2]
DATA = ROOT / "tests" / "data"
OUT = "@OUT@"
"""Stands for the output folder in a command."""
VALUE = "@VALUE@"
"""Stands for the content of the file ``value``, for what is given on the command line."""

Command = tuple[str, ...]


@dataclass(frozen=True)
class Seed:
    """Files that are accepted, and what is done with them.

    Attributes
    ----------
    targets
        Families of mutations by file.
    commands
        Commands, of which one is run for each input, in the folder of the files.
    imports
        Modules that the commands import and that take long to import.
    """

    name: str
    kind: str
    files: Mapping[str, bytes]
    targets: Mapping[str, Sequence[str]]
    commands: Sequence[Command]
    imports: Sequence[str] = ()


def _tree(folder: Path) -> dict[str, bytes]:
    """Contents of the files below a folder."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def _encoded(**texts: str) -> dict[str, bytes]:
    """Files by name; two underscores stand for a dot."""
    return {name.replace("__", "."): text.encode() for name, text in texts.items()}


# Scenarios --------------------------------------------------------------------------------------

YAML = ("yaml", "yaml", "words", "words", "lines", "bytes")


def _scenarios() -> Iterator[Seed]:
    beside = _encoded(
        series__csv=scenarios.SERIES, demand__csv=scenarios.DEMAND, forecast__csv=scenarios.FORECAST
    )
    beside["case.m"] = (DATA / "matpower" / "case9.m").read_bytes()
    for name, text in (("declared", scenarios.DECLARED), ("from-file", scenarios.FROM_FILE)):
        files = {"s.yaml": text.encode(), **beside}
        yield Seed(name, "scenario", files, {"s.yaml": YAML}, [("validate", "s.yaml")])
    case5 = (ROOT / "scenarios" / "case5-step.yaml").read_bytes()
    commands = [("validate", "s.yaml", "--json")]
    yield Seed("case5-step", "scenario", {"s.yaml": case5}, {"s.yaml": (*YAML, "file")}, commands)
    run = scenarios.TINY.encode()
    files = {"s.yaml": run, "demand.csv": scenarios.TINY_DEMAND.encode()}
    commands = [("run", "s.yaml", "--out", OUT, "--json", "--no-figures"), ("solve", "s.yaml")]
    yield Seed("tiny", "scenario", files, {"s.yaml": YAML}, commands)
    files = _encoded(s__yaml=scenarios.UNITS, t__csv=scenarios.STAMPED)
    commands = [("validate", "s.yaml"), ("info", "s.yaml"), ("convert", "s.yaml", f"{OUT}/x.yaml", "--lossy")]
    commands += [("powerflow", "s.yaml", "--json"), ("run", "s.yaml", "--out", OUT, "--json", "--no-figures")]
    yield Seed("units", "scenario", files, {"s.yaml": YAML}, commands)


# Networks ---------------------------------------------------------------------------------------


def _network_commands(file: str, *options: str) -> list[Command]:
    return [
        ("validate", file),
        ("validate", file, "--lossy", "--json"),
        ("solve", file, "--formulation", "dc", "--json", *options),
        ("info", file, "--lossy"),
        ("info", file, "--json"),
        ("powerflow", file, "--lossy", "--json", "--out", OUT),
        ("convert", file, f"{OUT}/x.m", "--lossy", *options),
        ("convert", file, f"{OUT}/x.yaml", "--lossy", "--json", *options),
        ("init", f"{OUT}/x.yaml", "--from", file, "--lossy"),
    ]


TEXT = ("words", "words", "lines", "bytes", "file")
NESTED = ("json", "nested", "nested", "words", "bytes", "file")
COST = ("--default-cost", "30")


def _networks() -> Iterator[Seed]:
    feeder = ROOT / "scenarios" / "data" / "case33bw.m"
    for path in (*(DATA / "matpower" / f"{name}.m" for name in ("case5", "case30pwl")), feeder):
        files = {"n.m": path.read_bytes()}
        yield Seed(path.stem, "network", files, {"n.m": TEXT}, _network_commands("n.m"))
    yield Seed(
        "psse", "network", {"n.raw": _emitted("psse")}, {"n.raw": TEXT}, _network_commands("n.raw", *COST)
    )


def _emitted(format: str) -> bytes:
    """The 14-bus case in a format of a single file."""
    import powerio

    module = powerio.parse(str(DATA / "pglib" / "pglib_opf_case14_ieee.m"))
    return str(powerio.emit(module, format).text).encode()


def _pandapower_networks() -> Iterator[Seed]:
    for name, content in (("case14", _emitted("pandapower-json")), ("multivoltage", _pandapower())):
        commands = _network_commands("n.json", *COST)
        yield Seed(name, "pandapower", {"n.json": content}, {"n.json": NESTED}, commands, ["pandapower"])


def _pypsa_networks() -> Iterator[Seed]:
    tree, netcdf = _pypsa_files()
    files = {f"n/{file}": content for file, content in tree.items()}
    targets = dict.fromkeys(files, ("words", "columns", "lines", "bytes", "file"))
    yield Seed("csv", "pypsa", files, targets, _network_commands("n", *COST), ["pypsa"])
    targets = {"n.nc": ("hdf5", "hdf5", "bytes", "file")}
    yield Seed("netcdf", "pypsa", {"n.nc": netcdf}, targets, _network_commands("n.nc", *COST), ["pypsa"])


def _pandapower() -> bytes:
    """A small network of pandapower with one of most elements, as JSON."""
    import pandapower
    from pandapower.networks import example_multivoltage

    return str(pandapower.to_json(example_multivoltage())).encode()


def _pypsa_files() -> tuple[dict[str, bytes], bytes]:
    """A small network of PyPSA with series, as a folder of CSV files and as a netCDF file."""
    import pypsa

    net = pypsa.Network()
    net.set_snapshots(["2025-03-29 22:00", "2025-03-29 23:00", "2025-03-30 00:00"])
    for bus in "ab":
        net.add("Bus", bus, v_nom=110)
    net.add("Line", "line", bus0="a", bus1="b", r=1.0, x=10.0, s_nom=100)
    net.add("Generator", "coal", bus="a", p_nom=150, marginal_cost=[20, 25, 30], control="Slack")
    net.add("Generator", "wind", bus="b", p_nom=40, p_max_pu=[0.1, 0.5, 0.9], marginal_cost=1)
    net.add("Load", "town", bus="b", p_set=[50, 60, 55], q_set=5)
    net.add(
        "StorageUnit",
        "cell",
        bus="b",
        p_nom=10,
        max_hours=4,
        efficiency_store=0.9,
        cyclic_state_of_charge=True,
    )
    with tempfile.TemporaryDirectory() as folder:
        net.export_to_csv_folder(str(Path(folder) / "csv"))
        net.export_to_netcdf(str(Path(folder) / "n.nc"))
        return _tree(Path(folder) / "csv"), (Path(folder) / "n.nc").read_bytes()


# Tables -----------------------------------------------------------------------------------------


def _tables() -> Iterator[Seed]:
    families = ("words", "words", "columns", "lines", "bytes", "file")
    commands = [("validate", "s.yaml"), ("solve", "s.yaml", "--json"), ("info", "s.yaml", "--json")]
    stamped = scenarios.TABLE.replace("time: {", "time: {start: 2025-03-29T00:00, zone: Europe/Berlin, ")
    for name, text, cells in (
        ("numbered", scenarios.TABLE, scenarios.CELLS),
        ("stamped", stamped, scenarios.STAMPED),
        ("resampled", stamped.replace("FILE", "FILE, resample: mean"), scenarios.QUARTERS),
    ):
        files = _encoded(s__yaml=text.replace("FILE", "t.csv"), t__csv=cells)
        yield Seed(f"csv-{name}", "table", files, {"t.csv": families}, commands)
        files = {"s.yaml": text.replace("FILE", "t.parquet").encode(), "t.parquet": _parquet(cells)}
        targets = {"t.parquet": ("parquet", "parquet", "parquet", "bytes", "file")}
        yield Seed(f"parquet-{name}", "table", files, targets, commands, ["pandas"])
        files = {"s.yaml": text.replace("FILE", "t.xlsx").encode(), "t.xlsx": _excel(cells)}
        targets = {"t.xlsx": ("zip", "zip", "zip", "bytes", "file")}
        yield Seed(f"excel-{name}", "table", files, targets, commands, ["openpyxl"])


def _parquet(cells: str) -> bytes:
    """A table as Parquet, with columns of numbers and of times."""
    import pyarrow.csv
    import pyarrow.parquet

    stream = io.BytesIO()
    pyarrow.parquet.write_table(pyarrow.csv.read_csv(io.BytesIO(cells.encode())), stream)
    return stream.getvalue()


def _excel(cells: str) -> bytes:
    """A table as an Excel file, with cells of numbers and of times."""
    from openpyxl import Workbook

    book = Workbook()
    for row in csv.reader(cells.splitlines()):
        book.active.append([_cell(word) for word in row])
    stream = io.BytesIO()
    book.save(stream)
    return stream.getvalue()


def _cell(word: str) -> float | datetime | str:
    for convert in (float, lambda word: datetime.fromisoformat(word).replace(tzinfo=None)):
        try:
            return convert(word)
        except ValueError:
            continue
    return word


# Studies ----------------------------------------------------------------------------------------


def _studies() -> Iterator[Seed]:
    files = _encoded(
        study__yaml=scenarios.STUDY, tiny__yaml=scenarios.TINY, demand__csv=scenarios.TINY_DEMAND
    )
    targets = {"study.yaml": (*YAML, "file"), "tiny.yaml": ("words",)}
    yield Seed("grid", "study", files, targets, [("validate", "study.yaml")])


def _records() -> Iterator[Seed]:
    from opfmodel.study import read_study, run_study

    files = _encoded(
        study__yaml=scenarios.STUDY, tiny__yaml=scenarios.TINY, demand__csv=scenarios.TINY_DEMAND
    )
    with tempfile.TemporaryDirectory() as folder:
        for name, content in files.items():
            (Path(folder) / name).write_bytes(content)
        run_study(read_study(Path(folder) / "study.yaml"), Path(folder) / "out", workers=0, progress=False)
        recorded = {f"out/{name}": content for name, content in _tree(Path(folder) / "out").items()}
    targets = {
        name: ("sealed", "sealed", "sealed", "json", "bytes", "file")
        for name in recorded
        if name.endswith(".json")
    }
    commands = [("study", "table", "out"), ("study", "table", "out", "--json")]
    yield Seed("records", "record", files | recorded, targets, commands)


# Results ----------------------------------------------------------------------------------------


DRAWING = ("matplotlib.font_manager", "h5netcdf", "xarray")  # the first writes a cache


def _results() -> Iterator[Seed]:
    from opfmodel.results import save
    from opfmodel.scenario import load_scenario

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, content in _encoded(
            s__yaml=scenarios.TABLE.replace("FILE", "t.csv"), t__csv=scenarios.CELLS
        ).items():
            (folder / file).write_bytes(content)
        done = load_scenario(folder / "s.yaml").simulate()
        save(done.data, done.summary(), folder / "run")
        files = {f"run/{file}": content for file, content in _tree(folder / "run").items()}
    commands = [
        ("plot", "run", "--out", OUT),
        ("plot", "run", "--out", OUT, "--paper", "--buses", "a", "--json"),
    ]
    yield Seed(
        "summary",
        "result",
        files,
        {"run/summary.json": ("json", "bytes", "file"), "run/trajectories.nc": ("file",)},
        commands,
        DRAWING,
    )
    # beside its summary, a damaged file is refused because of its checksum
    alone = {"r.nc": files["run/trajectories.nc"]}
    commands = [
        ("plot", "r.nc", "--out", OUT),
        ("plot", "r.nc", "--out", OUT, "--paper", "--bus", "a", "--json"),
    ]
    yield Seed("trajectories", "result", alone, {"r.nc": ("hdf5", "hdf5", "bytes")}, commands, DRAWING)


# The command line -------------------------------------------------------------------------------


def _overrides() -> Iterator[Seed]:
    files = _encoded(s__yaml=scenarios.TINY, demand__csv=scenarios.TINY_DEMAND)
    for setting in SETTINGS:
        given = {**files, "value": setting.encode()}
        commands = [("validate", "s.yaml", "--set", VALUE), ("info", "s.yaml", "--json", "--set", VALUE)]
        yield Seed(setting, "override", given, WORDS, commands)
    for option, value in OPTIONS:
        given = {**files, "value": value.encode()}
        yield Seed(option, "override", given, WORDS, [("solve", "s.yaml", "--json", option, VALUE)])


WORDS = {"value": ("words", "words", "words", "bytes")}
SETTINGS = (
    *("controller.horizon=2", "controller.formulation=dc", "time.steps=2", "time={steps: 2, step: 30 min}", "cost=economic"),
    *("network.generators.unit.p=[0, 90 MW]", "profiles=[{scale: {factor: 2}}]", "controller.solver={name: auto}", "time.at_end=repeat"),
)  # fmt: skip
OPTIONS = (("--formulation", "dc"), ("--solver", "auto"), ("--horizon", "2"), ("--on-infeasible", "elastic"))


_MAKERS: Mapping[str, Callable[[], Iterator[Seed]]] = {
    "scenario": _scenarios,
    "network": _networks,
    "pandapower": _pandapower_networks,
    "pypsa": _pypsa_networks,
    "table": _tables,
    "study": _studies,
    "record": _records,
    "result": _results,
    "override": _overrides,
}
KINDS = tuple(_MAKERS)


@cache
def seeds(kind: str) -> tuple[Seed, ...]:
    """Return the seeds of a kind of input."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return tuple(_MAKERS[kind]())
