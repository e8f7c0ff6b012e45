"""Limits of the numbers that are accepted, in components, options and arguments."""

from __future__ import annotations

import math
from typing import TypeGuard

import numpy as np

from opfmodel.errors import ModelError, OpfmodelError, shown

__all__ = ["BASE_MVA", "LARGEST", "STEP_HOURS", "bounded", "integer", "is_number", "number_within"]

# Maximum magnitude of a finite number in any unit. No power-system quantity is larger, and the product of
# eight such numbers is still finite.
LARGEST = 1e30
# Minimum and maximum of the power base in MVA and of the stage length in hours; within them, per-unit
# quantities and energies remain computable.
BASE_MVA = (1e-6, 1e9)
STEP_HOURS = (1e-6, 1e6)

# Created once, because they are used about ten times for each component of a network file.
_NUMBERS = (float, int, np.integer, np.floating)


def is_number(value: object) -> TypeGuard[float]:
    """Whether a value is a number; Booleans do not count."""
    return type(value) is float or (isinstance(value, _NUMBERS) and not isinstance(value, bool))


def bounded(value: float) -> bool:
    """Whether a number is finite and at most :data:`LARGEST` in magnitude; False for NaN.

    Examples
    --------
    >>> bounded(-1e30), bounded(1e31), bounded(float("inf")), bounded(float("nan")), bounded(10**400)
    (True, False, False, False, False)
    """
    return abs(value) <= LARGEST


def number_within(
    name: str,
    value: object,
    *,
    at_least: float = -math.inf,
    above: float = -math.inf,
    at_most: float = math.inf,
    below: float = math.inf,
    error: type[OpfmodelError] = ModelError,
) -> float:
    """Return an argument or option as a float, or raise an error that names it.

    Parameters
    ----------
    name
        The option, with its owner where that is not obvious: ``elastic: limit``.
    at_least, above, at_most, below
        Accepted range; in any case, numbers are finite and at most :data:`LARGEST` in magnitude.

    Examples
    --------
    >>> number_within("share", 0.5, at_least=0, at_most=1)
    0.5
    """
    if is_number(value) and bounded(value) and at_least <= value <= at_most and above < value < below:
        return float(value)
    limits = {"at least": at_least, "above": above, "at most": at_most, "below": below}
    stated = " and ".join(f"{word} {limit:g}" for word, limit in limits.items() if math.isfinite(limit))
    raise error(f"{name} = {shown(value)}: must be a finite number{', ' if stated else ''}{stated}")


def integer(name: str, value: object, at_least: int, error: type[OpfmodelError] = ModelError) -> int:
    """Return an argument or option as an int, or raise an error that names it.

    Examples
    --------
    >>> integer("horizon", 24, at_least=1)
    24
    """
    if isinstance(value, int | np.integer) and not isinstance(value, bool) and value >= at_least:
        return int(value)
    raise error(f"{name} = {shown(value)}: must be an integer, at least {at_least}")
