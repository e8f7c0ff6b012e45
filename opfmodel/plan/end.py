"""Terminal conditions on stored energy."""

from __future__ import annotations

from dataclasses import dataclass

from opfmodel.errors import ModelError
from opfmodel.network.bounds import bounded

__all__ = ["End"]


@dataclass(frozen=True)
class End:
    """Terminal conditions on stored energy.

    Parameters
    ----------
    cyclic
        Whether the final energy equals the initial: e(N) = e(0).
    minimum
        Minimum final energy as a share of the capacity, from 0 to 1.
    price
        Value of the final energy, $/MWh.
    """

    cyclic: bool = False
    minimum: float = 0.0
    price: float = 0.0

    def __post_init__(self) -> None:
        if not isinstance(self.minimum, int | float) or not 0.0 <= self.minimum <= 1.0:
            raise ModelError(f"end of horizon: minimum = {self.minimum!r}: must be a share between 0 and 1")
        if not isinstance(self.price, int | float) or not bounded(self.price):
            raise ModelError(f"end of horizon: price = {self.price!r}: must be a finite number in $/MWh")
