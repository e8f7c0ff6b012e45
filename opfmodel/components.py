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
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields, replace
from functools import cache
from itertools import pairwise
from typing import Any, ClassVar, NamedTuple, Self, TypeGuard, TypeVar

import numpy as np

from opfmodel.errors import ComponentError, NetworkError, ProfileError, name_fault, nearest
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
    "TableField",
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
# Made once: they are asked for some ten times for every component of a network file.
_NUMBERS = (float, int, np.integer, np.floating)
_FLAGS = (bool, np.bool_)


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, _NUMBERS) and not isinstance(value, bool)


def _type_of_number(name: str, key: str, value: object, rules: Mapping[str, Any]) -> None:
    if not (_is_number(value) or (value is None and rules["optional"])):
        raise ComponentError(name, key, value, f"must be a number in {_unit(rules)}")


def _rules_of_number(name: str, key: str, value: Any, rules: Mapping[str, Any]) -> None:
    if value is None:
        return
    if not bounded(value) and (rules["finite"] or abs(value) != INF):
        raise ComponentError(name, key, value, _FINITE)
    if value < rules["at_least"]:
        raise ComponentError(name, key, value, f"must be at least {rules['at_least']:g}")
    if value <= rules["above"]:
        raise ComponentError(name, key, value, f"must be greater than {rules['above']:g}")
    if value > rules["at_most"]:
        raise ComponentError(name, key, value, f"must be at most {rules['at_most']:g}")


def _type_of_span(name: str, key: str, value: object, rules: Mapping[str, Any]) -> None:
    if rules["symmetric"] and _is_number(value):
        return
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != 2:
        raise ComponentError(name, key, value, f"must be a pair (min, max) in {_unit(rules)}")
    if not all(_is_number(end) for end in value):
        raise ComponentError(name, key, value, f"both ends must be numbers in {_unit(rules)}")


def _rules_of_span(name: str, key: str, value: Any, rules: Mapping[str, Any]) -> None:
    if _is_number(value):
        if not (bounded(value) or abs(value) == INF):
            raise ComponentError(name, key, value, _FINITE)
        if value < 0:
            raise ComponentError(
                name, key, value, "a single number stands for (-a, a); it must be at least 0"
            )
        return
    low, high = value
    if not all(bounded(end) or abs(end) == INF for end in (low, high)):
        rule = f"both ends must be numbers in {_unit(rules)} of at most {LARGEST:g}, or infinite"
        raise ComponentError(name, key, value, rule)
    if low > high:
        raise ComponentError(name, key, value, f"the minimum {low:g} is above the maximum {high:g}")
    if low == INF or high == -INF:
        raise ComponentError(
            name, key, value, "the minimum must be below infinity, the maximum above -infinity"
        )
    if low < rules["at_least"]:
        raise ComponentError(name, key, value, f"the minimum must be at least {rules['at_least']:g}")


def _type_of_flag(name: str, key: str, value: object, _: Mapping[str, Any]) -> None:
    if not isinstance(value, _FLAGS):
        raise ComponentError(name, key, value, "must be true or false")


def _type_of_bus(name: str, key: str, value: object, _: Mapping[str, Any]) -> None:
    if not (isinstance(value, str) and value):
        raise ComponentError(name, key, value, "must be the name of a bus")


def _type_of_cost(name: str, key: str, value: object, _: Mapping[str, Any]) -> None:
    if not isinstance(value, Cost):
        raise ComponentError(
            name,
            key,
            value,
            "must be a Polynomial or PiecewiseLinear; in a file {c2: , c1: , c0: } in $/MW²h, "
            "$/MWh, $/h or {points: [[MW, $/h], ...]}",
        )
    value.check_types(name, key)


def _rules_of_cost(name: str, key: str, value: Cost, _: Mapping[str, Any]) -> None:
    value.check(name, key)


_Check = Callable[[str, str, Any, Mapping[str, Any]], None]
_TYPES: Mapping[str, _Check] = {
    "number": _type_of_number,
    "span": _type_of_span,
    "flag": _type_of_flag,
    "bus": _type_of_bus,
    "cost": _type_of_cost,
}
_RULES: Mapping[str, _Check] = {
    "number": _rules_of_number,
    "span": _rules_of_span,
    "cost": _rules_of_cost,
}


def _unit(rules: Mapping[str, Any]) -> str:
    return str(rules["unit"]) or "plain numbers"


# Costs ------------------------------------------------------------------------------------------


class Cost:
    """Cost of producing active power, in $/h; convex."""

    def check_types(self, name: str, key: str) -> None:
        """Raise :class:`ComponentError` if this does not consist of numbers."""
        raise NotImplementedError

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

    def check_types(self, name: str, key: str) -> None:
        """Raise :class:`ComponentError` unless the coefficients are numbers."""
        if not all(_is_number(c) for c in (self.c2, self.c1, self.c0)):
            raise ComponentError(name, key, self, "the coefficients must be finite numbers")

    def check(self, name: str, key: str) -> None:
        """Raise :class:`ComponentError` unless the coefficients are finite and ``c2 >= 0``."""
        if not all(map(bounded, (self.c2, self.c1, self.c0))):
            rule = f"the coefficients must be finite numbers of at most {LARGEST:g}"
            raise ComponentError(name, key, self, rule)
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

    def check_types(self, name: str, key: str) -> None:
        """Raise :class:`ComponentError` unless every point is a pair of numbers."""
        if any(len(point) != 2 for point in self.points):
            raise ComponentError(name, key, self, "needs at least two points (MW, $/h)")
        if not all(_is_number(v) for point in self.points for v in point):
            raise ComponentError(name, key, self, "the points must be finite numbers")

    def check(self, name: str, key: str) -> None:
        """Raise :class:`ComponentError` unless there are two points, in order, and the cost is convex."""
        if len(self.points) < 2:
            raise ComponentError(name, key, self, "needs at least two points (MW, $/h)")
        if not all(bounded(v) for point in self.points for v in point):
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


class TableField(NamedTuple):
    """A quantity that the arrays of a kind of component have.

    Attributes
    ----------
    form, unit
        Form and unit of the field that it comes from.
    series
        Whether it may have a time series.
    """

    form: str
    unit: str
    series: bool


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

    def check_types(self, name: str) -> None:
        """Raise :class:`ComponentError` unless every field is of its type.

        A number is a number (NaN and infinity too), or None where the field is optional; a span is a
        pair of numbers, a flag true or false, a bus the name of one, a cost a :class:`Cost` made of
        numbers. So much holds whether the component is in service or not: it is what arrays, files
        and later changes of the component are made of.
        """
        for key, metadata, check_type, _ in self._checks():
            if check_type is not None:
                check_type(name, key, getattr(self, key), metadata)

    def check(self, name: str) -> None:
        """Raise :class:`ComponentError` unless all holds that a component in service must keep.

        The types, and the rules of each field. Subclasses add rules of their own, after the call of
        this method.
        """
        self.check_types(name)
        for key, metadata, _, check_rules in self._checks():
            if check_rules is not None:
                check_rules(name, key, getattr(self, key), metadata)

    def check_declared(self, name: str) -> None:
        """Raise :class:`ComponentError` unless a network can hold the component as it is.

        In service it must keep every rule (:meth:`check`). Out of service its types alone must be
        right (:meth:`check_types`): nothing is computed from it, and data of units long gone, such
        as a minimum above the maximum, are kept as they are until it is put in service.
        """
        if isinstance(self.in_service, _FLAGS) and not self.in_service:
            self.check_types(name)
        else:
            self.check(name)

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
    def _checks(cls) -> tuple[tuple[str, Mapping[str, Any], _Check | None, _Check | None], ...]:
        """Key, metadata and checks of each field, of its type and of its rules."""
        forms = [(key, item.metadata, item.metadata["form"]) for key, item in cls.fields().items()]
        return tuple((key, metadata, _TYPES.get(form), _RULES.get(form)) for key, metadata, form in forms)

    @classmethod
    @cache
    def table_fields(cls) -> Mapping[str, TableField]:
        """The quantities that arrays of the kind have, by name: ``p_min`` and ``p_max`` of a span ``p``.

        Examples
        --------
        >>> list(Generator.table_fields())
        ['p_min', 'p_max', 'q_min', 'q_max', 'ramp', 'c2', 'c1', 'c0']
        """
        made = {}
        for name, item in cls.fields().items():
            form, unit = item.metadata["form"], item.metadata["unit"]
            series = item.metadata.get("series", True)
            if form == "number":
                made[name] = TableField(form, unit, series)
            elif form == "span":
                made |= dict.fromkeys((f"{name}_min", f"{name}_max"), TableField(form, unit, series))
            elif form == "cost":
                units = {"c2": "$/MW^2h", "c1": "$/MWh", "c0": "$/h"}
                made |= {coefficient: TableField(form, u, series) for coefficient, u in units.items()}
        return made

    def constant(self, field: str) -> float:
        """Value of a quantity of the arrays (``p``, ``p_max``, ``c1``) as the component declares it.

        Raises
        ------
        ProfileError
            The component has no such number; of a range the message names the two ends.
        """
        component, known = self.resolved(), self.fields()
        stem, _, end = field.rpartition("_")
        of = self.table_fields().get(field)
        if of is not None and of.form == "number":
            value = getattr(component, field)
            return INF if value is None else float(value)  # None is "no limit"
        if of is not None and of.form == "span":
            pair = getattr(component, stem)
            return float(pair[end == "max"] if isinstance(pair, tuple) else (pair if end == "max" else -pair))
        if of is not None:
            (cost,) = (
                getattr(component, name) for name, item in known.items() if item.metadata["form"] == "cost"
            )
            if hasattr(cost, field):
                return float(getattr(cost, field))
        span = field in known and known[field].metadata["form"] == "span"
        ends = f"; it has {field}_min and {field}_max" if span else ""
        raise ProfileError(f"a {self.kind} has no number {field!r}{ends}")

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
            An unknown field, a missing field or, see :meth:`check_declared`, a value that breaks its
            rule.
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
        component.check_declared(name)
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
        Power base of the impedances and admittances of its branches, from 1e-6 to 1e9 MVA. No result depends
        on it: inside, everything is per unit on :attr:`scale_mva`.

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

    @property
    def capacity_mva(self) -> float:
        """The largest of what generators, loads and storages can exchange, MW; 0 if nothing is limited."""
        generators, storages = self.of(Generator).values(), self.of(Storage).values()
        sums = (
            sum(abs(g.p[1]) for g in generators if g.in_service and abs(g.p[1]) < INF),
            sum(abs(load.p) for load in self.of(Load).values() if load.in_service),
            sum(s.power[1] if isinstance(s.power, tuple) else s.power for s in storages if s.in_service),
        )
        return float(max(sums))

    @property
    def scale_mva(self) -> float:
        """Power base on which the quantities of the system are of the order of one, MVA.

        100 MVA, or for a smaller system the power of ten at or below its capacity. It does not depend on
        ``base_mva``, so that neither do results.
        """
        capacity = self.capacity_mva
        return min(100.0, 10.0 ** math.floor(math.log10(capacity))) if capacity > 0 else 100.0

    def add(self, name: str, component: Component) -> Component:
        """Declare a component under a name.

        Raises
        ------
        NetworkError
            The name is taken, or has characters that cannot be seen.
        ComponentError
            A field of the component breaks its rule; of a component out of service only the types
            of fields are checked, see :meth:`Component.check_declared`.
        """
        if not isinstance(component, Component):
            raise NetworkError(
                f"network {self.name!r}: {name} = {component!r} is not a component (Bus, Branch, ...)"
            )
        name = str(name)
        if fault := name_fault(name):
            raise NetworkError(f"network {self.name!r}: the name {name!r} {fault}")
        if name in self._components:
            raise NetworkError(
                f"network {self.name!r}: the name {name!r} is taken by a {self._components[name].kind}; "
                "names must be unique"
            )
        component.check_declared(name)
        self._components[name] = component
        return component

    def update(self, name: str, /, **changes: Any) -> Component:
        """Replace fields of a declared component: ``grid.update("coal", ramp=30)``.

        Rules are checked as by :meth:`add`, so that a component put in service,
        ``grid.update("coal", in_service=True)``, must keep all of them from then on.
        """
        old = self[name]
        for key, value in changes.items():
            if key not in old.fields():
                raise ComponentError(
                    name, key, value, f"unknown field of a {old.kind}; {nearest(key, old.fields())}"
                )
        new = replace(old, **{k: _plain(old.fields()[k], v) for k, v in changes.items()})  # type: ignore[type-var]
        new.check_declared(name)
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
