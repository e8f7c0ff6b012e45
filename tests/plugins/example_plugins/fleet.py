"""Fleets of electric vehicles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from opfmodel.model import Device, Model, Stage
from opfmodel.network import Component, Table, at_bus, in_service, number
from solvers import total

__all__ = ["Fleet", "FleetDevice"]


@dataclass(frozen=True)
class Fleet(Component):
    """Electric vehicles that charge at one bus."""

    kind: ClassVar[str] = "fleet"
    plural: ClassVar[str] = "fleets"

    bus: str = at_bus()
    power: float = number(
        "MW",
        at_least=0.0,
        description="Maximum charging power; a series that is zero while the vehicles are away.",
    )
    energy: float = number("MWh", at_least=0.0, description="Maximum energy.")
    energy_min: float = number(
        "MWh", 0.0, at_least=0.0, description="Minimum energy; a series states what departures require."
    )
    driving: float = number(
        "MW", 0.0, at_least=0.0, description="Power consumed on the road, usually a series."
    )
    initial: float = number("MWh", 0.0, at_least=0.0, description="Initial energy.")
    wear: float = number("$/MWh", 0.0, at_least=0.0, description="Cost of battery wear per energy charged.")
    in_service: bool = in_service()


class FleetDevice(Device):
    r"""Fleets that charge, drive and depart with enough energy.

    .. math::
        e(k+1) = e(k) + \Delta (p^c(k) - p^d(k)), \quad 0 \le p^c \le power, \quad
        e_{min} \le e \le \bar e
    """

    component = Fleet

    def declare(self, model: Model, table: Table) -> None:
        """Declare ``charge`` and ``level``."""
        charge = model.variable("fleet", "charge", 0.0, "power", unit="MW", description="charging power")
        level, level_next = model.stock(
            "fleet", "level", "energy_min", "energy", initial="initial",
            unit="MWh", description="energy of the vehicles",
        )  # fmt: skip
        gained = model.step * (charge - model.field("fleet", "driving"))
        model.rows("fleet", "fleet_energy", level_next - level - gained, 0.0, 0.0)
        model.inject(table.bus, p=-charge)

    def cost(self, stage: Stage) -> Any:
        """Cost of wear, $/h."""
        return total(stage.fleet.wear * stage.fleet.charge)
