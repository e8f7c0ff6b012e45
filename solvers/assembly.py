"""Assembly of a program's functions from placed templates.

Values and derivatives are taken template by template, mapped over the places of each template,
and scattered into the global vectors and sparse matrices. No large expression graph is built:
the graph of a template is small, and everything else is index arrays, which the functions share.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from solvers.folding import Affine, Quadratic, fold_affine, fold_quadratic
from solvers.program import Array, Index, Placement, Program
from solvers.sharing import assembled

__all__ = ["Assembly", "Evaluator"]


class Assembly:
    """Symbolic functions of a program: values, Jacobian and Hessian of the Lagrangian.

    Every function is a CasADi ``MX`` function of ``x`` and ``p`` (and multipliers), in the form
    that ``nlpsol`` takes for ``grad_f``, ``jac_g`` and ``hess_lag``.

    Parameters
    ----------
    program
        The program. Its cones are not part of these functions;
        :func:`solvers.transform.smooth` states them as rows.
    """

    def __init__(self, program: Program) -> None:
        self.program = program
        self._x = ca.MX.sym("x", program.n_variables)
        self._p = ca.MX.sym("p", program.n_parameters)
        self._gathered: dict[Placement, tuple[Any, Any]] = {}

    @cached_property
    def costs(self) -> Quadratic:
        """The costs; those that are quadratic are folded."""
        return fold_quadratic(self.program, self.program.costs)

    @cached_property
    def constraints(self) -> Affine:
        """The rows; those that are affine are folded."""
        return fold_affine(self.program, self.program.constraints, self.program.n_rows)

    @cached_property
    def cones(self) -> Affine:
        """The cone values; those that are affine are folded."""
        return fold_affine(self.program, self.program.cone_values, self.program.n_cone_values)

    # Functions ---------------------------------------------------------------------------

    @cached_property
    def oracle(self) -> Any:
        """``(x, p) -> (f, g)``."""
        return ca.Function(
            "nlp", [self._x, self._p], [self._cost[0], self._values(self.constraints)], ["x", "p"], ["f", "g"]
        )

    @cached_property
    def gradient(self) -> Any:
        """``(x, p) -> (f, dense gradient of f)``."""
        cost, slope = self._cost
        matrix = _SparseSum((1, self.program.n_variables))
        self._add_jacobian(matrix, self.costs.rest)
        gradient = ca.densify(slope + matrix.expression.T)
        return ca.Function("nlp_grad_f", [self._x, self._p], [cost, gradient], ["x", "p"], ["f", "grad_f_x"])

    @cached_property
    def jacobian(self) -> Any:
        """``(x, p) -> (g, sparse Jacobian of g)``."""
        values, matrix = self._values(self.constraints), self._slope(self.constraints)
        return ca.Function("nlp_jac_g", [self._x, self._p], [values, matrix], ["x", "p"], ["g", "jac_g_x"])

    @cached_property
    def hessian(self) -> Any:
        """``(x, p, lam_f, lam_g) -> upper triangle of the Hessian of lam_f f + lam_g' g``."""
        lam_f = ca.MX.sym("lam_f")
        lam_g = ca.MX.sym("lam_g", self.program.n_rows)
        return ca.Function(
            "nlp_hess_l",
            [self._x, self._p, lam_f, lam_g],
            [self._hessian(lam_f, lam_g)],
            ["x", "p", "lam_f", "lam_g"],
            ["triu_hess_gamma_x_x"],
        )

    @cached_property
    def cone_values(self) -> Any:
        """``(x, p) -> (s, sparse Jacobian of s)``, the stacked values of all cones."""
        values, matrix = self._values(self.cones), self._slope(self.cones)
        return ca.Function("cone_values", [self._x, self._p], [values, matrix])

    # Parts of the functions --------------------------------------------------------------

    @cached_property
    def _cost(self) -> tuple[Any, Any]:
        """Objective, and gradient of its folded part."""
        q, x, p = self.costs, self._x, self._p
        curved = ca.densify(ca.mtimes(_constant(q.hxx), x))
        slope = ca.mac(_constant(q.hxp), p, ca.MX(ca.DM(q.gx)))
        cost = ca.dot(x, 0.5 * curved + slope) + ca.dot(ca.DM(q.gp), p) + q.c
        if q.hpp.nnz:
            cost += 0.5 * ca.dot(p, ca.mtimes(_constant(q.hpp), p))
        return self._scatter(q.rest, cost), curved + slope

    def _values(self, folded: Affine) -> Any:
        constant = ca.mac(_constant(folded.b), self._p, ca.MX(ca.DM(folded.c)))
        return self._scatter(folded.rest, ca.mac(_constant(folded.a), self._x, constant))

    def _slope(self, folded: Affine) -> Any:
        matrix = _SparseSum(folded.a.shape)
        matrix.add_numbers(folded.a)
        self._add_jacobian(matrix, folded.rest)
        return matrix.expression

    def _local(self, placement: Placement) -> tuple[Any, Any]:
        """Local variables and parameters at all places; read once, whatever the number of functions."""
        if placement not in self._gathered:
            of_x, of_p = _gather(self._x, placement.variables), _gather(self._p, placement.parameters)
            self._gathered[placement] = of_x, of_p
        return self._gathered[placement]

    def _map(self, function: Any, placement: Placement, *more: Any) -> Any:
        return function.map(placement.count)(*self._local(placement), *more)

    def _scatter(self, placements: Sequence[Placement], base: Any) -> Any:
        """Sum of ``base`` and the outputs of placements, each added at its target position."""
        values = [self._map(p.template.value, p) for p in placements]
        return _scatter(base, [p.into for p in placements], values)

    def _add_jacobian(self, matrix: _SparseSum, placements: Sequence[Placement]) -> None:
        for placement in placements:
            template = placement.template
            outputs, variables = template.jacobian_pattern
            rows, columns = placement.into[outputs], placement.variables[variables]
            matrix.add(rows, columns, self._map(template.jacobian, placement))

    def _hessian(self, lam_f: Any, lam_g: Any) -> Any:
        n = self.program.n_variables
        matrix = _SparseSum((n, n))
        matrix.add_numbers(sp.triu(self.costs.hxx, format="csc"), lam_f)
        for placement in self.costs.rest:
            weights = ca.repmat(lam_f, 1, placement.count)
            self._add_hessian(matrix, placement, weights)
        for placement in self.constraints.rest:
            into, weights = placement.into, lam_g
            if (into < 0).any():  # a discarded output has weight zero
                into, weights = np.where(into < 0, lam_g.numel(), into), ca.vertcat(lam_g, 0)
            self._add_hessian(matrix, placement, _gather(weights, into))
        return matrix.expression

    def _add_hessian(self, matrix: _SparseSum, placement: Placement, weights: Any) -> None:
        template = placement.template
        i, j = template.hessian_pattern
        first, second = placement.variables[i], placement.variables[j]
        values = self._map(template.hessian, placement, weights)
        # where two local variables share a position, both mixed derivatives contribute to its diagonal
        twice = (first == second) & (i != j)[:, None]
        if twice.any():
            values = values * ca.DM(1.0 + twice)
        matrix.add(np.minimum(first, second), np.maximum(first, second), values)


class _SparseSum:
    """A sparse matrix accumulated from scattered entries; repeated positions are summed."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self._shape = shape
        self._keys: list[npt.NDArray[np.int64]] = []
        self._values: list[Any] = []
        self._constant: tuple[npt.NDArray[np.int64], Array, Any] | None = None

    def _key(self, rows: npt.NDArray[Any], columns: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
        flat = columns.astype(np.int64) * self._shape[0] + rows
        return np.where(rows < 0, -1, flat).ravel(order="F")

    def add(self, rows: Index, columns: Index, values: Any) -> None:
        """Add symbolic ``values`` of the same shape as ``rows`` and ``columns``."""
        if rows.size:
            self._keys.append(self._key(rows, columns))
            self._values.append(values)

    def add_numbers(self, matrix: sp.csc_array, scale: Any = None) -> None:
        """Add a constant matrix, optionally scaled by a symbol; call at most once."""
        entries = matrix.tocoo()
        self._constant = (self._key(entries.row, entries.col), entries.data, scale)

    @cached_property
    def expression(self) -> Any:
        """The matrix as a sparse ``MX``."""
        none = np.zeros(0, dtype=np.int64)
        fixed, numbers, scale = self._constant or (none, np.zeros(0), None)
        keys = np.sort(np.concatenate([*self._keys, fixed, none]))
        unique = keys[(keys >= 0) & np.append(True, np.diff(keys))[: keys.size].astype(bool)]
        constant = np.zeros(unique.size)
        constant[np.searchsorted(unique, fixed)] = numbers
        base = ca.MX(ca.DM(constant)) if scale is None else scale * ca.DM(constant)
        targets = [np.where(key < 0, -1, np.searchsorted(unique, key)) for key in self._keys]
        return ca.MX(_sparsity(self._shape, unique), _scatter(ca.densify(base), targets, self._values))


def _sparsity(shape: tuple[int, int], keys: npt.NDArray[np.int64]) -> Any:
    """CasADi sparsity from sorted keys ``column * n_rows + row``."""
    n_rows = max(shape[0], 1)
    columns, rows = np.divmod(keys, n_rows)
    starts = np.searchsorted(columns, np.arange(shape[1] + 1))
    return ca.Sparsity(shape[0], shape[1], starts.tolist(), rows.tolist())


def _scatter(base: Any, targets: Iterable[npt.NDArray[np.integer[Any]]], values: Iterable[Any]) -> Any:
    """Add values to a vector, each at its target position; -1 drops it.

    To add at positions is the adjoint of reading from them. CasADi evaluates that in place, on the memory of
    ``base``, and keeps one number per value; a selection matrix would take three, and a copy of all values.
    """
    vector = ca.MX.sym("vector", base.numel())
    read, seeds = [], []
    for target, value in zip(targets, values, strict=True):
        flat, column = target.ravel(order="F"), ca.vec(value)
        kept = np.flatnonzero(flat >= 0)
        if kept.size < flat.size:
            flat, column = flat[kept], column.nz[kept.tolist()]
        if flat.size:
            read.append(ca.vec(vector.nz[flat.tolist()]))  # of a single number it is a row
            seeds.append(column)
    adjoint = ca.Function("read", [vector], [*read, vector]).reverse(1)
    unused = [ca.MX(*adjoint.size_in(i)) for i in range(2 + len(read))]
    return adjoint.call([*unused, *seeds, base], True, False)[0]


def _gather(vector: Any, index: Index) -> Any:
    """``vector[index]`` with the shape of ``index``."""
    if index.size == 0:
        return ca.MX(*index.shape)
    return ca.reshape(vector.nz[index.ravel(order="F").tolist()], *index.shape)


def _constant(matrix: sp.csc_array) -> Any:
    """A SciPy matrix as a CasADi matrix."""
    rows, columns = matrix.shape
    pattern = ca.Sparsity(rows, columns, matrix.indptr.tolist(), matrix.indices.tolist())
    return ca.DM(pattern, matrix.data)


class Evaluator:
    """Functions of a program on NumPy arrays, for certificates, matrices and tests.

    Parameters
    ----------
    program
        The program. The argument ``p`` of the methods is an instance's parameter vector.
    """

    def __init__(self, program: Program) -> None:
        self.program = program
        self.assembly: Assembly = assembled(program, Assembly)
        self._mapped: dict[str, Any] = {}

    def objective(self, x: Array, p: Array) -> float:
        """Value of the objective."""
        return float(self.assembly.oracle(x, p)[0])

    def rows(self, x: Array, p: Array) -> Array:
        """Values of the rows."""
        return _vector(self.assembly.oracle(x, p)[1])

    def gradient(self, x: Array, p: Array) -> Array:
        """Gradient of the objective."""
        return _vector(self.assembly.gradient(x, p)[1])

    def jacobian(self, x: Array, p: Array) -> sp.csc_matrix:
        """Jacobian of the rows."""
        return _matrix(self.assembly.jacobian(x, p)[1])

    def hessian(self, x: Array, p: Array, lam_f: float, lam_g: Array) -> sp.csc_matrix:
        """Upper triangle of the Hessian of the Lagrangian."""
        return _matrix(self.assembly.hessian(x, p, lam_f, lam_g))

    def cones(self, x: Array, p: Array) -> tuple[Array, sp.csc_matrix]:
        """Values of the cones and their Jacobian."""
        values, jacobian = self.assembly.cone_values(x, p)
        return _vector(values), _matrix(jacobian)

    def output(self, name: str, x: Array, p: Array) -> Array:
        """Values of a named output, of shape ``(items, stages)``."""
        output = self.program.outputs[name]
        shape, template = (output.items, output.stages), output.template
        variables, parameters = (
            [np.broadcast_to(vector[index], shape).ravel(order="F") for index in positions]
            for vector, positions in ((x, output.variables), (p, output.parameters))
        )
        count = output.items * output.stages
        if not count:
            return np.zeros(shape)
        if template.is_identity:
            return variables[0].reshape(shape, order="F")
        if name not in self._mapped:
            self._mapped[name] = template.value.map(count)
        at = (ca.DM(np.stack(each)) if each else ca.DM(0, count) for each in (variables, parameters))
        return _vector(self._mapped[name](*at)).reshape(shape, order="F")

    def outputs(self, x: Array, p: Array) -> dict[str, Array]:
        """Values of all named outputs."""
        return {name: self.output(name, x, p) for name in self.program.outputs}


def _vector(value: Any) -> Array:
    return np.asarray(ca.densify(value), dtype=float).ravel(order="F")


def _matrix(value: Any) -> sp.csc_matrix:
    sparsity = value.sparsity()
    data = np.asarray(value.nonzeros(), dtype=float)
    return sp.csc_matrix((data, sparsity.row(), sparsity.colind()), shape=value.shape)
