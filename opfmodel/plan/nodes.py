"""Data of base steps at the nodes of a horizon, and the start of a plan from an earlier one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from opfmodel.horizon import Horizon
from opfmodel.network.arrays import PerUnitNetwork
from solvers import Block, Cone, Solution, Start

__all__ = ["at_nodes", "moved", "over_nodes"]

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
Fields = Mapping[tuple[str, str], Array]

_REDUCE: Mapping[str, Callable[..., Array]] = {"mean": np.mean, "min": np.min, "max": np.max}


def over_nodes(
    futures: Sequence[Fields], horizon: Horizon, network: PerUnitNetwork
) -> dict[tuple[str, str], Array]:
    """Return fields ``(items, nodes)`` from those of base steps, ``(items, steps)``.

    Over the base steps of a longer node, most fields are averaged, so that energy is kept; of limits the
    tighter counts, as the field declares.

    Parameters
    ----------
    futures
        The fields of each future, from the beginning of the plan on; a single one serves all nodes.
    """
    made = {}
    for kind, field in futures[0]:
        table = network.tables[kind]
        rule = table.kind.over(field)
        values = [future[kind, field] for future in futures]
        made[kind, field] = at_nodes(values, horizon, rule)
    return made


def at_nodes(futures: Sequence[Array], horizon: Horizon, rule: str = "mean") -> Array:
    """Return values ``(items, nodes)`` from those of base steps by a rule: ``mean``, ``min`` or ``max``."""
    if horizon.is_even:
        if len(futures) == 1:
            return futures[0][:, horizon.step]
        return np.stack([futures[s][:, k] for s, k in zip(horizon.series, horizon.step, strict=True)], axis=1)
    reduce = _REDUCE[rule]
    columns = [
        reduce(futures[series if len(futures) > 1 else 0][:, first : first + length], axis=1)
        for series, first, length in zip(horizon.series, horizon.step, horizon.lengths, strict=True)
    ]
    return np.stack(columns, axis=1)


def moved(solution: Solution, horizon: Horizon, steps: int) -> Start:
    """Return a solution as the start of the problem ``steps`` base steps later.

    Every node starts from the one of the same future at that time; see :meth:`Horizon.moved`. Multipliers
    scale with probability and length.
    """
    if steps == 0:
        return solution.start()
    source = horizon.moved(steps)
    before = horizon.parent[source[horizon.roots[:1]]]  # whose end is now the measured state
    factor = horizon.weights / horizon.weights[source]

    def columns(block: Block | Cone) -> Index:
        nodes = horizon.columns(block.stages)
        if nodes is None:
            return np.arange(block.stages)
        wanted = np.where(nodes < 0, before, source[nodes])
        position = {node: column for column, node in enumerate(nodes.tolist())}
        return np.array([position.get(node, own) for own, node in enumerate(wanted.tolist())], dtype=np.intp)

    def scaled(block: Block | Cone) -> Array | float:
        nodes = horizon.columns(block.stages)
        return 1.0 if nodes is None else np.where(nodes < 0, 1.0, factor[nodes])

    return solution.rearranged(columns, scaled, moved=steps)
