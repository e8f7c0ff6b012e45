"""Clarabel on a quadratic program of qpsolvers, called directly.

qpsolvers calls it too, but drops the number of iterations and gives up a point that Clarabel calls
almost solved.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

__all__ = ["solve_clarabel"]


def solve_clarabel(problem: Any, verbose: bool, options: dict[str, Any]) -> Any:
    """Solve ``minimise x'Px/2 + q'x`` s.t. ``Ax = b, Gx <= h, lb <= x <= ub``.

    Parameters
    ----------
    problem
        A ``qpsolvers.Problem`` with bounds.

    Returns
    -------
    qpsolvers.Solution
        ``extras`` holds ``status`` and ``iter``.

    Raises
    ------
    AttributeError, TypeError
        An option that Clarabel does not have, or a value of the wrong type.
    """
    import clarabel
    import qpsolvers

    n = problem.q.size
    below, above = np.flatnonzero(np.isfinite(problem.lb)), np.flatnonzero(np.isfinite(problem.ub))
    unit = sp.eye(n, format="csr")
    blocks = [problem.A, problem.G, -unit[below], unit[above]]
    rights = [problem.b, problem.h, -problem.lb[below], problem.ub[above]]
    matrix = sp.vstack([sp.csc_matrix((0, n)), *(b for b in blocks if b is not None)], format="csc")
    right = np.concatenate([r for r in rights if r is not None])
    equal = 0 if problem.b is None else problem.b.size
    settings = clarabel.DefaultSettings()
    settings.verbose = verbose
    for name, value in options.items():
        setattr(settings, name, value)
    cones = [clarabel.ZeroConeT(equal), clarabel.NonnegativeConeT(right.size - equal)]
    upper = sp.triu(problem.P, format="csc")
    result = clarabel.DefaultSolver(upper, problem.q, matrix, right, cones, settings).solve()
    found = qpsolvers.Solution(problem)
    found.found = result.status == clarabel.SolverStatus.Solved
    found.extras = {"status": str(result.status), "iter": result.iterations}
    found.x = np.array(result.x)
    multipliers = np.array(result.z)
    bounds = right.size - below.size - above.size
    found.y, found.z = multipliers[:equal], multipliers[equal:bounds]
    found.z_box = np.zeros(n)
    found.z_box[below] -= multipliers[bounds : bounds + below.size]
    found.z_box[above] += multipliers[bounds + below.size :]
    return found
