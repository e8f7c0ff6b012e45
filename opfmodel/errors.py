"""The errors and warnings that opfmodel raises on purpose, and how their messages are written."""

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
    "name_fault",
    "nearest",
    "shown",
    "visible",
]

# control and format characters, lone surrogates, line and paragraph separators
_UNSEEN = ("Cc", "Cf", "Cs", "Zl", "Zp")
_LONGEST = 200


class OpfmodelError(Exception):
    """Base class: a mistake in the input, in one sentence. The command line exits with 2.

    The message is one line whatever names and paths it quotes.
    """

    def __init__(self, message: str = "") -> None:
        super().__init__(visible(message))


class ComponentError(OpfmodelError):
    """A field of a component breaks a rule.

    Attributes
    ----------
    component, field
        Name of the component and of its field, so that a caller can find the line in a file.
    """

    def __init__(self, component: str, field: str, value: object, rule: str) -> None:
        self.component = component
        self.field = field
        self.value = value
        self.rule = rule
        super().__init__(f"{component}: {field} = {shown(value)}: {rule}")


class NetworkError(OpfmodelError):
    """The components do not make a network: a duplicate name, no bus, no generator to balance it."""


class CaseError(OpfmodelError):
    """A network file is missing, damaged, of an unknown format, or lacks what a model needs."""


class CaseWarning(UserWarning):
    """Something about a network file that its user should know."""


class ProfileError(OpfmodelError):
    """A time series is too short, names nothing in the network, or is not a number.

    Attributes
    ----------
    series, step
        Component and field of the series, and the step if it is one value that breaks a rule.
    """

    def __init__(self, message: str, series: tuple[str, str] | None = None, step: int | None = None) -> None:
        super().__init__(message)
        self.series = series
        self.step = step


class ProfileWarning(UserWarning):
    """A profile rule that changes nothing."""


class ModelError(OpfmodelError):
    """An option of a formulation, objective, device, plant or horizon breaks a rule."""


class IncompatibleError(ModelError):
    """Parts that are valid by themselves do not fit together: an objective and a formulation, for instance.

    A study keeps such a combination as a failed run; every other error is a mistake in its file.
    """


class QuantityError(ModelError):
    """A quantity that is not there: unknown, or not published by the formulation.

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
    """A constraint of a scenario file is not well formed, or names what is not there.

    Attributes
    ----------
    key
        Keys below the constraint's name that lead to the mistake.
    """

    def __init__(self, message: str, *key: str) -> None:
        super().__init__(message)
        self.key = key


class PluginError(OpfmodelError):
    """A plugin does not exist, could not be loaded, or was given options it does not take.

    Attributes
    ----------
    option
        The option at fault, if it is one.
    key
        Keys that lead to the mistake: the option, and those inside its value.
    """

    def __init__(self, message: str, *key: str | int) -> None:
        super().__init__(message)
        self.key = key
        self.option = key[0] if key else None


class ResultError(OpfmodelError):
    """Results cannot be written, or what is read is not one."""


class ResultWarning(UserWarning):
    """Some of the results that are read cannot be trusted, and are left out."""


class ScenarioError(OpfmodelError):
    """A scenario or study file breaks its schema; the message names file, line and column."""


class SizeError(OpfmodelError):
    """What is asked for needs more memory than the machine has; nothing of it was allocated."""


class StudyError(OpfmodelError):
    """A study cannot go on: its folder is in use, or its workers cannot be had."""


def nearest(name: str, known: Iterable[str]) -> str:
    """What to tell somebody who wrote ``name``: the nearest known names, or all of them."""
    names = sorted(known)
    close = difflib.get_close_matches(name, names, n=3, cutoff=0.6)
    if close:
        return "did you mean " + " or ".join(repr(n) for n in close) + "?"
    return "known are: " + (", ".join(names[:20]) + (" ..." if len(names) > 20 else "") if names else "none")


def listed(names: Iterable[str], most: int = 5) -> str:
    """The first names, and how many more there are.

    Examples
    --------
    >>> listed("abcdefg")
    'a, b, c, d, e and 2 more'
    """
    names = list(names)
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")


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
