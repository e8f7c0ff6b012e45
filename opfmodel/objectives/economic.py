"""Operating cost."""

from __future__ import annotations

from typing import Any

from opfmodel.model import Stage
from opfmodel.network.bounds import number_within
from opfmodel.objectives.base import Objective
from solvers import total

__all__ = ["Economic"]


class Economic(Objective):
    r"""Operating cost of all devices, with optional small weights that make it strictly convex.

    .. math::
        \ell = \sum_g c_2 (p^g)^2 + c_1 p^g + c_0
             + w_q \sum_g (q^g)^2 + w_e \sum_s e^2

    in $/h. Source: Faulwasser and Engelmann (2019), Assumption 4.1 and section 5.

    Parameters
    ----------
    reactive_weight, energy_weight
        :math:`w_q` and :math:`w_e` in $/(h p.u.²), on the network's ``base_mva``. Formulations without
        reactive power omit the reactive term.
    """

    needs = ("pg",)
    regularisation = 1e-2

    def __init__(self, reactive_weight: float = 0.0, energy_weight: float = 0.0) -> None:
        self.reactive_weight = number_within("economic: reactive_weight", reactive_weight, at_least=0)
        self.energy_weight = number_within("economic: energy_weight", energy_weight, at_least=0)

    def stage_cost(self, stage: Stage) -> Any:
        """Return the operating cost plus the small quadratic terms."""
        cost, unit = stage.operating_cost, stage.network.rebased**2
        if self.reactive_weight and stage.has("qg"):
            cost = cost + self.reactive_weight * unit * total(stage.generator.qg**2)
        if self.energy_weight and stage.has("e"):
            cost = cost + self.energy_weight * unit * total(stage.storage.e**2)
        return cost
