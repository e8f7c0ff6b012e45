"""The check of capability curves, which several kinds of components have."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from opfmodel.check.trajectories import Array, Items

if TYPE_CHECKING:
    from opfmodel.check.checker import Checker

__all__ = ["check_capability"]


def check_capability(
    checker: Checker, units: Items, active: str, reactive: str, running: npt.ArrayLike = True
) -> None:
    """Check that the power of units is within their polygons, or their range without reactive power.

    Parameters
    ----------
    running
        Which units run, ``(items, 1)`` or ``(items, stages)``.
    """
    limited = np.array([points is not None for points in units.each("capability")], dtype=bool)
    curved = units.where(limited)
    if not curved.names:
        return
    p = curved.values(active)
    q = curved.values(reactive) if checker.reactive else None
    each = zip(curved.each("capability"), p, p if q is None else q, strict=True)
    excess = np.array([_beyond(np.array(c, dtype=float), at, r, flat=q is None) for c, at, r in each])
    at_work = (curved.status() > 0) & np.broadcast_to(running, (limited.size, p.shape[1]))[limited]
    checker.note(f"{units.kind} capability", curved.names, np.where(at_work, excess, 0.0), "MVA")


def _beyond(corners: Array, p: Array, q: Array, *, flat: bool) -> Array:
    """Return the largest distance of points from the edges of a polygon beyond which they lie, else <= 0."""
    if flat:
        low, high = corners[:, 0].min(), corners[:, 0].max()
        return np.asarray(np.maximum(low - p, p - high))
    at = corners[:, 0] + 1j * corners[:, 1]
    edges = np.roll(at, -1) - at
    about = at - at[0]
    inside = np.sign((about.conj() * np.roll(about, -1)).imag.sum())  # 1 if the corners go anticlockwise
    edges, at = edges[edges != 0], at[edges != 0]
    along = (p + 1j * q)[:, None] - at
    return np.asarray((-inside * (edges.conj() * along).imag / np.abs(edges)).max(axis=1))
