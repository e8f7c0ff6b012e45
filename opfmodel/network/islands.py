"""Islands: the groups of buses that branches connect."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from typing import TypeVar

__all__ = ["connected"]

Node = TypeVar("Node", bound=Hashable)


def connected(nodes: Iterable[Node], pairs: Iterable[Sequence[Node]]) -> list[list[Node]]:
    """Return the groups of nodes that pairs connect, in the order of their first nodes.

    Nodes that only pairs name follow the others.

    Every problem asks for them, and networkx takes longer to import than a small problem to solve.

    Examples
    --------
    >>> connected("abcde", [("d", "b"), ("e", "d")])
    [['a'], ['b', 'd', 'e'], ['c']]
    """
    beside: dict[Node, list[Node]] = {node: [] for node in nodes}
    for one, other in pairs:
        beside.setdefault(one, []).append(other)
        beside.setdefault(other, []).append(one)
    seen: set[Node] = set()
    groups = []
    for node in beside:
        if node in seen:
            continue
        seen.add(node)
        group = [node]
        for member in group:  # which grows
            found = dict.fromkeys(other for other in beside[member] if other not in seen)
            seen.update(found)
            group += found
        groups.append(group)
    return groups
