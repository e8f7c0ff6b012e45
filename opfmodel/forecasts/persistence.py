"""Persistence forecasts."""

from __future__ import annotations

import numpy as np

from opfmodel.data.series import Profiles
from opfmodel.errors import ProfileError
from opfmodel.forecasts.base import FORECAST_FIELDS, Forecast, forecast_fields, part

__all__ = ["Persistence"]


class Persistence(Forecast):
    r"""The last observed value, or the value one period earlier.

    .. math::
        \hat d(t + h) = d(t - P + (h \bmod P)), \qquad h = 0, 1, \dots

    with the period P. The step about to begin has not been observed yet. Until the first period is
    over, its actual values stand in for missing observations.

    Parameters
    ----------
    period
        Period in steps: 1 for the last value, 24 for the previous day in hourly steps.
    fields
        Fields of components that are forecast; others are known.
    """

    def __init__(self, period: int = 1, fields: tuple[str, ...] = FORECAST_FIELDS) -> None:
        if period < 1:
            raise ProfileError(f"persistence: period = {period}: must be a number of steps, at least 1")
        self.period = period
        self.fields = forecast_fields("persistence", fields)

    def expected(self, actual: Profiles, time: int, stages: int) -> Profiles:
        """Return the values of the previous period."""
        seen = time - self.period + np.arange(stages) % self.period
        seen = np.where(seen < 0, seen + self.period, seen)
        held = {key: values[seen] for key, values in actual.items() if key.field in self.fields}
        return Profiles({**part(actual, time, stages), **held})
