"""Files of values per step beside the profile rules: set-points, and limits of constraints."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from opfmodel.data.columns import Columns, read_columns
from opfmodel.data.grid import Grid

__all__ = ["FILE_OPTIONS", "read_fitted", "repeated"]

FILE_OPTIONS = ("time_column", "resample")


def read_fitted(path: Path, grid: Grid, headings: list[str] | None = None, **stated: Any) -> Columns:
    """Read the columns of a file for the steps of a scenario.

    Parameters
    ----------
    stated
        What a scenario states of the file; of this, the options ``time_column`` and ``resample``.

    Raises
    ------
    ProfileError
        The file cannot be read, or does not fit the steps.
    """
    clock = stated.get("time_column")
    clock = None if clock is None else str(clock)
    columns = read_columns(path, grid.steps, headings, time_column=clock, fewer=True)
    return grid.fit(columns, stated.get("resample"))


def repeated(values: Any, steps: int) -> Any:
    """Return a list of values repeated to a number of steps; anything else is unchanged."""
    listed = isinstance(values, list) and values
    return np.resize(np.asarray(values), max(steps, len(values))).tolist() if listed else values
