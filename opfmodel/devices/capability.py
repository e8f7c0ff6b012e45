"""Capability curves: rows that generators, storages and renewables have in common."""

from __future__ import annotations

import numpy as np

from opfmodel.model import Bound, Model
from opfmodel.model.declared import resolved
from opfmodel.network.arrays import Array, Table
from solvers import Expression

__all__ = ["active_bounds", "limit_to_capability"]


def active_bounds(model: Model, table: Table, lower: Bound, upper: Bound) -> tuple[Bound, Bound]:
    """Return the bounds of active power, within the range of each curve if there is no reactive power."""
    if model.reactive or not table.capability_owner.size:
        return lower, upper

    def least(t: Table) -> Array:
        return np.asarray(np.maximum(resolved(t, lower), np.where(t.status > 0, t.capability_p_min, -np.inf)))

    def most(t: Table) -> Array:
        return np.asarray(np.minimum(resolved(t, upper), np.where(t.status > 0, t.capability_p_max, np.inf)))

    return least, most


def limit_to_capability(model: Model, table: Table, p: Expression, q: Expression | None) -> None:
    """State the rows ``a p + b q <= c`` of all curves, one per edge, of the units that are in service."""
    owner = table.capability_owner
    if q is None or not owner.size:
        return

    def most(t: Table) -> Array:
        return np.where(t.status[owner] > 0, t.capability_limit, np.inf)

    kind = table.kind.kind
    power = table.capability_p * p[owner] + table.capability_q * q[owner]
    model.rows(kind, f"{kind}_capability", power, -np.inf, most)
