"""A price on emissions."""

from __future__ import annotations

from typing import Any

import numpy as np

from opfmodel.errors import ModelError, nearest
from opfmodel.model import Stage
from opfmodel.objectives import Objective
from solvers import largest, total

__all__ = ["Emissions"]


class Emissions(Objective):
    r"""Price on the emissions of generators above a limit.

    .. math::
        \ell = \pi \max\Bigl(0, \sum_g f_g p^g - \bar m\Bigr)

    Parameters
    ----------
    factors
        Emission factors :math:`f_g` in t/MWh by generator name; zero for all others.
    price
        Price :math:`\pi` in $/t.
    limit
        Limit :math:`\bar m` in t/h.
    """

    needs = ("pg",)

    def __init__(self, factors: dict[str, float], price: float, limit: float = 0.0) -> None:
        self.factors = factors
        self.price = price
        self.limit = limit

    def stage_cost(self, stage: Stage) -> Any:
        """Price on the emissions above the limit, $/h."""
        names = stage.network.generator.names
        for name in self.factors:
            if name not in names:
                raise ModelError(f"emissions: no generator is named {name!r}; {nearest(name, names)}")
        factors = np.array([[self.factors.get(name, 0.0)] for name in names])
        megawatts = stage.network.base_mva * stage.generator.pg
        return self.price * largest(0.0, total(factors * megawatts) - self.limit)
