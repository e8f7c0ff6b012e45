"""Loads."""

from __future__ import annotations

from typing import ClassVar

from opfmodel.network.component import Component, component
from opfmodel.network.fields import at_bus, in_service, number

__all__ = ["Load"]


@component
class Load(Component):
    """A demand at a bus; negative values are injections."""

    kind: ClassVar[str] = "load"
    plural: ClassVar[str] = "loads"

    bus: str = at_bus()
    p: float = number("MW", description="Active demand.")
    q: float = number("MVAr", 0.0, description="Reactive demand.")
    in_service: bool = in_service()
