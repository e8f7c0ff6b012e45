"""Forecasts from a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from opfmodel.data.columns import read_columns
from opfmodel.data.series import Profiles, SeriesKey
from opfmodel.errors import ProfileError, nearest, raise_all
from opfmodel.forecasts.base import Array, Forecast, part

__all__ = ["File"]

_ISSUED = "issued"


class File(Forecast):
    """Forecasts from a CSV file, with columns headed ``component.field``.

    Each row is one step. An optional column ``issued`` holds the step at which a row was issued; the
    rows of one issue cover the steps from that one on, and the latest issue applies. Without it, all
    rows were issued at step 0. Lines that begin with ``#`` are comments. Series that are not in the
    file are known.

    Parameters
    ----------
    file
        Path of the file.

    Raises
    ------
    ProfileError
        The file cannot be read, or a value is not a number; the message gives line and column.
    """

    def __init__(self, file: Path) -> None:
        self.file = Path(file)
        self._issues = _read(self.file)

    def expected(self, actual: Profiles, time: int, stages: int) -> Profiles:
        """Return the latest forecast of the steps from ``time`` on.

        Raises
        ------
        ProfileError
            No forecast was issued by then, the latest is too short, or a column names no series.
        """
        issued = max((step for step in self._issues if step <= time), default=None)
        if issued is None:
            raise ProfileError(
                f"{self.file}: no forecast issued by step {time}; the first is at step {min(self._issues)}"
            )
        series = self._issues[issued]
        rows, needed = len(next(iter(series.values()))), time - issued + stages
        if rows < needed:
            raise ProfileError(
                f"{self.file}: the forecast issued at step {issued} has {rows} rows; "
                f"steps {time} to {time + stages - 1} need {needed}"
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
        return Profiles(
            {**known, **{key: values[time - issued :][:stages] for key, values in series.items()}}
        )


def _read(path: Path) -> dict[int, dict[SeriesKey, Array]]:
    """Read the series, by the step at which they were issued."""
    columns = read_columns(path, optional=(_ISSUED,))
    series = dict(columns.values)
    if not columns.lines:
        raise ProfileError(f"{path}: has no rows of numbers; one per step is needed")
    steps = series.pop(_ISSUED, np.zeros(len(columns.lines)))
    parts = np.flatnonzero(steps != np.floor(steps))
    if parts.size:
        raise ProfileError(f"{columns.place(_ISSUED, parts[0])}{steps[parts[0]]:g} is not a step")
    order = np.argsort(steps, kind="stable")
    issues, begins = np.unique(steps[order], return_index=True)
    split = {SeriesKey.of(heading): np.split(v[order], begins[1:]) for heading, v in series.items()}
    return {
        int(step): {key: parts[number] for key, parts in split.items()} for number, step in enumerate(issues)
    }
