"""Errors and warnings that opfmodel raises, and helpers that write their messages."""

from __future__ import annotations

import difflib
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass, field
from heapq import nsmallest
from itertools import islice

__all__ = [
    "CaseError",
    "CaseWarning",
    "ComponentError",
    "ConstraintError",
    "Fault",
    "IncompatibleError",
    "ModelError",
    "NetworkError",
    "OpfmodelError",
    "PluginError",
    "ProfileError",
    "ProfileWarning",
    "QuantityError",
    "ResultError",
    "ResultWarning",
    "ScenarioError",
    "SizeError",
    "StudyError",
    "UnitError",
    "name_fault",
    "nearest",
    "shown",
    "visible",
]

# control and format characters, lone surrogates, line and paragraph separators
_UNSEEN = ("Cc", "Cf", "Cs", "Zl", "Zp")
_LONGEST = 200
MOST_FAULTS = 100  # reported at once: naming the nearest name for each takes time
_MOST_COMPARED = 200  # comparing ten thousand names letter by letter takes a second


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong in the user's input, and where it is.

    Attributes
    ----------
    message
        What is wrong, and what is accepted.
    file
        Name of the file, or the option of the command line; None if unknown.
    line, column
        Position in the file, from 1; None if unknown.
    key
        Path of keys to the invalid entry.
    excerpt
        The line of the file, and a line with a caret below the column; empty if unknown.
    cause
        The error that was raised where the position was not known.

    Examples
    --------
    >>> print(Fault("0: must be at least 1", "case.yaml", 3, 5, ("controller", "horizon")))
    case.yaml:3:5: controller.horizon: 0: must be at least 1
    """

    message: str
    file: str | None = None
    line: int | None = None
    column: int | None = None
    key: tuple[str | int, ...] = ()
    excerpt: str = field(default="", compare=False, repr=False)
    cause: Exception | None = field(default=None, compare=False, repr=False)

    @property
    def dotted_key(self) -> str:
        """The key as text."""
        return ".".join(map(str, self.key))

    @property
    def statement(self) -> str:
        """The key and what is wrong, without the position."""
        return f"{self.dotted_key}: {self.message}" if self.key else self.message

    def as_dict(self) -> dict[str, str | int | None]:
        """Return position, key and message as plain values."""
        return {
            "file": self.file,
            "line": self.line,
            "column": self.column,
            "key": self.dotted_key or None,
            "message": self.message,
        }

    def __str__(self) -> str:
        """Return file, line, column, key and message on one line."""
        where = ":".join(str(part) for part in (self.file, self.line, self.column) if part is not None)
        return visible(f"{where}: {self.statement}" if where else self.statement)


class OpfmodelError(Exception):
    """Base class of errors in the user's input; the command line exits with status 2.

    The message is a single line, whatever names and paths it quotes; that of several faults has one
    line for each.

    Attributes
    ----------
    key
        Path of keys to the invalid entry, inside the value that was read.
    others
        Errors that were found together with this one; see :func:`raise_all`.
    """

    key: tuple[str | int, ...] = ()
    others: tuple[OpfmodelError, ...] = ()

    def __init__(self, message: str = "") -> None:
        super().__init__(visible(message))

    @property
    def faults(self) -> tuple[Fault, ...]:
        """What is wrong, in order of position; a single fault without a position for most errors."""
        return (Fault(str(self)),)


class ComponentError(OpfmodelError):
    """A field of a component has an invalid value.

    Attributes
    ----------
    component, field
        Names of the component and the field, from which a caller can locate the line in a file.
    """

    def __init__(self, component: str, field: str, value: object, rule: str) -> None:
        self.component = component
        self.field = field
        self.value = value
        self.rule = rule
        super().__init__(f"{component}: {field} = {shown(value)}: {rule}")


class NetworkError(OpfmodelError):
    """The components do not form a valid network, for example because no bus is in service."""


class CaseError(OpfmodelError):
    """A network file is missing, corrupt, in an unknown format, or lacks required data."""


class CaseWarning(UserWarning):
    """A network file contains data that are ignored, changed or ambiguous."""


class ProfileError(OpfmodelError):
    """A time series is too short, matches no component, or has an invalid value.

    Attributes
    ----------
    series, step
        Component and field of the series, and the step if a single value is invalid.
    """

    def __init__(self, message: str, series: tuple[str, str] | None = None, step: int | None = None) -> None:
        super().__init__(message)
        self.series = series
        self.step = step


class ProfileWarning(UserWarning):
    """A profile rule has no effect."""


class ModelError(OpfmodelError):
    """An option of a formulation, objective, device, plant or horizon is invalid."""

    def __init__(self, message: str, *key: str | int) -> None:
        super().__init__(message)
        self.key = key


class HorizonError(ModelError):
    """The nodes of a horizon do not fit together: lengths, probabilities, common part."""


class SecurityError(ModelError):
    """Contingencies do not fit the network: a name is unknown, or an outage splits the grid."""


class IncompatibleError(ModelError):
    """Valid parts, such as an objective and a formulation, cannot be combined.

    A study records such a combination as a failed run; any other error is an error in the study file.
    """


class QuantityError(ModelError):
    """A quantity is unknown, or the formulation does not publish it.

    Attributes
    ----------
    kind, quantity
        Kind of component and name of the quantity.
    """

    def __init__(self, kind: str, quantity: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind
        self.quantity = quantity


class ConstraintError(ModelError):
    """A constraint in a scenario file is malformed or refers to an unknown name."""


class PluginError(OpfmodelError):
    """A plugin does not exist, cannot be loaded, or does not accept the given options.

    Attributes
    ----------
    option
        Invalid option, if the error concerns one; :attr:`key` is the option, then keys inside its value.
    """

    def __init__(self, message: str, *key: str | int) -> None:
        super().__init__(message)
        self.key = key
        self.option = key[0] if key else None


class ResultError(OpfmodelError):
    """Results cannot be written or read."""


class ResultWarning(UserWarning):
    """Some stored results fail verification and are skipped."""


class ScenarioError(OpfmodelError):
    """A scenario or study file is invalid.

    The message has one line for each fault, with file, line, column, key and accepted values;
    :attr:`faults` has the same as values, and an excerpt of the file for each.
    """

    def __init__(self, *faults: Fault | str) -> None:
        self._faults = tuple(Fault(fault) if isinstance(fault, str) else fault for fault in faults)
        Exception.__init__(self, *self._faults)

    def __str__(self) -> str:
        """Return one line for each fault."""
        return "\n".join(map(str, self._faults))

    @property
    def faults(self) -> tuple[Fault, ...]:
        """What is wrong, in order of position."""
        return self._faults


class SizeError(OpfmodelError):
    """A problem needs more memory than the machine has; raised before anything is allocated."""


class StudyError(OpfmodelError):
    """A study cannot continue: its folder is in use, or its workers are unavailable."""


class UnitError(OpfmodelError, ValueError):
    """A quantity is in another unit than its field; also a ValueError, which pydantic reports."""


def raise_all(errors: Iterable[OpfmodelError]) -> None:
    """Raise the first of several errors, which carries the others; return if there are none."""
    found = list(islice(errors, MOST_FAULTS + 1))
    if found:
        found[0].others = tuple(found[1:])
        raise found[0]


def nearest(name: str, known: Iterable[str]) -> str:
    """Suggest the known names closest to ``name``, or list all of them if none is close."""
    names = sorted(known)
    if name.partition(":")[0] in names:
        return f"a space is missing after the colon in {shown(name)}"
    if found := close(name, names):
        return "did you mean " + " or ".join(map(repr, found)) + "?"
    return "available: " + (", ".join(names[:20]) + (" ..." if len(names) > 20 else "") if names else "none")


def close(name: str, known: Iterable[str]) -> list[str]:
    """Return the known names that a misspelt name may stand for, the closest first."""
    names = sorted(known)
    if name.partition(":")[0] in names:  # a key with its value, without a space between them
        return [name.partition(":")[0]]
    similar = _similar(name, names)
    found = difflib.get_close_matches(name, similar, n=3, cutoff=0.6)
    return found or [other for other in similar if len(name) > 1 and _distance(name, other) == 1][:3]


def _similar(name: str, names: list[str]) -> list[str]:
    """Return the names that share the longest beginning and end with ``name``; all if they are few."""
    if len(names) <= _MOST_COMPARED:
        return names

    return nsmallest(_MOST_COMPARED, names, key=lambda other: _distance(name, other))


def _distance(one: str, other: str) -> int:
    """Length of what remains of two texts without the beginning and the end that they share."""
    begin = _shared(one, other)
    return max(len(one), len(other)) - begin - _shared(one[begin:][::-1], other[begin:][::-1])


def _shared(one: str, other: str) -> int:
    """Number of characters with which two texts both begin."""
    differs = (n for n, (a, b) in enumerate(zip(one, other, strict=False)) if a != b)
    return next(differs, min(len(one), len(other)))


def listed(names: Iterable[str], most: int = 5) -> str:
    """Join the first names and count the rest.

    Examples
    --------
    >>> listed("abcdefg")
    'a, b, c, d, e and 2 more'
    """
    names = list(names)
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")


def visible(text: str) -> str:
    r"""Escape the characters of a text that cannot be printed, as ``repr`` does.

    The command line passes all output through this function because names and values come from files.

    Examples
    --------
    >>> print(visible("a\x1b[31mb"))
    a\x1b[31mb
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def name_fault(name: str) -> str:
    r"""Describe the first invisible character of a name; empty if there is none.

    Examples
    --------
    >>> name_fault("a\tb")
    "has the character '\\t'; use visible characters only"
    >>> name_fault("Würzburg 2")
    ''
    """
    if not name.isprintable():
        for character in name:
            if unicodedata.category(character) in _UNSEEN:
                return f"has the character {character!a}; use visible characters only"
    return ""


def shown(value: object) -> str:
    """Format a value for a message: its ``repr``, truncated if long."""
    text = repr(value)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."
