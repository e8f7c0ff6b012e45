"""Forecasts from a file."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from opfmodel.errors import ProfileError
from opfmodel.forecasts.base import Array, Forecast, part
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
        The file cannot be read, or a value is not a number; the message names row and column.
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
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            lines = [line for line in csv.reader(stream) if line and not line[0].startswith("#")]
    except (OSError, UnicodeDecodeError) as error:
        raise ProfileError(f"{path}: cannot be read: {error}") from error
    header = [heading.strip() for heading in lines[0]] if lines else []
    columns = {n: heading.rpartition(".") for n, heading in enumerate(header) if "." in heading}
    if not columns or len(lines) < 2:
        raise ProfileError(f"{path}: needs a line of headings 'component.field' and a row per step")
    values = np.array([[_number(path, lines, row, n) for n in columns] for row in range(1, len(lines))])
    steps = np.zeros(len(values))
    if _ISSUED in header:
        position = header.index(_ISSUED)
        steps = np.array([_number(path, lines, row, position) for row in range(1, len(lines))])
    return {
        int(step): {
            (component, field): values[steps == step, n]
            for n, (component, _, field) in enumerate(columns.values())
        }
        for step in np.unique(steps)
    }


def _number(path: Path, lines: list[list[str]], row: int, column: int) -> float:
    try:
        value = float(lines[row][column])
    except (ValueError, IndexError):
        value = np.nan
    if not np.isfinite(value):
        found = lines[row][column] if column < len(lines[row]) else "nothing"
        raise ProfileError(f"{path}: row {row + 1}, column {lines[0][column]!r}: {found!r} is not a number")
    return value
