"""Independent verification of results: every constraint and the cost, from data alone.

This module shares no equations with the rest of the package: it works on the declared components
and on trajectories in physical units, with complex arithmetic, and knows neither programs nor
solvers. What it finds is evidence about them.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from opfmodel.components import (
    Branch,
    Bus,
    Generator,
    Load,
    Network,
    PiecewiseLinear,
    Polynomial,
    Shunt,
    Storage,
)

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Report", "Violation", "check", "economic_cost", "losses"]

Array = npt.NDArray[np.float64]
Series = Mapping[str, npt.ArrayLike]


@dataclass(frozen=True)
class Violation:
    """The largest violation of one family of constraints.

    Attributes
    ----------
    value
        In p.u. (powers, voltages, energies in p.u. h) or radians.
    component, time
        Where it is, and the coordinate of its stage.
    """

    family: str
    value: float
    component: str
    time: float


@dataclass
class Report:
    """What :func:`check` found.

    Attributes
    ----------
    violations
        The largest violation by family of constraints, also where it is zero.
    cost
        Operating cost over all stages, recomputed, in $.
    simultaneous
        Largest power in p.u. by which a storage with losses charges and discharges at once; it
        is no violation but says that the storage model was not tight.
    """

    violations: dict[str, Violation] = field(default_factory=dict)
    cost: float = 0.0
    simultaneous: float = 0.0

    @property
    def max_violation(self) -> float:
        """The largest violation of all."""
        return max((v.value for v in self.violations.values()), default=0.0)

    @property
    def worst(self) -> Violation | None:
        """The family with the largest violation."""
        return max(self.violations.values(), key=lambda v: v.value, default=None)

    def __str__(self) -> str:
        lines = [
            f"{v.family:<22} {v.value:10.3e}  at {v.component}, time {v.time:g}"
            for v in sorted(self.violations.values(), key=lambda v: -v.value)
        ]
        return "\n".join([*lines, f"{'cost':<22} {self.cost:.6f} $"])


def check(
    network: Network,
    data: xr.Dataset,
    series: Series | None = None,
    first: int = 0,
    previous_pg: Mapping[str, float] | None = None,
) -> Report:
    """Recompute every constraint of an AC trajectory and its operating cost.

    Parameters
    ----------
    network
        The declared network.
    data
        Trajectories as in ``plan.data`` or ``run.data``: ``vm``, ``va``, ``pg``, ``qg`` and, with
        storage, ``ps``, ``qs``, ``e``, ``e_next``, in physical units, over ``time``.
    series
        Time series by ``"component.field"``; other fields are constant.
    first
        Position in the series of the first stage of ``data``.
    previous_pg
        Dispatch before the first stage, MW by generator, if its ramp is to be checked.

    Returns
    -------
    Report
    """
    return _Checker(network, data, dict(series or {}), first).run(previous_pg)


def economic_cost(network: Network, data: xr.Dataset, series: Series | None = None, first: int = 0) -> Array:
    """Operating cost of the generators in each stage, $/h, from ``pg`` and the declared costs."""
    return _Checker(network, data, dict(series or {}), first).cost_rate()


def losses(network: Network, data: xr.Dataset) -> Array:
    """Active losses of all branches in each stage, MW, from voltages: the sum of both ends."""
    flows = _Checker(network, data, {}, 0).branch_flows()
    total: Array = np.sum([f.real + t.real for f, t in flows.values()], axis=0)
    return total * network.base_mva


class _Checker:
    """One pass over the components of a network and the stages of a trajectory."""

    def __init__(self, network: Network, data: xr.Dataset, series: dict[str, Any], first: int) -> None:
        self.network = network
        self.base = network.base_mva
        self.data = data
        self.series = series
        self.first = first
        self.times = np.asarray(data["time"].values, dtype=float)
        self.step = float(data.attrs.get("step_hours", 1.0))
        self.buses = {n: b for n, b in network.of(Bus).items() if n in set(data["bus"].values)}
        self.report = Report()

    def run(self, previous_pg: Mapping[str, float] | None) -> Report:
        """Check everything."""
        self.check_voltages()
        self.check_branches()
        self.check_generators(previous_pg)
        self.check_storages()
        self.check_balance()
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
        values = self.series.get(f"{component}.{key}")
        if values is not None:
            return np.asarray(values, dtype=float)[self.first : self.first + len(self.times)]
        return np.full(len(self.times), math.inf if constant is None else constant)

    def note(self, family: str, component: str, excess: Array, unit: float) -> None:
        """Keep the largest violation of a family; ``unit`` is the physical value of 1 p.u."""
        values = np.where(np.isnan(excess), np.inf, excess) / unit
        worst = int(np.argmax(values)) if values.size else 0
        value = max(float(values[worst]), 0.0) if values.size else 0.0
        known = self.report.violations.get(family)
        if known is None or value > known.value:
            self.report.violations[family] = Violation(family, value, component, float(self.times[worst]))

    def inside(
        self, family: str, component: str, values: Array, low: Array, high: Array, unit: float
    ) -> None:
        """Check ``low <= values <= high``."""
        self.note(family, component, np.maximum(low - values, values - high), unit)

    def bounds(self, component: str, key: str, pair: tuple[float, float]) -> tuple[Array, Array]:
        """Minimum and maximum of a span field over the stages."""
        return self.declared(component, f"{key}_min", pair[0]), self.declared(
            component, f"{key}_max", pair[1]
        )

    # Network -----------------------------------------------------------------------------

    def voltage(self, bus: str) -> Any:
        """Complex voltage of a bus, p.u."""
        angle = np.deg2rad(self.value("va", bus))
        return self.value("vm", bus) * (np.cos(angle) + 1j * np.sin(angle))

    def check_voltages(self) -> None:
        """Voltage magnitudes lie in their range."""
        for name, bus in self.buses.items():
            low, high = self.bounds(name, "vm", bus.vm)
            self.inside("voltage", name, self.value("vm", name), low, high, 1.0)

    def branch_flows(self) -> dict[str, tuple[Any, Any]]:
        """Complex power into both ends of each branch, p.u."""
        flows = {}
        for name, branch in self.of(Branch, "branch").items():
            series = 1 / complex(branch.r, branch.x)
            from_end = complex(branch.g / 2 + branch.g_from, branch.b / 2 + branch.b_from)
            to_end = complex(branch.g / 2 + branch.g_to, branch.b / 2 + branch.b_to)
            ratio = cmath.rect(branch.tap, math.radians(branch.shift))
            v_from, v_to = self.voltage(branch.from_bus), self.voltage(branch.to_bus)
            behind = v_from / ratio  # voltage behind the ideal transformer
            current_behind = (behind - v_to) * series + behind * from_end
            current_to = (v_to - behind) * series + v_to * to_end
            flows[name] = (behind * current_behind.conj(), v_to * current_to.conj())
        return flows

    def check_branches(self) -> None:
        """Flows as reported, ratings at both ends, angle differences."""
        for name, (at_from, at_to) in self.branch_flows().items():
            branch = self.network[name]
            assert isinstance(branch, Branch)
            for end, p, q in ((at_from, "pf", "qf"), (at_to, "pt", "qt")):
                for reported, power in ((p, end.real), (q, end.imag)):
                    if reported in self.data:
                        difference = np.abs(self.value(reported, name) / self.base - power)
                        self.note("reported flow", name, difference, 1.0)
                rating = self.declared(name, "rating", branch.rating)
                self.note("branch rating", name, np.abs(end) - rating / self.base, 1.0)
            low, high = branch.angle
            if low > -360 or high < 360:
                angle = self.value("va", branch.from_bus) - self.value("va", branch.to_bus)
                bounds = (np.full(angle.shape, low), np.full(angle.shape, high))
                self.inside("angle difference", name, angle, *bounds, math.degrees(1.0))

    def check_balance(self) -> None:
        """Complex power is balanced at every bus."""
        total = {bus: np.zeros(len(self.times), dtype=complex) for bus in self.buses}
        for name, generator in self.of(Generator, "generator").items():
            total[generator.bus] += (self.value("pg", name) + 1j * self.value("qg", name)) / self.base
        for name, storage in self.of(Storage, "storage").items():
            total[storage.bus] -= (self.value("ps", name) + 1j * self.value("qs", name)) / self.base
        for name, load in self.network.of(Load).items():
            if load.in_service and load.bus in total:
                p, q = self.declared(name, "p", load.p), self.declared(name, "q", load.q)
                total[load.bus] -= (p + 1j * q) / self.base
        for shunt in self.network.of(Shunt).values():
            if shunt.in_service and shunt.bus in total:
                drawn = complex(shunt.g, -shunt.b) / self.base
                total[shunt.bus] -= drawn * np.abs(self.voltage(shunt.bus)) ** 2
        for name, (at_from, at_to) in self.branch_flows().items():
            branch = self.network[name]
            assert isinstance(branch, Branch)
            total[branch.from_bus] -= at_from
            total[branch.to_bus] -= at_to
        for bus, power in total.items():
            self.note("active balance", bus, np.abs(power.real), 1.0)
            self.note("reactive balance", bus, np.abs(power.imag), 1.0)

    # Devices -----------------------------------------------------------------------------

    def check_generators(self, previous_pg: Mapping[str, float] | None) -> None:
        """Active and reactive limits and ramps."""
        for name, generator in self.of(Generator, "generator").items():
            pg = self.value("pg", name)
            self.inside("generator p", name, pg, *self.bounds(name, "p", generator.p), self.base)
            self.inside(
                "generator q", name, self.value("qg", name), *self.bounds(name, "q", generator.q), self.base
            )
            if generator.ramp is not None:
                before = math.nan if previous_pg is None else previous_pg[name]
                change = np.abs(np.diff(pg, prepend=before))
                change[np.isnan(change)] = 0.0
                ramp = self.declared(name, "ramp", generator.ramp)
                self.note("ramp", name, change - ramp * self.step, self.base)

    def check_storages(self) -> None:
        """Power, energy and apparent-power limits, and the energy balance of each storage."""
        for name, declared in self.of(Storage, "storage").items():
            storage = declared.resolved()
            ps, qs = self.value("ps", name), self.value("qs", name)
            e, e_next = self.value("e", name), self.value("e_next", name)
            for key, values, pair in (("power", ps, storage.power), ("q", qs, storage.q)):
                ends = pair if isinstance(pair, tuple) else (-pair, pair)
                self.inside(f"storage {key}", name, values, *self.bounds(name, key, ends), self.base)
            low = self.declared(name, "energy_min", storage.energy_min)
            high = self.declared(name, "energy", storage.energy)
            self.inside("storage energy", name, e_next, low, high, self.base)
            rating = self.declared(name, "rating", storage.rating)
            self.note("storage rating", name, np.hypot(ps, qs) - rating, self.base)
            self.note("energy continuity", name, np.abs(e[1:] - e_next[:-1]), self.base)
            stored = (e_next - (1 - storage.standing_loss * self.step) * e) / self.step
            self._check_efficiency(name, storage, ps, stored)

    def _check_efficiency(self, name: str, storage: Storage, ps: Array, stored: Array) -> None:
        gain, drain = storage.charge_efficiency, 1 / storage.discharge_efficiency
        if gain == drain:  # lossless
            self.note("storage dynamics", name, np.abs(stored - ps), self.base)
            return
        # of all splits into charging and discharging the one with nothing at once stores most
        most = np.where(ps >= 0, gain * ps, drain * ps)
        self.note("storage dynamics", name, stored - most, self.base)
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
