"""The value of the final stored energy."""

from __future__ import annotations

from typing import Annotated, Any

from opfmodel.model import Stage
from opfmodel.network.bounds import number_within
from opfmodel.network.quantities import In
from opfmodel.objectives.base import Objective
from solvers import total

__all__ = ["StoredEnergyValue"]


class StoredEnergyValue(Objective):
    r"""Value of the stored energy at the end of the horizon.

    .. math::
        V_f = -\pi \sum_s e_s(N)

    in $; the stage cost is zero. Without it a plan empties its storages towards the end, because
    nothing after the horizon counts. A closed loop has no end, so its realised cost excludes the
    term.

    Parameters
    ----------
    price
        :math:`\pi` in $/MWh.
    """

    needs = ("e_next",)

    def __init__(self, price: Annotated[float, In("$/MWh")]) -> None:
        self.price = number_within("stored energy value: price", price)

    def stage_cost(self, stage: Stage) -> Any:  # noqa: ARG002
        """Return None."""
        return None

    def terminal_cost(self, stage: Stage) -> Any:
        """Return minus the price times the final energy."""
        left = stage.leaves(stage.storage.e_next)
        return -self.price * stage.network.base_mva * total(left)
