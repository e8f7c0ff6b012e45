"""Limits of the quantities in a dataset, and the stages in which they bind."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from opfmodel.network.arrays import PerUnitNetwork, Table

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["LIMITS", "RAMPS", "RATINGS", "binding", "limits", "loading", "sides"]

Array = npt.NDArray[np.float64]

# Distance from a limit below which it binds, relative to the range of the quantity and to its other limit
# where that is infinite. Interior-point solvers stop short of a limit.
_NEAR = 5e-4


class Limit(NamedTuple):
    """The limits of a quantity: its kind, unit and description, and how both limits are found."""

    kind: str
    unit: str
    description: str
    lower: Callable[[Table], Array]
    upper: Callable[[Table], Array]


LIMITS = {
    "vm": Limit("bus", "p.u.", "voltage magnitude", lambda t: t.vm_min, lambda t: t.vm_max),
    "pg": Limit("generator", "MW", "active generation", lambda t: t.p_min, lambda t: t.p_max),
    "qg": Limit("generator", "MVAr", "reactive generation", lambda t: t.q_min, lambda t: t.q_max),
    "ps": Limit(
        "storage",
        "MW",
        "charging power",
        lambda t: np.maximum(t.power_min, -t.rating),
        lambda t: np.minimum(t.power_max, t.rating),
    ),
    "qs": Limit(
        "storage",
        "MVAr",
        "reactive power drawn",
        lambda t: np.maximum(t.q_min, -t.rating),
        lambda t: np.minimum(t.q_max, t.rating),
    ),
    "renewable_p": Limit(
        "renewable",
        "MW",
        "renewable generation",
        lambda t: np.zeros_like(t.available),
        lambda t: np.minimum(t.available, t.rating),
    ),
    "renewable_q": Limit(
        "renewable",
        "MVAr",
        "reactive power of renewables",
        lambda t: np.maximum(t.q_min, -t.rating),
        lambda t: np.minimum(t.q_max, t.rating),
    ),
    "flexible_load_p": Limit(
        "flexible_load",
        "MW",
        "power drawn",
        lambda t: t.power_min * t.inside,
        lambda t: t.power_max * t.inside,
    ),
    "dc_line_pf": Limit("dc_line", "MW", "power of the DC line", lambda t: t.p_min, lambda t: t.p_max),
    "dc_line_qf": Limit(
        "dc_line", "MVAr", "reactive power at the from end", lambda t: t.q_from_min, lambda t: t.q_from_max
    ),
    "dc_line_qt": Limit(
        "dc_line", "MVAr", "reactive power at the to end", lambda t: t.q_to_min, lambda t: t.q_to_max
    ),
    "connection_p": Limit("connection", "MW", "imported active power", lambda t: t.p_min, lambda t: t.p_max),
    "connection_q": Limit(
        "connection", "MVAr", "injected reactive power", lambda t: t.q_min, lambda t: t.q_max
    ),
    "e": Limit("storage", "MWh", "stored energy", lambda t: t.energy_min, lambda t: t.energy),
}
"""Quantities whose limits a dataset has as ``<quantity>_min`` and ``<quantity>_max``."""

RAMPS = {"pg": ("generator", "MW/h", "active generation")}
"""Quantities whose ramp limits a dataset has as ``<quantity>_ramp``."""

RATINGS = {"pf": ("branch", "rating", "MVA", "rating, of apparent power at either end")}
"""Quantities with a limit of another name: kind, name, unit and description."""


def limits(network: PerUnitNetwork, quantities: Iterable[str]) -> Iterator[tuple[str, str, str, str, Array]]:
    """Yield name, kind, unit, description and per-unit values of the limits of some quantities.

    The values have shape ``(items, 1)`` if they are constant, otherwise ``(items, stages)``. Without
    a limit, they are infinite.
    """
    present = set(quantities)
    for quantity, limit in LIMITS.items():
        if quantity in present:
            table = network.tables[limit.kind]
            yield (
                f"{quantity}_min",
                limit.kind,
                limit.unit,
                f"minimum {limit.description}",
                limit.lower(table),
            )
            yield (
                f"{quantity}_max",
                limit.kind,
                limit.unit,
                f"maximum {limit.description}",
                limit.upper(table),
            )
    for quantity, (kind, unit, description) in RAMPS.items():
        if quantity in present:
            yield f"{quantity}_ramp", kind, unit, f"ramp limit of {description}", network.tables[kind].ramp
    for quantity, (kind, name, unit, description) in RATINGS.items():
        if quantity in present:
            yield name, kind, unit, description, network.tables[kind].arrays[name]


def binding(data: xr.Dataset) -> xr.Dataset:
    """Return where limits bind: 1 at the upper limit, -1 at the lower one, 0 elsewhere.

    A limit binds if the quantity is closer to it than 0.05 % of its range, or beyond it.

    Returns
    -------
    xarray.Dataset
        Integers by the name of the quantity, with its dimensions: ``vm``, ``pg``, ``qg``, ``ps``, ``qs``,
        those of renewables and DC lines, and ``e`` at the end of each stage. ``pg_ramp`` is 1 where
        generation rises from the stage before by as much as its ramp limit permits, and -1 where it falls by
        as much. Quantities that are fixed are at no limit, nor are components while they are out of service.
        A quantity whose limits are not in the data is absent.
    """
    made = data[[]]
    for quantity, side in sides(data).items():
        name = "e_next" if quantity == "e" else quantity.removesuffix("_ramp")
        made[quantity] = data[name].drop_attrs().copy(data=side)
    return made


def sides(data: Any) -> dict[str, npt.NDArray[np.int8]]:
    """Return the values of :func:`binding` by quantity, of a dataset or of :class:`Labelled`."""
    made = {}
    for quantity, limit in LIMITS.items():
        names = ("e_next" if quantity == "e" else quantity, f"{quantity}_min", f"{quantity}_max")
        if all(name in data for name in names):
            values, low, high = (data[name].values for name in names)
            made[quantity] = _side(values, low, high, _in_service(data, limit.kind))
    for quantity, (kind, _, _) in RAMPS.items():
        if quantity in data and f"{quantity}_ramp" in data:
            before, hours = _before(data)
            change = data[quantity].values - data[quantity].values[before]
            most = data[f"{quantity}_ramp"].values * hours[:, None]
            there = _in_service(data, kind)
            # the stage before the first is unknown; a unit that trips or returns does not ramp
            there = there & there[before] & (before != np.arange(before.size))[:, None]
            made[f"{quantity}_ramp"] = _side(change, -most, most, there)
    return made


def loading(data: Any) -> Array | None:
    """Return the loading of the branches in percent of their ratings, ``(stages, branches)``.

    The larger apparent power of both ends counts; NaN without a rating.

    Parameters
    ----------
    data
        A dataset or :class:`Labelled`.

    Returns
    -------
    array or None
        None if the data have no flows or no ratings.
    """
    if not all(name in data for name in ("pf", "pt", "rating")):
        return None
    ends = [np.hypot(data[f"p{e}"].values, data[f"q{e}"].values if f"q{e}" in data else 0.0) for e in "ft"]
    rating = np.broadcast_to(data["rating"].values, ends[0].shape)
    rated = np.isfinite(rating) & (rating > 0)
    percent = np.full(ends[0].shape, np.nan)
    percent[rated] = 100 * np.maximum(*ends)[rated] / rating[rated]
    return percent if rated.any() else None


def _side(values: Array, low: Array, high: Array, free: npt.NDArray[np.bool_]) -> npt.NDArray[np.int8]:
    """Return which limit the values are at, with tolerance."""
    ends = np.abs(np.stack(np.broadcast_arrays(low, high)))
    with np.errstate(invalid="ignore"):  # infinite on both sides
        span = np.where(np.isfinite(high - low), high - low, ends.min(axis=0))
        near = _NEAR * np.where(np.isfinite(span), span, 0.0)
        there = free & (high > low)
        return ((values >= high - near) & there).astype(np.int8) - ((values <= low + near) & there)


def _in_service(data: Any, kind: str) -> npt.NDArray[np.bool_]:
    """Return which components of a kind are in service, ``(stages, items)``."""
    if f"{kind}_status" in data:
        return np.asarray(data[f"{kind}_status"].values > 0)
    return np.ones((data["time"].values.size, 1), dtype=bool)


def _before(data: Any) -> tuple[npt.NDArray[np.intp], Array]:
    """Return the stage before each, or itself without one, and the hours between their middles."""
    stages = data["time"].values.size
    before = data["parent"].values if "parent" in data else np.arange(stages) - 1
    before = np.where(before < 0, np.arange(stages), before)
    step = float(data.attrs.get("step_hours", 1.0))
    hours = data["hours"].values if "hours" in data else np.full(stages, step)
    return before, 0.5 * (hours + hours[before])
