"""Renewable generation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from opfmodel.errors import ComponentError
from opfmodel.network.component import Component, component
from opfmodel.network.components.capability import capability, check_capability
from opfmodel.network.fields import at_bus, in_service, number, span

__all__ = ["Renewable"]


@component
class Renewable(Component):
    """Wind or solar power, of which any part may be curtailed."""

    kind: ClassVar[str] = "renewable"
    plural: ClassVar[str] = "renewables"
    lost: ClassVar[Mapping[str, float]] = {"available": 0, "q_min": 0, "q_max": 0}

    bus: str = at_bus()
    available: float = number("MW", at_least=0.0, description="Active power that the weather permits.")
    q: tuple[float, float] = span("MVAr", (0.0, 0.0), description="(min, max) of reactive power.")
    power_factor: float | None = number(
        "",
        None,
        above=0.0,
        at_most=1.0,
        optional=True,
        series=False,
        description="Minimum power factor, leading or lagging; none for no limit.",
    )
    rating: float | None = number(
        "MVA",
        None,
        at_least=0.0,
        optional=True,
        finite=False,
        description="Maximum apparent power; none for no limit.",
    )
    curtail_cost: float = number(
        "$/MWh", 0.0, at_least=0.0, description="Cost of available energy that is not generated."
    )
    capability: tuple[tuple[float, float], ...] | None = capability()
    in_service: bool = in_service()

    def check(self, name: str) -> None:
        """Raise :class:`ComponentError` if a field breaks a rule or it has no state without wind or sun."""
        super().check(name)
        least = max(self.q[0], -self.q[1], 0.0)
        if self.rating is not None and least > self.rating:
            raise ComponentError(
                name, "rating", self.rating, f"q needs at least {least:g} MVA, whatever is decided"
            )
        if self.power_factor is not None and least > 0:
            raise ComponentError(
                name, "q", self.q, "must include 0 with a power_factor, since nothing may be available"
            )
        still = (0.0, 0.0)
        q = self.q if self.power_factor is None else still
        if self.rating is not None:
            q = max(q[0], -self.rating), min(q[1], self.rating)
        try:
            check_capability(name, self.capability, still, q)
        except ComponentError as error:
            rule = "must admit p = 0 within the limits of q, since nothing may be available"
            raise ComponentError(name, "capability", self.capability, rule) from error
