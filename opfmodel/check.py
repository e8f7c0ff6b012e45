"""Independent verification of results: every constraint and the cost, from data alone.

This module shares no equations with the rest of the package: it works on the declared components
and on trajectories in physical units, with complex arithmetic, and knows neither programs nor
solvers. What it finds is evidence about them. A trajectory is held against the physics of the
formulation that it says it was made with. Of formulations and devices of other packages it
verifies what needs no knowledge of them, and says what it left out.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from opfmodel.data.series import Profiles, SeriesKey
from opfmodel.network.component import Component
from opfmodel.network.components import BUILT_IN, Branch, Bus, Generator, Load, Shunt, Storage
from opfmodel.network.costs import PiecewiseLinear, Polynomial
from opfmodel.network.network import Network

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Report", "Violation", "check", "economic_cost", "losses"]

Array = npt.NDArray[np.float64]
Series = Mapping[Any, npt.ArrayLike]
Flows = dict[str, tuple[Any, Any]]


@dataclass(frozen=True)
class Violation:
    """The largest violation of one family of constraints.

    Attributes
    ----------
    value
        In per unit on the network's ``base_mva`` (energies in p.u. h), or radians.
    component, time
        Where it is, and the coordinate of its stage.
    physical, unit
        The same in MW, MVAr, MVA, MWh, degrees or p.u. of voltage.
    relative
        The same in per unit on ``Network.scale_mva``, which does not depend on the base, or radians.
    """

    family: str
    value: float
    component: str
    time: float
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
    """What :func:`check` found.

    Attributes
    ----------
    violations
        The largest violation by family of constraints, also where it is zero.
    cost
        Operating cost over all stages, recomputed, in $.
    unchecked
        What could not be verified, because a formulation or device is not one of this package.
    simultaneous
        Largest power in p.u. by which a storage with losses charges and discharges at once; it
        is no violation but says that the storage model was not tight.
    """

    violations: dict[str, Violation] = field(default_factory=dict)
    cost: float = 0.0
    simultaneous: float = 0.0
    unchecked: tuple[str, ...] = ()

    @property
    def max_violation(self) -> float:
        """The largest violation of all."""
        return max((v.value for v in self.violations.values()), default=0.0)

    @property
    def worst(self) -> Violation | None:
        """The family with the largest violation."""
        return max(self.violations.values(), key=lambda v: v.relative, default=None)

    def as_dict(self) -> dict[str, dict[str, Any]]:
        """The violations that are not zero, by family, as plain data in physical units."""
        return {
            v.family: {"value": v.physical, "unit": v.unit, "component": v.component, "time": v.time}
            for v in self.violations.values()
            if v.value > 0
        }

    def __str__(self) -> str:
        lines = [
            f"{v.family:<22} {v}  at {v.component}, time {v.time:g}"
            for v in sorted(self.violations.values(), key=lambda v: -v.value)
        ]
        left_out = [f"{'not checked':<22} {what}" for what in self.unchecked]
        return "\n".join([*lines, f"{'cost':<22} {self.cost:.6f} $", *left_out])


def check(
    network: Network,
    data: xr.Dataset,
    series: Series | None = None,
    first: int = 0,
    previous_pg: Mapping[str, float] | None = None,
) -> Report:
    """Recompute every constraint of a trajectory and its operating cost.

    Parameters
    ----------
    network
        The declared network.
    data
        Trajectories as in ``plan.data`` or ``run.data``, in physical units, over ``time``: for AC
        ``vm``, ``va``, ``pg``, ``qg`` and, with storage, ``ps``, ``qs``, ``e``, ``e_next``. The
        attribute ``formulation`` names the physics, AC by default.
    series
        Time series: :class:`opfmodel.Profiles`, or values by ``"component.field"``; other fields are
        constant.
    first
        Position in the series of the first stage of ``data``.
    previous_pg
        Dispatch before the first stage, MW by generator, if its ramp is to be checked.

    Returns
    -------
    Report
    """
    return _Checker(network, data, Profiles.of(series), first).run(previous_pg)


def economic_cost(network: Network, data: xr.Dataset, series: Series | None = None, first: int = 0) -> Array:
    """Operating cost of the generators in each stage, $/h, from ``pg`` and the declared costs."""
    return _Checker(network, data, Profiles.of(series), first).cost_rate()


def losses(network: Network, data: xr.Dataset) -> Array:
    """Active losses of all branches in each stage, MW, from voltages: the sum of both ends."""
    flows = _ac_flows(_Checker(network, data, Profiles(), 0))
    total = np.zeros(data.sizes["time"])
    for at_from, at_to in flows.values():
        total += at_from.real + at_to.real
    return total * network.base_mva


class _Checker:
    """One pass over the components of a network and the stages of a trajectory."""

    def __init__(self, network: Network, data: xr.Dataset, series: Profiles, first: int) -> None:
        self.network = network
        self.base = network.base_mva
        self.scale = network.scale_mva
        self.data = data
        self.series = series
        self.first = first
        self.times = np.asarray(data["time"].values, dtype=float)
        self.step = float(data.attrs.get("step_hours", 1.0))
        self.buses = self.of(Bus, "bus")
        self.reactive = not {"qg", "qs", "vm", "w"}.isdisjoint(data)
        self.formulation = str(data.attrs.get("formulation", "ac"))
        self.others = self.other_kinds()
        self.report = Report()

    def run(self, previous_pg: Mapping[str, float] | None) -> Report:
        """Check everything."""
        self.check_generators(previous_pg)
        self.check_storages()
        for kind in self.others:
            self.leave_out(f"limits and cost of the {kind.plural}")
        self.check_network(_FLOWS.get(self.formulation, _reported_flows)(self))
        self.report.cost = float(self.cost_rate().sum() * self.step)
        return self.report

    # Access ------------------------------------------------------------------------------

    def of(self, kind: type[Any], dimension: str) -> dict[str, Any]:
        """Components of a class that the data has."""
        present = set(self.data[dimension].values) if dimension in self.data.coords else set()
        return {n: c for n, c in self.network.of(kind).items() if n in present}

    def value(self, quantity: str, component: str) -> Array:
        """Trajectory of a quantity of a component, in its physical unit."""
        array = self.data[quantity]
        dimension = next(d for d in array.dims if d != "time")
        return np.asarray(array.sel({dimension: component}).values, dtype=float)

    def declared(self, component: str, key: str, constant: float | None) -> Array:
        """A field of a component over the stages: its time series or its constant."""
        values = self.series.get(SeriesKey(component, key))
        if values is not None:
            return np.asarray(values, dtype=float)[self.first : self.first + len(self.times)]
        return np.full(len(self.times), math.inf if constant is None else constant)

    def note(self, family: str, component: str, excess: Array, unit: str) -> None:
        """Keep the largest violation of a family, in its physical unit."""
        values = np.where(np.isnan(excess), np.inf, excess)
        worst = int(np.argmax(values)) if values.size else 0
        physical = max(float(values[worst]), 0.0) if values.size else 0.0
        known = self.report.violations.get(family)
        if known is None or physical > known.physical:
            power = unit not in ("p.u.", "deg")
            value = math.radians(physical) if unit == "deg" else physical / (self.base if power else 1.0)
            relative = physical / self.scale if power else value
            time = float(self.times[worst])
            self.report.violations[family] = Violation(
                family, value, component, time, physical, unit, relative
            )

    def inside(self, family: str, component: str, values: Array, low: Array, high: Array, unit: str) -> None:
        """Check ``low <= values <= high``."""
        self.note(family, component, np.maximum(low - values, values - high), unit)

    def leave_out(self, what: str) -> None:
        """Say that something was not verified."""
        if what not in self.report.unchecked:
            self.report.unchecked = (*self.report.unchecked, what)

    def other_kinds(self) -> list[type[Component]]:
        """Kinds of components in service that belong to other packages."""
        at_work = [self.network[name] for name in self.network if self.network[name].in_service]
        return [k for k in dict.fromkeys(type(c) for c in at_work) if not issubclass(k, BUILT_IN)]

    def bounds(self, component: str, key: str, pair: tuple[float, float]) -> tuple[Array, Array]:
        """Minimum and maximum of a span field over the stages."""
        return self.declared(component, f"{key}_min", pair[0]), self.declared(
            component, f"{key}_max", pair[1]
        )

    # Network -----------------------------------------------------------------------------

    def voltage_squared(self, bus: str) -> Array:
        """Squared voltage magnitude of a bus, p.u.; 1 where the formulation has none."""
        if "w" in self.data:
            return self.value("w", bus)
        return self.value("vm", bus) ** 2 if "vm" in self.data else np.ones(len(self.times))

    def check_network(self, flows: Flows) -> None:
        """Voltages, flows as reported, ratings, angle differences and the balance of every bus."""
        for name, bus in self.buses.items():
            low, high = self.bounds(name, "vm", bus.vm)
            if self.reactive and {"vm", "w"} & set(self.data):
                self.inside("voltage", name, np.sqrt(self.voltage_squared(name)), low, high, "p.u.")
        for name, (at_from, at_to) in flows.items():
            branch = self.network[name]
            assert isinstance(branch, Branch)
            for end, p, q in ((at_from, "pf", "qf"), (at_to, "pt", "qt")):
                for reported, power in ((p, end.real), (q, end.imag)):
                    if reported in self.data:
                        difference = np.abs(self.value(reported, name) - self.base * power)
                        self.note("reported flow", name, difference, "MVA")
                rating = self.declared(name, "rating", branch.rating)
                self.note("branch rating", name, self.base * np.abs(end) - rating, "MVA")
            least, most = branch.angle
            if (least > -360 or most < 360) and self.angles_known:
                bounds = (np.full(len(self.times), least), np.full(len(self.times), most))
                self.inside("angle difference", name, self.angle(name, branch), *bounds, "deg")
        missing = self.unreported()
        for plural in missing:
            self.leave_out(f"balance of the buses: the results do not say what the {plural} draw")
        if not missing:
            self.check_balance(flows)

    @property
    def angles_known(self) -> bool:
        """Whether the data say what the angle across a branch is."""
        return "va" in self.data or {"wr", "wi"} <= set(self.data)

    def unreported(self) -> list[str]:
        """What draws power that the data do not have."""
        missing = [k.plural for k in self.others if f"{k.kind}_p" not in self.data]
        if self.formulation not in _FLOWS and not self.flows_reported:
            missing.append("branches")
        return missing

    @property
    def flows_reported(self) -> bool:
        """Whether the data have the power at both ends of the branches."""
        active = {"pf", "pt"} <= set(self.data)
        return active and (not self.reactive or {"qf", "qt"} <= set(self.data))

    def angle(self, name: str, branch: Branch) -> Array:
        """Angle across a branch, degrees."""
        if "va" in self.data:
            return self.value("va", branch.from_bus) - self.value("va", branch.to_bus)
        return np.rad2deg(np.arctan2(self.value("wi", name), self.value("wr", name)))

    def injections(self) -> dict[str, Any]:
        """Complex power that devices and shunts put into each bus, p.u."""
        total = {bus: np.zeros(len(self.times), dtype=complex) for bus in self.buses}
        for name, generator in self.of(Generator, "generator").items():
            total[generator.bus] += self.power("pg", "qg", name)
        for name, storage in self.of(Storage, "storage").items():
            total[storage.bus] -= self.power("ps", "qs", name)
        for name, load in self.network.of(Load).items():
            if load.in_service and load.bus in total:
                p, q = self.declared(name, "p", load.p), self.declared(name, "q", load.q)
                total[load.bus] -= (p + 1j * q) / self.base - self.lacking("p_unserved", "q_unserved", name)
        for kind in self.others:
            for bus in total:
                reactive = f"{kind.kind}_q" if f"{kind.kind}_q" in self.data else None
                total[bus] += self.power(f"{kind.kind}_p", reactive, bus)
        for shunt in self.network.of(Shunt).values():
            if shunt.in_service and shunt.bus in total:
                total[shunt.bus] -= complex(shunt.g, -shunt.b) / self.base * self.voltage_squared(shunt.bus)
        for bus in total:
            total[bus] += self.lacking("p_shortage", "q_shortage", bus)
            total[bus] -= self.lacking("p_surplus", "q_surplus", bus)
        return total

    def lacking(self, active: str, reactive: str, name: str) -> Any:
        """What an elastic plan or a plant reports to lack, p.u.; a violation in itself."""
        power = np.zeros(len(self.times), dtype=complex)
        for quantity, factor in ((active, 1.0), (reactive, 1j)):
            if quantity in self.data:
                power += factor * self.value(quantity, name) / self.base
                unit = "MW" if factor == 1.0 else "MVAr"
                self.note(quantity.replace("_", " "), name, np.abs(self.value(quantity, name)), unit)
        return power

    def power(self, active: str, reactive: str | None, name: str) -> Any:
        """Complex power of a device, p.u."""
        q = self.value(reactive, name) if self.reactive and reactive is not None else 0.0
        return (self.value(active, name) + 1j * q) / self.base

    def check_balance(self, flows: Flows) -> None:
        """Power is balanced at every bus, or in every island where there is no network."""
        total = self.injections()
        for name, (at_from, at_to) in flows.items():
            branch = self.network[name]
            assert isinstance(branch, Branch)
            total[branch.from_bus] -= at_from
            total[branch.to_bus] -= at_to
        if self.data.attrs.get("formulation") == "copperplate":
            total = {members[0]: sum(total[bus] for bus in members) for members in self.islands()}
        for bus, power in total.items():
            self.note("active balance", bus, self.base * np.abs(power.real), "MW")
            if self.reactive:
                self.note("reactive balance", bus, self.base * np.abs(power.imag), "MVAr")

    def islands(self) -> list[list[str]]:
        """Buses that branches connect, by following branches from bus to bus."""
        island = {bus: {bus} for bus in self.buses}
        for branch in self.network.of(Branch).values():
            if branch.in_service and branch.from_bus in island and branch.to_bus in island:
                joined = island[branch.from_bus] | island[branch.to_bus]
                island.update(dict.fromkeys(joined, joined))
        return [sorted(members) for members in {id(m): m for m in island.values()}.values()]

    # Devices -----------------------------------------------------------------------------

    def check_generators(self, previous_pg: Mapping[str, float] | None) -> None:
        """Active and reactive limits and ramps."""
        for name, generator in self.of(Generator, "generator").items():
            pg = self.value("pg", name)
            self.inside("generator p", name, pg, *self.bounds(name, "p", generator.p), "MW")
            if self.reactive:
                bounds = self.bounds(name, "q", generator.q)
                self.inside("generator q", name, self.value("qg", name), *bounds, "MVAr")
            ramp = self.declared(name, "ramp", generator.ramp)
            if np.isfinite(ramp).any():
                before = math.nan if previous_pg is None else previous_pg[name]
                change = np.abs(np.diff(pg, prepend=before))
                change[np.isnan(change)] = 0.0
                self.note("ramp", name, change - ramp * self.step, "MW")

    def check_storages(self) -> None:
        """Power, energy and apparent-power limits, and the energy balance of each storage."""
        for name, declared in self.of(Storage, "storage").items():
            storage = declared.resolved()
            ps = self.value("ps", name)
            qs: Array = self.value("qs", name) if self.reactive else np.zeros(len(ps))
            e, e_next = self.value("e", name), self.value("e_next", name)
            for key, values, pair, unit in (
                ("power", ps, storage.power, "MW"),
                ("q", qs, storage.q, "MVAr"),
            ):
                ends = pair if isinstance(pair, tuple) else (-pair, pair)
                self.inside(f"storage {key}", name, values, *self.bounds(name, key, ends), unit)
            low = self.declared(name, "energy_min", storage.energy_min)
            high = self.declared(name, "energy", storage.energy)
            self.inside("storage energy", name, e_next, low, high, "MWh")
            rating = self.declared(name, "rating", storage.rating)
            self.note("storage rating", name, np.hypot(ps, qs) - rating, "MVA")
            self.note("energy continuity", name, np.abs(e[1:] - e_next[:-1]), "MWh")
            stored = (e_next - (1 - storage.standing_loss * self.step) * e) / self.step
            self._check_efficiency(name, storage, ps, stored)

    def _check_efficiency(self, name: str, storage: Storage, ps: Array, stored: Array) -> None:
        gain, drain = storage.charge_efficiency, 1 / storage.discharge_efficiency
        if gain == drain:  # lossless
            self.note("storage dynamics", name, np.abs(stored - ps), "MW")
            return
        # of all splits into charging and discharging the one with nothing at once stores most
        most = np.where(ps >= 0, gain * ps, drain * ps)
        self.note("storage dynamics", name, stored - most, "MW")
        wasted = (most - stored) / (drain - gain)
        self.report.simultaneous = max(self.report.simultaneous, float(wasted.max()) / self.base)

    def cost_rate(self) -> Array:
        """Operating cost of the generators in each stage, $/h."""
        rate = np.zeros(len(self.times))
        for name, generator in self.of(Generator, "generator").items():
            pg = self.value("pg", name)
            cost = generator.cost
            if isinstance(cost, PiecewiseLinear):
                rate += np.max([slope * pg + offset for slope, offset in cost.segments], axis=0)
            else:
                assert isinstance(cost, Polynomial)
                c2, c1, c0 = (self.declared(name, key, getattr(cost, key)) for key in ("c2", "c1", "c0"))
                rate += c2 * pg**2 + c1 * pg + c0
        return rate


# Flows of the formulations: complex power into both ends of each branch, p.u. ---------------------


def _ac_flows(c: _Checker) -> Flows:
    """The π model with an ideal transformer, from complex voltages."""
    flows = {}
    for name, branch in c.of(Branch, "branch").items():
        v_from, v_to = _voltage(c, branch.from_bus), _voltage(c, branch.to_bus)
        behind = v_from / cmath.rect(branch.tap, math.radians(branch.shift))  # the ideal transformer
        series, from_end, to_end = _pi_model(branch)
        current_behind = (behind - v_to) * series + behind * from_end
        current_to = (v_to - behind) * series + v_to * to_end
        flows[name] = (behind * current_behind.conj(), v_to * current_to.conj())
    return flows


def _voltage(c: _Checker, bus: str) -> Any:
    angle = np.deg2rad(c.value("va", bus))
    return c.value("vm", bus) * (np.cos(angle) + 1j * np.sin(angle))


def _pi_model(branch: Branch) -> tuple[complex, complex, complex]:
    """Series admittance and the shunts at the from and the to end."""
    from_end = complex(branch.g / 2 + branch.g_from, branch.b / 2 + branch.b_from)
    to_end = complex(branch.g / 2 + branch.g_to, branch.b / 2 + branch.b_to)
    return 1 / complex(branch.r, branch.x), from_end, to_end


def _soc_flows(c: _Checker) -> Flows:
    """The π model on products of voltages, which must lie in their cone."""
    flows = {}
    for name, branch in c.of(Branch, "branch").items():
        w_from, w_to = c.value("w", branch.from_bus), c.value("w", branch.to_bus)
        product = c.value("wr", name) + 1j * c.value("wi", name)  # v_from v_to*
        c.note("voltage products", name, np.abs(product) ** 2 - w_from * w_to, "p.u.")
        series, from_end, to_end = _pi_model(branch)
        ratio = cmath.rect(branch.tap, math.radians(branch.shift))
        at_from = (series + from_end).conjugate() * w_from / abs(ratio) ** 2
        at_to = (series + to_end).conjugate() * w_to
        across = series.conjugate() * product / ratio
        back = series.conjugate() * product.conj() / ratio.conjugate()
        flows[name] = (at_from - across, at_to - back)
    return flows


def _dc_flows(c: _Checker) -> Flows:
    """Susceptance x / (r² + x²) times the angle."""
    return _lossless(c, lambda branch: (-(1 / complex(branch.r, branch.x)).imag, 0.0))


def _dc_matpower_flows(c: _Checker) -> Flows:
    """Susceptance 1 / (x tap) times the angle behind the phase shift."""
    return _lossless(c, lambda branch: (1 / (branch.x * branch.tap), branch.shift))


def _lossless(c: _Checker, model: Callable[[Branch], tuple[float, float]]) -> Flows:
    flows = {}
    for name, branch in c.of(Branch, "branch").items():
        susceptance, shift = model(branch)
        flow = susceptance * np.deg2rad(c.angle(name, branch) - shift) + 0j
        flows[name] = (flow, -flow)
    return flows


def _dc_losses_flows(c: _Checker) -> Flows:
    """The lossless flow and half of a loss at either end, which must be at least g angle²."""
    flows = {}
    for name, (flow, _) in _dc_flows(c).items():
        branch = c.network[name]
        assert isinstance(branch, Branch)
        loss = c.value("loss", name) / c.base
        least = (1 / complex(branch.r, branch.x)).real * np.deg2rad(c.angle(name, branch)) ** 2
        c.note("branch loss", name, c.base * np.maximum(least - loss, -loss), "MW")
        flows[name] = (flow + loss / 2, -flow + loss / 2)
    return flows


def _no_flows(_: _Checker) -> Flows:
    return {}


def _reported_flows(c: _Checker) -> Flows:
    """Of a formulation that is not known here: the flows that it reports, if it does."""
    c.leave_out(f"branch equations of the formulation {c.formulation!r}")
    limits = [branch.angle for branch in c.of(Branch, "branch").values()]
    if not c.angles_known and any(least > -360 or most < 360 for least, most in limits):
        c.leave_out("angle differences")
    if c.reactive and not {"vm", "w"} & set(c.data):
        c.leave_out("voltages")
    flows = {}
    if c.flows_reported:
        for name in c.of(Branch, "branch"):
            ends = [c.power(p, q, name) for p, q in (("pf", "qf"), ("pt", "qt"))]
            flows[name] = (ends[0], ends[1])
    return flows


_FLOWS: dict[str, Callable[[_Checker], Flows]] = {
    "ac": _ac_flows,
    "ac-rectangular": _ac_flows,
    "soc": _soc_flows,
    "dc": _dc_flows,
    "dc-matpower": _dc_matpower_flows,
    "dc-losses": _dc_losses_flows,
    "copperplate": _no_flows,
}
