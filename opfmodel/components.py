"""The declarations: buses, branches, generators, storage, loads, shunts, and the network they form.

    >>> import opfmodel as om
    >>> grid = om.Network("two-bus", base_mva=100)
    >>> grid.north = om.Bus(vm=(0.95, 1.05), reference=True)
    >>> grid.south = om.Bus(vm=(0.95, 1.05))
    >>> grid.tie = om.Branch("north", "south", r=0.01, x=0.1, rating=120)
    >>> grid.coal = om.Generator("north", p=(0, 200), cost=om.Polynomial(0.01, 15, 0))
    >>> grid.town = om.Load("south", p=90, q=30)
    >>> grid
    Network('two-bus': 2 buses, 1 branch, 1 generator, 1 load)

An assigned attribute names the component; loops use :meth:`Network.add`. Quantities are physical:
MW, MVAr, MVA, MWh, hours, degrees, $; impedances and voltages are in per unit on ``base_mva``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields, replace
from functools import cache
from itertools import pairwise
from typing import Any, ClassVar, Self, TypeGuard, TypeVar

import numpy as np

from opfmodel.errors import ComponentError, NetworkError, nearest
from opfmodel.text import name_fault
from opfmodel.units import BASE_MVA, LARGEST, bounded

__all__ = [
    "BUILT_IN",
    "Branch",
    "Bus",
    "Component",
    "Cost",
    "Generator",
    "Load",
    "Network",
    "PiecewiseLinear",
    "Polynomial",
    "Shunt",
    "Storage",
    "at_bus",
    "flag",
    "name_pattern",
    "number",
    "span",
]

C = TypeVar("C", bound="Component")
INF = math.inf
_LEAST_IMPEDANCE = 1e-12  # p.u.; admittances are squared


# Fields: what a component's dataclass says about each of its quantities -----------------------


def number(
    unit: str,
    default: Any = MISSING,
    *,
    at_least: float = -INF,
    above: float = -INF,
    at_most: float = INF,
    optional: bool = False,
    finite: bool = True,
    series: bool = True,
) -> Any:
    """Declare a field that holds one number.

    Parameters
    ----------
    unit
        One of :data:`opfmodel.units.UNITS`; arrays of the field are in per unit accordingly.
    at_least, above, at_most
        What values are accepted.
    optional
        Whether ``None`` is accepted; it means "no limit" and becomes infinity.
    finite
        Whether infinity is refused; a field that accepts it says "no limit" by it, in time series too.
    series
        Whether the field may change in time; coefficients of a program's equations do not.
    """
    metadata = {
        "form": "number",
        "unit": unit,
        "at_least": at_least,
        "above": above,
        "at_most": at_most,
        "optional": optional,
        "finite": finite,
        "series": series,
    }
    return field(default=default, metadata=metadata)


def span(
    unit: str,
    default: Any = MISSING,
    *,
    at_least: float = -INF,
    symmetric: bool = False,
    series: bool = True,
) -> Any:
    """Declare a field that holds ``(min, max)``; arrays of it are ``<field>_min`` and ``<field>_max``.

    Parameters
    ----------
    symmetric
        Whether a single number ``a`` stands for ``(-a, a)``.
    series
        As for :func:`number`.
    """
    metadata = {"form": "span", "unit": unit, "at_least": at_least, "symmetric": symmetric, "series": series}
    return field(default=default, metadata=metadata)


def at_bus() -> Any:
    """Declare a field that names a bus; the array of it holds bus positions."""
    return field(metadata={"form": "bus", "unit": "", "series": False})


def flag(default: bool) -> Any:
    """Declare a field that is true or false."""
    return field(default=default, metadata={"form": "flag", "unit": "", "series": False})


_FINITE = f"must be a finite number of at most {LARGEST:g}"


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


def _check_number(name: str, key: str, value: object, rules: Mapping[str, Any]) -> None:
    if value is None and rules["optional"]:
        return
    if not _is_number(value):
        raise ComponentError(name, key, value, f"must be a number in {_unit(rules)}")
    if not bounded(value) and (rules["finite"] or abs(value) != INF):
        raise ComponentError(name, key, value, _FINITE)
    if value < rules["at_least"]:
        raise ComponentError(name, key, value, f"must be at least {rules['at_least']:g}")
    if value <= rules["above"]:
        raise ComponentError(name, key, value, f"must be greater than {rules['above']:g}")
    if value > rules["at_most"]:
        raise ComponentError(name, key, value, f"must be at most {rules['at_most']:g}")


def _check_span(name: str, key: str, value: object, rules: Mapping[str, Any]) -> None:
    if rules["symmetric"] and _is_number(value):
        if not (bounded(value) or abs(value) == INF):
            raise ComponentError(name, key, value, _FINITE)
        if value < 0:
            raise ComponentError(
                name, key, value, "a single number stands for (-a, a); it must be at least 0"
            )
        return
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != 2:
        raise ComponentError(name, key, value, f"must be a pair (min, max) in {_unit(rules)}")
    low, high = value
    for end in (low, high):
        if not _is_number(end) or not (bounded(end) or abs(end) == INF):
            raise ComponentError(
                name,
                key,
                value,
                f"both ends must be numbers in {_unit(rules)} of at most {LARGEST:g}, or infinite",
            )
    if low > high:
        raise ComponentError(name, key, value, f"the minimum {low:g} is above the maximum {high:g}")
    if low == INF or high == -INF:
        raise ComponentError(
            name, key, value, "the minimum must be below infinity, the maximum above -infinity"
        )
    if low < rules["at_least"]:
        raise ComponentError(name, key, value, f"the minimum must be at least {rules['at_least']:g}")


def _unit(rules: Mapping[str, Any]) -> str:
    return str(rules["unit"]) or "plain numbers"


# Costs ------------------------------------------------------------------------------------------


class Cost:
    """Cost of producing active power, in $/h; convex."""

    def check(self, name: str, key: str) -> None:
        """Raise :class:`ComponentError` if this is not a convex cost."""
        raise NotImplementedError


@dataclass(frozen=True)
class Polynomial(Cost):
    """Quadratic cost ``c2 p^2 + c1 p + c0`` with p in MW.

    Parameters
    ----------
    c2, c1, c0
        In $/MW²h, $/MWh and $/h; ``c2 >= 0``.
    """

    c2: float = 0.0
    c1: float = 0.0
    c0: float = 0.0

    def check(self, name: str, key: str) -> None:
        """Raise :class:`ComponentError` unless the coefficients are finite and ``c2 >= 0``."""
        for coefficient in (self.c2, self.c1, self.c0):
            if not _is_number(coefficient) or not bounded(coefficient):
                raise ComponentError(
                    name, key, self, f"the coefficients must be finite numbers of at most {LARGEST:g}"
                )
        if self.c2 < 0:
            raise ComponentError(name, key, self, "must be convex: c2 must be at least 0")


@dataclass(frozen=True)
class PiecewiseLinear(Cost):
    """Convex piecewise-linear cost through points; the outer segments extend beyond the ends.

    Parameters
    ----------
    points
        ``((p, cost), ...)`` in MW and $/h, at least two, with increasing p and increasing slope.
    """

    points: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", tuple(tuple(p) for p in self.points))

    @property
    def slopes(self) -> list[float]:
        """Slope of each segment in $/MWh."""
        return [(c1 - c0) / (p1 - p0) for (p0, c0), (p1, c1) in pairwise(self.points)]

    @property
    def segments(self) -> list[tuple[float, float]]:
        """``(slope, offset)`` of each distinct line; the cost is the largest of the lines."""
        lines: list[tuple[float, float]] = []
        for (p, c), slope in zip(self.points[:-1], self.slopes, strict=True):
            if not lines or not math.isclose(slope, lines[-1][0], rel_tol=1e-12, abs_tol=1e-12):
                lines.append((slope, c - slope * p))
        return lines

    def check(self, name: str, key: str) -> None:
        """Raise :class:`ComponentError` unless there are two points, in order, and the cost is convex."""
        values = [v for point in self.points for v in point]
        if len(self.points) < 2 or any(len(point) != 2 for point in self.points):
            raise ComponentError(name, key, self, "needs at least two points (MW, $/h)")
        if not all(_is_number(v) and bounded(v) for v in values):
            raise ComponentError(name, key, self, f"the points must be finite numbers of at most {LARGEST:g}")
        if any(a[0] >= b[0] for a, b in pairwise(self.points)):
            raise ComponentError(name, key, self, "the points must have increasing MW")
        if not all(map(bounded, self.slopes)):
            raise ComponentError(name, key, self, f"the slopes must be at most {LARGEST:g} $/MWh")
        for first, second in pairwise(self.slopes):
            if second < first - 1e-9 * max(1.0, abs(first)):
                raise ComponentError(
                    name, key, self, f"must be convex: slope {second:g} follows {first:g} $/MWh"
                )


# Components -------------------------------------------------------------------------------------


class Component:
    """Base class of everything that is declared in a network.

    A subclass is a frozen dataclass whose fields are made by :func:`number`, :func:`span` and
    :func:`at_bus`. These say how a field is checked, converted to per unit and laid out in
    arrays, so that a new kind of component needs nothing else.

    Attributes
    ----------
    kind, plural
        Name of the dimension in results, and of the section in scenario files.
    """

    kind: ClassVar[str]
    plural: ClassVar[str]
    in_service: bool

    def __new__(cls, *_: Any, **values: Any) -> Self:
        """Refuse a field that there is not, with the nearest that there is."""
        for key, value in values.items():
            if key not in cls.fields():
                raise ComponentError(cls.__name__, key, value, f"unknown field; {nearest(key, cls.fields())}")
        return super().__new__(cls)

    def check(self, name: str) -> None:
        """Raise :class:`ComponentError` if a field breaks its rule. Subclasses add rules of their own."""
        for item in self.fields().values():
            value = getattr(self, item.name)
            form = item.metadata["form"]
            if form == "number":
                _check_number(name, item.name, value, item.metadata)
            elif form == "span":
                _check_span(name, item.name, value, item.metadata)
            elif form == "flag" and not isinstance(value, bool | np.bool_):
                raise ComponentError(name, item.name, value, "must be true or false")
            elif form == "bus" and not (isinstance(value, str) and value):
                raise ComponentError(name, item.name, value, "must be the name of a bus")
            elif form == "cost":
                if not isinstance(value, Cost):
                    raise ComponentError(
                        name,
                        item.name,
                        value,
                        "must be a Polynomial or PiecewiseLinear; in a file {c2: , c1: , c0: } in $/MW²h, "
                        "$/MWh, $/h or {points: [[MW, $/h], ...]}",
                    )
                value.check(name, item.name)

    def resolved(self) -> Self:
        """The component with defaults that depend on other fields filled in."""
        return self

    @classmethod
    @cache
    def fields(cls) -> Mapping[str, Field[Any]]:
        """The fields by name."""
        return {f.name: f for f in fields(cls)}  # type: ignore[arg-type]

    @classmethod
    @cache
    def bus_fields(cls) -> tuple[str, ...]:
        """Names of the fields that name a bus."""
        return tuple(name for name, item in cls.fields().items() if item.metadata["form"] == "bus")

    @classmethod
    def unlimited(cls, key: str) -> float | None:
        """The infinity by which a field of the table says that there is no limit; None if it cannot.

        Examples
        --------
        >>> Branch.unlimited("rating"), Generator.unlimited("q_min"), Load.unlimited("p")
        (inf, -inf, None)
        """
        known = cls.fields()
        if key in known and known[key].metadata["form"] == "number":
            return None if known[key].metadata["finite"] else INF
        stem, _, end = key.rpartition("_")
        default: Any = known[stem].default if end in ("min", "max") and stem in known else None
        value = float(default[end == "max"]) if isinstance(default, tuple) else 0.0
        return value if math.isinf(value) else None

    @property
    def buses(self) -> tuple[str, ...]:
        """Names of the buses that it is connected to."""
        return tuple(getattr(self, name) for name in self.bus_fields())

    @classmethod
    def from_mapping(cls, name: str, values: Mapping[str, Any]) -> Self:
        """Make a component from plain values, as a scenario file has them.

        Raises
        ------
        ComponentError
            An unknown field, a missing field or a value that breaks its rule.
        """
        known = cls.fields()
        for key in values:
            if key not in known:
                raise ComponentError(
                    name, key, values[key], f"unknown field of a {cls.kind}; {nearest(key, known)}"
                )
        for key, item in known.items():
            if key not in values and item.default is MISSING:
                raise ComponentError(name, key, None, f"a {cls.kind} needs this field")
        converted = {key: _plain(known[key], value) for key, value in values.items()}
        component = cls(**converted)
        component.check(name)
        return component


def _plain(item: Field[Any], value: Any) -> Any:
    """A value of a file in the form that the field takes: lists become tuples, mappings costs."""
    form = item.metadata["form"]
    if form == "cost" and isinstance(value, Mapping):
        if set(value) == {"points"} and isinstance(value["points"], Sequence):
            return PiecewiseLinear(
                tuple(tuple(p) if isinstance(p, Sequence) else (p,) for p in value["points"])
            )
        if set(value) <= {"c2", "c1", "c0"}:
            return Polynomial(**value)
    if form == "bus" and isinstance(value, int) and not isinstance(value, bool):
        return str(value)
    if form == "span" and isinstance(value, Sequence) and not isinstance(value, str):
        return tuple(value)
    return value


@dataclass(frozen=True)
class Bus(Component):
    """A node of the grid.

    Parameters
    ----------
    vm
        ``(min, max)`` of the voltage magnitude, p.u.
    base_kv
        Nominal voltage, kV; kept for network files.
    reference
        Whether its angle is the zero of its island.
    """

    kind: ClassVar[str] = "bus"
    plural: ClassVar[str] = "buses"

    vm: tuple[float, float] = span("p.u.", (0.9, 1.1), at_least=0.0)
    base_kv: float | None = number("kV", None, above=0.0, optional=True, series=False)
    reference: bool = flag(False)
    in_service: bool = flag(True)


@dataclass(frozen=True)
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
        Limit of the apparent power at both ends, MVA; None for no limit.
    tap, shift
        Transformer ratio, from 0.001 to 1000, and phase shift in degrees.
    angle
        ``(min, max)`` of the angle difference from - to, degrees; beyond ±360 there is no limit.
    g_from, b_from, g_to, b_to
        Further shunt admittance at one end, p.u.
    """

    kind: ClassVar[str] = "branch"
    plural: ClassVar[str] = "branches"

    from_bus: str = at_bus()
    to_bus: str = at_bus()
    r: float = number("p.u.", series=False)
    x: float = number("p.u.", series=False)
    b: float = number("p.u.", 0.0, series=False)
    g: float = number("p.u.", 0.0, series=False)
    rating: float | None = number("MVA", None, at_least=0.0, optional=True, finite=False)
    tap: float = number("", 1.0, at_least=1e-3, at_most=1e3, series=False)
    shift: float = number("deg", 0.0, series=False)
    angle: tuple[float, float] = span("deg", (-360.0, 360.0), series=False)
    g_from: float = number("p.u.", 0.0, series=False)
    b_from: float = number("p.u.", 0.0, series=False)
    g_to: float = number("p.u.", 0.0, series=False)
    b_to: float = number("p.u.", 0.0, series=False)
    in_service: bool = flag(True)

    def check(self, name: str) -> None:
        """Raise :class:`ComponentError` if a field breaks its rule or the impedance is next to zero."""
        super().check(name)
        if math.hypot(self.r, self.x) < _LEAST_IMPEDANCE:
            raise ComponentError(
                name,
                "r, x",
                (self.r, self.x),
                f"the impedance must not be zero, but at least {_LEAST_IMPEDANCE:g} p.u.; "
                "merge the two buses instead",
            )
        if self.from_bus == self.to_bus:
            raise ComponentError(name, "to_bus", self.to_bus, "must differ from from_bus")


@dataclass(frozen=True)
class Generator(Component):
    """A unit that injects power at a bus.

    Parameters
    ----------
    bus
        Name of its bus.
    p, q
        ``(min, max)`` of active and reactive power, MW and MVAr; no limit on q by default.
    ramp
        Largest change of active power, MW/h; None for no limit.
    cost
        :class:`Polynomial` or :class:`PiecewiseLinear`.
    """

    kind: ClassVar[str] = "generator"
    plural: ClassVar[str] = "generators"

    bus: str = at_bus()
    p: tuple[float, float] = span("MW")
    q: tuple[float, float] = span("MVAr", (-INF, INF))
    ramp: float | None = number("MW/h", None, at_least=0.0, optional=True, finite=False)
    cost: Cost = field(default=Polynomial(), metadata={"form": "cost", "unit": ""})
    in_service: bool = flag(True)


@dataclass(frozen=True)
class Storage(Component):
    """A battery or another store; positive power charges it.

    Parameters
    ----------
    bus
        Name of its bus.
    energy
        Capacity, MWh.
    power
        ``(min, max)`` of the charging power, MW; one number ``a`` stands for ``(-a, a)``.
    q
        ``(min, max)`` of the reactive power drawn, MVAr.
    initial
        Energy at the start, MWh; None is midway between the least energy and the capacity.
    energy_min
        Least energy, MWh.
    charge_efficiency, discharge_efficiency
        From 0.001 to 1.
    standing_loss
        Fraction of the energy lost per hour.
    rating
        Limit of the apparent power, MVA; None for no limit.
    exclusive
        Forbid charging and discharging at once, which matters only with losses and negative
        prices. It makes the problem non-convex, so that only a nonlinear solver accepts it.
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
    in_service: bool = flag(True)

    def check(self, name: str) -> None:
        """Raise :class:`ComponentError` if a field breaks its rule or the energies are out of order."""
        super().check(name)
        if self.energy_min > self.energy:
            raise ComponentError(
                name, "energy_min", self.energy_min, f"must be at most the capacity, energy = {self.energy:g}"
            )
        if self.initial is not None and not self.energy_min <= self.initial <= self.energy:
            raise ComponentError(
                name,
                "initial",
                self.initial,
                f"must lie between energy_min = {self.energy_min:g} and energy = {self.energy:g}",
            )

    def resolved(self) -> Storage:
        """The storage with its initial energy filled in."""
        return (
            self if self.initial is not None else replace(self, initial=0.5 * (self.energy_min + self.energy))
        )


@dataclass(frozen=True)
class Load(Component):
    """A demand at a bus; negative values feed in.

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


@dataclass(frozen=True)
class Shunt(Component):
    """A shunt at a bus: draws ``g vm²`` active and injects ``b vm²`` reactive power.

    Parameters
    ----------
    bus
        Name of its bus.
    g, b
        Power at 1 p.u. voltage, MW and MVAr.
    """

    kind: ClassVar[str] = "shunt"
    plural: ClassVar[str] = "shunts"

    bus: str = at_bus()
    g: float = number("MW", 0.0, series=False)
    b: float = number("MVAr", 0.0, series=False)
    in_service: bool = flag(True)


BUILT_IN: tuple[type[Component], ...] = (Bus, Branch, Generator, Storage, Load, Shunt)
"""The kinds of this package; devices of others bring their own."""


# The network ------------------------------------------------------------------------------------


class Network:
    """Named components on a common power base.

    Parameters
    ----------
    name
        Name of the network.
    base_mva
        Power base of all per-unit quantities, from 1e-6 to 1e9 MVA.

    Examples
    --------
    ``grid.north = Bus()`` and ``grid.add("north", Bus())`` are the same;
    ``grid["north"]`` and ``grid.north`` read it back.
    """

    name: str
    base_mva: float
    _components: dict[str, Component]

    def __init__(self, name: str = "network", base_mva: float = 100.0) -> None:
        least, most = BASE_MVA
        if not _is_number(base_mva) or not least <= base_mva <= most:
            raise NetworkError(
                f"network {name!r}: base_mva = {base_mva!r}: must be a number from {least:g} to {most:g} MVA"
            )
        if fault := name_fault(str(name)):
            raise NetworkError(f"network {name!r}: the name {fault}")
        object.__setattr__(self, "name", str(name))
        object.__setattr__(self, "base_mva", float(base_mva))
        object.__setattr__(self, "_components", {})

    def add(self, name: str, component: Component) -> Component:
        """Declare a component under a name.

        Raises
        ------
        NetworkError
            The name is taken, or has characters that cannot be seen.
        ComponentError
            A field of the component breaks its rule.
        """
        if not isinstance(component, Component):
            raise NetworkError(
                f"network {self.name!r}: {name} = {component!r} is not a component (Bus, Branch, ...)"
            )
        name = str(name)
        if name in self._components:
            raise NetworkError(
                f"network {self.name!r}: the name {name!r} is taken by a {self._components[name].kind}; "
                "names must be unique"
            )
        if fault := name_fault(name):
            raise NetworkError(f"network {self.name!r}: the name {name!r} {fault}")
        component.check(name)
        self._components[name] = component
        return component

    def update(self, name: str, /, **changes: Any) -> Component:
        """Replace fields of a declared component: ``grid.update("coal", ramp=30)``."""
        old = self[name]
        for key, value in changes.items():
            if key not in old.fields():
                raise ComponentError(
                    name, key, value, f"unknown field of a {old.kind}; {nearest(key, old.fields())}"
                )
        new = replace(old, **{k: _plain(old.fields()[k], v) for k, v in changes.items()})  # type: ignore[type-var]
        new.check(name)
        self._components[name] = new
        return new

    def remove(self, name: str) -> Component:
        """Take a component out of the network."""
        component = self[name]
        del self._components[name]
        return component

    def of(self, kind: type[C]) -> dict[str, C]:
        """All components of a class, by name, in the order of their declaration."""
        return {n: c for n, c in self._components.items() if isinstance(c, kind)}

    def kinds(self) -> list[type[Component]]:
        """Classes of which there are components, in the order of their first declaration."""
        return list(dict.fromkeys(type(c) for c in self._components.values()))

    def copy(self) -> Network:
        """A network with the same components, to be changed independently."""
        twin = Network(self.name, self.base_mva)
        twin._components.update(self._components)
        return twin

    def __getitem__(self, name: str) -> Component:
        try:
            return self._components[str(name)]
        except KeyError:
            raise NetworkError(
                f"network {self.name!r} has no component {name!r}; {nearest(str(name), self._components)}"
            ) from None

    def __contains__(self, name: object) -> bool:
        return name in self._components

    def __iter__(self) -> Iterator[str]:
        return iter(self._components)

    def __len__(self) -> int:
        return len(self._components)

    def __getattr__(self, name: str) -> Component:
        if name.startswith("_"):
            raise AttributeError(name)
        try:
            return self[name]
        except NetworkError as error:
            raise AttributeError(str(error)) from None

    def __setattr__(self, name: str, value: Any) -> None:
        if hasattr(type(self), name) or name in ("name", "base_mva"):
            raise NetworkError(
                f"network {self.name!r}: {name!r} is a word of Network itself; use add({name!r}, ...) "
                "or another name"
            )
        self.add(name, value)

    def __delattr__(self, name: str) -> None:
        self.remove(name)

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._components]

    def __repr__(self) -> str:
        counts = []
        for kind in self.kinds():
            n = len(self.of(kind))
            counts.append(f"{n} {kind.kind if n == 1 else kind.plural}")
        return f"Network({self.name!r}: {', '.join(counts) or 'empty'})"


def name_pattern(name: str) -> re.Pattern[str]:
    """The names that a name with stars stands for: ``gas*`` is every name that begins with ``gas``."""
    return re.compile("".join(".*" if c == "*" else re.escape(c) for c in name))
