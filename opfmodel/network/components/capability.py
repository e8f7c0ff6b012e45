"""The field ``capability`` that several kinds of components share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from opfmodel.errors import ComponentError
from opfmodel.network.fields import points
from opfmodel.network.polygon import inside_box

__all__ = ["capability", "check_capability"]

_SLACK = 1e-9  # relative to the largest coordinate; rounding


def capability(power: str = "power") -> Any:
    """Declare the field, a convex polygon of active and reactive power."""
    return points(
        f"Capability curve: corners of a convex polygon of active and reactive {power} in order, at least 3; "
        "without reactive power, its range of active power counts. None for no curve."
    )


def check_capability(
    name: str, polygon: Sequence[tuple[float, float]] | None, p: tuple[float, float], q: tuple[float, float]
) -> None:
    """Raise :class:`ComponentError` if no point of the polygon is within the limits of p and q."""
    if polygon is None:
        return
    slack = _SLACK * max(abs(v) for point in polygon for v in point)
    p, q = ((low - slack, high + slack) for low, high in (p, q))
    if not inside_box(polygon, p, q):
        raise ComponentError(name, "capability", polygon, "no point of it is within the limits of p and q")
