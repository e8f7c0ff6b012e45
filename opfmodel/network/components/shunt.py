"""Shunts."""

from __future__ import annotations

from typing import ClassVar

from opfmodel.network.component import Component, component
from opfmodel.network.fields import at_bus, in_service, number

__all__ = ["Shunt"]


@component
class Shunt(Component):
    """A shunt at a bus, which draws ``g vm²`` active power and injects ``b vm²`` reactive power."""

    kind: ClassVar[str] = "shunt"
    plural: ClassVar[str] = "shunts"

    bus: str = at_bus()
    g: float = number("MW", 0.0, series=False, description="Active power drawn at 1 p.u. voltage.")
    b: float = number("MVAr", 0.0, series=False, description="Reactive power injected at 1 p.u. voltage.")
    in_service: bool = in_service()
