"""The copperplate formulation."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from opfmodel.formulations.base import Formulation, shunts
from opfmodel.model import Model
from opfmodel.network.arrays import PerUnitNetwork

__all__ = ["Copperplate"]


class Copperplate(Formulation):
    """One active balance per island, without a network; linear.

    Neglects branches, losses, reactive power and voltages; shunts draw their power at 1 p.u. This is
    economic dispatch, and a lower bound on lossless formulations.
    """

    name = "copperplate"
    reactive = False
    publishes = ()

    def zones(self, network: PerUnitNetwork) -> npt.NDArray[np.intp]:
        """Return the island of each bus."""
        return network.island

    def declare(self, model: Model) -> None:
        """Declare the power drawn by shunts, and nothing else."""
        shunts(model, 1.0)
