"""Cost functions of active-power generation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

from opfmodel.errors import ComponentError
from opfmodel.network.bounds import LARGEST, bounded, is_number

__all__ = ["COEFFICIENT_UNITS", "POINT_UNITS", "Cost", "PiecewiseLinear", "Polynomial"]

COEFFICIENT_UNITS = {"c2": "$/MW^2h", "c1": "$/MWh", "c0": "$/h"}
"""Units of the coefficients of a :class:`Polynomial`."""
POINT_UNITS = ("MW", "$/h")
"""Units of a point of a :class:`PiecewiseLinear` cost."""


class Cost:
    """Convex cost of active-power generation, $/h."""

    @property
    def numbers(self) -> Mapping[str, float]:
        """Numbers that may have a time series, by name, in the units of :data:`COEFFICIENT_UNITS`."""
        raise NotImplementedError

    def check_types(self, name: str, key: str) -> None:
        """Raise :class:`ComponentError` unless the parameters are numbers."""
        raise NotImplementedError

    def check(self, name: str, key: str) -> None:
        """Raise :class:`ComponentError` unless the cost is valid and convex."""
        raise NotImplementedError


@dataclass(frozen=True)
class Polynomial(Cost):
    """Quadratic cost ``c2 p^2 + c1 p + c0``, with p in MW.

    Parameters
    ----------
    c2, c1, c0
        Coefficients in $/MW²h, $/MWh and $/h, with ``c2 >= 0``.
    """

    c2: float = 0.0
    c1: float = 0.0
    c0: float = 0.0

    @property
    def numbers(self) -> Mapping[str, float]:
        """The coefficients."""
        return {"c2": self.c2, "c1": self.c1, "c0": self.c0}

    def check_types(self, name: str, key: str) -> None:
        """Raise :class:`ComponentError` unless the coefficients are numbers."""
        if not all(is_number(c) for c in (self.c2, self.c1, self.c0)):
            raise ComponentError(name, key, self, "the coefficients must be finite numbers")

    def check(self, name: str, key: str) -> None:
        """Raise :class:`ComponentError` unless the coefficients are finite and ``c2 >= 0``."""
        if not all(map(bounded, (self.c2, self.c1, self.c0))):
            rule = f"the coefficients must be finite numbers of at most {LARGEST:g}"
            raise ComponentError(name, key, self, rule)
        if self.c2 < 0:
            raise ComponentError(name, key, self, "must be convex: c2 must be at least 0")


@dataclass(frozen=True)
class PiecewiseLinear(Cost):
    """Convex piecewise-linear cost through given points; the outer segments extend beyond the ends.

    Time series may replace the slopes of its segments, ``slope_1``, ``slope_2``, ...: the MW of the points
    and the cost at the first one stay, and the cost is continuous. Successive segments of one slope are one.

    Parameters
    ----------
    points
        At least two points ``((p, cost), ...)`` in MW and $/h, with increasing p and nondecreasing slope.
    """

    points: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", tuple(tuple(p) for p in self.points))

    @property
    def slopes(self) -> list[float]:
        """Slope of each segment, $/MWh."""
        return [(c1 - c0) / (p1 - p0) for (p0, c0), (p1, c1) in pairwise(self.points)]

    @property
    def segments(self) -> list[tuple[float, float]]:
        """``(slope, offset)`` of each distinct segment; the cost is the maximum over these lines."""
        return [(slope, c - slope * p) for slope, (p, c) in self.bends]

    @property
    def bends(self) -> list[tuple[float, tuple[float, float]]]:
        """Slope of each distinct segment, and the point where it begins."""
        bends: list[tuple[float, tuple[float, float]]] = []
        for point, slope in zip(self.points[:-1], self.slopes, strict=True):
            if not bends or not math.isclose(slope, bends[-1][0], rel_tol=1e-12, abs_tol=1e-12):
                bends.append((slope, point))
        return bends

    @property
    def numbers(self) -> Mapping[str, float]:
        """Slope of each distinct segment, $/MWh: ``slope_1``, ``slope_2``, ...

        Examples
        --------
        >>> PiecewiseLinear(((0, 0), (10, 200), (30, 900))).numbers
        {'slope_1': 20.0, 'slope_2': 35.0}
        """
        if any(a[0] >= b[0] for a, b in pairwise(self.points)):
            return {}  # invalid, of a component out of service
        return {f"slope_{number}": slope for number, (slope, _) in enumerate(self.bends, 1)}

    def check_types(self, name: str, key: str) -> None:
        """Raise :class:`ComponentError` unless every point is a pair of numbers."""
        if any(len(point) != 2 for point in self.points):
            raise ComponentError(name, key, self, "needs at least two points (MW, $/h)")
        if not all(is_number(v) for point in self.points for v in point):
            raise ComponentError(name, key, self, "the points must be finite numbers")

    def check(self, name: str, key: str) -> None:
        """Raise :class:`ComponentError` unless the points are ordered and define a convex cost."""
        if len(self.points) < 2:
            raise ComponentError(name, key, self, "needs at least two points (MW, $/h)")
        if not all(bounded(v) for point in self.points for v in point):
            raise ComponentError(name, key, self, f"the points must be finite numbers of at most {LARGEST:g}")
        if any(a[0] >= b[0] for a, b in pairwise(self.points)):
            raise ComponentError(name, key, self, "the points must be in order of increasing MW")
        if not all(map(bounded, self.slopes)):
            raise ComponentError(name, key, self, f"the slopes must be at most {LARGEST:g} $/MWh")
        for first, second in pairwise(self.slopes):
            if second < first - 1e-9 * max(1.0, abs(first)):
                raise ComponentError(
                    name, key, self, f"must be convex: slope {second:g} follows {first:g} $/MWh"
                )
