"""Point-to-point DC lines."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

from opfmodel.errors import ComponentError
from opfmodel.network.component import Component, component
from opfmodel.network.fields import at_bus, in_service, number, span

__all__ = ["MOST_LOSS", "DCLine"]

MOST_LOSS = 0.999  # the receiving end has at least a thousandth of what is sent


@component
class DCLine(Component):
    """A DC line between two buses, with its converters; it joins no islands."""

    kind: ClassVar[str] = "dc_line"
    plural: ClassVar[str] = "dc_lines"
    lost: ClassVar[Mapping[str, float]] = {
        "p_min": 0,
        "p_max": 0,
        "loss_fixed": 0,
        "q_from_min": 0,
        "q_from_max": 0,
        "q_to_min": 0,
        "q_to_max": 0,
    }

    from_bus: str = at_bus("Name of the bus at its from end.")
    to_bus: str = at_bus("Name of the bus at its to end.")
    p: float | tuple[float, float] = span(
        "MW",
        symmetric=True,
        averaged=True,
        description="(min, max) of the active power that enters at the from end, negative where it leaves "
        "there; a single number a means (-a, a).",
    )
    loss: float = number(
        "",
        0.0,
        at_least=0.0,
        at_most=MOST_LOSS,
        series=False,
        description="Share of the power sent by either end that does not arrive at the other.",
    )
    loss_fixed: float = number(
        "MW",
        0.0,
        at_least=0.0,
        series=False,
        description="Loss at any power, drawn at the to end while the line is in service.",
    )
    q_from: float | tuple[float, float] = span(
        "MVAr",
        (0.0, 0.0),
        symmetric=True,
        description="(min, max) of the reactive power that the converter injects into the from bus; a single "
        "number a means (-a, a).",
    )
    q_to: float | tuple[float, float] = span(
        "MVAr",
        (0.0, 0.0),
        symmetric=True,
        description="(min, max) of the reactive power that the converter injects into the to bus; a single "
        "number a means (-a, a).",
    )
    cost: float = number(
        "$/MWh",
        0.0,
        at_least=0.0,
        description="Cost of the energy that enters or leaves at the from end.",
    )
    pf_set: float | None = number(
        "MW",
        None,
        optional=True,
        series=False,
        description="Set-point of the power that enters at the from end in a power flow; none for 0, within "
        "the limits.",
    )
    qf_set: float | None = number(
        "MVAr",
        None,
        optional=True,
        series=False,
        description="Set-point of the reactive power injected into the from bus in a power flow; none for 0, "
        "within the limits.",
    )
    qt_set: float | None = number(
        "MVAr",
        None,
        optional=True,
        series=False,
        description="Set-point of the reactive power injected into the to bus in a power flow; none for 0, "
        "within the limits.",
    )
    in_service: bool = in_service()

    def check(self, name: str) -> None:
        """Raise :class:`ComponentError` if a field breaks a rule or the relaxation of losses is unbounded."""
        super().check(name)
        if self.from_bus == self.to_bus:
            raise ComponentError(name, "to_bus", self.to_bus, "must differ from from_bus")
        low, high = self.constant("p_min"), self.constant("p_max")
        if self.loss and low < 0 < high and not math.isfinite(high - low):
            raise ComponentError(
                name, "p", self.p, f"must be finite in both directions with loss = {self.loss:g}"
            )

    @property
    def delivered_mw(self) -> tuple[float, float]:
        """Maximum power that the line delivers at its from and to ends, MW."""
        back, forward = -self.constant("p_min"), self.constant("p_max")
        return max(back, 0.0), max((1.0 - self.loss) * forward - self.loss_fixed, 0.0)
