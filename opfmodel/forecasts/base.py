"""Base class of forecasts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from opfmodel import plugins
from opfmodel.data.calendar import Calendar
from opfmodel.data.series import Profiles, SeriesKey
from opfmodel.errors import PluginError, ProfileError, nearest, shown
from opfmodel.network.components import BUILT_IN

Array = npt.NDArray[np.float64]

__all__ = ["FORECAST_FIELDS", "Array", "Forecast", "forecast_fields", "part"]

# Fields that are uncertain ahead of time; others, such as prices and ratings, are known.
FORECAST_FIELDS = ("p", "q", "p_max", "available")


class Forecast:
    """Base class of forecasts, made at one step for that step and later ones.

    Register subclasses as entry points in the group ``opfmodel.forecasts``. The keyword arguments of
    the constructor are the options in a scenario file; options annotated as paths are relative to
    that file. A forecast is a pure function of the actual series and the step; repeated calls, in any
    order, give the same result.

    Attributes
    ----------
    perfect
        Whether the forecast equals the actual series.
    """

    perfect: ClassVar[bool] = False

    def expected(self, actual: Profiles, time: int, stages: int) -> Profiles:
        """Forecast, at step ``time``, ``stages`` values of every series from that step on.

        Parameters
        ----------
        actual
            The actual series, from step 0.
        """
        raise NotImplementedError

    def paths(
        self,
        issued: Profiles,  # noqa: ARG002
        time: int,  # noqa: ARG002
        number: int,  # noqa: ARG002
        seed: int,  # noqa: ARG002
        calendar: Calendar | None = None,  # noqa: ARG002
    ) -> Mapping[SeriesKey, Array]:
        """Draw paths of the actual series around a forecast, for a forecast with an error model.

        A path depends on what was issued and on its arguments, never on what really happens.

        Parameters
        ----------
        issued
            The forecast issued at step ``time``, from that step on.
        number
            Number of paths.
        seed
            Seed of the random numbers.
        calendar
            Time stamps of the steps, from step 0.

        Returns
        -------
        Mapping
            Paths ``(number, steps)`` of the uncertain series; those that are known are left out.

        Raises
        ------
        ProfileError
            The forecast has no error model.
        """
        raise ProfileError(
            f"{type(self).__name__}: cannot draw paths; noisy can, and file if it has a column 'member'"
        )


def forecast_fields(forecast: str, fields: Sequence[str]) -> tuple[str, ...]:
    """Check and return the fields that a forecast is to forecast.

    Parameters
    ----------
    forecast
        Name of the forecast, for messages.

    Raises
    ------
    ProfileError
        No kind of component has a time series of such a field.
    """
    known = {name for kind in BUILT_IN for name, field in kind.table_fields().items() if field.series}
    if not known.issuperset(fields):  # then it may be a field of a device of another package
        known |= _fields_of_plugins()
    for field in fields:
        if field not in known:
            raise ProfileError(
                f"{forecast}: fields: {shown(field)}: no component has a time series of this name; "
                f"{nearest(field, known)}"
            )
    return tuple(fields)


def _fields_of_plugins() -> set[str]:
    """Return the fields of the components of installed devices that can have a time series."""
    known: set[str] = set()
    for plugin in plugins.plugins("device").values():
        try:
            component = plugin.load().component
        except PluginError:
            continue  # "opfmodel list" reports it
        known |= {name for name, field in component.table_fields().items() if field.series}
    return known


def part(actual: Profiles, time: int, stages: int) -> dict[SeriesKey, Array]:
    """Return the actual series from step ``time`` on; those that end earlier are shorter."""
    return {key: values[time : time + stages] for key, values in actual.items()}
