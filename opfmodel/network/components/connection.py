"""Connections to another grid."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from opfmodel.data.calendar import Times
from opfmodel.network.component import Clocked, Component, component
from opfmodel.network.fields import at_bus, in_service, number, span

__all__ = ["Connection"]

_SAME = 1e-9  # of a period; clock times are sums of steps


@component
class Connection(Component):
    """A connection to another grid, from which power is bought and to which it is sold."""

    kind: ClassVar[str] = "connection"
    plural: ClassVar[str] = "connections"
    lost: ClassVar[Mapping[str, float]] = {"p_min": 0, "p_max": 0, "q_min": 0, "q_max": 0}
    clocked: ClassVar[Mapping[str, Clocked]] = {"kept": Clocked("", "min")}

    bus: str = at_bus()
    p: tuple[float, float] = span(
        "MW",
        averaged=True,
        description="(min, max) of the imported active power; negative values are exports.",
    )
    buy: float = number("$/MWh", description="Price of imports.")
    sell: float = number(
        "$/MWh", 0.0, not_above="buy", description="Price of exports, at most that of imports."
    )
    q: tuple[float, float] = span(
        "MVAr", (0.0, 0.0), description="(min, max) of the reactive power injected at its bus."
    )
    peak_cost: float = number(
        "$/MW", 0.0, at_least=0.0, description="Charge for the maximum import of a billing period."
    )
    peak_hours: float | None = number(
        "h",
        None,
        above=0.0,
        optional=True,
        series=False,
        description="Length of a billing period, from midnight of the first day on; none if it does not end.",
    )
    peak: float = number(
        "MW", 0.0, at_least=0.0, series=False, description="Maximum import of the billing period so far."
    )
    in_service: bool = in_service()

    def at_clock(self, times: Times) -> Mapping[str, npt.NDArray[np.float64]]:
        """Return ``kept``: 0 in a step in which a billing period begins, else 1.

        The initial peak counts in the period of step 0.
        """
        if self.peak_hours is None:
            return {"kept": np.ones(times.steps.size)}
        before = Times(np.maximum(times.steps - 1, 0), times.step, times.calendar)
        now, last = (np.floor(each.clock / self.peak_hours + _SAME) for each in (times, before))
        return {"kept": np.where(now > last, 0.0, 1.0)}
