"""Base class of forecasts."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import numpy.typing as npt

from opfmodel.data.series import Profiles, SeriesKey

Array = npt.NDArray[np.float64]

__all__ = ["FORECAST_FIELDS", "Array", "Forecast", "part"]

# Fields that are uncertain ahead of time; others, such as prices and ratings, are known.
FORECAST_FIELDS = ("p", "q", "p_max")


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


def part(actual: Profiles, time: int, stages: int) -> dict[SeriesKey, Array]:
    """Return the actual series from step ``time`` on; those that end earlier are shorter."""
    return {key: values[time : time + stages] for key, values in actual.items()}
