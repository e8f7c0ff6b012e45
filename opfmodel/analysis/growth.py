"""Demand that grows in a given direction, as a device and an objective: how far the next step can go."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.model import Device, Model, Stage
from opfmodel.network.arrays import PerUnitNetwork, Table
from opfmodel.network.components import Bus
from opfmodel.objectives.base import Objective
from solvers import total

__all__ = ["DIRECTIONS", "GrowingDemand", "LargestGrowth"]

Array = npt.NDArray[np.float64]

# Fields of the buses that hold the direction, active and reactive; instance data of every solve.
DIRECTIONS = (("bus", "growth_p"), ("bus", "growth_q"))
_MOST = 1e3  # the scaling is at most this many times the direction


class GrowingDemand(Device):
    r"""Additional demand :math:`s\, \delta` at the buses, with the scaling s as a variable."""

    component = Bus

    def declare(self, model: Model, table: Table) -> None:
        """Declare ``growth`` and withdraw the additional demand from the buses."""
        one = model.build.variable("scaling", 1, model.stages, -_MOST, _MOST)
        each = one[np.zeros(len(table), dtype=np.intp)]
        p, q = (model.parameter(*key) for key in DIRECTIONS)
        model.inject(np.arange(len(table)), p=-p * each, q=-q * each)
        model.publish("bus", "growth", each, unit="", description="scaling of the additional demand")


class LargestGrowth(Objective):
    """Maximises the scaling of the additional demand.

    Parameters
    ----------
    objective
        The objective that it replaces; the problem keeps its series.
    """

    needs = ("growth",)

    def __init__(self, objective: Objective) -> None:
        self.objective = objective

    def series(self, network: PerUnitNetwork) -> Mapping[tuple[str, str], Array]:
        """Return no direction, which solves replace, and the series of the objective."""
        none = np.zeros((len(network.bus), 1))
        return {**self.objective.series(network), **dict.fromkeys(DIRECTIONS, none)}

    def stage_cost(self, stage: Stage) -> Any:
        """Return the negative scaling."""
        return -total(stage.bus.growth) / len(stage.network.bus)
