"""Time series in the columns of CSV files."""

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

__all__ = ["Columns", "read_columns", "separator_hint"]

Array = npt.NDArray[np.float64]
Row = tuple[int, list[str]]

_LONGEST_LINE = 10_000_000  # characters; a row for ten thousand components has 200,000


@dataclass(frozen=True)
class Columns:
    """Columns of a CSV file.

    Attributes
    ----------
    values
        Values by column heading, one per row.
    lines
        Line number of each row in the file, from 1.
    """

    path: Path
    values: Mapping[str, Array]
    lines: Sequence[int]

    def place(self, heading: str, row: int) -> str:
        """Location of a value, as the beginning of a message."""
        return f"{self.path}: line {self.lines[row]}, column {heading!r}: "


def read_columns(
    path: Path,
    rows: int | None = None,
    headings: Sequence[str] | None = None,
    *,
    optional: Collection[str] = (),
    unlimited: bool = False,
) -> Columns:
    """Read columns of a CSV file, stopping after the required number of rows.

    Lines that begin with ``#`` are comments.

    Parameters
    ----------
    rows
        Number of required rows, None for all. The rest of the file is not read.
    headings
        Columns to read; by default all columns whose heading contains a dot.
    optional
        Additional columns to read if the file contains them.
    unlimited
        Whether infinity is accepted, meaning "no limit".

    Raises
    ------
    ProfileError
        The file cannot be read, is too short, lacks a column, has duplicate headings, an entry that is
        not a number, or a row with more cells than headings. The message gives the line.
    """
    with open_text(path, ProfileError) as stream:
        table = _rows(path, stream)
        width, found = _headings(path, table)
        wanted = _wanted(path, found, headings)
        wanted += [heading for heading in optional if heading in found and heading not in wanted]
        positions = [found[heading] for heading in wanted]
        values, lines = [array("d") for _ in wanted], array("q")
        for number, row in table if rows is None else islice(table, rows):
            _check_width(path, number, row, width, found)
            lines.append(number)
            for heading, position, series in zip(wanted, positions, values, strict=True):
                value = _number(row[position]) if position < len(row) else math.nan
                if not math.isfinite(value) and (math.isnan(value) or not unlimited):
                    raise ProfileError(
                        f"{path}: line {number}, column {heading!r}: {_fault(row, position, value)}"
                        f"{separator_hint(found)}"
                    )
                series.append(value)
    if rows is not None and len(lines) < rows:
        raise ProfileError(f"{path}: {len(lines)} rows; {rows} are needed")
    return Columns(path, {h: np.array(series) for h, series in zip(wanted, values, strict=True)}, lines)


def _rows(path: Path, stream: TextIO) -> Iterator[Row]:
    """Rows with their line numbers, without comments and empty lines.

    Every line is read on its own: a quotation mark that is not closed would join it to the next lines.
    """
    for number, line in _lines(path, stream):
        try:
            row = next(csv.reader([line]))
        except csv.Error as error:
            raise ProfileError(f"{path}: line {number}: not CSV: {error}") from error
        if not row or row[0].startswith("#"):
            continue
        if row[-1].endswith(("\n", "\r")):
            raise ProfileError(f"{path}: line {number}: a quotation mark is not closed on its line")
        yield number, row


def _lines(path: Path, stream: TextIO) -> Iterator[tuple[int, str]]:
    """Lines of a file with their numbers, limited in length to bound memory use."""
    number = 0
    while line := stream.readline(_LONGEST_LINE):
        number += 1
        if len(line) == _LONGEST_LINE:
            raise ProfileError(
                f"{path}: line {number}: too long; at most {_LONGEST_LINE:,} characters are accepted"
            )
        yield number, line


def _number(text: str) -> float:
    """Value of a cell; NaN unless it is a number as other programs write it."""
    try:
        return math.nan if "_" in text or not text.isascii() else float(text)
    except ValueError:
        return math.nan


def _headings(path: Path, table: Iterator[Row]) -> tuple[int, dict[str, int]]:
    """Number of columns, and position of each heading."""
    number, row = next(table, (0, []))
    if not row:
        raise ProfileError(f"{path}: the file is empty")
    positions: dict[str, int] = {}
    for position, heading in enumerate(map(str.strip, row)):
        if heading and heading in positions:
            raise ProfileError(f"{path}: line {number}: duplicate column {heading!r}")
        positions[heading] = position
    return len(row), positions


def _wanted(path: Path, found: Collection[str], headings: Sequence[str] | None) -> list[str]:
    wanted = [heading for heading in found if "." in heading] if headings is None else list(headings)
    if not wanted:
        raise ProfileError(
            f"{path}: no column is named 'component.field', for example 'town.p'; {_listing(found)}"
            f"{separator_hint(found)}"
        )
    for heading in wanted:
        if heading not in found:
            raise ProfileError(f"{path}: no column {heading!r}; {_listing(found)}{separator_hint(found)}")
    return wanted


def separator_hint(found: Collection[str]) -> str:
    r"""Return the end of a message about headings that suspects another separator than commas.

    Examples
    --------
    >>> separator_hint(["hour;town.p"]), separator_hint(["hour", "town.p"])
    ("; columns are separated by ';', but must be by ','", '')
    """
    (only,) = found if len(found) == 1 else ("",)
    used = next((separator for separator in ";\t" if separator in only), "")
    return f"; columns are separated by {used!r}, but must be by ','" if used else ""


def _listing(found: Collection[str]) -> str:
    return f"columns are: {', '.join(islice(found, 20))}" + (" ..." if len(found) > 20 else "")


def _check_width(path: Path, number: int, row: Sequence[str], width: int, found: Collection[str]) -> None:
    if len(row) > width and any(cell.strip() for cell in row[width:]):
        raise ProfileError(
            f"{path}: line {number}: {len(row)} cells for {width} headings; use a decimal point and "
            f"one number per column{separator_hint(found)}"
        )


def _fault(row: Sequence[str], position: int, value: float) -> str:
    if position >= len(row):
        return "the value is missing"
    return f"{row[position]!r} is not a {'' if math.isnan(value) else 'finite '}number"
