"""Declarations of a model as plain values: quantities, prices, injections, states and bounds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from opfmodel.horizon import Horizon
from opfmodel.network.arrays import PerUnitNetwork, Table
from solvers import Expression, Solution

__all__ = ["Bound", "BoundSource", "Injection", "Price", "Published", "State", "resolved"]

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
Bound = str | float | npt.NDArray[Any] | Callable[[Table], npt.NDArray[Any]]


@dataclass(frozen=True)
class Published:
    """A quantity that plans report and that objectives and constraints may use.

    Attributes
    ----------
    kind
        Kind of component, also the dimension in results.
    values
        Expression of shape ``(items, stages)`` in per unit.
    """

    kind: str
    unit: str
    description: str
    values: Expression


@dataclass(frozen=True)
class Price:
    """A shadow price that plans report, computed from the multipliers of a solution.

    Attributes
    ----------
    read
        Function that returns the price as an array ``(items, stages)`` in $ and per unit: the change of the
        objective, in which stages weigh with their probability and, if ``rate``, with their length.
    rate
        Whether the price is that of one more unit over an hour, as of power, and not of one more unit once,
        as of stored energy.
    """

    kind: str
    unit: str
    description: str
    read: Callable[[Solution, PerUnitNetwork], Array]
    rate: bool = True

    def values(self, solution: Solution, network: PerUnitNetwork, horizon: Horizon) -> Array:
        """Return the price in every stage, given that this stage occurs; zero if it cannot."""
        weights = horizon.influence if self.rate else horizon.probability[horizon.owner]
        total = self.read(solution, network)
        weights = weights[: total.shape[1]]  # a constraint has no rows in contingencies, which come last
        return np.divide(total, weights, out=np.zeros_like(total), where=weights > 0)


@dataclass(frozen=True)
class Injection:
    """Power injected at the buses by one kind of device; several injections of a kind add up.

    Attributes
    ----------
    output
        Name of the program output with the values, one row per entry of ``bus``.
    """

    name: str
    unit: str
    description: str
    bus: Index
    output: str

    def at_buses(self, solution: Solution, network: PerUnitNetwork) -> Array:
        """Return the power at each bus, ``(buses, stages)`` in per unit."""
        values = solution.value(self.output)
        total = np.zeros((len(network.bus), values.shape[1]))
        np.add.at(total, self.bus, values)
        return total


@dataclass(frozen=True)
class State:
    """A quantity that links successive problems of a receding horizon.

    A ``stock`` evolves from stage to stage by an equation and has one more point than there are stages.
    A ``dispatch`` is decided in every stage and changes by at most ``ramp`` per hour. A ``setting`` of the
    network is decided in every stage, and what it moves may be counted.

    Attributes
    ----------
    initial
        Field with the default initial value.
    ramped
        Items with a ramp limit, or whose moves are counted.
    first
        Blocks of rows that limit the change from the value before the first stage.
    ends
        Whether terminal conditions apply to a stock.
    capacity
        Upper limit of a stock without what may exceed it, of which terminal conditions state a share.
    peak
        Whether it is the maximum of a quantity so far; see :func:`opfmodel.model.peak.declare_peak`.
    """

    name: str
    kind: str
    unit: str
    role: Literal["stock", "dispatch", "setting"]
    initial: str | None = None
    ramped: Index | None = None
    first: tuple[str, ...] = ()
    ends: bool = False
    capacity: Bound = np.inf
    peak: bool = False


@dataclass(frozen=True)
class BoundSource:
    """Source of the bounds of a block, evaluated in every solve to follow the time series.

    Attributes
    ----------
    nodes
        Node whose bounds apply to each column, if there is not one per node. Limits hold at the end of a
        stage; those of the first one apply before it too, which is node -1.
    """

    kind: str
    lower: Bound
    upper: Bound
    nodes: Index | None = None

    def resolve(self, table: Table) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        """Return the bounds as arrays of one column, or of one per column of the block."""
        return self._at_nodes(resolved(table, self.lower)), self._at_nodes(resolved(table, self.upper))

    def _at_nodes(self, bound: npt.NDArray[Any]) -> npt.NDArray[Any]:
        if self.nodes is None or bound.ndim < 2 or bound.shape[1] == 1:
            return bound
        return np.asarray(bound[:, np.maximum(self.nodes, 0)])


def resolved(table: Table, bound: Bound) -> npt.NDArray[Any]:
    """Return a bound as an array: from a field, a function of the table, or as given."""
    if isinstance(bound, str):
        return np.asarray(table.arrays[bound])
    return np.asarray(bound(table) if callable(bound) else bound)
