"""The page of a study, and reports of whatever a folder holds."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from opfmodel.data.files import read_text
from opfmodel.errors import ResultError
from opfmodel.results.presented import load_run
from opfmodel.results.report import comparison_page, report_page
from opfmodel.results.report.page import Explorer, Page, Section, Table, Tile, Tiles
from opfmodel.results.store import REPORT
from opfmodel.study.store import Store, read_table
from opfmodel.study.table import axes_of, is_figure

__all__ = ["report", "study_page"]

_ANALYSIS = "analysis.json"


def report(folders: Sequence[str | Path], out: str | Path | None = None) -> Path:
    """Write the report of a run, of a study, or of several runs side by side.

    The report of a study leads to one of each run that kept its trajectories, in its folder.

    Parameters
    ----------
    folders
        The folder of a run or a study, or those of several runs.
    out
        The file; by default ``report.html`` in the only folder, or ``comparison.html`` here.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ResultError
        A folder holds no results, they are damaged, or the file cannot be written.
    """
    paths = [Path(folder) for folder in folders]
    if len(paths) == 1:
        path = paths[0] / REPORT if out is None else Path(out)
        study = os.path.lexists(paths[0] / "study.json")
        page = study_page(paths[0], path) if study else _page_of_run(paths[0])
        return page.write(path)
    names = _names(paths)
    runs = {name: load_run(path) for name, path in zip(names, paths, strict=True)}
    page = comparison_page({name: (run.data, run.record()) for name, run in runs.items()})
    return page.write(Path("comparison.html") if out is None else Path(out))


def study_page(folder: Path, path: Path) -> Page:
    """Return the page of a study, and write those of its runs that kept trajectories.

    Parameters
    ----------
    path
        Where the page will be, from which its links lead to the runs.
    """
    rows = read_table(folder)
    axes = axes_of(rows)
    varying = [name for name in axes if len({repr(row[name]) for row in rows}) > 1]
    figures = [name for name in rows[0] if name not in axes and is_figure(name, rows)]
    links = [_link(folder, str(row["key"]), path) for row in rows]
    done = sum(row["status"] == "done" for row in rows)
    waiting = sum(row["status"] == "waiting" for row in rows)
    failed = len(rows) - done - waiting
    tiles = [Tile("runs", f"{len(rows):,}"), Tile("done", f"{done:,}")]
    tiles += [Tile("failed", f"{failed:,}")] if failed else []
    tiles += [Tile("waiting", f"{waiting:,}")] if waiting else []
    sections = [Section("In short", [Tiles(tiles)])]
    if figures:
        kept = [{name: row[name] for name in (*varying, "status", *figures)} for row in rows]
        preferred = sorted(figures, key=lambda name: name != "cost")
        explorer = Explorer("Any figure against any axis", varying, preferred, kept, links)
        sections.append(Section("Results", [explorer]))
    errors = [[*(row[name] for name in varying), row["status"], row["error"]] for row in rows if row["error"]]
    if errors:
        table = Table(
            "Runs that failed", [*varying, "status", "error"], [list(map(_cell, e)) for e in errors]
        )
        sections.append(Section("Failures", [table]))
    title = folder.resolve().name
    return Page(title, f"study of {len(rows):,} runs over {', '.join(varying) or 'no axis'}", sections)


def _page_of_run(folder: Path) -> Page:
    run = load_run(folder)
    return report_page(run.data, run.record(), _analysis(folder))


def _analysis(folder: Path) -> Mapping[str, Any] | None:
    """Return the verdicts of the theory beside a run; None if there are none."""
    path = folder / _ANALYSIS
    if not path.exists():
        return None
    try:
        found = json.loads(read_text(path, ResultError))
    except ValueError as error:
        raise ResultError(f"{path}: not JSON: {error}") from error
    return found if isinstance(found, dict) else None


def _link(folder: Path, key: str, page: Path) -> str:
    """Write the report of a run of a study; return its address from the page, empty if it kept nothing."""
    kept = Store(folder).folder / "runs" / key
    if not (kept / "trajectories.nc").exists():
        return ""
    written = _page_of_run(kept).write(kept / REPORT)
    return Path(os.path.relpath(written, page.parent)).as_posix()


def _names(paths: Sequence[Path]) -> list[str]:
    """Names of runs: those of their folders, or whole paths if they repeat."""
    short = [path.resolve().name for path in paths]
    return short if len(set(short)) == len(short) else [str(path) for path in paths]


def _cell(value: Any) -> Any:
    return value if value is None or isinstance(value, int | float | str) else json.dumps(value)
