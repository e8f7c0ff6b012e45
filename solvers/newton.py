"""Newton's method for programs whose rows are as many equations as there are free variables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from solvers.assembly import Evaluator
from solvers.errors import ProgramError
from solvers.program import Array, Index

__all__ = ["Root", "find_root"]

_SHORTEST = 1.0 / 64  # the shortest fraction of a step; near a solution the full one is taken


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

    Each step solves :math:`J_{free}\, d = -g` with the exact sparse Jacobian. It is halved until it
    reduces :math:`\|g\|_2`. Where no fraction does, the Jacobian is nearly singular and the method ends:
    most likely there is no solution nearby.

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
    iterations = 0
    while iterations < limit and _largest(values) > tolerance:
        step = _step(evaluator.jacobian(x, parameters)[:, unknown], values)
        following = None if step is None else _follow(evaluator, parameters, x, unknown, step, values)
        if following is None:
            break
        x, values = following
        iterations += 1
    residual = _largest(values)
    return Root(x, residual, iterations, residual <= tolerance)


def _step(jacobian: sp.csc_matrix, values: Array) -> Array | None:
    """Return the Newton step; None if the Jacobian is singular."""
    from scipy.sparse.linalg import splu

    try:
        step: Array = splu(jacobian).solve(-values)
    except RuntimeError:
        return None
    return step


def _follow(
    evaluator: Evaluator, parameters: Array, x: Array, unknown: Index, step: Array, values: Array
) -> tuple[Array, Array] | None:
    """Return point and rows after the largest fraction of a step that reduces the rows, if there is one."""
    norm, length = np.linalg.norm(values), 1.0
    while length >= _SHORTEST:
        point = x.copy()
        point[unknown] += length * step
        found = evaluator.rows(point, parameters)
        if np.linalg.norm(found) < norm:
            return point, found
        length /= 2.0
    return None


def _largest(values: Array) -> float:
    residual = float(np.abs(values).max(initial=0.0))
    return residual if np.isfinite(residual) else np.inf
