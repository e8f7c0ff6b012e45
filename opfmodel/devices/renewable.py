"""Renewable generation."""

from __future__ import annotations

from typing import Any

import numpy as np

from opfmodel.devices.capability import active_bounds, limit_to_capability
from opfmodel.model import Device, Model, Stage
from opfmodel.network.arrays import Array, Table
from opfmodel.network.components import Renewable
from solvers import Expression, total

__all__ = ["RenewableDevice"]


class RenewableDevice(Device):
    r"""Available power, of which a part may be curtailed, within a power factor, a rating and a curve.

    .. math::
        0 \le p \le \bar p, \quad q_{min} \le q \le q_{max}, \quad |q| \le \tan(\arccos \varphi)\, p, \quad
        p^2 + q^2 \le s^2, \quad a_j p + b_j q \le c_j

    Cost: the price of curtailment times :math:`\bar p - p`.
    """

    component = Renewable

    def declare(self, model: Model, table: Table) -> None:
        """Declare ``renewable_p``, ``renewable_q`` and ``renewable_curtailed``."""
        upper = "available" if model.reactive else _most
        low, high = active_bounds(model, table, 0.0, upper)
        p = model.variable(
            "renewable", "renewable_p", low, high, unit="MW", description="renewable generation"
        )
        model.publish(
            "renewable",
            "renewable_curtailed",
            model.field("renewable", "available") - p,
            unit="MW",
            description="available power not generated",
        )
        q = None
        if model.reactive:
            q = model.variable(
                "renewable",
                "renewable_q",
                lambda t: np.maximum(t.q_min, -_permitted(t)),
                lambda t: np.minimum(t.q_max, _permitted(t)),
                unit="MVAr",
                description="reactive power of renewables",
            )
            model.regularise(q)  # it costs nothing
            self._limit(model, table, p, q)
        model.inject(table.bus, p=p, q=q)

    @staticmethod
    def _limit(model: Model, table: Table, p: Expression, q: Expression) -> None:
        """Limit reactive power with respect to active power."""
        slope = _slope(table)
        limited = np.flatnonzero(np.isfinite(slope) & (slope > 0.0))
        if limited.size:

            def most(t: Table) -> Array:  # where nothing is available, the bounds say all
                return np.where(t.available[limited] > 0.0, 0.0, np.inf)

            share = slope[limited] * p[limited]
            model.rows("renewable", "renewable_lagging", q[limited] - share, -np.inf, most)
            model.rows("renewable", "renewable_leading", -q[limited] - share, -np.inf, most)
        circle = np.flatnonzero(np.isfinite(table.rating))
        if circle.size:
            rating = model.field("renewable", "rating")[circle]
            model.build.cone("renewable_rating", rating, p[circle], q[circle])
        limit_to_capability(model, table, p, q)

    def cost(self, stage: Stage) -> Any:
        """Return the cost of curtailment, $/h."""
        r = stage.renewable
        return total(r.curtail_cost * r.renewable_curtailed)


def _slope(table: Table) -> Array:
    """Return the maximum of reactive per active power, ``(items, 1)``; infinite without a power factor."""
    factor = table.power_factor
    return np.where(np.isfinite(factor), np.tan(np.arccos(np.minimum(factor, 1.0))), np.inf)


def _permitted(table: Table) -> Array:
    """Return the reactive power that the power factor permits with all available power."""
    slope = _slope(table)
    with np.errstate(invalid="ignore"):  # infinity times zero, without a power factor
        return np.where(np.isfinite(slope), slope * table.available, np.inf)


def _most(table: Table) -> Array:
    """Return the maximum active power if no reactive power shares the rating."""
    return np.asarray(np.minimum(table.available, table.rating))
