"""Trajectories, time series and declared fields as arrays, for a check."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import datetime, time
from itertools import chain, compress
from operator import attrgetter
from typing import TYPE_CHECKING, Any, TypeAlias
from zoneinfo import ZoneInfo

import numpy as np
import numpy.typing as npt

from opfmodel.data.calendar import Calendar, Times, shown_in
from opfmodel.data.series import Profiles, SeriesKey
from opfmodel.errors import ProfileError, ResultError
from opfmodel.network.component import Component

if TYPE_CHECKING:
    import xarray as xr

    from opfmodel.data.labelled import Labelled

__all__ = ["Array", "Bounds", "Complex", "Data", "Items", "Series", "Trajectories"]

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complexfloating]
Series = Mapping[Any, npt.ArrayLike]
Bounds = tuple[Array, Array]
Data: TypeAlias = "xr.Dataset | Labelled"

_OVER: Mapping[str, Callable[..., Any]] = {
    "mean": np.mean,
    "min": np.min,
    "max": np.max,
    "last": lambda steps: steps[-1],
}


def _times(data: Data) -> tuple[Array, Callable[[int], str]]:
    """Hours at which the stages begin, and a function that returns the beginning of one as text."""
    times = data["time"].values
    if not np.issubdtype(times.dtype, np.datetime64):
        hours = np.asarray(times, dtype=float)
        return hours, lambda stage: f"hour {hours[stage]:g}"
    zone = str(data["time"].attrs.get("zone", "UTC"))
    return (times - times[:1]) / np.timedelta64(1, "h"), lambda stage: shown_in(times[stage], zone)


class Trajectories:
    """Trajectories and time series as arrays ``(items, stages)``."""

    def __init__(self, data: Data, series: Series | None, first: int) -> None:
        self.data = data
        self.times, self.moments = _times(data)
        self.base = base = float(data.attrs.get("step_hours", 1.0))
        self.hours = np.asarray(data["hours"].values if "hours" in data else np.full(len(self.times), base))
        lengths = np.rint(self.hours / base).astype(int)  # in steps of the series
        self.begins = first + np.cumsum(lengths) - lengths
        self.ends = self.begins + lengths
        self.series = Profiles.of(series)
        self.changing = {key.field for key in self.series}
        self.positions: dict[str, dict[str, int]] = {}

    def clock(self, steps: npt.NDArray[np.intp]) -> Array:
        """Local times of the beginnings of steps, h since midnight of the day of step 0."""
        times = self.data["time"].values
        if not np.issubdtype(times.dtype, np.datetime64):
            return np.asarray(self.times[0] + (steps - self.begins[0]) * self.base)
        zone = ZoneInfo(str(self.data["time"].attrs.get("zone", "UTC")))
        length = np.timedelta64(round(self.base * 3.6e12), "ns")
        stamps = times[0] + (np.append(0, steps) - self.begins[0]) * length
        seconds = stamps.astype("datetime64[s]").astype(np.int64).tolist()
        walls = [datetime.fromtimestamp(second, tz=zone).replace(tzinfo=None) for second in seconds]
        midnight = datetime.combine(walls[0].date(), time())
        return np.array([(wall - midnight).total_seconds() / 3600.0 for wall in walls[1:]])

    def has(self, *quantities: str) -> bool:
        """Whether the data contain all given quantities."""
        return all(quantity in self.data for quantity in quantities)

    def position(self, kind: str) -> dict[str, int]:
        """Position of each component of a kind in the data."""
        if kind not in self.positions:
            names = self.data[kind].values.tolist() if kind in self.data.coords else []
            self.positions[kind] = {name: i for i, name in enumerate(names)}
            if len(self.positions[kind]) < len(names):
                twice = next(name for name in names if names.count(name) > 1)
                raise ResultError(f"data: {kind}: {twice!r} occurs more than once; names must be unique")
        return self.positions[kind]

    def of(self, quantity: str, names: list[str]) -> Array:
        """Values of a quantity for the named components, in its physical unit."""
        if not names:  # the quantity may be missing if there are no components
            return np.zeros((0, len(self.times)))
        if quantity not in self.data:
            raise ResultError(f"data: no such quantity: {quantity!r}")
        array = self.data[quantity]
        kind = next(str(d) for d in array.dims if d != "time")
        position = self.position(kind)
        values = np.asarray(array.values, dtype=float)
        values = values.T if array.dims[0] == "time" else values
        lacking = next((name for name in names if name not in position), None)
        if lacking is not None:
            raise ResultError(f"data: {kind}: {quantity!r} has no values of {lacking!r}")
        return values[[position[name] for name in names]]

    def declared(self, field: str, names: list[str], constants: Array, rule: str) -> Array:
        """Values of a field: ``constants`` of shape ``(items, 1)``, replaced by time series where given.

        Over a stage of several steps the rule applies: ``mean``, ``min`` and ``max`` of limits, or ``last``.
        """
        end = int(self.ends.max(initial=0))
        keys = {i: SeriesKey(name, field) for i, name in enumerate(names)} if field in self.changing else {}
        changing = {i: self.series[key] for i, key in keys.items() if key in self.series}
        values = np.repeat(constants, len(self.times), axis=1) if changing else constants
        for i, whole in changing.items():
            if len(whole) < end:
                raise ProfileError(
                    f"profile {str(keys[i])!r}: has {len(whole)} values; {end} are needed", keys[i]
                )
            values[i] = [_OVER[rule](whole[b:e]) for b, e in zip(self.begins, self.ends, strict=True)]
        return values

    def from_clock(self, items: Items, field: str) -> Array:
        """Values of a quantity that follows from the time of day, ``(items, stages)``."""
        moments = self.data["time"].values
        base = float(self.data.attrs.get("step_hours", 1.0))
        calendar, begins, ends = None, self.begins, self.ends
        if np.issubdtype(moments.dtype, np.datetime64):
            zone = str(self.data["time"].attrs.get("zone", "UTC"))
            since = np.timedelta64(round(float(begins[0]) * base * 3600e9), "ns")
            calendar = Calendar(moments[0] - since, base, zone)
        else:  # hours are counted from step 0, whatever the position in the series
            begins = begins - begins[0] + round(float(moments[0]) / base)
            ends = begins + self.ends - self.begins
        times = Times(np.arange(begins[0], ends[-1]), base, calendar)
        made = np.zeros((len(items.names), len(self.times)))
        for row, member in zip(made, items.members, strict=True):
            steps, over = member.at_clock(times)[field], _OVER[member.over(field)]
            row[:] = [over(steps[b:e]) for b, e in zip(begins - begins[0], ends - begins[0], strict=True)]
        return made


@dataclass(frozen=True)
class Items:
    """Components of one kind. Fields have shape ``(items, 1)``, or ``(items, stages)`` with time series."""

    names: list[str]
    members: list[Any]
    trajectories: Trajectories
    kind: str

    def where(self, mask: npt.ArrayLike) -> Items:
        """Select components by a Boolean mask."""
        chosen = np.asarray(mask, dtype=bool).tolist()
        return replace(self, names=[*compress(self.names, chosen)], members=[*compress(self.members, chosen)])

    def values(self, quantity: str) -> Array:
        """Values of a quantity for all components, in its physical unit."""
        return self.trajectories.of(quantity, self.names)

    def each(self, field: str) -> list[Any]:
        """Declared values of a field for all components."""
        return list(map(attrgetter(field), self.members))

    def constant(self, field: str) -> Array:
        """Values of a number field for all components; None becomes infinity (no limit)."""
        values = [math.inf if value is None else value for value in self.each(field)]
        return np.array(values, dtype=float)[:, None]

    def span(self, field: str) -> Bounds:
        """Minimum and maximum; a number a stands for (-a, a) or, in an adjustable field, for itself."""
        fixed = any(member.fields()[field].metadata["form"] == "adjustable" for member in self.members[:1])
        pairs = [
            pair if isinstance(pair, tuple | list) else (pair if fixed else -pair, pair)
            for pair in self.each(field)
        ]
        ends = np.fromiter(chain.from_iterable(pairs), dtype=float).reshape(-1, 2)
        return ends[:, :1], ends[:, 1:]

    def number(self, field: str) -> Array:
        """Values of a number field for all components, including time series."""
        return self._declared(field, self.constant(field))

    def bounds(self, field: str) -> Bounds:
        """Minimum and maximum for all components, including time series."""
        low, high = self.span(field)
        return self._declared(f"{field}_min", low), self._declared(f"{field}_max", high)

    def neutral(self, field: str) -> Array:
        """Constants of an adjustable field, or the values in its ranges nearest to its default."""
        return np.array([member.neutral(field) for member in self.members], dtype=float).reshape(-1, 1)

    def setting(self, quantity: str, field: str) -> Array:
        """Values that were decided for an adjustable field, if the data have them, else neutral ones."""
        return self.values(quantity) if self.trajectories.has(quantity) else self.neutral(field)

    def status(self) -> Array:
        """1 where a component is in service and 0 where it is out; in service if the data do not say."""
        name = f"{self.kind}_status"
        if not (self.names and self.trajectories.has(name)):
            return np.ones((len(self.names), len(self.trajectories.times)))
        return (self.values(name) > 0).astype(float)

    def left(self, field: str) -> Bounds:
        """Minimum and maximum of the part that is in service and runs, zero where there is none."""
        part = (self.status() > 0).astype(float)
        if self.members and hasattr(self.members[0], "on"):
            part = part * self.number("on")
        low, high = (
            np.multiply(part, end, out=np.zeros_like(part), where=part > 0) for end in self.bounds(field)
        )
        return low, high

    def _declared(self, field: str, constants: Array) -> Array:
        one = self.members[0] if self.members else None
        rule = one.over(field) if isinstance(one, Component) else "mean"
        return self.trajectories.declared(field, self.names, constants, rule)
