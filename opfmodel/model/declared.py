"""What is declared in a model, as plain values: quantities, prices, injections, states, sources of bounds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from opfmodel.network.arrays import PerUnitNetwork, Table
from solvers import Expression, Solution

__all__ = ["Bound", "BoundSource", "Injection", "Price", "Published", "State", "resolved"]

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
Bound = str | float | npt.NDArray[Any] | Callable[[Table], npt.NDArray[Any]]


@dataclass(frozen=True)
class Published:
    """A quantity that a plan reports and others may use.

    Attributes
    ----------
    kind
        Kind of component, which is also the dimension in results.
    values
        Expression of shape ``(items, stages)`` in per unit.
    """

    kind: str
    unit: str
    description: str
    values: Expression


@dataclass(frozen=True)
class Price:
    """A shadow price that plans report, read from the multipliers of a solution.

    Attributes
    ----------
    read
        Gives the price as an array ``(items, stages)`` in $ and per unit.
    """

    kind: str
    unit: str
    description: str
    read: Callable[[Solution, PerUnitNetwork], Array]


@dataclass(frozen=True)
class Injection:
    """Power that one kind of device feeds into the buses; several of a kind add up.

    Attributes
    ----------
    output
        Name of the program's output with the values, one row per entry of ``bus``.
    """

    name: str
    unit: str
    description: str
    bus: Index
    output: str

    def at_buses(self, solution: Solution, network: PerUnitNetwork) -> Array:
        """The power at each bus, ``(buses, stages)`` in per unit."""
        values = solution.value(self.output)
        total = np.zeros((len(network.bus), values.shape[1]))
        np.add.at(total, self.bus, values)
        return total


@dataclass(frozen=True)
class State:
    """A quantity that one problem of a receding horizon hands to the next.

    ``stock`` is carried from stage to stage by an equation and has one more point than there are
    stages; ``dispatch`` is decided afresh, at most ``ramp`` per hour away from what it was.

    Attributes
    ----------
    initial
        Field with the value to start from where none is given.
    ramped
        Items that have a ramp limit.
    """

    name: str
    kind: str
    unit: str
    role: Literal["stock", "dispatch"]
    initial: str | None = None
    ramped: Index | None = None

    @property
    def is_energy(self) -> bool:
        """Whether it is stored energy, of which something may be asked at the end of the horizon."""
        return self.role == "stock" and self.unit == "MWh"


@dataclass(frozen=True)
class BoundSource:
    """Where the bounds of a block come from, so that a time series reaches them in every solve."""

    kind: str
    lower: Bound
    upper: Bound

    def resolve(self, table: Table) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        """The bounds as numbers."""
        return resolved(table, self.lower), resolved(table, self.upper)


def resolved(table: Table, bound: Bound) -> npt.NDArray[Any]:
    """Numbers of a bound: of a field, a function of the table, or as given."""
    if isinstance(bound, str):
        return np.asarray(table.arrays[bound])
    return np.asarray(bound(table) if callable(bound) else bound)
