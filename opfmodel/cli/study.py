"""Commands for studies."""

from __future__ import annotations

import sys
import warnings
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from opfmodel.cli import show
from opfmodel.cli.options import JSON, OUT
from opfmodel.cli.output import print_json, print_notes, solver_output

__all__ = ["run", "table"]


class Retry(StrEnum):
    """Which recorded runs of a study to repeat."""

    FAILED = "failed"
    ALL = "all"


def run(
    study: Annotated[Path, typer.Argument(help="Study file (.yaml).")],
    out: OUT = None,
    workers: Annotated[
        int | None,
        typer.Option(
            help="Worker processes on this machine, by default one per processor; 0 uses this process."
        ),
    ] = None,
    scheduler: Annotated[str | None, typer.Option(help="Address of a running Dask scheduler.")] = None,
    cluster: Annotated[
        Path | None, typer.Option(help="Cluster file (.yaml): SLURM jobs or SSH hosts that Dask starts.")
    ] = None,
    memory: Annotated[str | None, typer.Option(help="Memory limit of a local worker, such as 2GiB.")] = None,
    retry: Annotated[Retry | None, typer.Option(help="Repeat failed runs, or all runs.")] = None,
    json_: JSON = False,
) -> int:
    """Run a study; recorded runs are skipped."""
    from opfmodel.errors import ProfileWarning
    from opfmodel.study import read_study, run_study

    warnings.simplefilter("ignore", ProfileWarning)  # studies may shorten scenarios; "validate" reports it

    loaded = read_study(study)
    with solver_output(False):
        outcome = run_study(
            loaded,
            Path("results") / loaded.name if out is None else out,
            workers=workers,
            scheduler=scheduler,
            cluster=cluster,
            memory=memory,
            retry=None if retry is None else retry.value,
            progress=sys.stderr.isatty() and not json_,
        )
    print_notes(outcome.notes)
    if json_:
        print_json(outcome.as_dict())
    else:
        show.study_outcome(loaded.name, outcome)
    return 0 if outcome.complete else 1


def table(
    folder: Annotated[Path, typer.Argument(help="Results folder of a study.")],
    column: Annotated[
        list[str] | None, typer.Option(help="Column to print; repeatable. The main results by default.")
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="Print all columns.")] = False,
    over: Annotated[
        list[str] | None,
        typer.Option(help="Axis over which to print mean, deviation and quantiles; repeatable."),
    ] = None,
    json_: JSON = False,
) -> int:
    """Print the results of a study, finished or not."""
    from opfmodel.study import aggregate, read_table, shown_columns

    rows = read_table(folder)
    columns = shown_columns(rows, column, every=every)
    if over:
        groups = aggregate(rows, over, column)
        if json_:
            print_json({"over": over, "groups": [group.as_dict() for group in groups]})
        else:
            show.study_statistics(groups, columns)
    elif json_:
        print_json({"rows": rows})
    else:
        show.study_table(rows, columns)
    return 0
