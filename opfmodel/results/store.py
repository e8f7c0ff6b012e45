"""Files of a run: written atomically, and verified when read."""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from opfmodel.data.files import check_file, read_text
from opfmodel.errors import ResultError

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["finite", "load", "remove_temporaries", "replace", "save"]

_DATA, _SUMMARY = "trajectories.nc", "summary.json"
_DIGEST = "trajectories_sha256"
_TEMPORARY = re.compile(r"\.(?P<name>.+)\.[0-9]+")  # name used by replace, with a process id


def save(data: xr.Dataset, summary: Mapping[str, object], folder: Path) -> dict[str, object]:
    """Write ``trajectories.nc`` (NetCDF 4) and ``summary.json`` to a folder, creating it if necessary.

    Each file is written under a temporary name and then renamed, so files are never incomplete.

    Returns
    -------
    dict
        Summary with the SHA-256 of the trajectories, which :func:`load` uses to detect damage.

    Raises
    ------
    ResultError
        The folder cannot be created or written.
    """
    saved = dict(summary)

    def write(path: Path) -> None:
        data.to_netcdf(path, engine="h5netcdf")
        saved[_DIGEST] = _digest(path)
        (folder / _SUMMARY).unlink(missing_ok=True)  # it describes the trajectories being replaced

    try:
        folder.mkdir(parents=True, exist_ok=True)
        replace(folder / _DATA, write)
        text = json.dumps(finite(saved), indent=2, allow_nan=False) + "\n"
        replace(folder / _SUMMARY, lambda path: path.write_text(text, encoding="utf-8"))
    except OSError as error:
        raise ResultError(f"{folder}: results cannot be written: {error.strerror or error}") from error
    return saved


def finite(value: Any) -> Any:
    """Replace infinity and NaN, which JSON cannot represent, with None."""
    if isinstance(value, Mapping):
        return {key: finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def load(folder: str | Path) -> xr.Dataset:
    """Read the trajectories of a saved run, from its folder or from a NetCDF file.

    Raises
    ------
    ResultError
        The file does not exist, does not match the checksum in its summary, or is not a result of
        opfmodel.
    """
    import h5py
    import xarray as xr

    path = Path(folder)
    path = path / _DATA if os.path.isdir(path) else path  # noqa: PTH112 - any text
    if not os.path.lexists(path):
        raise ResultError(f"{path}: no such file; 'opfmodel run' creates it")
    check_file(path, ResultError, most_bytes=sys.maxsize)
    _check_digest(path)
    try:
        with h5py.File(path, "r") as file:  # h5netcdf prints a traceback for files that are not HDF5
            dict(file.attrs)
        data = xr.load_dataset(path, engine="h5netcdf")
    except (OSError, ValueError, KeyError, RuntimeError, MemoryError) as error:
        raise ResultError(f"{path}: not a result of opfmodel: {' '.join(str(error).split())}") from error
    lacking = [name for name in ("time", "bus", "pd", "qd") if name not in data.variables]
    if lacking:
        raise ResultError(f"{path}: not a result of opfmodel: {lacking[0]!r} is missing")
    return data


def _check_digest(path: Path) -> None:
    """Raise :class:`ResultError` unless the trajectories match the checksum in their summary.

    Without this check, the NetCDF libraries may hang on a damaged file.
    """
    summary = path.with_name(_SUMMARY)
    if path.name != _DATA or not summary.exists():
        return
    try:
        known = json.loads(read_text(summary, ResultError))
    except (ValueError, RecursionError) as error:
        raise ResultError(f"{summary}: not JSON: {error}") from error
    saved = known.get(_DIGEST) if isinstance(known, dict) else None
    if saved is not None and saved != _digest(path):
        raise ResultError(f"{path}: the checksum differs from that in {_SUMMARY}; repeat the run")


def _digest(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def replace(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file under a temporary name, flush it to disk, and rename it.

    Parameters
    ----------
    write
        Function that writes to the given path, which does not exist.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        temporary.unlink(missing_ok=True)  # left by a killed process with the same id, or a link
        write(temporary)
        _sync(temporary)
        temporary.replace(path)
        _sync(path.parent)
    finally:
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
