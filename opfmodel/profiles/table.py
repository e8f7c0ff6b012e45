"""Time series from a file."""

from __future__ import annotations

from opfmodel.errors import ProfileError
from opfmodel.profiles.base import ProfileRule, Workbook, constant
from opfmodel.profiles.columns import read_columns, read_rows

__all__ = ["Table"]


class Table(ProfileRule):
    """Series from the columns of a CSV file, each headed ``component.field``.

    Lines that begin with ``#`` are comments; a column without a dot in its heading (a time stamp,
    say) is ignored.

    Parameters
    ----------
    file
        Path, relative to the scenario file.
    """

    def __init__(self, file: str) -> None:
        self.file = file

    def apply(self, book: Workbook) -> None:
        """Replace the series of the fields that the file has."""
        path = book.folder / self.file
        lines = [number for number, _ in read_rows(path)[1]]
        for heading, values in read_columns(path, book.steps).items():
            component, _, key = heading.rpartition(".")
            if component not in book.network:
                raise ProfileError(f"{path}: column {heading!r}: the network has no component {component!r}")
            constant(book.network[component], key)
            book.set(component, key, values)
            book.sources[heading] = path, lines
