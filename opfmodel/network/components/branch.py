"""Lines and transformers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

from opfmodel.errors import ComponentError
from opfmodel.network.component import Component, component
from opfmodel.network.components import positions
from opfmodel.network.fields import adjustable, at_bus, in_service, number, span

__all__ = ["Branch"]

_LEAST_IMPEDANCE = 1e-12  # p.u.; admittances are squared


@component
class Branch(Component):
    """A line or transformer: the π model with an ideal transformer at the from end."""

    kind: ClassVar[str] = "branch"
    plural: ClassVar[str] = "branches"
    lost: ClassVar[Mapping[str, float]] = {"angle_min": -4 * math.pi, "angle_max": 4 * math.pi}  # rad, none

    from_bus: str = at_bus("Name of the bus at its from end.")
    to_bus: str = at_bus("Name of the bus at its to end.")
    r: float = number("p.u. impedance", series=False, description="Series resistance.")
    x: float = number("p.u. impedance", series=False, description="Series reactance.")
    b: float = number(
        "p.u. admittance", 0.0, series=False, description="Total charging susceptance, half at each end."
    )
    g: float = number(
        "p.u. admittance", 0.0, series=False, description="Total charging conductance, half at each end."
    )
    rating: float | None = number(
        "MVA",
        None,
        at_least=0.0,
        optional=True,
        finite=False,
        description="Maximum apparent power at both ends; none for no limit.",
    )
    emergency_rating: float | None = number(
        "MVA",
        None,
        at_least=0.0,
        optional=True,
        over="min",
        description="Maximum for a short time after an outage; by default a multiple of the rating.",
    )
    tap: float | tuple[float, float] = adjustable(
        "", 1.0, at_least=1e-3, at_most=1e3, description="Transformer ratio; a range if it is adjustable."
    )
    shift: float | tuple[float, float] = adjustable(
        "deg", 0.0, description="Phase shift of the transformer; a range if it is adjustable."
    )
    angle: tuple[float, float] = span(
        "deg",
        (-360.0, 360.0),
        series=False,
        description="(min, max) of the angle difference from - to; ±360 or more means no limit.",
    )
    g_from: float = number(
        "p.u. admittance", 0.0, series=False, description="Additional shunt conductance at the from end."
    )
    b_from: float = number(
        "p.u. admittance", 0.0, series=False, description="Additional shunt susceptance at the from end."
    )
    g_to: float = number(
        "p.u. admittance", 0.0, series=False, description="Additional shunt conductance at the to end."
    )
    b_to: float = number(
        "p.u. admittance", 0.0, series=False, description="Additional shunt susceptance at the to end."
    )
    tap_steps: float | None = positions.steps(
        2, "Number of positions of an adjustable ratio, both ends included; none for any ratio."
    )
    shift_steps: float | None = positions.steps(
        2, "Number of positions of an adjustable phase shift, both ends included; none for any."
    )
    move_cost: float | None = positions.move_cost("tap or shift")
    in_service: bool = in_service()

    def check(self, name: str) -> None:
        """Raise :class:`ComponentError` if a field breaks a rule or the impedance is close to zero."""
        super().check(name)
        if math.hypot(self.r, self.x) < _LEAST_IMPEDANCE:
            raise ComponentError(
                name,
                "r, x",
                (self.r, self.x),
                f"the impedance must be at least {_LEAST_IMPEDANCE:g} p.u.; merge the two buses instead",
            )
        if self.from_bus == self.to_bus:
            raise ComponentError(name, "to_bus", self.to_bus, "must differ from from_bus")
        positions.check_positions(self, name, {"tap": "tap_steps", "shift": "shift_steps"})
