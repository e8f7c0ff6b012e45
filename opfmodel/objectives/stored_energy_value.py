"""What energy left in storage is worth."""

from __future__ import annotations

from typing import Any

from opfmodel.model import Stage
from opfmodel.objectives.base import Objective
from opfmodel.objectives.checks import finite
from solvers import total

__all__ = ["StoredEnergyValue"]


class StoredEnergyValue(Objective):
    r"""Value of the energy in storage at the end of the horizon.

    .. math::
        V_f = -\pi \sum_s e_s(N)

    in $; a stage costs nothing. Without it a plan empties its storages towards the end, because
    nothing after the horizon counts. A closed loop has no end, so that its realised cost does not
    contain the term.

    Parameters
    ----------
    price
        :math:`\pi` in $/MWh.
    """

    needs = ("e_next",)

    def __init__(self, price: float) -> None:
        self.price = finite("stored energy value", "price", price)

    def stage_cost(self, stage: Stage) -> Any:  # noqa: ARG002
        """Nothing."""
        return None

    def terminal_cost(self, stage: Stage) -> Any:
        """Minus price times energy."""
        left = stage.storage.e_next[:, -1:]
        return -self.price * stage.network.base_mva * total(left)
