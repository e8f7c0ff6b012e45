"""Commands for closed loops: run, compare, plot."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from opfmodel.cli import show
from opfmodel.cli.options import JSON, ON_INFEASIBLE, OUT, SCENARIO, SET, VARIANT, VERBOSE
from opfmodel.cli.output import print_json, print_line, print_pairs, remark, solver_output
from opfmodel.cli.reading import check_on_infeasible, read_scenario
from opfmodel.errors import OpfmodelError, ResultError

__all__ = ["plot", "run", "table"]


def run(
    scenario: SCENARIO,
    out: OUT = None,
    variant: VARIANT = None,
    set_: SET = None,
    on_infeasible: ON_INFEASIBLE = None,
    json_: JSON = False,
    verbose: VERBOSE = False,
    figures: Annotated[bool, typer.Option(help="Save a figure of the whole system.")] = True,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue the run in the results folder, if there is one.")
    ] = False,
    force: Annotated[
        bool, typer.Option("--force", help="Start again, and replace what is in the results folder.")
    ] = False,
) -> int:
    """Run the closed loop of a scenario.

    Writes trajectories, a summary and a figure to the results folder, and meanwhile checkpoints, from which a
    run that was interrupted or killed resumes.
    """
    from opfmodel.results import save
    from opfmodel.results.figures import save_figures
    from opfmodel.results.store import check_writable
    from opfmodel.scenario.results import results_of
    from opfmodel.simulation import inputs, simulate
    from opfmodel.simulation.folder import CHECKPOINT, prepare
    from solvers.interrupt import deferred

    check_on_infeasible(on_infeasible)
    if resume and force:
        raise OpfmodelError("--resume and --force exclude each other: continue a run, or start again")
    changes = (
        {} if on_infeasible is None else {"controller.on_infeasible": ("--on-infeasible", on_infeasible)}
    )
    loaded = read_scenario(scenario, variant, set_, changes)
    loaded.problem.verbose = verbose
    folder = Path("results") / loaded.name.replace(":", "-") if out is None else out
    check_writable(folder)
    with solver_output(verbose):
        loop = loaded.loop()
        given = inputs(**{name: loop[name] for name in ("controller", "plant", "steps", "objective")})
    ended = prepare(folder, given, resume, force)
    if ended is not None:
        return _already(ended, folder, json_)
    checkpoint = loaded.checkpoint(folder / CHECKPOINT)
    with solver_output(verbose):
        shown = sys.stderr.isatty() and not json_ and not verbose
        done = simulate(**loop, progress=shown, checkpoint=checkpoint)
    with deferred():  # a second Ctrl-C does not lose what has been done
        data, summary, report = results_of(loaded, done)
        try:
            summary = save(data, {**summary, "inputs": given}, folder)
        except ResultError as error:
            hint = "make room, and the same command with --resume writes them"
            raise ResultError(f"{error}; {hint}" if checkpoint.exists else str(error)) from error
        if not done.interrupted:
            checkpoint.remove()
        if figures and data is not None:
            save_figures(data, folder, figures=["system"])
    if json_:
        print_json(summary)
    else:
        show.run(done, summary, report, folder, loaded.settings.controller.on_infeasible == "elastic")
    return 0 if done.status == "done" else 1


def _already(summary: Mapping[str, Any], folder: Path, json_: bool) -> int:
    """Report that the run to be continued has ended."""
    remark(f"note: {folder}: this run has ended; --force repeats it")
    if json_:
        print_json(summary)
    else:
        print_pairs({"status": str(summary.get("status")), "results": str(folder)})
    return 0 if summary.get("status") == "done" else 1


def table(
    scenarios: Annotated[list[Path], typer.Argument(help="Scenario files (.yaml).")],
    markdown: Annotated[bool, typer.Option("--markdown", help="Print the table in Markdown.")] = False,
    json_: JSON = False,
) -> int:
    """Compare the costs J_e, J_s, J_t and J_b of scenarios.

    J_e, J_t and J_b are closed-loop costs of the scenario and of its variants setpoint-tracking and
    state-of-charge-tracking; J_s is the cost of its single-stage optima.
    """
    from opfmodel.study import comparison

    def say(what: str) -> None:
        if sys.stderr.isatty() and not json_:
            remark(what)

    for path in scenarios:
        read_scenario(path)  # report an error in any file before hours of work
    with solver_output(False):
        compared = [comparison.compare(path, say) for path in scenarios]
    if json_:
        print_json({"rows": [row.as_dict() for row in compared]})
    elif markdown:
        for line in comparison.markdown(compared).splitlines():
            print_line(line)
    else:
        show.comparisons(compared)
    for row in compared:
        for name, why in row.failures.items():
            remark(f"{row.scenario}: no {name}: {why}")
    return 1 if any(row.failures for row in compared) else 0


def plot(
    folder: Annotated[Path, typer.Argument(help="Results folder of a run.")],
    bus: Annotated[
        list[str] | None,
        typer.Option("--bus", "--buses", help="Bus to plot, or several with commas between; repeatable."),
    ] = None,
    paper: Annotated[
        bool, typer.Option("--paper", help="Draw all panels in one figure, with limits, as the paper does.")
    ] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for the figures; the run's by default.")] = None,
    json_: JSON = False,
) -> int:
    """Plot a run: the system, the demand and single buses.

    Figures are saved as PDF and PNG.
    """
    from opfmodel.results import binding, load
    from opfmodel.results.aggregates import named_buses
    from opfmodel.results.figures import save_figures

    data = load(folder)
    names = None if bus is None else named_buses(data, bus)
    where = folder if out is None else out
    drawn = save_figures(data, where, names, ["paper"]) if paper else save_figures(data, where, names)
    written = [str(path) for path in drawn]
    if paper and not set(binding(data)):
        remark(f"{folder}: the results have no limits, which the figure lacks; repeat the run")
    if json_:
        print_json({"figures": written})
    else:
        for path in written:
            print_line(path)
    return 0
