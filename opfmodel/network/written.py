"""Values of component fields as they are written in files, with units, as plain numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import Field
from typing import Any

from opfmodel.errors import ComponentError, UnitError
from opfmodel.network.component import Component
from opfmodel.network.costs import COEFFICIENT_UNITS, POINT_UNITS
from opfmodel.network.quantities import Basis, is_quantity, read_quantity

__all__ = ["without_units"]


def without_units(
    kind: type[Component], name: str, values: Mapping[str, Any], basis: Basis
) -> dict[str, Any]:
    """Return values by field with the numbers for which texts such as ``200 MWh`` stand.

    Other values are unchanged, valid or not.

    Raises
    ------
    ComponentError
        A unit is not that of its field.
    """
    known = kind.fields()

    def number(key: str, value: Any, unit: str) -> Any:
        if not is_quantity(value):
            return value
        try:
            return read_quantity(value, unit, basis)
        except UnitError as fault:
            raise ComponentError(name, key, value, str(fault)) from None

    def plain(key: str, value: Any, item: Field[Any]) -> Any:
        form, unit = item.metadata["form"], item.metadata["unit"]
        if form in ("span", "adjustable") and isinstance(value, list):
            return [number(key, end, unit) for end in value]
        if form in ("number", "span", "adjustable"):
            return number(key, value, unit)
        if form == "cost" and isinstance(value, Mapping):
            return {part: cost(key, part, inner) for part, inner in value.items()}
        if form == "points" and isinstance(value, list):
            return [coordinates(key, point, item.metadata["units"]) for point in value]
        if form == "weights" and isinstance(value, Mapping):
            return {member: number(key, weight, unit) for member, weight in value.items()}
        return value

    def coordinates(key: str, point: Any, units: Sequence[str]) -> Any:
        if not isinstance(point, list) or len(point) != len(units):
            return point
        return [number(key, end, unit) for end, unit in zip(point, units, strict=True)]

    def cost(key: str, part: str, value: Any) -> Any:
        if part == "points" and isinstance(value, list):
            return [coordinates(key, point, POINT_UNITS) for point in value]
        return number(key, value, COEFFICIENT_UNITS[part]) if part in COEFFICIENT_UNITS else value

    return {key: plain(key, value, known[key]) if key in known else value for key, value in values.items()}
