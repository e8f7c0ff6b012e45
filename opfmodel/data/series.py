"""Time series of component fields: the container that everything else reads."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from opfmodel.errors import ProfileError

__all__ = ["Profiles", "SeriesKey"]

Array = npt.NDArray[np.float64]


class SeriesKey(NamedTuple):
    """What a series is of: a component and a field of its table, written ``component.field``.

    Examples
    --------
    >>> SeriesKey.of("bus.3.load.p"), str(SeriesKey("town", "p"))
    (SeriesKey(component='bus.3.load', field='p'), 'town.p')
    """

    component: str
    field: str

    @classmethod
    def of(cls, key: object) -> SeriesKey:
        """The key of a text ``component.field`` or of a pair.

        Raises
        ------
        ProfileError
            The text has no component or no field.
        """
        if isinstance(key, tuple) and len(key) == 2:
            return cls(str(key[0]), str(key[1]))
        component, dot, field = str(key).rpartition(".")
        if not (dot and component and field):
            raise ProfileError(f"profile {key!r}: write 'component.field', for instance 'town.p'")
        return cls(component, field)

    def __str__(self) -> str:
        return f"{self.component}.{self.field}"


class Profiles(Mapping[SeriesKey, Array]):
    """Values of some fields of some components over time, in physical units.

    A mapping from :class:`SeriesKey` to one value per time step; texts ``component.field`` are keys, too.

    Parameters
    ----------
    series
        By component name and field of its table (``p`` of a load, ``p_max`` or ``c1`` of a generator,
        ``rating`` of a branch).

    Raises
    ------
    ProfileError
        A key without a field, or values that are not a vector of numbers.

    Examples
    --------
    >>> profiles = Profiles({"town.p": [90, 95, 120], "wind.p_max": [30, 0, 10]})
    >>> profiles.length, profiles["town.p"].tolist()
    (3, [90.0, 95.0, 120.0])
    """

    def __init__(self, series: Mapping[Any, npt.ArrayLike] | None = None) -> None:
        self._series = {
            named: _vector(named, values)
            for named, values in ((SeriesKey.of(key), values) for key, values in (series or {}).items())
        }

    @classmethod
    def of(cls, series: Mapping[Any, npt.ArrayLike] | None) -> Profiles:
        """Profiles as they are, or made of a mapping.

        Raises
        ------
        ProfileError
            It is no mapping, or not one of vectors of numbers by ``component.field``.
        """
        if isinstance(series, Profiles):
            return series
        if series is not None and not isinstance(series, Mapping):
            raise ProfileError(f"profiles = {series!r}: must be a mapping {{'component.field': values}}")
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
        """The series by key."""
        return self._series

    @property
    def length(self) -> int | None:
        """Number of time steps that every series covers; None if there are no series."""
        return min((len(values) for values in self.values()), default=None)

    def steps(self, chosen: slice | npt.NDArray[np.integer[Any]]) -> Profiles:
        """The values of some steps; series that end before are cut."""
        return Profiles({key: values[chosen] for key, values in self.items()})


def _vector(key: SeriesKey, values: Any) -> Array:
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise ProfileError(f"profile '{key}': the values must be numbers", key) from None
    if array.ndim != 1:
        raise ProfileError(
            f"profile '{key}': one value per time step is expected, not shape {array.shape}", key
        )
    if np.isnan(array).any():
        step = int(np.argmax(np.isnan(array)))
        raise ProfileError(f"profile '{key}': step {step} is not a number", key, step)
    array = array.copy() if array is values or array.base is not None else array
    array.flags.writeable = False  # nobody changes what has been checked
    return array
