"""Time series from a file."""

from __future__ import annotations

from opfmodel.data.columns import read_columns, separator_hint
from opfmodel.data.resampling import Resample
from opfmodel.data.series import SeriesKey
from opfmodel.errors import ProfileError, nearest
from opfmodel.profiles.base import ProfileRule, Workbook

__all__ = ["Table"]


class Table(ProfileRule):
    """Read series from the columns of a file, each headed ``component.field``.

    The file is CSV, Excel (``.xlsx``) or Parquet (``.parquet``). Its rows belong to the steps of the
    scenario by a column of times; without one they are numbered from the first step on. Lines of a CSV file
    that begin with ``#`` are comments. Other columns without a dot in the heading are ignored. ``inf``
    stands for "no limit" in columns of ratings, ramps, and generators' ``q_min`` (``-inf``) and ``q_max``.

    Parameters
    ----------
    file
        Path, relative to the scenario file.
    time_column
        Heading of the column with the beginnings of the steps, in ISO 8601. By default it is one named
        ``time``, ``timestamp``, ``datetime``, ``date`` or ``snapshot``, or the first without a dot in the
        heading that has such times.
    resample
        Conversion of rows of another step: ``mean`` (a value holds during its step; energy is kept) or
        ``interpolate`` (a value holds at the beginning of its step). By default they are refused.
    """

    def __init__(self, file: str, time_column: str | None = None, resample: Resample | None = None) -> None:
        self.file = file
        self.time_column = time_column
        self.resample = resample

    def apply(self, book: Workbook) -> None:
        """Replace the series of the fields in the file."""
        path = book.folder / self.file
        read = read_columns(path, book.steps, unlimited=True, time_column=self.time_column, fewer=True)
        columns = book.grid.fit(read, self.resample)
        for heading, values in columns.values.items():
            key = SeriesKey.of(heading)
            if key.component not in book.network:
                near = nearest(key.component, book.network)
                raise ProfileError(
                    f"{path}: column {heading!r}: the network has no component {key.component!r}; {near}"
                    f"{separator_hint(columns.values)}"
                )
            try:
                book.network[key.component].constant(key.field)
            except ProfileError as error:
                raise ProfileError(f"{path}: column {heading!r}: {error}") from error
            book.set(key.component, key.field, values)
            book.sources[key] = columns
