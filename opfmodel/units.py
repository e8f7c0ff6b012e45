"""Physical units at the public boundary, per unit inside: the one place that converts.

Per unit is on ``base_mva``; energy per unit is in hours (1 p.u. h = base_mva MWh); angles are
radians inside and degrees outside; costs are $ on both sides.
"""

from __future__ import annotations

import math

from opfmodel.errors import ModelError

__all__ = ["BASE_MVA", "LARGEST", "STEP_HOURS", "UNITS", "bounded", "scale"]

# Largest magnitude of a finite number in any unit. What is larger is no quantity of a power system, and a
# product of eight numbers of this size is still finite.
LARGEST = 1e30
# Least and largest power base, and length of a stage in hours, that per-unit quantities and energies survive.
BASE_MVA = (1e-6, 1e9)
STEP_HOURS = (1e-6, 1e6)

# power of base_mva in one internal unit, and another constant factor
_FACTORS: dict[str, tuple[int, float]] = {
    "": (0, 1.0),
    "p.u.": (0, 1.0),
    "p.u.^2": (0, 1.0),
    "1/h": (0, 1.0),
    "h": (0, 1.0),
    "kV": (0, 1.0),
    "deg": (0, math.degrees(1.0)),
    "MW": (1, 1.0),
    "MVAr": (1, 1.0),
    "MVA": (1, 1.0),
    "MWh": (1, 1.0),
    "MW/h": (1, 1.0),
    "$/h": (0, 1.0),
    "$": (0, 1.0),
    "$/MWh": (-1, 1.0),
    "$/MVArh": (-1, 1.0),
    "$/MW": (-1, 1.0),
    "$/MW^2h": (-2, 1.0),
}

UNITS = tuple(_FACTORS)


def bounded(value: float) -> bool:
    """Whether a number is finite and at most :data:`LARGEST` in magnitude; false of what is not a number.

    Examples
    --------
    >>> bounded(-1e30), bounded(1e31), bounded(math.inf), bounded(math.nan), bounded(10**400)
    (True, False, False, False, False)
    """
    return abs(value) <= LARGEST


def scale(unit: str, base_mva: float) -> float:
    """Physical value of one internal unit: ``physical = scale(unit, base_mva) * internal``.

    Examples
    --------
    >>> scale("MW", 100.0)
    100.0
    >>> scale("$/MWh", 100.0)
    0.01
    """
    try:
        power, factor = _FACTORS[unit]
    except KeyError:
        raise ModelError(f"unknown unit {unit!r}; known are: {', '.join(UNITS)}") from None
    return base_mva**power * factor
