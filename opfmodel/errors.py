"""Errors and warnings that opfmodel raises, and helpers that write their messages."""

from __future__ import annotations

import difflib
import unicodedata
from collections.abc import Iterable

__all__ = [
    "CaseError",
    "CaseWarning",
    "ComponentError",
    "ConstraintError",
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


class OpfmodelError(Exception):
    """Base class of errors in the user's input; the command line exits with status 2.

    The message is a single line, whatever names and paths it quotes.
    """

    def __init__(self, message: str = "") -> None:
        super().__init__(visible(message))


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


class HorizonError(ModelError):
    """The nodes of a horizon do not fit together: lengths, probabilities, common part.

    Attributes
    ----------
    key
        Path of keys to the invalid entry, in a scenario file below the horizon or its scenarios.
    """

    def __init__(self, message: str, *key: str | int) -> None:
        super().__init__(message)
        self.key = key


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
    """A constraint in a scenario file is malformed or refers to an unknown name.

    Attributes
    ----------
    key
        Path of keys, below the constraint's name, to the invalid entry.
    """

    def __init__(self, message: str, *key: str) -> None:
        super().__init__(message)
        self.key = key


class PluginError(OpfmodelError):
    """A plugin does not exist, cannot be loaded, or does not accept the given options.

    Attributes
    ----------
    option
        Invalid option, if the error concerns one.
    key
        Path of keys to the invalid entry: the option, then keys inside its value.
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
    """A scenario or study file violates its schema; the message gives file, line and column."""


class SizeError(OpfmodelError):
    """A problem needs more memory than the machine has; raised before anything is allocated."""


class StudyError(OpfmodelError):
    """A study cannot continue: its folder is in use, or its workers are unavailable."""


class UnitError(OpfmodelError, ValueError):
    """A quantity is in another unit than its field; also a ValueError, which pydantic reports."""


def nearest(name: str, known: Iterable[str]) -> str:
    """Suggest the known names closest to ``name``, or list all of them if none is close."""
    names = sorted(known)
    close = difflib.get_close_matches(name, names, n=3, cutoff=0.6)
    if close:
        return "did you mean " + " or ".join(repr(n) for n in close) + "?"
    return "available: " + (", ".join(names[:20]) + (" ..." if len(names) > 20 else "") if names else "none")


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
