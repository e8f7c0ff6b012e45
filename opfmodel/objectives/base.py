"""The base class of objectives, and weighted sums of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.errors import IncompatibleError
from opfmodel.model import Stage
from opfmodel.network.arrays import PerUnitNetwork
from opfmodel.network.bounds import number_within

__all__ = ["Objective", "WeightedSum"]

Array = npt.NDArray[np.float64]


class Objective:
    """A stage cost, and optionally a terminal cost; one class per file.

    Registered by an entry point in the group ``opfmodel.objectives``; the keyword arguments of
    the constructor are the options in a scenario file. Objectives can be added, and multiplied
    by non-negative numbers.

    Attributes
    ----------
    needs
        Names of the quantities that the objective requires.
    convex
        Whether the cost is convex in the quantities that it reads.
    regularisation
        Default weight, in $/h, of the squares of storage power that a plan adds to make the problem well
        posed; per unit refers to the scale of the system, whatever its base. No reported cost includes it.
    """

    needs: tuple[str, ...] = ()
    convex: bool = True
    regularisation: float = 0.0

    def stage_cost(self, stage: Stage) -> Any:
        """Return the cost rate in $/h, one value per stage, from quantities in per unit, or None.

        The same code is compiled for a solver and evaluated on numbers: use plain arithmetic, NumPy
        functions, :func:`solvers.total` and :func:`solvers.largest`.
        """
        raise NotImplementedError

    def series(self, network: PerUnitNetwork) -> Mapping[tuple[str, str], Array]:  # noqa: ARG002
        """Return the objective's own time-varying data, in per unit, by ``(kind, field)``.

        ``stage.generator.pg_setpoint`` is then the value of the field in each stage.

        Returns
        -------
        mapping
            Arrays of shape ``(items, steps)``, from the first step of the profiles on, or
            ``(items, 1)`` for constants.
        """
        return {}

    def terminal_cost(self, stage: Stage) -> Any:  # noqa: ARG002 - for subclasses
        """Return a cost in $ of the end of the horizon, one value per scenario, or None.

        ``stage.leaves(stage.storage.e_next)`` is the stored energy at the end of each scenario.
        """
        return None

    def __add__(self, other: Objective) -> WeightedSum:
        if not isinstance(other, Objective):
            return NotImplemented
        return WeightedSum([(1.0, self), (1.0, other)])

    def __mul__(self, weight: float) -> WeightedSum:
        return WeightedSum([(weight, self)])

    def __rmul__(self, weight: float) -> WeightedSum:
        return self * weight


class WeightedSum(Objective):
    """A weighted sum of objectives: ``2 * Economic() + VoltageDeviation()``."""

    def __init__(self, parts: list[tuple[float, Objective]]) -> None:
        flat: list[tuple[float, Objective]] = []
        for given, part in parts:
            weight = number_within(f"{type(part).__name__}: weight", given, at_least=0)
            nested = part.parts if isinstance(part, WeightedSum) else [(1.0, part)]
            flat += [(weight * w, p) for w, p in nested]
        self.parts: list[tuple[float, Objective]] = flat
        self.needs = tuple(dict.fromkeys(name for _, part in flat for name in part.needs))
        self.convex = all(part.convex for _, part in flat)
        self.regularisation = max((part.regularisation for _, part in flat), default=0.0)

    def stage_cost(self, stage: Stage) -> Any:
        """Return the weighted sum of the stage costs."""
        return _sum([(w, p.stage_cost(stage)) for w, p in self.parts])

    def series(self, network: PerUnitNetwork) -> Mapping[tuple[str, str], Array]:
        """Return the series of all parts.

        Raises
        ------
        IncompatibleError
            Two parts define different values for the same field.
        """
        merged: dict[tuple[str, str], Array] = {}
        for _, part in self.parts:
            for key, values in part.series(network).items():
                if key in merged and not np.array_equal(merged[key], values, equal_nan=True):
                    raise IncompatibleError(f"two objectives of a sum have different values for {key[1]!r}")
                merged[key] = values
        return merged

    def terminal_cost(self, stage: Stage) -> Any:
        """Return the weighted sum of the terminal costs."""
        return _sum([(w, p.terminal_cost(stage)) for w, p in self.parts])


def _sum(terms: list[tuple[float, Any]]) -> Any:
    result = None
    for weight, term in terms:
        if term is not None:
            result = weight * term if result is None else result + weight * term
    return result
