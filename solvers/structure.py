"""The kind of a program, derived from its templates."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from solvers.program import Array, Index, Instance, Placement, Program
from solvers.template import Degree

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

__all__ = ["Kind", "Structure", "classify", "curvature_varies", "nonconvex_cost"]


class Kind(IntEnum):
    """Problem classes, each containing the ones before it."""

    LINEAR = 1
    QUADRATIC = 2
    CONIC = 3
    NONLINEAR = 4

    def __str__(self) -> str:
        return {1: "linear program", 2: "convex quadratic program", 3: "second-order cone program"}.get(
            self.value, "nonlinear program"
        )


@dataclass(frozen=True)
class Structure:
    """Kind of a program and the blocks responsible for it.

    Attributes
    ----------
    culprits
        Names of the blocks without which the program would be of a simpler kind.
    nonconvex
        Whether the program is nonlinear only because the culprit's quadratic cost is not convex.
    """

    kind: Kind
    culprits: tuple[str, ...]
    nonconvex: bool = False


def classify(program: Program, instance: Instance | None = None) -> Structure:
    """Derive the kind of ``program`` from its templates, for an instance or the default one.

    The instance matters only if parameters enter the Hessian of a quadratic cost; see
    :func:`curvature_varies`.
    """
    found: dict[Kind, list[str]] = {kind: [] for kind in Kind}
    for placement in program.constraints:
        if placement.count and placement.template.degree > Degree.LINEAR:
            found[Kind.NONLINEAR].append(placement.block)
    for placement in program.costs:
        degree = placement.template.degree
        if placement.count and degree > Degree.LINEAR:
            kind = Kind.QUADRATIC if degree == Degree.QUADRATIC else Kind.NONLINEAR
            found[kind].append(placement.block)
    for placement in program.cone_values:
        affine = placement.template.degree <= Degree.LINEAR
        found[Kind.CONIC if affine else Kind.NONLINEAR].append(placement.block)
    if found[Kind.QUADRATIC] and not found[Kind.NONLINEAR]:
        culprit = nonconvex_cost(program, program.default if instance is None else instance)
        if culprit is not None:
            return Structure(Kind.NONLINEAR, (culprit,), nonconvex=True)
    for kind in (Kind.NONLINEAR, Kind.CONIC, Kind.QUADRATIC):
        if found[kind]:
            return Structure(kind, tuple(dict.fromkeys(found[kind])))
    return Structure(Kind.LINEAR, ())


def curvature_varies(program: Program) -> bool:
    """Whether a parameter that instances may change enters the Hessian of a quadratic cost."""
    for placement in program.costs:
        template = placement.template
        if template.degree == Degree.QUADRATIC:
            moving = ~np.all(program.fixed_parameters[placement.parameters], axis=1)
            if np.any(moving[template.hessian_parameters]):
                return True
    return False


def nonconvex_cost(program: Program, instance: Instance) -> str | None:
    """Name of a quadratic cost that makes the quadratic part of the objective non-convex, or None.

    Each place of each template is tested separately, on a few variables. Their sum is tested only
    if one fails, since the sum of non-convex terms can be convex.
    """
    quadratic = [p for p in program.costs if p.count and p.template.degree == Degree.QUADRATIC]
    for placement in quadratic:
        for _, hessians in _local_hessians(placement, instance.parameters):
            scale = np.abs(hessians).max(initial=1e-12)
            if np.linalg.eigvalsh(hessians).min(initial=0.0) < -_NEGATIVE * scale:
                whole = _hessian(program.n_variables, quadratic, instance.parameters)
                return None if _is_positive_semidefinite(whole) else placement.block
    return None


_NEGATIVE = 1e-9  # an eigenvalue below minus this, relative to the largest entry, counts as negative


def _local_hessians(placement: Placement, parameters: Array) -> Iterator[tuple[Index, Array]]:
    """Positions and dense Hessians of a scalar quadratic template: ``(n, batch)``, ``(batch, n, n)``."""
    template = placement.template
    i, j = template.hessian_pattern
    n, batch = template.n_variables, max(1, 2_000_000 // max(1, template.n_variables**2))
    for first in range(0, placement.count, batch):
        local = parameters[placement.parameters[:, first : first + batch]]
        count = min(batch, placement.count - first)
        values = np.asarray(
            template.hessian.map(count)(np.zeros((n, count)), local, np.ones((1, count))), dtype=float
        )
        hessians = np.zeros((count, n, n))
        hessians[:, i, j] = values.T
        hessians[:, j, i] = values.T
        yield placement.variables[:, first : first + batch], hessians


def _hessian(size: int, placements: Iterable[Placement], parameters: Array) -> sp.csc_array:
    """Hessian of the sum of quadratic costs."""
    total = sp.csc_array((size, size))
    for placement in placements:
        for positions, values in _local_hessians(placement, parameters):
            rows = np.broadcast_to(positions.T[:, :, None], values.shape).ravel()
            columns = np.broadcast_to(positions.T[:, None, :], values.shape).ravel()
            total = total + sp.coo_array((values.ravel(), (rows, columns)), shape=total.shape).tocsc()
    return total


def _is_positive_semidefinite(matrix: sp.csc_array) -> bool:
    """Whether all pivots of a sparse symmetric matrix, with a slightly increased diagonal, are positive.

    Elimination without interchanges is stable for a positive definite matrix, and only for such a
    matrix are all pivots positive.
    """
    from scipy.sparse.linalg import splu

    lift = _NEGATIVE * np.abs(matrix.data).max(initial=1e-12)
    lifted = (matrix + lift * sp.eye_array(matrix.shape[0])).tocsc()
    try:
        factors = splu(
            lifted, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )
    except RuntimeError:  # a pivot of zero
        return False
    symmetric = np.array_equal(factors.perm_r, factors.perm_c)
    return bool(symmetric and (factors.U.diagonal() > 0).all())
