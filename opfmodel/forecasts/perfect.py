"""Knowing what happens."""

from __future__ import annotations

from opfmodel.data.series import Profiles
from opfmodel.forecasts.base import Forecast, part

__all__ = ["Perfect"]


class Perfect(Forecast):
    """Exactly what happens."""

    perfect = True

    def expected(self, actual: Profiles, time: int, stages: int) -> Profiles:
        """What happens."""
        return Profiles(part(actual, time, stages))
