"""Field declarations of component dataclasses, and checks of their values."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, field
from typing import Any, Literal, NamedTuple, TypeGuard

import numpy as np

from opfmodel.errors import ComponentError
from opfmodel.network.bounds import LARGEST, bounded, is_number
from opfmodel.network.polygon import fault_of

__all__ = [
    "INF",
    "TableField",
    "adjustable",
    "at_bus",
    "choice",
    "cost_of",
    "flag",
    "in_service",
    "is_adjustable",
    "is_flag",
    "number",
    "points",
    "rules_of_adjustable",
    "rules_of_number",
    "rules_of_points",
    "rules_of_span",
    "rules_of_weights",
    "span",
    "type_of_adjustable",
    "type_of_bus",
    "type_of_choice",
    "type_of_flag",
    "type_of_number",
    "type_of_points",
    "type_of_span",
    "type_of_weights",
    "weights",
]

INF = math.inf
Over = Literal["mean", "min", "max", "last"]  # how the values of several steps make one


def number(
    unit: str,
    default: Any = MISSING,
    *,
    at_least: float = -INF,
    above: float = -INF,
    at_most: float = INF,
    not_above: str | None = None,
    optional: bool = False,
    finite: bool = True,
    series: bool = True,
    over: Over | None = None,
    description: str = "",
) -> Any:
    """Declare a field that holds one number.

    Parameters
    ----------
    unit
        One of :data:`opfmodel.network.units.UNITS`; determines the conversion to per unit.
    at_least, above, at_most
        Limits of the accepted values.
    not_above
        Another number of the component that this one must not exceed, in any step of a time series.
    optional
        Whether ``None`` is accepted; it means "no limit" and becomes infinity in the arrays.
    finite
        Whether infinity is refused. Where it is accepted, also in time series, it means "no limit".
    series
        Whether the field accepts a time series. Coefficients of equations must be constant.
    over
        Value over a stage of several steps: ``mean``, ``min``, ``max`` or ``last``. By default the minimum of
        a field that may be infinite, which is a limit, and the mean of all others.
    description
        What the field means, in one line without its unit; documentation and schemas state it.
    """
    metadata = {
        "form": "number",
        "unit": unit,
        "at_least": at_least,
        "above": above,
        "at_most": at_most,
        "not_above": not_above,
        "optional": optional,
        "finite": finite,
        "series": series,
        "over": over or ("mean" if finite else "min"),
        "description": description,
    }
    return field(default=default, metadata=metadata)


def span(
    unit: str,
    default: Any = MISSING,
    *,
    at_least: float = -INF,
    symmetric: bool = False,
    series: bool = True,
    averaged: bool = False,
    description: str = "",
) -> Any:
    """Declare a field that holds ``(min, max)``, with arrays ``<field>_min`` and ``<field>_max``.

    Parameters
    ----------
    symmetric
        Whether a single number ``a`` stands for ``(-a, a)``.
    series, description
        As for :func:`number`.
    averaged
        Whether a stage of several steps takes the mean of each limit; by default the tighter counts.
    """
    metadata = {
        "form": "span",
        "unit": unit,
        "at_least": at_least,
        "symmetric": symmetric,
        "series": series,
        "averaged": averaged,
        "description": description,
    }
    return field(default=default, metadata=metadata)


def adjustable(
    unit: str, default: float, *, at_least: float = -INF, at_most: float = INF, description: str = ""
) -> Any:
    """Declare a field that holds a constant or, as ``(min, max)``, the range in which it is decided.

    The arrays ``<field>_min`` and ``<field>_max`` hold the range, and ``<field>`` the constant or, of a
    range, the value that is nearest to the default.

    Parameters
    ----------
    unit, at_least, at_most, description
        As for :func:`number`.
    """
    metadata = {
        "form": "adjustable",
        "unit": unit,
        "at_least": at_least,
        "at_most": at_most,
        "optional": False,
        "finite": True,
        "symmetric": False,
        "series": False,
        "above": -INF,
        "description": description,
    }
    return field(default=default, metadata=metadata)


def at_bus(description: str = "Name of its bus.") -> Any:
    """Declare a field that names a bus; its array holds bus positions."""
    return field(metadata={"form": "bus", "unit": "", "series": False, "description": description})


def flag(default: bool, description: str = "") -> Any:
    """Declare a field that is true or false."""
    return field(
        default=default, metadata={"form": "flag", "unit": "", "series": False, "description": description}
    )


def choice(options: Sequence[str], default: Any = MISSING, *, description: str = "") -> Any:
    """Declare a field that holds one of some words; its array holds the words."""
    metadata = {
        "form": "choice",
        "unit": "",
        "series": False,
        "options": tuple(options),
        "description": description,
    }
    return field(default=default, metadata=metadata)


def in_service() -> Any:
    """Declare the field ``in_service``, which every component has."""
    return flag(True, "Whether the component is in service; false leaves it out.")


def cost_of(default: Any, description: str) -> Any:
    """Declare a field that holds a cost function."""
    return field(default=default, metadata={"form": "cost", "unit": "", "description": description})


def weights(
    unit: str,
    *,
    of: Sequence[str],
    positive: Sequence[str] = (),
    default: Any = MISSING,
    description: str = "",
) -> Any:
    """Declare a field that holds a number for each of some components, by name.

    The arrays hold one entry per name, by kind of the named component: ``<field>_<kind>``, the numbers, and
    ``<field>_<kind>_owner`` and ``<field>_<kind>_member``, the positions of the component that declares the
    field and of the named one. ``<field>_stated`` is whether a component names any, in service or not.

    Parameters
    ----------
    of
        Kinds of the components that may be named.
    positive
        Those for which the number must be at least 0.
    unit, description
        As for :func:`number`.
    """
    metadata = {
        "form": "weights",
        "unit": unit,
        "series": False,
        "of": tuple(of),
        "positive": tuple(positive),
        "description": description,
    }
    if default is MISSING:
        return field(metadata=metadata)
    return field(default_factory=lambda: dict(default), metadata=metadata)


def points(description: str = "") -> Any:
    """Declare a field that holds the corners of a convex polygon of active and reactive power in order.

    None means no limit. The arrays hold one entry per edge, the half-plane ``a p + b q <= c`` with
    ``a² + b² = 1``: ``<field>_owner``, the position of the component, and ``<field>_p``, ``<field>_q`` and
    ``<field>_limit``, which are a, b and c. Per component, they hold the ranges of the polygon, from
    ``<field>_p_min`` to ``<field>_q_max``, infinite without one.
    """
    metadata = {
        "form": "points",
        "unit": "MW",
        "units": ("MW", "MVAr"),
        "series": False,
        "description": description,
    }
    return field(default=None, metadata=metadata)


class TableField(NamedTuple):
    """A quantity in the arrays of a kind of component.

    Attributes
    ----------
    form, unit
        Form and unit of its field.
    series
        Whether it accepts a time series.
    """

    form: str
    unit: str
    series: bool


# Checks: types always, rules only for components in service -----------------------------------------

_FINITE = f"must be a finite number of at most {LARGEST:g}"
_FLAGS = (bool, np.bool_)


def is_flag(value: object) -> TypeGuard[bool]:
    """Whether a value is a Boolean."""
    return isinstance(value, _FLAGS)


def type_of_number(name: str, key: str, value: object, rules: Mapping[str, Any]) -> None:
    """Raise :class:`ComponentError` unless a value is a number."""
    if not (is_number(value) or (value is None and rules["optional"])):
        raise ComponentError(name, key, value, f"must be a number{_unit(rules)}")


def rules_of_number(name: str, key: str, value: Any, rules: Mapping[str, Any]) -> None:
    """Raise :class:`ComponentError` for a number that violates the rules of its field."""
    if value is None:
        return
    if not bounded(value) and (rules["finite"] or abs(value) != INF):
        raise ComponentError(name, key, value, _FINITE)
    if value < rules["at_least"]:
        raise ComponentError(name, key, value, f"must be at least {rules['at_least']:g}")
    if value <= rules["above"]:
        raise ComponentError(name, key, value, f"must be greater than {rules['above']:g}")
    if value > rules["at_most"]:
        raise ComponentError(name, key, value, f"must be at most {rules['at_most']:g}")


def type_of_span(name: str, key: str, value: object, rules: Mapping[str, Any]) -> None:
    """Raise :class:`ComponentError` unless a value is a pair of numbers or, if symmetric, one number."""
    if rules["symmetric"] and is_number(value):
        return
    if not is_adjustable(value) or len(value) != 2:
        raise ComponentError(name, key, value, f"must be a pair (min, max){_unit(rules)}")
    if not all(map(is_number, value)):
        raise ComponentError(name, key, value, f"both ends must be numbers{_unit(rules)}")


def rules_of_span(name: str, key: str, value: Any, rules: Mapping[str, Any]) -> None:
    """Raise :class:`ComponentError` for a range that violates the rules of its field."""
    if is_number(value):
        if not (bounded(value) or abs(value) == INF):
            raise ComponentError(name, key, value, _FINITE)
        if value < 0:
            raise ComponentError(
                name, key, value, "a single number a stands for (-a, a) and must be at least 0"
            )
        return
    low, high = value
    if not all(bounded(end) or abs(end) == INF for end in (low, high)):
        rule = f"both ends must be numbers{_unit(rules)} of at most {LARGEST:g}, or infinite"
        raise ComponentError(name, key, value, rule)
    if low > high:
        raise ComponentError(name, key, value, f"the minimum {low:g} is above the maximum {high:g}")
    if low == INF or high == -INF:
        raise ComponentError(
            name, key, value, "the minimum must be below infinity and the maximum above -infinity"
        )
    if low < rules["at_least"]:
        raise ComponentError(name, key, value, f"the minimum must be at least {rules['at_least']:g}")


def is_adjustable(value: object) -> TypeGuard[tuple[float, float]]:
    """Whether the value of an adjustable field is a range."""
    return type(value) is tuple or (isinstance(value, Sequence) and not isinstance(value, str))


def type_of_adjustable(name: str, key: str, value: object, rules: Mapping[str, Any]) -> None:
    """Raise :class:`ComponentError` unless a value is a number or a pair of numbers."""
    if not is_number(value):
        if not is_adjustable(value):
            raise ComponentError(name, key, value, f"must be a number or a pair (min, max){_unit(rules)}")
        type_of_span(name, key, value, rules)


def rules_of_adjustable(name: str, key: str, value: Any, rules: Mapping[str, Any]) -> None:
    """Raise :class:`ComponentError` for a number or a range that violates the rules of its field."""
    ends = value if is_adjustable(value) else (value,)
    for end in ends:
        rules_of_number(name, key, end, rules)
    if is_adjustable(value):
        rules_of_span(name, key, value, rules)


def type_of_weights(name: str, key: str, value: object, rules: Mapping[str, Any]) -> None:
    """Raise :class:`ComponentError` unless a value is a mapping of names to numbers."""
    if not isinstance(value, Mapping) or not all(
        isinstance(member, str) and is_number(weight) for member, weight in value.items()
    ):
        raise ComponentError(name, key, value, f"must be {{name: number, ...}}, with numbers{_unit(rules)}")


def rules_of_weights(name: str, key: str, value: Mapping[str, Any], _: Mapping[str, Any]) -> None:
    """Raise :class:`ComponentError` for a number that is not finite."""
    for member, number in value.items():
        if not bounded(number):
            raise ComponentError(name, f"{key}.{member}", number, _FINITE)


def type_of_points(name: str, key: str, value: object, rules: Mapping[str, Any]) -> None:
    """Raise :class:`ComponentError` unless a value is a list of at least three pairs of numbers."""
    if value is None:
        return
    accepted = f"must be a list of at least 3 points [{', '.join(rules['units'])}]"
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) < 3:
        raise ComponentError(name, key, value, accepted)
    for point in value:
        pair = isinstance(point, Sequence) and not isinstance(point, str) and len(point) == 2
        if not pair or not all(map(is_number, point)):
            raise ComponentError(name, key, point, accepted)


def rules_of_points(name: str, key: str, value: Any, _: Mapping[str, Any]) -> None:
    """Raise :class:`ComponentError` unless points are finite and the corners of a convex polygon."""
    if value is None:
        return
    for point in value:
        if not all(map(bounded, point)):
            raise ComponentError(name, key, point, f"both must be finite numbers of at most {LARGEST:g}")
    fault = fault_of(value)
    if fault:
        raise ComponentError(name, key, value, fault)


def type_of_flag(name: str, key: str, value: object, _: Mapping[str, Any]) -> None:
    """Raise :class:`ComponentError` unless a value is true or false."""
    if not is_flag(value):
        raise ComponentError(name, key, value, "must be true or false")


def type_of_choice(name: str, key: str, value: object, rules: Mapping[str, Any]) -> None:
    """Raise :class:`ComponentError` unless a value is one of the words of its field."""
    if not (isinstance(value, str) and value in rules["options"]):
        raise ComponentError(name, key, value, f"must be {' or '.join(rules['options'])}")


def type_of_bus(name: str, key: str, value: object, _: Mapping[str, Any]) -> None:
    """Raise :class:`ComponentError` unless a value names a bus."""
    if not (isinstance(value, str) and value):
        raise ComponentError(name, key, value, "must be the name of a bus")


def _unit(rules: Mapping[str, Any]) -> str:
    return f" in {rules['unit']}" if rules["unit"] else ""
