"""Active losses of the branches."""

from __future__ import annotations

from typing import Annotated, Any

from opfmodel.model import Stage
from opfmodel.network.bounds import number_within
from opfmodel.network.quantities import In
from opfmodel.objectives.base import Objective
from solvers import total

__all__ = ["LossMinimisation"]


class LossMinimisation(Objective):
    r"""Active power lost in branches and DC lines, at a price.

    .. math::
        \ell = \pi \sum_b (p^f_b + p^t_b)

    in $/h, over branches and DC lines. In a lossless formulation (``dc``), branches add nothing; without DC
    lines, every dispatch is optimal.

    Parameters
    ----------
    price
        :math:`\pi` in $/MWh.
    """

    needs = ("pf", "pt")
    regularisation = 1e-2

    def __init__(self, price: Annotated[float, In("$/MWh")] = 1.0) -> None:
        self.price = number_within("loss minimisation: price", price, at_least=0)

    def stage_cost(self, stage: Stage) -> Any:
        """Return the price times the losses."""
        branch = stage.branch
        lost = total(branch.pf + branch.pt)
        if len(stage.network.tables["dc_line"]):
            lost = lost + total(stage.dc_line.dc_line_loss)
        return self.price * stage.network.base_mva * lost
