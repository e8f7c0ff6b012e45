"""Terminal conditions on stored energy."""

from __future__ import annotations

from dataclasses import dataclass

from opfmodel.network.bounds import number_within

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
        number_within("end: minimum", self.minimum, at_least=0, at_most=1)
        number_within("end: price", self.price)
