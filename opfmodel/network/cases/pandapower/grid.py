"""Buses and branches of a pandapower network, from pandapower's own converter.

The converter resolves switches, fuses buses, splits three-winding transformers and computes admittances
with taps, as ``runpp`` does. What injects is read from the tables by
:mod:`opfmodel.network.cases.pandapower.units`.
"""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.errors import CaseError, listed
from opfmodel.network.cases.pandapower.source import Row, Source, refusals
from opfmodel.network.cases.warn import warn
from opfmodel.network.components import Branch, Bus, Shunt
from opfmodel.network.islands import connected
from opfmodel.network.network import Network
from opfmodel.network.physics import branch_admittance

__all__ = ["Grid"]

Array = npt.NDArray[np.float64]

_VM = (0.0, 2.0)  # limits where the network has none, as in pandapower's optimal power flow
_DEAD = 4  # type of a bus out of service or without supply
_EVEN = 1e-12  # p.u.; impedances that differ by less are equal

# Options of runpp that its converter takes, and that a network may hold in user_pf_options.
_OPTIONS: Mapping[str, Any] = {
    "calculate_voltage_angles": True,
    "check_connectivity": True,
    "consider_line_temperature": False,
    "neglect_open_switch_branches": False,
    "switch_rx_ratio": 2,
    "trafo3w_losses": "hv",
    "trafo_model": "t",
}
# Others that change the result of a power flow.
_NOT_REPRESENTED = ("distributed_slack", "enforce_p_lims", "enforce_q_lims", "tdpf")


class Grid:
    """Buses and branches as the converter gives them.

    Attributes
    ----------
    bus
        Buses of the converter, one row each, in per unit and degrees.
    row
        Row of each bus by its index in the table; the rows of fused buses are equal.
    names
        Name of the bus that stands for each row: that of the first bus that the row carries.

    Raises
    ------
    CaseError
        The converter refuses the network.
    """

    def __init__(self, source: Source) -> None:
        self.source = source
        net = source.net
        arrays = _convert(source)
        self.bus: Array = arrays["bus"]
        self._branch: Array = np.real(arrays["branch"])
        lookup = net._pd2ppc_lookups["bus"]
        self.row = {int(index): int(lookup[index]) for index in net.bus.index}
        self.names: dict[int, str] = {}
        self._places: dict[int, tuple[float, float]] = {}
        for bus in source.rows("bus"):
            row = self.row[bus.index]
            self.names.setdefault(row, bus.name)
            if found := _place(bus.text("geo")):
                self._places.setdefault(row, found)

    def at(self, item: Row, column: str = "bus") -> str:
        """Name of the bus that stands for the bus of an element, or for another one that it names."""
        return self.names[self.row_of(item, column)]

    def row_of(self, item: Row, column: str = "bus") -> int:
        """Row of the bus of an element."""
        index = item.given(column)
        if index not in self.row:
            raise CaseError(f"{item.label}: {column} = {index:g}: no such bus")
        return self.row[int(index)]

    def alive(self, row: int) -> bool:
        """Whether the bus of a row is in service and supplied."""
        from pandapower.pypower.idx_bus import BUS_TYPE

        return bool(self.bus[row, BUS_TYPE] != _DEAD)

    def base_kv(self, row: int) -> float:
        """Nominal voltage of a row, kV."""
        from pandapower.pypower.idx_bus import BASE_KV

        return float(self.bus[row, BASE_KV])

    def declare(self, network: Network) -> None:
        """Declare buses and branches, and the aliases of fused buses."""
        self._warn_of_charging()
        limits = self._voltage_limits()
        references = self._references()
        for row, name in list(self.names.items()):
            self._declare_bus(network, name, row, limits[row], references.get(row))
        aliases = self._aliases()
        for name, row, neighbour in self.inner_buses():
            self.names[row] = name
            self._declare_bus(network, name, row, limits[neighbour])
        for name, row, limited in self._branch_rows():
            self._declare_branch(network, name, self._branch[row], limited)
        if any(name != bus for name, bus in aliases.items()) or len(network.of(Bus)) > len(aliases):
            network.alias(aliases)
        self._report_references(references)

    def _declare_bus(
        self, network: Network, name: str, row: int, vm: tuple[float, float], reference: Row | None = None
    ) -> None:
        x, y = self._places.get(row, (None, None))
        bus = Bus(
            vm=vm,
            base_kv=self.base_kv(row) or None,
            x=x,
            y=y,
            reference=reference is not None,
            va_set=0.0 if reference is None else reference.number("va_degree", 0.0),
            in_service=self.alive(row),
        )
        network.add(name, bus)

    def _aliases(self) -> dict[str, str | None]:
        """Return which bus carries each bus of the table."""
        aliases: dict[str, str | None] = {}
        dead = []
        for bus in self.source.rows("bus"):
            row = self.row[bus.index]
            aliases[bus.name] = self.names[row] if self.alive(row) else None
            if bus.in_service and not self.alive(row):
                dead.append(bus.name)
        if dead:
            warn(
                f"{self.source.where}: no connection to an external grid, therefore out of service: "
                f"{listed(map(repr, dead))}"
            )
        return aliases

    def _voltage_limits(self) -> dict[int, tuple[float, float]]:
        """Voltage limits of the rows: the tightest of the fused buses and of their generators."""
        low, high = (dict.fromkeys(self.names, limit) for limit in _VM)
        for table in ("bus", "gen"):
            for item in self.source.rows(table):
                if item.in_service:
                    row = self.row[item.index] if table == "bus" else self.row_of(item)
                    least, most = item.limits("vm_pu")
                    low[row], high[row] = max(low[row], least), min(high[row], most)
        for table in ("ext_grid", "gen"):  # a unit that is not controllable holds its voltage
            for item in self.source.rows(table):
                if item.in_service and not self.source.controllable(table, item):
                    low[self.row_of(item)] = high[self.row_of(item)] = item.given("vm_pu")
        return {row: (low[row], high[row]) for row in self.names}

    def _references(self) -> dict[int, Row]:
        """External grid or slack generator of each row that has one."""
        found: dict[int, Row] = {}
        for table in ("ext_grid", "gen"):
            for item in self.source.rows(table):
                slack = table == "ext_grid" or item.flag("slack", False)
                if item.in_service and slack and self.alive(self.row_of(item)):
                    found.setdefault(self.row_of(item), item)
        return found

    def _warn_of_charging(self) -> None:
        """Warn of transformers whose charging in MATPOWER was written as a negative open-loop current."""
        negative = [
            item.name
            for table in ("trafo", "trafo3w")
            for item in self.source.rows(table)
            if item.in_service and item.number("i0_percent", 0.0) < 0
        ]
        if negative:
            warn(
                f"{self.source.where}: i0_percent is negative and counts with its magnitude, as in runpp: "
                f"{listed(map(repr, negative))}"
            )

    def _report_references(self, references: Mapping[int, Row]) -> None:
        """Report references beyond the first of an island."""
        from pandapower.pypower.idx_brch import BR_STATUS, F_BUS, T_BUS

        closed = self._branch[self._branch[:, BR_STATUS] > 0]
        for island in map(set, connected(references, closed[:, [F_BUS, T_BUS]].astype(int).tolist())):
            members = [item for row, item in references.items() if row in island]
            for item in members[1:]:
                self.source.losses.add(
                    f"{item.table} {item.name!r}: holds the angle of its bus, as {members[0].name!r} of the "
                    "same island does; an island has one reference bus"
                )

    def inner_buses(self) -> Iterator[tuple[str, int, int]]:
        """Buses inside of equipment: name, row, and the row of the bus whose voltage limits they have."""
        net = self.source.net
        lookup = net._pd2ppc_lookups
        for table, at, inner in (("xward", "bus", "source"), ("trafo3w", "hv_bus", "star")):
            for item, index in zip(self.source.rows(table), lookup["aux"].get(table, ()), strict=True):
                row = int(lookup["bus"][index])
                yield f"{item.name}:{inner}", row, self.row[int(item.given(at))]

    def _branch_rows(self) -> Iterator[tuple[str, int, bool]]:
        """Name and row of each branch, and whether the converter gives a rating."""
        net = self.source.net
        spans = net._pd2ppc_lookups["branch"]
        for table in ("line", "trafo", "trafo3w", "impedance", "xward", "switch"):
            if table not in spans:
                continue
            frame = net.switch[net._impedance_bb_switches] if table == "switch" else net[table]
            names = [self.source.name(table, index) for index in frame.index]
            if table == "trafo3w":
                names = [f"{name}:{side}" for side in ("hv", "mv", "lv") for name in names]
            elif table == "xward":
                names = [f"{name}:impedance" for name in names]
            # The converter limits impedances to their sn_mva, as runopp does.
            limited = table == "impedance" or "max_loading_percent" in frame
            for name, row in zip(names, range(*spans[table]), strict=True):
                yield name, row, limited

    def _declare_branch(self, network: Network, name: str, values: Array, limited: bool) -> None:
        """Declare a branch, and the bus at an open end of it."""
        from pandapower.pypower import idx_brch as column

        ends = []
        for key, side in ((column.F_BUS, "from"), (column.T_BUS, "to")):
            row = int(values[key])
            if row not in self.names:
                self.names[row] = f"{name}:open_{side}"
                self._declare_bus(network, self.names[row], row, _VM)
            ends.append(self.names[row])
        r, x = self._series(name, values)
        g, b = float(values[column.BR_G]), float(values[column.BR_B])
        g_to, b_to = g + float(values[column.BR_G_ASYM]), b + float(values[column.BR_B_ASYM])
        rating = float(values[column.RATE_A]) if limited else math.nan
        even = (g, b) == (g_to, b_to)
        branch = Branch(
            ends[0],
            ends[1],
            r=r,
            x=x,
            g=g if even else 0.0,
            b=b if even else 0.0,
            g_from=0.0 if even else g / 2,
            b_from=0.0 if even else b / 2,
            g_to=0.0 if even else g_to / 2,
            b_to=0.0 if even else b_to / 2,
            rating=rating if rating > 0 else None,
            tap=float(values[column.TAP]) or 1.0,
            shift=float(values[column.SHIFT]),
            in_service=bool(values[column.BR_STATUS]),
        )
        network.add(name, branch if ends[0] != ends[1] else self._short_circuited(branch))

    def _short_circuited(self, branch: Branch) -> Shunt:
        """Shunt that equals a branch between fused buses: its charging, and circulating power at a tap."""
        from_end = branch.g / 2 + branch.g_from, branch.b / 2 + branch.b_from
        to_end = branch.g / 2 + branch.g_to, branch.b / 2 + branch.b_to
        values = (
            branch.r,
            branch.x,
            *from_end,
            *to_end,
            branch.neutral("tap"),
            math.radians(branch.neutral("shift")),
        )
        y = branch_admittance(*map(np.array, values))
        base = float(self.source.net.sn_mva)
        g = float(y.g_ff + y.g_ft + y.g_tf + y.g_tt) * base
        b = float(y.b_ff + y.b_ft + y.b_tf + y.b_tt) * base
        return Shunt(branch.from_bus, g=g, b=b, in_service=branch.in_service)

    def _series(self, name: str, values: Array) -> tuple[float, float]:
        """Series impedance; one that depends on the direction is a loss and becomes the mean."""
        from pandapower.pypower import idx_brch as column

        r, x = float(values[column.BR_R]), float(values[column.BR_X])
        more_r, more_x = float(values[column.BR_R_ASYM]), float(values[column.BR_X_ASYM])
        if math.hypot(more_r, more_x) <= _EVEN * math.hypot(r, x):
            return r, x
        if values[column.BR_STATUS]:
            self.source.losses.add(
                f"impedance {name!r}: rtf_pu and xtf_pu differ from rft_pu and xft_pu; "
                "a branch has one series impedance, their mean"
            )
        return r + more_r / 2, x + more_x / 2


def _place(text: str) -> tuple[float, float] | None:
    """Return the coordinates of a point in GeoJSON; None if it is no such point."""
    try:
        x, y = json.loads(text)["coordinates"][:2]
        found = float(x), float(y)
    except (ValueError, LookupError, TypeError):
        return None
    return found if all(map(math.isfinite, found)) else None


def _convert(source: Source) -> Mapping[str, Any]:
    """Run the converter of pandapower.

    Its public form, ``to_ppc``, drops asymmetries and losses of branches.
    """
    from pandapower.auxiliary import _add_ppc_options
    from pandapower.pd2ppc import _pd2ppc

    net = source.net
    saved = dict(net.get("user_pf_options") or {})
    for key in _NOT_REPRESENTED:
        if saved.get(key):
            source.losses.add(f"user_pf_options: {key} = {saved[key]!r}; power flows are without it")
    options = {key: saved.get(key, value) for key, value in _OPTIONS.items()}
    if options["calculate_voltage_angles"] == "auto":
        options["calculate_voltage_angles"] = True
    with refusals(source.where), warnings.catch_warnings(action="ignore"):
        net._options = {}
        _add_ppc_options(
            net,
            mode="pf",
            enforce_p_lims=False,
            enforce_q_lims=False,
            recycle=None,
            init_vm_pu="flat",
            init_va_degree="flat",
            **options,
        )
        arrays: Mapping[str, Any] = _pd2ppc(net)[0]
    return arrays
