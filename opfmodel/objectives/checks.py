"""Rules for the options of objectives."""

from __future__ import annotations

import math

from opfmodel.errors import ModelError

__all__ = ["finite", "not_negative"]


def finite(owner: str, option: str, value: float) -> float:
    """The value, or a :class:`ModelError` if it is not a finite number."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        raise ModelError(f"{owner}: {option} = {value!r}: must be a number")
    return float(value)


def not_negative(owner: str, option: str, value: float) -> float:
    """The value, or a :class:`ModelError` if it is not a number of at least 0."""
    if finite(owner, option, value) < 0:
        raise ModelError(f"{owner}: {option} = {value!r}: must be at least 0")
    return float(value)
