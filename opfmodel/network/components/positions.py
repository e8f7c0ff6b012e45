"""The fields of adjustable quantities with positions, which several kinds of components share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from opfmodel.errors import ComponentError
from opfmodel.network.component import Component
from opfmodel.network.fields import is_adjustable, number

__all__ = ["check_positions", "move_cost", "steps"]


def steps(at_least: int, description: str) -> Any:
    """Declare the field that holds the number of positions or steps of an adjustable quantity."""
    return number("", None, at_least=at_least, optional=True, series=False, description=description)


def move_cost(of: str) -> Any:
    """Declare the field that holds the cost of a move; without it moves are not counted."""
    text = f"Cost of each position by which {of} moves; none: moves are neither counted nor priced."
    return number("$", None, at_least=0.0, optional=True, series=False, description=text)


def check_positions(component: Component, name: str, positions: Mapping[str, str]) -> None:
    """Raise :class:`ComponentError` unless positions, and the moves that cost, are defined.

    Parameters
    ----------
    positions
        Field with the number of positions or steps of each adjustable field.
    """
    for key, stated in positions.items():
        count, value = getattr(component, stated), getattr(component, key)
        if count is not None and count != int(count):
            raise ComponentError(name, stated, count, "must be a whole number")
        if count is not None and not is_adjustable(value):
            rule = f"{key} = {value!r} is constant; must be a range (min, max)"
            raise ComponentError(name, stated, count, rule)
    cost = getattr(component, "move_cost")  # noqa: B009 - of the kinds that have it
    if cost is not None and all(getattr(component, stated) is None for stated in positions.values()):
        rule = f"needs {' or '.join(positions.values())}, the positions that are counted"
        raise ComponentError(name, "move_cost", cost, rule)
