"""Generators."""

from __future__ import annotations

from typing import Any

import numpy as np

from opfmodel.devices.capability import active_bounds, limit_to_capability
from opfmodel.model import Device, Model, Stage
from opfmodel.network.arrays import Table
from opfmodel.network.components import Generator
from solvers import largest_by, total

__all__ = ["GeneratorDevice"]


class GeneratorDevice(Device):
    r"""Dispatchable units with ramp limits and optional capability curves.

    .. math::
        p_{min} \le p^g \le p_{max}, \quad q_{min} \le q^g \le q_{max}, \quad
        |p^g(k) - p^g(k-1)| \le \Delta\, ramp, \quad a_j p^g + b_j q^g \le c_j

    Cost: :math:`c_2 (p^g)^2 + c_1 p^g + c_0`, or the maximum over the segments of a convex
    piecewise-linear cost, and of the starts that follow from the series of its status.
    """

    component = Generator

    def declare(self, model: Model, table: Table) -> None:
        """Declare ``pg`` and ``qg``."""
        low, high = active_bounds(model, table, "p_min", "p_max")
        pg = model.dispatch(
            "generator", "pg", low, high, ramp="ramp", unit="MW", description="active generation"
        )
        qg = None
        if model.reactive:
            qg = model.dispatch(
                "generator", "qg", "q_min", "q_max", unit="MVAr", description="reactive generation"
            )
        limit_to_capability(model, table, pg, qg)
        model.inject(table.bus, p=pg, q=qg)

    def cost(self, stage: Stage) -> Any:
        """Return the cost of active generation, $/h."""
        g = stage.generator
        cost = total(g.c2 * g.pg**2 + g.c1 * g.pg + g.c0)
        owners, owner = np.unique(g.segment_owner, return_inverse=True)
        if owners.size:
            lines = g.segment_slope * g.pg[g.segment_owner] + g.segment_offset
            cost = cost + total(largest_by(owner, lines, owners.size))
        if g.start_cost.any():
            cost = cost + total(g.start_cost * g.starts / stage.step)
        return cost
