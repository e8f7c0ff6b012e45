"""The files of a run: written whole or not at all, and read with suspicion."""

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
_TEMPORARY = re.compile(r"\.(?P<name>.+)\.[0-9]+")  # as replace names a file, with a number of a process


def save(data: xr.Dataset, summary: Mapping[str, object], folder: Path) -> dict[str, object]:
    """Write ``trajectories.nc`` (NetCDF 4) and ``summary.json`` into a folder, which is made if need be.

    Each file is written under a temporary name and renamed, so that none is ever half there.

    Returns
    -------
    dict
        The summary with the SHA-256 of the trajectories, by which :func:`load` notices damage.

    Raises
    ------
    ResultError
        The folder cannot be made or written.
    """
    saved = dict(summary)

    def write(path: Path) -> None:
        data.to_netcdf(path, engine="h5netcdf")
        saved[_DIGEST] = _digest(path)
        (folder / _SUMMARY).unlink(missing_ok=True)  # it is about the trajectories that are now replaced

    try:
        folder.mkdir(parents=True, exist_ok=True)
        replace(folder / _DATA, write)
        text = json.dumps(finite(saved), indent=2, allow_nan=False) + "\n"
        replace(folder / _SUMMARY, lambda path: path.write_text(text, encoding="utf-8"))
    except OSError as error:
        raise ResultError(f"{folder}: results cannot be written: {error.strerror or error}") from error
    return saved


def finite(value: Any) -> Any:
    """Plain data as JSON can have it, which knows no infinity and no nan: these become None."""
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
        There is no such file, it is not what was saved with the summary beside it, or it is no
        result of a run.
    """
    import h5py
    import xarray as xr

    path = Path(folder)
    path = path / _DATA if os.path.isdir(path) else path  # noqa: PTH112 - any text
    if not os.path.lexists(path):
        raise ResultError(f"{path}: there is no such file; 'opfmodel run' writes it")
    check_file(path, ResultError, most_bytes=sys.maxsize)
    _check_digest(path)
    try:
        with h5py.File(path, "r") as file:  # h5netcdf prints a traceback for what is no HDF5 file
            dict(file.attrs)
        data = xr.load_dataset(path, engine="h5netcdf")
    except (OSError, ValueError, KeyError, RuntimeError, MemoryError) as error:
        raise ResultError(f"{path}: not a result of opfmodel: {' '.join(str(error).split())}") from error
    lacking = [name for name in ("time", "bus", "pd", "qd") if name not in data.variables]
    if lacking:
        raise ResultError(f"{path}: not a result of opfmodel: it has no {lacking[0]!r}")
    return data


def _check_digest(path: Path) -> None:
    """Raise :class:`ResultError` for trajectories that are not those of the summary beside them.

    The libraries that read a damaged file may do so for ever.
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
        raise ResultError(f"{path}: not what was saved with {_SUMMARY}: the checksums differ; run again")


def _digest(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def replace(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file under a temporary name, flush it to disk, and rename it.

    Parameters
    ----------
    write
        Writes to the path that it is given, which does not exist.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        temporary.unlink(missing_ok=True)  # of a killed process of the same number, or somebody's link
        write(temporary)
        _sync(temporary)
        temporary.replace(path)
        _sync(path.parent)
    finally:
        temporary.unlink(missing_ok=True)


def remove_temporaries(folder: Path, names: re.Pattern[str]) -> None:
    """Delete what killed processes were writing by :func:`replace` into a folder that is this process' alone.

    Parameters
    ----------
    names
        The files that are written there; only regular files with the temporary name of such a file
        are deleted.
    """
    with os.scandir(folder) as entries:
        for entry in entries:
            match = _TEMPORARY.fullmatch(entry.name)
            if match and names.fullmatch(match["name"]) and entry.is_file(follow_symlinks=False):
                Path(entry.path).unlink()


def _sync(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    if path.is_dir() and os.name == "nt":
        return  # a folder cannot be opened there, and a renamed file is safe
    descriptor = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
