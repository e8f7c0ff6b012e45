"""Forecasts with random errors that grow with the lead time."""

from __future__ import annotations

import zlib

import numpy as np

from opfmodel.data.series import Profiles
from opfmodel.errors import ProfileError
from opfmodel.forecasts.base import FORECAST_FIELDS, Array, Forecast, forecast_fields, part
from opfmodel.network.bounds import integer, number_within

__all__ = ["Noisy"]


class Noisy(Forecast):
    r"""Actual series times one plus a first-order autoregressive error.

    .. math::
        \hat d(t + h) = \max(0, 1 + \epsilon_h)\, d(t + h), \qquad
        \epsilon_h = \phi\, \epsilon_{h-1} + \sigma \eta_h, \quad \epsilon_{-1} = 0

    with independent standard normal :math:`\eta_h`. The standard deviation of the relative error is
    :math:`\sigma` for the step about to begin, and grows with the lead time to
    :math:`\sigma / \sqrt{1 - \phi^2}`. The fields of a component share one error, which preserves
    power factors. The draws depend only on the seed, the component and the step.

    Parameters
    ----------
    deviation
        :math:`\sigma`, relative to the value.
    seed
        Seed of the random numbers.
    correlation
        :math:`\phi`, at least 0 and below 1.
    fields
        Fields of loads and generators that are forecast; others are known.
    """

    def __init__(
        self,
        deviation: float,
        seed: int,
        correlation: float = 0.9,
        fields: tuple[str, ...] = FORECAST_FIELDS,
    ) -> None:
        self.deviation = number_within("noisy: deviation", deviation, at_least=0, error=ProfileError)
        self.correlation = number_within(
            "noisy: correlation", correlation, at_least=0, below=1, error=ProfileError
        )
        self.seed = integer("noisy: seed", seed, at_least=0, error=ProfileError)
        self.fields = forecast_fields("noisy", fields)

    def expected(self, actual: Profiles, time: int, stages: int) -> Profiles:
        """Return the actual series with errors."""
        expected = part(actual, time, stages)
        for key, values in expected.items():
            if key.field in self.fields:
                factor = np.maximum(0.0, 1.0 + self.error(key.component, time, stages))
                expected[key] = values * factor[: values.size]
        return Profiles(expected)

    def error(self, component: str, time: int, stages: int) -> Array:
        """Return the relative errors of a forecast for a component, made at step ``time``."""
        entropy = [self.seed, time, zlib.crc32(component.encode())]
        drawn = np.random.default_rng(entropy).standard_normal(stages)
        error, errors = 0.0, np.empty(stages)
        for ahead, shock in enumerate(drawn):
            error = self.correlation * error + self.deviation * shock
            errors[ahead] = error
        return errors
