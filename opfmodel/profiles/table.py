"""Time series from a file."""

from __future__ import annotations

from opfmodel.data.columns import read_columns, separator_hint
from opfmodel.data.resampling import Resample
from opfmodel.data.series import SeriesKey
from opfmodel.errors import ProfileError, raise_all
from opfmodel.network.series import faults_of_keys
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
        keys = {SeriesKey.of(heading): heading for heading in columns.values}
        raise_all(
            ProfileError(f"{path}: column {keys[key]!r}: {fault}{separator_hint(columns.values)}")
            for key, fault in faults_of_keys(keys, book.network)
        )
        for key, heading in keys.items():
            book.set(key.component, key.field, columns.values[heading])
            book.sources[key] = columns
