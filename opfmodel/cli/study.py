"""One scenario under many variations."""

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
    """Which recorded runs of a study are repeated."""

    FAILED = "failed"
    ALL = "all"


def run(
    study: Annotated[Path, typer.Argument(help="A study file (.yaml).")],
    out: OUT = None,
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
    with solver_output(False):
        outcome = run_study(
            loaded,
            Path("results") / loaded.name if out is None else out,
            workers=workers,
            scheduler=scheduler,
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
        print_json({"rows": rows})
    else:
        show.study_table(rows, shown_columns(rows, column))
    return 0
