"""The maxima of quantities so far, as small as a solution allows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from opfmodel.model import Model
from solvers import Solution

__all__ = ["with_least_peaks"]


def with_least_peaks(model: Model, solution: Solution) -> Solution:
    """Return the solution with the smallest maxima that satisfy their rows.

    Solvers leave them larger where they cost nothing, or where a later maximum costs the same; see
    :func:`opfmodel.model.peak.declare_peak`.
    """
    peaks = [state.name for state in model.states.values() if state.peak]
    if not peaks:
        return solution
    x, horizon, first = solution.x.copy(), model.horizon, solution.skipped
    whole = replace(solution, skipped=0)
    for name in peaks:
        block = solution.program.variables[name]
        kept, met = whole.value(f"{name} kept"), whole.value(f"{name} met")
        values = block.read(x)
        for node in range(first, len(horizon)):  # parents come first
            start = values[:, horizon.parent[node] + 1]
            counted = node < len(horizon.regular)
            least = np.maximum(kept[:, node] * start, met[:, node])
            values[:, node + 1] = least if counted else start
        x[block.slice] = values.ravel(order="F")
    return replace(solution, x=x)
