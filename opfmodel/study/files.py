"""The files that the content of a scenario names."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from opfmodel.scenario.document import Document

__all__ = ["check_relative", "named_files"]

Key = tuple[str | int, ...]


def named_files(document: Document, content: Mapping[str, Any]) -> list[Path]:
    """Return every file named by a text in the content of a scenario.

    Raises
    ------
    ScenarioError
        As for :func:`check_relative`.
    """
    check_relative(document, content)
    return [path for _, text in _texts(content) for path in _found(document, text)]


def check_relative(document: Document, content: Mapping[str, Any]) -> None:
    """Raise :class:`ScenarioError` for a file with an absolute path: studies copy their files."""
    for key, text in _texts(content):
        if os.path.isabs(text) and _found(document, text):  # noqa: PTH117 - any text
            raise document.error(
                key, f"{text!r}: must be relative to the scenario's folder; studies copy their files"
            )


def _texts(content: Any, key: Key = ()) -> Iterator[tuple[Key, str]]:
    """Yield all texts in nested mappings and lists, with their path of keys."""
    if isinstance(content, str):
        yield key, content
    elif isinstance(content, Mapping):
        for part, value in content.items():
            yield from _texts(value, (*key, part))
    elif isinstance(content, list):
        for place, value in enumerate(content):
            yield from _texts(value, (*key, place))


def _found(document: Document, text: str) -> list[Path]:
    """Return the file of this name, or the tables of a network that is a folder of CSV files."""
    named = document.path.parent / text
    if os.path.isfile(named):  # noqa: PTH113 - any text
        return [named]
    return sorted(named.glob("*.csv")) if os.path.isdir(named) else []  # noqa: PTH112 - any text
