"""Time stamps of the steps of time series."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Calendar"]


@dataclass(frozen=True)
class Calendar:
    """Time stamps of equal steps.

    Attributes
    ----------
    start
        Beginning of the first step, in UTC.
    step
        Length of a step, h.
    zone
        Name of the time zone in which stamps are shown, such as ``Europe/Berlin``.
    """

    start: np.datetime64
    step: float
    zone: str = "UTC"
