"""Affine rows and quadratic costs with constant coefficients, folded into matrices.

With ``z = (x, p)``, rows that are affine in ``z`` and costs that are quadratic in ``z`` are folded
once into a few sparse matrices. The remaining placements are evaluated template by template.
Constants of the formulas (blocks of fixed parameters) are coefficients, not part of ``z``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from solvers.program import Array, Placement, Program
from solvers.template import nonzeros

__all__ = ["Affine", "Quadratic", "fold_affine", "fold_quadratic", "map_numbers"]


@dataclass(frozen=True, eq=False)
class Affine:
    """``a @ x + b @ p + c``.

    Attributes
    ----------
    rest
        Placements that are not folded.
    """

    a: sp.csc_array
    b: sp.csc_array
    c: Array
    rest: tuple[Placement, ...]


@dataclass(frozen=True, eq=False)
class Quadratic:
    """``x' hxx x / 2 + (gx + hxp p)' x + p' hpp p / 2 + gp' p + c``.

    Attributes
    ----------
    rest
        Placements that are not folded.
    """

    hxx: sp.csc_array
    hxp: sp.csc_array
    hpp: sp.csc_array
    gx: Array
    gp: Array
    c: float
    rest: tuple[Placement, ...]


class _Entries:
    """Entries of a sparse matrix, collected in batches."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self.shape = shape
        self.rows: list[npt.NDArray[np.intp]] = []
        self.columns: list[npt.NDArray[np.intp]] = []
        self.values: list[Array] = []

    def add(self, rows: npt.NDArray[np.intp], columns: npt.NDArray[np.intp], values: Array) -> None:
        kept = (rows >= 0).ravel()
        self.rows.append(rows.ravel()[kept])
        self.columns.append(columns.ravel()[kept])
        self.values.append(values.ravel()[kept])

    def matrix(self) -> sp.csc_array:
        """The matrix; entries at the same position are summed."""
        if not self.values:
            return sp.csc_array(self.shape)
        place = (np.concatenate(self.rows), np.concatenate(self.columns))
        return sp.coo_array((np.concatenate(self.values), place), shape=self.shape).tocsc()

    def vector(self) -> Array:
        """The single column of the matrix."""
        return np.asarray(self.matrix().toarray(), dtype=float).ravel()


def fold_affine(program: Program, placements: Iterable[Placement], size: int) -> Affine:
    """Fold the placements whose outputs are affine in ``(x, p)`` with constant coefficients."""
    n = program.n_variables
    matrix, offset = _Entries((size, n + program.n_parameters)), _Entries((size, 1))
    rest = []
    for placement in _alike(program, placements):
        local = _Local(program, placement)
        slope = ca.jacobian(local.outputs, local.z)
        if ca.depends_on(slope, local.z):
            rest.append(placement)
            continue
        outputs, columns = (np.array(i, dtype=np.intp) for i in slope.sparsity().get_triplet())
        matrix.add(placement.into[outputs], local.positions[columns], local.numbers(slope))
        constant = _at_zero(local.outputs, local.z)
        outputs, _ = (np.array(i, dtype=np.intp) for i in constant.sparsity().get_triplet())
        into = placement.into[outputs]
        offset.add(into, np.zeros_like(into), local.numbers(constant))
    whole = matrix.matrix()
    return Affine(whole[:, :n], whole[:, n:], offset.vector(), tuple(rest))


def fold_quadratic(program: Program, placements: Iterable[Placement]) -> Quadratic:
    """Fold the costs that are quadratic in ``(x, p)`` with constant coefficients."""
    n = program.n_variables
    total = n + program.n_parameters
    curvature, slope, constant = _Entries((total, total)), _Entries((total, 1)), 0.0
    rest = []
    for placement in _alike(program, placements):
        local = _Local(program, placement)
        hessian, gradient = ca.hessian(local.outputs, local.z)
        if ca.depends_on(hessian, local.z):
            rest.append(placement)
            continue
        i, j = (np.array(k, dtype=np.intp) for k in hessian.sparsity().get_triplet())
        curvature.add(local.positions[i], local.positions[j], local.numbers(hessian))
        at_zero = _at_zero(gradient, local.z)
        i, _ = (np.array(k, dtype=np.intp) for k in at_zero.sparsity().get_triplet())
        where = local.positions[i]
        slope.add(where, np.zeros_like(where), local.numbers(at_zero))
        constant += float(local.numbers(_at_zero(local.outputs, local.z)).sum())
    h, g = curvature.matrix(), slope.vector()
    return Quadratic(h[:n, :n], h[:n, n:], h[n:, n:], g[:n], g[n:], constant, tuple(rest))


def _alike(program: Program, placements: Iterable[Placement]) -> Iterator[Placement]:
    """Yield placements in parts in which a parameter is program data at every place or at none."""
    for placement in placements:
        fixed: npt.NDArray[np.bool_] = program.fixed_parameters[placement.parameters]
        mixed = fixed[fixed.any(axis=1) & ~fixed.all(axis=1)]
        if not mixed.size:
            yield placement
            continue
        _, group = np.unique(mixed, axis=1, return_inverse=True)
        for number in range(int(group.max()) + 1):
            at = group.ravel() == number
            yield replace(
                placement,
                variables=placement.variables[:, at],
                parameters=placement.parameters[:, at],
                into=placement.into[:, at],
            )


class _Local:
    """A placement with its local symbols separated into ``z`` and constants.

    Attributes
    ----------
    positions
        Global position of each local entry of ``z``, at every place.
    """

    def __init__(self, program: Program, placement: Placement) -> None:
        template = placement.template
        fixed: npt.NDArray[np.bool_] = np.all(program.fixed_parameters[placement.parameters], axis=1)
        symbols = ca.vertsplit(template.parameters) if template.n_parameters else []
        moving = [s for s, constant in zip(symbols, fixed, strict=True) if not constant]
        self.outputs = template.outputs
        self.z = ca.vertcat(template.variables, *moving)
        shifted = program.n_variables + placement.parameters[~fixed]
        self.positions = np.vstack([placement.variables, shifted])
        self._constants = ca.vertcat(*(s for s, c in zip(symbols, fixed, strict=True) if c))
        self._data = program.values[placement.parameters[fixed]]
        self._count = placement.count

    def numbers(self, expression: Any) -> Array:
        """Nonzeros of an expression of the constants, at every place: ``(nonzeros, M)``."""
        entries = nonzeros(expression)
        if not self._data.size:
            values = np.asarray(ca.evalf(entries), dtype=float)
            return np.broadcast_to(values, (values.size, self._count))
        function = ca.Function("numbers", [self._constants], [entries])
        return map_numbers(function, self._count, self._data)


def map_numbers(function: Any, count: int, *arguments: Array) -> Array:
    """Values of a template function at every place, shape ``(outputs, count)``."""
    out = function.map(count)(*(ca.DM(a) if a.size else ca.DM(*a.shape) for a in arguments))
    return np.asarray(ca.densify(out), dtype=float).reshape(-1, count)


def _at_zero(expression: Any, symbols: Any) -> Any:
    """Set ``symbols`` to zero in an expression, and drop entries that become zero."""
    if not symbols.numel():
        return expression
    return ca.sparsify(ca.substitute(expression, symbols, ca.SX.zeros(symbols.shape)))
