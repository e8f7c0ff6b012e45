"""Perfect forecasts."""

from __future__ import annotations

from opfmodel.data.series import Profiles
from opfmodel.forecasts.base import Forecast, part

__all__ = ["Perfect"]


class Perfect(Forecast):
    """Perfect foresight of the actual series."""

    perfect = True

    def expected(self, actual: Profiles, time: int, stages: int) -> Profiles:
        """Return the actual series."""
        return Profiles(part(actual, time, stages))
