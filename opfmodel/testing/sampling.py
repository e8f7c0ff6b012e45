"""Random points of a compiled problem."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from opfmodel.plan import Plan
from solvers import Epigraph, Solution

__all__ = ["at_random"]


def at_random(plan: Plan, rng: np.random.Generator) -> Plan:
    """Return a plan of the same problem with random values in place of the optimum.

    Variables that stand for a maximum (:func:`solvers.largest`) take the value of the maximum; the
    cost of the program then equals that of the formula.
    """
    instance = plan.solution.instance
    low = np.where(np.isfinite(instance.lower), instance.lower, np.minimum(instance.upper, 2.0) - 2.0)
    high = np.where(np.isfinite(instance.upper), instance.upper, low + 2.0)
    solution = replace(plan.solution, x=rng.uniform(low, high))
    for epigraph in solution.program.epigraphs:
        solution = _raised(solution, epigraph)
    return Plan(plan.problem, plan.problem.model, solution, plan.stage.network, plan.request)


def _raised(solution: Solution, epigraph: Epigraph) -> Solution:
    """Set the variables of maxima to their largest piece; pieces are in rows ``t - piece``."""
    x, block = solution.x.copy(), epigraph.variables
    x[block.slice] = 0.0
    solution = replace(solution, x=x)
    most = np.full(block.size, -np.inf)
    slopes = solution.evaluator.jacobian(x, solution.instance.parameters).tocsr()[:, block.slice]
    for rows in epigraph.pieces:
        row, column = slopes[rows.slice].nonzero()
        np.maximum.at(most, column, -solution.rows[rows.slice][row])
    x = x.copy()
    x[block.slice] = most
    return replace(solution, x=x)
