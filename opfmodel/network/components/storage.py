"""Storages."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

from opfmodel.errors import ComponentError
from opfmodel.network.component import Component, component
from opfmodel.network.components.capability import capability, check_capability
from opfmodel.network.fields import at_bus, flag, in_service, number, span

__all__ = ["Storage"]


@component
class Storage(Component):
    """A battery or other energy storage; positive power charges it."""

    kind: ClassVar[str] = "storage"
    plural: ClassVar[str] = "storages"
    lost: ClassVar[Mapping[str, float]] = {"power_min": 0, "power_max": 0, "q_min": 0, "q_max": 0}

    bus: str = at_bus()
    energy: float = number("MWh", at_least=0.0, over="min", description="Energy capacity.")
    power: float | tuple[float, float] = span(
        "MW", symmetric=True, description="(min, max) of the charging power; a single number a means (-a, a)."
    )
    q: float | tuple[float, float] = span(
        "MVAr",
        (0.0, 0.0),
        symmetric=True,
        description="(min, max) of the reactive power drawn; a single number as for power.",
    )
    initial: float | None = number(
        "MWh",
        None,
        at_least=0.0,
        optional=True,
        series=False,
        description="Initial energy; none for the midpoint of energy_min and energy.",
    )
    energy_min: float = number(
        "MWh", 0.0, at_least=0.0, not_above="energy", over="max", description="Minimum stored energy."
    )
    charge_efficiency: float = number(
        "", 1.0, at_least=1e-3, at_most=1.0, series=False, description="Energy stored per energy drawn."
    )
    discharge_efficiency: float = number(
        "",
        1.0,
        at_least=1e-3,
        at_most=1.0,
        series=False,
        description="Energy delivered per energy taken from the store.",
    )
    standing_loss: float = number(
        "1/h",
        0.0,
        at_least=0.0,
        at_most=1.0,
        series=False,
        description="Fraction of the stored energy lost per hour.",
    )
    rating: float | None = number(
        "MVA",
        None,
        at_least=0.0,
        optional=True,
        finite=False,
        description="Maximum apparent power; none for no limit.",
    )
    exclusive: bool = flag(
        False,
        "Forbid simultaneous charging and discharging, relevant only with losses and negative prices; "
        "the problem becomes non-convex and needs a nonlinear solver.",
    )
    ps_set: float | None = number(
        "MW",
        None,
        optional=True,
        series=False,
        description="Set-point of the charging power in a power flow; none for 0.",
    )
    qs_set: float | None = number(
        "MVAr",
        None,
        optional=True,
        series=False,
        description="Set-point of the reactive power drawn in a power flow; none for 0.",
    )
    capability: tuple[tuple[float, float], ...] | None = capability("power as drawn")
    in_service: bool = in_service()

    def check(self, name: str) -> None:
        """Raise :class:`ComponentError` if a field breaks a rule or the energies are not in order."""
        super().check(name)
        power, q = (pair if isinstance(pair, tuple) else (-pair, pair) for pair in (self.power, self.q))
        least = math.hypot(*(max(low, min(0.0, high)) for low, high in (power, q)))
        if self.rating is not None and least > self.rating:
            raise ComponentError(
                name, "rating", self.rating, f"power and q need at least {least:g} MVA, whatever is decided"
            )
        check_capability(name, self.capability, power, q)
        if self.initial is not None and not self.energy_min <= self.initial <= self.energy:
            raise ComponentError(
                name,
                "initial",
                self.initial,
                f"must be between energy_min = {self.energy_min:g} and energy = {self.energy:g}",
            )

    def resolved(self) -> Storage:
        """Return the storage with its initial energy filled in."""
        return (
            self if self.initial is not None else replace(self, initial=0.5 * (self.energy_min + self.energy))
        )
