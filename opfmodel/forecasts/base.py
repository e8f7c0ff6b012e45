"""What a forecast is."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import numpy.typing as npt

from opfmodel.data.series import Profiles, SeriesKey

Array = npt.NDArray[np.float64]

__all__ = ["FORECAST_FIELDS", "Array", "Forecast", "part"]

# What is uncertain ahead of time; prices, ratings and the like are known.
FORECAST_FIELDS = ("p", "q", "p_max")


class Forecast:
    """What is expected, at a step, of the steps from there on; one class in one file.

    Registered by an entry point in the group ``opfmodel.forecasts``; the keyword arguments of the
    constructor are the options in a scenario file, and one that is annotated as a path is relative
    to that file. A forecast is a pure function of what happens and of the step, so that solving again
    or in another order sees the same.

    Attributes
    ----------
    perfect
        Whether it is what happens.
    """

    perfect: ClassVar[bool] = False

    def expected(self, actual: Profiles, time: int, stages: int) -> Profiles:
        """Series of ``stages`` values that are expected at step ``time`` for the steps from it on.

        Parameters
        ----------
        actual
            What happens, from step 0.
        """
        raise NotImplementedError


def part(actual: Profiles, time: int, stages: int) -> dict[SeriesKey, Array]:
    """What happens in the steps from ``time`` on; series that end before are cut."""
    return {key: values[time : time + stages] for key, values in actual.items()}
