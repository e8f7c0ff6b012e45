"""Time series in CSV files, with a column for each."""

from __future__ import annotations

import csv
import math
from array import array
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TextIO

import numpy as np
import numpy.typing as npt

from opfmodel.data.files import open_text
from opfmodel.errors import ProfileError

__all__ = ["Columns", "read_columns"]

Array = npt.NDArray[np.float64]
Row = tuple[int, list[str]]

_LONGEST_LINE = 10_000_000  # characters; a row of ten thousand components has 200,000


@dataclass(frozen=True)
class Columns:
    """Columns of a CSV file.

    Attributes
    ----------
    values
        By heading, one value per row.
    lines
        The line of the file that each row stands in, from 1.
    """

    path: Path
    values: Mapping[str, Array]
    lines: Sequence[int]

    def place(self, heading: str, row: int) -> str:
        """Where a value stands, as messages begin."""
        return f"{self.path}: line {self.lines[row]}, column {heading!r}: "


def read_columns(
    path: Path,
    rows: int | None = None,
    headings: Sequence[str] | None = None,
    *,
    optional: Collection[str] = (),
    unlimited: bool = False,
) -> Columns:
    """Read columns of a CSV file, and no further than the rows that are needed.

    Lines that begin with ``#`` are comments.

    Parameters
    ----------
    rows
        How many rows are needed; all if it is None. What follows them is not read.
    headings
        The columns that are wanted; by default all whose heading has a dot.
    optional
        Columns that are taken as well if the file has them.
    unlimited
        Whether infinity is accepted, where a value may stand for "no limit".

    Raises
    ------
    ProfileError
        The file cannot be read, is too short, lacks a column, has two of one heading, or has an entry
        that is not a number or a row with more cells than headings; the message names the line.
    """
    with open_text(path, ProfileError) as stream:
        table = _rows(path, stream)
        width, found = _headings(path, table)
        wanted = _wanted(path, found, headings)
        wanted += [heading for heading in optional if heading in found and heading not in wanted]
        positions = [found[heading] for heading in wanted]
        values, lines = [array("d") for _ in wanted], array("q")
        for number, row in table if rows is None else islice(table, rows):
            _check_width(path, number, row, width)
            lines.append(number)
            for heading, position, series in zip(wanted, positions, values, strict=True):
                try:
                    value = float(row[position])
                except (ValueError, IndexError):
                    value = math.nan
                if not math.isfinite(value) and (math.isnan(value) or not unlimited):
                    raise ProfileError(
                        f"{path}: line {number}, column {heading!r}: {_fault(row, position, value)}"
                    )
                series.append(value)
    if rows is not None and len(lines) < rows:
        raise ProfileError(f"{path}: {len(lines)} rows; {rows} are needed")
    return Columns(path, {h: np.array(series) for h, series in zip(wanted, values, strict=True)}, lines)


def _rows(path: Path, stream: TextIO) -> Iterator[Row]:
    """Rows with the number of their line, without comments and empty lines."""
    reader = csv.reader(_lines(path, stream))
    try:
        for row in reader:
            if row and not row[0].startswith("#"):
                yield reader.line_num, row
    except csv.Error as error:
        raise ProfileError(f"{path}: line {reader.line_num}: not CSV: {error}") from error


def _lines(path: Path, stream: TextIO) -> Iterator[str]:
    """Lines of a file, none of which may fill the memory."""
    number = 0
    while line := stream.readline(_LONGEST_LINE):
        number += 1
        if len(line) == _LONGEST_LINE:
            raise ProfileError(f"{path}: line {number}: has more than {_LONGEST_LINE:,} characters")
        yield line


def _headings(path: Path, table: Iterator[Row]) -> tuple[int, dict[str, int]]:
    """Number of columns, and the column of each heading."""
    number, row = next(table, (0, []))
    if not row:
        raise ProfileError(f"{path}: the file is empty")
    positions: dict[str, int] = {}
    for position, heading in enumerate(map(str.strip, row)):
        if heading and heading in positions:
            raise ProfileError(f"{path}: line {number}: two columns are headed {heading!r}")
        positions[heading] = position
    return len(row), positions


def _wanted(path: Path, found: Collection[str], headings: Sequence[str] | None) -> list[str]:
    wanted = [heading for heading in found if "." in heading] if headings is None else list(headings)
    if not wanted:
        raise ProfileError(
            f"{path}: no column is headed 'component.field', such as 'town.p'; {_listing(found)}"
        )
    for heading in wanted:
        if heading not in found:
            raise ProfileError(f"{path}: no column {heading!r}; {_listing(found)}")
    return wanted


def _listing(found: Collection[str]) -> str:
    return f"columns are: {', '.join(islice(found, 20))}" + (" ..." if len(found) > 20 else "")


def _check_width(path: Path, number: int, row: Sequence[str], width: int) -> None:
    if len(row) > width and any(cell.strip() for cell in row[width:]):
        raise ProfileError(
            f"{path}: line {number}: {len(row)} cells under {width} headings; a number is "
            "written with a point, and a row has one per column"
        )


def _fault(row: Sequence[str], position: int, value: float) -> str:
    entry = repr(row[position]) if position < len(row) else "nothing"
    return f"{entry} is not a number" if math.isnan(value) else f"{entry} is not a finite number"
