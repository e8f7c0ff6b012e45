"""Tracking of a state of charge."""

from __future__ import annotations

from typing import Any

from opfmodel.errors import ModelError
from opfmodel.model import Stage
from opfmodel.objectives.base import Objective
from opfmodel.objectives.checks import not_negative
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
        if not_negative("state-of-charge tracking", "share", share) > 1.0:
            raise ModelError(f"state-of-charge tracking: share = {share!r}: must lie between 0 and 1")
        self.share = float(share)
        self.weight = not_negative("state-of-charge tracking", "weight", weight)

    def stage_cost(self, stage: Stage) -> Any:
        """Return the weighted squares of the distances at the start of the stage."""
        storage = stage.storage
        weight = self.weight * stage.network.rebased**2
        return weight * total((storage.e - self.share * storage.energy) ** 2)
