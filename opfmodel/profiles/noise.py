"""Random variation of demand."""

from __future__ import annotations

import numpy as np

from opfmodel.errors import ProfileError
from opfmodel.network.bounds import integer, number_within
from opfmodel.profiles.base import ProfileRule, Workbook

__all__ = ["Noise"]


class Noise(ProfileRule):
    r"""Multiply the demand of each load by 1 plus a first-order autoregressive Gaussian process.

    .. math::
        n(t) = \phi\, n(t-1) + \sqrt{1 - \phi^2}\, \sigma\, w(t), \quad w(t) \sim N(0, 1)

    The process has the standard deviation :math:`\sigma` from the first step on. Large deviations can
    make demand negative, when renewable feed-in exceeds it. Power factors do not change. Random numbers
    come from NumPy's PCG64 generator and are the same on every machine.

    Parameters
    ----------
    deviation
        Standard deviation :math:`\sigma`.
    correlation
        Correlation :math:`\phi` from one step to the next, at least 0 and below 1.
    seed
        Seed of the random numbers.
    loads
        Names of loads; all by default.
    """

    def __init__(
        self, deviation: float, correlation: float, seed: int, loads: list[str] | None = None
    ) -> None:
        self.deviation = number_within("noise: deviation", deviation, at_least=0, error=ProfileError)
        self.correlation = number_within(
            "noise: correlation", correlation, at_least=0, below=1, error=ProfileError
        )
        self.seed = integer("noise: seed", seed, at_least=0, error=ProfileError)
        self.loads = loads

    def apply(self, book: Workbook) -> None:
        """Multiply the demand."""
        names = book.loads(self.loads)
        # drawn step by step: a longer horizon does not change earlier steps
        draws = np.random.Generator(np.random.PCG64(self.seed)).standard_normal((book.steps, len(names)))
        noise = self.deviation * draws.T
        for t in range(1, book.steps):
            fresh = np.sqrt(1.0 - self.correlation**2) * noise[:, t]
            noise[:, t] = self.correlation * noise[:, t - 1] + fresh
        for name, factor in zip(names, 1.0 + noise, strict=True):
            for key in ("p", "q"):
                book.set(name, key, book.get(name, key) * factor)
