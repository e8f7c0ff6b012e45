"""Files of a run: written atomically, and verified when read."""

from __future__ import annotations

import hashlib
import io
import json
import math
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any

from opfmodel.data.files import check_file, read_text
from opfmodel.data.writing import replace
from opfmodel.errors import ResultError
from opfmodel.results.figures import figure_paths
from opfmodel.results.validity import check_trajectories

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "REPORT",
    "Files",
    "check_writable",
    "digest",
    "finite",
    "load",
    "make_folder",
    "netcdf",
    "packed",
    "read_summary",
    "save",
    "unpack",
    "write_file",
    "write_record",
]

Files = Mapping[str, bytes]

REPORT = "report.html"
"""Name of the report in the folder of a run or a study."""

_DATA, _SUMMARY = "trajectories.nc", "summary.json"
_DIGEST = "trajectories_sha256"

# What the NetCDF libraries raise for damaged files.
_DAMAGE = (
    OSError,
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    ArithmeticError,
    RuntimeError,
    MemoryError,
)


def save(data: xr.Dataset | None, summary: Mapping[str, object], folder: Path) -> dict[str, object]:
    """Write ``trajectories.nc`` (NetCDF 4) and ``summary.json`` to a folder, creating it if necessary.

    Afterwards, the folder describes this run only: figures and the report of an earlier run are deleted,
    and so are its trajectories if this run has none. Files are never incomplete; on a full disk, those of
    the earlier run are kept.

    Parameters
    ----------
    data
        Trajectories; None for a run without a completed step.

    Returns
    -------
    dict
        Summary with the SHA-256 of the trajectories, which :func:`load` uses to detect damage.

    Raises
    ------
    ResultError
        The folder cannot be created or written.
    """
    files, saved = packed(data, summary)
    try:
        unpack(files, folder)
    except OSError as error:
        raise ResultError(f"{folder}: results cannot be written: {error.strerror or error}") from error
    return saved


def packed(data: xr.Dataset | None, summary: Mapping[str, object]) -> tuple[Files, dict[str, object]]:
    """Return the files that :func:`save` writes, by name, and the summary with its checksum."""
    saved, files = dict(summary), {}
    if data is not None:
        files[_DATA] = netcdf(data)
        saved[_DIGEST] = hashlib.sha256(files[_DATA]).hexdigest()
    files[_SUMMARY] = (json.dumps(finite(saved), indent=2, allow_nan=False) + "\n").encode()
    return files, saved


def unpack(files: Files, folder: Path) -> None:
    """Write the files of a run to a folder; without any, those of an earlier run are deleted.

    Raises
    ------
    OSError
        The folder cannot be created or written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    # the summary goes first and comes last: a process that is killed leaves none rather than a wrong one
    obsolete = [folder / _SUMMARY, folder / _DATA, folder / REPORT, *figure_paths(folder)]
    replace({folder / name: content for name, content in files.items()}, obsolete)


def digest(folder: Path) -> str | None:
    """Return the SHA-256 of the trajectories in a folder; None if there are none that can be read."""
    path = folder / _DATA
    try:
        check_file(path, ResultError, most_bytes=sys.maxsize)
        return _digest(path)
    except (ResultError, OSError):
        return None


def make_folder(folder: Path) -> None:
    """Create a folder for results, unless it exists.

    Raises
    ------
    ResultError
        It cannot be created.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ResultError(f"{folder}: cannot be created: {error.strerror or error}") from error


def check_writable(folder: Path) -> None:
    """Create a folder for results, unless it exists, and write a file there for a moment.

    Raises
    ------
    ResultError
        It cannot be created or written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=folder) as file:
            file.write(b"0")
    except OSError as error:
        raise ResultError(f"{folder}: results cannot be written: {error.strerror or error}") from error


def read_summary(folder: Path) -> dict[str, Any] | None:
    """Return the summary of the run in a folder; None if there is none.

    Raises
    ------
    ResultError
        The file is damaged.
    """
    return _summary(folder / _DATA)


def write_record(record: Mapping[str, object], path: Path) -> None:
    """Write a record as a JSON file, as :func:`write_file` does."""
    write_file(path, (json.dumps(finite(record), indent=2, allow_nan=False) + "\n").encode())


def write_file(path: Path, content: bytes) -> Path:
    """Write a file, atomically; its folder is created if necessary.

    Raises
    ------
    ResultError
        The file cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        replace({path: content})
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        reason = getattr(error, "strerror", None) or error
        raise ResultError(f"{path}: cannot be written: {reason}") from error
    return path


def netcdf(data: xr.Dataset) -> bytes:
    """Return a dataset as a NetCDF file, made in memory: HDF5 crashes if the disk is full."""
    stream = io.BytesIO()
    data.to_netcdf(stream, engine="h5netcdf")
    return stream.getvalue()


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
        summary = _summary(path)
        stepless = summary is not None and _DIGEST not in summary
        reason = "the run in this folder completed no step" if stepless else "'opfmodel run' creates it"
        raise ResultError(f"{path}: no such file; {reason}")
    check_file(path, ResultError, most_bytes=sys.maxsize)
    _check_digest(path)
    if not h5py.is_hdf5(path):  # h5netcdf prints a traceback for such files
        raise ResultError(f"{path}: not a result of opfmodel: is not a NetCDF 4 file")
    try:
        with h5py.File(path, "r") as file:
            dict(file.attrs)
        data = xr.load_dataset(path, engine="h5netcdf")
    except _DAMAGE as error:
        raise ResultError(f"{path}: not a result of opfmodel: the NetCDF file is damaged") from error
    try:
        check_trajectories(data)
    except ResultError as error:
        raise ResultError(f"{path}: not a result of opfmodel: {error}") from error
    return data


def _check_digest(path: Path) -> None:
    """Raise :class:`ResultError` unless the trajectories match the checksum in their summary.

    Without this check, the NetCDF libraries may hang on a damaged file.
    """
    saved = (_summary(path) or {}).get(_DIGEST)
    if saved is not None and saved != _digest(path):
        raise ResultError(f"{path}: the checksum differs from that in {_SUMMARY}; repeat the run")


def _summary(path: Path) -> dict[str, Any] | None:
    """Return the summary beside trajectories; None if there is none, as for files of another name."""
    file = path.with_name(_SUMMARY)
    if path.name != _DATA or not file.exists():
        return None
    try:
        known = json.loads(read_text(file, ResultError))
    except (ValueError, RecursionError) as error:
        raise ResultError(f"{file}: not JSON: {error}") from error
    return known if isinstance(known, dict) else None


def _digest(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
