"""Time stamps of the steps of time series."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, time
from functools import cached_property
from typing import Any
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np
import numpy.typing as npt

from opfmodel.errors import ProfileError, shown

__all__ = [
    "NANOSECONDS",
    "Calendar",
    "Times",
    "duration",
    "instants",
    "parse_stamp",
    "shown_in",
    "stated_time",
    "within_years",
    "zone_of",
]

NANOSECONDS = 3_600_000_000_000  # of an hour
_YEARS = np.datetime64("1700", "Y"), np.datetime64("2200", "Y")  # nanoseconds in 64 bits end in 2262
_RANGE = "from the years 1700 to 2199"


@dataclass(frozen=True)
class Calendar:
    """Time stamps of equal steps.

    Steps are counted in UTC: a local day may have 23 or 25 hours.

    Attributes
    ----------
    start
        Beginning of the first step, in UTC.
    step
        Length of a step, h.
    zone
        Name of the time zone in which stamps are shown, such as ``Europe/Berlin``.

    Raises
    ------
    ProfileError
        The start is not a time from the years 1700 to 2199, the step is not positive, or the zone is unknown.

    Examples
    --------
    >>> berlin = Calendar(np.datetime64("2025-03-30T00:00"), 1.0, "Europe/Berlin")
    >>> berlin.shown(0), berlin.shown(1)
    ('2025-03-30 01:00 CET', '2025-03-30 03:00 CEST')
    """

    start: np.datetime64
    step: float
    zone: str = "UTC"

    def __post_init__(self) -> None:
        zone_of(self.zone)
        object.__setattr__(self, "start", _nanoseconds(self.start))
        if not (isinstance(self.step, int | float) and self.step > 0 and self._length >= 1):
            raise ProfileError(f"step = {self.step!r}: must be a positive number of hours")

    @cached_property
    def _length(self) -> int:
        """Length of a step in nanoseconds."""
        return round(self.step * NANOSECONDS)

    def has_step(self, hours: float) -> bool:
        """Whether a step has this length, to the nanosecond."""
        return round(hours * NANOSECONDS) == self._length

    def stamps(self, steps: int, first: int = 0) -> npt.NDArray[np.datetime64]:
        """Return the beginnings of ``steps`` steps from ``first`` on, in UTC."""
        return np.asarray(self.start + np.arange(first, first + steps) * np.timedelta64(self._length, "ns"))

    def later(self, steps: int) -> Calendar:
        """Return the calendar that begins some steps later."""
        return Calendar(self.start + np.timedelta64(steps * self._length, "ns"), self.step, self.zone)

    def shown(self, step: int) -> str:
        """Return the beginning of a step in the zone, for messages."""
        return shown_in(self.stamps(1, step)[0], self.zone)

    def steps_until(self, other: Calendar) -> int:
        """Return the number of steps from the start of this calendar to that of another.

        Raises
        ------
        ProfileError
            The steps of the calendars differ in length or are out of phase, or the other one starts
            earlier.
        """
        if not self.has_step(other.step):
            raise ProfileError(
                f"time series have steps of {duration(self.step)}, not of {duration(other.step)}; "
                "all series of a problem must have the same step"
            )
        steps, rest = divmod(int((other.start - self.start).astype(np.int64)), self._length)
        if steps < 0:
            raise ProfileError(
                f"time series begin at {self.shown(0)}, later than the first step at {other.shown(0)}; "
                "they must begin at the first step or before"
            )
        if rest:
            raise ProfileError(
                f"the first step begins at {other.shown(0)}, between the stamps {self.shown(steps)} and "
                f"{self.shown(steps + 1)} of the time series; it must be one of them"
            )
        return steps


@dataclass(frozen=True, eq=False)
class Times:
    """Beginnings of successive stages: hours, or time stamps where there is a calendar.

    Attributes
    ----------
    steps
        Step at which each stage begins.
    step
        Length of a step, h.
    """

    steps: npt.NDArray[np.intp]
    step: float
    calendar: Calendar | None = None

    @property
    def hours(self) -> npt.NDArray[np.float64]:
        """Hours at which the stages begin, counted from step 0."""
        return np.asarray(self.steps * self.step, dtype=float)

    @property
    def clock(self) -> npt.NDArray[np.float64]:
        """Local times of the beginnings of the stages, in hours since midnight of the day of step 0.

        Without a calendar, step 0 begins at midnight. Where clocks are put forward an hour is missing, and
        where they are put back one occurs twice.
        """
        if self.calendar is None:
            return self.hours
        zone = zone_of(self.calendar.zone)
        stamps = self.calendar.stamps(int(self.steps.max(initial=0)) + 1)[np.append(0, self.steps)]
        seconds = stamps.astype("datetime64[s]").astype(np.int64)
        walls = [datetime.fromtimestamp(second, tz=zone).replace(tzinfo=None) for second in seconds.tolist()]
        midnight = datetime.combine(walls[0].date(), time())
        return np.array([(wall - midnight).total_seconds() / 3600.0 for wall in walls[1:]])

    @property
    def shown(self) -> tuple[str, ...]:
        """Beginnings of the stages for messages: ``hour 3``, or local times."""
        if self.calendar is None:
            return tuple(f"hour {hour:g}" for hour in self.hours)
        return tuple(map(self.calendar.shown, self.steps.tolist()))

    def coordinate(self) -> tuple[str, npt.NDArray[Any], dict[str, str]]:
        """Return the coordinate ``time`` of results: hours, or times in UTC with the zone as an attribute."""
        about = {"long_name": "start of the stage"}
        if self.calendar is None:
            return "time", self.hours, {"units": "h", **about}
        stamps = self.calendar.stamps(int(self.steps.max(initial=0)) + 1)[self.steps]
        return "time", stamps, {"zone": self.calendar.zone, **about}


def parse_stamp(text: str, zone: str) -> np.datetime64:
    """Return the time that a text in ISO 8601 names, in UTC; without an offset, it is in the zone.

    Raises
    ------
    ProfileError
        The text is not a time, does not exist in the zone or exists twice.

    Examples
    --------
    >>> parse_stamp("2025-03-29T00:00", "Europe/Berlin"), parse_stamp("2025-03-29T00:00Z", "Europe/Berlin")
    (np.datetime64('2025-03-28T23:00:00.000000'), np.datetime64('2025-03-29T00:00:00.000000'))
    """
    try:
        stated = datetime.fromisoformat(text)
    except ValueError:
        raise ProfileError(
            f"{shown(text)}: must be a time in ISO 8601, such as 2025-03-29T00:00 or 2025-03-29T00:00+01:00"
        ) from None
    if not within_years(stated):
        raise ProfileError(f"{text}: must be {_RANGE}")
    return np.datetime64(stated_time(stated, zone).replace(tzinfo=None))


def within_years(time: datetime) -> bool:
    """Whether nanoseconds can represent a time."""
    return bool(_YEARS[0] <= np.datetime64(time.year - 1970, "Y") < _YEARS[1])


def stated_time(stated: datetime, zone: str) -> datetime:
    """Return a time in UTC.

    Raises
    ------
    ProfileError
        It does not exist in the zone, or exists twice.
    """
    found = instants(stated, zone)
    if not found:
        raise ProfileError(f"{stated}: does not exist in {zone}, where clocks are put forward over it")
    if len(found) > 1:
        offsets = " or ".join(each.astimezone(zone_of(zone)).isoformat() for each in found)
        raise ProfileError(
            f"{stated}: exists twice in {zone}, where clocks are put back over it; write {offsets}"
        )
    return found[0]


def duration(hours: float) -> str:
    """Return the length of a step in words.

    Examples
    --------
    >>> duration(0.25), duration(2.0), duration(1e-4)
    ('15 min', '2 h', '0.36 s')
    """
    for unit, of_an_hour in (("h", 1.0), ("min", 60.0)):
        if hours * of_an_hour >= 1.0:
            return f"{hours * of_an_hour:g} {unit}"
    return f"{hours * 3600.0:g} s"


def instants(stated: datetime, zone: str) -> list[datetime]:
    """Return the times in UTC that a time may mean: one, or none or two for local times at clock changes."""
    if stated.tzinfo is not None:
        return [stated.astimezone(UTC)]
    local = zone_of(zone)
    times = {stated.replace(tzinfo=local, fold=fold).astimezone(UTC) for fold in (0, 1)}
    return sorted(time for time in times if time.astimezone(local).replace(tzinfo=None, fold=0) == stated)


def shown_in(stamp: np.datetime64, zone: str) -> str:
    """Return a time in UTC as local time with the abbreviation of its offset, to the second if need be."""
    seconds = int(stamp.astype("datetime64[s]").astype(np.int64))
    local = datetime.fromtimestamp(seconds, tz=zone_of(zone))
    clock = "%H:%M:%S" if local.second else "%H:%M"
    return local.strftime(f"%Y-%m-%d {clock} %Z")


def zone_of(name: str) -> ZoneInfo:
    """Return a time zone by its IANA name.

    Raises
    ------
    ProfileError
        There is no such zone.
    """
    try:
        return ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError, TypeError, AttributeError):
        raise ProfileError(
            f"zone = {shown(name)}: no such time zone; must be a name such as 'Europe/Berlin' or 'UTC'"
        ) from None


def _nanoseconds(start: object) -> np.datetime64:
    """Return a time in nanoseconds."""
    if isinstance(start, np.datetime64) and not np.isnat(start):
        stamp: np.datetime64 = start
        if _YEARS[0] <= stamp.astype("datetime64[Y]") < _YEARS[1]:
            return np.datetime64(int(stamp.astype("datetime64[ns]").astype(np.int64)), "ns")
    raise ProfileError(f"start = {start!r}: must be a numpy.datetime64 {_RANGE}")
