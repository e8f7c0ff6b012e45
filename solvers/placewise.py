"""Evaluation of a program in parts of limited size, for programs that are never assembled as a whole."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from solvers.assembly import Evaluator
from solvers.folding import map_numbers
from solvers.program import Array, Placement

__all__ = ["PlacewiseEvaluator", "parts"]

_MOST = 100_000  # places at a time


class PlacewiseEvaluator(Evaluator):
    """The functions of a program, evaluated template by template on at most 100,000 places at a time.

    Unlike its base class it builds no CasADi function of the whole program, which takes some
    megabytes per stage. The Hessian is still that of the base class.
    """

    def objective(self, x: Array, p: Array) -> float:
        """Value of the objective."""
        return float(self._sum(self.program.costs, 1, x, p)[0])

    def rows(self, x: Array, p: Array) -> Array:
        """Values of the rows."""
        return self._sum(self.program.constraints, self.program.n_rows, x, p)

    def gradient(self, x: Array, p: Array) -> Array:
        """Gradient of the objective."""
        total = np.zeros(self.program.n_variables)
        for part in parts(self.program.costs):
            outputs, variables = part.template.jacobian_pattern
            if outputs.size:
                slopes = map_numbers(part.template.jacobian, part.count, *_local(part, x, p))
                np.add.at(total, part.variables[variables], slopes)
        return total

    def jacobian(self, x: Array, p: Array) -> sp.csc_matrix:
        """Jacobian of the rows."""
        return self._slope(self.program.constraints, self.program.n_rows, x, p)

    def cones(self, x: Array, p: Array) -> tuple[Array, sp.csc_matrix]:
        """Values of the cones and their Jacobian."""
        size = self.program.n_cone_values
        return self._sum(self.program.cone_values, size, x, p), self._slope(
            self.program.cone_values, size, x, p
        )

    @staticmethod
    def _sum(placements: Iterable[Placement], size: int, x: Array, p: Array) -> Array:
        total = np.zeros(size)
        for part in parts(placements):
            values = map_numbers(part.template.value, part.count, *_local(part, x, p))
            kept = part.into >= 0
            np.add.at(total, part.into[kept], values[kept])
        return total

    def _slope(self, placements: Iterable[Placement], size: int, x: Array, p: Array) -> sp.csc_matrix:
        rows, columns, values = [], [], []
        for part in parts(placements):
            outputs, variables = part.template.jacobian_pattern
            if not outputs.size:
                continue
            slopes = map_numbers(part.template.jacobian, part.count, *_local(part, x, p))
            into = part.into[outputs]
            kept = into >= 0
            rows.append(into[kept])
            columns.append(part.variables[variables][kept])
            values.append(slopes[kept])
        shape = (size, self.program.n_variables)
        if not values:
            return sp.csc_matrix(shape)
        place = (np.concatenate(rows), np.concatenate(columns))
        return sp.csc_matrix((np.concatenate(values), place), shape=shape)


def parts(placements: Iterable[Placement]) -> Iterator[Placement]:
    """Yield placements in parts of at most 100,000 places."""
    for placement in placements:
        for first in range(0, placement.count, _MOST):
            at = slice(first, first + _MOST)
            yield replace(
                placement,
                variables=placement.variables[:, at],
                parameters=placement.parameters[:, at],
                into=placement.into[:, at],
            )


def _local(part: Placement, x: Array, p: Array) -> tuple[Array, Array]:
    return x[part.variables], p[part.parameters]
