"""A plan in a few lines: units by bus, the range of prices, and the limits that bind."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from opfmodel.results.limits import loading, sides

__all__ = ["Limited", "Unit", "limited", "price_range", "units"]

Array = npt.NDArray[np.float64]

# Kind, quantity, and sign of an injection into the grid.
_UNITS = (
    ("generator", "pg", 1.0),
    ("renewable", "renewable_p", 1.0),
    ("connection", "connection_p", 1.0),
    ("storage", "ps", -1.0),
    ("flexible_load", "flexible_load_p", -1.0),
)
_RATED = 99.99  # percent of its rating from which on a branch is at it


class Unit(NamedTuple):
    """What a unit does.

    Attributes
    ----------
    mean_mw, min_mw, max_mw
        Active power into the grid over the stages: mean by their length, least and largest.
    energy_mwh
        Energy into the grid.
    price
        Mean price of active power at its bus, weighted by the energy; NaN without energy or prices.
    stages_at_limit
        Number of stages in which it is at a limit of active power.
    """

    name: str
    kind: str
    bus: str
    mean_mw: float
    min_mw: float
    max_mw: float
    energy_mwh: float
    price: float
    stages_at_limit: int


class Limited(NamedTuple):
    """A limit that binds: of what, of which component, on which side, and in how many stages."""

    quantity: str
    component: str
    side: str
    stages: int


def units(data: Any) -> list[Unit]:
    """Return what each unit does, in the order of declaration.

    Parameters
    ----------
    data
        Trajectories over ``time``, as a dataset or as :class:`Labelled`.
    """
    at_limit, hours = sides(data), _hours(data)
    known = data["bus"].values.tolist()
    price = data["lmp"].values if "lmp" in data else None
    made = []
    for kind, quantity, sign in _UNITS:
        if quantity not in data or data[quantity].dims != ("time", kind):
            continue
        power = sign * data[quantity].values
        for number, name in enumerate(data[kind].values):
            own = power[:, number]
            bus = str(data[f"{kind}_bus"].values[number]) if f"{kind}_bus" in data else ""
            energy = float((own * hours).sum())
            paid = np.nan
            if price is not None and bus in known and energy:
                paid = float((price[:, known.index(bus)] * own * hours).sum()) / energy
            bound = int(np.count_nonzero(at_limit[quantity][:, number])) if quantity in at_limit else 0
            mean = energy / float(hours.sum())
            made.append(
                Unit(str(name), kind, bus, mean, float(own.min()), float(own.max()), energy, paid, bound)
            )
    return made


def price_range(data: Any) -> tuple[tuple[float, str], float, tuple[float, str]] | None:
    """Return the least price of active power and its bus, the mean, and the largest; None without prices."""
    if "lmp" not in data or not np.isfinite(data["lmp"].values).all():
        return None
    price, names = data["lmp"].values, data["bus"].values
    least, most = (np.unravel_index(int(of(price)), price.shape) for of in (np.argmin, np.argmax))
    return (
        (float(price[least]), str(names[least[1]])),
        float(np.average(price.mean(axis=1), weights=_hours(data))),
        (float(price[most]), str(names[most[1]])),
    )


def limited(data: Any) -> list[Limited]:
    """Return the limits that bind, those of branches first, then in the order of the quantities."""
    return [*_rated(data), *_bounded(data)]


def _bounded(data: Any) -> Iterator[Limited]:
    for quantity, side in sides(data).items():
        kind = data[quantity.removesuffix("_ramp")].dims[1]
        for word, sign in (("maximum", 1), ("minimum", -1)):
            many = np.count_nonzero(side == sign, axis=0)
            for number in np.flatnonzero(many):
                yield Limited(quantity, str(data[kind].values[number]), word, int(many[number]))


def _rated(data: Any) -> Iterator[Limited]:
    percent = loading(data)
    if percent is not None:
        many = np.count_nonzero(percent >= _RATED, axis=0)  # NaN is at no rating
        for number in np.flatnonzero(many):
            yield Limited("flow", str(data["branch"].values[number]), "rating", int(many[number]))


def _hours(data: Any) -> Array:
    """Return the lengths of the stages."""
    if "hours" in data:
        return np.asarray(data["hours"].values, dtype=float)
    return np.full(data["time"].values.size, float(data.attrs.get("step_hours", 1.0)))
