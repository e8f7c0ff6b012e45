"""Reduction of a set of paths to a few that stand for all."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

__all__ = ["Reduced", "fast_forward_selection"]

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


def fast_forward_selection(paths: Array, probability: Array, keep: int) -> Reduced:
    r"""Select the paths that represent all of them best, one after the other.

    Each step adds the path that lowers the Kantorovich distance
    :math:`\sum_k p_k \min_{j \in kept} \|x_k - x_j\|` most. Every path then stands for those that are
    closest to it. Source: H. Heitsch and W. Römisch, "Scenario reduction algorithms in stochastic
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
    squares = (paths**2).sum(axis=1)
    distance = np.sqrt(np.maximum(squares[:, None] + squares[None, :] - 2.0 * paths @ paths.T, 0.0))
    np.fill_diagonal(distance, 0.0)
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
    weight = np.bincount(stands_for, probability, len(kept)).astype(float)
    return Reduced(selected, weight, stands_for)
