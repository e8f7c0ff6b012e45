"""Convex polygons in a plane: their rules, their half-planes, and their intersections."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import accumulate

__all__ = ["HalfPlane", "Point", "clipped", "fault_of", "half_planes", "inside_box"]

Point = tuple[float, float]
HalfPlane = tuple[float, float, float]

_STRAIGHT = 1e-9  # sine of an angle that is none
_FLAT = 1e-9  # area relative to the square of the extent


def fault_of(points: Sequence[Point]) -> str:
    """Return why points are not the corners of a convex polygon in order; empty if they are.

    Corners may lie on a straight edge and may be repeated. The first one that breaks convexity is named.
    """
    corners = _distinct(points)
    extent = max(math.dist(one, other) for one in points for other in points)
    if len(corners) < 3 or abs(_area(corners)) <= _FLAT * extent**2:
        return "must enclose an area"
    side = math.copysign(1.0, _area(corners))
    turns = []
    for before, at, after in zip([corners[-1], *corners], corners, [*corners[1:], corners[0]], strict=False):
        one, other = _step(before, at), _step(at, after)
        turns.append(math.atan2(side * _cross(one, other), one[0] * other[0] + one[1] * other[1]))
    wrong = [turn < -_STRAIGHT or turn > math.pi - _STRAIGHT for turn in turns]
    if not any(wrong):
        wrong = [so_far > 2 * math.pi + 1e-6 for so_far in accumulate(turns)]  # goes round more than once
    if any(wrong):
        x, y = corners[wrong.index(True)]
        return f"must be convex, with its points in order round it: point ({x:g}, {y:g}) is not"
    return ""


def half_planes(points: Sequence[Point]) -> list[HalfPlane]:
    """Return ``(a, b, c)`` of the half-planes ``a x + b y <= c`` of a polygon, with ``a² + b² = 1``.

    Examples
    --------
    >>> half_planes([(0, 0), (2, 0), (2, 1), (0, 1)])[1]
    (1.0, 0.0, 2.0)
    """
    corners = _distinct(points)
    if _area(corners) < 0:
        corners = corners[::-1]
    made = []
    for start, end in zip(corners, corners[1:] + corners[:1], strict=True):
        x, y = _step(start, end)
        length = math.hypot(x, y)
        a, b = y / length, 0.0 - x / length
        made.append((a, b, a * start[0] + b * start[1]))
    return made


def clipped(points: Sequence[Point], plane: HalfPlane) -> list[Point]:
    """Return the part of a convex polygon in a half-plane; empty if there is none.

    Source: I. E. Sutherland and G. W. Hodgman, "Reentrant polygon clipping", Communications of the ACM
    17(1), 1974.
    """
    a, b, c = plane
    beyond = [a * x + b * y - c for x, y in points]
    made: list[Point] = []
    for i, (x, y) in enumerate(points):
        (x0, y0), before, here = points[i - 1], beyond[i - 1], beyond[i]
        if (before > 0) != (here > 0):
            t = before / (before - here)
            made.append((x0 + t * (x - x0), y0 + t * (y - y0)))
        if here <= 0:
            made.append((x, y))
    return _distinct(made)


def inside_box(points: Sequence[Point], x: Point, y: Point) -> list[Point]:
    """Return the part of a convex polygon within limits, which may be infinite."""
    made = list(points)
    for (low, high), (a, b) in ((x, (1.0, 0.0)), (y, (0.0, 1.0))):
        for sign, limit in ((1.0, high), (-1.0, low)):
            if math.isfinite(limit) and made:
                made = clipped(made, (sign * a, sign * b, sign * limit))
    return made


def _distinct(points: Sequence[Point]) -> list[Point]:
    """Return points without those that repeat the one before."""
    made = [(float(x), float(y)) for i, (x, y) in enumerate(points) if i == 0 or (x, y) != points[i - 1]]
    return made[:-1] if len(made) > 1 and made[0] == made[-1] else made


def _area(points: Sequence[Point]) -> float:
    """Return the enclosed area, positive anticlockwise, about the first point for precision."""
    x0, y0 = points[0]
    sides = zip(points, [*points[1:], points[0]], strict=True)
    return 0.5 * sum((x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0) for (x1, y1), (x2, y2) in sides)


def _step(start: Point, end: Point) -> Point:
    return end[0] - start[0], end[1] - start[1]


def _cross(one: Point, other: Point) -> float:
    return one[0] * other[1] - one[1] * other[0]
