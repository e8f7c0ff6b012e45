"""Starting points of a plan: an earlier plan, moved in time, or the plan for the expected future."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from opfmodel.horizon import Horizon
from solvers import Block, Cone, Program, Solution, Start

__all__ = ["grown", "lifted", "moved"]

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]


def moved(solution: Solution, before: Horizon, after: Horizon, steps: int) -> Start:
    """Return a solution as the start of the same problem ``steps`` base steps later.

    Every node starts from the one of the same future at that time; see :meth:`Horizon.moved`. Multipliers
    scale with probability and length.

    Parameters
    ----------
    before, after
        The horizon of the solution, and that of the problem, which may have other probabilities.
    """
    if steps == 0 and before is after:
        return solution.start()
    source = after.moved(steps) if steps else np.arange(len(after))
    measured = after.parent[source[after.roots[0]]]  # whose end is now the measured state
    factor = after.influence / before.influence[source]

    def columns(block: Block | Cone) -> Index:
        nodes = after.columns(block.stages)
        if nodes is None:
            return np.arange(block.stages)
        return _positions(np.where(nodes < 0, measured, source[nodes]), nodes)

    def scaled(block: Block | Cone) -> Array | float:
        nodes = after.columns(block.stages)
        return 1.0 if nodes is None else np.where(nodes < 0, 1.0, factor[nodes])

    return solution.rearranged(columns, scaled, moved=steps)


def lifted(solution: Solution, program: Program, horizon: Horizon) -> Start:
    """Return the plan for the expected future as the start of a plan for all futures.

    Every node starts from that of its moment; multipliers scale with probability. Blocks that the plan for
    the expected future lacks start from their default, with multipliers of zero.

    Parameters
    ----------
    program, horizon
        The problem to start; the nodes of the solution are the moments of its horizon.
    """
    factor = horizon.probability
    return _carried(
        solution.start(), solution.program, horizon.trunk, program, horizon, horizon.depth, factor
    )


def grown(start: Start, before: Program, known: Horizon, program: Program, horizon: Horizon) -> Start:
    """Return the start of a problem as that of the same problem with other contingencies.

    Every node starts from itself, and a new contingency from its owner, with multipliers of zero.

    Parameters
    ----------
    before, known
        The problem of the start, and its horizon.
    program, horizon
        The problem to start, and its horizon.
    """
    named = {(int(known.owner[node]), known.out[node]): node for node in known.contingencies.tolist()}
    source, factor = horizon.owner.copy(), np.ones(len(horizon))
    for node in horizon.contingencies.tolist():
        found = named.get((int(horizon.owner[node]), horizon.out[node]))
        source[node], factor[node] = (source[node], 0.0) if found is None else (found, 1.0)
    return _carried(start, before, known, program, horizon, source, factor)


def _carried(
    start: Start,
    of: Program,
    known: Horizon,
    program: Program,
    horizon: Horizon,
    source: Index,
    factor: Array,
) -> Start:
    """Return a start on another program, whose nodes take that of ``source``; multipliers by a factor."""

    def carry(vector: Array, blocks: Mapping[str, Block], own: Mapping[str, Block], dual: bool) -> Array:
        made = [np.zeros(0)]
        for name, block in blocks.items():
            nodes, there = horizon.columns(block.stages), own.get(name)
            columns = None if there is None else known.columns(there.stages)
            if there is None or nodes is None or columns is None:
                values = np.zeros(block.shape) if dual else block.value
            else:
                position = _positions(np.where(nodes < 0, nodes, source[nodes]), columns)
                scale = np.where(nodes < 0, 1.0, factor[nodes]) if dual else 1.0
                values = there.read(vector)[:, position] * scale
            made.append(values.ravel(order="F"))
        return np.concatenate(made)

    def multipliers(vector: Array | None, which: str) -> Array | None:
        return None if vector is None else carry(vector, getattr(program, which), getattr(of, which), True)

    x = carry(start.x, program.variables, of.variables, dual=False)
    return Start(x, multipliers(start.lam_x, "variables"), multipliers(start.lam_g, "rows"), moved=1)


def _positions(wanted: Index, nodes: Index) -> Index:
    """Return the column of each wanted node among ``nodes``; its own column, or the last, if it has none."""
    known = {node: column for column, node in enumerate(nodes.tolist())}
    last = len(nodes) - 1
    found = [known.get(node, min(own, last)) for own, node in enumerate(wanted.tolist())]
    return np.array(found, dtype=np.intp)
