"""JSON files with a schema version and a checksum, to detect damage."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from opfmodel.data.files import read_text
from opfmodel.errors import ResultError

__all__ = ["sealed", "unsealed"]

_SCHEMA = 1  # of the files of a study; increase it to reject older files


def sealed(content: Mapping[str, Any]) -> str:
    """Return the text of a file: the content, ``schema`` and ``checksum``.

    The checksum is the SHA-256 of everything else as JSON with sorted keys and without spaces.
    """
    plain = json.loads(json.dumps({"schema": _SCHEMA, **content}, default=str))
    return json.dumps({**plain, "checksum": _checksum(plain)}, indent=1) + "\n"


def unsealed(path: Path) -> dict[str, Any]:
    """Return the content of such a file.

    Raises
    ------
    ResultError
        The file cannot be read, is not a JSON object, has another schema version, or does not match
        its checksum.
    """
    try:
        content = json.loads(read_text(path, ResultError))
    except (ValueError, RecursionError) as error:
        raise ResultError(f"{path}: not JSON: {error}") from error
    if not isinstance(content, dict) or content.get("schema") != _SCHEMA:
        raise ResultError(f"{path}: not of schema version {_SCHEMA}")
    if content.pop("checksum", None) != _checksum(content):
        raise ResultError(f"{path}: the checksum does not match the content")
    del content["schema"]
    return content


def _checksum(content: Mapping[str, Any]) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode("ascii")).hexdigest()
