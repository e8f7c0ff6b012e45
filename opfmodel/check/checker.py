"""The check of a trajectory: its data, and the violations that are found."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import chain
from operator import attrgetter

import numpy as np
import numpy.typing as npt

from opfmodel.check.equipment import EQUIPMENT
from opfmodel.check.flows import Flows, flows
from opfmodel.check.report import Report, Violation
from opfmodel.check.trajectories import Array, Bounds, Complex, Data, Items, Series, Trajectories
from opfmodel.network.component import Component
from opfmodel.network.components import BUILT_IN, Branch, Bus, Load, Shunt
from opfmodel.network.islands import connected
from opfmodel.network.network import Network

__all__ = ["Checker"]


class Checker:
    """Constraints of all kinds of components, evaluated as arrays ``(items, stages)``."""

    def __init__(
        self,
        network: Network,
        data: Data,
        series: Series | None,
        first: int,
        previous_pg: Mapping[str, float] | None = None,
    ) -> None:
        self.network, self.base, self.scale = network, network.base_mva, network.scale_mva
        self.trajectories = Trajectories(data, series, first)
        self.has = self.trajectories.has
        self.hours = self.trajectories.hours
        self.previous_pg = previous_pg
        self.formulation = str(data.attrs.get("formulation", "ac"))
        self.voltages_known = self.has("vm") or self.has("w")
        self.angles_known = self.has("va") or self.has("wr", "wi")
        self.reactive = self.voltages_known or self.has("qg") or self.has("qs")
        self.buses, self.branches = self.reported(Bus), self.reported(Branch)
        self.position = {bus: i for i, bus in enumerate(self.buses.names)}
        kinds = dict.fromkeys(type(c) for c in network.of(Component).values() if c.in_service)
        self.others = [kind for kind in kinds if not issubclass(kind, BUILT_IN)]  # from other packages
        self.report = Report(currency=network.currency)
        self.equipment = [checked(self) for checked in EQUIPMENT]

    def run(self) -> Report:
        """Run all checks."""
        for equipment in self.equipment:
            equipment.check()
        for kind in self.others:
            self.leave_out(f"limits and cost of the {kind.plural}")
        flow = flows(self)
        if self.voltages_known:
            magnitude = np.sqrt(self.voltage_squared(self.buses.names))
            self.inside("voltage", self.buses, magnitude, self.buses.bounds("vm"), "p.u.")
        if flow is not None:
            self.check_branches(flow)
        if self.angles_known:
            limited = self.branches.where(self.limited_angles())
            angles = np.where(limited.status() > 0, self.angles()[self.limited_angles()], 0.0)
            (low, high), (least, most) = limited.span("angle"), limited.span("shift")
            if not self.has("va"):  # those behind adjustable phase shifters
                low, high = low - np.where(least < most, most, 0.0), high - np.where(least < most, least, 0.0)
            self.inside("angle difference", limited, angles, (low, high), "deg")
        self.check_balance(flow)
        self.report.cost = float(self.cost_rate() @ self.hours)
        return self.report

    def cost_rate(self) -> Array:
        """Operating cost in each stage, $/h."""
        rate = np.zeros(len(self.hours))
        for equipment in self.equipment:
            rate += equipment.cost_rate()
        return rate

    def table(self, members: Mapping[str, Component]) -> Items:
        """Make a table of components."""
        kind = next((member.kind for member in members.values()), "")
        resolved = [member.resolved() for member in members.values()]
        return Items(list(members), resolved, self.trajectories, kind)

    def reported(self, kind: type[Component]) -> Items:
        """Components of a class that are in the data, in order of declaration."""
        present = self.trajectories.position(kind.kind)
        return self.table({n: c for n, c in self.network.of(kind).items() if n in present})

    def at_work(self, kind: type[Load | Shunt]) -> Items:
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

    def inside(self, family: str, items: Items, values: Array, bounds: Bounds, unit: str) -> None:
        """Check ``low <= values <= high``."""
        low, high = bounds
        self.note(family, items.names, np.maximum(low - values, values - high), unit)

    def continuous(self, family: str, items: Items, start: Array, end: Array, unit: str) -> None:
        """Check that a stored quantity starts each stage as it ended the one before."""
        gap = np.zeros_like(start)  # the last stage has no successor
        gap[:, :-1] = np.abs(start[:, 1:] - end[:, :-1])
        self.note(family, items.names, gap, unit)

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
        """Complex power injected into each bus by equipment, p.u."""
        buses = self.buses
        total = np.zeros((len(buses.names), len(self.hours)), dtype=complex)
        for at, power in chain(
            chain.from_iterable(equipment.power() for equipment in self.equipment),
            ((buses.names, self.power(f"{k.kind}_p", f"{k.kind}_q", buses)) for k in self.others),
            ((buses.names, self.lacking("p_shortage", "q_shortage", buses)),),
            ((buses.names, -self.lacking("p_surplus", "q_surplus", buses)),),
        ):
            np.add.at(total, [self.position[bus] for bus in at], power)
        return total

    def power(self, active: str, reactive: str, items: Items) -> Complex:
        """Complex power, p.u."""
        q = items.values(reactive) if self.reactive and self.has(reactive) else 0.0
        return np.asarray((items.values(active) + 1j * q) / self.base)

    def lacking(self, active: str, reactive: str, items: Items) -> Complex:
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
        pairs = [b.buses for b in self.network.of(Branch).values() if b.in_service]
        within = (pair for pair in pairs if self.position.keys() >= set(pair))
        return [sorted(members) for members in connected(self.position, within)]
