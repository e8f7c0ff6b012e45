"""Independent verification of results: recompute all constraints and the cost from the data alone.

This module shares no equations with the rest of the package. It works on declared components and on
trajectories in physical units, uses complex arithmetic, and does not depend on programs or solvers,
so it provides independent evidence about them. A trajectory is checked against the physics of the
formulation named in its attributes. For formulations and devices from other packages, everything that
requires no knowledge of them is verified, and the rest is reported as unchecked.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain, compress
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import networkx as nx
import numpy as np
import numpy.typing as npt

from opfmodel.data.calendar import shown_in
from opfmodel.data.series import Profiles, SeriesKey
from opfmodel.errors import ProfileError, ResultError
from opfmodel.network.component import Component
from opfmodel.network.components import BUILT_IN, Branch, Bus, Generator, Load, Shunt, Storage
from opfmodel.network.costs import PiecewiseLinear
from opfmodel.network.network import Network

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Report", "Violation", "check", "economic_cost", "losses"]

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complexfloating]
Series = Mapping[Any, npt.ArrayLike]
Bounds = tuple[Array, Array]
Flows = tuple[Complex, Complex]  # power into the from and to ends of each branch, p.u.


@dataclass(frozen=True)
class Violation:
    """The largest violation of one family of constraints.

    Attributes
    ----------
    value
        Violation in per unit on the network's ``base_mva`` (energies in p.u. h), or in radians.
    component, time
        Component where it occurs, and beginning of the stage, h; counted from the first stage of the data
        if these have time stamps.
    moment
        Beginning of the stage as text: ``hour 3``, or a local time.
    physical, unit
        Violation in MW, MVAr, MVA, MWh, degrees or, for voltages, p.u.
    relative
        Violation in per unit on ``Network.scale_mva``, which does not depend on the base, or in radians.
    """

    family: str
    value: float
    component: str
    time: float
    moment: str
    physical: float
    unit: str
    relative: float

    def __str__(self) -> str:
        amount = f"{self.value:.1e} p.u."
        if self.unit == "deg":
            amount = f"{self.value:.1e} rad"
        return amount if self.unit == "p.u." else f"{amount} ({self.physical:.1e} {self.unit})"


@dataclass
class Report:
    """Outcome of :func:`check`.

    Attributes
    ----------
    violations
        Largest violation of each family of constraints, including zero violations.
    unserved
        Largest unserved active and reactive power of a load, if the data contain any. Load shedding
        violates no limit and is measured as energy. Unserved power outside zero to the demand is a
        violation, and so is power without a source (``p_shortage`` and the like), without which the
        balance does not hold.
    cost
        Recomputed operating cost over all stages, in the currency of the network.
    unchecked
        Items that could not be verified because a formulation or device is from another package.
    simultaneous
        Maximum power, p.u., at which a storage with losses charges and discharges simultaneously.
        This is not a violation but shows that the storage model is not tight.
    currency
        Name of the currency of the network.
    """

    violations: dict[str, Violation] = field(default_factory=dict)
    unserved: dict[str, Violation] = field(default_factory=dict)
    cost: float = 0.0
    simultaneous: float = 0.0
    unchecked: tuple[str, ...] = ()
    currency: str = "$"

    @property
    def max_violation(self) -> float:
        """Largest violation of all families, without unserved power."""
        return max((v.value for v in self.violations.values()), default=0.0)

    @property
    def worst(self) -> Violation | None:
        """Violation that is largest in the relative measure."""
        return max(self.violations.values(), key=lambda v: v.relative, default=None)

    def as_dict(self) -> dict[str, dict[str, Any]]:
        """Nonzero violations by family, as plain data in physical units."""
        return {
            v.family: {
                "value": v.physical,
                "unit": v.unit,
                "component": v.component,
                "time": v.time,
                "moment": v.moment,
            }
            for v in self.violations.values()
            if v.value > 0
        }

    def __str__(self) -> str:
        lines = [
            f"{v.family:<22} {v}  at {v.component}, {v.moment}"
            for family in (self.violations, self.unserved)
            for v in sorted(family.values(), key=lambda v: -v.value)
        ]
        left_out = [f"{'not checked':<22} {what}" for what in self.unchecked]
        return "\n".join([*lines, f"{'cost':<22} {self.cost:.6f} {self.currency}", *left_out])


def check(
    network: Network,
    data: xr.Dataset,
    series: Series | None = None,
    first: int = 0,
    previous_pg: Mapping[str, float] | None = None,
) -> Report:
    """Recompute all constraints and the operating cost of a trajectory.

    Parameters
    ----------
    network
        Declared network.
    data
        Trajectories over ``time`` in physical units, as in ``plan.data``, ``plan.scenario(name)`` or
        ``run.data``: for AC
        ``vm``, ``va``, ``pg``, ``qg`` and, with storage, ``ps``, ``qs``, ``e``, ``e_next``. The
        attribute ``formulation`` selects the physics, AC by default. Components may be in any order;
        components that are missing from the data count as out of service.
    series
        Time series: :class:`opfmodel.Profiles`, or values by ``"component.field"``. All other fields
        are constant.
    first
        Position of the first stage of ``data`` in the series.
    previous_pg
        Dispatch before the first stage, MW by generator; required to check the first ramp.

    Returns
    -------
    Report

    Raises
    ------
    ProfileError
        A time series does not cover all stages.
    ResultError
        The data contain two components of the same kind and name.
    """
    return _Checker(network, data, series, first).run(previous_pg)


def economic_cost(network: Network, data: xr.Dataset, series: Series | None = None, first: int = 0) -> Array:
    """Operating cost of the generators in each stage, $/h, from ``pg`` and the declared cost functions."""
    return _Checker(network, data, series, first).cost_rate()


def losses(network: Network, data: xr.Dataset) -> Array:
    """Active losses of all branches in each stage, MW: the sum of the flows into both ends."""
    at_from, at_to = _ac_flows(_Checker(network, data, None, 0))
    return np.asarray((at_from.real + at_to.real).sum(axis=0) * network.base_mva)


def _times(data: xr.Dataset) -> tuple[Array, Callable[[int], str]]:
    """Hours at which the stages begin, and a function that returns the beginning of one as text."""
    times = data["time"].values
    if not np.issubdtype(times.dtype, np.datetime64):
        hours = np.asarray(times, dtype=float)
        return hours, lambda stage: f"hour {hours[stage]:g}"
    zone = str(data["time"].attrs.get("zone", "UTC"))
    return (times - times[:1]) / np.timedelta64(1, "h"), lambda stage: shown_in(times[stage], zone)


class _Trajectories:
    """Trajectories and time series as arrays ``(items, stages)``."""

    def __init__(self, data: xr.Dataset, series: Series | None, first: int) -> None:
        self.data = data
        self.times, self.moments = _times(data)
        base = float(data.attrs.get("step_hours", 1.0))
        self.hours = np.asarray(data["hours"].values if "hours" in data else np.full(len(self.times), base))
        lengths = np.rint(self.hours / base).astype(int)  # in steps of the series
        self.begins = first + np.cumsum(lengths) - lengths
        self.ends = self.begins + lengths
        self.series = Profiles.of(series)
        self.changing = {key.field for key in self.series}
        self.positions: dict[str, dict[str, int]] = {}

    def has(self, *quantities: str) -> bool:
        """Whether the data contain all given quantities."""
        return all(quantity in self.data for quantity in quantities)

    def position(self, kind: str) -> dict[str, int]:
        """Position of each component of a kind in the data."""
        if kind not in self.positions:
            names = self.data[kind].values.tolist() if kind in self.data.coords else []
            self.positions[kind] = {name: i for i, name in enumerate(names)}
            if len(self.positions[kind]) < len(names):
                twice = next(name for name in names if names.count(name) > 1)
                raise ResultError(f"data: {kind}: {twice!r} occurs more than once; names must be unique")
        return self.positions[kind]

    def of(self, quantity: str, names: list[str]) -> Array:
        """Values of a quantity for the named components, in its physical unit."""
        if not names:  # the quantity may be missing if there are no components
            return np.zeros((0, len(self.times)))
        if quantity not in self.data:
            raise ResultError(f"data: no such quantity: {quantity!r}")
        array = self.data[quantity].variable
        kind = next(str(d) for d in array.dims if d != "time")
        position = self.position(kind)
        values = np.asarray(array.transpose(kind, "time").values, dtype=float)
        lacking = next((name for name in names if name not in position), None)
        if lacking is not None:
            raise ResultError(f"data: {kind}: {quantity!r} has no values of {lacking!r}")
        return values[[position[name] for name in names]]

    def declared(self, field: str, names: list[str], constants: Array, rule: str) -> Array:
        """Values of a field: ``constants`` of shape ``(items, 1)``, replaced by time series where given.

        Over a stage of several steps the rule applies: ``mean``, or ``min`` and ``max`` of limits.
        """
        end = int(self.ends.max(initial=0))
        keys = {i: SeriesKey(name, field) for i, name in enumerate(names)} if field in self.changing else {}
        changing = {i: self.series[key] for i, key in keys.items() if key in self.series}
        values = np.repeat(constants, len(self.times), axis=1) if changing else constants
        over: Mapping[str, Callable[..., Any]] = {"mean": np.mean, "min": np.min, "max": np.max}
        for i, whole in changing.items():
            if len(whole) < end:
                raise ProfileError(
                    f"profile {str(keys[i])!r}: has {len(whole)} values; {end} are needed", keys[i]
                )
            values[i] = [over[rule](whole[b:e]) for b, e in zip(self.begins, self.ends, strict=True)]
        return values


@dataclass(frozen=True)
class _Table:
    """Components of one kind. Fields have shape ``(items, 1)``, or ``(items, stages)`` with time series."""

    names: list[str]
    members: list[Any]
    trajectories: _Trajectories
    kind: str

    def where(self, mask: npt.ArrayLike) -> _Table:
        """Select components by a Boolean mask."""
        chosen = np.asarray(mask, dtype=bool).tolist()
        return replace(self, names=[*compress(self.names, chosen)], members=[*compress(self.members, chosen)])

    def values(self, quantity: str) -> Array:
        """Values of a quantity for all components, in its physical unit."""
        return self.trajectories.of(quantity, self.names)

    def each(self, field: str) -> list[Any]:
        """Declared values of a field for all components."""
        return list(map(attrgetter(field), self.members))

    def constant(self, field: str) -> Array:
        """Values of a number field for all components; None becomes infinity (no limit)."""
        values = [math.inf if value is None else value for value in self.each(field)]
        return np.array(values, dtype=float)[:, None]

    def span(self, field: str) -> Bounds:
        """Minimum and maximum for all components; a single number ``a`` stands for ``(-a, a)``."""
        pairs = [pair if isinstance(pair, tuple | list) else (-pair, pair) for pair in self.each(field)]
        ends = np.fromiter(chain.from_iterable(pairs), dtype=float).reshape(-1, 2)
        return ends[:, :1], ends[:, 1:]

    def number(self, field: str) -> Array:
        """Values of a number field for all components, including time series."""
        return self._declared(field, self.constant(field))

    def bounds(self, field: str) -> Bounds:
        """Minimum and maximum for all components, including time series."""
        low, high = self.span(field)
        return self._declared(f"{field}_min", low), self._declared(f"{field}_max", high)

    def status(self) -> Array:
        """1 where a component is in service and 0 where it is out; in service if the data do not say."""
        name = f"{self.kind}_status"
        if not (self.names and self.trajectories.has(name)):
            return np.ones((len(self.names), len(self.trajectories.times)))
        return (self.values(name) > 0).astype(float)

    def left(self, field: str) -> Bounds:
        """Minimum and maximum for all components, which are zero while one is out of service."""
        low, high = self.bounds(field)
        status = self.status() > 0
        return np.where(status, low, 0.0), np.where(status, high, 0.0)

    def _declared(self, field: str, constants: Array) -> Array:
        one = self.members[0] if self.members else None
        rule = one.over(field) if isinstance(one, Component) else "mean"
        return self.trajectories.declared(field, self.names, constants, rule)


class _Checker:
    """Constraints of all kinds of components, evaluated as arrays ``(items, stages)``."""

    def __init__(self, network: Network, data: xr.Dataset, series: Series | None, first: int) -> None:
        self.network, self.base, self.scale = network, network.base_mva, network.scale_mva
        self.trajectories = _Trajectories(data, series, first)
        self.has = self.trajectories.has
        self.hours = self.trajectories.hours
        self.formulation = str(data.attrs.get("formulation", "ac"))
        self.voltages_known = self.has("vm") or self.has("w")
        self.angles_known = self.has("va") or self.has("wr", "wi")
        self.reactive = self.voltages_known or self.has("qg") or self.has("qs")
        self.buses, self.branches = self.reported(Bus), self.reported(Branch)
        self.generators, self.storages = self.reported(Generator), self.reported(Storage)
        self.position = {bus: i for i, bus in enumerate(self.buses.names)}
        kinds = dict.fromkeys(type(c) for c in network.of(Component).values() if c.in_service)
        self.others = [kind for kind in kinds if not issubclass(kind, BUILT_IN)]  # from other packages
        self.report = Report(currency=network.currency)

    def run(self, previous_pg: Mapping[str, float] | None) -> Report:
        """Run all checks."""
        self.check_generators(previous_pg)
        self.check_storages()
        for kind in self.others:
            self.leave_out(f"limits and cost of the {kind.plural}")
        flows = _FLOWS.get(self.formulation, _reported_flows)(self)
        if flows is not None:
            status = self.branches.status()
            flows = flows[0] * status, flows[1] * status
        if self.voltages_known:
            magnitude = np.sqrt(self.voltage_squared(self.buses.names))
            self.inside("voltage", self.buses, magnitude, self.buses.bounds("vm"), "p.u.")
        if flows is not None:
            self.check_branches(flows)
        if self.angles_known:
            limited = self.branches.where(self.limited_angles())
            angles = np.where(limited.status() > 0, self.angles()[self.limited_angles()], 0.0)
            self.inside("angle difference", limited, angles, limited.span("angle"), "deg")
        self.check_balance(flows)
        self.report.cost = float(self.cost_rate() @ self.hours)
        return self.report

    def table(self, members: Mapping[str, Component]) -> _Table:
        """Make a table of components."""
        kind = next((member.kind for member in members.values()), "")
        resolved = [member.resolved() for member in members.values()]
        return _Table(list(members), resolved, self.trajectories, kind)

    def reported(self, kind: type[Component]) -> _Table:
        """Components of a class that are in the data, in order of declaration."""
        present = self.trajectories.position(kind.kind)
        return self.table({n: c for n, c in self.network.of(kind).items() if n in present})

    def at_work(self, kind: type[Load | Shunt]) -> _Table:
        """Components of a class that are in service at buses in the data."""
        members = self.network.of(kind).items()
        return self.table({n: c for n, c in members if c.in_service and c.bus in self.position})

    def leave_out(self, what: str) -> None:
        """Record that something was not verified."""
        if what not in self.report.unchecked:
            self.report.unchecked = (*self.report.unchecked, what)

    def note(self, family: str, names: list[str], excess: Array, unit: str) -> None:
        """Record the largest violation of a family; see :meth:`largest`."""
        if names:
            self.report.violations[family] = self.largest(family, names, excess, unit)

    def largest(self, family: str, names: list[str], excess: Array, unit: str) -> Violation:
        """Return the largest value; ties go to the first component, then the first stage.

        Without a violation, the first component at the stage where it is closest to its limit.

        Parameters
        ----------
        excess
            ``(items, stages)`` or ``(items, ends, stages)``, in ``unit``; NaN counts as infinite.
        """
        rows = np.where(np.isnan(excess), np.inf, excess).reshape(-1, excess.shape[-1])
        ends = len(rows) // len(names)
        row, stage = divmod(int(rows.argmax()), rows.shape[1])
        if rows[row, stage] <= 0:
            row, stage = 0, int(rows[0].argmax())
        physical = max(0.0, float(rows[row, stage]))
        power = unit not in ("p.u.", "deg")
        value = math.radians(physical) if unit == "deg" else physical / (self.base if power else 1.0)
        relative = physical / self.scale if power else value
        at = self.trajectories
        component, time, moment = names[row // ends], float(at.times[stage]), at.moments(stage)
        return Violation(family, value, component, time, moment, physical, unit, relative)

    def inside(self, family: str, items: _Table, values: Array, bounds: Bounds, unit: str) -> None:
        """Check ``low <= values <= high``."""
        low, high = bounds
        self.note(family, items.names, np.maximum(low - values, values - high), unit)

    # Devices -----------------------------------------------------------------------------

    def check_generators(self, previous_pg: Mapping[str, float] | None) -> None:
        """Check active and reactive power limits and ramps."""
        units = self.generators
        self.inside("generator p", units, units.values("pg"), units.left("p"), "MW")
        if self.reactive:
            self.inside("generator q", units, units.values("qg"), units.left("q"), "MVAr")
        ramped = units.where(np.isfinite(units.number("ramp")).any(axis=1))
        before = [
            math.nan if previous_pg is None else previous_pg.get(name, math.nan) for name in ramped.names
        ]
        change = np.abs(np.diff(ramped.values("pg"), axis=1, prepend=np.array(before).reshape(-1, 1)))
        change[np.diff(ramped.status(), axis=1, prepend=1.0) != 0] = 0.0  # a unit trips, or returns
        change[np.isnan(change)] = 0.0  # no check where the dispatch is unknown, as before the first stage
        between = 0.5 * (self.hours + np.concatenate([self.hours[:1], self.hours[:-1]]))
        self.note("ramp", ramped.names, change - ramped.number("ramp") * between, "MW")

    def check_storages(self) -> None:
        """Check power and apparent-power limits and, unless the data have no energy, that of each storage."""
        units = self.storages
        ps = units.values("ps")
        qs = units.values("qs") if self.reactive else np.zeros_like(ps)
        self.inside("storage power", units, ps, units.left("power"), "MW")
        self.inside("storage q", units, qs, units.left("q"), "MVAr")
        self.note("storage rating", units.names, np.hypot(ps, qs) - units.number("rating"), "MVA")
        if self.has("e", "e_next") or not units.names:
            self.check_energy(units, ps)
        else:  # a power flow is the state of one moment
            self.leave_out("stored energy: the results do not include it")

    def check_energy(self, units: _Table, ps: Array) -> None:
        """Check energy limits and the energy balance of each storage."""
        e, e_next = units.values("e"), units.values("e_next")
        limits = units.number("energy_min"), units.number("energy")
        self.inside("storage energy", units, e_next, limits, "MWh")
        gap = np.zeros_like(e)  # the last stage has no successor
        gap[:, :-1] = np.abs(e[:, 1:] - e_next[:, :-1])
        self.note("energy continuity", units.names, gap, "MWh")
        stored = (e_next - (1 - units.constant("standing_loss") * self.hours) * e) / self.hours
        # a given net power stores the most energy without simultaneous charging and discharging
        gain, drain = units.constant("charge_efficiency"), 1 / units.constant("discharge_efficiency")
        most = np.where(ps >= 0, gain * ps, drain * ps)
        lossy = gain < drain
        excess = np.where(lossy, stored - most, np.abs(stored - ps))
        self.note("storage dynamics", units.names, excess, "MW")
        wasted = np.divide(most - stored, drain - gain, out=np.zeros_like(ps), where=lossy).max(axis=1)
        self.report.simultaneous = float(np.fmax.reduce(wasted, initial=0.0)) / self.base

    def cost_rate(self) -> Array:
        """Operating cost of the generators in each stage, $/h."""
        piecewise = [isinstance(cost, PiecewiseLinear) for cost in self.generators.each("cost")]
        smooth, linear = self.generators.where([not p for p in piecewise]), self.generators.where(piecewise)
        costs, pg = replace(smooth, members=smooth.each("cost")), smooth.values("pg")
        rate = costs.number("c2") * pg**2 + costs.number("c1") * pg + costs.number("c0")
        rate = (rate * smooth.status()).sum(axis=0)
        for cost, dispatch, status in zip(
            linear.each("cost"), linear.values("pg"), linear.status(), strict=True
        ):
            slope, offset = np.array(cost.segments).T[:, :, None]
            rate += status * (slope * dispatch + offset).max(axis=0)  # convex: the maximum over the segments
        return np.asarray(rate)

    # Network -----------------------------------------------------------------------------

    def voltage_squared(self, buses: list[str]) -> Array:
        """Squared voltage magnitudes, p.u.; 1 if the formulation has none."""
        if not self.voltages_known:
            return np.ones((len(buses), 1))
        of = self.trajectories.of
        return of("w", buses) if self.has("w") else of("vm", buses) ** 2

    def ends(self, quantity: str) -> tuple[Array, Array]:
        """Bus quantity at the from and to ends of the branches."""
        from_bus, to_bus = self.branches.each("from_bus"), self.branches.each("to_bus")
        return self.trajectories.of(quantity, from_bus), self.trajectories.of(quantity, to_bus)

    def angles(self) -> Array:
        """Angle differences across the branches, degrees."""
        if self.has("va"):
            return np.subtract(*self.ends("va"))
        return np.rad2deg(np.arctan2(self.branches.values("wi"), self.branches.values("wr")))

    def limited_angles(self) -> npt.NDArray[np.bool_]:
        """Mask of the branches that have an angle-difference limit."""
        least, most = self.branches.span("angle")
        return np.asarray((least > -360) | (most < 360))[:, 0]

    def check_branches(self, flows: Flows) -> None:
        """Check reported flows, and ratings at both ends."""
        names, (at_from, at_to) = self.branches.names, flows
        parts = {"pf": at_from.real, "qf": at_from.imag, "pt": at_to.real, "qt": at_to.imag}
        wrong = [np.abs(self.branches.values(q) - self.base * p) for q, p in parts.items() if self.has(q)]
        if wrong:
            self.note("reported flow", names, np.stack(wrong, axis=1), "MVA")
        apparent = self.base * np.abs(np.stack(flows, axis=1))
        self.note("branch rating", names, apparent - self.ratings()[:, None], "MVA")

    def ratings(self) -> Array:
        """Ratings of the branches: those of an emergency while the controller does not know of an outage."""
        rating = self.branches.number("rating")
        if not self.has("outages_known"):
            return rating
        emergency = self.branches.number("emergency_rating")
        multiple = float(self.trajectories.data.attrs.get("outage_rating", 1.0))
        after = np.where(np.isfinite(emergency), emergency, multiple * rating)
        known = np.asarray(self.trajectories.data["outages_known"].values, dtype=float)
        return np.where(known > 0, rating, after)

    def check_balance(self, flows: Flows | None) -> None:
        """Check the power balance of each bus or, in a copperplate model, of each island."""
        missing = [kind.plural for kind in self.others if not self.has(f"{kind.kind}_p")]
        if flows is None and self.formulation != "copperplate":
            missing.append("branches")
        for plural in missing:
            self.leave_out(f"bus balances: the results do not include the power of the {plural}")
        if missing:
            return
        names, total = self.buses.names, self.injections()
        if flows is not None:
            buses = chain.from_iterable(map(attrgetter("from_bus", "to_bus"), self.branches.members))
            drawn = np.stack(flows, axis=1).reshape(-1, total.shape[1])
            np.subtract.at(total, [self.position[bus] for bus in buses], drawn)
        else:
            islands = self.islands()
            names = [island[0] for island in islands]
            total = np.array(
                [total[[self.position[bus] for bus in island]].sum(axis=0) for island in islands]
            )
        self.note("active balance", names, self.base * np.abs(total.real), "MW")
        if self.reactive:
            self.note("reactive balance", names, self.base * np.abs(total.imag), "MVAr")

    def injections(self) -> Complex:
        """Complex power injected into each bus by devices and shunts, p.u."""
        buses, loads, shunts = self.buses, self.at_work(Load), self.at_work(Shunt)
        g, b = shunts.constant("g") / self.base, shunts.constant("b") / self.base
        drawn = (g - 1j * b) * self.voltage_squared(shunts.each("bus"))
        total = np.zeros((len(buses.names), len(self.trajectories.times)), dtype=complex)
        for at, power in (
            (self.generators.each("bus"), self.power("pg", "qg", self.generators)),
            (self.storages.each("bus"), -self.power("ps", "qs", self.storages)),
            (loads.each("bus"), -self.served(loads)),
            *((buses.names, self.power(f"{k.kind}_p", f"{k.kind}_q", buses)) for k in self.others),
            (shunts.each("bus"), -drawn),
            (buses.names, self.lacking("p_shortage", "q_shortage", buses)),
            (buses.names, -self.lacking("p_surplus", "q_surplus", buses)),
        ):
            np.add.at(total, [self.position[bus] for bus in at], power)
        return total

    def power(self, active: str, reactive: str, items: _Table) -> Complex:
        """Complex power, p.u."""
        q = items.values(reactive) if self.reactive and self.has(reactive) else 0.0
        return np.asarray((items.values(active) + 1j * q) / self.base)

    def served(self, loads: _Table) -> Complex:
        """Demand less its unserved part, p.u.; the latter lies between zero and the demand."""
        power = np.zeros((len(loads.names), len(self.trajectories.times)), dtype=complex)
        for letter, factor, unit in (("p", 1.0, "MW"), ("q", 1j, "MVAr")):
            demand, quantity = loads.number(letter), f"{letter}_unserved"
            power += factor * demand / self.base
            if not (self.has(quantity) and loads.names):
                continue
            values, family = loads.values(quantity), quantity.replace("_", " ")
            power -= factor * values / self.base
            self.inside(
                f"{family} range", loads, values, (np.minimum(demand, 0), np.maximum(demand, 0)), unit
            )
            self.report.unserved[family] = self.largest(family, loads.names, np.abs(values), unit)
        return power

    def lacking(self, active: str, reactive: str, items: _Table) -> Complex:
        """Power without a source or sink reported by an elastic plan or a plant, p.u.; itself a violation."""
        power = np.zeros((len(items.names), len(self.trajectories.times)), dtype=complex)
        for quantity, factor, unit in ((active, 1.0, "MW"), (reactive, 1j, "MVAr")):
            if self.has(quantity):
                values = items.values(quantity)
                power += factor * values / self.base
                self.note(quantity.replace("_", " "), items.names, np.abs(values), unit)
        return power

    def islands(self) -> list[list[str]]:
        """Groups of buses connected by branches in service."""
        graph = nx.Graph()
        graph.add_nodes_from(self.position)
        pairs = [b.buses for b in self.network.of(Branch).values() if b.in_service]
        graph.add_edges_from(pair for pair in pairs if self.position.keys() >= set(pair))
        return [sorted(members) for members in nx.connected_components(graph)]


# Flows by formulation: complex power into both ends of each branch, p.u. --------------------------


def _phasor(magnitude: Array, degrees: Array) -> Complex:
    angle = np.deg2rad(degrees)
    return np.asarray(magnitude * (np.cos(angle) + 1j * np.sin(angle)))


def _series_admittance(branches: _Table) -> Complex:
    return np.asarray(1 / (branches.constant("r") + 1j * branches.constant("x")))


def _end_shunts(branches: _Table) -> tuple[Complex, Complex]:
    """Admittance to ground at the from and to ends: half the line charging plus the shunt of that end."""
    half = (branches.constant("g") + 1j * branches.constant("b")) / 2
    at_from = half + branches.constant("g_from") + 1j * branches.constant("b_from")
    at_to = half + branches.constant("g_to") + 1j * branches.constant("b_to")
    return at_from, at_to


def _ac_flows(c: _Checker) -> Flows:
    """Flows of the π model with an ideal transformer at the from end, from complex voltages."""
    v_from, v_to = map(_phasor, c.ends("vm"), c.ends("va"))
    ratio = _phasor(c.branches.constant("tap"), c.branches.constant("shift"))
    series, (shunt_from, shunt_to) = _series_admittance(c.branches), _end_shunts(c.branches)
    behind = v_from / ratio  # voltage behind the ideal transformer
    current_behind = (behind - v_to) * series + behind * shunt_from
    current_to = (v_to - behind) * series + v_to * shunt_to
    return behind * current_behind.conj(), v_to * current_to.conj()


def _soc_flows(c: _Checker) -> Flows:
    """Flows of the π model from voltage products; also check that the products lie in their cone."""
    w_from, w_to = c.ends("w")
    product = c.branches.values("wr") + 1j * c.branches.values("wi")  # v_from v_to*
    c.note("voltage products", c.branches.names, np.abs(product) ** 2 - w_from * w_to, "p.u.")
    ratio = _phasor(c.branches.constant("tap"), c.branches.constant("shift"))
    series, (shunt_from, shunt_to) = _series_admittance(c.branches), _end_shunts(c.branches)
    at_from = (series + shunt_from).conj() * w_from / np.abs(ratio) ** 2 - series.conj() * product / ratio
    at_to = (series + shunt_to).conj() * w_to - series.conj() * product.conj() / ratio.conj()
    return at_from, at_to


def _dc_flows(c: _Checker) -> Flows:
    """Flows as susceptance x / (r² + x²) times the angle difference."""
    flow = -_series_admittance(c.branches).imag * np.deg2rad(c.angles()) + 0j
    return flow, -flow


def _dc_matpower_flows(c: _Checker) -> Flows:
    """Flows as susceptance 1 / (x tap) times the angle difference minus the phase shift."""
    susceptance = 1 / (c.branches.constant("x") * c.branches.constant("tap"))
    flow = susceptance * np.deg2rad(c.angles() - c.branches.constant("shift")) + 0j
    return flow, -flow


def _dc_losses_flows(c: _Checker) -> Flows:
    """Lossless flows plus half the loss at each end; also check that the loss is at least g angle²."""
    flow, _ = _dc_flows(c)
    loss = c.branches.values("loss") / c.base
    least = c.branches.status() * _series_admittance(c.branches).real * np.deg2rad(c.angles()) ** 2
    c.note("branch loss", c.branches.names, c.base * np.maximum(least - loss, -loss), "MW")
    return flow + loss / 2, -flow + loss / 2


def _reported_flows(c: _Checker) -> Flows | None:
    """Flows reported by an unknown formulation; None if it reports none."""
    c.leave_out(f"branch equations of the formulation {c.formulation!r}")
    if not c.angles_known and c.limited_angles().any():
        c.leave_out("angle differences")
    if c.reactive and not c.voltages_known:
        c.leave_out("voltages")
    if not c.has("pf", "pt") or (c.reactive and not c.has("qf", "qt")):
        return None
    return c.power("pf", "qf", c.branches), c.power("pt", "qt", c.branches)


_FLOWS: dict[str, Callable[[_Checker], Flows | None]] = {
    "ac": _ac_flows,
    "ac-rectangular": _ac_flows,
    "soc": _soc_flows,
    "dc": _dc_flows,
    "dc-matpower": _dc_matpower_flows,
    "dc-losses": _dc_losses_flows,
    "copperplate": lambda _: None,
}
