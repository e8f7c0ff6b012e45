"""Components of opfmodel from those of PyPSA, with the equations and sign conventions of PyPSA."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np

from opfmodel.data.series import SeriesKey
from opfmodel.errors import CaseError
from opfmodel.network.cases.pypsa.source import Array, Source, Value
from opfmodel.network.cases.warn import warn
from opfmodel.network.component import Component
from opfmodel.network.components import Branch, Bus, DCLine, Generator, Load, Shunt, Storage
from opfmodel.network.components.dc_line import MOST_LOSS
from opfmodel.network.costs import Polynomial
from opfmodel.network.network import Network

__all__ = ["Converter"]


class Converter:
    """Convert the components of a PyPSA network, class by class.

    Parameters
    ----------
    source
        The network.
    voltage
        Voltage limits of buses without, p.u.
    free_dispatch
        Whether ``p_set`` is the set-point of a power flow only.

    Attributes
    ----------
    series
        Time series of the fields that vary.
    """

    def __init__(self, source: Source, voltage: tuple[float, float], free_dispatch: bool) -> None:
        self.source = source
        self.voltage = voltage
        self.free_dispatch = free_dispatch
        self.series: dict[SeriesKey, Array] = {}
        self.network = Network(source.network_name, base_mva=1.0)

    def convert(self) -> Network:
        """Declare all components."""
        source = self.source
        grid = self._grid()
        references = set(grid.c.sub_networks.static.slack_bus)
        places = source.static("buses")[["x", "y"]].to_numpy(dtype=float)
        self._placed = bool(np.isfinite(places).all() and places.any())  # by default all are at the origin
        for bus in source.buses:
            self._bus(bus, bus in references)
        for class_name in ("lines", "transformers"):
            table = getattr(grid.c, class_name).static
            for member in source.members(class_name):
                self._branch(class_name, member, table.loc[member])
        stated, found = (n.c.generators.static.control for n in (source.n, grid))
        for member in source.members("generators"):  # of the inactive ones, PyPSA finds none
            self._generator(member, found.get(member, stated.at[member]) in ("PV", "Slack"))
        for member in source.members("storage_units"):
            self._storage_unit(member)
        for member in source.members("stores"):
            self._store(member)
        for member in source.members("loads"):
            self._load(member)
        for member in source.members("shunt_impedances"):
            self._shunt(member)
        for member in source.members("links"):
            self._link(member)
        return self.network

    def _grid(self) -> Any:
        """Copy of the passive network and the active generators, with per-unit values and slack buses.

        PyPSA derives these in place; the network of the user is left as it is.
        """
        grid = _empty().copy()
        for class_name in ("line_types", "transformer_types", "buses", "lines", "transformers", "generators"):
            table = self.source.static(class_name)
            if class_name == "generators":
                table = table.loc[self.source.active(class_name)]
            getattr(grid.c, class_name).static = table.copy()
        try:
            grid.calculate_dependent_values()
        except ValueError as error:  # an unknown type
            raise CaseError(f"{self.source.title}: {error}") from error
        grid.determine_network_topology()
        for part in grid.c.sub_networks.static.obj:
            part.find_slack_bus()
        return grid

    def _put(self, name: str, field: str, value: Value) -> float:
        """Record the time series of a field, if it varies; return its first value."""
        values = np.atleast_1d(np.asarray(value, dtype=float)) + 0.0  # without negative zeros
        if len(values) > 1 and not (values == values[0]).all():
            self.series[SeriesKey(name, field)] = values
        return float(values[0])

    def _add(self, class_name: str, member: Any, component: Component) -> None:
        self.network.add(self.source.names[class_name, member], component)

    def _bus(self, bus: Any, reference: bool) -> None:
        row = self.source.static("buses").loc[bus]
        low, high = float(row.v_mag_pu_min), float(row.v_mag_pu_max)
        low = low if low > 0.0 else min(self.voltage[0], high)
        high = high if high < math.inf else max(self.voltage[1], low)
        x, y = (float(row.x), float(row.y)) if self._placed else (None, None)
        self._add("buses", bus, Bus(vm=(low, high), base_kv=float(row.v_nom), reference=reference, x=x, y=y))

    def _branch(self, class_name: str, member: Any, row: Any) -> None:
        name = self.source.names[class_name, member]
        s_max_pu = self.source.value(class_name, member, "s_max_pu")
        closed = np.equal(s_max_pu, 0.0)  # 0 times infinity is 0
        rating = self._put(name, "rating", np.where(closed, 0.0, s_max_pu) * np.where(closed, 0.0, row.s_nom))
        tap, shift, base = 1.0, 0.0, 1.0
        if class_name == "transformers":
            tap, shift = float(row.tap_ratio) or 1.0, float(row.phase_shift)  # as in PyPSA, 0 means 1
            if row.tap_side not in (0, 1):
                raise CaseError(
                    f"{self.source.title}: transformer {member!r}: tap_side = {row.tap_side}: must be 0 or 1"
                )
            if row.tap_side == 1:  # an ideal transformer moves to the other side with the square of its ratio
                base, tap = tap**2, 1.0 / tap
        self._add(
            class_name,
            member,
            Branch(
                str(row.bus0),
                str(row.bus1),
                r=float(row.r_pu) * base,
                x=float(row.x_pu) * base,
                b=float(row.b_pu) / base,
                g=float(row.g_pu) / base,
                rating=None if rating == math.inf else rating,
                tap=tap,
                shift=shift,
                angle=(max(float(row.v_ang_min), -360.0), min(float(row.v_ang_max), 360.0)),
                in_service=bool(row.active),
            ),
        )

    def _generator(self, member: Any, regulates: bool) -> None:
        name = self.source.names["generators", member]

        def value(attribute: str) -> Value:
            return self.source.value("generators", member, attribute)

        row = self.source.static("generators").loc[member]
        sign, p_nom = float(row.sign), float(row.p_nom)
        if sign == 0.0:
            raise CaseError(f"{self.source.title}: generator {member!r}: sign = 0: must differ from 0")
        ends = sign * p_nom * value("p_min_pu"), sign * p_nom * value("p_max_pu")
        p_set = sign * value("p_set")
        low, high = self._fixed(p_set, *(ends if sign > 0 else ends[::-1]))
        self._add(
            "generators",
            member,
            Generator(
                str(row.bus),
                p=(self._put(name, "p_min", low), self._put(name, "p_max", high)),
                ramp=self._ramp(member, name, abs(sign * p_nom)),
                cost=Polynomial(
                    c2=self._put(name, "c2", value("marginal_cost_quadratic") / sign**2),
                    c1=self._put(name, "c1", value("marginal_cost") / sign),
                ),
                pg_set=_first(p_set),
                qg_set=sign * self.source.first("generators", member, "q_set"),
                vm_set=self.source.first("buses", row.bus, "v_mag_pu_set"),
                regulates=regulates,
                in_service=bool(row.active),
            ),
        )

    def _fixed(self, p_set: Value, low: Value, high: Value) -> tuple[Value, Value]:
        """Limits of a power, which a set-point replaces in the snapshots that have one."""
        if self.free_dispatch:
            return low, high
        return np.where(np.isnan(p_set), low, p_set), np.where(np.isnan(p_set), high, p_set)

    def _ramp(self, member: Any, name: str, p_nom: float) -> float | None:
        """Ramp limit, MW/h; PyPSA's is per snapshot."""
        limit = np.fmin(*self.source.ramp_limits(member)) * p_nom / self.source.hours
        first = self._put(name, "ramp", np.where(np.isnan(limit), math.inf, limit))
        return None if first == math.inf else first

    def _storage_unit(self, member: Any) -> None:
        def first(attribute: str) -> float:
            return self.source.first("storage_units", member, attribute)

        least, most = (
            -first("p_nom") * self.source.value("storage_units", member, attribute)
            for attribute in ("p_max_pu", "p_min_pu")  # positive power discharges
        )
        self._storage(
            "storage_units",
            member,
            power=(least, most),
            initial=first("state_of_charge_initial"),
            efficiency=(first("efficiency_store"), first("efficiency_dispatch")),
        )

    def _store(self, member: Any) -> None:
        _, high = self.source.energy("stores", member)
        most = float(np.max(high)) / self.source.hours  # any change of energy within a snapshot
        initial = self.source.first("stores", member, "e_initial")
        self._storage("stores", member, power=(-most, most), initial=initial, efficiency=(1.0, 1.0))

    def _storage(
        self,
        class_name: str,
        member: Any,
        *,
        power: tuple[Value, Value],
        initial: float,
        efficiency: tuple[float, float],
    ) -> None:
        name = self.source.names[class_name, member]
        row = self.source.static(class_name).loc[member]
        low, high = self.source.energy(class_name, member)
        self._put(name, "energy", high)
        self._put(name, "energy_min", low)
        loss = self.source.first(class_name, member, "standing_loss")
        p_set = -self.source.value(class_name, member, "p_set")
        q = -self.source.first(class_name, member, "q_set") + 0.0
        least, most = self._fixed(p_set, *power)
        self._add(
            class_name,
            member,
            Storage(
                str(row.bus),
                energy=float(np.max(high)),
                energy_min=float(np.min(low)) + 0.0,
                power=(self._put(name, "power_min", least), self._put(name, "power_max", most)),
                q=(min(q, 0.0), max(q, 0.0)),
                initial=None
                if self.source.cyclic(class_name, member)
                else self._initial(name, initial, loss, high),
                charge_efficiency=efficiency[0],
                discharge_efficiency=efficiency[1],
                standing_loss=self._per_hour(loss),
                ps_set=_first(p_set),
                qs_set=q,
                in_service=bool(row.active),
            ),
        )

    def _initial(self, name: str, initial: float, loss: float, high: Array) -> float:
        """Initial energy of which as much is left after the first snapshot as in PyPSA.

        In PyPSA's optimum, the energy before the first snapshot has no standing loss.
        """
        kept = (1.0 - loss) ** self.source.hours
        before = initial / kept if kept > 0.0 else initial
        most = max(float(np.max(high)), initial)
        if before > most:
            warn(
                f"{self.source.title}: {name!r}: PyPSA takes no standing loss from the initial energy of "
                f"{initial:g} MWh in the first snapshot; opfmodel takes {initial - kept * most:g} MWh"
            )
        return min(before, most)

    def _per_hour(self, loss: float) -> float:
        """Standing loss with which a step keeps as much as in PyPSA, where losses compound."""
        hours = self.source.hours
        return loss if hours == 1.0 else (1.0 - (1.0 - loss) ** hours) / hours

    def _load(self, member: Any) -> None:
        name, row = self.source.names["loads", member], self.source.static("loads").loc[member]
        p, q = (-float(row.sign) * self.source.value("loads", member, a) for a in ("p_set", "q_set"))
        load = Load(
            str(row.bus), p=self._put(name, "p", p), q=self._put(name, "q", q), in_service=bool(row.active)
        )
        self._add("loads", member, load)

    def _shunt(self, member: Any) -> None:
        row = self.source.static("shunt_impedances").loc[member]
        mva = float(self.source.static("buses").v_nom.at[row.bus]) ** 2  # of 1 S
        shunt = Shunt(str(row.bus), g=float(row.g) * mva, b=float(row.b) * mva, in_service=bool(row.active))
        self._add("shunt_impedances", member, shunt)

    def _link(self, member: Any) -> None:
        source, name = self.source, self.source.names["links", member]
        row = source.static("links").loc[member]
        p_set = source.value("links", member, "p_set")
        low, high = self._fixed(p_set, *source.link_power(member))
        line = DCLine(
            str(row.bus0),
            str(row.bus1),
            p=(self._put(name, "p_min", low), self._put(name, "p_max", high)),
            loss=min(max(1.0 - source.first("links", member, "efficiency"), 0.0), MOST_LOSS),
            cost=self._put(name, "cost", np.maximum(source.value("links", member, "marginal_cost"), 0.0)),
            pf_set=_first(p_set),
            in_service=bool(row.active),
        )
        self._add("links", member, line)


@cache
def _empty() -> Any:
    """Return a network without components; a copy is made sooner than a new one, which reads files."""
    import pypsa

    return pypsa.Network()


def _first(set_point: Value) -> float:
    """Set-point in the first snapshot; without one, PyPSA's power flow injects nothing."""
    first = float(np.ravel(set_point)[0])
    return 0.0 if math.isnan(first) else first + 0.0
