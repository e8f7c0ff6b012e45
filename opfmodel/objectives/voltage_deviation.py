"""Deviation of voltages from a target."""

from __future__ import annotations

from typing import Annotated, Any

from opfmodel.model import Stage
from opfmodel.network.bounds import number_within
from opfmodel.network.quantities import In
from opfmodel.objectives.base import Objective
from solvers import total

__all__ = ["VoltageDeviation"]


class VoltageDeviation(Objective):
    r"""Squared distance of voltage magnitudes from a target.

    .. math::
        \ell = w \sum_i (v_i - v^\ast)^2

    Parameters
    ----------
    target
        :math:`v^\ast` in p.u.
    weight
        :math:`w` in $/(h p.u.²).
    """

    needs = ("vm",)
    regularisation = 1e-2

    def __init__(self, target: Annotated[float, In("p.u.")] = 1.0, weight: float = 1.0) -> None:
        self.target = number_within("voltage deviation: target", target, at_least=0)
        self.weight = number_within("voltage deviation: weight", weight, at_least=0)

    def stage_cost(self, stage: Stage) -> Any:
        """Return the weighted squares of the distances."""
        return self.weight * total((stage.bus.vm - self.target) ** 2)
