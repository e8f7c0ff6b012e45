"""Repeating patterns."""

from __future__ import annotations

import numpy as np

from opfmodel.errors import ProfileError
from opfmodel.profiles import ProfileRule
from opfmodel.profiles.base import Workbook

__all__ = ["Repeat"]


class Repeat(ProfileRule):
    """Repeat a pattern, such as a daily profile.

    Parameters
    ----------
    component, field
        Component and field of the series, such as the ``driving`` of a fleet.
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
        book.get(self.component, self.field)  # raises an error for unknown names
        book.set(self.component, self.field, np.resize(self.values, book.steps))
