"""Time series from a file."""

from __future__ import annotations

import csv

import numpy as np

from opfmodel.errors import ProfileError
from opfmodel.profiles.base import ProfileRule, Workbook, constant

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
        try:
            with path.open(newline="", encoding="utf-8") as stream:
                lines = [line for line in csv.reader(stream) if line and not line[0].startswith("#")]
        except (OSError, UnicodeDecodeError) as error:
            raise ProfileError(f"{path}: cannot be read: {error}") from error
        if not lines:
            raise ProfileError(f"{path}: the file is empty")
        header, rows = lines[0], lines[1:]
        if len(rows) < book.steps:
            raise ProfileError(f"{path}: {len(rows)} rows; {book.steps} are needed")
        for column, heading in enumerate(header):
            component, dot, key = heading.strip().rpartition(".")
            if not dot:
                continue
            if component not in book.network:
                raise ProfileError(f"{path}: column {heading!r}: the network has no component {component!r}")
            constant(book.network[component], key)
            values = np.zeros(book.steps)
            for number, row in enumerate(rows[: book.steps]):
                try:
                    values[number] = float(row[column])
                except (ValueError, IndexError):
                    found = row[column] if column < len(row) else "nothing"
                    raise ProfileError(
                        f"{path}: row {number + 2}, column {heading!r}: {found!r} is not a number"
                    ) from None
            book.set(component, key, values)
