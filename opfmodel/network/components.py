"""Built-in kinds of components: buses, branches, generators, storages, loads and shunts.

Quantities are in physical units: MW, MVAr, MVA, MWh, hours, degrees and $. Impedances are per unit on the
network's ``base_mva``, and voltages are per unit.
"""

from __future__ import annotations

import math
from dataclasses import field, replace
from typing import ClassVar

from opfmodel.errors import ComponentError
from opfmodel.network.component import Component, component
from opfmodel.network.costs import Cost, Polynomial
from opfmodel.network.fields import INF, at_bus, flag, number, span

__all__ = ["BUILT_IN", "Branch", "Bus", "Generator", "Load", "Shunt", "Storage"]

_LEAST_IMPEDANCE = 1e-12  # p.u.; admittances are squared


@component
class Bus(Component):
    """A node of the grid.

    Parameters
    ----------
    vm
        ``(min, max)`` of the voltage magnitude, p.u.
    base_kv
        Nominal voltage, kV; only used in network files.
    reference
        Whether this is the reference bus of its island, with angle zero.
    va_set
        Angle of the reference bus in a power flow, degrees.
    """

    kind: ClassVar[str] = "bus"
    plural: ClassVar[str] = "buses"

    vm: tuple[float, float] = span("p.u.", (0.9, 1.1), at_least=0.0)
    base_kv: float | None = number("kV", None, above=0.0, optional=True, series=False)
    reference: bool = flag(False)
    va_set: float = number("deg", 0.0, series=False)
    in_service: bool = flag(True)


@component
class Branch(Component):
    """A line or transformer: the π model with an ideal transformer at the from end.

    Parameters
    ----------
    from_bus, to_bus
        Names of its buses.
    r, x
        Series impedance, p.u.
    b, g
        Total charging susceptance and conductance, half at each end, p.u.
    rating
        Maximum apparent power at both ends, MVA; None for no limit.
    tap, shift
        Transformer ratio, from 0.001 to 1000, and phase shift, degrees.
    angle
        ``(min, max)`` of the angle difference from - to, degrees; ±360 or more means no limit.
    g_from, b_from, g_to, b_to
        Additional shunt admittance at each end, p.u.
    """

    kind: ClassVar[str] = "branch"
    plural: ClassVar[str] = "branches"

    from_bus: str = at_bus()
    to_bus: str = at_bus()
    r: float = number("p.u. impedance", series=False)
    x: float = number("p.u. impedance", series=False)
    b: float = number("p.u. admittance", 0.0, series=False)
    g: float = number("p.u. admittance", 0.0, series=False)
    rating: float | None = number("MVA", None, at_least=0.0, optional=True, finite=False)
    tap: float = number("", 1.0, at_least=1e-3, at_most=1e3, series=False)
    shift: float = number("deg", 0.0, series=False)
    angle: tuple[float, float] = span("deg", (-360.0, 360.0), series=False)
    g_from: float = number("p.u. admittance", 0.0, series=False)
    b_from: float = number("p.u. admittance", 0.0, series=False)
    g_to: float = number("p.u. admittance", 0.0, series=False)
    b_to: float = number("p.u. admittance", 0.0, series=False)
    in_service: bool = flag(True)

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
    """A generating unit at a bus.

    Parameters
    ----------
    bus
        Name of its bus.
    p, q
        ``(min, max)`` of active and reactive power, MW and MVAr; no limit on q by default.
    ramp
        Maximum change of active power, MW/h; None for no limit.
    cost
        :class:`Polynomial` or :class:`PiecewiseLinear`.
    pg_set, qg_set
        Set-points of active and reactive power in a power flow, MW and MVAr; None for 0, within the limits.
    vm_set
        Set-point of the voltage at its bus in a power flow, p.u.; None for 1, within the limits of the bus.
    regulates
        Whether the generator holds ``vm_set`` in a power flow; otherwise it injects ``qg_set``.
    participation
        Weight in the distributed slack of a power flow, relative to the other generators of the island;
        None for ``p[1]`` if it regulates, else 0.
    """

    kind: ClassVar[str] = "generator"
    plural: ClassVar[str] = "generators"

    bus: str = at_bus()
    p: tuple[float, float] = span("MW")
    q: tuple[float, float] = span("MVAr", (-INF, INF))
    ramp: float | None = number("MW/h", None, at_least=0.0, optional=True, finite=False)
    cost: Cost = field(default=Polynomial(), metadata={"form": "cost", "unit": ""})
    pg_set: float | None = number("MW", None, optional=True, series=False)
    qg_set: float | None = number("MVAr", None, optional=True, series=False)
    vm_set: float | None = number("p.u.", None, above=0.0, optional=True, series=False)
    regulates: bool = flag(True)
    participation: float | None = number("", None, at_least=0.0, optional=True, series=False)
    in_service: bool = flag(True)


@component
class Storage(Component):
    """A battery or other energy storage; positive power charges it.

    Parameters
    ----------
    bus
        Name of its bus.
    energy
        Energy capacity, MWh.
    power
        ``(min, max)`` of the charging power, MW; a single number ``a`` means ``(-a, a)``.
    q
        ``(min, max)`` of the reactive power drawn, MVAr; a single number as for ``power``.
    initial
        Initial energy, MWh; None for the midpoint of ``energy_min`` and ``energy``.
    energy_min
        Minimum stored energy, MWh.
    charge_efficiency, discharge_efficiency
        Efficiency, from 0.001 to 1.
    standing_loss
        Fraction of the stored energy lost per hour.
    rating
        Maximum apparent power, MVA; None for no limit.
    exclusive
        Forbid simultaneous charging and discharging, relevant only with losses and negative
        prices. Makes the problem non-convex, so it requires a nonlinear solver.
    ps_set, qs_set
        Charging power and reactive power drawn in a power flow, MW and MVAr; None for 0.
    """

    kind: ClassVar[str] = "storage"
    plural: ClassVar[str] = "storages"

    bus: str = at_bus()
    energy: float = number("MWh", at_least=0.0)
    power: float | tuple[float, float] = span("MW", symmetric=True)
    q: float | tuple[float, float] = span("MVAr", (0.0, 0.0), symmetric=True)
    initial: float | None = number("MWh", None, at_least=0.0, optional=True, series=False)
    energy_min: float = number("MWh", 0.0, at_least=0.0)
    charge_efficiency: float = number("", 1.0, at_least=1e-3, at_most=1.0, series=False)
    discharge_efficiency: float = number("", 1.0, at_least=1e-3, at_most=1.0, series=False)
    standing_loss: float = number("1/h", 0.0, at_least=0.0, at_most=1.0, series=False)
    rating: float | None = number("MVA", None, at_least=0.0, optional=True, finite=False)
    exclusive: bool = flag(False)
    ps_set: float | None = number("MW", None, optional=True, series=False)
    qs_set: float | None = number("MVAr", None, optional=True, series=False)
    in_service: bool = flag(True)

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
    """A demand at a bus; negative values are injections.

    Parameters
    ----------
    bus
        Name of its bus.
    p, q
        Active and reactive demand, MW and MVAr.
    """

    kind: ClassVar[str] = "load"
    plural: ClassVar[str] = "loads"

    bus: str = at_bus()
    p: float = number("MW")
    q: float = number("MVAr", 0.0)
    in_service: bool = flag(True)


@component
class Shunt(Component):
    """A shunt at a bus, which draws ``g vm²`` active power and injects ``b vm²`` reactive power.

    Parameters
    ----------
    bus
        Name of its bus.
    g, b
        Active power drawn and reactive power injected at 1 p.u. voltage, MW and MVAr.
    """

    kind: ClassVar[str] = "shunt"
    plural: ClassVar[str] = "shunts"

    bus: str = at_bus()
    g: float = number("MW", 0.0, series=False)
    b: float = number("MVAr", 0.0, series=False)
    in_service: bool = flag(True)


BUILT_IN: tuple[type[Component], ...] = (Bus, Branch, Generator, Storage, Load, Shunt)
"""Kinds of this package; devices from other packages define their own."""
