"""Networks of PyPSA, with their snapshots and time series.

What opfmodel does not represent is reported by :mod:`opfmodel.network.cases.pypsa_attributes`. Equations
are those of PyPSA's power flow; impedances are per unit on 1 MVA, as there.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from opfmodel.data.series import Profiles, SeriesKey
from opfmodel.errors import CaseError, OpfmodelError, listed
from opfmodel.network.cases.losses import Losses
from opfmodel.network.cases.pypsa_attributes import add_losses
from opfmodel.network.cases.pypsa_time import steps_of
from opfmodel.network.cases.warn import warn
from opfmodel.network.component import Component
from opfmodel.network.components import Branch, Bus, Generator, Load, Shunt, Storage
from opfmodel.network.costs import Polynomial
from opfmodel.network.network import Network
from opfmodel.network.series import check_series

if TYPE_CHECKING:
    import pypsa

__all__ = ["from_pypsa"]

Array = npt.NDArray[np.float64]
Value = float | Array

_UNNAMED = "Unnamed Network"  # PyPSA's name of a network without one
# Prefix of a name that components of several classes have.
_PREFIXES = {
    "lines": "line",
    "transformers": "transformer",
    "generators": "generator",
    "loads": "load",
    "storage_units": "storage_unit",
    "stores": "store",
    "shunt_impedances": "shunt",
}


def from_pypsa(
    n: pypsa.Network,
    *,
    lossy: bool = False,
    voltage: tuple[float, float] = (0.9, 1.1),
    free_dispatch: bool = False,
) -> Network:
    """Convert a network of PyPSA; its time series become :attr:`Network.profiles`.

    Components keep their names. PyPSA's are unique within a class only: a name that several classes have
    stays with the bus, and the others are called ``line_NAME``, ``transformer_NAME``, ``generator_NAME``,
    ``load_NAME``, ``storage_unit_NAME``, ``store_NAME`` and ``shunt_NAME``. Constant values are those of
    the first snapshot.

    Parameters
    ----------
    n
        The network, which is not changed.
    lossy
        Warn about what opfmodel does not represent, and convert the rest, instead of raising an error.
    voltage
        ``(min, max)`` of the voltage magnitude, p.u., at buses without ``v_mag_pu_min`` or
        ``v_mag_pu_max``, which PyPSA leaves at 0 and infinity.
    free_dispatch
        Take ``p_set`` of generators, storage units and stores for the set-point of a power flow only. By
        default it also fixes their power, as in ``n.optimize()``.

    Raises
    ------
    CaseError
        The network contains what opfmodel does not represent, or invalid data; or its snapshots are
        not equally spaced.

    Notes
    -----
    ``n.optimize()`` is the formulation ``dc-matpower``, except that it neglects phase shifts, the power
    of shunts, and the magnetising branch of transformers in their reactance. Standing losses, ramp limits
    and the power limits of stores depend on the length of the snapshots and are converted for it. The
    initial energy is larger than PyPSA's by the standing loss of one snapshot, which PyPSA leaves out.
    """
    import pypsa

    if not isinstance(n, pypsa.Network):
        raise CaseError(f"from_pypsa: {type(n).__name__}: must be a pypsa.Network")
    source = "PyPSA network" if n.name in ("", _UNNAMED) else f"PyPSA network {n.name!r}"
    losses = Losses(source)
    if n.has_scenarios:
        first = n.scenarios[0]
        losses.add(f"{len(n.scenarios)} scenarios: only {first!r} is read")
        n = n.get_scenario(first)
    hours, calendar = steps_of(n, source, losses)
    reader = _Reader(n, source, hours, voltage, free_dispatch)
    reader.add_losses(losses)
    losses.settle(lossy)
    try:
        network = reader.read()
        network.attach(Profiles(reader.series, calendar))
        check_series(network.profiles, network)
    except CaseError:
        raise
    except OpfmodelError as error:
        raise CaseError(f"{source}: {error}") from error
    return network


class _Reader:
    """Convert the components of a PyPSA network, class by class."""

    def __init__(
        self, n: Any, source: str, hours: float, voltage: tuple[float, float], free_dispatch: bool
    ) -> None:
        self.n = n
        self.source = source
        self.hours = hours
        self.voltage = voltage
        self.free_dispatch = free_dispatch
        self.series: dict[SeriesKey, Array] = {}
        self.network = Network("network" if n.name in ("", _UNNAMED) else str(n.name), base_mva=1.0)
        carriers = n.c.buses.static.carrier
        self.buses = [bus for bus in n.c.buses.static.index if carriers.at[bus] == "AC"]
        self._of_class = {name: list(self._at_buses(name)) for name in _PREFIXES}
        self.names = self._unique_names()

    # What is read ------------------------------------------------------------------------

    def _static(self, class_name: str) -> Any:
        return getattr(self.n.c, class_name).static

    def _at_buses(self, class_name: str) -> Iterator[Any]:
        """Names of the components of a class at buses that are represented."""
        table, represented = self._static(class_name), set(self.buses)
        columns = [c for c in ("bus", "bus0", "bus1") if c in table]
        known = set(self.n.c.buses.static.index)
        for name, *buses in table[columns].itertuples():
            for column, bus in zip(columns, buses, strict=True):
                if bus not in known:
                    raise CaseError(
                        f"{self.source}: {_PREFIXES[class_name]} {name!r}: {column} = {bus!r}: no such bus"
                    )
            if represented.issuperset(buses):
                yield name

    def _unique_names(self) -> dict[tuple[str, Any], str]:
        """Name of each component in opfmodel, by class and name in PyPSA."""
        names = {("buses", bus): str(bus) for bus in self.buses}
        uses = Counter(names.values())
        for members in self._of_class.values():
            uses.update(str(name) for name in members)
        taken = set(uses)
        for class_name, members in self._of_class.items():
            for member in members:
                name = str(member)
                if uses[name] > 1:
                    name = f"{_PREFIXES[class_name]}_{name}"
                    while name in taken:
                        name += "_"
                    taken.add(name)
                names[class_name, member] = name
        return names

    def _active(self, class_name: str) -> list[Any]:
        active = self._static(class_name).active
        return [name for name in self._of_class[class_name] if active.at[name]]

    # What is lost ------------------------------------------------------------------------

    def add_losses(self, losses: Losses) -> None:
        """Report what is not represented."""
        represented = set(self.buses)
        for bus, carrier in self.n.c.buses.static.carrier.items():
            if bus not in represented:
                losses.add(
                    f"bus {bus!r}: carrier = {carrier!r}: only AC is represented; left out with all at it"
                )
        kept = {"buses": self.buses} | {name: self._active(name) for name in _PREFIXES}
        for components in self.n.components:
            if components.list_name not in kept and len(components.static):
                table = components.static
                kept[components.list_name] = list(
                    table.index[table.active] if "active" in table else table.index
                )
        add_losses(self.n, kept, losses)
        for name in kept["generators"]:
            self._ramp_losses(name, losses)
        self._cyclic_losses(losses)

    def _ramp_losses(self, name: Any, losses: Losses) -> None:
        up, down = (self._value("generators", name, f"ramp_limit_{way}") for way in ("up", "down"))
        if np.isnan(up).all() and np.isnan(down).all():
            return
        if not np.array_equal(
            np.broadcast_arrays(up, down)[0], np.broadcast_arrays(up, down)[1], equal_nan=True
        ):
            losses.add(
                f"Generator ramp_limit_up, ramp_limit_down of {name!r}: one limit holds in both "
                "directions; the tighter is used"
            )
        start, up = (self._value("generators", name, a) for a in ("p_init", "up_time_before"))
        if not np.isnan(start) or up == 0:
            losses.add(
                f"Generator p_init, up_time_before of {name!r}: the first change is free; "
                "give MultiStage.solve(initial={'pg': ...}) the power before it"
            )

    def _cyclic_losses(self, losses: Losses) -> None:
        """Report cyclic ends that are no end of a problem: of some storages only, or with varying limits."""
        storages = [*self._storages()]
        cyclic = [name for class_name, name in storages if self._cyclic(class_name, name)]
        if not cyclic:
            return
        if len(cyclic) < len(storages):
            losses.add(
                f"cyclic end of {listed([repr(n) for n in cyclic])}: the end of a problem is that of all "
                "storages or of none"
            )
        for class_name, name in storages:
            low, high = self._energy(class_name, name)
            if self._cyclic(class_name, name) and (np.ptp(low) or np.ptp(high)):
                losses.add(f"cyclic end of {name!r}: its energy limits vary, and also hold at the beginning")

    def _storages(self) -> Iterator[tuple[str, Any]]:
        for class_name in ("storage_units", "stores"):
            for name in self._active(class_name):
                yield class_name, name

    def _cyclic(self, class_name: str, name: Any) -> bool:
        column = "e_cyclic" if class_name == "stores" else "cyclic_state_of_charge"
        return bool(self._static(class_name)[column].at[name])

    # Values ------------------------------------------------------------------------------

    def _value(self, class_name: str, name: Any, attribute: str) -> Value:
        """Value of an attribute: one number, or one per snapshot."""
        components = getattr(self.n.c, class_name)
        dynamic = components.dynamic.get(attribute)
        if dynamic is not None and name in dynamic.columns:
            return np.asarray(dynamic[name].to_numpy(), dtype=float)
        if attribute not in components.static:  # an older PyPSA
            return math.nan
        return float(components.static[attribute].at[name])

    def _constant(self, class_name: str, name: Any, attribute: str) -> float:
        """Value of an attribute in the first snapshot."""
        return float(np.ravel(self._value(class_name, name, attribute))[0])

    def _put(self, name: str, field: str, value: Value) -> float:
        """Record the time series of a field, if it varies; return its first value."""
        values = np.atleast_1d(np.asarray(value, dtype=float)) + 0.0  # without negative zeros
        if len(values) > 1 and not (values == values[0]).all():
            self.series[SeriesKey(name, field)] = values
        return float(values[0])

    def _add(self, class_name: str, member: Any, component: Component) -> None:
        self.network.add(self.names[class_name, member], component)

    # Components --------------------------------------------------------------------------

    def read(self) -> Network:
        """Declare all components."""
        grid = self._grid()
        references = set(grid.c.sub_networks.static.slack_bus)
        controls = grid.c.generators.static.control
        static = self._static("buses")
        for bus in self.buses:
            self._add(
                "buses",
                bus,
                Bus(
                    vm=self._voltage(float(static.v_mag_pu_min.at[bus]), float(static.v_mag_pu_max.at[bus])),
                    base_kv=float(static.v_nom.at[bus]),
                    reference=bus in references,
                ),
            )
        for class_name in ("lines", "transformers"):
            for name in self._of_class[class_name]:
                self._branch(class_name, name, getattr(grid.c, class_name).static.loc[name])
        for name in self._of_class["generators"]:
            self._generator(name, controls.get(name, "PQ"))
        for class_name in ("storage_units", "stores"):
            for name in self._of_class[class_name]:
                self._storage(class_name, name)
        for name in self._of_class["loads"]:
            self._load(name)
        for name in self._of_class["shunt_impedances"]:
            self._shunt(name)
        self._notes()
        return self.network

    def _grid(self) -> Any:
        """Copy of the passive network and the active generators, with per-unit values and slack buses.

        PyPSA derives these in place; the network of the user is left as it is.
        """
        import pypsa

        grid = pypsa.Network()
        for class_name in ("line_types", "transformer_types", "buses", "lines", "transformers", "generators"):
            static = self._static(class_name).copy()
            if class_name == "generators":
                static = static.loc[self._active(class_name)]
            getattr(grid.c, class_name).static = static
        try:
            grid.calculate_dependent_values()
        except ValueError as error:  # an unknown type
            raise CaseError(f"{self.source}: {error}") from error
        grid.determine_network_topology()
        for part in grid.c.sub_networks.static.obj:
            part.find_slack_bus()
        return grid

    def _voltage(self, low: float, high: float) -> tuple[float, float]:
        low = low if low > 0.0 else min(self.voltage[0], high)
        return low, high if high < math.inf else max(self.voltage[1], low)

    def _branch(self, class_name: str, member: Any, row: Any) -> None:
        name = self.names[class_name, member]
        s_max_pu = self._value(class_name, member, "s_max_pu")
        rating = np.where(np.equal(s_max_pu, 0.0), 0.0, s_max_pu) * (
            np.where(np.equal(s_max_pu, 0.0), 0.0, float(row.s_nom))
        )
        first = self._put(name, "rating", rating)
        ratio, shift, factor = 1.0, 0.0, 1.0
        if class_name == "transformers":
            ratio, shift = float(row.tap_ratio) or 1.0, float(row.phase_shift)  # PyPSA takes 0 for 1
            if row.tap_side not in (0, 1):
                raise CaseError(
                    f"{self.source}: transformer {member!r}: tap_side = {row.tap_side}: must be 0 or 1"
                )
            if row.tap_side == 1:  # seen from the other side, where all impedances have another base
                factor, ratio = ratio**2, 1.0 / ratio
        self._add(
            class_name,
            member,
            Branch(
                str(row.bus0),
                str(row.bus1),
                r=float(row.r_pu) * factor,
                x=float(row.x_pu) * factor,
                b=float(row.b_pu) / factor,
                g=float(row.g_pu) / factor,
                rating=None if first == math.inf else first,
                tap=ratio,
                shift=shift,
                angle=(max(float(row.v_ang_min), -360.0), min(float(row.v_ang_max), 360.0)),
                in_service=bool(row.active),
            ),
        )

    def _generator(self, member: Any, control: str) -> None:
        name = self.names["generators", member]

        def value(attribute: str) -> Value:
            return self._value("generators", member, attribute)

        static = self._static("generators").loc[member]
        sign, p_nom = float(static.sign), float(static.p_nom)
        if sign == 0.0:
            raise CaseError(f"{self.source}: generator {member!r}: sign = 0: must differ from 0")
        ends = sign * p_nom * value("p_min_pu"), sign * p_nom * value("p_max_pu")
        low, high = ends if sign > 0 else ends[::-1]
        p_set = sign * value("p_set")
        if not self.free_dispatch:
            low, high = (np.where(np.isnan(p_set), limit, p_set) for limit in (low, high))
        bus = str(static.bus)
        self._add(
            "generators",
            member,
            Generator(
                bus,
                p=(self._put(name, "p_min", low), self._put(name, "p_max", high)),
                ramp=self._ramp(member, name, abs(sign * p_nom)),
                cost=Polynomial(
                    c2=self._put(name, "c2", value("marginal_cost_quadratic") / sign**2),
                    c1=self._put(name, "c1", value("marginal_cost") / sign),
                ),
                pg_set=_first(p_set),
                qg_set=sign * self._constant("generators", member, "q_set"),
                vm_set=self._constant("buses", static.bus, "v_mag_pu_set"),
                regulates=control in ("PV", "Slack"),
                in_service=bool(static.active),
            ),
        )

    def _ramp(self, member: Any, name: str, p_nom: float) -> float | None:
        """Ramp limit, MW/h; PyPSA's is per snapshot."""
        up, down = (self._value("generators", member, f"ramp_limit_{way}") for way in ("up", "down"))
        limit = np.fmin(up, down) * p_nom / self.hours  # of a limit and none, the limit
        first = self._put(name, "ramp", np.where(np.isnan(limit), math.inf, limit))
        return None if first == math.inf else first

    def _storage(self, class_name: str, member: Any) -> None:
        name = self.names[class_name, member]
        static = self._static(class_name).loc[member]
        low, high = self._energy(class_name, member)
        loss = self._constant(class_name, member, "standing_loss")
        # 0 - p: PyPSA's storages inject positive power
        if class_name == "stores":
            initial, efficiency = float(static.e_initial), (1.0, 1.0)
            most = float(np.max(high)) / self.hours  # any change of energy in one step
            least: Value = -most
            charge: Value = most
        else:
            initial = float(static.state_of_charge_initial)
            efficiency = (
                self._constant(class_name, member, "efficiency_store"),
                self._constant(class_name, member, "efficiency_dispatch"),
            )
            least = 0.0 - float(static.p_nom) * self._value(class_name, member, "p_max_pu")
            charge = 0.0 - float(static.p_nom) * self._value(class_name, member, "p_min_pu")
        p_set = 0.0 - self._value(class_name, member, "p_set")
        if not self.free_dispatch:
            least, charge = (np.where(np.isnan(p_set), limit, p_set) for limit in (least, charge))
        q = 0.0 - self._constant(class_name, member, "q_set")
        self._put(name, "energy", high)
        self._put(name, "energy_min", low)
        self._add(
            class_name,
            member,
            Storage(
                str(static.bus),
                energy=float(np.max(high)),
                energy_min=float(np.min(low)) + 0.0,
                power=(self._put(name, "power_min", least), self._put(name, "power_max", charge)),
                q=(min(q, 0.0), max(q, 0.0)),
                initial=None
                if self._cyclic(class_name, member)
                else self._initial(name, initial, loss, high),
                charge_efficiency=efficiency[0],
                discharge_efficiency=efficiency[1],
                standing_loss=self._per_hour(loss),
                ps_set=_first(p_set),
                qs_set=q,
                in_service=bool(static.active),
            ),
        )

    def _energy(self, class_name: str, member: Any) -> tuple[Array, Array]:
        """Limits of the energy at the end of each snapshot."""
        static = self._static(class_name).loc[member]
        low: Value
        high: Value
        if class_name == "stores":
            low = float(static.e_nom) * self._value(class_name, member, "e_min_pu")
            high = float(static.e_nom) * self._value(class_name, member, "e_max_pu")
            fixed = self._value(class_name, member, "e_set")
        else:
            low, high = 0.0, float(static.p_nom) * float(static.max_hours)
            fixed = self._value(class_name, member, "state_of_charge_set")
        return np.atleast_1d(np.fmax(low, fixed)), np.atleast_1d(np.fmin(high, fixed))

    def _initial(self, name: str, initial: float, loss: float, high: Array) -> float:
        """Initial energy of which as much is left after the first snapshot as in PyPSA.

        In PyPSA's optimum, the energy before the first snapshot has no standing loss.
        """
        kept = (1.0 - loss) ** self.hours
        before = initial / kept if kept > 0.0 else initial
        most = max(float(np.max(high)), initial)
        if before > most:
            warn(
                f"{self.source}: {name!r}: PyPSA takes no standing loss from the initial energy of "
                f"{initial:g} MWh in the first snapshot; opfmodel takes {initial - kept * most:g} MWh"
            )
        return min(before, most)

    def _per_hour(self, loss: float) -> float:
        """Standing loss with which a step keeps as much as in PyPSA, where losses compound."""
        return loss if self.hours == 1.0 else (1.0 - (1.0 - loss) ** self.hours) / self.hours

    def _load(self, member: Any) -> None:
        name, static = self.names["loads", member], self._static("loads").loc[member]
        p, q = (-float(static.sign) * self._value("loads", member, a) for a in ("p_set", "q_set"))
        load = Load(
            str(static.bus),
            p=self._put(name, "p", p),
            q=self._put(name, "q", q),
            in_service=bool(static.active),
        )
        self._add("loads", member, load)

    def _shunt(self, member: Any) -> None:
        static = self._static("shunt_impedances").loc[member]
        mva = float(self._static("buses").v_nom.at[static.bus]) ** 2  # of 1 S
        shunt = Shunt(
            str(static.bus), g=float(static.g) * mva, b=float(static.b) * mva, in_service=bool(static.active)
        )
        self._add("shunt_impedances", member, shunt)

    # Notes -------------------------------------------------------------------------------

    def _notes(self) -> None:
        """Warn of what is represented and yet surprising."""
        cyclic = [repr(self.names[key]) for key in self._storages() if self._cyclic(*key)]
        if cyclic:
            warn(
                f"{self.source}: {listed(cyclic)}: energy ends where it begins; the end belongs to the "
                "problem: solve it with end=End(cyclic=True) and initial={'e': None}"
            )
        fixed = [
            repr(self.names[class_name, member])
            for class_name in ("generators", "storage_units", "stores")
            for member in self._active(class_name)
            if not np.isnan(self._value(class_name, member, "p_set")).all()
        ]
        if fixed and not self.free_dispatch:
            warn(
                f"{self.source}: {listed(fixed)}: p_set fixes the power, as in n.optimize(); without it, "
                "or with from_pypsa(..., free_dispatch=True), the power is free"
            )
        closed = [
            repr(self.names[class_name, member])
            for class_name in ("lines", "transformers")
            for member in self._active(class_name)
            if not float(self._static(class_name).s_nom.at[member]) and not self._typed(class_name, member)
        ]
        if closed:
            warn(f"{self.source}: {listed(closed)}: s_nom = 0: carries nothing in an optimum, as in PyPSA")

    def _typed(self, class_name: str, member: Any) -> bool:
        return class_name == "transformers" and bool(self._static(class_name).type.at[member])


def _first(set_point: Value) -> float:
    """Set-point in the first snapshot; without one, PyPSA's power flow injects nothing."""
    first = float(np.ravel(set_point)[0])
    return 0.0 if math.isnan(first) else first
