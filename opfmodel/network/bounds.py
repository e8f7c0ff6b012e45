"""Which numbers are accepted at all."""

from __future__ import annotations

__all__ = ["BASE_MVA", "LARGEST", "STEP_HOURS", "bounded"]

# Largest magnitude of a finite number in any unit. What is larger is no quantity of a power system, and a
# product of eight numbers of this size is still finite.
LARGEST = 1e30
# Least and largest power base, and length of a stage in hours, that per-unit quantities and energies survive.
BASE_MVA = (1e-6, 1e9)
STEP_HOURS = (1e-6, 1e6)


def bounded(value: float) -> bool:
    """Whether a number is finite and at most :data:`LARGEST` in magnitude; false of what is not a number.

    Examples
    --------
    >>> bounded(-1e30), bounded(1e31), bounded(float("inf")), bounded(float("nan")), bounded(10**400)
    (True, False, False, False, False)
    """
    return abs(value) <= LARGEST
