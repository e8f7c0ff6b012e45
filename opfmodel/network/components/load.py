"""Loads."""

from __future__ import annotations

from typing import ClassVar

from opfmodel.network.component import Component, component
from opfmodel.network.fields import at_bus, in_service, number

__all__ = ["Load"]


@component
class Load(Component):
    """A demand at a bus; negative values are injections, which are never shed."""

    kind: ClassVar[str] = "load"
    plural: ClassVar[str] = "loads"

    bus: str = at_bus()
    p: float = number("MW", description="Active demand.")
    q: float = number("MVAr", 0.0, description="Reactive demand.")
    shed_cost: float | None = number(
        "$/MWh",
        None,
        at_least=0.0,
        optional=True,
        description="Cost of demand that is shed (value of lost load); none if it may not be shed.",
    )
    in_service: bool = in_service()
