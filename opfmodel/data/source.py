"""Texts that a user wrote, as cited by errors: a file, or an option of the command line."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

from opfmodel.errors import Fault, visible

__all__ = ["Source"]

_WIDTH = 100  # columns of an excerpt
_MARGIN = 30  # columns shown before the caret in a line that is too long
_BREAKS = re.compile("\r\n|[\r\n\x85\u2028\u2029]")  # the line breaks of YAML


@dataclass(frozen=True)
class Source:
    """A text and its name.

    Attributes
    ----------
    name
        Path of the file, or what else messages begin with.
    before
        What the user wrote before the text, on its first line.
    is_file
        Whether messages give line and column.
    """

    name: str
    text: str = field(default="", repr=False)
    before: str = field(default="", repr=False)
    is_file: bool = True

    def fault(
        self,
        line: int,
        column: int,
        message: str,
        key: Sequence[str | int] = (),
        cause: Exception | None = None,
    ) -> Fault:
        """Return a fault at a position, numbered from 1."""
        at = (line, column) if self.is_file else (None, None)
        return Fault(message, self.name, at[0], at[1], tuple(key), self.excerpt(line, column), cause)

    def excerpt(self, line: int, column: int) -> str:
        r"""Return a line of the text and, below it, a caret at a column.

        A long line is cut around the column. Tabs are four columns wide, and characters that cannot be
        printed are escaped.

        Examples
        --------
        >>> print(Source("s.yaml", "time:\n\tstep: 1").excerpt(2, 2))
            2 |     step: 1
              |     ^
        """
        text, at = self.line(line), column - 1
        if line == 1:
            text, at = self.before + text, len(self.before) + at
        if not text.strip():
            return ""
        shown, offset = _cut(text, at)
        gutter = f"{line:>5} | " if self.is_file else "  "
        below = f"{'':>5} | " if self.is_file else "  "
        return f"{gutter}{shown}\n{below}{' ' * offset}^"

    def line(self, number: int) -> str:
        """Return a line by its number, from 1; empty behind the end."""
        return self._lines[number - 1] if 0 < number <= len(self._lines) else ""

    @cached_property
    def _lines(self) -> list[str]:
        return _BREAKS.split(self.text)


def _printed(character: str) -> str:
    """Return what an excerpt shows for a character."""
    return "    " if character == "\t" else visible(character)


def _width(text: str) -> int:
    """Columns that a text occupies in a terminal."""
    return sum(
        0 if unicodedata.combining(c) else 2 if unicodedata.east_asian_width(c) in "WF" else 1 for c in text
    )


def _cut(text: str, at: int) -> tuple[str, int]:
    """Return a part of a line that fits the width, and the column of a character in it."""
    first = 0 if _width("".join(map(_printed, text[: _WIDTH + 1]))) <= _WIDTH else max(at - _MARGIN, 0)
    cells = [_printed(character) for character in text[first : first + _WIDTH + 1]]
    while sum(map(_width, cells)) > _WIDTH:
        cells.pop()
    dots = "..." if first else ""
    shown = dots + "".join(cells) + ("..." if first + len(cells) < len(text) else "")
    return shown.rstrip(), len(dots) + sum(map(_width, cells[: at - first]))
