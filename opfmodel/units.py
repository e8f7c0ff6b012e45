"""Physical units at the public boundary, per unit inside: the one place that converts.

Per unit is on ``base_mva``; energy per unit is in hours (1 p.u. h = base_mva MWh); angles are
radians inside and degrees outside; costs are $ on both sides.
"""

from __future__ import annotations

import math

from opfmodel.errors import ModelError

__all__ = ["UNITS", "scale"]

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
