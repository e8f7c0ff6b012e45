"""Opening data files: regular files of bounded size, and nothing else.

Every file that a user names is opened here, so that a device, a pipe or a file without end is an
error in one sentence and never a program that waits or fills the memory.
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
MOST_BYTES = 1_000 * MB  # a table of a year in hours for ten thousand components has 700 MB


@contextmanager
def open_text(path: Path, raises: type[OpfmodelError], most_bytes: int = MOST_BYTES) -> Iterator[TextIO]:
    """Open a UTF-8 text file; what goes wrong inside the block is reported with its path.

    Parameters
    ----------
    raises
        Class of the error for a file that is missing, not a regular file, larger than
        ``most_bytes``, unreadable, or not UTF-8 text.
    """
    descriptor = _open(path, raises, most_bytes)
    try:
        with io.TextIOWrapper(os.fdopen(descriptor, "rb"), encoding="utf-8", newline="") as stream:
            yield stream
    except UnicodeDecodeError as error:
        raise raises(f"{path}: not a text file in UTF-8: {error.reason} at byte {error.start}") from error
    except OSError as error:
        raise raises(f"{path}: cannot be read: {error.strerror or error}") from error


def read_text(path: Path, raises: type[OpfmodelError], most_bytes: int = MOST_BYTES) -> str:
    """Content of a text file, with line ends as Python has them; errors as for :func:`open_text`."""
    with open_text(path, raises, most_bytes) as stream:
        return stream.read(most_bytes).replace("\r\n", "\n")


def read_bytes(path: Path, raises: type[OpfmodelError], most_bytes: int = MOST_BYTES) -> bytes:
    """Content of a file; errors as for :func:`open_text`."""
    try:
        with os.fdopen(_open(path, raises, most_bytes), "rb") as stream:
            return stream.read(most_bytes)
    except OSError as error:
        raise raises(f"{path}: cannot be read: {error.strerror or error}") from error


def check_file(path: Path, raises: type[OpfmodelError], most_bytes: int = MOST_BYTES) -> None:
    """Raise an error, as :func:`open_text` does, unless a library may open the file itself."""
    os.close(_open(path, raises, most_bytes))


def is_folder(path: Path) -> bool:
    """Whether a path is that of a folder; one that no file can have is not."""
    try:
        return path.is_dir()
    except (OSError, ValueError):
        return False


def _open(path: Path, raises: type[OpfmodelError], most_bytes: int) -> int:
    """A descriptor of a regular file; opening a pipe or a device does not wait for its other end."""
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    try:
        descriptor = os.open(path, flags)
    except FileNotFoundError:
        raise raises(f"{path}: there is no such file") from None
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        raise raises(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise raises(f"{path}: is {_sort(status.st_mode)}; a regular file is needed")
        if status.st_size > most_bytes:
            raise raises(
                f"{path}: has {status.st_size / MB:,.0f} MB; at most {most_bytes / MB:,.0f} MB are read"
            )
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def _sort(mode: int) -> str:
    """What a file is that is not a regular one."""
    sorts = ((stat.S_ISDIR, "a folder"), (stat.S_ISFIFO, "a pipe"), (stat.S_ISSOCK, "a socket"))
    return next((name for test, name in sorts if test(mode)), "a device")
