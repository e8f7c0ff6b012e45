"""Time series from a file."""

from __future__ import annotations

from opfmodel.data.columns import read_columns, separator_hint
from opfmodel.data.series import SeriesKey
from opfmodel.errors import ProfileError, nearest
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
