"""Rows of tables in files: CSV, Excel and Parquet."""

from __future__ import annotations

import csv
import io
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

from opfmodel.data.files import MB, open_text, read_bytes
from opfmodel.errors import ProfileError

__all__ = ["Row", "open_rows", "where"]

Row = tuple[int, list[Any]]

_LONGEST_LINE = 10_000_000  # characters; a row for ten thousand components has 200,000
_MOST_BYTES = 1_000 * MB  # unpacked; compressed files may expand a thousandfold
_EXCEL = (".xlsx", ".xlsm")
_PARQUET = (".parquet", ".pq")


def where(path: Path, number: int) -> str:
    """Return the location of a row for messages: its line in a text file."""
    noun = "row" if path.suffix.lower() in (*_EXCEL, *_PARQUET) else "line"
    return f"{path}: {noun} {number}"


@contextmanager
def open_rows(path: Path) -> Iterator[Iterator[Row]]:
    """Open a table and iterate over its rows, headings first, each with its number in the file from 1.

    The ending of the name tells the format: ``.xlsx`` and ``.xlsm`` are Excel (the first sheet),
    ``.parquet`` and ``.pq`` are Parquet, everything else is CSV. Cells of CSV are text; lines that begin
    with ``#`` are comments there.

    Raises
    ------
    ProfileError
        The file cannot be read, is not of its format, or is too large.
    """
    suffix = path.suffix.lower()
    if suffix in _EXCEL:
        yield _excel(path)
    elif suffix in _PARQUET:
        yield _parquet(path)
    else:
        with open_text(path, ProfileError) as stream:
            yield _csv(path, stream)


def _csv(path: Path, stream: TextIO) -> Iterator[Row]:
    """Rows with their line numbers, without comments and empty lines.

    Every line is read on its own: a quotation mark that is not closed would join it to the next lines.
    """
    for number, line in _lines(path, stream):
        try:
            row = next(csv.reader([line]))
        except csv.Error as error:
            raise ProfileError(f"{path}: line {number}: not CSV: {error}") from error
        if not row or row[0].startswith("#"):
            continue
        if row[-1].endswith(("\n", "\r")):
            raise ProfileError(f"{path}: line {number}: a quotation mark is not closed on its line")
        yield number, row


def _lines(path: Path, stream: TextIO) -> Iterator[tuple[int, str]]:
    """Lines of a file with their numbers, limited in length to bound memory use."""
    number = 0
    while line := stream.readline(_LONGEST_LINE):
        number += 1
        if len(line) == _LONGEST_LINE:
            raise ProfileError(
                f"{path}: line {number}: too long; at most {_LONGEST_LINE:,} characters are accepted"
            )
        yield number, line


def _excel(path: Path) -> Iterator[Row]:
    """Rows of the first sheet with their numbers, without empty ones; formulas have their saved values."""
    content = read_bytes(path, ProfileError)
    try:
        from openpyxl import load_workbook
        from openpyxl.utils.exceptions import InvalidFileException
    except ImportError:
        raise ProfileError(
            f"{path}: Excel files need the package openpyxl; install it with 'pip install opfmodel[excel]', "
            "or save the sheet as CSV"
        ) from None
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        if size > _MOST_BYTES:
            raise ProfileError(
                f"{path}: has {size / MB:,.0f} MB unpacked; at most {_MOST_BYTES / MB:,.0f} MB are accepted"
            )
        book = load_workbook(io.BytesIO(content), read_only=True, data_only=True)
        if not book.worksheets:
            raise ProfileError(f"{path}: has no sheet with cells")
        for number, cells in enumerate(book.worksheets[0].iter_rows(values_only=True), 1):
            if any(cell is not None for cell in cells):
                yield number, list(cells)
    except (
        InvalidFileException,
        zipfile.BadZipFile,
        zipfile.LargeZipFile,
        zlib.error,
        SyntaxError,  # of XML, by any of the parsers that openpyxl uses
        KeyError,
        IndexError,
        ValueError,
        TypeError,
        AttributeError,
        OSError,
        EOFError,
        NotImplementedError,
    ) as error:  # what openpyxl raises for files that are damaged or no workbooks
        raise ProfileError(f"{path}: not an Excel workbook, or damaged: {error}") from error


def _parquet(path: Path) -> Iterator[Row]:
    """Rows with their numbers; the headings are row 0."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    content = read_bytes(path, ProfileError)
    try:
        file = pq.ParquetFile(pa.BufferReader(content))
        groups = (file.metadata.row_group(number) for number in range(file.metadata.num_row_groups))
        size = sum(group.total_byte_size for group in groups)
        if size > _MOST_BYTES:
            raise ProfileError(
                f"{path}: has {size / MB:,.0f} MB unpacked; at most {_MOST_BYTES / MB:,.0f} MB are accepted"
            )
        yield 0, list(file.schema_arrow.names)
        number = 0
        for batch in file.iter_batches():
            for cells in zip(*map(_cells, batch.columns), strict=True):
                number += 1
                yield number, list(cells)
    except (pa.ArrowException, OSError, ValueError, OverflowError) as error:  # the last by times out of range
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ProfileError(f"{path}: not a Parquet file, or damaged: {reason}") from error


def _cells(column: Any) -> list[Any]:
    """Values of a column; times to the microsecond, as the standard library has them."""
    import pyarrow as pa

    if pa.types.is_timestamp(column.type):
        column = column.cast(pa.timestamp("us", column.type.tz), safe=False)
    values: list[Any] = column.to_pylist()
    return values
