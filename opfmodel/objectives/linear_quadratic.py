"""Linear-quadratic stage costs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.errors import ModelError, nearest, shown
from opfmodel.model import Stage
from opfmodel.network.bounds import LARGEST
from opfmodel.objectives.base import Objective
from solvers import total

__all__ = ["LinearQuadratic"]

Array = npt.NDArray[np.float64]
Weights = Mapping[str, Any]

_STATES = {"pg": "generator", "qg": "generator", "e": "storage"}
_INPUTS = {"ps": "storage", "qs": "storage"}


class LinearQuadratic(Objective):
    r"""Linear-quadratic cost of states and inputs, in per unit on the network's ``base_mva``.

    .. math::
        \ell(x, u) = x^T Q x + u^T R u + q^T x + r^T u

    in $/h, with :math:`x = (p^g, q^g, e)` and :math:`u = (p^s, q^s)` in the order of the network.
    Increments of generation are not variables here; ramps limit them. Source: Faulwasser and
    Engelmann (2019), Assumption 4.1.

    Parameters
    ----------
    Q, R
        By quantity (``pg``, ``qg``, ``e``; ``ps``, ``qs``) a number, one number per component, or
        a matrix; quantities not listed have no weight. Or one matrix for all of x or u. Only the
        symmetric part of a matrix counts.
    q, r
        By quantity a number or one number per component, or one vector for all of x or u.

    Raises
    ------
    ModelError
        A quantity is unknown; or, when the problem is compiled, a shape does not fit the network.
    """

    def __init__(
        self,
        Q: Weights | list[list[float]] | None = None,  # noqa: N803 - the paper's symbols
        R: Weights | list[list[float]] | None = None,  # noqa: N803
        q: Weights | list[float] | None = None,
        r: Weights | list[float] | None = None,
    ) -> None:
        self.terms = (("Q", Q, _STATES), ("R", R, _INPUTS), ("q", q, _STATES), ("r", r, _INPUTS))
        named = [_named(symbol, weights, kinds) for symbol, weights, kinds in self.terms]
        self.needs = tuple(dict.fromkeys(name for names in named for name in names))

    def stage_cost(self, stage: Stage) -> Any:
        """Return the sum of the terms with non-zero weights."""
        cost: Any = None
        for symbol, weights, kinds in self.terms:
            for term in _terms(symbol, weights, kinds, stage):
                cost = term if cost is None else cost + term
        return cost


def _named(symbol: str, weights: Any, kinds: Mapping[str, str]) -> list[str]:
    """Return the quantities that have weights."""
    if weights is None:
        return []
    if not isinstance(weights, Mapping):
        return list(kinds)
    for name in weights:
        if name not in kinds:
            raise ModelError(
                f"linear-quadratic cost: {symbol} has no quantity {name!r}; {nearest(name, kinds)}"
            )
    return list(weights)


def _terms(symbol: str, weights: Any, kinds: Mapping[str, str], stage: Stage) -> list[Any]:
    if weights is None:
        return []
    sizes = {name: len(stage.network.tables[kind]) for name, kind in kinds.items()}
    values = {name: getattr(getattr(stage, kind), name) for name, kind in kinds.items() if stage.has(name)}
    unit = stage.network.rebased
    if symbol in ("q", "r"):
        vectors = _vectors(symbol, weights, sizes)
        return [total(unit * w[:, None] * values[name]) for name, w in vectors.items() if w.any()]
    terms = []
    for (one, other), block in _blocks(symbol, weights, sizes).items():
        i, j = np.nonzero(block)
        if i.size:
            terms.append(total(unit**2 * block[i, j][:, None] * values[one][i] * values[other][j]))
    return terms


def _vectors(symbol: str, weights: Any, sizes: Mapping[str, int]) -> dict[str, Array]:
    """Return the weights as one vector per quantity."""
    if isinstance(weights, Mapping):
        return {n: _shaped(f"{symbol} of {n}", w, (sizes[n],)) for n, w in weights.items()}
    whole = _shaped(symbol, weights, (sum(sizes.values()),))
    parts = np.split(whole, np.cumsum(list(sizes.values()))[:-1])
    return dict(zip(sizes, parts, strict=True))


def _blocks(symbol: str, weights: Any, sizes: Mapping[str, int]) -> dict[tuple[str, str], Array]:
    """Return the weights as upper triangular blocks, with every product of two entries once."""
    if isinstance(weights, Mapping):
        square = {}
        for name, weight in weights.items():
            what, size = f"{symbol} of {name}", sizes[name]
            if np.ndim(weight) == 2:
                square[name, name] = _upper(_shaped(what, weight, (size, size)))
            else:
                square[name, name] = np.diag(_shaped(what, weight, (size,)))
        return square
    whole = _upper(_shaped(symbol, weights, (sum(sizes.values()),) * 2))
    ends = np.cumsum([0, *sizes.values()])
    part = {name: slice(a, b) for name, a, b in zip(sizes, ends, ends[1:], strict=False)}
    return {(one, other): whole[part[one], part[other]] for one in sizes for other in sizes}


def _upper(matrix: Array) -> Array:
    return np.triu(matrix) + np.triu(matrix.T, 1)


def _shaped(what: str, weight: Any, shape: tuple[int, ...]) -> Array:
    try:
        array = np.asarray(weight, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise ModelError(f"linear-quadratic cost: {what}: must be numbers, not {shown(weight)}") from None
    if array.ndim and array.shape != shape:
        raise ModelError(f"linear-quadratic cost: {what} has shape {array.shape}; must have {shape}")
    if not (np.abs(array) <= LARGEST).all():
        raise ModelError(f"linear-quadratic cost: {what}: must be finite numbers of at most {LARGEST:g}")
    return np.array(np.broadcast_to(array, shape))
