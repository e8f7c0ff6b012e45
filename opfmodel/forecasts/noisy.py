"""What happens, with an error that grows with the time ahead."""

from __future__ import annotations

import zlib

import numpy as np

from opfmodel.data.series import Profiles
from opfmodel.errors import ProfileError
from opfmodel.forecasts.base import FORECAST_FIELDS, Array, Forecast, part

__all__ = ["Noisy"]


class Noisy(Forecast):
    r"""What happens, times one plus a first-order autoregressive error.

    .. math::
        \hat d(t + h) = \max(0, 1 + \epsilon_h)\, d(t + h), \qquad
        \epsilon_h = \phi\, \epsilon_{h-1} + \sigma \eta_h, \quad \epsilon_{-1} = 0

    with independent standard normal :math:`\eta_h`. The relative error of the step about to begin
    has the deviation :math:`\sigma`; it grows with the time ahead to
    :math:`\sigma / \sqrt{1 - \phi^2}`. Each component draws its own error for all its fields, so that a
    power factor is kept. What is drawn depends on the seed, the component and the step alone.

    Parameters
    ----------
    deviation
        :math:`\sigma`, as a share of the value.
    seed
        Of the random numbers.
    correlation
        :math:`\phi`, from 0 to below 1.
    fields
        Fields that are forecast, of loads and generators; others are known.
    """

    def __init__(
        self,
        deviation: float,
        seed: int,
        correlation: float = 0.9,
        fields: tuple[str, ...] = FORECAST_FIELDS,
    ) -> None:
        if not 0 <= deviation < np.inf:
            raise ProfileError(f"noisy: deviation = {deviation}: must be a share, at least 0")
        if not 0 <= correlation < 1:
            raise ProfileError(f"noisy: correlation = {correlation}: must be at least 0 and below 1")
        if seed < 0:
            raise ProfileError(f"noisy: seed = {seed}: must be a whole number, at least 0")
        self.deviation = deviation
        self.seed = seed
        self.correlation = correlation
        self.fields = fields

    def expected(self, actual: Profiles, time: int, stages: int) -> Profiles:
        """What happens, with errors."""
        expected = part(actual, time, stages)
        for key, values in expected.items():
            if key.field in self.fields:
                factor = np.maximum(0.0, 1.0 + self.error(key.component, time, stages))
                expected[key] = values * factor[: values.size]
        return Profiles(expected)

    def error(self, component: str, time: int, stages: int) -> Array:
        """Relative errors, at step ``time``, of what is expected of a component for the steps from it on."""
        entropy = [self.seed, time, zlib.crc32(component.encode())]
        drawn = np.random.default_rng(entropy).standard_normal(stages)
        error, errors = 0.0, np.empty(stages)
        for ahead, shock in enumerate(drawn):
            error = self.correlation * error + self.deviation * shock
            errors[ahead] = error
        return errors
