"""Demand that follows a measured curve."""

from __future__ import annotations

from opfmodel.data.columns import read_columns
from opfmodel.errors import ProfileError
from opfmodel.profiles.base import ProfileRule, Workbook

__all__ = ["Shape"]


class Shape(ProfileRule):
    """Multiply active and reactive demand by a column of a CSV file divided by its mean over all rows.

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
    """

    def __init__(
        self, file: str, column: str, less: list[str] | None = None, loads: list[str] | None = None
    ) -> None:
        self.file = file
        self.column = column
        self.less = less or []
        self.loads = loads

    def apply(self, book: Workbook) -> None:
        """Multiply the demand."""
        path = book.folder / self.file
        columns = read_columns(path, None, [self.column, *self.less]).values
        curve = columns[self.column] - sum(columns[heading] for heading in self.less)
        if len(curve) < book.steps:
            raise ProfileError(f"{path}: {len(curve)} rows; {book.steps} are needed")
        if curve.mean() <= 0:
            raise ProfileError(f"{path}: the mean of column {self.column!r} is not positive")
        factor = curve[: book.steps] / curve.mean()
        for load in book.loads(self.loads):
            for key in ("p", "q"):
                book.set(load, key, book.get(load, key) * factor)
