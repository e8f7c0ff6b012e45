"""The command that writes a report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from opfmodel.cli.options import JSON
from opfmodel.cli.output import print_json, print_line

__all__ = ["report"]


def report(
    folders: Annotated[
        list[Path],
        typer.Argument(help="Folder of a run or a study, or those of several runs.", metavar="DIR..."),
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="File to write; by default report.html in the folder, or comparison.html."),
    ] = None,
    json_: JSON = False,
) -> int:
    """Write a report as one HTML file that any browser opens.

    Of one run: dispatch, prices, branch loading, voltages, storage, the network over time, violations and
    effort. Of several runs: their figures side by side. Of a study: any figure against any axis.
    """
    from opfmodel.study.report import report as written

    path = written(folders, out)
    if json_:
        print_json({"report": str(path), "bytes": path.stat().st_size})
    else:
        print_line(str(path))
    return 0
