"""Time series from a file."""

from __future__ import annotations

from opfmodel.data.columns import read_columns, separator_hint
from opfmodel.data.series import SeriesKey
from opfmodel.errors import ProfileError, raise_all
from opfmodel.network.series import faults_of_keys
from opfmodel.profiles.base import ProfileRule, Workbook

__all__ = ["Table"]


class Table(ProfileRule):
    """Read series from the columns of a CSV file, each headed ``component.field``.

    Lines that begin with ``#`` are comments. Columns without a dot in the heading, such as time stamps,
    are ignored. Rows beyond those that the scenario needs are not read. ``inf`` stands for "no limit"
    in columns of ratings, ramps, and generators' ``q_min`` (``-inf``) and ``q_max``.

    Parameters
    ----------
    file
        Path, relative to the scenario file.
    """

    def __init__(self, file: str) -> None:
        self.file = file

    def apply(self, book: Workbook) -> None:
        """Replace the series of the fields in the file."""
        path = book.folder / self.file
        columns = read_columns(path, book.steps, unlimited=True)
        keys = {SeriesKey.of(heading): heading for heading in columns.values}
        raise_all(
            ProfileError(f"{path}: column {keys[key]!r}: {fault}{separator_hint(columns.values)}")
            for key, fault in faults_of_keys(keys, book.network)
        )
        for key, heading in keys.items():
            book.set(key.component, key.field, columns.values[heading])
            book.sources[key] = columns
