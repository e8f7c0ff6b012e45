"""Time series in files with a column for each."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from opfmodel.errors import ProfileError

__all__ = ["numbers", "read_columns", "read_rows"]

Array = npt.NDArray[np.float64]
Row = tuple[int, list[str]]


def read_columns(path: Path, steps: int | None, headings: list[str] | None = None) -> dict[str, Array]:
    """Columns of a CSV file by heading, the first ``steps`` rows of each; all rows if it is None.

    Lines that begin with ``#`` are comments.

    Parameters
    ----------
    headings
        The columns that are wanted; by default all whose heading has a dot.

    Raises
    ------
    ProfileError
        The file cannot be read, is too short, lacks a column, or has an entry that is not a number.
    """
    found, rows = read_rows(path)
    if not found:
        raise ProfileError(f"{path}: the file is empty")
    if steps is not None and len(rows) < steps:
        raise ProfileError(f"{path}: {len(rows)} rows; {steps} are needed")
    wanted = [heading for heading in found if "." in heading] if headings is None else headings
    if not wanted:
        raise ProfileError(
            f"{path}: no column is headed 'component.field', such as 'town.p'; "
            f"columns are: {', '.join(found)}"
        )
    missing = [heading for heading in wanted if heading not in found]
    if missing:
        raise ProfileError(f"{path}: no column {missing[0]!r}; columns are: {', '.join(found)}")
    return {heading: numbers(path, heading, found.index(heading), rows[:steps]) for heading in wanted}


def read_rows(path: Path) -> tuple[list[str], list[Row]]:
    """Headings of a CSV file, none if it is empty, and its rows with their line numbers; no comments.

    Raises
    ------
    ProfileError
        The file cannot be read, two columns have one heading, or a row has more cells than headings.
    """
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            reader = csv.reader(stream)
            lines = [(reader.line_num, line) for line in reader if line and not line[0].startswith("#")]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ProfileError(f"{path}: cannot be read: {error}") from error
    headings = [heading.strip() for heading in lines[0][1]] if lines else []
    for place, heading in enumerate(headings):
        if heading and heading in headings[:place]:
            raise ProfileError(f"{path}: line {lines[0][0]}: two columns are headed {heading!r}")
    for number, row in lines[1:]:
        if any(cell.strip() for cell in row[len(headings) :]):
            raise ProfileError(
                f"{path}: line {number}: {len(row)} cells under {len(headings)} headings; a number is "
                "written with a point, and a row has one per column"
            )
    return headings, lines[1:]


def numbers(path: Path, heading: str, column: int, rows: Sequence[Row]) -> Array:
    """A column of some rows.

    Raises
    ------
    ProfileError
        An entry is not a number; the message names its line.
    """
    values = np.zeros(len(rows))
    for position, (number, row) in enumerate(rows):
        try:
            values[position] = float(row[column])
        except (ValueError, IndexError):
            values[position] = np.nan
        if np.isnan(values[position]):
            entry = repr(row[column]) if column < len(row) else "nothing"
            raise ProfileError(f"{path}: line {number}, column {heading!r}: {entry} is not a number")
    return values
