"""Reduction of a set of paths to a few that stand for all, or to a tree."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

__all__ = ["Branched", "Reduced", "backward_construction", "fast_forward_selection"]

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]


class Reduced(NamedTuple):
    """A selection of paths.

    Attributes
    ----------
    kept
        Positions of the selected paths, in the order of selection.
    probability
        Probability of each, with that of the paths for which it stands.
    stands_for
        For every path, the position in ``kept`` of the one that stands for it.
    """

    kept: Index
    probability: Array
    stands_for: Index


class Branched(NamedTuple):
    """A tree made of paths.

    Attributes
    ----------
    carried
        Path whose values each leaf has in each stretch, of shape ``(leaves, stretches)``.
    probability
        Probability of each leaf.
    stands_for
        For every path, the leaf that stands for it.
    """

    carried: Index
    probability: Array
    stands_for: Index


def fast_forward_selection(paths: Array, probability: Array, keep: int) -> Reduced:
    r"""Select the paths that represent all of them best, one after the other.

    Each step adds the path that lowers the Kantorovich distance
    :math:`\sum_k p_k \min_{j \in kept} \|x_k - x_j\|` most. It then stands for itself and for those others
    that are closest to it. Source: H. Heitsch and W. Römisch, "Scenario reduction algorithms in stochastic
    programming", Computational Optimization and Applications 24, 2003, algorithm 2.4.

    Parameters
    ----------
    paths
        Points of shape ``(paths, dimensions)``.
    probability
        Probability of each path.
    keep
        Number of paths to select, at most that of the paths.

    Examples
    --------
    >>> points = np.array([[0.0], [1.0], [10.0]])
    >>> fast_forward_selection(points, np.full(3, 1 / 3), 2).stands_for.tolist()
    [0, 0, 1]
    """
    distance = _distances(paths)
    nearest = np.full(len(paths), np.inf)  # distance of each path to the closest selected one
    kept: list[int] = []
    for _ in range(keep):
        cost = probability @ np.minimum(nearest[:, None], distance)
        cost[kept] = np.inf
        chosen = int(np.argmin(cost))
        kept.append(chosen)
        nearest = np.minimum(nearest, distance[:, chosen])
    selected = np.array(kept, dtype=np.intp)
    stands_for = np.argmin(distance[:, selected], axis=1)
    stands_for[selected] = np.arange(keep)  # also if another is equal: none is without probability
    weight = np.bincount(stands_for, probability, len(kept)).astype(float)
    return Reduced(selected, weight, stands_for)


def backward_construction(
    stretches: Sequence[Array], probability: Array, children: Sequence[int]
) -> Branched:
    r"""Make a tree of paths that splits at the beginning of every stretch, from the last split to the first.

    The last split makes one node for each leaf: paths that :func:`fast_forward_selection` chooses to stand
    for all. Then, from the last split but one to the first, with the next split at time :math:`t`: among the
    paths :math:`j` of the next split, with probabilities :math:`p_j`, the same selection chooses those that
    become nodes, with the distance :math:`\|x_j - x_k\|_t` of the values before :math:`t`. Every node
    :math:`k` gets exactly as many children as are asked for: its own path, and others by the assignment of
    least :math:`\sum_j p_j \|x_j - x_{k(j)}\|_t`. Before :math:`t` they all carry the values of :math:`k`;
    its probability is the sum of theirs.

    Source: H. Heitsch and W. Römisch, "Scenario tree modeling for multistage stochastic programs",
    Mathematical Programming 118, 2009, whose backward construction reduces and joins paths in the same order
    and by the same distances. It makes as many nodes as an error allows, each with the children that are
    closest to it; here their numbers are given, because they are the shape of the program.

    Parameters
    ----------
    stretches
        Values of the paths from each split to the next, of shape ``(paths, dimensions)`` each.
    probability
        Probability of each path.
    children
        Number of children of every node at each split; their product is at most the number of paths.

    Returns
    -------
    Branched
        Leaves with the same ancestors follow each other, and the children of a node are in the order of their
        totals until they split.

    Examples
    --------
    >>> early, late = np.array([[0.0], [0.1], [5.0], [5.1]]), np.array([[1.0], [-1.0], [1.0], [-1.0]])
    >>> backward_construction([early, late], np.full(4, 0.25), [2, 2]).carried.tolist()
    [[0, 1], [0, 0], [2, 3], [2, 2]]
    """
    counts = np.cumprod(children)
    reduced = fast_forward_selection(np.hstack(stretches), probability, counts[-1])
    chosen, weight = reduced.kept, reduced.probability  # the nodes of a split
    carried = chosen[:, None]  # of each leaf, by split
    node = np.arange(chosen.size)  # of each leaf
    for split in range(len(children) - 2, -1, -1):
        points = np.hstack(stretches[: split + 1])[chosen]
        kept = fast_forward_selection(points, weight, counts[split]).kept
        group = _allotted(weight[:, None] * _distances(points)[:, kept], kept)
        chosen, weight, node = chosen[kept], np.bincount(group, weight).astype(float), group[node]
        carried = np.column_stack([chosen[node], carried])
    totals = [values[path].sum(axis=1) for values, path in zip(stretches, carried.T, strict=True)]
    keys: list[npt.NDArray[Any]] = [
        key
        for pair in zip(totals, carried.T, strict=True)
        for key in pair  # equal nodes stay apart
    ]
    order = np.lexsort(keys[::-1])
    return Branched(carried[order], reduced.probability[order], np.argsort(order)[reduced.stands_for])


def _allotted(cost: Array, kept: Index) -> Index:
    """Return the selected one, by position, to which each is allotted at least cost, equally many to each."""
    from scipy.optimize import linear_sum_assignment  # a large module, for trees alone

    each = len(cost) // kept.size - 1  # besides itself
    others = np.setdiff1d(np.arange(len(cost)), kept)
    group = np.empty(len(cost), dtype=np.intp)
    group[kept] = np.arange(kept.size)
    own, place = linear_sum_assignment(np.repeat(cost[others], each, axis=1))
    group[others[own]] = place // each
    return group


def _distances(points: Array) -> Array:
    """Return the Euclidean distances of all pairs of points."""
    squares = (points**2).sum(axis=1)
    distance = np.sqrt(np.maximum(squares[:, None] + squares[None, :] - 2.0 * points @ points.T, 0.0))
    np.fill_diagonal(distance, 0.0)
    return np.asarray(distance)
