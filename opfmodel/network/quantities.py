"""Numbers with a unit as text: ``200 MWh``, ``15 min``, ``40 EUR/MWh``.

A unit is a product of symbols with prefixes and powers, ``MW/min`` or ``$/MW^2h``. Text and field must
agree in dimension; active, reactive and apparent power are different dimensions, and so is a currency. A
library of units is not used because none makes these distinctions and knows per-unit values: the symbols
below are all that the fields of components have.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple, TypeGuard

from opfmodel.errors import UnitError, shown

if TYPE_CHECKING:
    from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler, ValidationInfo
    from pydantic_core import CoreSchema

__all__ = [
    "CURRENCY",
    "Basis",
    "In",
    "currency_fault",
    "in_currency",
    "is_quantity",
    "quantity_schema",
    "read_quantity",
]

CURRENCY = "$"
"""The currency of a network that states none; in the units of fields it stands for any currency."""

_PREFIXES = {"": 1.0, "k": 1e3, "M": 1e6, "G": 1e9}
# symbol: dimension, size in the unit of that dimension, and whether it takes a prefix
_SYMBOLS: dict[str, tuple[str, float, bool]] = {
    "W": ("active power", 1e-6, True),
    "VAr": ("reactive power", 1e-6, True),
    "var": ("reactive power", 1e-6, True),
    "VA": ("apparent power", 1e-6, True),
    "V": ("voltage", 1e-3, True),
    "h": ("time", 1.0, False),
    "min": ("time", 1.0 / 60.0, False),
    "s": ("time", 1.0 / 3600.0, False),
    "d": ("time", 24.0, False),
    "unit": ("use of a budget", 1.0, False),
    "units": ("use of a budget", 1.0, False),
    "deg": ("angle", 1.0, False),
    "°": ("angle", 1.0, False),
    "rad": ("angle", math.degrees(1.0), False),
    "%": ("", 0.01, False),
    "1": ("", 1.0, False),
    "p.u.": ("per unit", 1.0, False),
    "pu": ("per unit", 1.0, False),
}
_POWERS = ("active power", "reactive power", "apparent power")

# the group is atomic, so that "200" is not 20 of the unit "0"
_NUMBER = re.compile(
    r"([+-]?(?>(?:\d[\d_]*(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?))\s*((?:[^\W\d_]|[%°$€£¥(]|1\s*/).*)", re.DOTALL
)
# the same for JSON Schema, whose patterns have no atomic groups
_PATTERN = (
    r"^\s*(?!.*%\s*of\b)(?![+-]?[\d_.]+([eE][+-]?\d+)?\s*$)[+-]?(\d[\d_]*(\.\d*)?|\.\d+)([eE][+-]?\d+)?\s*"
    r"([^\W\d_]|[%°$€£¥(]|1\s*/)"
)
_NAME = re.compile(r"[^\W\d_]{1,16}|[$€£¥]")
_SHARE = re.compile(r"%\s*of\b")  # "10% of p_max" is a share of another field, not a quantity


class _Unit(NamedTuple):
    """Size of a unit, in the units of the fields, and its dimensions with their powers."""

    size: float
    dimensions: Mapping[str, int]


class Basis(NamedTuple):
    """What the value of a quantity depends on besides its text.

    Attributes
    ----------
    currency
        Name of the currency of all values.
    base_mva
        Base of powers in per unit, which are refused if it is None.
    """

    currency: str = CURRENCY
    base_mva: float | None = None


def is_quantity(value: object) -> TypeGuard[str]:
    """Whether a value is text that begins with a number, followed by what may be a unit.

    Examples
    --------
    >>> is_quantity("200 MWh"), is_quantity("200"), is_quantity("10% of p_max"), is_quantity("coal")
    (True, False, False, False)
    """
    match = _NUMBER.fullmatch(value.strip()) if isinstance(value, str) else None
    return match is not None and not _SHARE.match(match[2])


def read_quantity(text: str, unit: str, basis: Basis | None = None) -> float:
    """Return the number in the unit of a field for which a text such as ``1.2 GW`` stands.

    Parameters
    ----------
    unit
        Unit of the field, one of :data:`opfmodel.network.units.UNITS`.

    Raises
    ------
    UnitError
        The unit is unknown, of another dimension, or in another currency.

    Examples
    --------
    >>> read_quantity("500 kW", "MW"), read_quantity("0.5 MW/min", "MW/h"), read_quantity("15 min", "h")
    (0.5, 30.0, 0.25)
    >>> read_quantity("0.5 pu", "MW", Basis(base_mva=200.0)), read_quantity("4 EUR", "$", Basis("EUR"))
    (100.0, 4.0)
    >>> read_quantity("200 MW", "MWh")
    Traceback (most recent call last):
    opfmodel.errors.UnitError: is in MW; must be in MWh
    """
    basis = basis or Basis()
    match = _NUMBER.fullmatch(text.strip())
    accepted = in_currency(_spelt(unit), basis.currency)
    if match is None:
        raise UnitError(f"must be a number in {accepted}")
    number, written = float(match[1].replace("_", "")), match[2]
    given, field = _parsed(written, basis.currency), _of_field(unit)
    if given is None:
        raise UnitError(_unknown(written, accepted, basis.currency, "currency" in field.dimensions))
    size = given.size / field.size
    if given.dimensions != field.dimensions:
        power = _based(given, field)
        if power is None or basis.base_mva is None:
            raise UnitError(f"is in {written}; must be in {accepted}")
        size = given.size * basis.base_mva**power
    value = _product(number, size)
    if not math.isfinite(value):
        raise UnitError("must be a finite number")
    return value


@dataclass(frozen=True)
class In:
    """Unit of an option or key, as an annotation: ``price: Annotated[float, In("$/MWh")]``.

    With it, pydantic accepts text such as ``40 EUR/MWh`` for the number. The context of the validation is
    a :class:`Basis`.
    """

    unit: str

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Convert text before the number is checked."""
        from pydantic_core import core_schema

        return core_schema.with_info_before_validator_function(self._read, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Accept what the number accepts, or text with a unit."""
        return {"anyOf": [handler(schema), quantity_schema(self.unit)]}

    def _read(self, value: Any, info: ValidationInfo) -> Any:
        if not is_quantity(value):
            return value
        return read_quantity(value, self.unit, info.context)


def quantity_schema(unit: str) -> dict[str, Any]:
    """Return the JSON Schema of text with a unit.

    Only its form is described: whether the unit is one of the field depends on the currency.
    """
    return {"type": "string", "pattern": _PATTERN, "description": _spelt(unit)}


def in_currency(unit: str, currency: str) -> str:
    """Return a unit with the name of the currency in place of ``$``.

    Examples
    --------
    >>> in_currency("$/MWh", "EUR")
    'EUR/MWh'
    """
    return unit.replace(CURRENCY, currency)


def currency_fault(name: object) -> str:
    """Describe what is wrong with the name of a currency; empty if nothing is.

    Examples
    --------
    >>> currency_fault("EUR"), currency_fault("MW")
    ('', 'is a unit; must be the name of a currency, such as EUR')
    """
    if not (isinstance(name, str) and _NAME.fullmatch(name)):
        return "must be the name of a currency, such as EUR: up to 16 letters or one of $€£¥"
    if _parsed(name, CURRENCY) is not None and name != CURRENCY:
        return "is a unit; must be the name of a currency, such as EUR"
    return ""


def _spelt(unit: str) -> str:
    """Unit as it is written: impedances and admittances are in ``p.u.``, shares plain numbers or in %."""
    return (unit.partition(" ")[0] if unit.startswith("p.u. ") else unit) or "% or a plain number"


def _product(number: float, size: float) -> float:
    """Product without the rounding error of a size such as 1/60: 500 kW are 0.5 MW exactly."""
    parts = round(1.0 / size) if 0 < size < 1 else 0
    return number / parts if parts and math.isclose(parts * size, 1.0, rel_tol=1e-12) else number * size


def _based(given: _Unit, field: _Unit) -> int | None:
    """Power of the base in a unit with ``pu`` where that of the field has power; None if it is another.

    The time in the unit remains: energy is in ``pu h``, a ramp in ``pu/h``.
    """
    powers = {key: power for key, power in field.dimensions.items() if key in _POWERS}
    if not powers:
        return None
    (power,) = powers.values()
    rest = {key: n for key, n in field.dimensions.items() if key not in powers}
    return power if given.dimensions == {**rest, "per unit": power} else None


def _unknown(written: str, accepted: str, currency: str, priced: bool) -> str:
    """What to say about a unit that cannot be parsed, which may be in another currency."""
    for other in _NAME.findall(written) if priced else ():
        if not currency_fault(other) and _parsed(written, other) is not None:
            return f"is in {written}, but the currency is {currency}; must be in {accepted}"
    return f"{shown(written)} is not a unit; must be in {accepted}"


@cache
def _of_field(unit: str) -> _Unit:
    """Unit of a field; impedances and admittances are per unit."""
    parsed = _parsed(unit.partition(" ")[0] if unit else "1", CURRENCY)
    if parsed is None:
        raise UnitError(f"has the unit {unit!r}, in which no text can be written; must be a number")
    return parsed


@lru_cache(maxsize=4096)
def _parsed(text: str, currency: str) -> _Unit | None:
    """Parse a unit: factors joined by spaces, ``*``, ``·`` or nothing; ``/`` divides by the next product."""
    symbols = {
        prefix + symbol: (dimension, factor * size)
        for symbol, (dimension, size, prefixed) in _SYMBOLS.items()
        for prefix, factor in (_PREFIXES.items() if prefixed else [("", 1.0)])
    } | {prefix + currency: ("currency", factor) for prefix, factor in _PREFIXES.items()}
    known = "|".join(map(re.escape, sorted(symbols, key=len, reverse=True)))
    factor = re.compile(rf"[\s*·]*({known})(?:\^?(-?\d)|([²³]))?")
    size, dimensions = 1.0, Counter[str]()
    for number, product in enumerate(text.replace("(", " ").replace(")", " ").strip().split("/")):
        at = 0
        while at < len(product.rstrip()):
            match = factor.match(product, at)
            if match is None:
                return None
            at = match.end()
            dimension, one = symbols[match[1]]
            power = int(match[2] or {"²": 2, "³": 3}.get(match[3], 1)) * (-1 if number else 1)
            size *= one**power
            dimensions[dimension] += power
        if at == 0:
            return None
    return _Unit(size, {key: power for key, power in dimensions.items() if key and power})
