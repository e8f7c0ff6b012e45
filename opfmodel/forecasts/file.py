"""Forecasts from a file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from opfmodel.data.calendar import Calendar
from opfmodel.data.columns import Columns, read_columns
from opfmodel.data.grid import at_calendar
from opfmodel.data.resampling import Resample, check_method
from opfmodel.data.series import Profiles, SeriesKey
from opfmodel.errors import ProfileError, nearest, raise_all
from opfmodel.forecasts.base import Array, Forecast, part

__all__ = ["File"]

# Series ``(members, rows)``, and the position of the step of issue in the rows.
Issue = tuple[dict[SeriesKey, Array], int]
Rows = npt.NDArray[np.intp]

_ISSUED, _MEMBER = "issued", "member"


class File(Forecast):
    """Forecasts from a file, with columns headed ``component.field``.

    Each row is one step. Formats and times of the rows are those of the profile rule ``table``. An optional
    column ``issued`` holds the number of the step at which a row was issued; the rows of one issue cover the
    steps from that one on, and the latest issue applies. Without it, all rows were issued at step 0. Lines
    of a CSV file that begin with ``#`` are comments. Series that are not in the file are known.

    An optional column ``member`` makes it an ensemble: the rows of each member are one path, the forecast is
    the mean of all, and scenarios are drawn from the members.

    Parameters
    ----------
    file
        Path of the file.
    time_column, resample
        As for the profile rule ``table``; rows that were issued at several steps are not resampled.

    Raises
    ------
    ProfileError
        The file cannot be read, or a value is not a number; the message gives line and column.
    """

    def __init__(self, file: Path, time_column: str | None = None, resample: Resample | None = None) -> None:
        self.file = Path(file)
        self.resample = resample
        check_method(resample)
        self._columns = read_columns(self.file, optional=(_ISSUED, _MEMBER), time_column=time_column)
        if not self._columns.lines:
            raise ProfileError(f"{self.file}: has no rows of numbers; one per step is needed")
        self._issued = _ISSUED in self._columns.values
        if self._issued and resample is not None:
            raise ProfileError(f"{self.file}: resample: not for forecasts with a column {_ISSUED!r}")
        self._rows = _rows(self._columns)
        self._known: tuple[Calendar | None, dict[int, Issue]] | None = None

    def expected(self, actual: Profiles, time: int, stages: int) -> Profiles:
        """Return the latest forecast of the steps from ``time`` on.

        Raises
        ------
        ProfileError
            No forecast was issued by then, the latest is too short, a column names no series, or the
            times of the rows do not fit those of the series.
        """
        issues = self._issues(actual.calendar)
        issued = max((step for step in issues if step <= time), default=None)
        if issued is None:
            raise ProfileError(
                f"{self.file}: no forecast issued by step {time}; the first is at step {min(issues)}"
            )
        series, lead = issues[issued]
        rows, first = next(iter(series.values())).shape[1], lead + time - issued
        if rows < first + stages and not (actual.repeats and not self._issued):
            raise ProfileError(
                f"{self.file}: the forecast issued at step {issued} has {rows - lead} rows; "
                f"steps {time} to {time + stages - 1} need {first + stages - lead}"
            )
        known = part(actual, time, stages)
        raise_all(
            ProfileError(
                f"{self.file}: column '{key}': the profiles have no such series; "
                f"{nearest(str(key), map(str, known))}"
            )
            for key in series
            if key not in known
        )
        ahead = np.arange(first, first + stages) % rows
        return Profiles({**known, **{key: values.mean(axis=0)[ahead] for key, values in series.items()}})

    def paths(
        self, issued: Profiles, time: int, number: int, seed: int, calendar: Calendar | None = None
    ) -> dict[SeriesKey, Array]:
        """Return members of the latest forecast: all of them, or as many drawn without replacement.

        Raises
        ------
        ProfileError
            The file has no members, or fewer than paths are to be drawn.
        """
        issues = self._issues(calendar)
        step = max(step for step in issues if step <= time)
        series, lead = issues[step]
        members, rows = next(iter(series.values())).shape
        if members == 1:
            raise ProfileError(
                f"{self.file}: the forecast issued at step {step} has no members from which scenarios can be "
                f"drawn; state at least two in a column {_MEMBER!r}"
            )
        if number > members:
            raise ProfileError(
                f"{self.file}: the forecast issued at step {step} has {members} members, fewer "
                f"than the {number} paths to draw; draw.number must be at most {members}"
            )
        chosen = np.sort(np.random.default_rng([seed, time]).permutation(members)[:number])
        ahead = np.arange(lead + time - step, lead + time - step + (issued.length or 0)) % rows
        return {key: values[np.ix_(chosen, ahead)] for key, values in series.items()}

    def _issues(self, calendar: Calendar | None) -> dict[int, Issue]:
        """Return the forecasts by the step at which they were issued, at the steps of a calendar."""
        if self._known is None or self._known[0] != calendar:
            self._known = (
                calendar,
                {step: self._issue(step, rows, calendar) for step, rows in self._rows.items()},
            )
        return self._known[1]

    def _issue(self, step: int, members: Sequence[Rows], calendar: Calendar | None) -> Issue:
        made = [self._member(step, rows, calendar) for rows in members]
        shapes = [(len(next(iter(values.values()))), lead) for values, lead in made]
        for shape, rows in zip(shapes, members, strict=True):
            if shape != shapes[0]:
                raise ProfileError(
                    f"{self._columns.place(_MEMBER, rows[0])}the members of a forecast must cover the "
                    "same steps"
                )
        return {key: np.array([values[key] for values, _ in made]) for key in made[0][0]}, shapes[0][1]

    def _member(self, step: int, rows: Rows, calendar: Calendar | None) -> tuple[dict[SeriesKey, Array], int]:
        columns = self._columns.rows(rows)
        lead = 0
        if columns.clock is not None:
            if calendar is None:
                raise ProfileError(
                    f"{self.file}: its rows have times, but the time series have none; state time.start"
                )
            begin = calendar.later(step)
            columns, lead = at_calendar(columns, begin, self.resample)
            if self._issued and lead:
                raise ProfileError(
                    f"{columns.place(_ISSUED, 0)}the rows issued at step {step} must begin at "
                    f"{begin.shown(0)}"
                )
        elif self.resample is not None:
            raise ProfileError(f"{self.file}: resample needs a column of times; state time_column")
        stated = {k: v for k, v in columns.values.items() if k not in (_ISSUED, _MEMBER)}
        return {SeriesKey.of(key): values for key, values in stated.items()}, lead


def _rows(columns: Columns) -> dict[int, list[Rows]]:
    """Return the positions of the rows of each member, by the step at which they were issued."""
    steps, members = (_whole(columns, name, what) for name, what in ((_ISSUED, "step"), (_MEMBER, "member")))
    order = np.lexsort((members, steps))  # stable
    made: dict[int, list[Rows]] = {}
    keys = np.column_stack([steps, members])[order]
    changes = np.flatnonzero((keys[1:] != keys[:-1]).any(axis=1)) + 1
    for rows in np.split(order, changes):
        made.setdefault(int(steps[rows[0]]), []).append(rows)
    return made


def _whole(columns: Columns, name: str, what: str) -> Array:
    """Return an optional column of whole numbers, by default zeros."""
    values = columns.values.get(name, np.zeros(len(columns.lines)))
    parts = np.flatnonzero(values != np.floor(values))
    if parts.size:
        raise ProfileError(f"{columns.place(name, parts[0])}{values[parts[0]]:g} is not a {what}")
    return values
