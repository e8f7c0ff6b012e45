"""Per-unit arrays of a network, the only place where declarations are converted to arrays.

:func:`per_unit` removes components out of service, finds islands, selects one reference bus for each,
and lays out each kind of component as a :class:`Table` of arrays.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from opfmodel.errors import ComponentError, NetworkError, listed, nearest, raise_all
from opfmodel.network.component import Component
from opfmodel.network.components import BUILT_IN, Branch, Bus, Connection, Generator
from opfmodel.network.costs import Cost, PiecewiseLinear, Polynomial
from opfmodel.network.fields import is_adjustable
from opfmodel.network.islands import connected
from opfmodel.network.network import Network
from opfmodel.network.physics import Admittance, branch_admittance
from opfmodel.network.polygon import half_planes
from opfmodel.network.quantities import CURRENCY
from opfmodel.network.units import scale

__all__ = ["OUTAGES", "Array", "Index", "PerUnitNetwork", "Table", "per_unit"]

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]


# Kinds whose components may go out while the network is operated.
OUTAGES = tuple(kind for kind in BUILT_IN if kind.lost)
# Plausible capacity in per unit on the declared base, from single households on 100 MVA to continents.
_SMALLEST, _LARGEST = 1e-5, 1e4
_PLAUSIBLE_VM = 0.1, 10.0  # p.u.


@dataclass(frozen=True, eq=False)
class Table:
    """All components of one kind as per-unit arrays, which are available as attributes.

    A quantity has shape ``(items, 1)``, or ``(items, stages)`` with a time series. A span field ``p``
    gives ``p_min`` and ``p_max``. A cost gives ``c2``, ``c1``, ``c0`` and, if piecewise linear, one row
    per segment in ``segment_slope``, ``segment_offset`` and ``segment_begin``. Bus positions (``bus``), the
    positions of the owners of segments (``segment_owner``), flags and choices are vectors; see
    :func:`opfmodel.network.fields.points` for those of a polygon. The ``status`` of a component that may go
    out is 1 in service and 0 while it is out.

    Attributes
    ----------
    names
        Names of the components.
    units
        Physical unit of each declared quantity.
    """

    kind: type[Component]
    names: tuple[str, ...]
    arrays: Mapping[str, npt.NDArray[Any]]
    units: Mapping[str, str]
    base_mva: float

    def __len__(self) -> int:
        return len(self.names)

    def __getattr__(self, name: str) -> Any:
        arrays = object.__getattribute__(self, "arrays")
        if name in arrays:
            return arrays[name]
        raise AttributeError(f"{self.kind.plural} have no field {name!r}; {nearest(name, arrays)}")

    @cached_property
    def position(self) -> dict[str, int]:
        """Position of each component by name."""
        return {name: i for i, name in enumerate(self.names)}

    def with_series(self, series: Mapping[str, Array]) -> Table:
        """Return the table with fields replaced by per-unit time series of shape ``(items, stages)``."""
        return replace(self, arrays={**self.arrays, **series}) if series else self


@dataclass(frozen=True, eq=False)
class PerUnitNetwork:
    """A network as per-unit arrays.

    Attributes
    ----------
    base_mva
        Base of the arrays: :attr:`Network.scale_mva <opfmodel.network.Network.scale_mva>`.
    declared_mva
        Base on which the network declares its impedances.
    tables
        One table per kind of component, including built-in kinds without components.
    island
        Index of the island of each bus.
    reference
        Position of the reference bus of each island.
    notes
        Messages about removed components, selected reference buses, and components out of service
        with invalid data.
    left_out
        Names of the components that are out of service or connected to a bus out of service.
    currency
        Name of the currency of all costs and prices.
    """

    name: str
    base_mva: float
    declared_mva: float
    tables: Mapping[str, Table]
    island: Index
    reference: Index
    notes: tuple[str, ...]
    left_out: tuple[str, ...] = ()
    currency: str = CURRENCY

    @property
    def bus(self) -> Table:
        """Buses."""
        return self.tables["bus"]

    @property
    def branch(self) -> Table:
        """Branches."""
        return self.tables["branch"]

    @property
    def generator(self) -> Table:
        """Generators."""
        return self.tables["generator"]

    @property
    def storage(self) -> Table:
        """Storages."""
        return self.tables["storage"]

    @property
    def load(self) -> Table:
        """Loads."""
        return self.tables["load"]

    @property
    def shunt(self) -> Table:
        """Shunts."""
        return self.tables["shunt"]

    @property
    def renewable(self) -> Table:
        """Renewables."""
        return self.tables["renewable"]

    @property
    def n_components(self) -> int:
        """Number of components of all kinds."""
        return sum(map(len, self.tables.values()))

    @property
    def rebased(self) -> float:
        """One internal unit of power, in per unit on the declared base; converts declared weights."""
        return self.base_mva / self.declared_mva

    @property
    def n_islands(self) -> int:
        """Number of islands."""
        return len(self.reference)

    @cached_property
    def admittance(self) -> Admittance:
        """Two-port admittances of all branches."""
        return self.admittance_at(self.branch.tap, self.branch.shift)

    def admittance_at(self, tap: Array, shift: Array) -> Admittance:
        """Two-port admittances of all branches at other ratios and phase shifts of their transformers."""
        t = self.branch
        half_g, half_b = t.g / 2, t.b / 2
        ends = half_g + t.g_from, half_b + t.b_from, half_g + t.g_to, half_b + t.b_to
        return branch_admittance(t.r, t.x, *ends, tap, shift)

    @cached_property
    def resting_angle(self) -> Array:
        r"""Voltage angles without flow, radians, shape ``(buses, 1)``: a first guess for solvers.

        Phase shifts of 30 degrees and more, as of most transformers, are too far from zero for a guess.
        With :math:`w = 1/|r + jx|`, the angles minimise :math:`\sum w (\theta_f - \theta_t - \phi)^2`, zero
        at the reference buses; they are exact where the shifts around every loop cancel.
        """
        branch, n = self.branch, len(self.bus)
        angle = np.zeros((n, 1))
        if not branch.shift.any():
            return angle
        from scipy.sparse.linalg import spsolve  # a large module, for phase shifters alone

        weight = 1.0 / np.hypot(branch.r, branch.x)[:, 0]
        ends = np.concatenate([branch.from_bus, branch.to_bus])
        incidence = sp.csr_matrix(
            (np.repeat([1.0, -1.0], len(branch)), (ends, np.tile(np.arange(len(branch)), 2))),
            shape=(n, len(branch)),
        )
        free = np.setdiff1d(np.arange(n), self.reference)
        matrix = (incidence @ sp.diags(weight) @ incidence.T)[free][:, free]
        angle[free, 0] = spsolve(matrix.tocsc(), (incidence @ (weight * branch.shift[:, 0]))[free])
        return angle

    def at_buses(self, kind: str, values: Array) -> Array:
        """Sum the values of one kind of component at each bus: ``(items, ...) -> (buses, ...)``."""
        out = np.zeros((len(self.bus), *values.shape[1:]))
        np.add.at(out, self.tables[kind].bus, values)
        return out

    def with_series(self, series: Mapping[tuple[str, str], Array]) -> PerUnitNetwork:
        """Return the network with constant fields replaced by time series, by ``(kind, field)``."""
        tables = dict(self.tables)
        for kind in {k for k, _ in series}:
            tables[kind] = tables[kind].with_series({f: a for (k, f), a in series.items() if k == kind})
        return replace(self, tables=tables)

    def over(self, stages: slice) -> PerUnitNetwork:
        """Return the network with some stages of its time series."""
        return self.with_series(
            {
                (kind, field): values[:, stages]
                for kind, table in self.tables.items()
                for field, values in table.arrays.items()
                if values.ndim == 2 and values.shape[1] > 1
            }
        )


def per_unit(network: Network) -> PerUnitNetwork:
    """Lay out a network as read-only per-unit arrays, cached until the network changes.

    Raises
    ------
    ComponentError
        A component refers to a bus that does not exist.
    NetworkError
        No bus is in service.
    """
    return network.derived(_lay_out)


def _lay_out(network: Network) -> PerUnitNetwork:
    notes: list[str] = []
    raise_all(chain(_errors_of_buses(network), _errors_of_weights(network)))
    every_bus = network.of(Bus)
    buses = {name: bus for name, bus in every_bus.items() if bus.in_service}
    kept = {
        name: component
        for name, component in ((n, network[n]) for n in network)
        if component.in_service and all(bus in buses for bus in component.buses)
    }
    dropped = [n for n in network if n not in kept and n not in every_bus]
    if dropped:
        notes.append(f"out of service, left out: {listed(map(repr, dropped))}")
    notes.extend(_broken_rules(network))
    occupied = {bus for c in kept.values() if not isinstance(c, Bus) for bus in c.buses}
    isolated = [b for b in buses if b not in occupied and len(buses) > 1]
    if isolated:
        notes.append(f"isolated buses with nothing connected, left out: {listed(map(repr, isolated))}")
    lonely = set(isolated)
    kept = {n: c for n, c in kept.items() if n not in lonely}
    names = [b for b in buses if b not in lonely]
    if not names:
        raise NetworkError(f"network {network.name!r} has no bus in service")
    base_mva = network.scale_mva
    notes += [*_absurd_base(network), *_absurd_voltages({b: buses[b] for b in names})]
    kinds = dict.fromkeys((*BUILT_IN, *network.kinds()))
    position = {b: i for i, b in enumerate(names)}
    tables = {
        kind.kind: _table(
            kind, {n: c for n, c in kept.items() if type(c) is kind}, position, base_mva, network.base_mva
        )
        for kind in kinds
    }
    tables = {name: _with_weights(table, tables, kept) for name, table in tables.items()}
    pairs = (c.buses for c in kept.values() if isinstance(c, Branch))
    islands = [sorted(island, key=position.__getitem__) for island in connected(names, pairs)]
    if len(islands) > 1:
        notes.append(f"{len(islands)} islands, each with its own reference bus")
    island = np.zeros(len(names), dtype=np.intp)
    reference = np.zeros(len(islands), dtype=np.intp)
    for number, members in enumerate(islands):
        island[[position[b] for b in members]] = number
        chosen, note = _reference(members, buses, kept)
        reference[number] = position[chosen]
        if note:
            notes.append(note)
    left_out = tuple(name for name in network if name not in kept)
    return PerUnitNetwork(
        network.name,
        base_mva,
        network.base_mva,
        tables,
        island,
        reference,
        tuple(notes),
        left_out,
        network.currency,
    )


def _absurd_base(network: Network) -> list[str]:
    """Note a base of the impedances that is implausible for the size of the system."""
    size = network.capacity_mva / network.base_mva
    if not size or _SMALLEST <= size <= _LARGEST:
        return []
    return [
        f"base_mva = {network.base_mva:g} for a system of {network.capacity_mva:g} MW: "
        "are the impedances of its branches per unit on that base?"
    ]


def _absurd_voltages(buses: Mapping[str, Bus]) -> list[str]:
    """Note voltage limits that are implausible in p.u., as those in kV are."""
    least, most = _PLAUSIBLE_VM
    absurd = [b for b, bus in buses.items() if bus.vm[1] < least or bus.vm[0] > most]
    if not absurd:
        return []
    low, high = buses[absurd[0]].vm
    return [
        f"vm = ({low:g}, {high:g}) at {listed(map(repr, absurd))}: are these limits per unit on the "
        "nominal voltage of the bus?"
    ]


def _broken_rules(network: Network) -> Iterator[str]:
    """Note components out of service whose data break a rule."""
    broken: dict[str, ComponentError] = {}
    for name in network:
        if not network[name].in_service:
            try:
                network[name].check(name)
            except ComponentError as error:
                broken[name] = error
    if broken:
        first = next(iter(broken.values()))
        yield f"out of service, with invalid data: {listed(map(repr, broken))}; {first}"


def _errors_of_buses(network: Network) -> Iterator[ComponentError]:
    """Yield an error for every field that names no bus."""
    known = network.of(Bus)
    for name in network:
        component = network[name]
        for key, bus in zip(component.bus_fields(), component.buses, strict=True):
            if bus not in known:
                yield ComponentError(name, key, bus, f"no such bus; {nearest(bus, known)}")


def _errors_of_weights(network: Network) -> Iterator[ComponentError]:
    """Yield an error for every name in a field of weights that is not of its kinds, or has no such number."""
    for name in network:
        component = network[name]
        for key, of in component.weight_fields().items():
            known = [other for other in network if network[other].kind in of]
            for member, weight in getattr(component, key).items():
                if member not in known:
                    kinds = " or ".join(filter(None, (", ".join(of[:-1]), of[-1])))
                    rule = f"no {kinds} has this name; {nearest(member, known)}"
                    yield ComponentError(name, f"{key}.{member}", weight, rule)
                elif weight < 0 and network[member].kind in component.fields()[key].metadata["positive"]:
                    rule = f"must be at least 0 for a {network[member].kind}"
                    yield ComponentError(name, f"{key}.{member}", weight, rule)


def _reference(
    members: list[str], buses: Mapping[str, Bus], kept: Mapping[str, Component]
) -> tuple[str, str]:
    """Select the reference bus of an island, with a note unless exactly one is declared."""
    declared = [b for b in members if buses[b].reference]
    if len(declared) == 1:
        return declared[0], ""
    if declared:
        return declared[0], f"several reference buses in one island; {declared[0]!r} is used"
    capacity = dict.fromkeys(members, -np.inf)
    for component in kept.values():
        if isinstance(component, Generator | Connection) and component.bus in capacity:
            capacity[component.bus] = max(capacity[component.bus], component.p[1])
    chosen = max(members, key=lambda b: capacity[b])
    return chosen, f"no reference bus declared in the island of {members[0]!r}; {chosen!r} is used"


def _table(
    kind: type[Component],
    members: Mapping[str, Component],
    buses: Mapping[str, int],
    base_mva: float,
    declared_mva: float,
) -> Table:
    arrays: dict[str, npt.NDArray[Any]] = {}
    units: dict[str, str] = {}
    resolved = [member.resolved() for member in members.values()]
    for key, item in kind.fields().items():
        form, unit = item.metadata["form"], item.metadata["unit"]
        values = [getattr(m, key) for m in resolved]
        factor = scale(unit, base_mva, declared_mva)
        if form == "number":
            plain = [np.inf if v is None else v for v in values]
            arrays[key] = _column(plain) / factor
        elif form == "span":
            pairs = [v if isinstance(v, tuple | list) else (-v, v) for v in values]
            ends = np.array(pairs, dtype=float).reshape(-1, 2) / factor
            arrays[f"{key}_min"], arrays[f"{key}_max"] = ends[:, :1].copy(), ends[:, 1:].copy()
        elif form == "adjustable":
            ends = np.array([v if is_adjustable(v) else (v, v) for v in values], dtype=float).reshape(-1, 2)
            arrays[key] = _column([m.neutral(key) for m in resolved]) / factor
            arrays[f"{key}_min"], arrays[f"{key}_max"] = ends[:, :1] / factor, ends[:, 1:] / factor
        elif form in ("flag", "choice"):
            arrays[key] = np.array(values, dtype=bool if form == "flag" else str)
        elif form == "bus":
            arrays[key] = np.array([buses[v] for v in values], dtype=np.intp)
        elif form == "cost":
            arrays |= _cost_arrays(values, base_mva)
        elif form == "points":
            arrays |= _polygon_arrays(key, values, factor)
            units |= {f"{key}_{part}": unit for part in ("limit", "p_min", "p_max", "q_min", "q_max")}
    arrays |= {name: np.full((len(members), 1), known.loosest) for name, known in kind.clocked.items()}
    if kind.lost:
        arrays["status"] = np.ones((len(members), 1))
    governed = {name for names in kind.governs.values() for name in names}
    arrays |= {name: np.zeros((len(members), 1)) for name in sorted(governed - arrays.keys())}
    for array in arrays.values():
        array.flags.writeable = False
    units |= {name: field.unit for name, field in kind.table_fields().items()}
    if "segment_slope" in arrays:
        units |= {"segment_slope": "$/MWh", "segment_offset": "$/h", "segment_begin": "MW"}
    if "status" in arrays:
        units |= {"status": ""}
    units |= dict.fromkeys(arrays.keys() & governed - units.keys(), "")
    return Table(kind, tuple(members), arrays, units, base_mva)


def _with_weights(table: Table, tables: Mapping[str, Table], kept: Mapping[str, Component]) -> Table:
    """Return a table with the numbers that its components state for others; see :func:`weights`."""
    made: dict[str, npt.NDArray[Any]] = {}
    units: dict[str, str] = {}
    for key, of in table.kind.weight_fields().items():
        unit = table.kind.fields()[key].metadata["unit"]
        stated = [(i, getattr(kept[name], key)) for i, name in enumerate(table.names)]
        made[f"{key}_stated"] = np.array([bool(own) for _, own in stated], dtype=bool)
        for other in of:
            position = tables[other].position if other in tables else {}
            entries = [(i, position[n], w) for i, own in stated for n, w in own.items() if n in position]
            owner, member, weight = np.array(entries, dtype=float).reshape(-1, 3).T
            made[f"{key}_{other}_owner"] = owner.astype(np.intp)
            made[f"{key}_{other}_member"] = member.astype(np.intp)
            made[f"{key}_{other}"] = weight[:, None] / scale(unit, table.base_mva)
            units[f"{key}_{other}"] = unit
    for array in made.values():
        array.flags.writeable = False
    return replace(table, arrays={**table.arrays, **made}, units={**table.units, **units}) if made else table


def _cost_arrays(costs: list[Cost], base_mva: float) -> dict[str, npt.NDArray[Any]]:
    polynomials = [c if isinstance(c, Polynomial) else Polynomial() for c in costs]
    segments = [
        (owner, slope, offset, begin)
        for owner, cost in enumerate(costs)
        if isinstance(cost, PiecewiseLinear)
        for (slope, offset), (_, (begin, _)) in zip(cost.segments, cost.bends, strict=True)
    ]
    lines = np.array(segments, dtype=float).reshape(-1, 4)
    return {
        "c2": _column([p.c2 for p in polynomials]) * base_mva**2,
        "c1": _column([p.c1 for p in polynomials]) * base_mva,
        "c0": _column([p.c0 for p in polynomials]),
        "segment_owner": lines[:, 0].astype(np.intp),
        "segment_slope": lines[:, 1:2] * base_mva,
        "segment_offset": lines[:, 2:3].copy(),
        "segment_begin": lines[:, 3:] / base_mva,
    }


def _polygon_arrays(key: str, polygons: list[Any], factor: float) -> dict[str, npt.NDArray[Any]]:
    """Lay out polygons; see :func:`opfmodel.network.fields.points`."""
    edges = [
        (owner, *plane)
        for owner, points in enumerate(polygons)
        if points is not None
        for plane in half_planes(points)
    ]
    planes = np.array(edges, dtype=float).reshape(-1, 4)
    made: dict[str, npt.NDArray[Any]] = {
        f"{key}_owner": planes[:, 0].astype(np.intp),
        f"{key}_p": planes[:, 1:2].copy(),
        f"{key}_q": planes[:, 2:3].copy(),
        f"{key}_limit": planes[:, 3:] / factor,
    }
    everywhere = ((-np.inf, -np.inf), (np.inf, np.inf))
    corners = [everywhere if points is None else points for points in polygons]
    for axis, name in enumerate("pq"):
        for end, extreme in (("min", min), ("max", max)):
            values = [float(extreme(point[axis] for point in points)) for points in corners]
            made[f"{key}_{name}_{end}"] = _column(values) / factor
    return made


def _column(values: list[float]) -> Array:
    """Make an array ``(items, 1)``."""
    return np.array(values, dtype=float).reshape(-1, 1)
