"""What is wrong with a text that is not YAML, in words, and where."""

from __future__ import annotations

import re
from typing import Any

from opfmodel.data.source import Source
from opfmodel.errors import Fault, shown

__all__ = ["SPACELESS", "syntax_fault"]

# A key whose colon is followed by its value without a space, after the marks of list items.
SPACELESS = re.compile(r"\s*(?:- +)*([A-Za-z_][\w.*-]*:)([^\s:/,\]}][^\s,\]}]*)")
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
    message, (line, column) = _explained(error, mark, _Mark(source, begin.line, begin.column))
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


def _explained(error: Any, mark: _Mark, begin: _Mark) -> tuple[str, tuple[int, int]]:
    """Return what is wrong, and its position."""
    problem, context = str(error.problem), str(error.context or "")
    if "tab character" in problem or ("cannot start any token" in problem and mark.character == "\t"):
        return "a tab indents this line; indent with spaces", mark.place
    if "cannot start any token" in problem:
        return f"a value cannot begin with {shown(mark.character)}; put it in quotes", mark.place
    if "mapping values are not allowed" in problem:
        return _second_colon(mark)
    if "sequence entries are not allowed" in problem:
        return "an item '- ' begins behind other text; begin it on a line of its own", mark.place
    if "flow" in context and "expected ','" in problem:
        return _unclosed(mark, begin)
    if "quoted scalar" in context and "unexpected" in problem:
        return "the quotation mark opened here is not closed", begin.place
    if "unknown escape" in problem:
        character = shown(mark.text[mark.column + 1 : mark.column + 2])
        return f"a backslash with {character} has no meaning; write \\\\ or single quotes", mark.place
    if "could not find expected ':'" in problem:
        return "a key without ': ' and a value", begin.place
    if "scanning an alias" in context or "scanning an anchor" in context:
        return f"{begin.character!r} is not followed by a name; put text in quotes", begin.place
    if "block scalar" in context:
        return f"{begin.character!r} begins text on the lines below; put text of one line in quotes", begin.place
    if "directive" in context:
        return "a line that begins with '%' is a directive; put text in quotes", begin.place
    if "expected node content" in problem:
        return f"a value cannot begin with {shown(mark.character)}", mark.place
    if "expected key" in problem or "'-' indicator" in problem or "document start" in problem:
        return _misplaced(mark, problem)
    return problem, mark.place


def _second_colon(mark: _Mark) -> tuple[str, tuple[int, int]]:
    """Explain a ``: `` that is not accepted: in a value, or behind a value of the lines above."""
    if re.search(r":\s", mark.before):
        return "a second ': ' on one line; put the value in quotes or on a line of its own", mark.place
    for line in range(mark.line - 1, -1, -1):
        above = mark.source.line(line + 1)
        if match := SPACELESS.match(above):
            return f"a space is missing after the colon in {shown(match[1] + match[2])}", (line, match.start(2))
        if re.search(r":\s", above):
            break
    return (
        "this line is indented further than the one above, which has a value already; " + _SPACES,
        mark.indented,
    )


def _unclosed(mark: _Mark, begin: _Mark) -> tuple[str, tuple[int, int]]:
    """Explain a bracket that is not closed, or a comma that is missing in it."""
    opening = begin.character
    closing = _CLOSING.get(opening, "")
    if mark.line == begin.line and mark.character:
        return f"expected ',' or {closing!r}; the {opening!r} is in column {begin.column + 1}", mark.place
    where = f"in line {mark.line + 1} without a ',' before it" if mark.text.strip() else "to the end"
    return f"the {opening!r} opened here is not closed by {closing!r}; it continues {where}", begin.place


def _misplaced(mark: _Mark, problem: str) -> tuple[str, tuple[int, int]]:
    """Explain text where a key or an item of a list is expected."""
    before = mark.before.rstrip()
    if not before and "'-' indicator" in problem:
        return "expected an item '- ' as in the lines above, or another indentation", mark.place
    if not before and mark.text[mark.column :].startswith("- "):
        return f"an item '- ' where a key is expected; {_SPACES}", mark.place
    if not before:
        return f"this line begins in another column than the lines it belongs to; {_SPACES}", mark.place
    if before[-1] in "'\"":
        return "text behind a closing quotation mark; a quotation mark inside quotes is doubled", mark.place
    if mark.character in ("]", "}"):
        return f"{mark.character!r} closes no bracket", mark.place
    return f"{shown(mark.text[mark.column :].rstrip())}: expected the end of the line", mark.place
