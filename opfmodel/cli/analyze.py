"""The command that checks what the theory promises for a scenario."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from opfmodel.cli.options import JSON, SCENARIO, SET, VARIANT
from opfmodel.cli.output import print_json, print_line, print_table, solver_output
from opfmodel.cli.reading import read_scenario
from opfmodel.errors import OpfmodelError, shown

if TYPE_CHECKING:
    from opfmodel.analysis.analyze import Analysis
    from opfmodel.analysis.progress import Advance

__all__ = ["analyze"]

_SHOWN = 20  # limits that bind


def analyze(
    scenario: SCENARIO,
    only: Annotated[
        list[str] | None,
        typer.Option(
            help="Check to run, or several with commas between; repeatable. All of them by default.",
            metavar="NAME",
        ),
    ] = None,
    step: Annotated[int, typer.Option(help="Step whose demand is held constant.")] = 0,
    horizons: Annotated[
        str | None, typer.Option(help="Horizons of the turnpike in steps, such as 48,96,192.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the result and a figure of the turnpike.")
    ] = None,
    variant: VARIANT = None,
    set_: SET = None,
    json_: JSON = False,
) -> int:
    """Check by numbers what the theory of economic NMPC promises for a scenario.

    The checks are steady_state, dissipativity, turnpike, practical_stability, recursive_feasibility and
    performance_bound. Each ends with the verdict holds, violated or undecided.
    """
    from opfmodel.analysis.analyze import analyze as analysed

    swept = None if horizons is None else _numbers(horizons)
    wanted = [name.strip() for names in only or () for name in names.split(",")]
    loaded = read_scenario(scenario, variant, set_)
    if out is not None:
        from opfmodel.results.store import make_folder

        make_folder(out)  # before minutes of work
    with solver_output(False), _progress(sys.stderr.isatty() and not json_) as advance:
        found = analysed(loaded, wanted, step=step, horizons=swept, advance=advance)
    if out is not None:
        _write(found, out)
    if json_:
        print_json(found.as_dict())
    else:
        _show(found)
    return 1 if found.violated else 0


def _numbers(text: str) -> list[int]:
    try:
        return [int(part) for part in text.split(",")]
    except ValueError:
        raise OpfmodelError(f"--horizons {shown(text)}: must be whole numbers, such as 48,96,192") from None


@contextmanager
def _progress(visible: bool) -> Iterator[Advance]:
    """Show a progress bar on standard error; yield a function that moves it."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from opfmodel.analysis.progress import silent

    if not visible:
        yield silent
        return
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("steady state", total=None)

        def advance(what: str, done: int = 0, of: int = 0) -> None:
            bar.update(task, description=what, completed=done, total=of or None)

        yield advance


def _write(found: Analysis, folder: Path) -> None:
    """Write the result, and the figure of the turnpike if plans were found."""
    from opfmodel.analysis.figure import turnpike_figure
    from opfmodel.results.figures import write_figures
    from opfmodel.results.store import write_record

    write_record(found.as_dict(), folder / "analysis.json")
    turnpike = found.checks.get("turnpike")
    if turnpike is not None and turnpike.figures:
        write_figures({"turnpike": turnpike_figure(turnpike, found.scenario)}, folder)


def _show(found: Analysis) -> None:
    """Print the verdicts and what they rest on."""
    rows = [[name, finding.verdict.value, finding.explanation] for name, finding in found.checks.items()]
    print_table(["check", "verdict", "because"], rows, prose=True)
    for finding in found.checks.values():
        limits = finding.figures.get("active")
        if limits:
            print_line("")
            print_line("limits that bind in the steady state")
            for limit in limits[:_SHOWN]:
                print_line(f"  {limit}")
            if len(limits) > _SHOWN:
                print_line(f"  and {len(limits) - _SHOWN} more; --json lists all")
