"""Reactive demand from a power factor."""

from __future__ import annotations

import math

from opfmodel.errors import ProfileError
from opfmodel.profiles.base import ProfileRule, Workbook

__all__ = ["PowerFactor"]


class PowerFactor(ProfileRule):
    r"""Set reactive demand by an inductive power factor: :math:`q = p \tan(\arccos \lambda)`.

    Parameters
    ----------
    value
        Power factor :math:`\lambda`, above 0 and at most 1.
    loads
        Names of loads; all by default.
    """

    def __init__(self, value: float, loads: list[str] | None = None) -> None:
        if not 0 < value <= 1:
            raise ProfileError(f"power factor: value = {value!r}: must be above 0 and at most 1")
        self.value = value
        self.loads = loads

    def apply(self, book: Workbook) -> None:
        """Replace the reactive demand."""
        ratio = math.tan(math.acos(self.value))
        for load in book.loads(self.loads):
            book.set(load, "q", ratio * book.get(load, "p"))
