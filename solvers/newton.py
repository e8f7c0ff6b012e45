"""Newton's method for programs whose rows are as many equations as there are free variables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.sparse.linalg as spla

from solvers.assembly import Evaluator
from solvers.errors import ProgramError
from solvers.program import Array

__all__ = ["Root", "find_root"]

_SHORTEST = 1.0 / 64  # the shortest step that is tried before the full one is taken as it is


@dataclass(frozen=True, eq=False)
class Root:
    """The point at which Newton's method stopped.

    Attributes
    ----------
    residual
        Largest absolute value of the rows; infinite if the rows cannot be evaluated.
    converged
        Whether the residual is within the tolerance.
    """

    x: Array
    residual: float
    iterations: int
    converged: bool


def find_root(
    evaluator: Evaluator,
    parameters: Array,
    start: Array,
    free: npt.NDArray[np.bool_],
    *,
    tolerance: float = 1e-8,
    limit: int = 30,
) -> Root:
    r"""Solve ``rows(x, p) = 0`` for the free variables, from a starting point.

    Each step solves :math:`J_{free}\, d = -g` with the exact sparse Jacobian. It is halved while it does
    not reduce the residual; if no fraction does, the full step is taken, because Newton's method
    for power flows often leaves a plateau that way.

    Parameters
    ----------
    evaluator
        Functions of the program. Bounds of variables and rows are ignored.
    parameters
        Parameter vector of the instance.
    start
        Starting point; entries that are not free keep its values.
    free
        Mask of the unknowns, as many as there are rows.
    tolerance
        Largest absolute value of the rows at a solution.
    limit
        Largest number of steps.

    Raises
    ------
    ProgramError
        The numbers of unknowns and of rows differ.
    """
    unknown = np.flatnonzero(free)
    if unknown.size != evaluator.program.n_rows:
        raise ProgramError(
            f"{evaluator.program.name!r}: {unknown.size} unknowns in {evaluator.program.n_rows} equations"
        )
    x = np.array(start, dtype=float)
    values = evaluator.rows(x, parameters)
    for iteration in range(limit):
        residual = _largest(values)
        if residual <= tolerance or not np.isfinite(residual):
            return Root(x, residual, iteration, residual <= tolerance)
        try:
            factors = spla.splu(evaluator.jacobian(x, parameters)[:, unknown])
        except RuntimeError:  # exactly singular
            return Root(x, residual, iteration, False)
        step = factors.solve(-values)
        x, values = _advance(evaluator, parameters, x, unknown, step, float(np.linalg.norm(values)))
    residual = _largest(values)
    return Root(x, residual, limit, residual <= tolerance)


def _advance(
    evaluator: Evaluator, parameters: Array, x: Array, unknown: npt.NDArray[np.intp], step: Array, norm: float
) -> tuple[Array, Array]:
    """Return the next point and its row values."""
    length = 1.0
    while length >= _SHORTEST:
        point = x.copy()
        point[unknown] += length * step
        values = evaluator.rows(point, parameters)
        if np.linalg.norm(values) < norm:
            return point, values
        length /= 2.0
    point = x.copy()
    point[unknown] += step
    return point, evaluator.rows(point, parameters)


def _largest(values: Array) -> float:
    residual = float(np.abs(values).max(initial=0.0))
    return residual if np.isfinite(residual) else np.inf
