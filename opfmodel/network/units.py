"""Physical units at the public boundary, per unit inside: the one place that converts.

Inside, per unit is on the base of the arrays, which the size of the system decides; impedances and
admittances are declared per unit on the network's own base. Energy per unit is in hours (1 p.u. h is
the base in MWh); angles are radians inside and degrees outside; costs are $ on both sides.
"""

from __future__ import annotations

import math

from opfmodel.errors import ModelError

__all__ = ["UNITS", "scale"]

# power of the base inside in one internal unit, and another constant factor
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
# power of the ratio of the base inside to the declared one
_REBASED = {"p.u. impedance": -1, "p.u. admittance": 1}

UNITS = (*_FACTORS, *_REBASED)


def scale(unit: str, base_mva: float, declared_mva: float | None = None) -> float:
    """Declared value of one internal unit: ``declared = scale(unit, base_mva) * internal``.

    Parameters
    ----------
    base_mva
        Base of the per-unit values inside.
    declared_mva
        Base on which the network declares impedances and admittances; by default the same.

    Examples
    --------
    >>> scale("MW", 100.0)
    100.0
    >>> scale("$/MWh", 100.0)
    0.01
    >>> scale("p.u. impedance", base_mva=100.0, declared_mva=10.0)
    0.1
    """
    if unit in _REBASED:
        return float((base_mva / (declared_mva or base_mva)) ** _REBASED[unit])
    try:
        power, factor = _FACTORS[unit]
    except KeyError:
        raise ModelError(f"unknown unit {unit!r}; known are: {', '.join(UNITS)}") from None
    return base_mva**power * factor
