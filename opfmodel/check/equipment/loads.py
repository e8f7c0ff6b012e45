"""Loads."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from opfmodel.check.equipment.base import Equipment
from opfmodel.check.trajectories import Complex
from opfmodel.network.components import Load

if TYPE_CHECKING:
    from opfmodel.check.checker import Checker

__all__ = ["Loads"]


class Loads(Equipment):
    """Demand, of which a part may be unserved."""

    component = Load

    def __init__(self, checker: Checker) -> None:
        super().__init__(checker)
        self.items = checker.at_work(Load)

    def power(self) -> Iterator[tuple[list[str], Complex]]:
        """Yield the demand less its unserved part, which lies between zero and the demand."""
        checker, loads = self.checker, self.items
        served = np.zeros((len(loads.names), len(checker.hours)), dtype=complex)
        for letter, factor, unit in (("p", 1.0, "MW"), ("q", 1j, "MVAr")):
            demand, quantity = loads.number(letter), f"{letter}_unserved"
            served += factor * demand / checker.base
            if not (checker.has(quantity) and loads.names):
                continue
            values, family = loads.values(quantity), quantity.replace("_", " ")
            served -= factor * values / checker.base
            limits = np.minimum(demand, 0), np.maximum(demand, 0)
            checker.inside(f"{family} range", loads, values, limits, unit)
            checker.report.unserved[family] = checker.largest(family, loads.names, np.abs(values), unit)
        yield loads.each("bus"), -served
