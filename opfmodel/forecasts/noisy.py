"""Forecasts with random errors that grow with the lead time."""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping

import numpy as np

from opfmodel.data.calendar import Calendar
from opfmodel.data.series import Profiles, SeriesKey
from opfmodel.errors import ProfileError
from opfmodel.forecasts.base import FORECAST_FIELDS, Array, Forecast, forecast_fields, part
from opfmodel.network.bounds import integer, number_within

__all__ = ["Noisy"]

_PATHS = 1  # paths have other random numbers than the forecast that is issued, if the seeds are equal


class Noisy(Forecast):
    r"""Actual series times one plus a first-order autoregressive error.

    .. math::
        \hat d(t + h) = \max(0, 1 + \epsilon_h)\, d(t + h), \qquad
        \epsilon_h = \phi\, \epsilon_{h-1} + \sigma \eta_h, \quad \epsilon_{-1} = 0

    with independent standard normal :math:`\eta_h`. The standard deviation of the relative error is
    :math:`\sigma` for the step about to begin, and grows with the lead time to
    :math:`\sigma / \sqrt{1 - \phi^2}`. The fields of a component share one error, which preserves
    power factors. The draws depend only on the seed, the component and the step. A share of the variance is
    common to all components; independent errors of many components would cancel in their sum.

    Paths of the actual series are drawn around a forecast with the same errors.

    Parameters
    ----------
    deviation
        :math:`\sigma`, relative to the value.
    seed
        Seed of the random numbers.
    correlation
        :math:`\phi`, at least 0 and below 1.
    fields
        Fields of components that are forecast; others are known.
    common_share
        Share of the variance of the errors that is common to all components, from 0 to 1.
    """

    def __init__(
        self,
        deviation: float,
        seed: int,
        correlation: float = 0.9,
        fields: tuple[str, ...] = FORECAST_FIELDS,
        common_share: float = 0,
    ) -> None:
        self.deviation = number_within("noisy: deviation", deviation, at_least=0, error=ProfileError)
        self.correlation = number_within(
            "noisy: correlation", correlation, at_least=0, below=1, error=ProfileError
        )
        self.seed = integer("noisy: seed", seed, at_least=0, error=ProfileError)
        self.fields = forecast_fields("noisy", fields)
        self.common_share = number_within(
            "noisy: common_share", common_share, at_least=0, at_most=1, error=ProfileError
        )

    def expected(self, actual: Profiles, time: int, stages: int) -> Profiles:
        """Return the actual series with errors."""
        known = part(actual, time, stages)
        drawn = self._with_errors(known, [self.seed, time], 1)
        return Profiles({**known, **{key: values[0] for key, values in drawn.items()}})

    def paths(
        self,
        issued: Profiles,
        time: int,
        number: int,
        seed: int,
        calendar: Calendar | None = None,  # noqa: ARG002
    ) -> dict[SeriesKey, Array]:
        """Return the issued series with errors, one draw for each path."""
        return self._with_errors(issued, [seed, time, _PATHS], number)

    def _with_errors(
        self, series: Mapping[SeriesKey, Array], entropy: list[int], number: int
    ) -> dict[SeriesKey, Array]:
        """Multiply the uncertain series by one plus a number of errors drawn for their components."""
        uncertain = {key: values for key, values in series.items() if key.field in self.fields}
        shape = (number, max(map(len, uncertain.values()), default=0))
        common = self._error(entropy, shape, self.common_share)
        factors = {}
        for name in dict.fromkeys(key.component for key in uncertain):
            own = self._error([*entropy, zlib.crc32(name.encode())], shape, 1.0 - self.common_share)
            factors[name] = np.maximum(0.0, 1.0 + own + common)
        return {key: values * factors[key.component][:, : values.size] for key, values in uncertain.items()}

    def _error(self, entropy: list[int], shape: tuple[int, int], share: float) -> Array:
        """Return relative errors with a share of the variance, over the second axis."""
        if not share:
            return np.zeros(shape)
        error = math.sqrt(share) * self.deviation * np.random.default_rng(entropy).standard_normal(shape)
        lag = 1
        # error[k] += correlation * error[k - 1], by doubling; scipy.signal.lfilter takes a second to import
        while lag < shape[1]:
            error[:, lag:] = error[:, lag:] + self.correlation**lag * error[:, :-lag]
            lag *= 2
        return error
