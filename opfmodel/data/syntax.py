"""What is wrong with a text that is not YAML, in words, and where."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from opfmodel.data.source import Source
from opfmodel.errors import Fault, shown

__all__ = ["SPACELESS", "syntax_fault"]

# A key whose colon is followed by its value without a space, after the marks of list items.
SPACELESS = re.compile(r"\s*(?:- +)*([A-Za-z_][\w.*-]*:)([^\s:/,\]}][^\s,\]}]*)")
Explained = tuple[str, tuple[int, int]]  # what is wrong, and its position
_CLOSING = {"[": "]", "{": "}"}
_SPACES = "keys of one mapping begin in the same column"


def syntax_fault(error: Any, source: Source) -> Fault:
    """Return the fault for an error of the parser.

    Parameters
    ----------
    error
        A ``yaml.MarkedYAMLError``, which has a position, and may have that of the item it is about.
    """
    at, begin = error.problem_mark, error.context_mark or error.problem_mark
    mark = _Mark(source, at.line, at.column)
    said = f"{error.context or ''}: {error.problem}"
    explain = next((explain for pattern, explain in _EXPLANATIONS if re.search(pattern, said)), None)
    explained = explain(mark, _Mark(source, begin.line, begin.column)) if explain else None
    message, (line, column) = explained or (str(error.problem), mark.place)
    return source.fault(line + 1, column + 1, f"not YAML: {message}")


class _Mark:
    """A position in the text, counted from 0."""

    def __init__(self, source: Source, line: int, column: int) -> None:
        self.line = line
        self.column = column
        self.source = source
        self.text = source.line(line + 1)
        self.before = self.text[:column]
        self.character = self.text[column : column + 1]

    @property
    def place(self) -> tuple[int, int]:
        """Line and column."""
        return self.line, self.column

    @property
    def indented(self) -> tuple[int, int]:
        """Position of the first character of the line."""
        return self.line, len(self.text) - len(self.text.lstrip())


def _start(mark: _Mark, _: _Mark) -> Explained:
    """Explain a character that begins nothing."""
    if mark.character == "\t":
        return "a tab indents this line; indent with spaces", mark.place
    return f"a value cannot begin with {shown(mark.character)}; put it in quotes", mark.place


def _escape(mark: _Mark, _: _Mark) -> Explained:
    """Explain a backslash in double quotes."""
    character = shown(mark.text[mark.column + 1 : mark.column + 2])
    return f"a backslash with {character} has no meaning; write \\\\ or single quotes", mark.place


def _second_colon(mark: _Mark, _: _Mark) -> Explained:
    """Explain a ``: `` that is not accepted: in a value, or behind a value of the lines above."""
    if re.search(r":\s", mark.before):
        return "a second ': ' on one line; put the value in quotes or on a line of its own", mark.place
    for line in range(mark.line - 1, -1, -1):
        above = mark.source.line(line + 1)
        if match := SPACELESS.match(above):
            return f"a space is missing after the colon in {shown(match[1] + match[2])}", (
                line,
                match.start(2),
            )
        if re.search(r":\s", above):
            break
    return (
        "this line is indented further than the one above, which has a value already; " + _SPACES,
        mark.indented,
    )


def _unclosed(mark: _Mark, begin: _Mark) -> Explained:
    """Explain a bracket that is not closed, or a comma that is missing in it."""
    opening = begin.character
    closing = _CLOSING.get(opening, "")
    if mark.line == begin.line and mark.character:
        return f"expected ',' or {closing!r}; the {opening!r} is in column {begin.column + 1}", mark.place
    where = f"in line {mark.line + 1} without a ',' before it" if mark.text.strip() else "to the end"
    return f"the {opening!r} opened here is not closed by {closing!r}; it continues {where}", begin.place


def _no_item(mark: _Mark, begin: _Mark) -> Explained:
    """Explain text where an item of a list is expected."""
    if not mark.before.strip():
        return "expected an item '- ' as in the lines above, or another indentation", mark.place
    return _misplaced(mark, begin)


def _misplaced(mark: _Mark, _: _Mark) -> Explained:
    """Explain text where a key is expected."""
    before = mark.before.rstrip()
    if not before and mark.text[mark.column :].startswith("- "):
        return f"an item '- ' where a key is expected; {_SPACES}", mark.place
    if not before:
        return f"this line begins in another column than the lines it belongs to; {_SPACES}", mark.place
    if before[-1] in "'\"":
        return "text behind a closing quotation mark; a quotation mark inside quotes is doubled", mark.place
    if mark.character in ("]", "}"):
        return f"{mark.character!r} closes no bracket", mark.place
    return f"{shown(mark.text[mark.column :].rstrip())}: expected the end of the line", mark.place


def _at_mark(message: str) -> Callable[[_Mark, _Mark], Explained]:
    """Return an explanation that blames the position itself."""
    return lambda mark, _: (message.format(shown(mark.character)), mark.place)


def _at_begin(message: str) -> Callable[[_Mark, _Mark], Explained]:
    """Return an explanation that blames the beginning of the item."""
    return lambda _, begin: (message.format(shown(begin.character)), begin.place)


# By what the parser says, with its context in front; the first that matches applies.
_EXPLANATIONS = (
    ("tab character", _at_mark("a tab indents this line; indent with spaces")),
    ("cannot start any token", _start),
    ("mapping values are not allowed", _second_colon),
    ("sequence entries are not allowed", _at_mark("an item '- ' begins behind other text; begin a line")),
    ("flow .*expected ','", _unclosed),
    ("quoted scalar: .*unexpected", _at_begin("the quotation mark opened here is not closed")),
    ("unknown escape", _escape),
    ("could not find expected ':'", _at_begin("a key without ': ' and a value")),
    ("scanning an (alias|anchor)", _at_begin("{} is not followed by a name; put text in quotes")),
    ("block scalar", _at_begin("{} begins text on the lines below; put text of one line in quotes")),
    ("directive", _at_begin("a line that begins with '%' is a directive; put text in quotes")),
    ("expected node content", _at_mark("a value cannot begin with {}")),
    ("'-' indicator", _no_item),
    ("expected key|document start", _misplaced),
)  # fmt: skip
