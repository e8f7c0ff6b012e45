"""The steps that the time series of a scenario cover, and files laid onto them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from opfmodel.data.calendar import NANOSECONDS, Calendar, duration
from opfmodel.data.columns import Columns
from opfmodel.data.resampling import Resample, check_method, resampled
from opfmodel.data.series import Profiles
from opfmodel.errors import ProfileError

__all__ = ["Grid", "at_calendar"]

Index = npt.NDArray[np.intp]


@dataclass
class Grid:
    """The steps that time series cover. The first file with times completes what is not stated.

    Attributes
    ----------
    steps
        Number of values of every series. Where plans end with the data, it falls to that of the shortest.
    step
        Length of a step, h; None until it is known.
    start
        Beginning of the first step, in UTC; None until it is known.
    zone
        Time zone of times without an offset, and in which times are shown; None if it is not stated.
    at_end
        What to do if data are too short: ``error``, ``repeat`` or ``shrink``.
    least
        Number of values that series must have even where plans end with them.
    """

    steps: int
    step: float | None = None
    start: np.datetime64 | None = None
    zone: str | None = None
    at_end: str = "error"
    least: int = 1

    @property
    def calendar(self) -> Calendar | None:
        """Time stamps of the steps; None if they are only numbered, so far."""
        return None if self.start is None else Calendar(self.start, self.hours, self.zone or "UTC")

    @property
    def hours(self) -> float:
        """Length of a step, h; 1 if it is not stated."""
        return 1.0 if self.step is None else self.step

    def fit(self, columns: Columns, resample: Resample | None = None) -> Columns:
        """Return the rows of a file for the steps.

        Rows with times are found by these; those without are numbered from the first step on.

        Parameters
        ----------
        resample
            How rows of another step are converted; None refuses them.

        Raises
        ------
        ProfileError
            The rows have another step, begin later than the first step or end too early, or their times
            are not those of equal steps.
        """
        check_method(resample)
        own = columns.calendar(self.zone, self.step)
        if own is None and resample is not None:
            raise ProfileError(f"{columns.path}: resample needs a column of times; state time_column")
        if own is not None:
            self._complete(own)
            if resample is not None:
                columns, own = _at_steps(columns, own, self._known, resample)
        with _located(columns, own, self.calendar):
            return columns.rows(self._chosen(len(columns.lines), own, "rows"))

    def take(self, series: Profiles) -> Profiles:
        """Return the values of series for the steps; errors are those of :meth:`fit`."""
        if series.length is None:
            return series
        if series.calendar is not None:
            self._complete(series.calendar)
        chosen = self._chosen(series.length, series.calendar, "values")
        return Profiles({key: values[chosen] for key, values in series.items()}, self.calendar)

    def _complete(self, own: Calendar) -> None:
        """Take start and step from the first series with time stamps if they are not stated."""
        self.start = own.start if self.start is None else self.start
        self.step = own.step if self.step is None else self.step

    @property
    def _known(self) -> Calendar:
        assert self.calendar is not None
        return self.calendar

    def _chosen(self, rows: int, own: Calendar | None, noun: str) -> Index:
        """Return the positions of the values for the steps, among as many as a series has."""
        lead = 0 if own is None else own.steps_until(self._known)
        if self.at_end == "repeat" and rows > lead:
            return np.asarray((lead + np.arange(self.steps)) % rows)
        if self.at_end == "shrink" and self.least <= rows - lead < self.steps:
            self.steps = rows - lead
        if rows - lead < self.steps:
            needed = self.least if self.at_end == "shrink" else self.steps
            if own is None:
                raise ProfileError(f"{rows} {noun}; {needed} are needed")
            raise ProfileError(
                f"the data end at {own.shown(rows)}; {needed} from {self._known.shown(0)} on are needed, "
                f"up to {self._known.shown(needed)}"
            )
        return lead + np.arange(self.steps)


def at_calendar(columns: Columns, calendar: Calendar, resample: Resample | None) -> tuple[Columns, int]:
    """Return rows with times at the steps of a calendar, and the position of its first step among them.

    Raises
    ------
    ProfileError
        As for :meth:`Grid.fit`.
    """
    own = columns.calendar(calendar.zone, calendar.step)
    assert own is not None
    if resample is not None:
        columns, own = _at_steps(columns, own, calendar, resample)
    with _located(columns, own, calendar):
        return columns, own.steps_until(calendar)


@contextmanager
def _located(columns: Columns, own: Calendar | None, calendar: Calendar | None) -> Iterator[None]:
    """Add the file to errors, and how to convert rows of another step."""
    try:
        yield
    except ProfileError as error:
        other = own is not None and calendar is not None and not own.has_step(calendar.step)
        hint = "; state resample: mean or interpolate to convert them" if other else ""
        raise ProfileError(f"{columns.path}: {error}{hint}") from None


def _at_steps(
    columns: Columns, own: Calendar, calendar: Calendar, resample: Resample
) -> tuple[Columns, Calendar]:
    """Return rows converted to the steps of a calendar, as far as they cover these, and their calendar."""
    edges, length = _edges(own, len(columns.lines)), round(calendar.step * NANOSECONDS)
    start = int(calendar.start.astype(np.int64))
    first, last = -((start - edges[0]) // length), (edges[-1] - start) // length
    if last <= first:
        raise ProfileError(
            f"{columns.path}: {len(columns.lines)} rows of {duration(own.step)} are too short for a step of "
            f"{duration(calendar.step)}"
        )
    wanted = start + np.arange(first, last + 1) * length
    try:
        made = {key: resampled(v, edges, wanted, resample) for key, v in columns.values.items()}
    except ProfileError as error:
        raise ProfileError(f"{columns.path}: {error}") from None
    origin = np.searchsorted(edges, wanted[:-1], side="right") - 1
    lines = np.asarray(columns.lines)[origin].tolist()
    times = [columns.times[row] for row in origin]
    return Columns(columns.path, made, lines, columns.clock, times), calendar.later(int(first))


def _edges(calendar: Calendar, steps: int) -> npt.NDArray[np.int64]:
    """Return the beginnings of steps and the end of the last, in nanoseconds."""
    return calendar.stamps(steps + 1).astype(np.int64)
