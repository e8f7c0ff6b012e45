"""How far the price of a horizon's end reaches back, and the overlap that makes the least work."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solvers.program import Array, Instance
from solvers.solve import Session
from solvers.windows.piece import End, Piece
from solvers.windows.seam import Seam
from solvers.windows.window import Window

__all__ = ["best_overlap", "influence"]

_SAMPLES = 24  # stages whose prices are averaged


def influence(window: Window, session: Session, instance: Instance) -> Array | None:
    r"""Return what the price of the end changes at each distance from it.

    The window is solved with an end of no value and with an end of the mean price. The change of seam
    variables :math:`x_k` is weighed by their prices :math:`c_k` and related to their range:

    .. math:: d_k = \frac{\sum |c_k \Delta x_k|}{\sum |c_k| (u_k - l_k)}

    Returns
    -------
    ndarray or None
        The largest :math:`d_k` at distance ``o`` or farther from the end, for ``o = 1, 2, ...``; None if the
        window has no solution with one of the two ends.
    """
    staged, last = window.staged, window.span.last
    piece = Piece.of(window, instance)
    free = session.solve(piece.posed(None, End.free(piece.behind)))
    if not free.status.is_optimal:
        return None
    seams = [Seam.after(staged, stage, instance) for stage in range(last - 1)]
    local = [seam.inside(window) for seam in seams]
    chosen = np.unique(np.linspace(0, len(local) - 1, _SAMPLES).astype(int))
    prices = [local[at].price(free.x, free.lam_g) for at in chosen]
    prices = [price for price in prices if price.size == piece.behind]
    mean = np.mean(prices, axis=0) if prices else np.zeros(piece.behind)
    priced = session.solve(piece.posed(None, replace(End.free(mean.size), price=mean)))
    if not priced.status.is_optimal:
        return None
    changes = np.zeros(len(seams))
    for stage, (seam, inside) in enumerate(zip(seams, local, strict=True)):
        at = window.position(seam.variables)
        width = np.minimum(piece.data.upper[at] - piece.data.lower[at], 1.0 + 2.0 * np.abs(free.x[at]))
        price = np.abs(inside.price(free.x, free.lam_g))
        moved = np.abs(priced.x[at] - free.x[at])
        changes[stage] = (price @ moved) / max(float(price @ width), 1e-12)
    return np.maximum.accumulate(changes)[::-1]


def best_overlap(change: Array, length: int) -> int | None:
    """Return the overlap ``o`` that minimises ``(length + o) / -log(change)``, the work per digit.

    Returns
    -------
    int or None
        None if the change does not fall below a half within the window.
    """
    overlap = np.arange(1, change.size + 1)
    falls = change < 0.5
    if not falls.any():
        return None
    work = (length + overlap[falls]) / -np.log(np.maximum(change[falls], 1e-8))
    return int(overlap[falls][np.argmin(work)])
