"""What kind of problem a program is, read off its templates."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

import numpy as np

from solvers.program import Array, Instance, Placement, Program
from solvers.template import Degree

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["Kind", "Structure", "classify", "nonconvex_cost"]


class Kind(IntEnum):
    """Problem classes, each containing those before it."""

    LINEAR = 1
    QUADRATIC = 2
    CONIC = 3
    NONLINEAR = 4

    def __str__(self) -> str:
        return {1: "linear program", 2: "quadratic program", 3: "second-order cone program"}.get(
            self.value, "nonlinear program"
        )


@dataclass(frozen=True)
class Structure:
    """Kind of a program, and the blocks that make it so.

    Attributes
    ----------
    culprits
        Names of the blocks without which the program would be of a simpler kind.
    """

    kind: Kind
    culprits: tuple[str, ...]


def classify(program: Program) -> Structure:
    """Derive the kind of ``program`` from the degrees of its templates."""
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
    for kind in (Kind.NONLINEAR, Kind.CONIC, Kind.QUADRATIC):
        if found[kind]:
            return Structure(kind, tuple(dict.fromkeys(found[kind])))
    return Structure(Kind.LINEAR, ())


def nonconvex_cost(program: Program, instance: Instance) -> str | None:
    """Name of a quadratic cost whose Hessian has a negative eigenvalue at some place, or None.

    Each template is tested by itself, which is sufficient for the sum to be convex.
    """
    for placement in program.costs:
        if placement.template.degree != Degree.QUADRATIC:
            continue
        for hessians in _local_hessians(placement, instance.parameters):
            scale = np.abs(hessians).max(initial=1e-12)
            if np.linalg.eigvalsh(hessians).min(initial=0.0) < -1e-9 * scale:
                return placement.block
    return None


def _local_hessians(placement: Placement, parameters: Array) -> Iterator[Array]:
    """Dense Hessians of a scalar quadratic template, in batches of shape ``(batch, n, n)``."""
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
        yield hessians
