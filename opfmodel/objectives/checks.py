"""Checks of the options of objectives."""

from __future__ import annotations

from opfmodel.errors import ModelError
from opfmodel.network.bounds import LARGEST, bounded

__all__ = ["finite", "not_negative"]


def finite(owner: str, option: str, value: float) -> float:
    """Return the value; raise :class:`ModelError` unless it is a finite number of at most 1e30."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not bounded(value):
        raise ModelError(f"{owner}: {option} = {value!r}: must be a number of at most {LARGEST:g}")
    return float(value)


def not_negative(owner: str, option: str, value: float) -> float:
    """Return the value; raise :class:`ModelError` unless it is a number of at least 0."""
    if finite(owner, option, value) < 0:
        raise ModelError(f"{owner}: {option} = {value!r}: must be at least 0")
    return float(value)
