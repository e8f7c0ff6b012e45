"""Shunts."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from opfmodel.check.equipment.base import Equipment
from opfmodel.check.trajectories import Complex
from opfmodel.network.components import Shunt

if TYPE_CHECKING:
    from opfmodel.check.checker import Checker

__all__ = ["Shunts"]


class Shunts(Equipment):
    """Power drawn at the square of the voltage."""

    component = Shunt

    def __init__(self, checker: Checker) -> None:
        super().__init__(checker)
        self.items = checker.at_work(Shunt)

    def check(self) -> None:
        """Check the range and the steps of switchable shunts."""
        self.checker.settings(
            "shunt", self.items, "shunt_b", "b", "MVAr", [s and s + 1 for s in self.items.each("steps")]
        )

    def power(self) -> Iterator[tuple[list[str], Complex]]:
        """Yield what is injected."""
        checker, shunts = self.checker, self.items
        g, b = shunts.constant("g") / checker.base, shunts.setting("shunt_b", "b") / checker.base
        drawn = (g - 1j * b) * checker.voltage_squared(shunts.each("bus"))
        yield shunts.each("bus"), np.asarray(-drawn)
