"""The contract of a forecast."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from opfmodel.data.series import Profiles, SeriesKey
from opfmodel.forecasts.base import Forecast
from opfmodel.testing.grids import demand
from opfmodel.testing.options import check_options
from solvers.testing import Contract

__all__ = ["check_forecast"]

Series = Mapping[SeriesKey, npt.NDArray[np.float64]]


def check_forecast(forecast: Forecast, actual: Profiles | None = None) -> None:
    """Raise :class:`ContractError` unless a forecast keeps its contract.

    Its options are documented and plain data; it expects every series that there is and no other,
    by as many finite numbers as are asked for; it expects the same whenever, in whatever order and for
    however many stages it is asked; and it leaves what happens as it is.

    Parameters
    ----------
    actual
        What happens; by default the demand of a feeder.
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
    rules.require(same, "expects the same when it is asked again, in another order")
    for time, stages in asked:
        longer = {key: values[:stages] for key, values in first[time, 3].items()}
        rules.require(_equal(first[time, stages], longer), "expects the same for however many stages")


def _expected(rules: Contract, forecast: Forecast, actual: Profiles, time: int, stages: int) -> Series:
    """What is expected, of the right series and shapes."""
    with rules.rule("forecasts every step"):
        series = forecast.expected(actual, time, stages)
    rules.require(series.keys() == actual.keys(), "expects every series that there is and no other")
    for key, values in series.items():
        where = f"{key}, asked for {stages}, has shape {np.shape(values)}"
        rules.require(np.shape(values) == (stages,), "expects one value per stage", where)
        rules.require(np.isfinite(values).all(), "expects finite numbers", str(key))
    return {key: np.array(values) for key, values in series.items()}


def _equal(one: Series, other: Series) -> bool:
    return all(np.array_equal(values, other[key]) for key, values in one.items())
