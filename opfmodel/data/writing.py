"""Writing of files: complete under a temporary name, flushed to disk, then renamed."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

__all__ = ["remove_temporaries", "replace"]

_TEMPORARY = re.compile(r"\.(?P<name>.+)\.[0-9]+")  # name used by replace, with a process id


def replace(contents: Mapping[Path, bytes], obsolete: Iterable[Path] = ()) -> None:
    """Write files of one folder, replacing those of the same names.

    Every file is first written completely under a temporary name. A full disk therefore changes nothing.

    Parameters
    ----------
    contents
        Content by path.
    obsolete
        Files to delete before the new ones get their names: they describe the content being replaced.

    Raises
    ------
    OSError
        A file cannot be written; those of the same names are unchanged.
    """
    temporaries = {path: path.with_name(f".{path.name}.{os.getpid()}") for path in contents}
    try:
        for path, temporary in temporaries.items():
            temporary.unlink(missing_ok=True)  # left by a killed process with the same id, or a link
            temporary.write_bytes(contents[path])
            _sync(temporary)
        for path in obsolete:
            path.unlink(missing_ok=True)
        for path, temporary in temporaries.items():
            temporary.replace(path)
        for folder in {path.parent for path in contents}:
            _sync(folder)
    finally:
        for temporary in temporaries.values():
            temporary.unlink(missing_ok=True)


def remove_temporaries(folder: Path, names: re.Pattern[str]) -> None:
    """Delete temporary files that killed processes left in a folder used by this process only.

    Parameters
    ----------
    names
        Names of the files written there by :func:`replace`. Only regular files with the temporary name
        of such a file are deleted.
    """
    with os.scandir(folder) as entries:
        for entry in entries:
            match = _TEMPORARY.fullmatch(entry.name)
            if match and names.fullmatch(match["name"]) and entry.is_file(follow_symlinks=False):
                Path(entry.path).unlink()


def _sync(path: Path) -> None:
    """Flush a file, or the entries of a folder, to disk."""
    if path.is_dir() and os.name == "nt":
        return  # Windows cannot open folders, and renaming is durable there
    descriptor = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
