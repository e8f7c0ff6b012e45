"""Scaling of demand."""

from __future__ import annotations

from opfmodel.errors import ProfileError
from opfmodel.profiles.base import ProfileRule, Workbook

__all__ = ["Scale"]


class Scale(ProfileRule):
    """Multiply active and reactive demand by a factor.

    Parameters
    ----------
    factor
        The factor, at least 0.
    loads
        Names of loads; all by default.
    """

    def __init__(self, factor: float, loads: list[str] | None = None) -> None:
        if factor < 0:
            raise ProfileError(f"scale: factor = {factor!r}: must be at least 0")
        self.factor = factor
        self.loads = loads

    def apply(self, book: Workbook) -> None:
        """Scale the demand of every step."""
        for load in book.loads(self.loads):
            for key in ("p", "q"):
                book.set(load, key, self.factor * book.get(load, key))
