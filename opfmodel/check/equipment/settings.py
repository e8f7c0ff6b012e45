"""Settings of the network that are decided: taps, phase shifts and shunts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from opfmodel.check.equipment.base import Equipment
from opfmodel.check.trajectories import Array, Items
from opfmodel.network.components import Branch

__all__ = ["Branches", "Settings"]

_SMALL = 1e-3  # positions; solvers count nearly so many where nothing moves


class Settings(Equipment):
    """Ranges and positions of settings, and what their moves cost.

    Attributes
    ----------
    settings
        Adjustable field and unit of each quantity.
    """

    settings: ClassVar[Mapping[str, tuple[str, str]]]

    def gaps(self, field: str) -> list[float | None]:
        """Return the number of steps between the ends of a range, None without steps."""
        raise NotImplementedError

    def check(self) -> None:
        """Check ranges, positions and the count of moves."""
        checker = self.checker
        for quantity, (field, unit) in self.settings.items():
            if not (checker.has(quantity) and self.items.names):
                continue
            values, (low, high) = self.items.values(quantity), self.items.span(field)
            family = f"{self.component.kind} {field}"
            checker.inside(f"{family} range", self.items, values, (low, high), unit)
            if checker.formulation == "soc":  # which relaxes positions
                continue
            size = (high - low) / self._steps(field)
            with np.errstate(invalid="ignore", divide="ignore"):
                away = np.abs(values - low - size * np.rint((values - low) / size))
            checker.note(f"{family} position", self.items.names, np.where(size > 0, away, 0.0), unit)
            if checker.has(f"{quantity}_moves"):
                counted = self._counted(field)
                moved = np.abs(np.diff(counted.values(quantity), axis=1)) / size[self._mask(field)]
                short = moved - counted.values(f"{quantity}_moves")[:, 1:] - _SMALL
                checker.note(f"{family} moves", counted.names if short.size else [], short, "p.u.")

    def cost_rate(self) -> Array | float:
        """Cost of the positions by which settings move."""
        rate = np.zeros(len(self.checker.hours))
        for quantity, (field, _) in self.settings.items():
            if self.checker.has(f"{quantity}_moves"):
                counted = self._counted(field)
                moved = counted.values(f"{quantity}_moves") / self.checker.hours
                rate += (counted.constant("move_cost") * moved).sum(axis=0)
        return rate

    def _steps(self, field: str) -> Array:
        return np.array([math.nan if n is None else n for n in self.gaps(field)]).reshape(-1, 1)

    def _mask(self, field: str) -> list[bool]:
        """Return which components have moves that are counted."""
        low, high = self.items.span(field)
        priced = [cost is not None for cost in self.items.each("move_cost")]
        stepped = np.isfinite(self._steps(field)) & (low < high)
        return [price and step for price, step in zip(priced, stepped[:, 0].tolist(), strict=True)]

    def _counted(self, field: str) -> Items:
        return self.items.where(self._mask(field))


class Branches(Settings):
    """Adjustable transformers; flows and limits of branches are checked with the network."""

    component = Branch
    settings: ClassVar[Mapping[str, tuple[str, str]]] = {"tap": ("tap", "p.u."), "shift": ("shift", "deg")}

    def gaps(self, field: str) -> list[float | None]:
        """Return the number of positions less one."""
        return [None if n is None else n - 1 for n in self.items.each(f"{field}_steps")]
