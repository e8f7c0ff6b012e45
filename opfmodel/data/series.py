"""Container of the time series of component fields."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from opfmodel.data.calendar import Calendar
from opfmodel.data.frames import is_frame, without_index
from opfmodel.errors import ProfileError, shown

__all__ = ["Profiles", "SeriesKey"]

Array = npt.NDArray[np.float64]


class SeriesKey(NamedTuple):
    """Component and field of a time series, written ``component.field``.

    Examples
    --------
    >>> SeriesKey.of("bus.3.load.p"), str(SeriesKey("town", "p"))
    (SeriesKey(component='bus.3.load', field='p'), 'town.p')
    """

    component: str
    field: str

    @classmethod
    def of(cls, key: object) -> SeriesKey:
        """Make a key from a string ``component.field`` or a pair.

        Raises
        ------
        ProfileError
            The component or the field is missing.
        """
        if isinstance(key, tuple) and len(key) == 2:
            return cls(str(key[0]), str(key[1]))
        component, dot, field = str(key).rpartition(".")
        if not (dot and component and field):
            raise ProfileError(f"profile {key!r}: must be 'component.field', for example 'town.p'")
        return cls(component, field)

    def __str__(self) -> str:
        return f"{self.component}.{self.field}"


class Profiles(Mapping[SeriesKey, Array]):
    """Time series of component fields in physical units.

    A mapping from :class:`SeriesKey` to one value per time step. Strings ``component.field`` also serve
    as keys.

    Parameters
    ----------
    series
        Values by component and field (``p`` of a load, ``p_max`` or ``c1`` of a generator, ``rating`` of
        a branch). Series and DataFrames of pandas may have a DatetimeIndex, the beginnings of the steps;
        without a zone it is in that of the calendar, or in UTC. All must have the same step.
    calendar
        Time stamps of the steps. By default the first step is the first one that all indices have, and
        steps are only numbered if there are none.

    Attributes
    ----------
    repeats
        Whether the series were repeated beyond their end; forecasts from a file then repeat as well.

    Raises
    ------
    ProfileError
        A key has no field, or values are not a vector of numbers.

    Examples
    --------
    >>> profiles = Profiles({"town.p": [90, 95, 120], "wind.p_max": [30, 0, 10]})
    >>> profiles.length, profiles["town.p"].tolist()
    (3, [90.0, 95.0, 120.0])
    """

    def __init__(
        self, series: Mapping[Any, npt.ArrayLike] | None = None, calendar: Calendar | None = None
    ) -> None:
        stated = {} if series is None else series
        given, self.calendar = without_index({SeriesKey.of(key): v for key, v in stated.items()}, calendar)
        self.repeats = False
        self._series = {key: _vector(key, values) for key, values in given.items()}

    @classmethod
    def of(cls, series: Mapping[Any, npt.ArrayLike] | None) -> Profiles:
        """Return profiles unchanged, or make them from a mapping.

        Raises
        ------
        ProfileError
            The argument is not a mapping from ``component.field`` to vectors of numbers.
        """
        if isinstance(series, Profiles):
            return series
        if series is not None and not (isinstance(series, Mapping) or is_frame(series)):
            raise ProfileError(
                f"profiles = {shown(series)}: must be a mapping {{'component.field': values}} or a DataFrame"
            )
        return cls(series)

    def __getitem__(self, key: object) -> Array:
        return self._series[SeriesKey.of(key)]

    def __contains__(self, key: object) -> bool:
        return key in self._series or (isinstance(key, str) and SeriesKey.of(key) in self._series)

    def __iter__(self) -> Iterator[SeriesKey]:
        return iter(self._series)

    def __len__(self) -> int:
        return len(self._series)

    def __repr__(self) -> str:
        return f"Profiles({len(self)} series of {self.length} values)" if self else "Profiles()"

    @property
    def series(self) -> Mapping[SeriesKey, Array]:
        """Values by key."""
        return self._series

    @property
    def length(self) -> int | None:
        """Number of time steps covered by all series; None without series."""
        return min((len(values) for values in self.values()), default=None)

    def steps(self, chosen: slice | npt.NDArray[np.integer[Any]]) -> Profiles:
        """Select time steps; shorter series are truncated.

        Time stamps are kept for a slice without a stride, and dropped otherwise.
        """
        return Profiles({key: values[chosen] for key, values in self.items()}, self._calendar_of(chosen))

    def _calendar_of(self, chosen: slice | npt.NDArray[np.integer[Any]]) -> Calendar | None:
        if self.calendar is None or not isinstance(chosen, slice) or chosen.step not in (None, 1):
            return None
        start = chosen.start or 0
        return self.calendar.later(start) if start >= 0 else None

    def repeated(self, steps: int) -> Profiles:
        """Return the series, repeated as a whole until they have at least ``steps`` values.

        Examples
        --------
        >>> Profiles({"town.p": [1, 2]}).repeated(3)["town.p"].tolist()
        [1.0, 2.0, 1.0, 2.0]
        """
        times = -(-steps // (self.length or steps))
        made = Profiles({key: np.tile(values, times) for key, values in self.items()}, self.calendar)
        made.repeats = True
        return made

    def or_else(self, others: Profiles) -> Profiles:
        """Return these series, and those of ``others`` that these lack.

        If both have time stamps, the first step is that of these series, and ``others`` lose the steps
        before it. Series without time stamps begin at the first step.

        Raises
        ------
        ProfileError
            Both have time stamps, which differ in the step, are out of phase or do not overlap, or
            ``others`` begin later.
        """
        calendar = self.calendar or others.calendar
        if not others:
            return self if calendar is self.calendar else Profiles(self, calendar)
        kept = others.steps(slice(self._lead(others), None))
        return Profiles({**kept, **self}, calendar)

    def _lead(self, others: Profiles) -> int:
        """Number of steps by which the time stamps of ``others`` begin earlier."""
        if self.calendar is None or others.calendar is None:
            return 0
        lead = others.calendar.steps_until(self.calendar)
        if others.length is not None and lead >= others.length:
            ends = others.calendar.shown(others.length)
            raise ProfileError(
                f"time series end at {ends}, before the first step at {self.calendar.shown(0)}; "
                "they must overlap with it"
            )
        return lead


def _vector(key: SeriesKey, values: Any) -> Array:
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise ProfileError(f"profile '{key}': the values must be numbers", key) from None
    if array.ndim != 1:
        raise ProfileError(f"profile '{key}': has shape {array.shape}; must be one value per time step", key)
    if np.isnan(array).any():
        step = int(np.argmax(np.isnan(array)))
        raise ProfileError(f"profile '{key}': step {step}: nan: must be a number", key, step)
    array = array.copy() if array is values or array.base is not None else array
    array.flags.writeable = False  # it has been checked
    return array
