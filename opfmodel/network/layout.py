"""Positions of buses in a drawing, from the topology alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

__all__ = ["MOST_BUSES", "positions"]

MOST_BUSES = 3000  # the layout takes seconds from there on


def positions(graph: Any) -> Mapping[str, tuple[float, float]]:
    """Position of each bus, in a square from 0 to 1.

    Parameters
    ----------
    graph
        NetworkX graph of the buses, of at most :data:`MOST_BUSES`.

    Notes
    -----
    Kamada and Kawai's layout for small connected networks, in which distances in the drawing are those
    along branches; otherwise Fruchterman and Reingold's with a fixed seed.
    """
    import networkx as nx

    small = len(graph) <= 150 and nx.is_connected(graph)
    placed = nx.kamada_kawai_layout(graph, weight=None) if small else nx.spring_layout(graph, seed=1)
    xs, ys = ([float(place[axis]) for place in placed.values()] for axis in (0, 1))
    spans = [max(max(values) - min(values), 1e-9) for values in (xs, ys)]
    return {
        bus: ((x - min(xs)) / spans[0], (y - min(ys)) / spans[1])
        for bus, x, y in zip(placed, xs, ys, strict=True)
    }
