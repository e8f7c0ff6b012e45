"""The average of past values."""

from __future__ import annotations

import numpy as np

from opfmodel.data.series import Profiles
from opfmodel.errors import ProfileError
from opfmodel.forecasts import Forecast
from opfmodel.forecasts.base import FORECAST_FIELDS, part

__all__ = ["Average"]


class Average(Forecast):
    r"""The mean of the last observed values, for all steps ahead.

    .. math::
        \hat d(t + h) = \frac{1}{n} \sum_{i=1}^{n} d(t - i), \qquad n = \min(\mathrm{window}, t)

    Before the first observation, it is the first value.

    Parameters
    ----------
    window
        Maximum number of values.
    """

    def __init__(self, window: int = 24) -> None:
        if window < 1:
            raise ProfileError(f"average: window = {window}: must be a number of steps, at least 1")
        self.window = window

    def expected(self, actual: Profiles, time: int, stages: int) -> Profiles:
        """The mean, repeated for every stage."""
        expected = part(actual, time, stages)
        for key, values in actual.items():
            if key.field in FORECAST_FIELDS:
                seen = values[max(time - self.window, 0) : time] if time else values[:1]
                expected[key] = np.full(stages, seen.mean())
        return Profiles(expected)
