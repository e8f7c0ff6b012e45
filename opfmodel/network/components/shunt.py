"""Shunts."""

from __future__ import annotations

from typing import ClassVar

from opfmodel.network.component import Component, component
from opfmodel.network.components import positions
from opfmodel.network.fields import adjustable, at_bus, in_service, number

__all__ = ["Shunt"]


@component
class Shunt(Component):
    """A shunt at a bus, which draws ``g vm²`` active power and injects ``b vm²`` reactive power."""

    kind: ClassVar[str] = "shunt"
    plural: ClassVar[str] = "shunts"

    bus: str = at_bus()
    g: float = number("MW", 0.0, series=False, description="Active power drawn at 1 p.u. voltage.")
    b: float | tuple[float, float] = adjustable(
        "MVAr",
        0.0,
        description="Reactive power injected at 1 p.u. voltage; a range if it is switchable.",
    )
    steps: float | None = positions.steps(
        1, "Number of equal steps in which a switchable shunt is switched; none for any value."
    )
    move_cost: float | None = positions.move_cost("b")
    in_service: bool = in_service()

    def check(self, name: str) -> None:
        """Raise :class:`ComponentError` if a field breaks a rule or the steps do not fit the range."""
        super().check(name)
        positions.check_positions(self, name, {"b": "steps"})
