"""The expanded form of programs: intermediate quantities as variables, their definitions as rows.

Of the rows ``outer(inner(x))`` the expanded program has ``outer(y)`` and ``inner(x) - y = 0``. It has the
same solutions, and is larger, but its equations are sparser and less nonlinear. An interior-point method,
whose iterates need not satisfy the definitions, solves some problems in it that it cannot solve in the
original form. In an electricity grid the quantities are the flows of branches.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np

from solvers.assembly import Evaluator
from solvers.program import Array, Block, Index, Instance, Placement, Program
from solvers.solution import Solution, Start
from solvers.template import Template

__all__ = ["Expanded", "expand"]

# Factor of the implied bounds of quantities. With 1.5 case13659_pegase crawls in this form too; nearer to 1
# the neglected multipliers of the bounds grow.
_WIDER = 1.1


@dataclass(frozen=True, eq=False)
class Expanded:
    """A program in expanded form, and the mapping back to the original.

    The variables and rows of the original come first, with the same multipliers.
    """

    original: Program
    program: Program

    def instance(self, instance: Instance) -> Instance:
        """The same instance data for the expanded program."""
        most = np.concatenate([np.zeros(0), *(b.ravel(order="F") for b in self._implied(instance))])
        return Instance(
            parameters=instance.parameters,
            lower=np.concatenate([instance.lower, -most]),
            upper=np.concatenate([instance.upper, most]),
            row_lower=np.concatenate([instance.row_lower, np.zeros(most.size)]),
            row_upper=np.concatenate([instance.row_upper, np.zeros(most.size)]),
            start=self._with_quantities(instance.start, instance.parameters),
        )

    def start(self, start: Start, instance: Instance) -> Start:
        """The same start for the expanded program."""
        p = instance.parameters
        x = self._with_quantities(start.x, p)
        if start.lam_x is None or start.lam_g is None:
            return replace(start, x=x)
        slopes = [start.lam_g]
        for placement, y in zip(self._composed, self._quantities(start.x, p), strict=True):
            assert placement.parts is not None
            outer = placement.parts.outer
            output, quantity = outer.jacobian_pattern
            into = placement.into[output]
            weights = np.where(into < 0, 0.0, start.lam_g[into])
            values = np.asarray(outer.jacobian(y, p[placement.parameters]), dtype=float)
            slope = np.zeros_like(y)
            np.add.at(slope, quantity, weights * values.reshape(weights.shape))
            slopes.append(slope.ravel(order="F"))
        added = np.zeros(x.size - start.x.size)
        return replace(start, x=x, lam_x=np.concatenate([start.lam_x, added]), lam_g=np.concatenate(slopes))

    def solution(self, solution: Solution, evaluator: Evaluator, instance: Instance) -> Solution:
        """The solution of the original program that one of the expanded program is."""
        n, m = self.original.n_variables, self.original.n_rows
        return replace(
            solution,
            program=self.original,
            evaluator=evaluator,
            instance=instance,
            x=solution.x[:n],
            lam_x=solution.lam_x[:n],
            lam_g=solution.lam_g[:m],
        )

    @property
    def _composed(self) -> list[Placement]:
        return [placement for placement in self.original.constraints if placement.parts is not None]

    def _quantities(self, x: Array, p: Array) -> list[Array]:
        """Intermediate quantities of each composed placement at a point, ``(quantities, places)``."""
        made = []
        for placement in self._composed:
            assert placement.parts is not None
            y = placement.parts.inner.value(x[placement.variables], p[placement.parameters])
            made.append(np.asarray(y, dtype=float))
        return made

    def _implied(self, instance: Instance) -> Iterator[Array]:
        """Magnitudes that the quantities of each composed placement have at most, ``(quantities, places)``.

        They follow from upper bounds on sums of squares. Bounds keep the iterates from straying far.
        They are a little wider than implied, so that none binds, and their multipliers, which are neglected,
        stay small.
        """
        for placement in self._composed:
            assert placement.parts is not None
            most = np.full((placement.parts.inner.n_outputs, placement.count), np.inf)
            for output, quantity, factor in _squares(placement.parts.outer):
                into = placement.into[output]
                alone = (into >= 0) & (self._terms[into] == 1)
                limit = np.where(alone, instance.row_upper[into], np.inf)
                implied = _WIDER * np.sqrt(np.maximum(limit, 0.0) / factor)
                most[quantity] = np.minimum(most[quantity], implied)
            yield most

    @cached_property
    def _terms(self) -> Index:
        """Number of terms that are added to each row."""
        into = [p.into[p.into >= 0] for p in self.original.constraints]
        return np.bincount(
            np.concatenate([*into, np.zeros(0, dtype=np.intp)]), minlength=self.original.n_rows
        )

    def _with_quantities(self, x: Array, p: Array) -> Array:
        return np.concatenate([x, *(y.ravel(order="F") for y in self._quantities(x, p))])


def expand(program: Program) -> Expanded:
    """State every composed placement of ``program`` with its intermediate quantities as variables."""
    variables, rows = dict(program.variables), dict(program.rows)
    constraints: list[Placement] = []
    n, m = program.n_variables, program.n_rows
    for placement in program.constraints:
        if placement.parts is None:
            constraints.append(placement)
            continue
        inner, outer = placement.parts.inner, placement.parts.outer
        shape = inner.n_outputs * placement.count, 1
        free, zero = np.full(shape, np.inf), np.zeros(shape)
        quantities = Block(inner.name, *shape, n, -free, free, zero)
        definitions = Block(f"{inner.name}, definitions", *shape, m, zero, zero, zero)
        n, m = n + quantities.size, m + definitions.size
        variables[quantities.name], rows[definitions.name] = quantities, definitions
        y = _by_place(quantities, placement)
        constraints.append(_defined(placement, inner, y, definitions))
        constraints.append(Placement(outer, y, placement.parameters, placement.into, placement.block))
    expanded = replace(program, variables=variables, rows=rows, constraints=tuple(constraints))
    return Expanded(program, expanded)


def _by_place(block: Block, placement: Placement) -> Index:
    """Positions of a block with several entries per place, ``(entries, places)``."""
    return block.index.reshape(-1, placement.count, order="F")


def _defined(placement: Placement, inner: Template, quantities: Index, rows: Block) -> Placement:
    """The rows ``inner(x) - y = 0``."""
    y = ca.SX.sym("quantity", inner.n_outputs)
    template = Template(rows.name, ca.vertcat(inner.variables, y), inner.parameters, inner.outputs - y)
    index = np.vstack([placement.variables, quantities])
    return Placement(template, index, placement.parameters, _by_place(rows, placement), rows.name)


def _squares(outer: Template) -> Iterator[tuple[int, int, float]]:
    """Outputs that are sums of squares: output, quantity, and the factor of its square."""
    y = outer.variables
    for position in range(outer.n_outputs):
        output = outer.outputs[position]
        curvature, slope = ca.hessian(output, y)
        at_zero = ca.substitute(ca.vertcat(output, slope), y, ca.SX.zeros(y.shape))
        if ca.symvar(curvature) or not at_zero.is_zero():
            continue
        matrix = np.asarray(ca.DM(curvature), dtype=float)
        factors = 0.5 * np.diag(matrix)
        if (matrix == np.diag(np.diag(matrix))).all() and (factors >= 0.0).all():
            yield from ((position, int(each), float(factors[each])) for each in np.flatnonzero(factors))
