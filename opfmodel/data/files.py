"""Opening of data files: only regular files of bounded size.

Every file named by a user is opened here. A device, a pipe or an endless file therefore gives an error
message instead of blocking the program or exhausting memory.
"""

from __future__ import annotations

import io
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from opfmodel.errors import OpfmodelError

__all__ = ["check_file", "is_folder", "open_text", "read_bytes", "read_text"]

MB = 1_000_000
MOST_BYTES = 1_000 * MB  # an hourly table of one year for ten thousand components has 700 MB


@contextmanager
def open_text(path: Path, raises: type[OpfmodelError], most_bytes: int = MOST_BYTES) -> Iterator[TextIO]:
    """Open a UTF-8 text file; read errors inside the block are reported with the path.

    A byte-order mark is skipped.

    Parameters
    ----------
    raises
        Class of the error raised if the file is missing, not a regular file, larger than
        ``most_bytes``, unreadable, or not UTF-8 text.
    """
    descriptor = _open(path, raises, most_bytes)
    try:
        with io.TextIOWrapper(os.fdopen(descriptor, "rb"), encoding="utf-8-sig", newline="") as stream:
            yield stream
    except UnicodeDecodeError as error:
        raise raises(f"{path}: not UTF-8 text: {error.reason} at byte {error.start}") from error
    except OSError as error:
        raise raises(f"{path}: cannot be read: {error.strerror or error}") from error


def read_text(path: Path, raises: type[OpfmodelError], most_bytes: int = MOST_BYTES) -> str:
    """Read a text file, converting CRLF to LF; errors as for :func:`open_text`."""
    with open_text(path, raises, most_bytes) as stream:
        return stream.read(most_bytes).replace("\r\n", "\n")


def read_bytes(path: Path, raises: type[OpfmodelError], most_bytes: int = MOST_BYTES) -> bytes:
    """Read a binary file; errors as for :func:`open_text`."""
    try:
        with os.fdopen(_open(path, raises, most_bytes), "rb") as stream:
            return stream.read(most_bytes)
    except OSError as error:
        raise raises(f"{path}: cannot be read: {error.strerror or error}") from error


def check_file(path: Path, raises: type[OpfmodelError], most_bytes: int = MOST_BYTES) -> None:
    """Raise an error, as for :func:`open_text`, unless a library may safely open the file itself."""
    os.close(_open(path, raises, most_bytes))


def is_folder(path: Path) -> bool:
    """Whether a path is a folder; False for invalid paths."""
    try:
        return path.is_dir()
    except (OSError, ValueError):
        return False


def _open(path: Path, raises: type[OpfmodelError], most_bytes: int) -> int:
    """Open a descriptor of a regular file, without blocking on pipes and devices."""
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    try:
        descriptor = os.open(path, flags)
    except FileNotFoundError:
        raise raises(f"{path}: no such file") from None
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        raise raises(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise raises(f"{path}: is {_sort(status.st_mode)}; must be a regular file")
        if status.st_size > most_bytes:
            raise raises(
                f"{path}: has {status.st_size / MB:,.0f} MB; at most {most_bytes / MB:,.0f} MB are accepted"
            )
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def _sort(mode: int) -> str:
    """Type of a file that is not a regular file."""
    sorts = ((stat.S_ISDIR, "a folder"), (stat.S_ISFIFO, "a pipe"), (stat.S_ISSOCK, "a socket"))
    return next((name for test, name in sorts if test(mode)), "a device")
