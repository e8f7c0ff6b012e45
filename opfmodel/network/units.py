"""Conversion between physical units, used in the public interface, and per unit, used internally.

All conversions take place here. Internal per-unit values refer to the base of the arrays, which depends
on the size of the system; impedances and admittances are declared per unit on the network's own base.
Per-unit energy is in hours (1 p.u. h is the base in MWh). Angles are in radians internally and in degrees
in the interface; costs are in $ in both.
"""

from __future__ import annotations

import math

from opfmodel.errors import ModelError

__all__ = ["UNITS", "scale"]

# exponent of the internal base in one internal unit, and a constant factor
_FACTORS: dict[str, tuple[int, float]] = {
    "": (0, 1.0),
    "p.u.": (0, 1.0),
    "p.u.^2": (0, 1.0),
    "1/h": (0, 1.0),
    "h": (0, 1.0),
    "min": (0, 1.0),
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
    "$/MWh/h": (-1, 1.0),
    "$/MVArh": (-1, 1.0),
    "$/MW": (-1, 1.0),
    "$/MW^2h": (-2, 1.0),
    # of a budget, whose unit is the user's own
    "units": (0, 1.0),
    "units/h": (0, 1.0),
    "units/MWh": (-1, 1.0),
    "$/unit": (0, 1.0),
}
# exponent of the ratio of the internal base to the declared base
_REBASED = {"p.u. impedance": -1, "p.u. admittance": 1}

UNITS = (*_FACTORS, *_REBASED)


def scale(unit: str, base_mva: float, declared_mva: float | None = None) -> float:
    """Factor from internal to declared values: ``declared = scale(unit, base_mva) * internal``.

    Parameters
    ----------
    base_mva
        Base of the internal per-unit values.
    declared_mva
        Base on which the network declares impedances and admittances; ``base_mva`` by default.

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
        raise ModelError(f"unknown unit {unit!r}; available: {', '.join(UNITS)}") from None
    return base_mva**power * factor
