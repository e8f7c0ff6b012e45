"""Forecasts of the time series for a controller, one file each."""

from opfmodel.forecasts.base import Forecast
from opfmodel.forecasts.file import File
from opfmodel.forecasts.noisy import Noisy
from opfmodel.forecasts.perfect import Perfect
from opfmodel.forecasts.persistence import Persistence

__all__ = ["File", "Forecast", "Noisy", "Perfect", "Persistence"]
