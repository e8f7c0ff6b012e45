"""Devices that miss their set-points."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from opfmodel.errors import ModelError
from opfmodel.plan import Plan
from opfmodel.simulation import PowerFlow
from opfmodel.simulation.plants.base import Values

__all__ = ["Inexact"]


class Inexact(PowerFlow):
    r"""Power flow in which units and storages miss their active set-points.

    .. math::
        \tilde p = (1 + \sigma \eta)\, \hat p

    with independent standard normal :math:`\eta`, drawn from the seed and the step alone.

    Parameters
    ----------
    deviation
        Standard deviation :math:`\sigma`, as a share of the set-point.
    seed
        Seed of the random numbers.
    participation
        Participation factors of generators in the slack; in proportion to ``p_max`` by default.
    """

    def __init__(
        self, deviation: float = 0.02, seed: int = 1, participation: Mapping[str, float] | None = None
    ) -> None:
        super().__init__(participation)
        if not 0 <= deviation < 1:
            raise ModelError(f"inexact: deviation = {deviation!r}: must be a share, at least 0 and below 1")
        self.deviation = deviation
        self.seed = seed

    def aims(self, plan: Plan, planned: Values) -> Values:
        """The set-points with random errors."""
        rng = np.random.default_rng([self.seed, plan.time])
        missed = {}
        for key in (("generator", "pg"), ("storage", "ps")):
            if key in planned:
                errors = rng.standard_normal(planned[key].shape)
                missed[key] = (1.0 + self.deviation * errors) * planned[key]
        return planned | missed
