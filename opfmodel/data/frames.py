"""Time series of pandas, whose index holds the time stamps.

Pandas is not imported: only who uses it can have such an object.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from opfmodel.data.calendar import Calendar, zone_of
from opfmodel.data.stamps import calendar_of, in_utc
from opfmodel.errors import ProfileError

__all__ = ["is_frame", "without_index"]


def is_frame(series: object) -> bool:
    """Whether an object is a DataFrame of pandas."""
    pandas: Any = sys.modules.get("pandas")
    return pandas is not None and isinstance(series, pandas.DataFrame)


def without_index(
    series: Mapping[Any, Any], calendar: Calendar | None
) -> tuple[dict[Any, Any], Calendar | None]:
    """Return series as arrays from a common first step on, and the calendar of their index, if any.

    Parameters
    ----------
    series
        Values by name: Series with a DatetimeIndex, which have time stamps, or anything else.
    calendar
        Calendar of the result. By default it begins with the latest of the series.

    Raises
    ------
    ProfileError
        Time stamps are missing, out of order, duplicate or not equally spaced; series have different
        steps, do not overlap or begin later than the calendar; or an index is neither of times nor of
        integers.
    """
    pandas: Any = sys.modules.get("pandas")
    if pandas is None:
        return dict(series), calendar
    made, calendars = {}, {}
    known: list[tuple[Any, Calendar]] = []  # the columns of a frame share an index
    for name, values in series.items():
        made[name] = values
        if isinstance(values, pandas.Series):
            made[name] = values.to_numpy()
            index = values.index
            if isinstance(index, pandas.DatetimeIndex):
                found = next((own for other, own in known if other is index), None)
                calendars[name] = found or _calendar(name, index, calendar)
                if found is None:
                    known.append((index, calendars[name]))
                _check_missing(name, values.isna().to_numpy(), calendars[name])
            elif not pandas.api.types.is_integer_dtype(index.dtype):
                raise ProfileError(
                    f"profile '{name}': the index is a {type(index).__name__} of {index.dtype}; must be a "
                    "DatetimeIndex, or integers for numbered steps"
                )
    if not calendars:
        return made, calendar
    if calendar is None:
        calendar = max(calendars.values(), key=lambda each: each.start)
    for name, own in calendars.items():
        try:
            lead = own.steps_until(calendar)
        except ProfileError as error:
            raise ProfileError(f"profile '{name}': {error}") from None
        if lead >= len(made[name]):
            raise ProfileError(
                f"profile '{name}': ends at {own.shown(len(made[name]))}, before the first step at "
                f"{calendar.shown(0)}"
            )
        made[name] = made[name][lead:]
    return made, calendar


def _calendar(name: object, index: Any, calendar: Calendar | None) -> Calendar:
    """Return the calendar of an index; without a zone it is in that of the calendar, else in UTC."""
    zone = "UTC" if calendar is None else calendar.zone
    place = partial(_place, name)
    if index.tz is None:
        stamps = in_utc(index.to_numpy(), zone, place)
    else:
        stamps = in_utc(index.tz_convert("UTC").tz_localize(None).to_numpy(), "UTC", place)
        zone = _named(index.tz) if calendar is None else zone
    return calendar_of(stamps, zone, place, None if calendar is None else calendar.step)


def _place(name: object, row: int) -> str:
    return f"profile '{name}': row {row}: "


def _named(zone: Any) -> str:
    """Return the name of a time zone, UTC if it is a mere offset."""
    name = str(getattr(zone, "key", None) or getattr(zone, "zone", None) or "UTC")
    try:
        zone_of(name)
    except ProfileError:
        return "UTC"
    return name


def _check_missing(name: object, missing: Any, calendar: Calendar) -> None:
    """Raise an error that names the time of a missing value."""
    if missing.any():
        row = int(np.argmax(missing))
        raise ProfileError(
            f"profile '{name}': row {row}: {calendar.shown(row)}: the value is missing; must be a number"
        )
