"""Capability curves in MATPOWER's form: limits of both powers, and one sloped line above and one below.

The lines lead from ``(PC1, QC1MAX)`` to ``(PC2, QC2MAX)`` and from ``(PC1, QC1MIN)`` to ``(PC2, QC2MIN)``,
and narrow towards PC2. Source: MATPOWER, ``hasPQcap.m`` and ``makeApq.m``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from opfmodel.network.polygon import Point, clipped, half_planes, inside_box

__all__ = ["COLUMNS", "Trapezoid", "fault_of_columns", "polygon_of", "trapezoid_of"]

COLUMNS = ("PC1", "PC2", "QC1MIN", "QC1MAX", "QC2MIN", "QC2MAX")
_STRAIGHT = 1e-9  # of a unit normal


class Trapezoid(NamedTuple):
    """Limits of active and reactive power, and the values of :data:`COLUMNS`."""

    p: Point
    q: Point
    columns: tuple[float, ...]


def fault_of_columns(columns: Sequence[float]) -> tuple[str, str]:
    """Return the column that breaks a rule of MATPOWER, and the rule; empty if none does."""
    values = dict(zip(COLUMNS, columns, strict=True))
    for low, high in (("PC1", "PC2"), ("QC2MAX", "QC1MAX"), ("QC1MIN", "QC2MIN")):
        if not values[low] <= values[high]:
            return low, f"must be at most {high} = {values[high]:g}"
    return "", ""


def polygon_of(columns: Sequence[float], p: Point, q: Point) -> tuple[Point, ...] | None:
    """Return what is between both lines over a range of active power; None if that limits nothing."""
    pc1, pc2, *ends = columns
    if pc1 == pc2:
        return None
    one_min, one_max, two_min, two_max = ends

    def line(start: float, end: float, at: float) -> float:
        return start + (at - pc1) * (end - start) / (pc2 - pc1)

    if line(one_min, two_min, p[1]) <= q[0] and line(one_max, two_max, p[1]) >= q[1]:
        return None
    left, right = min(p[0], pc1), max(p[1], pc2)
    low, high = line(one_min, two_min, left), line(one_max, two_max, left)
    polygon = [(left, low), (right, low), (right, high), (left, high)]
    above = (one_max - two_max, pc2 - pc1, (one_max - two_max) * pc1 + (pc2 - pc1) * one_max)
    below = (two_min - one_min, pc1 - pc2, (two_min - one_min) * pc1 + (pc1 - pc2) * one_min)
    return tuple(clipped(clipped(polygon, above), below))


def trapezoid_of(polygon: Sequence[Point], p: Point, q: Point) -> Trapezoid | None:
    """Return the columns that limit power as a polygon within limits does; None if none do."""
    region = inside_box(polygon, p, q)
    if len(region) < 3:
        return None
    (left, right), (low, high) = ((min(values), max(values)) for values in zip(*region, strict=True))
    sloped = [(a, b, c) for a, b, c in half_planes(region) if min(abs(a), abs(b)) > _STRAIGHT]
    above, below = ([plane for plane in sloped if side * plane[1] > 0] for side in (1, -1))
    if max(len(above), len(below)) > 1 or any(a < 0 for a, _, _ in sloped):
        return None
    if not sloped:
        return Trapezoid((left, right), (low, high), (0.0,) * len(COLUMNS))

    def ends(planes: list[tuple[float, float, float]], limit: float) -> tuple[float, float]:
        if not planes:
            return limit, limit
        a, b, c = planes[0]
        return (c - a * left) / b, (c - a * right) / b

    (one_min, two_min), (one_max, two_max) = ends(below, low), ends(above, high)
    columns = (left, right, one_min, one_max, two_min, two_max)
    return Trapezoid((left, right), (low, high), columns) if all(map(math.isfinite, columns)) else None
