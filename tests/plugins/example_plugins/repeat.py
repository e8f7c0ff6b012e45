"""Patterns that repeat."""

from __future__ import annotations

import numpy as np

from opfmodel.errors import ProfileError
from opfmodel.profiles import ProfileRule
from opfmodel.profiles.base import Workbook

__all__ = ["Repeat"]


class Repeat(ProfileRule):
    """Repeat a pattern: the same day again and again.

    Parameters
    ----------
    component, field
        Whose number it is, for instance the ``driving`` of a fleet.
    values
        The pattern, in the physical unit of the field.
    """

    def __init__(self, component: str, field: str, values: list[float]) -> None:
        if not values:
            raise ProfileError(f"the pattern of {component}.{field} has no values")
        self.component = component
        self.field = field
        self.values = values

    def apply(self, book: Workbook) -> None:
        """Replace the series of the field."""
        book.get(self.component, self.field)  # says what is wrong with the names
        book.set(self.component, self.field, np.resize(self.values, book.steps))
