"""Shunts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from opfmodel.check.equipment.settings import Settings
from opfmodel.check.trajectories import Complex
from opfmodel.network.components import Shunt

if TYPE_CHECKING:
    from opfmodel.check.checker import Checker

__all__ = ["Shunts"]


class Shunts(Settings):
    """Power drawn at the square of the voltage."""

    component = Shunt
    settings: ClassVar[Mapping[str, tuple[str, str]]] = {"shunt_b": ("b", "MVAr")}

    def __init__(self, checker: Checker) -> None:
        super().__init__(checker)
        self.items = checker.at_work(Shunt)

    def gaps(self, field: str) -> list[float | None]:  # noqa: ARG002 - there is one
        """Return the number of steps."""
        return self.items.each("steps")

    def power(self) -> Iterator[tuple[list[str], Complex]]:
        """Yield what is injected."""
        checker, shunts = self.checker, self.items
        g, b = shunts.constant("g") / checker.base, shunts.setting("shunt_b", "b") / checker.base
        drawn = (g - 1j * b) * checker.voltage_squared(shunts.each("bus"))
        yield shunts.each("bus"), np.asarray(-drawn)
