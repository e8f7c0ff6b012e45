"""Flexible loads."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from opfmodel.data.calendar import Times, duration
from opfmodel.errors import ComponentError, IncompatibleError
from opfmodel.network.component import Clocked, Component, component
from opfmodel.network.fields import at_bus, in_service, number, span

__all__ = ["FlexibleLoad"]

_SAME = 1e-6  # h; distance of a window from the beginning of a step that is rounding
_SHIFT = 3.0  # h; clocks are put back by less


class _Windows(NamedTuple):
    """The windows at some steps: masks of the steps in one, of the first and last of each, and what is left.

    Attributes
    ----------
    left
        Hours from the end of a step to that of its window; 0 outside.
    """

    inside: npt.NDArray[np.bool_]
    opens: npt.NDArray[np.bool_]
    closes: npt.NDArray[np.bool_]
    left: npt.NDArray[np.float64]


@component
class FlexibleLoad(Component):
    """A demand for energy, not power: so many MWh in every window of the clock, within power limits."""

    kind: ClassVar[str] = "flexible_load"
    plural: ClassVar[str] = "flexible_loads"
    clocked: ClassVar[Mapping[str, Clocked]] = {
        "inside": Clocked("", "min", loosest=1.0),  # 1 in a window, 0 outside
        "kept": Clocked("", "min", loosest=1.0),  # 0 in the stage that opens a window, else 1
        "due": Clocked("", "max"),  # 1 in the stage that ends with a window, else 0
        "hours_left": Clocked("h", "min"),  # from the end of a stage to that of its window
    }

    bus: str = at_bus()
    energy: float = number("MWh", at_least=0.0, series=False, description="Energy wanted in every window.")
    power: tuple[float, float] = span(
        "MW",
        averaged=True,
        description="(min, max) of the power drawn in a window; a negative minimum feeds back. It is zero "
        "outside.",
    )
    begin: float = number(
        "h",
        0.0,
        at_least=0.0,
        series=False,
        description="Time of day at which a window begins, in local time; without a calendar, step 0 begins "
        "at midnight.",
    )
    hours: float = number("h", 24.0, above=0.0, series=False, description="Length of a window.")
    every: float = number("h", 24.0, above=0.0, series=False, description="Time from one window to the next.")
    efficiency: float = number(
        "",
        1.0,
        at_least=1e-3,
        at_most=1.0,
        series=False,
        description="Energy delivered per energy drawn; below 1 only without feeding back.",
    )
    power_factor: float = number(
        "",
        1.0,
        at_least=1e-3,
        at_most=1.0,
        series=False,
        description="Active per apparent power; reactive power is drawn.",
    )
    unserved_cost: float | None = number(
        "$/MWh",
        None,
        at_least=0.0,
        optional=True,
        series=False,
        description="Cost of energy that is missing at the end of a window; none if nothing may be missing.",
    )
    delivered: float = number(
        "MWh",
        0.0,
        at_least=0.0,
        series=False,
        description="Energy delivered before the first step in a window that is open already.",
    )
    p_set: float | None = number(
        "MW",
        None,
        optional=True,
        series=False,
        description="Set-point of the power drawn in a power flow; none for 0.",
    )
    in_service: bool = in_service()

    def check(self, name: str) -> None:
        """Raise :class:`ComponentError` if a field breaks a rule or no window can hold the energy."""
        super().check(name)
        low, high = self.power
        if not (math.isfinite(low) and math.isfinite(high)):
            raise ComponentError(name, "power", self.power, "both ends must be finite")
        if low < 0 and self.efficiency < 1:
            rule = "must be 1 for a load that feeds back; use a Storage"
            raise ComponentError(name, "efficiency", self.efficiency, rule)
        if self.begin >= self.every:
            raise ComponentError(name, "begin", self.begin, f"must be below every = {self.every:g}")
        if self.hours > self.every:
            raise ComponentError(name, "hours", self.hours, f"must be at most every = {self.every:g}")
        if self.delivered > self.energy:
            raise ComponentError(
                name, "delivered", self.delivered, f"must be at most energy = {self.energy:g}"
            )
        least, most = (self.efficiency * self.hours * power for power in (low, high))
        if self.energy > most + 1e-9 * abs(most) and self.unserved_cost is None:
            rule = f"a window takes at most {most:g} MWh; state unserved_cost if some may be missing"
            raise ComponentError(name, "energy", self.energy, rule)
        if self.energy < least - 1e-9 * abs(least):
            raise ComponentError(name, "energy", self.energy, f"a window takes at least {least:g} MWh")

    def at_clock(self, times: Times) -> Mapping[str, npt.NDArray[np.float64]]:
        """Return where the steps are in their windows."""
        windows = self._windows(times)
        return {
            "inside": windows.inside.astype(float),
            "kept": 1.0 - windows.opens,
            "due": windows.closes.astype(float),
            "hours_left": windows.left,
        }

    def check_clock(self, name: str, times: Times, lengths: npt.NDArray[np.intp]) -> None:
        """Raise :class:`IncompatibleError` if a window begins or ends inside a stage."""
        first, end = int(times.steps.min()), int((times.steps + lengths).max())
        every_step = Times(np.arange(first, end), times.step, times.calendar)
        windows, clock = self._windows(every_step), every_step.clock
        within = np.zeros(clock.size, dtype=bool)  # a step with a boundary inside itself
        for boundary in (self.begin, self.begin + self.hours):
            ahead = (boundary - clock) % self.every
            ahead[ahead <= _SAME] += self.every
            within |= ahead < times.step - _SAME
        begins, ends = times.steps - first, times.steps - first + lengths
        broken = (
            _count(within, begins, ends)
            + _count(windows.opens, begins + 1, ends)
            + _count(windows.closes, begins, ends - 1)
        )
        if broken.any():
            stage = int(np.argmax(broken > 0))
            close = (self.begin + self.hours) % 24.0
            raise IncompatibleError(
                f"{name}: a window from {_time(self.begin)} to {_time(close)} every "
                f"{duration(self.every)} begins or ends inside the stage of "
                f"{duration(float(lengths[stage]) * times.step)} that begins at {times.shown[stage]}; stages "
                "must begin and end with the windows"
            )

    def _windows(self, times: Times) -> _Windows:
        """Return where the steps, which follow one another, are in their windows.

        Where clocks are put back, the hour that occurs twice belongs to what came before it: windows begin
        and end when a time of day first occurs. Where they are put forward, one that would begin or end in
        the missing hour does so at once.
        """
        first, count = int(times.steps[0]), times.steps.size
        before = min(first, math.ceil(_SHIFT / times.step))
        after = math.ceil((self.hours + _SHIFT) / times.step)
        steps = np.arange(first - before, first + count + after)
        clock = np.maximum.accumulate(Times(steps, times.step, times.calendar).clock)
        since = clock - self.begin + _SAME
        number = np.floor(since / self.every)
        inside = since - number * self.every < self.hours
        # the step before the data is not known: a window is open already unless it begins right there
        previous = np.append(number[0] - (abs(since[0] % self.every - _SAME) < _SAME), number[:-1])
        was_inside = np.append(inside[0], inside[:-1])
        opens = inside & ((number != previous) | ~was_inside)
        following = np.append(opens[1:] | ~inside[1:], True)
        closes = inside & following
        last = np.flatnonzero(following)  # for each step, the last one of its window
        until = last[np.searchsorted(last, np.arange(steps.size))] - np.arange(steps.size)
        left = np.where(inside, until * times.step, 0.0)
        own = slice(before, before + count)
        return _Windows(inside[own], opens[own], closes[own], left[own])


def _count(
    marks: npt.NDArray[np.bool_], begins: npt.NDArray[np.intp], ends: npt.NDArray[np.intp]
) -> npt.NDArray[np.intp]:
    """Return the number of marks from each beginning up to each end."""
    before = np.append(0, np.cumsum(marks))
    return np.asarray(before[ends] - before[begins])


def _time(hour: float) -> str:
    """Return an hour of the day as on a clock."""
    minutes = round(60 * hour)
    return f"{minutes // 60:02}:{minutes % 60:02}"
