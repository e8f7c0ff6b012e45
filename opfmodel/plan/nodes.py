"""Data of base steps at the nodes of a horizon."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from opfmodel.horizon import Horizon
from opfmodel.network.arrays import PerUnitNetwork

__all__ = ["at_nodes", "mean_of_futures", "over_nodes"]

Array = npt.NDArray[np.float64]
Fields = Mapping[tuple[str, str], Array]


def _last(values: Array, axis: int) -> Array:
    return np.asarray(np.take(values, -1, axis))


_REDUCE: Mapping[str, Callable[..., Array]] = {"mean": np.mean, "min": np.min, "max": np.max, "last": _last}


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
    """Return values ``(items, nodes)`` from those of base steps by a rule; see :meth:`Component.over`."""
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


def mean_of_futures(fields: Fields, horizon: Horizon) -> dict[tuple[str, str], Array]:
    """Return the expected data at each moment, ``(items, moments)``, from those of the nodes."""
    nodes = horizon.regular
    moments = [np.flatnonzero(nodes.depth == depth) for depth in range(int(nodes.depth.max()) + 1)]
    return {  # moment by moment: a limit may be infinite
        key: np.column_stack([values[:, at] @ nodes.probability[at] for at in moments])
        for key, values in fields.items()
    }
