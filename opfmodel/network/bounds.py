"""Limits of the numbers that are accepted."""

from __future__ import annotations

__all__ = ["BASE_MVA", "LARGEST", "STEP_HOURS", "bounded"]

# Maximum magnitude of a finite number in any unit. No power-system quantity is larger, and the product of
# eight such numbers is still finite.
LARGEST = 1e30
# Minimum and maximum of the power base in MVA and of the stage length in hours; within them, per-unit
# quantities and energies remain computable.
BASE_MVA = (1e-6, 1e9)
STEP_HOURS = (1e-6, 1e6)


def bounded(value: float) -> bool:
    """Whether a number is finite and at most :data:`LARGEST` in magnitude; False for NaN.

    Examples
    --------
    >>> bounded(-1e30), bounded(1e31), bounded(float("inf")), bounded(float("nan")), bounded(10**400)
    (True, False, False, False, False)
    """
    return abs(value) <= LARGEST
