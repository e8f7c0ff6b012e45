"""Tracking of a state of charge."""

from __future__ import annotations

from typing import Any

from opfmodel.model import Stage
from opfmodel.network.bounds import number_within
from opfmodel.objectives.base import Objective
from solvers import total

__all__ = ["StateOfChargeTracking"]


class StateOfChargeTracking(Objective):
    r"""Squared distance of stored energy from a share of the capacity.

    .. math::
        \ell_b = c \sum_s (e_s - \sigma\, \bar e_s)^2

    with energies in p.u.·h on the network's ``base_mva``. The cost leaves generation undetermined, so
    several dispatches are optimal; this is the point of the comparison in Faulwasser and Engelmann
    (2019), section 5.

    Parameters
    ----------
    share
        :math:`\sigma`, between 0 and 1.
    weight
        :math:`c` in $/(h (p.u.·h)²).
    """

    needs = ("e",)

    def __init__(self, share: float = 0.5, weight: float = 1.0) -> None:
        self.share = number_within("state-of-charge tracking: share", share, at_least=0, at_most=1)
        self.weight = number_within("state-of-charge tracking: weight", weight, at_least=0)

    def stage_cost(self, stage: Stage) -> Any:
        """Return the weighted squares of the distances at the start of the stage."""
        storage = stage.storage
        weight = self.weight * stage.network.rebased**2
        return weight * total((storage.e - self.share * storage.energy) ** 2)
