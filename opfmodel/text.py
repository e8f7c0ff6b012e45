"""Text for people: nothing in it that a terminal would obey or hide."""

from __future__ import annotations

import unicodedata

__all__ = ["name_fault", "shown", "visible"]

# control and format characters, lone surrogates, line and paragraph separators
_UNSEEN = ("Cc", "Cf", "Cs", "Zl", "Zp")
_LONGEST = 200


def visible(text: str) -> str:
    r"""The text with escapes, as ``repr`` writes them, for whatever cannot be printed.

    Everything that the command line prints passes here, for names and values come from files.

    Examples
    --------
    >>> print(visible("a\x1b[31mb"))
    a\x1b[31mb
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def name_fault(name: str) -> str:
    r"""What is wrong with a name: a character that cannot be seen; empty for a name that can be read.

    Examples
    --------
    >>> name_fault("a\tb")
    "has the character '\\t'; names have visible characters only"
    >>> name_fault("Würzburg 2")
    ''
    """
    if not name.isprintable():
        for character in name:
            if unicodedata.category(character) in _UNSEEN:
                return f"has the character {character!a}; names have visible characters only"
    return ""


def shown(value: object) -> str:
    """A value as messages show it: its ``repr``, cut where it is long."""
    text = repr(value)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."
