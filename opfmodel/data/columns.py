"""Time series in the columns of files."""

from __future__ import annotations

import math
from array import array
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.data.calendar import Calendar
from opfmodel.data.rows import Row, open_rows, where
from opfmodel.data.stamps import calendar_of, in_utc, is_local, is_stamp, looks_like_date
from opfmodel.errors import ProfileError, nearest

__all__ = ["Columns", "read_columns", "separator_hint"]

Array = npt.NDArray[np.float64]

_TIME_NAMES = ("time", "timestamp", "datetime", "date", "snapshot")


@dataclass(frozen=True)
class Columns:
    """Columns of a file.

    Attributes
    ----------
    values
        Values by column heading, one per row.
    lines
        Number of each row in the file, from 1: the line of a text file.
    clock
        Heading of the column with the times of the rows; None if they are only numbered.
    times
        Cells of that column.
    """

    path: Path
    values: Mapping[str, Array]
    lines: Sequence[int]
    clock: str | None = None
    times: Sequence[Any] = ()

    def place(self, heading: str, row: int) -> str:
        """Location of a value, as the beginning of a message."""
        return f"{where(self.path, self.lines[row])}, column {heading!r}: "

    def calendar(self, zone: str | None, step: float | None = None) -> Calendar | None:
        """Return the calendar of the rows; None if they are only numbered.

        Parameters
        ----------
        zone
            Time zone of times without an offset; UTC if it is not known.
        step
            Length of the steps, h, if there is a single row.

        Raises
        ------
        ProfileError
            The times are not those of successive equal steps; see :func:`opfmodel.data.stamps.calendar_of`.
        """
        if self.clock is None or not len(self.lines):
            return None
        place = partial(self.place, self.clock)
        try:
            return calendar_of(in_utc(self.times, zone or "UTC", place), zone or "UTC", place, step)
        except ProfileError as error:
            stated = zone or not is_local(self.times[0])
            hint = "" if stated else " (a time without an offset is in UTC unless a zone is stated)"
            raise ProfileError(f"{error}{hint}") from None

    def rows(self, chosen: npt.NDArray[np.intp]) -> Columns:
        """Return a selection of rows."""
        lines = np.asarray(self.lines)[chosen].tolist()
        times = [self.times[row] for row in chosen] if self.clock is not None else ()
        values = {key: series[chosen] for key, series in self.values.items()}
        return Columns(self.path, values, lines, self.clock, times)


def read_columns(
    path: Path,
    rows: int | None = None,
    headings: Sequence[str] | None = None,
    *,
    optional: Collection[str] = (),
    unlimited: bool = False,
    time_column: str | None = None,
    fewer: bool = False,
) -> Columns:
    """Read columns of a file, stopping after the required number of rows.

    The formats are those of :func:`opfmodel.data.rows.open_rows`. A file with times of its rows is read to
    its end: they tell which rows are needed.

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
    time_column
        Heading of the column of times. By default it is one named ``time``, ``timestamp``, ``datetime``,
        ``date`` or ``snapshot``, unless it has plain numbers, or else the first one without a dot in the
        heading and with a time in ISO 8601 in the first row.
    fewer
        Whether fewer rows are accepted.

    Raises
    ------
    ProfileError
        The file cannot be read, is too short, lacks a column, has duplicate headings, an entry that is
        not a number, or a row with more cells than headings. The message gives the line.
    """
    with open_rows(path) as table:
        width, found = _headings(path, table)
        wanted = _wanted(path, found, headings)
        wanted += [heading for heading in optional if heading in found and heading not in wanted]
        positions = [found[heading] for heading in wanted]
        values, lines = [array("d") for _ in wanted], array("q")
        first, body = _peek(table)
        clock = _clock(path, found, first, time_column)
        times: list[Any] = []
        for number, row in body if rows is None or clock is not None else islice(body, rows):
            _check_width(path, number, row, width, found)
            lines.append(number)
            if clock is not None:
                times.append(row[found[clock]] if found[clock] < len(row) else "")
            for heading, position, series in zip(wanted, positions, values, strict=True):
                value = _number(row[position]) if position < len(row) else math.nan
                if not math.isfinite(value) and (math.isnan(value) or not unlimited):
                    raise ProfileError(
                        f"{where(path, number)}, column {heading!r}: {_fault(row, position, value)}"
                        f"{separator_hint(found)}"
                    )
                series.append(value)
    if rows is not None and clock is None and len(lines) < rows and not fewer:
        raise ProfileError(f"{path}: {len(lines)} rows; {rows} are needed")
    made = {h: np.array(series) for h, series in zip(wanted, values, strict=True)}
    return Columns(path, made, lines, clock, times)


def _peek(table: Iterator[Row]) -> tuple[Sequence[Any], Iterator[Row]]:
    """Return the cells of the next row, empty if there is none, and all rows from it on."""
    first = next(table, None)
    return ([], table) if first is None else (first[1], chain([first], table))


def _clock(path: Path, found: Mapping[str, int], first: Sequence[Any], stated: str | None) -> str | None:
    """Return the heading of the column of times, None if the rows are only numbered."""
    if stated is not None:
        if stated not in found:
            raise ProfileError(f"{path}: no column {stated!r} of times; {_listing(found)}")
        return stated
    cells = {h: first[at] for h, at in found.items() if "." not in h and at < len(first)}
    for heading, cell in cells.items():
        if heading.casefold() in _TIME_NAMES and cell is not None and math.isnan(_number(cell)):
            return heading
    for test in (is_stamp, looks_like_date):
        for heading, cell in cells.items():
            if test(cell):
                return heading
    return None


def _number(cell: Any) -> float:
    """Value of a cell; NaN unless it is a number as other programs write it."""
    if isinstance(cell, bool) or not isinstance(cell, str | int | float | Decimal):
        return math.nan
    try:
        odd = isinstance(cell, str) and ("_" in cell or not cell.isascii())
        return math.nan if odd else float(cell)
    except (ValueError, OverflowError):
        return math.nan


def _headings(path: Path, table: Iterator[Row]) -> tuple[int, dict[str, int]]:
    """Number of columns, and position of each heading."""
    number, row = next(table, (0, []))
    if not row:
        raise ProfileError(f"{path}: the file is empty")
    positions: dict[str, int] = {}
    texts = ("" if cell is None else str(cell).strip() for cell in row)
    for position, heading in enumerate(texts):
        if heading and heading in positions:
            raise ProfileError(f"{where(path, number)}: duplicate column {heading!r}")
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
            raise ProfileError(
                f"{path}: no column {heading!r}; {nearest(heading, found)}{separator_hint(found)}"
            )
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


def _check_width(path: Path, number: int, row: Sequence[Any], width: int, found: Collection[str]) -> None:
    if len(row) > width and any(str(cell).strip() for cell in row[width:] if cell is not None):
        raise ProfileError(
            f"{where(path, number)}: {len(row)} cells for {width} headings; use a decimal point and "
            f"one number per column{separator_hint(found)}"
        )


def _fault(row: Sequence[Any], position: int, value: float) -> str:
    if position >= len(row) or row[position] is None:
        return "the value is missing"
    return f"{row[position]!r} is not a {'' if math.isnan(value) else 'finite '}number"
