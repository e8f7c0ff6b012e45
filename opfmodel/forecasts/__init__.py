"""Forecasts of the time series for a controller, one file each."""

from opfmodel.forecasts.base import Forecast
from opfmodel.forecasts.file import File
from opfmodel.forecasts.noisy import Noisy
from opfmodel.forecasts.perfect import Perfect
from opfmodel.forecasts.persistence import Persistence
from opfmodel.forecasts.scenarios import Case, Draw, Futures, Scenarios

__all__ = [
    "Case",
    "Draw",
    "File",
    "Forecast",
    "Futures",
    "Noisy",
    "Perfect",
    "Persistence",
    "Scenarios",
]
