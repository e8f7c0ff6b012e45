"""Access to quantities by name, as symbols or numbers, for objectives, device costs and constraints."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt

from opfmodel.errors import QuantityError, nearest
from opfmodel.horizon import Horizon
from opfmodel.network.arrays import PerUnitNetwork

if TYPE_CHECKING:
    from opfmodel.model.model import Model

__all__ = ["Costed", "NumericStage", "Quantities", "RegularStage", "Stage", "per_node", "sum_of_costs"]

Array = npt.NDArray[np.float64]


class Quantities:
    """The quantities and data of one kind of component, as attributes, in per unit.

    ``stage.generator.pg`` is a quantity of shape ``(items, stages)``; ``stage.generator.c1`` is a
    field of the network, of shape ``(items, 1)``, or ``(items, stages)`` if it has a time series.
    """

    def __init__(self, kind: str, get: Callable[[str], Any], names: Callable[[], Iterable[str]]) -> None:
        self._kind = kind
        self._get = get
        self._names = names

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        value = self._get(name)
        if value is None:
            message = f"{self._kind} has no quantity {name!r} here; {nearest(name, self._names())}"
            raise QuantityError(self._kind, name, message)
        return value

    def __contains__(self, name: str) -> bool:
        return self._get(name) is not None

    def __dir__(self) -> list[str]:
        return list(self._names())


class Stage(Protocol):
    """The argument of objectives, device costs and custom constraints.

    Attributes
    ----------
    network
        Arrays of the network.
    step
        Length of each stage in hours: a number if all are equal, else an array ``(1, stages)``.
    """

    network: PerUnitNetwork
    step: float | Array

    def __getattr__(self, kind: str) -> Quantities:
        """Return the quantities of a kind of component: ``stage.generator``, ``stage.bus``, ..."""
        ...

    def leaves(self, values: Any) -> Any:
        """Return a quantity at the end of the horizon: in the last stage of each scenario."""
        ...

    def has(self, name: str) -> bool:
        """Whether a quantity (``vm``, ``qg``, ...) is published."""
        ...

    @property
    def operating_cost(self) -> Any:
        """Operating cost of all equipment, $/h, one value per stage."""
        ...


class Costed(Protocol):
    """What has an operating cost: devices, and the formulation for the network."""

    def cost(self, stage: Any) -> Any:
        """Return the operating cost in $/h, one value per stage, or None."""
        ...


class NumericStage:
    """The quantities of a model as numbers, for evaluating costs.

    Parameters
    ----------
    network
        Arrays of the network, including the time series of the window.
    step
        Length of each stage in hours.
    values
        Arrays of shape ``(items, stages)`` in per unit, by ``(kind, name)``.
    costed
        What contributes to the operating cost: the formulation and the devices.
    horizon
        The nodes in time; by default the stages follow one another.
    """

    def __init__(
        self,
        network: PerUnitNetwork,
        step: float | Array,
        values: Mapping[tuple[str, str], Array],
        costed: Iterable[Costed],
        horizon: Horizon | None = None,
    ) -> None:
        self.network = network
        self.step = step
        self.values = dict(values)
        self._costed = list(costed)
        self._horizon = horizon

    def __getattr__(self, kind: str) -> Quantities:
        if kind.startswith("_") or kind not in self.network.tables:
            raise AttributeError(kind)
        table = self.network.tables[kind]

        def get(name: str) -> Any:
            value = self.values.get((kind, name))
            return table.arrays.get(name) if value is None else value

        names = [n for k, n in self.values if k == kind]
        return Quantities(kind, get, lambda: [*names, *table.arrays])

    @property
    def horizon(self) -> Horizon:
        """The nodes in time."""
        if self._horizon is None:
            stages = max(values.shape[1] for values in self.values.values())
            self._horizon = Horizon.grid(np.broadcast_to(self.step, (1, stages))[0].tolist())
        return self._horizon

    def leaves(self, values: Any) -> Any:
        """Return a quantity at the end of the horizon: in the last stage of each scenario."""
        return values[:, [-1] if self._horizon is None else self._horizon.leaves]

    def has(self, name: str) -> bool:
        """Whether a quantity has values."""
        return any(n == name for _, n in self.values)

    @property
    def operating_cost(self) -> Any:
        """Operating cost of all equipment, $/h, one value per stage."""
        return sum_of_costs(self._costed, self)


class RegularStage:
    """The quantities of a model at the regular nodes of its horizon, without contingencies."""

    def __init__(self, model: Model) -> None:
        self.network = model.network
        self.horizon = model.horizon.regular
        self.stages = len(self.horizon)
        self.step = per_node(self.horizon.hours)
        self._model = model

    def __getattr__(self, kind: str) -> Quantities:
        whole = getattr(self._model, kind)

        def get(name: str) -> Any:
            values = getattr(whole, name) if name in whole else None
            if values is None or (
                isinstance(values, np.ndarray) and (values.ndim < 2 or values.shape[1] == 1)
            ):
                return values
            return values[:, np.arange(self.stages)]

        return Quantities(kind, get, lambda: dir(whole))

    def leaves(self, values: Any) -> Any:
        """Return a quantity at the end of the horizon: at the last node of each scenario."""
        return values[:, self.horizon.leaves]

    def has(self, name: str) -> bool:
        """Whether a quantity is published."""
        return self._model.has(name)

    @property
    def operating_cost(self) -> Any:
        """Operating cost of all equipment, $/h."""
        return sum_of_costs(self._model.costed, self)


def per_node(values: Array) -> Any:
    """Return one value per node as a number if all are equal, else as an array ``(1, nodes)``."""
    return float(values[0]) if (values == values[0]).all() else values[None, :]


def sum_of_costs(costed: Iterable[Costed], stage: Any) -> Any:
    """Return the total operating cost, $/h, or None if nothing has a cost."""
    costs = [cost for cost in (each.cost(stage) for each in costed) if cost is not None]
    result = costs[0] if costs else None
    for cost in costs[1:]:
        result = result + cost
    return result
