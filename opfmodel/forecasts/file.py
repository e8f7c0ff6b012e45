"""Forecasts from a file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from opfmodel.errors import ProfileError
from opfmodel.forecasts.base import Array, Forecast, part
from opfmodel.profiles.columns import numbers, read_rows
from opfmodel.profiles.series import Profiles

__all__ = ["File"]

_ISSUED = "issued"


class File(Forecast):
    """What a CSV file says, in columns headed ``component.field``.

    A row is a step. With a column ``issued``, which holds the step at which a row was forecast, the
    rows of one issue are the steps from that one on, and the newest issue counts; without it the
    whole file was issued at step 0. Lines that begin with ``#`` are comments. What the file says nothing
    of is known.

    Parameters
    ----------
    file
        Path of the file.

    Raises
    ------
    ProfileError
        The file cannot be read, or a value is not a number; the message names line and column.
    """

    def __init__(self, file: Path) -> None:
        self.file = Path(file)
        self._issues = _read(self.file)

    def expected(self, actual: Profiles, time: int, stages: int) -> Profiles:
        """The newest forecast of the steps from ``time`` on.

        Raises
        ------
        ProfileError
            Nothing was issued by then, the issue ends too early, or a column names no series.
        """
        issued = max((step for step in self._issues if step <= time), default=None)
        if issued is None:
            raise ProfileError(
                f"{self.file}: nothing was issued by step {time}; first is {min(self._issues)}"
            )
        series = self._issues[issued]
        rows, needed = len(next(iter(series.values()))), time - issued + stages
        if rows < needed:
            raise ProfileError(
                f"{self.file}: the forecast issued at step {issued} has {rows} rows; "
                f"steps {time} to {time + stages - 1} need {needed}"
            )
        known = part(actual, time, stages)
        for component, field in series:
            if (component, field) not in known:
                raise ProfileError(
                    f"{self.file}: column '{component}.{field}': there is no such series among the profiles"
                )
        return Profiles(
            {**known, **{key: values[time - issued :][:stages] for key, values in series.items()}}
        )


def _read(path: Path) -> dict[int, dict[tuple[str, str], Array]]:
    """Series by component and field, by the step at which they were issued."""
    headings, rows = read_rows(path)
    series = [n for n, heading in enumerate(headings) if "." in heading]
    if not series or not rows:
        raise ProfileError(f"{path}: needs a line of headings 'component.field' and a row per step")
    columns = {n: _finite(path, headings[n], n, rows) for n in series}
    steps = np.zeros(len(rows))
    if _ISSUED in headings:
        steps = _finite(path, _ISSUED, headings.index(_ISSUED), rows)
        parts = np.flatnonzero(steps != np.floor(steps))
        if parts.size:
            raise ProfileError(
                f"{path}: line {rows[parts[0]][0]}, column '{_ISSUED}': {steps[parts[0]]:g} is not a step"
            )
    named = {n: headings[n].rpartition(".") for n in series}
    return {
        int(step): {
            (component, field): columns[n][steps == step] for n, (component, _, field) in named.items()
        }
        for step in np.unique(steps)
    }


def _finite(path: Path, heading: str, column: int, rows: Sequence[tuple[int, list[str]]]) -> Array:
    values = numbers(path, heading, column, rows)
    endless = np.flatnonzero(~np.isfinite(values))
    if endless.size:
        raise ProfileError(f"{path}: line {rows[endless[0]][0]}, column {heading!r}: must be finite")
    return values
