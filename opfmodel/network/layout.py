"""Positions of buses in a drawing: their own places, or from the topology."""

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
        NetworkX graph of the buses, of at most :data:`MOST_BUSES` unless they have places.

    Notes
    -----
    Buses with places, in the attributes ``x`` and ``y`` of their nodes, keep them, in proportion; those
    without are put among their neighbours. If none has a place, the layout is Kamada and Kawai's for small
    connected networks, in which distances in the drawing are those along branches; otherwise Fruchterman
    and Reingold's with a fixed seed.
    """
    import networkx as nx

    placed = {
        bus: (float(x), float(y))
        for bus, x, y in ((bus, node.get("x"), node.get("y")) for bus, node in graph.nodes(data=True))
        if x is not None and y is not None
    }
    stated = bool(placed)
    if stated:
        _among_neighbours(graph, placed)
    elif len(graph) <= 150 and nx.is_connected(graph):
        placed = nx.kamada_kawai_layout(graph, weight=None)
    else:
        placed = nx.spring_layout(graph, seed=1)
    xs, ys = ([float(place[axis]) for place in placed.values()] for axis in (0, 1))
    spans = [max(max(values) - min(values), 1e-9) for values in (xs, ys)]
    if stated:
        spans = [max(spans)] * 2
    return {
        bus: ((x - min(xs)) / spans[0], (y - min(ys)) / spans[1])
        for bus, x, y in zip(placed, xs, ys, strict=True)
    }


def _among_neighbours(graph: Any, placed: dict[str, tuple[float, float]]) -> None:
    """Put buses without places in the middle of their neighbours, those next to placed ones first."""
    middle = _mean(list(placed.values()))
    waiting = [bus for bus in graph if bus not in placed]
    while waiting:
        beside = [bus for bus in waiting if any(other in placed for other in graph[bus])]
        found = {}
        for bus in beside or waiting[:1]:
            found[bus] = _mean([placed[other] for other in graph[bus] if other in placed] or [middle])
        placed |= found
        waiting = [bus for bus in waiting if bus not in placed]


def _mean(places: list[tuple[float, float]]) -> tuple[float, float]:
    return sum(x for x, _ in places) / len(places), sum(y for _, y in places) / len(places)
