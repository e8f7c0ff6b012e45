"""Plain data with arrays in one file: NumPy's ``.npz`` with two arrays, which holds no code.

``content`` is JSON, in which ``{"$array": [type, shape, begin]}`` stands for an array, and ``numbers`` are
the bytes of all arrays. The format has a checksum of both, so that damage is found when a file is read.
"""

from __future__ import annotations

import io
import json
import math
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.data.files import check_file
from opfmodel.errors import ResultError

__all__ = ["packed", "unpacked"]

_ARRAY = "$array"
_KINDS = "biuf"  # Booleans and numbers
_MOST_BYTES = 2**40
_DAMAGE = (
    OSError,
    EOFError,
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    ArithmeticError,
    RecursionError,
    NotImplementedError,
    RuntimeError,
    MemoryError,
    zipfile.BadZipFile,
)


def packed(content: Mapping[str, Any]) -> bytes:
    """Return nested mappings, sequences, numbers, texts and arrays as the bytes of a file.

    Sequences are read back as lists. Numbers, with infinity and NaN, are read back exactly.

    Examples
    --------
    >>> packed({"e": np.array([1.5, np.nan])})[:2]
    b'PK'
    """
    arrays: list[bytes] = []
    begin = 0

    def plain(value: Any) -> Any:
        nonlocal begin
        if isinstance(value, np.ndarray):
            if value.dtype.kind not in _KINDS:
                raise TypeError(f"arrays of {value.dtype} cannot be stored")
            arrays.append(np.ascontiguousarray(value).tobytes())
            at, begin = begin, begin + len(arrays[-1])
            return {_ARRAY: [value.dtype.str, list(value.shape), at]}
        if isinstance(value, np.generic):
            return value.item()
        if isinstance(value, Mapping):
            if not all(isinstance(key, str) and key != _ARRAY for key in value):
                raise TypeError(f"keys must be texts, not {list(value)!r}")
            return {key: plain(entry) for key, entry in value.items()}
        if isinstance(value, list | tuple):
            return [plain(entry) for entry in value]
        if value is None or isinstance(value, bool | int | float | str):
            return value
        raise TypeError(f"a {type(value).__name__} cannot be stored")

    text = json.dumps(plain(content)).encode()
    stream = io.BytesIO()
    parts = {"content": text, "numbers": b"".join(arrays)}
    np.savez(stream, **{name: np.frombuffer(part, np.uint8) for name, part in parts.items()})  # type: ignore[arg-type]
    return stream.getvalue()


def unpacked(path: Path, what: str) -> dict[str, Any]:
    """Return the content of a file that :func:`packed` made.

    Parameters
    ----------
    what
        What the file is, for messages.

    Raises
    ------
    ResultError
        The file cannot be read, or is damaged.
    """
    check_file(path, ResultError, most_bytes=_MOST_BYTES)
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as file:
            text, numbers = file["content"].tobytes(), file["numbers"]
        content = _with_arrays(json.loads(text), numbers)
    except _DAMAGE as error:
        raise ResultError(f"{path}: not {what} of opfmodel, or damaged: {_reason(error)}") from error
    if not isinstance(content, dict):
        raise ResultError(f"{path}: not {what} of opfmodel")
    return content


def _with_arrays(value: Any, numbers: npt.NDArray[np.uint8]) -> Any:
    if isinstance(value, list):
        return [_with_arrays(entry, numbers) for entry in value]
    if not isinstance(value, dict):
        return value
    if value.keys() != {_ARRAY}:
        return {key: _with_arrays(entry, numbers) for key, entry in value.items()}
    kind, shape, begin = value[_ARRAY]
    dtype = np.dtype(kind)
    if dtype.kind not in _KINDS:
        raise TypeError(f"an array of {kind!r}")
    end = begin + dtype.itemsize * math.prod(shape)
    return numbers[begin:end].view(dtype).reshape(shape).copy()


def _reason(error: Exception) -> str:
    return str(error).partition("\n")[0] or type(error).__name__
