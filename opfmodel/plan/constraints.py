"""Constraints of users: what they see, in physical units, and limits that may change from step to step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.errors import ModelError, nearest
from opfmodel.model import Model, Stage
from opfmodel.units import scale

__all__ = ["OwnConstraint", "PhysicalStage", "limit_of", "rows_of"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class OwnConstraint:
    """A user's constraint: what it limits, and limits that may change from step to step."""

    state: Callable[[Stage], Any]
    lower: Array
    upper: Array

    @property
    def limited(self) -> bool:
        """Whether limits were given beside the function."""
        return bool(np.isfinite(self.lower).any() or np.isfinite(self.upper).any())

    def window(self, name: str, start: int, stages: int) -> tuple[Array, Array]:
        """Limits of the stages from a step on."""
        limits = []
        for side, values in (("at_least", self.lower), ("at_most", self.upper)):
            if values.ndim and len(values) < start + stages:
                raise ModelError(
                    f"constraint {name!r}: {side} has {len(values)} values; "
                    f"steps {start} to {start + stages - 1} need {start + stages}"
                )
            limits.append(values[start : start + stages] if values.ndim else np.full(stages, values))
        return limits[0], limits[1]


def limit_of(name: str, side: str, given: npt.ArrayLike | None, absent: float) -> Array:
    """A limit as a number or a vector over time steps."""
    values = np.asarray(absent if given is None else given)
    if values.ndim > 1 or values.dtype.kind not in "if" or np.isnan(values).any():
        raise ModelError(
            f"constraint {name!r}: {side} = {given!r}: must be a number or one number per time step"
        )
    return values.astype(float)


def rows_of(name: str) -> str:
    """Name of the rows of a user's constraint, which no quantity of a formulation or device has."""
    return f"constraint {name}"


class PhysicalStage:
    """A model whose quantities are in physical units, for users' constraints."""

    def __init__(self, model: Model) -> None:
        self.network = model.network
        self.step = model.step
        self._model = model

    def __getattr__(self, kind: str) -> Any:
        if kind.startswith("_"):
            raise AttributeError(kind)
        if kind not in self.network.tables:
            raise ModelError(f"there is no kind of component {kind!r}; {nearest(kind, self.network.tables)}")
        return _PhysicalQuantities(self._model, kind)

    def has(self, name: str) -> bool:
        """Whether a quantity is published."""
        return self._model.has(name)

    @property
    def operating_cost(self) -> Any:
        """Sum of the costs of all devices, $/h."""
        return self._model.operating_cost


class _PhysicalQuantities:
    def __init__(self, model: Model, kind: str) -> None:
        self._model = model
        self._kind = kind

    def __contains__(self, name: str) -> bool:
        return name in getattr(self._model, self._kind)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        value = getattr(getattr(self._model, self._kind), name)
        table = self._model.network.tables[self._kind]
        published = self._model.published.get(name)
        unit = published.unit if published is not None else table.units.get(name, "")
        return (
            value
            if name in table.arrays and table.arrays[name].dtype.kind != "f"
            else value * scale(unit, table.base_mva)
        )
