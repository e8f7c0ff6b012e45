"""The contract of a forecast."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from opfmodel.data.series import Profiles, SeriesKey
from opfmodel.errors import ProfileError
from opfmodel.forecasts.base import Forecast
from opfmodel.testing.grids import demand
from opfmodel.testing.options import check_options
from solvers.testing import Contract

__all__ = ["check_forecast"]

Series = Mapping[SeriesKey, npt.NDArray[np.float64]]


def check_forecast(forecast: Forecast, actual: Profiles | None = None) -> None:
    """Raise :class:`ContractError` unless a forecast satisfies its contract.

    - Its options are documented plain data.
    - It covers every actual series and no other, with one finite value per stage.
    - Its values depend neither on the order of calls nor on the number of stages.
    - Paths, if it can draw them, are those of forecast series, ``(number, steps)``, and depend on what was
      issued and on the seed alone.

    Parameters
    ----------
    actual
        The actual series; by default the demand of a feeder.
    """
    rules = Contract(f"forecast {type(forecast).__name__}")
    rules.require(isinstance(forecast, Forecast), "is a Forecast")
    check_options(rules, type(forecast))
    actual = Profiles.of(demand(6)) if actual is None else actual
    asked = [(time, stages) for time in (0, 2, 1) for stages in (3, 1, 2)]
    first, second = (
        {which: _expected(rules, forecast, actual, *which) for which in order}
        for order in (asked, asked[::-1])
    )
    same = all(_equal(first[which], second[which]) for which in asked)
    rules.require(same, "returns the same values when called again in another order")
    for time, stages in asked:
        longer = {key: values[:stages] for key, values in first[time, 3].items()}
        rules.require(_equal(first[time, stages], longer), "returns the same values for any number of stages")
    _check_paths(rules, forecast, actual)


def _check_paths(rules: Contract, forecast: Forecast, actual: Profiles) -> None:
    issued = Profiles(_expected(rules, forecast, actual, 1, 3))
    try:
        first, again = (forecast.paths(issued, 1, 2, 0, actual.calendar) for _ in range(2))
    except ProfileError:
        return  # it has no error model
    rules.require(first.keys() <= issued.keys(), "draws paths of forecast series alone")
    rules.require(_equal(first, again), "draws the same paths when called again")
    for key, values in first.items():
        where = f"{key} has shape {np.shape(values)} for 2 paths of 3 steps"
        rules.require(np.shape(values) == (2, 3), "draws one value per path and step", where)
        rules.require(np.isfinite(values).all(), "draws finite values", str(key))


def _expected(rules: Contract, forecast: Forecast, actual: Profiles, time: int, stages: int) -> Series:
    """Return a forecast after checking its series and shapes."""
    with rules.rule("forecasts every step"):
        series = forecast.expected(actual, time, stages)
    rules.require(series.keys() == actual.keys(), "covers every actual series and no other")
    for key, values in series.items():
        where = f"{key} has shape {np.shape(values)} for {stages} stages"
        rules.require(np.shape(values) == (stages,), "returns one value per stage", where)
        rules.require(np.isfinite(values).all(), "returns finite values", str(key))
    return {key: np.array(values) for key, values in series.items()}


def _equal(one: Series, other: Series) -> bool:
    return all(np.array_equal(values, other[key]) for key, values in one.items())
