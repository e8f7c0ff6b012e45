"""Lower bounds on convex programs, from multipliers of any accuracy."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from solvers.matrices import Matrices, MatrixMaker
from solvers.program import Array, Cone
from solvers.solution import Solution

__all__ = ["dual_bound"]

_FAR = 1e3  # times its value at the solution: the assumed range of a variable without bounds
_REPAIRS = 2


def dual_bound(solution: Solution) -> float:
    r"""Return a lower bound on the objective of a convex program: the value of its dual.

    By convexity, and for any multipliers :math:`\lambda` of the rows and any :math:`z` in the dual cones,
    every feasible x satisfies

    .. math::
        f(x) \ge f(\bar x) - \nabla f(\bar x)' \bar x + \min_{l \le x \le u} r' x
            - \max_{b_l \le v \le b_u} \lambda' v - z' s_0, \quad
        r = \nabla f(\bar x) + A' \lambda - S' z

    so that the bound is valid up to rounding however inaccurate the solution is, which only loosens it:
    dual residuals are charged to the bounds of the variables. For variables without bounds the multipliers
    are corrected first, until nothing but rounding is left; what remains is charged to a thousand times the
    value of the variable.

    Parameters
    ----------
    solution
        Of a program with affine rows and cones and a convex cost that is at most quadratic; see
        :func:`solvers.classify`. Its status does not matter.

    Returns
    -------
    float
        The bound, or minus infinity.
    """
    if not all(np.isfinite(v).all() for v in (solution.x, solution.lam_g, solution.z)):
        return -np.inf
    m = MatrixMaker(solution.evaluator).at(solution.instance)
    x, cones = solution.x, solution.program.cones.values()
    slope = solution.evaluator.gradient(x, solution.instance.parameters)
    rows, z = _one_sided(solution.lam_g, m), _in_cones(solution.z, cones)
    fixed = slope - m.s.T @ z
    for _ in range(_REPAIRS):
        residual = fixed + m.a.T @ rows
        rows = _corrected(rows, m, residual, _unbounded(residual, m))
    residual = fixed + m.a.T @ rows
    far = _FAR * np.maximum(1.0, np.abs(x))
    low, high = np.where(np.isinf(m.lower), -far, m.lower), np.where(np.isinf(m.upper), far, m.upper)
    least = np.maximum(residual, 0.0) @ low + np.minimum(residual, 0.0) @ high
    row_low = np.where(np.isinf(m.row_lower), 0.0, m.row_lower)  # where the multiplier has the other sign
    row_high = np.where(np.isinf(m.row_upper), 0.0, m.row_upper)
    most = np.maximum(rows, 0.0) @ row_high + np.minimum(rows, 0.0) @ row_low
    return float(solution.objective - slope @ x + least - most - m.s0 @ z)


def _one_sided(rows: Array, m: Matrices) -> Array:
    """Return multipliers of rows without those of limits that do not exist."""
    rows = np.where(np.isinf(m.row_upper), np.minimum(rows, 0.0), rows)
    return np.where(np.isinf(m.row_lower), np.maximum(rows, 0.0), rows)


def _in_cones(z: Array, cones: Iterable[Cone]) -> Array:
    """Return multipliers of cones, moved into the dual cones."""
    z = z.copy()
    for cone in cones:
        axis, *rest = cone.index
        z[axis] = np.maximum(z[axis], np.linalg.norm(z[np.array(rest)], axis=0))
    return z


def _unbounded(residual: Array, m: Matrices) -> npt.NDArray[np.intp]:
    """Return the variables that a residual would move to infinity."""
    away = ((residual > 0) & np.isinf(m.lower)) | ((residual < 0) & np.isinf(m.upper))
    return np.flatnonzero(away)


def _corrected(rows: Array, m: Matrices, residual: Array, at: npt.NDArray[np.intp]) -> Array:
    """Return multipliers of rows that leave no residual at some variables, each changed by a small share.

    Shares of their magnitude, so that no inactive inequality becomes active and signs stay as they are.
    """
    from scipy.sparse.linalg import lsmr

    if not at.size:
        return rows
    weight = np.where(m.row_lower == m.row_upper, 1.0 + np.abs(rows), np.abs(rows))
    weighted = (sp.diags_array(weight) @ m.a[:, at]).tocsc()
    share = lsmr(weighted.T, -residual[at], atol=1e-15, btol=1e-15, conlim=0.0)[0]
    return _one_sided(rows + weight * share, m)
