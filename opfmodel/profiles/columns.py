"""Time series in files with a column for each."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import numpy.typing as npt

from opfmodel.errors import ProfileError

__all__ = ["read_columns"]

Array = npt.NDArray[np.float64]


def read_columns(path: Path, steps: int, headings: list[str] | None = None) -> dict[str, Array]:
    """Columns of a CSV file by heading, the first ``steps`` rows of each.

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
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            numbered = enumerate(csv.reader(stream), 1)
            lines = [(number, line) for number, line in numbered if line and not line[0].startswith("#")]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ProfileError(f"{path}: cannot be read: {error}") from error
    if not lines:
        raise ProfileError(f"{path}: the file is empty")
    found, rows = [heading.strip() for heading in lines[0][1]], lines[1:]
    if len(rows) < steps:
        raise ProfileError(f"{path}: {len(rows)} rows; {steps} are needed")
    wanted = [heading for heading in found if "." in heading] if headings is None else headings
    missing = [heading for heading in wanted if heading not in found]
    if missing:
        raise ProfileError(f"{path}: no column {missing[0]!r}; columns are: {', '.join(found)}")
    return {heading: _column(path, heading, found.index(heading), rows[:steps]) for heading in wanted}


def _column(path: Path, heading: str, column: int, rows: list[tuple[int, list[str]]]) -> Array:
    values = np.zeros(len(rows))
    for position, (number, row) in enumerate(rows):
        try:
            values[position] = float(row[column])
        except (ValueError, IndexError):
            entry = repr(row[column]) if column < len(row) else "nothing"
            raise ProfileError(
                f"{path}: line {number}, column {heading!r}: {entry} is not a number"
            ) from None
    return values
