"""The command line: output, files and exit status."""

from __future__ import annotations

import json
import os
import re
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path

import pytest
from conftest import DATA, SCENARIOS, Call

from opfmodel import cli
from opfmodel.cli.show import comparisons
from opfmodel.results import load
from opfmodel.study.comparison import Comparison

CASE14 = DATA / "pglib" / "pglib_opf_case14_ieee.m"
CASE5 = SCENARIOS / "case5-step.yaml"
SHORT = ("--set", "time.steps=3", "--set", "controller.horizon=6")


def test_solve_a_network_file(call: Call) -> None:
    code, out, _ = call("solve", CASE14, "--json")
    result = json.loads(out)
    assert code == 0
    assert result["status"] == "locally_optimal"
    assert result["objective"] == pytest.approx(2178.08, rel=1e-4)
    assert result["max_violation"] <= 1e-6
    assert (result["formulation"], result["solver"]) == ("ac", "ipopt")
    assert {"build_seconds", "solve_seconds", "iterations"} <= set(result)
    code, out, _ = call("solve", CASE14)
    assert code == 0
    assert "2,178.08" in out


def test_solve_reports_how_far_a_relaxation_is_from_exact(call: Call) -> None:
    _, out, _ = call("solve", CASE14, "--formulation", "soc", "--json")
    relaxation = json.loads(out)["relaxation"]
    assert set(relaxation) == {"largest_cone_slack", "largest_angle_mismatch"}
    assert 0 <= relaxation["largest_cone_slack"] < 1e-3
    assert "largest angle mismatch" in call("solve", CASE14, "--formulation", "soc")[1]
    assert json.loads(call("solve", CASE14, "--json")[1])["relaxation"] == {}


def test_solve_a_scenario(call: Call) -> None:
    code, out, _ = call("solve", CASE5, "--horizon", 4, "--json")
    assert code == 0
    assert json.loads(out)["rows"] < 120


def test_an_infeasible_problem_ends_with_1(call: Call, tmp_path: Path) -> None:
    text = CASE5.read_text().replace("factor: 1.06", "factor: 3.0")
    path = tmp_path / "heavy.yaml"
    path.write_text(text.replace("generator_delay: 1", "generator_delay: 0"))
    code, out, _ = call("solve", path, "--horizon", 2, "--json")
    assert code == 1
    assert json.loads(out)["status"] == "locally_infeasible"
    assert json.loads(out)["objective"] is None
    code, out, _ = call("run", path, *SHORT, "--json", "--out", tmp_path / "out")
    assert code == 1
    assert json.loads(out)["status"] == "locally_infeasible"
    assert json.loads(out)["cost"] is None
    code, out, _ = call("run", path, *SHORT, "--out", tmp_path / "out")
    assert code == 1
    assert "none" in out


def test_any_formulation_and_solver_by_name(call: Call) -> None:
    code, out, _ = call("solve", CASE14, "--formulation", "dc", "--solver", "qp:osqp", "--json")
    result = json.loads(out)
    assert (code, result["status"]) == (0, "globally_optimal")
    assert (result["formulation"], result["solver"]) == ("dc", "osqp")
    assert result["objective"] == pytest.approx(2051.5, rel=1e-4)
    assert result["iterations"] > 0
    code, out, _ = call("solve", CASE14, "--formulation", "dc", "--solver", "qp:highs")
    assert code == 0
    assert "highs, iterations not reported" in out


def test_run_saves_trajectories_summary_and_a_figure(call: Call, tmp_path: Path) -> None:
    out_folder = tmp_path / "deep" / "out"
    code, out, _ = call("run", CASE5, *SHORT, "--out", out_folder, "--json")
    summary = json.loads(out)
    assert code == 0
    assert {"status", "cost", "steps", "solve_seconds_mean", "solve_seconds_max", "iterations_mean"} <= set(
        summary
    )
    assert summary["max_violation"] <= 1e-6
    assert sorted(p.name for p in out_folder.iterdir()) == [
        "summary.json",
        "system.pdf",
        "system.png",
        "trajectories.nc",
    ]
    data = load(out_folder)
    assert data.attrs["cost"] == pytest.approx(summary["cost"])
    assert data.sizes["time"] == 3
    assert json.loads((out_folder / "summary.json").read_text()) == summary
    code, out, _ = call("plot", out_folder, "--json", "--bus", "1", "--bus", "4")
    assert len(json.loads(out)["figures"]) == 6
    assert all(Path(p).stat().st_size > 1000 for p in json.loads(out)["figures"])
    code, _, err = call("plot", out_folder, "--bus", "9")
    assert (code, err) == (2, "error: no bus is named '9'; available: 1, 2, 3, 4, 5\n")


def test_run_prints_a_short_table(call: Call, tmp_path: Path) -> None:
    code, out, _ = call("run", CASE5, *SHORT, "--out", tmp_path)
    assert code == 0
    assert [line.split()[0] for line in out.splitlines()] == [
        "scenario",
        "status",
        "cost",
        "solve",
        "iterations",
        "max",
        "results",
    ]


def test_validate(call: Call, tmp_path: Path) -> None:
    code, out, _ = call("validate", CASE5, "--json")
    assert (code, json.loads(out)["buses"]) == (0, 5)
    code, out, _ = call("validate", SCENARIOS / "data" / "case33bw.m")
    assert code == 0
    assert "33 buses" in out
    bad = tmp_path / "bad.yaml"
    bad.write_text(CASE5.read_text().replace("horizon: 48", "horizn: 48"))
    code, out, err = call("validate", bad, "--json")
    assert code == 2
    assert "did you mean 'horizon'" in json.loads(out)["error"]
    assert err.startswith("error: ")


@pytest.mark.parametrize("command", ["solve", "validate"])
@pytest.mark.parametrize(
    ("name", "accept"), [("more.m", ["--lossy"]), ("more.yaml", ["--set", "network.lossy=true"])]
)
def test_losses_of_a_network_file_are_refused_or_accepted(
    command: str, name: str, accept: list[str], call: Call, tmp_path: Path
) -> None:
    text = (DATA / "matpower" / "case5.m").read_text() + "\nmpc.reserves = [\n1 3 10;\n];\n"
    (tmp_path / "more.m").write_text(text)
    (tmp_path / "more.yaml").write_text("network: {file: more.m}\n")
    code, out, err = call(command, tmp_path / name)
    assert (code, out, err.startswith("error: "), "mpc.reserves" in err) == (2, "", True, True)
    code, _, err = call(command, tmp_path / name, *accept)
    assert (code, err.startswith("warning: "), "mpc.reserves" in err) == (0, True, True)


def test_validate_reads_every_variant(call: Call, tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(WEAK + "variants:\n  fine: {}\n  bad: {controller: {horizon: 0}}\n")
    code, _, err = call("validate", path)
    assert code == 2
    message, line, caret = err.splitlines()
    assert message.startswith(f"error: {path}:12:22: controller.horizon: 0: ")
    assert message.endswith("(variant 'bad')")
    assert line[caret.index("^") :].startswith("horizon: 0}")
    assert call("validate", path, "--variant", "fine")[0] == 0


def test_only_an_error_caused_by_an_option_cites_it(call: Call, tmp_path: Path) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(TWO_BUSES.replace("horizon: 3", "horizon: 0"))
    fault = f"error: {path}:8:14: controller.horizon: 0: "
    assert call("solve", path, "--set", "time.steps=2")[2].startswith(fault)
    both = call("solve", path, "--set", "time.steps=0")[2]
    assert both.startswith(fault)
    assert "error: --set time.steps=0: time.steps: 0: " in both
    assert call("run", path, "--on-infeasible", "elastic")[2].startswith(fault)
    assert call("solve", path, "--horizon", "2", "--formulation", "nosuch")[2].startswith(
        "error: --formulation nosuch: controller.formulation: "
    )


@pytest.mark.parametrize("command", [(), ("study",)])
def test_without_a_command_the_usage_is_printed(call: Call, command: tuple[str, ...]) -> None:
    code, out, err = call(*command)
    assert (code, out) == (2, "")
    assert err.startswith(f"Usage: {' '.join(['opfmodel', *command])} ")
    lines = err.splitlines()
    assert any(line.lstrip().startswith("run  ") for line in lines)
    assert "\\n" not in err


def test_the_version_is_printed(call: Call) -> None:
    assert call("--version") == (0, f"opfmodel {version('opfmodel')}\n", "")


def test_counts_are_written_as_words(call: Call, two_buses: Path, tmp_path: Path) -> None:
    linear = ("--set", "controller.formulation=dc", "--set", "controller.solver=qp:highs")
    code, out, _ = call("run", two_buses, *linear, "--out", tmp_path / "out")
    assert (code, "iterations     not reported\n" in out) == (0, True)
    for horizon, size in ((1, "1 stage of 1 h"), (2, "2 stages of 1 h")):
        assert size in call("solve", two_buses, "--horizon", horizon, "--solver", "clarabel")[2]


def test_list(call: Call) -> None:
    code, out, _ = call("list", "--json")
    entries = json.loads(out)["plugins"]
    assert code == 0
    assert ("formulation", "ac", "opfmodel") in {(e["kind"], e["name"], e["origin"]) for e in entries}
    assert all(e["summary"] for e in entries)
    assert not [e for e in entries if ":math:" in e["summary"] or "`" in e["summary"]]
    options = {(e["kind"], e["name"]): e["options"] for e in entries}
    stated = ["deviation", "seed", "correlation=0.9", "fields=[p, q, p_max, available]", "common_share=0"]
    assert options["forecast", "noisy"] == stated
    assert options["profile", "scale"] == ["factor", "loads=null"]
    assert options["formulation", "ac"] == []
    shown = call("list")[1]
    assert "economic" in shown
    assert "factor, loads=null" in shown


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("solve", "none.m"), "none.m: no such file"),
        (("solve", "none.yaml"), "none.yaml: no such file"),
        (("run", CASE14), r"pglib_opf_case14_ieee\.m: .*\.yaml"),
        (("solve", CASE14, "--formulation", "acc"), "there is no formulation 'acc'; did you mean 'ac'"),
        (("solve", CASE14, "--solver", "nosuch"), "solver .*'nosuch'; available: .*ipopt"),
        (
            ("solve", CASE14, "--solver", "qp"),
            "make it a nonlinear program; back ends that accept it: expanded, ipopt, windows",
        ),
        (("solve", CASE14, "--horizon", "0"), "horizon = 0"),
        (("solve", CASE14, "--variant", "x"), r"pglib_opf_case14_ieee\.m: --variant and --set"),
        (("run", CASE5, "--set", "controller"), "--set controller: .*KEY=VALUE"),
        (("run", CASE5, "--set", "controller.x=1"), "controller.x: unknown key"),
        (("run", CASE5, "--set", "time.steps=[1"), r"--set time.steps=\[1: not YAML"),
        (
            ("run", CASE5, "--set", "controller.solver.options={no_such: 1}"),
            "ipopt .*'no_such': 1",
        ),
        (("run", CASE5, "--set", f"x={'[' * 20_000}"), r"--set x=\[+\.\.\.: not YAML"),
        (("run", CASE5, "--set", f"x={'{a: ' * 20_000}"), r"--set x=.*\.\.\.: nested too deeply"),
        (("run", CASE5, "--set", f"{'a.' * 20_000}a=1"), "has 20001 parts"),
        (("run", CASE5, "--set", f"time.steps={10**30}"), "--set time.steps=10*: .*integers of more than 64"),
        (("run", CASE5, "--set", f"name={'x' * 5000}"), r"--set name=x+\.\.\.: name: .* at most 120 bytes"),
        (("run", f"{'x' * 5000}.yaml"), "xxx.yaml: cannot be read"),
        (
            ("run", CASE5, "--set", "time=2019-07-22"),
            "--set time=2019-07-22: time: '2019-07-22': must be a mapping",
        ),
        (
            ("run", CASE5, "--set", "network.base_mva=1e308"),
            "--set network.base_mva=1e308: network.base_mva: 1e.308: must be a finite",
        ),
        (
            ("solve", CASE5, "--formulation", "acc"),
            "error: --formulation acc: controller.formulation: .* 'acc'",
        ),
        (("solve", CASE5, "--solver", "nosuch"), "error: --solver nosuch: controller.solver: .*'nosuch'"),
        (("solve", CASE5, "--horizon", "0"), "error: --horizon 0: controller.horizon: 0: "),
        (("solve", CASE5, "--default-cost", "3"), "--default-cost .*network.default_cost"),
        (("solve", CASE5, "--lossy"), "--lossy .*--set network.lossy=true"),
        (("validate", CASE5, "--lossy"), "--lossy .*--set network.lossy=true"),
        (("plot", CASE5), r"case5-step\.yaml: not a result of opfmodel: is not a NetCDF 4 file$"),
        (("plot", "x" * 5000), "no such file"),
        (("plot", "/dev/zero"), "is a device"),
        (("frobnicate",), "No such command"),
        (("solve",), "Missing argument"),
        (("solve", CASE14, "--horizon", "x"), "Invalid value for '--horizon': 'x': must be an integer"),
        (("plot", "nowhere"), "no such file"),
    ],
)
def test_bad_input_is_one_line_with_an_excerpt_and_status_2(
    call: Call, arguments: tuple, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # whatever results an earlier run has left
    code, out, err = call(*arguments)
    assert code == 2
    assert out == ""
    assert message in err or re.search(message, err)
    first, *excerpt = err.splitlines()
    assert first.startswith("error: ")
    assert not excerpt or (len(excerpt) == 2 and excerpt[1].strip() == "^")


@pytest.mark.parametrize(
    "arguments",
    [
        ("solve", "\x1b[31m.m"),
        ("solve", "\x1b[31m.yaml", "--json"),
        ("solve", CASE14, "--formulation", "\x9b31m"),
        ("solve", CASE14, "--solver", "a\x7fb", "--json"),
        ("run", CASE5, "--set", "cost=\x1b[31m"),
        ("run", CASE5, "--set", 'cost="\\e[31m\\u2028"'),
        ("run", CASE5, "--set", "\x1b=1"),
        ("run", CASE5, "--set", 'name="\udc9b"'),
        ("validate", CASE5, "--variant", "\u202e"),
        ("plot", "\x1b]0;title\x07"),
        ("frobnicate\x1b",),
        ("solve", CASE14, "--\x1b"),
    ],
)
def test_no_escape_reaches_the_terminal(call: Call, arguments: tuple) -> None:
    code, out, err = call(*arguments)
    assert code == 2
    assert err.startswith("error: ")
    for text in (out, err):
        assert text.replace("\n", "").isprintable()
    assert not out or "error" in json.loads(out)


def test_names_in_tables_are_not_markup(capsys: pytest.CaptureFixture[str]) -> None:
    costs = dict.fromkeys(("J_e", "J_s", "J_t", "J_b"))
    comparisons([Comparison("[/red]a\x1b[1m", costs, {}, {})])
    assert "[/red]a\\x1b[1m" in capsys.readouterr().out


def test_all_printing_passes_one_function() -> None:
    sources = [path.read_text() for path in Path(cli.__file__).parent.glob("*.py")]
    printing = [line for source in sources for line in source.splitlines() if " print(" in line]
    assert printing
    assert all("print(visible(" in line for line in printing)


def test_a_letter_missing_from_the_encoding_is_escaped(tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(f"name: Łódź\n{WEAK}", encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-c", "from opfmodel import cli; cli.main()", "validate", path],
        capture_output=True,
        env=os.environ | {"PYTHONIOENCODING": "latin-1"},
        check=False,
    )
    assert (done.returncode, b"\\u0141" in done.stdout) == (0, True)


def test_solver_options_that_are_refused_are_bad_input(call: Call) -> None:
    options = "controller.solver={name: ipopt, options: {no_such: 1}}"
    code, _, err = call("solve", CASE5, "--horizon", 2, "--set", options)
    assert code == 2
    assert "no_such" in err


def test_a_folder_that_cannot_be_written_is_reported(call: Call, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    code, _, err = call("run", CASE5, *SHORT, "--out", tmp_path / "file")
    assert code == 2
    assert "results cannot be written" in err


TWO_BUSES = """
network:
  buses: {north: {reference: true}, south: {}}
  branches: {tie: {from_bus: north, to_bus: south, r: 0.01, x: 0.1, rating: 120}}
  generators: {coal: {bus: north, p: [0, 200], q: [-80, 80], cost: {c1: 15}}}
  loads: {town: {bus: south, p: 90, q: 30}}
time: {steps: 4}
controller: {horizon: 3}
"""


@pytest.fixture
def two_buses(tmp_path: Path) -> Path:
    path = tmp_path / "two-buses.yaml"
    path.write_text(TWO_BUSES)
    return path


@contextmanager
def full_disk(most_bytes: int) -> Iterator[None]:
    """Let this process write small files only."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("most_bytes", [1_000, 12_000, 45_000])
def test_a_full_disk_is_reported_in_one_line(
    most_bytes: int, call: Call, two_buses: Path, tmp_path: Path
) -> None:
    with full_disk(most_bytes):
        code, out, err = call("run", two_buses, "--out", tmp_path / "out", "--json")
    assert code == 2
    assert "cannot be written: File too large" in json.loads(out)["error"]
    *warned, last = err.splitlines()
    assert last.startswith("error: ")
    assert all("the checkpoint cannot be written: File too large" in line for line in warned)
    written = sorted(p.name for p in (tmp_path / "out").iterdir())
    assert (
        written
        == {1_000: [], 12_000: ["checkpoint"], 45_000: ["summary.json", "trajectories.nc"]}[most_bytes]
    )


def test_what_a_full_disk_did_not_take_is_written_later(call: Call, two_buses: Path, tmp_path: Path) -> None:
    command = ("run", two_buses, "--out", tmp_path / "out", "--json", "--no-figures")
    often = ("--set", "checkpoint.seconds=0")
    with full_disk(12_000):
        assert "the same command with --resume" in call(*command, *often)[2]
    code, out, _ = call(*command, *often, "--resume")
    assert (code, json.loads(out)["status"]) == (0, "done")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["summary.json", "trajectories.nc"]


def test_figures_on_a_full_disk_are_reported_in_one_line(call: Call, two_buses: Path, tmp_path: Path) -> None:
    assert call("run", two_buses, "--out", tmp_path / "out", "--no-figures")[0] == 0
    with full_disk(4_000):
        code, out, err = call("plot", tmp_path / "out", "--json")
    assert code == 2
    assert "figures cannot be written: File too large" in json.loads(out)["error"]
    assert err.count("\n") == 1


def test_the_results_folder_describes_the_last_run(call: Call, two_buses: Path, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    assert call("run", two_buses, "--out", folder)[0] == 0
    assert call("plot", folder)[0] == 0
    assert call("run", two_buses, "--out", folder, "--no-figures")[0] == 0
    assert sorted(p.name for p in folder.iterdir()) == ["summary.json", "trajectories.nc"]
    heavy = ("--set", "network.loads.town.p=500")
    code, out, _ = call("run", two_buses, "--out", folder, *heavy, "--force")
    assert (code, f"results        {folder}" in out) == (1, True)
    assert [p.name for p in folder.iterdir()] == ["summary.json"]
    summary = json.loads((folder / "summary.json").read_text())
    assert (summary["status"], summary["steps"], summary["cost"]) == ("locally_infeasible", 0, None)
    code, _, err = call("plot", folder)
    assert (code, "the run in this folder completed no step" in err) == (2, True)


def test_a_folder_without_a_run_is_reported(call: Call, tmp_path: Path) -> None:
    (tmp_path / "trajectories.nc").write_text("junk")
    code, _, err = call("plot", tmp_path)
    assert code == 2
    assert "not a result of opfmodel: is not a NetCDF 4 file" in err


def start(script: str, *arguments: object) -> subprocess.Popen[str]:
    """Start a process that runs a script and then the command line, and responds to Ctrl-C."""
    obey = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    return subprocess.Popen(
        [
            sys.executable,
            "-c",
            f"{obey}\n{script}\nfrom opfmodel import cli; cli.main()",
            *map(str, arguments),
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


# reports each step on standard error, so that the interrupt comes in the middle of the run
TELL = """
import opfmodel.simulation as simulation, sys
apply = simulation.NominalPlant.apply
def told(self, plan):
    print("step", plan.time, file=sys.stderr, flush=True)
    return apply(self, plan)
simulation.NominalPlant.apply = told
"""


def test_ctrl_c_keeps_finished_steps(tmp_path: Path) -> None:
    process = start(TELL, "run", CASE5, "--json", "--out", tmp_path)
    assert process.stderr is not None
    for line in process.stderr:
        if line.strip() == "step 3":
            process.send_signal(signal.SIGINT)
            break
    out, err = process.communicate()
    summary = json.loads(out)
    assert process.returncode == 1
    assert summary["status"] == "stopped"
    assert 3 <= summary["steps"] < 49
    assert summary["termination"] == f"interrupted after {summary['steps']} steps"
    assert load(tmp_path).sizes["time"] == summary["steps"]
    assert "Traceback" not in err


# output of a library that bypasses Python's standard output
PRINT = """
import ctypes, os
from opfmodel.plan import MultiStage
solve = MultiStage.solve
def banner(*arguments, **options):
    ctypes.CDLL(None).puts(b"BANNER")
    os.write(1, b"BANNER")
    return solve(*arguments, **options)
MultiStage.solve = banner
"""


@pytest.mark.parametrize(
    "arguments",
    [("solve", CASE14), ("solve", CASE14, "--verbose"), ("run", CASE5, *SHORT), ("table",)],
    ids=["solve", "verbose", "run", "table"],
)
def test_solver_output_is_separate_from_results(arguments: tuple, tmp_path: Path) -> None:
    if arguments[0] == "table":
        (tmp_path / "s.yaml").write_text(WEAK.replace("p: 300", "p: 3"))
        arguments = ("table", tmp_path / "s.yaml")
    elif arguments[0] == "run":
        arguments = (*arguments, "--out", tmp_path, "--no-figures")
    out, err = start(PRINT, *arguments, "--json").communicate()
    assert isinstance(json.loads(out), dict)
    for text in ("BANNER", "iter    objective"):
        assert (text in err) == ("--verbose" in arguments)


PRESS = """
import os, signal
from opfmodel.plan import MultiStage
def solve(*arguments, **options):
    os.kill(os.getpid(), signal.SIGINT)
MultiStage.solve = solve
"""


@pytest.mark.parametrize("command", ["solve", "table"])
def test_ctrl_c_is_reported_and_ends_with_1(command: str) -> None:
    process = start(PRESS, command, CASE5)
    out, err = process.communicate()
    assert (process.returncode, out, err) == (1, "", "error: interrupted\n")


def test_help_needs_no_heavy_library() -> None:
    code = "import sys, opfmodel, opfmodel.cli; print([m for m in ('casadi', 'numpy', 'xarray', 'pydantic') if m in sys.modules])"
    out = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=os.environ.copy()
    )
    assert out.stdout.strip() == "[]"


HEAVY = ("--set", "profiles=[{scale: {factor: 1.5}}]", "--set", "controller.generator_delay=0")


def test_solve_diagnoses_an_infeasible_problem(call: Call) -> None:
    arguments = ("solve", CASE5, *HEAVY, "--horizon", 2, "--on-infeasible", "elastic")
    code, out, _ = call(*arguments, "--json")
    result = json.loads(out)
    assert code == 1
    assert result["status"] == "locally_infeasible"
    assert "--on-infeasible elastic" in call(*arguments[:-2])[1]
    (sentence,) = result["diagnosis"]["0"]  # by step, as for a closed loop
    assert sentence.startswith("branch 4-5 exceeds its rating by 14.0 MVA at hour 0 (in 2 stages)")
    code, out, _ = call(*arguments)
    assert f"diagnosis: {sentence}" in out
    assert json.loads(call(*arguments[:-2], "--json")[1])["diagnosis"] == {}


def test_run_continues_with_elastic_plans(call: Call, tmp_path: Path) -> None:
    short = (*HEAVY, "--set", "time.steps=2", "--set", "controller.horizon=2", "--out", tmp_path)
    code, out, _ = call("run", CASE5, *short, "--on-infeasible", "elastic", "--json")
    summary = json.loads(out)
    assert (code, summary["status"], summary["elastic_steps"]) == (0, "done", 2)
    assert "branch 4-5" in summary["diagnosis"]["0"][0]
    assert summary["max_violation"] == pytest.approx(0.14, abs=0.01)
    assert load(tmp_path)["plan_status"].values.tolist() == ["elastic", "elastic"]
    code, _, err = call("run", CASE5, "--on-infeasible", "pray")
    assert (code, "--on-infeasible pray: must be stop or elastic" in err) == (2, True)


def test_soft_limits_are_a_key_of_a_scenario(call: Call, tmp_path: Path) -> None:
    soft = (
        *HEAVY,
        "--set",
        "time.steps=2",
        "--set",
        "controller.horizon=2",
        "--set",
        "controller.limits=soft",
    )
    code, out, _ = call("solve", CASE5, *soft, "--json")
    plan = json.loads(out)
    assert (code, plan["status"]) == (0, "locally_optimal")
    assert plan["objective"] > 1.1 * plan["expected_cost"]
    assert "branch 4-5 exceeds its rating" in plan["diagnosis"]["0"][0]
    assert "diagnosis: branch 4-5 exceeds" in call("solve", CASE5, *soft)[1]
    code, out, _ = call("run", CASE5, *soft, "--out", tmp_path, "--json", "--no-figures")
    summary = json.loads(out)
    assert (code, summary["elastic_steps"], summary["retries"]) == (0, 2, {})
    code, _, err = call("solve", CASE5, "--set", "controller.limits=none")
    assert (code, "'hard'" in err) == (2, True)


def test_penalty_prices_are_keys_of_a_scenario(call: Call, tmp_path: Path) -> None:
    weak = tmp_path / "weak.yaml"
    weak.write_text(
        "network:\n  buses: {a: {}, b: {}}\n  branches: {l: {from_bus: a, to_bus: b, r: 0, x: 0.1, rating: 50}}\n"
        "  generators: {g: {bus: a, p: [0, 100]}}\n  loads: {town: {bus: b, p: 80}}\n"
        "controller: {formulation: dc, on_infeasible: elastic}\n"
    )
    for prices, lacking in (
        ((), "branch l exceeds its rating by 30.0 MVA"),
        (("shedding=100",), "b lacks 30.0 MW"),
    ):
        keys = [word for price in prices for word in ("--set", f"controller.elastic.{price}")]
        code, out, _ = call("solve", weak, "--on-infeasible", "elastic", *keys)
        assert (code, lacking in out) == (1, True)
        code, out, _ = call("run", weak, "--out", tmp_path, "--json", "--no-figures", "--force", *keys)
        assert lacking in json.loads(out)["diagnosis"]["0"][0]
    for price in ("0", "-1", ".inf", "much"):
        code, _, err = call("solve", weak, "--set", f"controller.elastic.shedding={price}")
        assert (code, "controller.elastic.shedding" in err) == (2, True)


def test_run_with_an_ac_plant(call: Call, tmp_path: Path) -> None:
    plant = ("--set", "plant.mode=power-flow", "--set", "controller.formulation=dc", "--out", tmp_path)
    code, out, _ = call("run", CASE5, *SHORT, *plant)
    assert code == 0
    assert "limits           exceeded in 3 of 3 steps" in out
    assert "worst violation  generator q at " in out
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["redispatched_mwh"] > 1
    assert float(load(tmp_path)["flow_excess"].max()) == pytest.approx(summary["largest_flow_excess"])


def test_non_finite_values_are_null_in_json(call: Call, tmp_path: Path) -> None:
    (tmp_path / "weak.yaml").write_text(WEAK)
    code, out, _ = call("run", tmp_path / "weak.yaml", "--out", tmp_path, "--json", "--no-figures")
    assert code == 1  # the plant found no solution
    for text in (out, (tmp_path / "summary.json").read_text()):
        summary = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
        assert (summary["status"], summary["unsolved_steps"]) == ("unsolved", 1)
        assert summary["cost"] is None


# a line too weak for AC power flow, planned with DC
WEAK = """
network:
  buses: {a: {reference: true}, b: {}}
  branches: {l: {from_bus: a, to_bus: b, r: 0.1, x: 1}}
  generators: {coal: {bus: a, p: [0, 500]}}
  loads: {town: {bus: b, p: 300}}
cost: {loss-minimisation: {price: 1}}
controller: {formulation: dc, objective: economic}
plant: {mode: power-flow}
"""
