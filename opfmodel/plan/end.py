"""What is asked of stored energy at the end of the horizon."""

from __future__ import annotations

from dataclasses import dataclass

from opfmodel.errors import ModelError
from opfmodel.network.bounds import bounded

__all__ = ["End"]


@dataclass(frozen=True)
class End:
    """What is asked of stored energy at the end of the horizon.

    Parameters
    ----------
    cyclic
        As much as at its start: e(N) = e(0).
    minimum
        At least this share of the capacity, from 0 to 1.
    price
        Value of what is left, $/MWh.
    """

    cyclic: bool = False
    minimum: float = 0.0
    price: float = 0.0

    def __post_init__(self) -> None:
        if not isinstance(self.minimum, int | float) or not 0.0 <= self.minimum <= 1.0:
            raise ModelError(f"end of horizon: minimum = {self.minimum!r}: must be a share between 0 and 1")
        if not isinstance(self.price, int | float) or not bounded(self.price):
            raise ModelError(f"end of horizon: price = {self.price!r}: must be a finite number in $/MWh")
