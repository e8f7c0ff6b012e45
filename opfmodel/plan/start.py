"""Starting points of a plan: an earlier plan, moved in time, or the plan for the expected future."""

from __future__ import annotations

from collections.abc import Callable, Mapping

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

    return solution.rearranged(columns, scaled, moved=steps or int(before.out != after.out))


def lifted(solution: Solution, program: Program, horizon: Horizon) -> Start:
    """Return the plan for the expected future as the start of a plan for all futures.

    Every node starts from that of its moment; multipliers scale with probability. Blocks that the plan for
    the expected future lacks start from their default, with multipliers of zero.

    Parameters
    ----------
    program, horizon
        The problem to start; the nodes of the solution are the moments of its horizon.
    """
    of = solution.program
    carried = _carrier(horizon.trunk, horizon, horizon.depth, horizon.probability)
    return Start(
        carried(solution.x, of.variables, program.variables, dual=False),
        carried(solution.lam_x, of.variables, program.variables, dual=True),
        carried(solution.lam_g, of.rows, program.rows, dual=True),
        moved=1,
    )


def grown(start: Start, of: Program, before: Horizon, program: Program, after: Horizon) -> Start:
    """Return the primal start of a problem as that of the same problem with more contingencies.

    Every node starts from itself, and a new contingency from its owner. Its multipliers are not known: with
    zeros in their place IPOPT takes two to three times as many iterations as without any.

    Parameters
    ----------
    of, before
        The problem of the start, and its horizon.
    program, after
        The problem to start, and its horizon.
    """
    known = {(int(before.owner[node]), before.out[node]): node for node in before.contingencies.tolist()}
    source = after.owner.copy()
    for node in after.contingencies.tolist():
        source[node] = known.get((int(source[node]), after.out[node]), source[node])
    carried = _carrier(before, after, source, np.ones(len(after)))
    return Start(carried(start.x, of.variables, program.variables, dual=False))


def _carrier(before: Horizon, after: Horizon, source: Index, factor: Array) -> Callable[..., Array]:
    """Return a function that carries a vector to blocks over other nodes, by the names of the blocks.

    Parameters
    ----------
    source
        Node of ``before`` for each node of ``after``.
    factor
        Factor of multipliers at each node.
    """

    def carried(vector: Array, own: Mapping[str, Block], blocks: Mapping[str, Block], *, dual: bool) -> Array:
        made = [np.zeros(0)]
        for name, block in blocks.items():
            nodes, there = after.columns(block.stages), own.get(name)
            columns = None if there is None else before.columns(there.stages)
            if there is None or nodes is None or columns is None:
                values = np.zeros(block.shape) if dual else block.value
            else:
                position = _positions(np.where(nodes < 0, nodes, source[nodes]), columns)
                scale = np.where(nodes < 0, 1.0, factor[nodes]) if dual else 1.0
                values = there.read(vector)[:, position] * scale
            made.append(values.ravel(order="F"))
        return np.concatenate(made)

    return carried


def _positions(wanted: Index, nodes: Index) -> Index:
    """Return the column of each wanted node among ``nodes``; its own column, or the last, if it has none."""
    known = {node: column for column, node in enumerate(nodes.tolist())}
    last = len(nodes) - 1
    found = [known.get(node, min(own, last)) for own, node in enumerate(wanted.tolist())]
    return np.array(found, dtype=np.intp)
