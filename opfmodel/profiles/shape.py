"""Demand that follows a measured curve."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from opfmodel.data.columns import read_columns
from opfmodel.data.resampling import Resample
from opfmodel.errors import ProfileError
from opfmodel.profiles.base import ProfileRule, Workbook

__all__ = ["Shape"]

Array = npt.NDArray[np.float64]


class Shape(ProfileRule):
    """Multiply active and reactive demand by a column of a file divided by its mean over all rows.

    Formats and times of the rows are those of the rule ``table``.

    Parameters
    ----------
    file
        Path, relative to the scenario file.
    column
        Heading of the column.
    less
        Headings of columns to subtract first, such as renewable generation for net demand.
    loads
        Names of loads; all by default.
    time_column, resample
        As for the rule ``table``.
    """

    def __init__(
        self,
        file: str,
        column: str,
        less: list[str] | None = None,
        loads: list[str] | None = None,
        time_column: str | None = None,
        resample: Resample | None = None,
    ) -> None:
        self.file = file
        self.column = column
        self.less = less or []
        self.loads = loads
        self.time_column = time_column
        self.resample = resample

    def apply(self, book: Workbook) -> None:
        """Multiply the demand."""
        path = book.folder / self.file
        read = read_columns(path, None, [self.column, *self.less], time_column=self.time_column)
        curve = self._curve(book.grid.fit(read, self.resample).values)
        mean = self._curve(read.values).mean()
        if mean <= 0:
            raise ProfileError(f"{path}: the mean of column {self.column!r} is not positive")
        factor = curve / mean
        for load in book.loads(self.loads):
            for key in ("p", "q"):
                book.set(load, key, book.get(load, key) * factor)

    def _curve(self, columns: Mapping[str, Array]) -> Array:
        """Return the column less those to subtract."""
        return columns[self.column] - sum(columns[heading] for heading in self.less)
