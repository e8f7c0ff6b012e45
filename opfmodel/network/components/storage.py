"""Storages."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from opfmodel.data.calendar import Times
from opfmodel.errors import ComponentError
from opfmodel.network.component import Clocked, Component, component
from opfmodel.network.components.capability import capability, check_capability
from opfmodel.network.fields import at_bus, flag, in_service, number, span

__all__ = ["Storage"]

_SAME = 1e-9  # of a period; clock times are sums of steps


@component
class Storage(Component):
    """A battery or other energy storage; positive power charges it."""

    kind: ClassVar[str] = "storage"
    plural: ClassVar[str] = "storages"
    lost: ClassVar[Mapping[str, float]] = {"power_min": 0, "power_max": 0, "q_min": 0, "q_max": 0}
    clocked: ClassVar[Mapping[str, Clocked]] = {"energy_wanted": Clocked("MWh", "max", of="wanted")}

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
    throughput_cost: float = number(
        "$/MWh", 0.0, at_least=0.0, description="Cost of the energy charged or discharged at its bus."
    )
    wanted: float | None = number(
        "MWh",
        None,
        at_least=0.0,
        optional=True,
        series=False,
        description="Minimum stored energy at the end of the stages that contain an hour of wanted_at.",
    )
    wanted_at: float = number(
        "h",
        0.0,
        at_least=0.0,
        series=False,
        description="First hour at which the energy is wanted, from midnight of the first day.",
    )
    wanted_every: float = number(
        "h", 24.0, above=0.0, series=False, description="Hours between two hours at which it is wanted."
    )
    recovery_cost: float | None = number(
        "$/MWh/h",
        None,
        above=0.0,
        optional=True,
        series=False,
        description="Price of stored energy outside its limits at the end of a stage; none forbids it.",
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
        if self.wanted is not None and self.wanted > self.energy:
            raise ComponentError(name, "wanted", self.wanted, f"must be at most energy = {self.energy:g}")
        power, q = (pair if isinstance(pair, tuple) else (-pair, pair) for pair in (self.power, self.q))
        least = math.hypot(*(max(low, min(0.0, high)) for low, high in (power, q)))
        if self.rating is not None and least > self.rating:
            raise ComponentError(
                name, "rating", self.rating, f"power and q need at least {least:g} MVA, whatever is decided"
            )
        check_capability(name, self.capability, power, q)
        confined = self.recovery_cost is None
        if confined and self.initial is not None and not self.energy_min <= self.initial <= self.energy:
            raise ComponentError(
                name,
                "initial",
                self.initial,
                f"must be between energy_min = {self.energy_min:g} and energy = {self.energy:g}",
            )

    def at_clock(self, times: Times) -> Mapping[str, npt.NDArray[np.float64]]:
        """Return ``energy_wanted``: what is wanted at the end of a step that such an hour is in, else 0."""
        if self.wanted is None:
            return {"energy_wanted": np.zeros(times.steps.size)}
        after = Times(times.steps + 1, times.step, times.calendar)
        begin, end = (
            np.floor((each.clock - self.wanted_at) / self.wanted_every + _SAME) for each in (times, after)
        )
        return {"energy_wanted": np.where(end > np.maximum(begin, -1.0), self.wanted, 0.0)}

    def resolved(self) -> Storage:
        """Return the storage with its initial energy filled in."""
        return (
            self if self.initial is not None else replace(self, initial=0.5 * (self.energy_min + self.energy))
        )
