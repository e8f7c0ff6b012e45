"""Mutations inside binary files: HDF5, Parquet and ZIP archives, of which Excel files are made."""

from __future__ import annotations

import gzip
import io
import random
import re
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from .values import KEYS, WORDS

__all__ = ["FAMILIES", "OPERATORS", "compressed"]

Operator = Callable[[random.Random, bytes], bytes]


def compressed(content: bytes) -> bytes:
    """Compress a file; the result is determined by the content."""
    return gzip.compress(content, mtime=0)


# HDF5 -------------------------------------------------------------------------------------------

_ARRAYS: Sequence[Callable[[np.ndarray], object]] = (
    lambda old: np.full(old.shape, np.nan),
    lambda old: np.full(old.shape, np.inf),
    lambda old: np.full(old.shape, 1e308),
    lambda old: np.zeros(old.shape, dtype=np.int8),
    lambda old: np.full(old.shape, -(2**63)),
    lambda old: np.full(old.shape, 1 + 1j),
    lambda old: np.full(old.shape, b"\xff\xfe"),
    lambda old: np.zeros(old.shape, dtype=[("a", "i4"), ("b", "f8")]),
    lambda old: old[:0],
    lambda old: old[:-1],
    lambda old: np.concatenate([old, old]),
    lambda old: old[..., None],
    lambda old: old.reshape(-1),
    lambda old: old.T,
    lambda old: np.zeros((1,) * 32),
    lambda old: 3.0,
    lambda old: "text",
)
_ATTRIBUTES: Sequence[object] = (
    *("", "x", "x" * 5000, "days since 0000-00-00", "hours since 2019-07-22", "\x1b[31m", "nan", "UTC", "../x", "Europe/Nowhere"),
    *(0, -1, 1e308, float("nan"), float("inf"), 2**62, np.zeros(3), np.zeros((2, 2)), np.int8(3), b"\xff", True),
)  # fmt: skip
_NAMES = ("units", "scenario", "step_hours", "zone", "currency", "calendar", "_FillValue", "scale_factor", "coordinates", "dtype", "DIMENSION_LIST", "_Netcdf4Dimid", "CLASS", "NAME")  # fmt: skip


def _hdf5(rng: random.Random, content: bytes) -> bytes:
    """Change one variable or attribute of a NetCDF file."""
    import h5py

    if not content.startswith(b"\x89HDF"):
        return content
    stream = io.BytesIO(content)
    try:
        with h5py.File(stream, "r+") as file:
            _change_hdf5(rng, file)
    except (OSError, ValueError, KeyError, RuntimeError, TypeError):  # already damaged, or not possible
        return content
    return stream.getvalue()


def _change_hdf5(rng: random.Random, file: object) -> None:
    import h5py

    names = sorted(name for name in file if isinstance(file[name], h5py.Dataset))
    name, other, sort = rng.choice(names), rng.choice(names), rng.randrange(7)
    if sort == 0:
        del file[name]
    elif sort == 1:
        file.move(name, rng.choice([k for k in KEYS if k.strip("./ ") and "\0" not in k]))
    elif sort == 2:
        del file[name]
        file.create_group(name)
    elif sort == 3 and name != other:
        first, second = file[name][()], file[other][()]
        del file[name], file[other]
        file[name], file[other] = second, first
    elif sort == 4:
        array = rng.choice(_ARRAYS)(np.atleast_1d(file[name][()]))
        attributes = {
            k: v for k, v in file[name].attrs.items() if k not in ("DIMENSION_LIST", "REFERENCE_LIST")
        }
        del file[name]
        file[name] = array
        file[name].attrs.update(attributes)
    else:
        target = file if sort == 5 else file[name]
        attribute = rng.choice([*_NAMES, *target.attrs])
        if rng.random() < 0.2 and attribute in target.attrs:
            del target.attrs[attribute]
        else:
            target.attrs[attribute] = rng.choice(_ATTRIBUTES)


# Parquet ----------------------------------------------------------------------------------------


def _parquet(rng: random.Random, content: bytes) -> bytes:
    """Change one column of a Parquet file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(io.BytesIO(content))
        place = rng.randrange(table.num_columns)
        name, column = table.column_names[place], table.column(place)
        sort = rng.randrange(6)
        if sort == 0:
            table = table.remove_column(place)
        elif sort == 1:
            table = table.append_column(rng.choice((*KEYS, name)), column)
        elif sort == 2:
            table = table.rename_columns(
                [rng.choice((*KEYS, *WORDS)) if n == name else n for n in table.column_names]
            )
        elif sort == 3:
            length = len(column)
            odd: Sequence[object] = (
                pa.nulls(length),
                pa.array([None, *[1.5] * (length - 1)]),
                pa.array([float("nan")] * length),
                pa.array([rng.choice(WORDS).encode("utf-8", "replace").decode() for _ in range(length)]),
                pa.array([[1, 2]] * length),
                pa.array([{"a": 1}] * length),
                pa.array([2**63 - 1] * length, pa.int64()),
                pa.array([rng.randrange(-(2**62), 2**62) for _ in range(length)], pa.timestamp("us")),
                pa.array([0] * length, pa.timestamp("ns", "Europe/Berlin")),
                pa.array([True] * length),
                pa.array([b"\xff"] * length),
                pa.array([1] * length, pa.decimal128(38, 10)),
            )
            table = table.set_column(place, name, rng.choice(odd))
        elif sort == 4:
            table = table.slice(rng.randrange(len(column)))
        else:
            table = table.take(pa.array(rng.sample(range(len(column)), len(column))))
        stream = io.BytesIO()
        pq.write_table(table, stream)
    except (pa.ArrowException, OSError, ValueError, TypeError, OverflowError):
        return content
    return stream.getvalue()


# ZIP --------------------------------------------------------------------------------------------

_CELL = re.compile(rb"(?<=>)[^<>]+(?=<)|(?<=\")[^\"<>]+(?=\")")


def _zip(rng: random.Random, content: bytes) -> bytes:
    """Change a word in a member of an archive, remove the member or blow it up."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
    except (zipfile.BadZipFile, OSError, ValueError, zlib.error, NotImplementedError, RuntimeError, EOFError):
        return content
    name = rng.choice([*members, *(n for n in members if "sheet" in n)])
    sort = rng.randrange(8)
    if sort == 0:
        del members[name]
    elif sort == 1:
        members[name] = b" " * 50_000_000 if rng.random() < 0.2 else b""
    else:
        words = list(_CELL.finditer(members[name]))
        if words:
            old = rng.choice(words)
            odd = rng.choice((rng.choice(WORDS).encode("utf-8", "replace"), rng.choice(words)[0]))
            members[name] = members[name][: old.start()] + odd + members[name][old.end() :]
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for member, data in members.items():
            archive.writestr(zipfile.ZipInfo(member), data, zipfile.ZIP_DEFLATED)
    return stream.getvalue()


OPERATORS: dict[str, Operator] = {"hdf5": _hdf5, "parquet": _parquet, "zip": _zip}
FAMILIES: Mapping[str, Sequence[str]] = {name: (name,) for name in OPERATORS}
