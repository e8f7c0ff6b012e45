"""Flexible loads."""

from __future__ import annotations

import math
from collections.abc import Iterator
from datetime import UTC, datetime, time, timedelta
from itertools import count
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np
import numpy.typing as npt

from opfmodel.check.equipment.base import Equipment
from opfmodel.check.trajectories import Array, Complex, Trajectories
from opfmodel.data.series import SeriesKey
from opfmodel.network.components import FlexibleLoad

__all__ = ["FlexibleLoads"]

_SAME = 1e-6  # h


class FlexibleLoads(Equipment):
    """Power limits inside and outside windows, and the energy that each window has received."""

    component = FlexibleLoad

    def check(self) -> None:
        """Check power, and energy with its beginning and end in every window."""
        checker, loads = self.checker, self.items
        if not loads.names:
            return
        p, hours = loads.values("flexible_load_p"), checker.hours
        windows = [_windows(load, checker.trajectories) for load in loads.members]
        inside, opens, closes, left = (np.array(parts) for parts in zip(*windows, strict=True))
        low, high = loads.bounds("power")
        limits = np.where(inside, low, 0.0), np.where(inside, high, 0.0)
        checker.inside("flexible load power", loads, p, limits, "MW")
        if checker.has("flexible_load_q"):
            share = np.tan(np.arccos(loads.constant("power_factor")))
            gap = np.abs(loads.values("flexible_load_q") - share * p)
            checker.note("flexible load q", loads.names, gap, "MVAr")
        if not checker.has("flexible_load_delivered", "flexible_load_delivered_next"):
            checker.leave_out("energy of flexible loads: the results do not include it")
            return
        start, end = loads.values("flexible_load_delivered"), loads.values("flexible_load_delivered_next")
        energy, gain = loads.constant("energy"), loads.constant("efficiency")
        checker.continuous("flexible load continuity", loads, start, end, "MWh")
        begun = np.where(opens, 0.0, start)
        received = (end - begun) / hours - gain * p
        checker.note("flexible load dynamics", loads.names, np.abs(received), "MW")
        checker.inside("flexible load energy", loads, end, (0.0 * energy, energy), "MWh")
        firm = np.isinf(loads.constant("unserved_cost"))
        pairs = zip(loads.names, loads.members, strict=True)
        most = np.array([self._most_power(name, load) for name, load in pairs])
        reachable = np.where(inside, np.maximum(energy - gain * most[:, None] * left, 0.0), 0.0)
        wanted = np.where(closes, energy, reachable)
        checker.note("flexible load due", loads.names, np.where(firm, wanted - end, -energy), "MWh")

    def _most_power(self, name: str, load: FlexibleLoad) -> float:
        """Maximum power of a load in any step."""
        series, key = self.checker.trajectories.series, SeriesKey(name, "power_max")
        return max(load.power[1], float(np.max(series[key])) if key in series else -math.inf)

    def power(self) -> Iterator[tuple[list[str], Complex]]:
        """Yield what is drawn."""
        loads = self.items
        if loads.names:
            yield loads.each("bus"), -self.checker.power("flexible_load_p", "flexible_load_q", loads)

    def cost_rate(self) -> Array | float:
        """Cost of what is missing at the end of windows."""
        loads, checker = self.items, self.checker
        price = loads.constant("unserved_cost")
        if not np.isfinite(price).any() or not checker.has("flexible_load_delivered_next"):
            return 0.0
        closes = np.array([_windows(load, checker.trajectories)[2] for load in loads.members])
        missing = loads.constant("energy") - loads.values("flexible_load_delivered_next")
        missing = np.where(closes & np.isfinite(price), np.maximum(missing, 0.0), 0.0)
        return np.asarray((np.where(np.isfinite(price), price, 0.0) * missing).sum(axis=0) / checker.hours)


_Mask = npt.NDArray[np.bool_]


def _windows(load: FlexibleLoad, at: Trajectories) -> tuple[_Mask, _Mask, _Mask, Array]:
    """Return for each stage whether it is in a window, opens one, ends with it, and the hours left in it.

    Windows are found one by one as instants, from times of day in the local zone.
    """
    starts, instant = _instants(at)
    ends = starts + at.hours
    inside, opens, closes = (np.zeros(starts.size, dtype=bool) for _ in range(3))
    left = np.zeros(starts.size)
    first = math.floor((starts[0] - load.begin) / load.every) - 2
    for number in count(first):
        begin = load.begin + number * load.every
        opening, closing = instant(begin), instant(begin + load.hours)
        if opening > ends[-1] + _SAME:
            return inside, opens, closes, left
        own = (starts > opening - _SAME) & (ends < closing + _SAME)
        inside |= own
        opens |= own & (np.abs(starts - opening) < _SAME)
        closes |= own & (np.abs(ends - closing) < _SAME)
        left[own] = closing - ends[own]
    raise AssertionError


def _instants(at: Trajectories) -> tuple[Array, Any]:
    """Return the beginnings of the stages in hours, and the instant of a time of day, in the same hours.

    Both count from midnight of the day on which the series begin.
    """
    before = float(at.begins[0]) * float(at.data.attrs.get("step_hours", 1.0)) if at.begins.size else 0.0
    stamps = at.data["time"].values
    if not np.issubdtype(stamps.dtype, np.datetime64):
        return np.asarray(at.times, dtype=float), float
    zone = ZoneInfo(str(at.data["time"].attrs.get("zone", "UTC")))
    seconds = float(stamps[0].astype("datetime64[ns]").astype(np.int64)) / 1e9 - 3600.0 * before
    midnight = datetime.combine(datetime.fromtimestamp(round(seconds), tz=zone).date(), time())

    def instant(clock: float) -> float:
        wall = midnight + timedelta(seconds=round(3600 * clock))
        found = wall.replace(tzinfo=zone, fold=0).astimezone(UTC)
        if found.astimezone(zone).replace(tzinfo=None) != wall:  # skipped: clocks are put forward over it
            early = wall.replace(tzinfo=zone, fold=1).astimezone(UTC)
            while found - early > timedelta(seconds=1):
                middle = early + (found - early) / 2
                later = middle.astimezone(zone).replace(tzinfo=None) >= wall
                early, found = (early, middle) if later else (middle, found)
        return (found.timestamp() - midnight.replace(tzinfo=UTC).timestamp()) / 3600.0

    zero = midnight.replace(tzinfo=UTC).timestamp()
    nanoseconds = stamps.astype("datetime64[ns]").astype(np.int64)
    return np.asarray(nanoseconds / 1e9 - zero) / 3600.0, instant
