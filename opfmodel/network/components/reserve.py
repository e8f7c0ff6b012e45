"""Reserves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from opfmodel.errors import ComponentError, nearest
from opfmodel.network.component import Component, component
from opfmodel.network.fields import choice, in_service, number, weights

__all__ = ["Reserve"]

_OFFERING = ("generator", "storage")


@component
class Reserve(Component):
    """A reserve product: power that units keep ready, beyond or below what they are planned to inject."""

    kind: ClassVar[str] = "reserve"
    plural: ClassVar[str] = "reserves"

    requirement: float = number(
        "MW", at_least=0.0, over="max", description="Reserve that all units together must offer."
    )
    direction: str = choice(
        ("up", "down"),
        "up",
        description="Whether it is called up by injecting more power (up) or less (down).",
    )
    minutes: float = number(
        "min",
        15.0,
        above=0.0,
        series=False,
        description="Time within which it must be delivered; a generator offers at most ramp minutes / 60.",
    )
    hours: float = number(
        "h",
        1.0,
        at_least=0.0,
        series=False,
        description="Time for which a storage must be able to deliver it.",
    )
    units: Mapping[str, float] = weights(
        "MW",
        of=_OFFERING,
        default={},
        description="Maximum that each generator or storage offers, by name; others offer none. Empty for "
        "all generators and storages, each as much as it can.",
    )
    cost: Mapping[str, float] = weights(
        "$/MWh",
        of=_OFFERING,
        default={},
        description="Price of the reserve that each generator or storage offers, by name, per MW and hour; "
        "others offer it for nothing.",
    )
    lacking_cost: float | None = number(
        "$/MWh",
        None,
        at_least=0.0,
        optional=True,
        series=False,
        description="Price of the reserve that is missing; none if the requirement must be met.",
    )
    in_service: bool = in_service()

    def check(self, name: str) -> None:
        """Raise :class:`ComponentError` if a field breaks a rule or a price belongs to no offer."""
        super().check(name)
        for key, values in (("units", self.units), ("cost", self.cost)):
            for unit, value in values.items():
                if value < 0.0:
                    raise ComponentError(name, f"{key}.{unit}", value, "must be at least 0")
        for unit, price in self.cost.items():
            if self.units and unit not in self.units:
                rule = f"has a price but is not among the units; {nearest(unit, self.units)}"
                raise ComponentError(name, f"cost.{unit}", price, rule)
