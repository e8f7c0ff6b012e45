"""The command line. Exit status: 0 done; 1 not solved or interrupted; 2 bad input or usage."""

from __future__ import annotations

import ctypes
import json
import os
import sys
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout, suppress
from enum import StrEnum
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from opfmodel.errors import OpfmodelError, visible

if TYPE_CHECKING:
    from rich.text import Text

    from opfmodel.check import Report
    from opfmodel.documents import Document
    from opfmodel.model import Elastic
    from opfmodel.plan import MultiStage, Plan
    from opfmodel.scenario import Scenario
    from opfmodel.study import Outcome
    from opfmodel.study.comparison import Comparison

__all__ = ["app", "main"]

app = typer.Typer(
    help="Declarative multi-stage AC optimal power flow with storage, in receding horizon.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

study_app = typer.Typer(help="Run one scenario under many variations, and compare.", no_args_is_help=True)
app.add_typer(study_app, name="study")

FILE = Annotated[
    Path, typer.Argument(help="A network file (MATPOWER .m, PSS/E .raw, ...) or a scenario (.yaml).")
]
STUDY = Annotated[Path, typer.Argument(help="A study file (.yaml).")]
SCENARIO = Annotated[Path, typer.Argument(help="A scenario file (.yaml).")]
JSON = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]
VERBOSE = Annotated[
    bool, typer.Option("--verbose", "-v", help="Show the solver's iterations on standard error.")
]
VARIANT = Annotated[str | None, typer.Option(help="A variant of the scenario.")]
SET = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Override a key of the scenario: controller.horizon=24."),
]
FORMULATION = Annotated[str | None, typer.Option(help="Formulation: ac, ...; 'opfmodel list' shows all.")]
SOLVER = Annotated[str | None, typer.Option(help="Back end or solver: auto, ipopt, ...")]
ON_INFEASIBLE = Annotated[
    str | None,
    typer.Option(
        metavar="stop|elastic",
        help="When a problem has no solution: stop, or let limits give way at a price.",
    ),
]
HORIZON = Annotated[int | None, typer.Option(help="Number of stages.")]


class Retry(StrEnum):
    """Which recorded runs of a study are repeated."""

    FAILED = "failed"
    ALL = "all"


_CTRL_C = 130  # what Typer makes of it


def main() -> NoReturn:
    """Run the command line; a mistake in the input is one line on standard error and exit status 2."""
    as_json = "--json" in sys.argv[1:]
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # as standard error: a name is no reason to stop
    warnings.showwarning = _show_warning
    try:
        code = app(standalone_mode=False)
    except typer.Exit as stop:
        sys.exit(stop.exit_code)
    except (typer.Abort, KeyboardInterrupt):
        _fail("interrupted", as_json, code=1)
    except Exception as error:
        message = _mistake(error)
        if message is None:
            raise
        _fail(message, as_json)
    if code == _CTRL_C:
        _fail("interrupted", as_json, code=1)
    sys.exit(code or 0)


def _mistake(error: Exception) -> str | None:
    """What to tell the user about an error that is his, None for one that is ours."""
    if isinstance(error, OpfmodelError):
        return str(error)
    if hasattr(error, "format_message"):  # usage of the command line itself
        return str(error.format_message())
    from solvers import SolverError

    return str(error) if isinstance(error, SolverError) else None


def _fail(message: str, as_json: bool, code: int = 2) -> NoReturn:
    _remark(f"error: {message}")
    if as_json:
        _print(_json({"error": message}))
    sys.exit(code)


def _show_warning(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
    from opfmodel.errors import CaseWarning, ProfileWarning, ResultWarning

    if issubclass(category, CaseWarning | ProfileWarning | ResultWarning):
        _remark(f"warning: {message}")


# Commands ---------------------------------------------------------------------------------------


@app.command()
def solve(
    file: FILE,
    formulation: FORMULATION = None,
    solver: SOLVER = None,
    horizon: HORIZON = None,
    default_cost: Annotated[
        float | None, typer.Option(help="Cost in $/MWh of generators for which a network file has none.")
    ] = None,
    variant: VARIANT = None,
    set_: SET = None,
    on_infeasible: ON_INFEASIBLE = None,
    json_: JSON = False,
    verbose: VERBOSE = False,
) -> int:
    """Solve one problem: of a network file its optimal power flow, of a scenario the first plan."""
    _check_on_infeasible(on_infeasible)
    with _solver_output(verbose):
        problem, initial, prices = _problem(
            file, formulation, solver, horizon, default_cost, variant, set_, verbose
        )
        plan = problem.solve(initial=initial)
        diagnosis = []
        if not plan.optimal and on_infeasible == "elastic":
            diagnosis = [str(s) for s in problem.elastic_twin(prices).solve(initial=initial).shortages]
    report = _verify(problem, plan) if plan.optimal else None
    result = {
        "status": plan.status,
        "termination": plan.termination,
        "objective": plan.objective if plan.optimal else None,
        "build_seconds": problem.build_seconds,
        "solve_seconds": plan.solution.seconds,
        "iterations": plan.solution.iterations,
        "max_violation": None if report is None else report.max_violation,
        "violations": {} if report is None else report.as_dict(),
        "unchecked": [] if report is None else list(report.unchecked),
        "formulation": problem.formulation.name,
        "solver": plan.solution.solver,
        "variables": plan.solution.program.n_variables,
        "rows": plan.solution.program.n_rows,
        "notes": list(problem.notes),
        "diagnosis": diagnosis,
    }
    if json_:
        _print_json(result)
    else:
        _print_notes(problem.notes)
        _print_pairs(
            {
                "status": plan.status if plan.optimal else f"{plan.status}: {plan.termination}",
                "objective": f"{plan.objective:,.4f} $" if plan.optimal else "none",
                "formulation": problem.formulation.name,
                "size": f"{result['variables']:,} variables, {result['rows']:,} rows",
                "solver": f"{plan.solution.solver}, {_count(plan.solution.iterations, 'iterations')}",
                "time": f"{problem.build_seconds:.3f} s build, {plan.solution.seconds:.3f} s solve",
                **({} if report is None else _verified(report)),
            }
        )
        _print_diagnosis(diagnosis)
        if plan.status.endswith("infeasible") and on_infeasible != "elastic":
            _print(_ELASTIC)
    return 0 if plan.optimal else 1


@app.command()
def run(
    scenario: SCENARIO,
    out: Annotated[Path | None, typer.Option(help="Folder of the results; results/NAME by default.")] = None,
    variant: VARIANT = None,
    set_: SET = None,
    on_infeasible: ON_INFEASIBLE = None,
    json_: JSON = False,
    verbose: VERBOSE = False,
    figures: Annotated[bool, typer.Option(help="Draw the figure of the whole system.")] = True,
) -> int:
    """Run the closed loop of a scenario; save trajectories, a summary and a figure."""
    from opfmodel import plot, results
    from opfmodel.check import check

    _check_on_infeasible(on_infeasible)
    changes = {} if on_infeasible is None else {"controller.on_infeasible": on_infeasible}
    loaded = _scenario(scenario, variant, set_, changes)
    folder = Path("results") / loaded.name.replace(":", "-") if out is None else out
    exceeded: dict[str, str] = {}
    with _solver_output(verbose):
        done = loaded.simulate(progress=sys.stderr.isatty() and not json_ and not verbose, verbose=verbose)
    summary: dict[str, Any] = {
        "scenario": loaded.name,
        **done.summary(),
        "max_violation": None,
        "violations": {},
        "unchecked": [],
    }
    if done.steps:
        data = done.data
        report = check(loaded.network, data, loaded.profiles)
        exceeded = _exceeded(report)
        summary |= {
            "max_violation": report.max_violation,
            "violations": report.as_dict(),
            "unchecked": list(report.unchecked),
        }
        summary = results.save(data, summary, folder)
        if figures:
            plot.save_figures(data, folder, figures=["system"])
    if json_:
        _print_json(summary)
    else:
        _print_notes(done.problem.notes)
        _print_run(summary, folder, exceeded)
        if done.status.endswith("infeasible") and loaded.settings.controller.on_infeasible == "stop":
            _print(_ELASTIC)
    return 0 if done.status == "done" else 1


@app.command()
def table(
    scenarios: Annotated[list[Path], typer.Argument(help="Scenario files (.yaml).")],
    markdown: Annotated[bool, typer.Option("--markdown", help="Print the table in Markdown.")] = False,
    json_: JSON = False,
) -> int:
    """Compare economic control with single-stage optima and with tracking: J_e, J_s, J_t, J_b."""
    from opfmodel.study import comparison

    def say(what: str) -> None:
        if sys.stderr.isatty() and not json_:
            _remark(what)

    for path in scenarios:
        _scenario(path, None, None)  # so that a mistake in any file is said before hours of work
    with _solver_output(False):
        rows = [comparison.compare(path, say) for path in scenarios]
    if json_:
        _print_json({"rows": [row.as_dict() for row in rows]})
    elif markdown:
        _print_lines(comparison.markdown(rows).splitlines())
    else:
        _print_comparisons(rows)
    for row in rows:
        for name, why in row.failures.items():
            _remark(f"{row.scenario}: no {name}: {why}")
    return 1 if any(row.failures for row in rows) else 0


@app.command()
def validate(file: FILE, variant: VARIANT = None, set_: SET = None, json_: JSON = False) -> int:
    """Check a scenario with its variants, a study or a network file without solving anything."""
    from opfmodel.documents import read_document
    from opfmodel.network.arrays import per_unit
    from opfmodel.network.cases import read_network
    from opfmodel.network.costs import Polynomial

    if _is_scenario(file):
        document = read_document(file)
        if isinstance(document.content, dict) and "vary" in document.content:
            return _validate_study(file, json_)
        loaded = _scenario(document, variant, set_)
        network = loaded.network
        for name in loaded.settings.variants if variant is None else ():
            try:
                _scenario(document, name, set_)
            except OpfmodelError as error:
                raise OpfmodelError(f"variant {name!r}: {error}") from error
    else:
        network = read_network(file, default_cost=Polynomial())
    arrays = per_unit(network)
    counts = {kind.plural: len(network.of(kind)) for kind in network.kinds()}
    if json_:
        _print_json({"valid": True, **counts, "islands": arrays.n_islands, "notes": list(arrays.notes)})
    else:
        _print_notes(arrays.notes)
        _print(f"{file}: valid; {network!r}")
    return 0


@app.command("plot")
def plot_(
    folder: Annotated[Path, typer.Argument(help="Folder of a run.")],
    bus: Annotated[list[str] | None, typer.Option(help="A bus to show; repeat for several.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of the figures; the run's by default.")] = None,
    json_: JSON = False,
) -> int:
    """Draw the figures of a run: the system, the demand and single buses, as PDF and PNG."""
    from opfmodel import plot, results

    written = plot.save_figures(results.load(folder), folder if out is None else out, bus)
    if json_:
        _print_json({"figures": [str(path) for path in written]})
    else:
        _print_lines(str(path) for path in written)
    return 0


@app.command("list")
def list_(json_: JSON = False) -> int:
    """List objectives, formulations, devices, profiles, forecasts and back ends: origins and options."""
    from opfmodel.catalogue import catalogue

    entries = catalogue()
    if json_:
        _print_json({"plugins": [entry.as_dict() for entry in entries]})
        return 0
    from rich.console import Console
    from rich.table import Table

    table = Table("sort", "name", "origin", "what it is and its options", box=None, pad_edge=False)
    for entry in entries:
        lines = [entry.summary, f"  {', '.join(entry.options)}"] if entry.options else [entry.summary]
        table.add_row(*map(_text, (entry.sort, entry.name, entry.origin)), _text(*lines))
    Console().print(table)
    return 0


@study_app.command("run")
def study_run(
    study: STUDY,
    out: Annotated[Path | None, typer.Option(help="Folder of the results; results/NAME by default.")] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            help="Worker processes on this machine; 0: in this process. By default one per processor."
        ),
    ] = None,
    scheduler: Annotated[str | None, typer.Option(help="Address of a running Dask scheduler to use.")] = None,
    memory: Annotated[str | None, typer.Option(help="What each local worker may use, such as 2GiB.")] = None,
    retry: Annotated[Retry | None, typer.Option(help="Repeat the runs that failed, or all.")] = None,
    json_: JSON = False,
) -> int:
    """Make the runs of a study that its folder does not have yet."""
    from opfmodel.errors import ProfileWarning
    from opfmodel.study import read_study, run_study

    warnings.simplefilter("ignore", ProfileWarning)  # a study may shorten its scenarios: "validate" says it

    loaded = read_study(study)
    with _solver_output(False):
        outcome = run_study(
            loaded,
            Path("results") / loaded.name if out is None else out,
            workers=workers,
            scheduler=scheduler,
            memory=memory,
            retry=None if retry is None else retry.value,
            progress=sys.stderr.isatty() and not json_,
        )
    _print_notes(outcome.notes)
    if json_:
        _print_json(outcome.as_dict())
    else:
        _print_outcome(loaded.name, outcome)
    return 0 if outcome.complete else 1


@study_app.command("table")
def study_table(
    folder: Annotated[Path, typer.Argument(help="Folder of a study.")],
    column: Annotated[
        list[str] | None, typer.Option(help="A column to show; repeat for several. By default all figures.")
    ] = None,
    json_: JSON = False,
) -> int:
    """Print the results of a study side by side; also of one that is not finished."""
    from opfmodel.study import read_table, shown_columns

    rows = read_table(folder)
    if json_:
        _print_json({"rows": rows})
    else:
        columns = shown_columns(rows, column)
        _print_table([columns, *([_cell(row[name]) for name in columns] for row in rows)])
    return 0


_TOLERATED = 1e-5  # p.u. on the scale of the system, or radians
_ELASTIC = "--on-infeasible elastic says what is lacking, where and when"

# Parts of the commands --------------------------------------------------------------------------


def _problem(
    file: Path,
    formulation: str | None,
    solver: str | None,
    horizon: int | None,
    default_cost: float | None,
    variant: str | None,
    overrides: list[str] | None,
    verbose: bool,
) -> tuple[MultiStage, Mapping[str, Any] | None, Elastic | None]:
    """The problem of a file, the state that it starts from, and prices at which its limits give way."""
    from opfmodel.network.cases import read_network
    from opfmodel.network.costs import Polynomial
    from opfmodel.plan import MultiStage

    if _is_scenario(file):
        chosen = {"formulation": formulation, "solver": solver, "horizon": horizon}
        changes = {f"controller.{key}": value for key, value in chosen.items() if value is not None}
        scenario = _scenario(file, variant, overrides, changes)
        return scenario.problem(verbose), scenario.initial(), scenario.elastic
    if variant is not None or overrides:
        raise OpfmodelError(f"{file}: --variant and --set are for scenario files (.yaml)")
    cost = None if default_cost is None else Polynomial(0.0, default_cost, 0.0)
    problem = MultiStage(
        read_network(file, default_cost=cost),
        1 if horizon is None else horizon,
        formulation=formulation or "ac",
        solver=solver or "auto",
        verbose=verbose,
    )
    return problem, None, None


def _check_on_infeasible(value: str | None) -> None:
    if value not in (None, "stop", "elastic"):
        raise OpfmodelError(f"--on-infeasible {value}: must be stop or elastic")


def _verify(problem: MultiStage, plan: Plan) -> Report:
    from opfmodel.check import check

    return check(problem.network, plan.data, problem.profiles)


def _is_scenario(file: Path) -> bool:
    return file.suffix.lower() in (".yaml", ".yml")


def _validate_study(file: Path, as_json: bool) -> int:
    from opfmodel.study import read_study

    study = read_study(file)
    axes = {axis.name: len(axis.labels) for axis in study.axes}
    if as_json:
        _print_json({"valid": True, "runs": len(study), "axes": axes})
    else:
        _print(f"{file}: valid; {len(study)} runs: " + " x ".join(f"{n} {name}" for name, n in axes.items()))
    return 0


def _scenario(
    file: Path | Document,
    variant: str | None,
    overrides: list[str] | None,
    changes: Mapping[str, Any] | None = None,
) -> Scenario:
    from opfmodel.data.yaml import parse
    from opfmodel.scenario import load_scenario

    if isinstance(file, Path) and not _is_scenario(file):
        raise OpfmodelError(f"{file}: a scenario file ends in .yaml")
    values: dict[str, Any] = {}
    for item in overrides or []:
        key, equals, text = item.partition("=")
        if not equals or not key:
            raise OpfmodelError(f"--set {item}: write KEY=VALUE, for instance controller.horizon=24")
        values[key], _ = parse(text, f"--set {key}")
    return load_scenario(file, variant, {**values, **(changes or {})})


@contextmanager
def _solver_output(verbose: bool) -> Iterator[None]:
    """Keep what a solver prints from standard output, which holds results alone; verbose shows it as errors.

    Libraries write to the file descriptor, past Python's own stream.
    """
    sys.stdout.flush()
    kept = os.dup(1)
    with open(os.devnull, "w", encoding="utf-8") as nowhere:  # noqa: PTH123 - no path of a file
        shown = sys.stderr if verbose else nowhere
        os.dup2(2 if verbose else nowhere.fileno(), 1)
        try:
            with redirect_stdout(shown):
                yield
        finally:
            _flush_libraries()
            os.dup2(kept, 1)
            os.close(kept)


def _flush_libraries() -> None:
    """Write out what C libraries have buffered, while it still goes where it should."""
    with suppress(OSError, TypeError):  # where the C library cannot be named, it is not buffered
        ctypes.CDLL(None).fflush(None)


def _print_json(result: Mapping[str, Any]) -> None:
    from opfmodel.results import finite

    _print(_json(finite(result)))


def _json(result: Mapping[str, Any]) -> str:
    """JSON in printable characters; DEL is the one control character that ``json`` writes as it is."""
    return json.dumps(result, allow_nan=False).replace("\x7f", "\\u007f")


def _print(line: str) -> None:
    """Print a line of results."""
    print(visible(line))  # noqa: T201


def _remark(line: str) -> None:
    """Print a line that is no result: an error, a warning, a note."""
    print(visible(line), file=sys.stderr)  # noqa: T201


def _print_lines(lines: Iterable[str]) -> None:
    for line in lines:
        _print(line)


def _text(*lines: str) -> Text:
    """A cell of a table; square brackets in it are no markup."""
    from rich.text import Text

    return Text("\n".join(map(visible, lines)))


def _print_notes(notes: tuple[str, ...]) -> None:
    for note in notes:
        _remark(f"note: {note}")


def _print_pairs(pairs: Mapping[str, str]) -> None:
    width = max(len(key) for key in pairs)
    for key, value in pairs.items():
        _print(f"{key:<{width}}  {value}")


def _print_diagnosis(sentences: list[str], label: str = "lacking") -> None:
    for sentence in sentences:
        _print(f"{label}: {sentence}")


def _print_comparisons(comparisons: list[Comparison]) -> None:
    from rich.console import Console
    from rich.table import Table

    from opfmodel.study.comparison import COSTS, rows

    shown = Table("k$", box=None, pad_edge=False)
    for name in COSTS:
        shown.add_column(name, justify="right")
    for row in rows(comparisons):
        shown.add_row(*map(_text, row))
    Console().print(shown)


def _count(iterations: float | None, what: str) -> str:
    """Iterations as text; a solver that does not tell them has none."""
    return f"no {what} told" if iterations is None else f"{f'{iterations:.1f}'.removesuffix('.0')} {what}"


def _verified(report: Report) -> dict[str, str]:
    """The lines of what the independent check found in a plan."""
    worst = report.worst
    place = f" ({worst.family} at {worst.component})" if worst is not None and worst.value > 0 else ""
    return {"max violation": f"{'none' if worst is None else worst}{place}", **_unchecked(report.unchecked)}


def _unchecked(what: Iterable[str]) -> dict[str, str]:
    """The line that says what the independent check could not verify, if there is anything."""
    said = "; ".join(what)
    return {"not checked": said} if said else {}


def _exceeded(report: Report) -> dict[str, str]:
    """The line that names the worst violation, if it is more than solvers leave."""
    worst = report.worst
    if worst is None or worst.relative <= _TOLERATED:
        return {}
    return {"limits exceeded": f"{worst.family} at {worst.component}, hour {worst.time:g}: {worst}"}


def _print_run(summary: Mapping[str, Any], folder: Path, exceeded: Mapping[str, str]) -> None:
    done = summary["status"] == "done"
    violation, cost = summary["max_violation"], summary["cost"]
    mean, largest = summary["solve_seconds_mean"], summary["solve_seconds_max"]
    _print_pairs(
        {
            "scenario": summary["scenario"],
            "status": "done" if done else f"{summary['status']}: {summary['termination']}",
            "cost": "none" if cost is None else f"{cost:,.2f} $ in {summary['steps']} steps",
            "solve time": f"{mean:.3f} s mean, {largest:.3f} s largest",
            "iterations": _count(summary["iterations_mean"], "mean"),
            "max violation": "none checked" if violation is None else f"{violation:.1e} p.u.",
            **exceeded,
            **_measured(summary),
            **_unchecked(summary["unchecked"]),
            "results": f"{folder}" if summary["steps"] else "none",
        }
    )
    for step, sentences in summary["diagnosis"].items():
        _print_diagnosis(sentences, f"plan at step {step}")


def _measured(summary: Mapping[str, Any]) -> dict[str, str]:
    """What the plant found, in words; nothing of a nominal plant."""
    named = {"redispatched_mwh": "redispatched", "shed_mwh": "shed", "curtailed_mwh": "curtailed"}
    shown = {word: f"{summary[key]:,.2f} MWh" for key, word in named.items() if key in summary}
    if "violated_steps" in summary:
        shown["limits"] = f"exceeded in {summary['violated_steps']} of {summary['steps']} steps"
    if summary.get("unsolved_steps"):
        shown["no state found"] = f"in {summary['unsolved_steps']} steps"
    return shown


def _print_outcome(name: str, outcome: Outcome) -> None:
    counts = {"done": outcome.done, "failed": outcome.failed, "done before": outcome.skipped}
    if outcome.waiting:
        counts["waiting"] = outcome.waiting
    status = "interrupted" if outcome.interrupted else "done" if outcome.complete else "not all done"
    for run, error in outcome.failures.items():
        _remark(f"failed: {run}: {error}")
    _print_pairs(
        {
            "study": name,
            "status": status,
            "runs": f"{outcome.total}: " + ", ".join(f"{count} {what}" for what, count in counts.items()),
            "time": f"{outcome.seconds:.1f} s",
            "table": str(outcome.table),
        }
    )


def _print_table(lines: list[list[str]]) -> None:
    lines = [[visible(cell) for cell in line] for line in lines]
    widths = [max(len(line[place]) for line in lines) for place in range(len(lines[0]))]
    for line in lines:
        _print("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:,.2f}" if abs(value) >= 1e3 else f"{value:.4g}"
    return str(value)
