"""Built-in kinds of components: buses, branches, generators, storages, loads and shunts.

Quantities are in physical units: MW, MVAr, MVA, MWh, hours, degrees and $. Impedances are per unit on the
network's ``base_mva``, and voltages are per unit.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar

from opfmodel.errors import ComponentError
from opfmodel.network.component import Component, component
from opfmodel.network.costs import Cost, Polynomial
from opfmodel.network.fields import INF, at_bus, cost_of, flag, in_service, number, span

__all__ = ["BUILT_IN", "Branch", "Bus", "Generator", "Load", "Shunt", "Storage"]

_LEAST_IMPEDANCE = 1e-12  # p.u.; admittances are squared


@component
class Bus(Component):
    """A node of the grid."""

    kind: ClassVar[str] = "bus"
    plural: ClassVar[str] = "buses"

    vm: tuple[float, float] = span(
        "p.u.", (0.9, 1.1), at_least=0.0, description="(min, max) of the voltage magnitude."
    )
    base_kv: float | None = number(
        "kV",
        None,
        above=0.0,
        optional=True,
        series=False,
        description="Nominal voltage; only used in network files.",
    )
    reference: bool = flag(False, "Whether this is the reference bus of its island, with angle zero.")
    va_set: float = number(
        "deg", 0.0, series=False, description="Angle of the reference bus in a power flow."
    )
    in_service: bool = in_service()


@component
class Branch(Component):
    """A line or transformer: the π model with an ideal transformer at the from end."""

    kind: ClassVar[str] = "branch"
    plural: ClassVar[str] = "branches"

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
    tap: float = number("", 1.0, at_least=1e-3, at_most=1e3, series=False, description="Transformer ratio.")
    shift: float = number("deg", 0.0, series=False, description="Phase shift of the transformer.")
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


@component
class Generator(Component):
    """A generating unit at a bus."""

    kind: ClassVar[str] = "generator"
    plural: ClassVar[str] = "generators"

    bus: str = at_bus()
    p: tuple[float, float] = span("MW", averaged=True, description="(min, max) of active power.")
    q: tuple[float, float] = span("MVAr", (-INF, INF), description="(min, max) of reactive power.")
    ramp: float | None = number(
        "MW/h",
        None,
        at_least=0.0,
        optional=True,
        finite=False,
        description="Maximum change of active power; none for no limit.",
    )
    cost: Cost = cost_of(Polynomial(), "Cost of active power: a Polynomial or PiecewiseLinear.")
    pg_set: float | None = number(
        "MW",
        None,
        optional=True,
        series=False,
        description="Set-point of active power in a power flow; none for 0, within the limits.",
    )
    qg_set: float | None = number(
        "MVAr",
        None,
        optional=True,
        series=False,
        description="Set-point of reactive power in a power flow; none for 0, within the limits.",
    )
    vm_set: float | None = number(
        "p.u.",
        None,
        above=0.0,
        optional=True,
        series=False,
        description="Set-point of the voltage at its bus in a power flow; none for 1, within its limits.",
    )
    regulates: bool = flag(
        True, "Whether the generator holds vm_set in a power flow; otherwise it injects qg_set."
    )
    participation: float | None = number(
        "",
        None,
        at_least=0.0,
        optional=True,
        series=False,
        description="Weight in the distributed slack of a power flow, relative to the other generators of "
        "its island; none for p_max if it regulates, else 0.",
    )
    in_service: bool = in_service()


@component
class Storage(Component):
    """A battery or other energy storage; positive power charges it."""

    kind: ClassVar[str] = "storage"
    plural: ClassVar[str] = "storages"

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
    energy_min: float = number("MWh", 0.0, at_least=0.0, over="max", description="Minimum stored energy.")
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
    in_service: bool = in_service()

    def check(self, name: str) -> None:
        """Raise :class:`ComponentError` if a field breaks a rule or the energies are not in order."""
        super().check(name)
        if self.energy_min > self.energy:
            raise ComponentError(
                name, "energy_min", self.energy_min, f"must be at most energy = {self.energy:g}"
            )
        power, q = (pair if isinstance(pair, tuple) else (-pair, pair) for pair in (self.power, self.q))
        least = math.hypot(*(max(low, min(0.0, high)) for low, high in (power, q)))
        if self.rating is not None and least > self.rating:
            raise ComponentError(
                name, "rating", self.rating, f"power and q need at least {least:g} MVA, whatever is decided"
            )
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


@component
class Load(Component):
    """A demand at a bus; negative values are injections."""

    kind: ClassVar[str] = "load"
    plural: ClassVar[str] = "loads"

    bus: str = at_bus()
    p: float = number("MW", description="Active demand.")
    q: float = number("MVAr", 0.0, description="Reactive demand.")
    in_service: bool = in_service()


@component
class Shunt(Component):
    """A shunt at a bus, which draws ``g vm²`` active power and injects ``b vm²`` reactive power."""

    kind: ClassVar[str] = "shunt"
    plural: ClassVar[str] = "shunts"

    bus: str = at_bus()
    g: float = number("MW", 0.0, series=False, description="Active power drawn at 1 p.u. voltage.")
    b: float = number("MVAr", 0.0, series=False, description="Reactive power injected at 1 p.u. voltage.")
    in_service: bool = in_service()


BUILT_IN: tuple[type[Component], ...] = (Bus, Branch, Generator, Storage, Load, Shunt)
"""Kinds of this package; devices from other packages define their own."""
