"""Convex programs as matrices, the input of quadratic and conic back ends.

:mod:`solvers.folding` makes the matrices once, and the vectors are affine in the parameters, so a
new instance changes only vectors. If a coefficient depends on a parameter that instances may
change, the matrices are re-evaluated at each instance.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from solvers.assembly import Evaluator
from solvers.program import Array, Instance, Program

__all__ = ["Matrices", "MatrixMaker", "StandardForm", "proves_infeasible", "standard_form"]


@dataclass(frozen=True, eq=False)
class Matrices:
    """A convex program at one instance.

    ``minimise x' p x / 2 + q' x`` subject to ``row_lower <= a x <= row_upper``,
    ``lower <= x <= upper`` and cone values ``s x + s0``.
    """

    p: sp.csc_array
    q: Array
    a: sp.csc_array
    row_lower: Array
    row_upper: Array
    lower: Array
    upper: Array
    s: sp.csc_array
    s0: Array

    @property
    def limits(self) -> tuple[Array, Array]:
        """Lower and upper limits of ``(a; I) x``: rows first, then variables."""
        return (
            np.concatenate([self.row_lower, self.lower]),
            np.concatenate([self.row_upper, self.upper]),
        )

    @property
    def cost_scale(self) -> float:
        """Divisor of the cost for conic solvers: the mean magnitude of its slopes, at least 1.

        Slopes in $ per p.u. are in the thousands.
        """
        return max(1.0, float(np.abs(self.q).sum()) / max(1, self.q.size))


class MatrixMaker:
    """Make the matrices of a program for successive instances.

    Parameters
    ----------
    evaluator
        Functions of a program with affine rows, costs that are at most quadratic, and affine
        cones; see :func:`solvers.classify`.
    """

    def __init__(self, evaluator: Evaluator) -> None:
        self._evaluator = evaluator
        self._program: Program = evaluator.program

    @cached_property
    def constant(self) -> bool:
        """Whether the matrices are the same for every instance."""
        assembly = self._evaluator.assembly
        return not (assembly.costs.rest or assembly.constraints.rest or assembly.cones.rest)

    def at(self, instance: Instance) -> Matrices:
        """Matrices and vectors for an instance."""
        p = instance.parameters
        if self.constant:
            assembly = self._evaluator.assembly
            costs, rows, cones = assembly.costs, assembly.constraints, assembly.cones
            hessian, slope = costs.hxx, costs.gx + costs.hxp @ p
            a, offset = rows.a, rows.b @ p + rows.c
            s, s0 = cones.a, cones.b @ p + cones.c
        else:
            zero = np.zeros(self._program.n_variables)
            upper = sp.csc_array(self._evaluator.hessian(zero, p, 1.0, np.zeros(self._program.n_rows)))
            hessian = sp.csc_array(upper + upper.T - sp.diags_array(upper.diagonal()))
            slope = self._evaluator.gradient(zero, p)
            a, offset = sp.csc_array(self._evaluator.jacobian(zero, p)), self._evaluator.rows(zero, p)
            s0, cone_slope = self._evaluator.cones(zero, p)
            s = sp.csc_array(cone_slope)
        return Matrices(
            hessian,
            slope,
            a,
            instance.row_lower - offset,
            instance.row_upper - offset,
            instance.lower,
            instance.upper,
            s,
            s0,
        )


@dataclass(frozen=True, eq=False)
class StandardForm:
    """A quadratic program ``minimise x'px/2 + q'x`` s.t. ``ax = b, gx <= h, lb <= x <= ub``.

    Fixed variables become equalities because interior-point methods need an interior.
    :meth:`multipliers` maps the multipliers back.
    """

    p: sp.csc_array
    q: Array
    a: sp.csc_array
    b: Array
    g: sp.csc_array
    h: Array
    lb: Array
    ub: Array
    _rows: tuple[npt.NDArray[np.intp], npt.NDArray[np.intp], npt.NDArray[np.intp]]
    _fixed: npt.NDArray[np.intp]
    _n_rows: int

    def multipliers(self, y: Array, z: Array, z_box: Array) -> tuple[Array, Array]:
        """Multipliers ``(lam_x, lam_g)`` of the program from those of the standard form."""
        equal, above, below = self._rows
        lam_g = np.zeros(self._n_rows)
        lam_g[equal] = y[: equal.size]
        lam_g[above] += z[: above.size]
        lam_g[below] -= z[above.size :]
        lam_x = np.array(z_box, dtype=float)
        lam_x[self._fixed] = y[equal.size :]
        return lam_x, lam_g


def standard_form(m: Matrices) -> StandardForm:
    """Separate rows into equalities and inequalities; fixed variables become equalities."""
    fixed = np.flatnonzero(m.lower == m.upper)
    equal = np.flatnonzero(m.row_lower == m.row_upper)
    rest = m.row_lower < m.row_upper
    above = np.flatnonzero(rest & np.isfinite(m.row_upper))
    below = np.flatnonzero(rest & np.isfinite(m.row_lower))
    rows = m.a.tocsr()
    n = m.q.size
    pick = sp.csr_array((np.ones(fixed.size), (np.arange(fixed.size), fixed)), shape=(fixed.size, n))
    lb, ub = m.lower.copy(), m.upper.copy()
    lb[fixed], ub[fixed] = -np.inf, np.inf
    return StandardForm(
        p=m.p,
        q=m.q,
        a=sp.vstack([rows[equal], pick], format="csc"),
        b=np.concatenate([m.row_lower[equal], m.lower[fixed]]),
        g=sp.vstack([rows[above], -rows[below]], format="csc"),
        h=np.concatenate([m.row_upper[above], -m.row_lower[below]]),
        lb=lb,
        ub=ub,
        _rows=(equal, above, below),
        _fixed=fixed,
        _n_rows=m.row_lower.size,
    )


_FAR = 1e3


def proves_infeasible(m: Matrices, lam_x: Array, lam_g: Array, z: Array) -> bool:
    """Whether multipliers are a Farkas certificate that no point satisfies the constraints.

    Any feasible x satisfies ``0 = (lam_x + a' lam_g - s' z)' x <= support``, where the support is
    the maximum of the three terms that bounds and cones allow; a negative support excludes every x.
    A residual of the left-hand side is charged to the bounds of the variables, and to
    ``|x| <= 1000`` for variables without bounds.
    """
    scale = max(np.abs(lam_x).max(initial=0), np.abs(lam_g).max(initial=0), np.abs(z).max(initial=0))
    if not np.isfinite(scale) or scale == 0:
        return False
    lam_x, lam_g, z = lam_x / scale, lam_g / scale, z / scale
    lam_x = lam_x - (m.a.T @ lam_g + lam_x - m.s.T @ z)
    support = _support(lam_x, m.lower, m.upper) + _support(lam_g, m.row_lower, m.row_upper)
    return bool(support - m.s0 @ z < -1e-7)


def _support(multiplier: Array, lower: Array, upper: Array) -> float:
    """Maximum of ``multiplier' v`` over ``lower <= v <= upper``."""
    high = np.where(np.isinf(upper), _FAR, upper)
    low = np.where(np.isinf(lower), -_FAR, lower)
    return float(np.maximum(multiplier, 0.0) @ high + np.minimum(multiplier, 0.0) @ low)
