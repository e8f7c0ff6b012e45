"""The errors and warnings that opfmodel raises on purpose."""

from __future__ import annotations

import difflib
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
    "StudyError",
    "nearest",
]


class OpfmodelError(Exception):
    """Base class: a mistake in the input, said in one sentence. The command line exits with 2."""


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
        super().__init__(f"{component}: {field} = {value!r}: {rule}")


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
        ``component.field`` and the step at fault, if it is one value that breaks a rule.
    """

    def __init__(self, message: str, series: str | None = None, step: int | None = None) -> None:
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
    """

    def __init__(self, message: str, option: str | None = None) -> None:
        super().__init__(message)
        self.option = option


class ResultError(OpfmodelError):
    """Results cannot be written, or what is read is not one."""


class ResultWarning(UserWarning):
    """Some of the results that are read cannot be trusted, and are left out."""


class ScenarioError(OpfmodelError):
    """A scenario or study file breaks its schema; the message names file, line and column."""


class StudyError(OpfmodelError):
    """A study cannot go on: its folder is in use, or its workers cannot be had."""


def nearest(name: str, known: Iterable[str]) -> str:
    """What to tell somebody who wrote ``name``: the nearest known names, or all of them."""
    names = sorted(known)
    close = difflib.get_close_matches(name, names, n=3, cutoff=0.6)
    if close:
        return "did you mean " + " or ".join(repr(n) for n in close) + "?"
    return "known are: " + (", ".join(names[:20]) + (" ..." if len(names) > 20 else "") if names else "none")
