"""Time stamps of the rows of a series: their meaning, and the checks that they form equal steps."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from datetime import date, datetime, timedelta
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.data.calendar import (
    NANOSECONDS,
    Calendar,
    duration,
    instants,
    shown_in,
    stated_time,
    within_years,
)
from opfmodel.errors import ProfileError, shown

__all__ = ["calendar_of", "in_utc", "is_local", "is_stamp", "looks_like_date"]

Stamps = npt.NDArray[np.datetime64]

_DATE = re.compile(r"\s*\d{1,4}([./-])\d{1,2}\1\d{1,4}(\D.*)?")


def is_stamp(cell: object) -> bool:
    """Whether a cell of a file is a time: a date of a spreadsheet, or text in ISO 8601.

    Examples
    --------
    >>> is_stamp("2025-03-29 00:15"), is_stamp("29.03.2025 00:15"), is_stamp("20250329"), is_stamp(3.0)
    (True, False, False, False)
    """
    if isinstance(cell, str):
        return bool(_DATE.fullmatch(cell)) and _parsed(cell) is not None
    return isinstance(cell, date | np.datetime64)


def looks_like_date(cell: object) -> bool:
    """Whether a cell is meant as a date, in ISO 8601 or not."""
    return is_stamp(cell) or (isinstance(cell, str) and bool(_DATE.fullmatch(cell)))


def is_local(cell: object) -> bool:
    """Whether a cell is a time without an offset from UTC."""
    time = _parsed(cell)
    return time is not None and time.tzinfo is None


def in_utc(cells: Sequence[Any] | Stamps, zone: str, place: Callable[[int], str]) -> Stamps:
    """Return the times of rows in UTC.

    A time without an offset is in the zone. Where clocks are put back, it exists twice: it is the one at
    the distance of the two rows before, or else the earlier one that follows them. The first row must be
    unambiguous.

    Parameters
    ----------
    place
        Location of a row, as the beginning of a message.

    Raises
    ------
    ProfileError
        A cell is no time, does not exist in the zone, or has an offset where the first row has none or the
        other way round.
    """
    if isinstance(cells, np.ndarray) and cells.dtype.kind == "M":
        missing = np.flatnonzero(np.isnat(cells))
        if missing.size:
            raise ProfileError(f"{place(int(missing[0]))}the time is missing")
        if zone == "UTC":
            return cells.astype("datetime64[ns]")
        cells = cells.astype("datetime64[us]").tolist()
    made = np.empty(len(cells), dtype="datetime64[ns]")
    before: datetime | None = None
    step = timedelta(0)
    offset: bool | None = None
    for row, cell in enumerate(cells):
        time = _parsed(cell)
        if time is None:
            found = "the time is missing" if cell in ("", None) else shown(cell)
            raise ProfileError(
                f"{place(row)}{found}: must be a time in ISO 8601, such as 2025-03-29T00:15 or "
                "2025-03-29T00:15+01:00"
            )
        offset = (time.tzinfo is not None) if offset is None else offset
        if offset != (time.tzinfo is not None):
            have = ("has no", "has an")[time.tzinfo is not None]
            raise ProfileError(f"{place(row)}{cell}: {have} offset from UTC, unlike the rows before")
        utc = _following(time, zone, before, step, partial(place, row))
        step = step if before is None else utc - before
        before = utc
        made[row] = np.datetime64(utc.replace(tzinfo=None), "ns")
    return made


def _following(
    time: datetime, zone: str, before: datetime | None, step: timedelta, place: Callable[[], str]
) -> datetime:
    """Return a time in UTC; of two possible ones, that one step after the row before, or else the earlier."""
    possible = instants(time, zone)
    if len(possible) == 1:
        return possible[0]
    if not possible or before is None:
        try:
            stated_time(time, zone)
        except ProfileError as error:
            raise ProfileError(f"{place()}{error}") from None
    assert before is not None
    after = [each for each in possible if each > before]
    return next((each for each in after if each == before + step), (after or possible[-1:])[0])


def _parsed(cell: object) -> datetime | None:
    """Return the time that a cell states, None if it states none."""
    time: object = cell
    if isinstance(cell, str):
        try:
            time = datetime.fromisoformat(cell.strip())
        except ValueError:
            return None
    elif isinstance(cell, np.datetime64):
        time = cell.astype("datetime64[us]").item()
    if isinstance(time, date) and not isinstance(time, datetime):
        time = datetime(time.year, time.month, time.day)
    return time if isinstance(time, datetime) and within_years(time) else None


def calendar_of(
    stamps: Stamps, zone: str, place: Callable[[int], str], step: float | None = None
) -> Calendar:
    """Return the calendar of rows with these times in UTC.

    Parameters
    ----------
    step
        Length of the steps, h, for a single row; otherwise the most frequent difference counts.

    Raises
    ------
    ProfileError
        Rows are out of order, duplicate or missing, the steps are unequal, or a single row leaves the step
        open. The message gives the row.
    """
    if stamps.size < 2:
        if step is None or not stamps.size:
            raise ProfileError(f"{place(0)}a single time does not tell the length of the steps; state it")
        return Calendar(stamps[0], step, zone)
    differences = np.diff(stamps).astype(np.int64)
    usual = _usual(differences[differences > 0])
    wrong = np.flatnonzero(differences != usual)
    if wrong.size or not usual:
        row = int(wrong[0]) + 1 if wrong.size else 1
        raise ProfileError(f"{place(row)}{_fault(stamps[row - 1], stamps[row], usual, zone)}")
    return Calendar(stamps[0], usual / NANOSECONDS, zone)


def _usual(differences: npt.NDArray[np.int64]) -> int:
    """Return the most frequent difference, 0 without any; of equals, that with most multiples."""
    if not differences.size:
        return 0
    lengths, first, counts = np.unique(differences, return_index=True, return_counts=True)
    equals = np.flatnonzero(counts == counts.max())[:100]
    multiples = [int((differences % lengths[each] == 0).sum()) for each in equals]
    return int(lengths[equals[np.lexsort((first[equals], np.negative(multiples)))[0]]])


def _fault(before: np.datetime64, after: np.datetime64, usual: int, zone: str) -> str:
    """Describe what is wrong with two successive times."""
    difference = int((after - before).astype(np.int64))
    text = f"{shown_in(after, zone)} follows {shown_in(before, zone)}: "
    if difference == 0:
        return text + "the same time twice"
    if difference < 0:
        return text + "rows must be in the order of time"
    step = duration(usual / NANOSECONDS)
    if difference % usual == 0:
        missing = difference // usual - 1
        return text + f"{missing} row{'s are' if missing > 1 else ' is'} missing at steps of {step}"
    return text + f"the other rows have steps of {step}"
