"""Settings of the network: adjustable quantities such as taps, and the moves that are counted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from opfmodel.model.declared import State
from solvers import Expression

if TYPE_CHECKING:
    from opfmodel.model.model import Model

__all__ = ["Setting", "declare_setting"]

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Setting:
    """An adjustable quantity of the network, which contingencies leave as it was.

    Attributes
    ----------
    neutral, low, high
        Value nearest to the default, and range, ``(items, 1)`` per unit.
    positions
        Number of equidistant positions of each item, ``(items, 1)``, infinite if it takes any value.
    """

    kind: str
    name: str
    neutral: Array
    low: Array
    high: Array
    positions: Array

    @property
    def stepped(self) -> npt.NDArray[np.bool_]:
        """Which items have positions, ``(items, 1)``."""
        return np.isfinite(self.positions) & (self.low < self.high)

    @property
    def size(self) -> Array:
        """Distance between two positions, ``(items, 1)``; 1 without positions."""
        gaps = np.where(self.stepped, self.positions - 1.0, 1.0)
        return np.asarray(np.where(self.stepped, (self.high - self.low) / gaps, 1.0))

    def rounded(self, values: Array) -> Array:
        """Return the positions nearest to some values; NaN for items without positions."""
        nearest = self.low + self.size * np.rint((values - self.low) / self.size)
        return np.where(self.stepped, nearest, np.nan)


def declare_setting(
    model: Model, kind: str, name: str, field: str, positions: Array, *, unit: str, description: str
) -> Expression:
    """Declare an adjustable quantity of the network, which contingencies leave as it was.

    Components with a ``move_cost`` have the positions by which it moves in each stage counted as
    ``name_moves``; the first stage moves from the position applied last.

    Parameters
    ----------
    field
        Adjustable field with its range.
    positions
        Number of positions of each item, ``(items, 1)``, infinite if it takes any value.
    """
    horizon, table = model.horizon, model.network.tables[kind]
    low, high = table.arrays[f"{field}_min"], table.arrays[f"{field}_max"]
    values = model.variable(
        kind, name, f"{field}_min", f"{field}_max",
        unit=unit, start=table.arrays[field], nodes=np.arange(len(horizon.regular)), publish=False,
    )  # fmt: skip
    chosen = values[:, horizon.owner] if horizon.contingencies.size else values
    model.publish(kind, name, chosen, unit=unit, description=description)
    setting = model.settings[name] = Setting(kind, name, table.arrays[field], low, high, positions)
    counted = np.flatnonzero(setting.stepped & np.isfinite(table.move_cost))
    rows = _count_moves(model, setting, values, counted) if counted.size else ()
    model.states[name] = State(name, kind, unit, "setting", ramped=counted, first=rows)
    return chosen


def _count_moves(model: Model, setting: Setting, values: Expression, counted: Index) -> tuple[str, ...]:
    """Count the positions by which items of a setting move; return the rows of the first stage."""
    kind, name, horizon = setting.kind, setting.name, model.horizon.regular
    most = np.zeros((values.items, 1))
    most[counted] = np.inf
    moves = model.variable(
        kind, f"{name}_moves", 0.0, most,
        unit="", start=0.0, nodes=np.arange(len(horizon)), description=f"positions by which {name} moves",
    )[counted]  # fmt: skip
    at, size = values[counted], setting.size[counted]
    before = model.build.parameter(f"{name}_previous", counted.size)
    change = {"first": (at[:, model.starts] - before, model.starts)}
    if horizon.inner.size:
        earlier = horizon.parent[horizon.inner]
        change["later"] = at[:, horizon.inner] - at[:, earlier], horizon.inner
    for when, (moved, nodes) in change.items():
        for way, sign in (("up", 1.0), ("down", -1.0)):
            distance = (sign / size) * moved - moves[:, nodes]
            model.rows(kind, f"{name}_{way}_{when}", distance, -np.inf, 0.0, nodes=nodes)
    return f"{name}_up_first", f"{name}_down_first"
