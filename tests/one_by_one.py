"""Scalar reference for :func:`opfmodel.check.check`: one component and one stage at a time.

The two-port admittances of a branch are those of MATPOWER's manual (equation 3.2), and the balance of a bus
sums over everything connected to it. No arrays, and no equations shared with the check.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator, Mapping, Sequence

import xarray as xr

import opfmodel as om

Series = Mapping[str, Sequence[float]]
Excess = tuple[str, str, float]
"""Family, component, and amount by which a limit is exceeded, in the physical unit."""


def excesses(grid: om.Network, data: xr.Dataset, series: Series) -> dict[str, list[tuple[str, float, float]]]:
    """Component, time and excess of every constraint, by family, for the built-in components in the data."""
    found: dict[str, list[tuple[str, float, float]]] = {}
    stages = each_stage(grid, data, series)
    for before, stage, after in zip([None, *stages], stages, [*stages[1:], None], strict=False):
        everything = (*stage.generators(before), *stage.storages(after), *stage.branches(), *stage.buses())
        for family, component, excess in everything:
            missing = math.isnan(excess)
            found.setdefault(family, []).append((component, stage.time, math.inf if missing else excess))
    return found


def cost(grid: om.Network, data: xr.Dataset, series: Series) -> float:
    """Operating cost over all stages, $."""
    return sum(stage.cost() for stage in each_stage(grid, data, series))


def each_stage(grid: om.Network, data: xr.Dataset, series: Series) -> list[Stage]:
    return [Stage(grid, data.isel(time=k), series, k) for k in range(data.sizes["time"])]


class Stage:
    """One stage of the data, with powers in MW and MVAr."""

    def __init__(self, grid: om.Network, data: xr.Dataset, series: Series, k: int) -> None:
        self.grid, self.series, self.k = grid, series, k
        self.time, self.hours = float(data["time"]), data.attrs["step_hours"]
        self.formulation = data.attrs["formulation"]
        self.data = {
            str(q): dict(zip(data[a.dims[0]].values.tolist(), a.values.tolist(), strict=True))
            for q, a in data.data_vars.items()
        }
        self.reactive = "qg" in self.data

    def limit(self, name: str, key: str, constant: float | None) -> float:
        values = self.series.get(f"{name}.{key}")
        return float(values[self.k]) if values is not None else math.inf if constant is None else constant

    def outside(self, name: str, key: str, value: float, pair: tuple[float, float]) -> float:
        low, high = self.limit(name, f"{key}_min", pair[0]), self.limit(name, f"{key}_max", pair[1])
        return max(low - value, value - high)

    # Devices

    def generators(self, before: Stage | None) -> Iterator[Excess]:
        for name, unit in self.grid.of(om.Generator).items():
            p, ramp = self.data["pg"][name], self.limit(name, "ramp", unit.ramp)
            yield "generator p", name, self.outside(name, "p", p, unit.p)
            if self.reactive:
                yield "generator q", name, self.outside(name, "q", self.data["qg"][name], unit.q)
            if before is not None:
                yield "ramp", name, abs(p - before.data["pg"][name]) - ramp * self.hours

    def storages(self, after: Stage | None) -> Iterator[Excess]:
        for name, store in self.grid.of(om.Storage).items():
            p, start, end = (self.data[key][name] for key in ("ps", "e", "e_next"))
            q = self.data["qs"][name] if self.reactive else 0.0
            power, reactive = (v if isinstance(v, tuple) else (-v, v) for v in (store.power, store.q))
            yield "storage power", name, self.outside(name, "power", p, power)
            yield "storage q", name, self.outside(name, "q", q, reactive)
            low, high = (self.limit(name, key, getattr(store, key)) for key in ("energy_min", "energy"))
            yield "storage energy", name, max(low - end, end - high)
            yield "storage rating", name, abs(complex(p, q)) - self.limit(name, "rating", store.rating)
            if after is not None:
                yield "energy continuity", name, abs(after.data["e"][name] - end)
            change = (end - start + store.standing_loss * self.hours * start) / self.hours
            stored = p * store.charge_efficiency if p > 0 else p / store.discharge_efficiency
            ideal = store.charge_efficiency == store.discharge_efficiency == 1
            yield "storage dynamics", name, abs(change - p) if ideal else change - stored

    def cost(self) -> float:
        total = 0.0
        for name, unit in self.grid.of(om.Generator).items():
            p = self.data["pg"][name]
            if isinstance(unit.cost, om.PiecewiseLinear):
                total += max(slope * p + offset for slope, offset in unit.cost.segments)
            else:
                c2, c1, c0 = (self.limit(name, key, getattr(unit.cost, key)) for key in ("c2", "c1", "c0"))
                total += c2 * p * p + c1 * p + c0
        return total * self.hours

    # Network

    def branches(self) -> Iterator[Excess]:
        for name, branch in self.grid.of(om.Branch).items():
            if self.formulation == "copperplate":
                continue
            at_from, at_to = self.flows(name, branch)
            for power in (at_from, at_to):
                yield "branch rating", name, abs(power) - self.limit(name, "rating", branch.rating)
            reported = {"pf": at_from.real, "qf": at_from.imag, "pt": at_to.real, "qt": at_to.imag}
            for quantity in reported.keys() & self.data.keys():
                yield "reported flow", name, abs(self.data[quantity][name] - reported[quantity])
            least, most = branch.angle
            angle = self.angle(name, branch)
            if least > -360 or most < 360:
                yield "angle difference", name, max(least - angle, angle - most)
            if self.formulation == "soc":
                w_from, w_to = self.data["w"][branch.from_bus], self.data["w"][branch.to_bus]
                product = self.data["wr"][name] ** 2 + self.data["wi"][name] ** 2
                yield "voltage products", name, product - w_from * w_to
            if self.formulation == "dc-losses":
                loss, conductance = self.data["loss"][name], branch.r / (branch.r**2 + branch.x**2)
                least_loss = self.grid.base_mva * conductance * math.radians(angle) ** 2
                yield "branch loss", name, max(least_loss - loss, -loss)

    def buses(self) -> Iterator[Excess]:
        balance = {bus: self.injection(bus) for bus in self.grid.of(om.Bus)}
        if self.formulation == "copperplate":  # the test grid is one island
            balance = {min(balance): sum(balance.values())}
        for name, power in balance.items():
            yield "active balance", name, abs(power.real)
            if self.reactive:
                yield "reactive balance", name, abs(power.imag)
        for name, bus in self.grid.of(om.Bus).items():
            if self.reactive:
                yield "voltage", name, self.outside(name, "vm", math.sqrt(self.voltage_squared(name)), bus.vm)
        for quantity in ("p_shortage", "q_shortage", "p_surplus", "q_surplus"):
            for name, value in self.data.get(quantity, {}).items():
                yield quantity.replace("_", " "), name, abs(value)

    def voltage_squared(self, bus: str) -> float:
        if not self.reactive:
            return 1.0
        return self.data["w"][bus] if self.formulation == "soc" else self.data["vm"][bus] ** 2

    def injection(self, bus: str) -> complex:
        power = 0j
        for kind, active, reactive, sign in ((om.Generator, "pg", "qg", 1), (om.Storage, "ps", "qs", -1)):
            for name in (name for name, unit in self.grid.of(kind).items() if unit.bus == bus):
                q = self.data[reactive][name] if self.reactive else 0.0
                power += sign * complex(self.data[active][name], q)
        for name, load in self.grid.of(om.Load).items():
            if load.bus == bus and load.in_service:
                power -= complex(self.limit(name, "p", load.p), self.limit(name, "q", load.q))
        for shunt in self.grid.of(om.Shunt).values():
            if shunt.bus == bus and shunt.in_service:
                power -= complex(shunt.g, -shunt.b) * self.voltage_squared(bus)
        for quantity, factor in (
            ("p_shortage", 1),
            ("q_shortage", 1j),
            ("p_surplus", -1),
            ("q_surplus", -1j),
        ):
            power += factor * self.data.get(quantity, {}).get(bus, 0.0)
        for name, branch in self.grid.of(om.Branch).items():
            if bus in branch.buses and self.formulation != "copperplate":
                power -= self.flows(name, branch)[branch.buses.index(bus)]
        return power

    def angle(self, name: str, branch: om.Branch) -> float:
        """Angle difference across a branch, degrees."""
        if self.formulation == "soc":
            return math.degrees(math.atan2(self.data["wi"][name], self.data["wr"][name]))
        return self.data["va"][branch.from_bus] - self.data["va"][branch.to_bus]

    def flows(self, name: str, branch: om.Branch) -> tuple[complex, complex]:
        """Power into both ends of a branch."""
        base, x, tap, shift = self.grid.base_mva, branch.x, branch.tap, math.radians(branch.shift)
        if self.formulation == "of another package":
            at_from, at_to = (
                (self.data[p][name], self.data[q][name]) for p, q in (("pf", "qf"), ("pt", "qt"))
            )
            return complex(*at_from), complex(*at_to)
        if self.formulation == "dc-matpower":
            flow = base * (math.radians(self.angle(name, branch)) - shift) / (x * tap)
            return complex(flow), complex(-flow)
        if self.formulation in ("dc", "dc-losses"):
            flow = base * x / (branch.r**2 + x**2) * math.radians(self.angle(name, branch))
            half = self.data.get("loss", {}).get(name, 0.0) / 2
            return complex(half + flow), complex(half - flow)
        series, ratio = 1 / complex(branch.r, x), tap * cmath.exp(1j * shift)
        y_tt = series + complex(branch.g / 2 + branch.g_to, branch.b / 2 + branch.b_to)
        y_ff = (series + complex(branch.g / 2 + branch.g_from, branch.b / 2 + branch.b_from)) / tap**2
        y_ft, y_tf = -series / ratio.conjugate(), -series / ratio
        if self.formulation == "soc":
            w_from, w_to = self.data["w"][branch.from_bus], self.data["w"][branch.to_bus]
            product = complex(self.data["wr"][name], self.data["wi"][name])
        else:
            v_from, v_to = (
                cmath.rect(self.data["vm"][bus], math.radians(self.data["va"][bus])) for bus in branch.buses
            )
            w_from, w_to, product = abs(v_from) ** 2, abs(v_to) ** 2, v_from * v_to.conjugate()
        at_from = y_ff.conjugate() * w_from + y_ft.conjugate() * product
        at_to = y_tt.conjugate() * w_to + y_tf.conjugate() * product.conjugate()
        return base * at_from, base * at_to
