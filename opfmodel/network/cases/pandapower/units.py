"""What injects or draws power in a pandapower network, from its tables.

Units that pandapower's optimal power flow decides about become generators and storages with limits;
units that are not ``controllable`` are fixed. Set-points are those of ``runpp``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from opfmodel.errors import CaseError, listed
from opfmodel.network.cases.pandapower.costs import Costs
from opfmodel.network.cases.pandapower.grid import Grid
from opfmodel.network.cases.pandapower.source import Row, Source
from opfmodel.network.cases.pandapower.tables import CURVES
from opfmodel.network.cases.warn import warn
from opfmodel.network.components import DCLine, Generator, Load, Shunt, Storage
from opfmodel.network.costs import Polynomial
from opfmodel.network.network import Network
from opfmodel.network.polygon import fault_of

__all__ = ["Units"]

_CONSTANT = ("const_z_p_percent", "const_i_p_percent", "const_z_q_percent", "const_i_q_percent")
_EFFICIENCY, _SELF_DISCHARGE = "efficiency_percent", "self-discharge_percent_per_day"  # of SimBench
_PHASES = "abc"
_AGREE = 1e-9  # MW; the converter and this reader add the same numbers in another order


class Units:
    """Loads, generators, storages and shunts."""

    def __init__(self, source: Source, grid: Grid, costs: Costs) -> None:
        self.source = source
        self.grid = grid
        self.costs = costs
        self._unlimited: list[str] = []
        self._held: list[str] = []
        self._dc_lines: list[str] = []
        self._backward: list[str] = []
        self._drawn = np.zeros((len(grid.bus), 2))  # as the converter adds them, MW and MVAr
        self._shunts = np.zeros((len(grid.bus), 2))

    def declare(self, network: Network) -> None:
        """Declare all units, and compare their sums with those of the converter.

        Raises
        ------
        CaseError
            The sums differ: this reader does not know a kind of injection.
        """
        kinds: Mapping[str, Callable[[Network, Row], None]] = {
            "ext_grid": self._external_grid,
            "gen": self._generator,
            "sgen": self._static_generator,
            "load": self._load,
            "motor": self._motor,
            "asymmetric_load": self._asymmetric,
            "asymmetric_sgen": self._asymmetric,
            "storage": self._storage,
            "shunt": self._shunt,
            "ward": self._ward,
            "xward": self._extended_ward,
            "dcline": self._dc_line,
        }
        for table, declare in kinds.items():
            for row in self.source.rows(table):
                declare(network, row)
        self._losses_at_star_points(network)
        self._report_controllers()
        self._warn()
        self._compare()

    # Units that may be decided ------------------------------------------------------------------------

    def _external_grid(self, network: Network, row: Row) -> None:
        generator = Generator(
            self.grid.at(row),
            p=row.limits("p_mw"),
            q=row.limits("q_mvar"),
            cost=self.costs.of("ext_grid", row),
            vm_set=row.given("vm_pu"),
            participation=row.number("slack_weight", 1.0),
            in_service=row.in_service,
        )
        network.add(row.name, generator)

    def _generator(self, network: Network, row: Row) -> None:
        p = row.given("p_mw") * row.number("scaling", 1.0)
        controllable = self.source.controllable("gen", row)
        limits = self._active_limits(row) if controllable else (p, p)
        curve = self._capability(row, limits)
        generator = Generator(
            self.grid.at(row),
            p=limits,
            q=row.limits("q_mvar") if curve is None else (-math.inf, math.inf),
            capability=curve,
            cost=self.costs.of("gen", row),
            pg_set=p,
            vm_set=row.given("vm_pu"),
            participation=row.number("slack_weight", 0.0),
            in_service=row.in_service,
        )
        network.add(row.name, generator)

    def _static_generator(self, network: Network, row: Row) -> None:
        p, q = self._power(row)
        self._draw(row, -p, -q)
        controllable = self.source.controllable("sgen", row)
        limits = self._active_limits(row) if controllable else (p, p)
        curve = self._capability(row, limits) if controllable else None
        within = row.limits("q_mvar") if curve is None else (-math.inf, math.inf)
        generator = Generator(
            self.grid.at(row),
            p=limits,
            q=within if controllable else (q, q),
            capability=curve,
            cost=self.costs.of("sgen", row) if controllable else Polynomial(),
            pg_set=p,
            qg_set=q,
            regulates=False,
            in_service=row.in_service,
        )
        network.add(row.name, generator)

    def _load(self, network: Network, row: Row) -> None:
        self._report_voltage_dependence(row)
        p, q = self._power(row)
        if not self.source.controllable("load", row):
            self._add_load(network, row, p, q)
            return
        self._draw(row, p, q)
        least, most = self._active_limits(row)
        least_q, most_q = row.limits("q_mvar")
        generator = Generator(
            self.grid.at(row),
            p=(-most, -least),
            q=(-most_q, -least_q),
            cost=self.costs.of_demand("load", row),
            pg_set=-p,
            qg_set=-q,
            regulates=False,
            in_service=row.in_service,
        )
        network.add(row.name, generator)

    def _storage(self, network: Network, row: Row) -> None:
        p, q = self._power(row)
        if not self.source.controllable("storage", row):
            if row.in_service:
                self._held.append(row.name)
            self._add_load(network, row, p, q)
            return
        self._draw(row, p, q)
        if self.costs.given("storage", row):
            self.source.losses.add(f"storage {row.name!r}: a cost of its power; it is left out")
        energy, charge = row.number("max_e_mwh"), row.number("soc_percent")
        if row.in_service and (math.isnan(energy) or math.isnan(charge)):
            missing = "max_e_mwh" if math.isnan(energy) else "soc_percent"
            raise CaseError(
                f"{row.label}: {missing} has no value; a controllable storage needs its energy: "
                "max_e_mwh in MWh and soc_percent in percent of it"
            )
        efficiency = row.number(_EFFICIENCY, 100.0)
        efficiency /= 100.0 if efficiency > 1.0 else 1.0  # SimBench writes 0.95 in this column
        network.add(
            row.name,
            Storage(
                self.grid.at(row),
                energy=energy,
                power=self._active_limits(row),
                q=row.limits("q_mvar"),
                initial=charge / 100.0 * energy,
                energy_min=row.number("min_e_mwh", 0.0),
                charge_efficiency=efficiency,
                discharge_efficiency=efficiency,
                standing_loss=row.number(_SELF_DISCHARGE, 0.0) / 100.0 / 24.0,
                ps_set=p,
                qs_set=q,
                in_service=row.in_service,
            ),
        )

    def _dc_line(self, network: Network, row: Row) -> None:
        """Declare a DC line, whose direction is the sign of its set-point.

        In ``runopp``, the share that is lost is one of the power that arrives:
        ``p_from = (1 + share) p_to + loss_mw``.
        """
        power, share = row.given("p_mw"), row.number("loss_percent", 0.0) / 100.0
        fixed, forward = row.number("loss_mw", 0.0), power > 0.0
        sending, receiving = ("from", "to") if forward else ("to", "from")
        line = DCLine(
            self.grid.at(row, f"{sending}_bus"),
            self.grid.at(row, f"{receiving}_bus"),
            p=(0.0, row.number("max_p_mw", math.inf)),
            loss=share / (1.0 + share),
            loss_fixed=fixed / (1.0 + share),
            q_from=row.limits(f"q_{sending}_mvar"),
            q_to=row.limits(f"q_{receiving}_mvar"),
            cost=self.costs.of_dc_line(row, forward),
            pf_set=abs(power),
            in_service=row.in_service,
        )
        network.add(row.name, line)
        if row.in_service:
            self._dc_lines.append(row.name)
            if not forward and (share or fixed):
                self._backward.append(row.name)

    # Fixed demand -------------------------------------------------------------------------------------

    def _motor(self, network: Network, row: Row) -> None:
        share = row.given("loading_percent") / 100.0 * row.number("scaling", 1.0)
        p = row.given("pn_mech_mw") / (row.given("efficiency_percent") / 100.0) * share
        factor = row.given("cos_phi")
        if not 0.0 < factor <= 1.0:
            raise CaseError(f"{row.label}: cos_phi = {factor:g}: must be above 0 and at most 1")
        self._add_load(network, row, p, math.sqrt(max((p / factor) ** 2 - p**2, 0.0)))

    def _asymmetric(self, network: Network, row: Row) -> None:
        p, q = (
            [row.number(f"{quantity}_{phase}_{unit}", 0.0) for phase in _PHASES]
            for quantity, unit in (("p", "mw"), ("q", "mvar"))
        )
        if row.in_service and any(len(set(values)) > 1 for values in (p, q)):
            self.source.losses.add(f"{row.table} {row.name!r}: its phases differ; their sum is balanced")
        scaling = row.number("scaling", 1.0) * (-1.0 if row.table == "asymmetric_sgen" else 1.0)
        self._add_load(network, row, sum(p) * scaling, sum(q) * scaling)

    def _ward(self, network: Network, row: Row) -> None:
        self._add_load(network, row, row.given("ps_mw"), row.given("qs_mvar"))
        self._add_shunt(network, row, f"{row.name}:shunt", row.given("pz_mw"), row.given("qz_mvar"))

    def _extended_ward(self, network: Network, row: Row) -> None:
        """Declare a ward with a voltage source behind an impedance, which gives no active power."""
        self._ward(network, row)
        generator = Generator(
            f"{row.name}:source",
            p=(0.0, 0.0),
            pg_set=0.0,
            participation=0.0,
            vm_set=row.given("vm_pu"),
            in_service=row.in_service and self.grid.alive(self.grid.row_of(row)),
        )
        network.add(f"{row.name}:voltage", generator)

    def _shunt(self, network: Network, row: Row) -> None:
        p, q = self._shunt_step(row)
        bus_kv = self.source.net.bus.vn_kv.at[int(row.given("bus"))]
        ratio = (self.grid.base_kv(self.grid.row_of(row)) / row.number("vn_kv", bus_kv)) ** 2
        self._add_shunt(network, row, row.name, p * ratio, q * ratio)

    def _shunt_step(self, row: Row) -> tuple[float, float]:
        """Power of a shunt at its present step, from its table of characteristics if it has one."""
        step = row.number("step", 1.0)
        if not row.flag("step_dependency_table", False):
            return row.given("p_mw") * step, row.given("q_mvar") * step
        table = self.source.net["shunt_characteristic_table"]
        found = table[
            (table["id_characteristic"] == row.given("id_characteristic_table")) & (table["step"] == step)
        ]
        if len(found) != 1:
            raise CaseError(f"{row.label}: step = {step:g}: not in its table of characteristics")
        return float(found["p_mw"].iloc[0]), float(found["q_mvar"].iloc[0])

    def _losses_at_star_points(self, network: Network) -> None:
        """Declare losses of three-winding transformers, if pandapower's options put them at the star."""
        from pandapower.pypower.idx_bus import BS, GS

        for name, row, _ in self.grid.inner_buses():
            g, b = map(float, self.grid.bus[row, [GS, BS]])
            if g or b:
                network.add(f"{name}:losses", Shunt(name, g=g, b=b, in_service=self.grid.alive(row)))
                self._shunts[row] += (g, b)

    # Common parts -------------------------------------------------------------------------------------

    def _power(self, row: Row) -> tuple[float, float]:
        """Set-points of active and reactive power."""
        scaling = row.number("scaling", 1.0)
        return row.given("p_mw") * scaling, row.given("q_mvar") * scaling

    def _active_limits(self, row: Row) -> tuple[float, float]:
        limits = row.limits("p_mw")
        if row.in_service and not all(map(math.isfinite, limits)):
            self._unlimited.append(row.name)
        return limits

    def _add_load(self, network: Network, row: Row, p: float, q: float) -> None:
        self._draw(row, p, q)
        network.add(row.name, Load(self.grid.at(row), p=p, q=q, in_service=row.in_service))

    def _add_shunt(self, network: Network, row: Row, name: str, g: float, q: float) -> None:
        if row.in_service:
            self._shunts[self.grid.row_of(row)] += (g, -q)
        network.add(name, Shunt(self.grid.at(row), g=g, b=-q, in_service=row.in_service))

    def _draw(self, row: Row, p: float, q: float) -> None:
        if row.in_service:
            self._drawn[self.grid.row_of(row)] += (p, q)

    # Losses and warnings ------------------------------------------------------------------------------

    def _report_voltage_dependence(self, row: Row) -> None:
        shares = [f"{key} = {row.number(key):g}" for key in _CONSTANT if row.number(key, 0.0)]
        if row.in_service and shares:
            self.source.losses.add(
                f"load {row.name!r}: {', '.join(shares)}: its power depends on the voltage; it is constant"
            )

    def _capability(self, row: Row, p: tuple[float, float]) -> tuple[tuple[float, float], ...] | None:
        """Capability curve, which replaces the limits of reactive power; constant beyond its ends.

        A curve that no convex polygon represents is a loss.
        """
        if not (row.in_service and row.flag("reactive_capability_curve", False)):
            return None
        number = row.number("id_q_capability_characteristic")
        rows = [
            [point.given(column) for column in ("p_mw", "q_min_mvar", "q_max_mvar")]
            for point in self.source.rows(CURVES)
            if point.number("id_q_capability_curve") == number
        ]
        rows.sort()
        if rows:
            (first, last), (low, high) = (rows[0], rows[-1]), p
            rows = [[low, *first[1:]]] * (-math.inf < low < first[0]) + rows
            rows += [[high, *last[1:]]] * (math.inf > high > last[0])
        corners = tuple((at, low) for at, low, _ in rows) + tuple((at, high) for at, _, high in rows[::-1])
        if not rows:
            why = f"it has no points in {CURVES}"
        elif row.text("curve_style") != "straightLineYValues":
            why = "only those of straight lines (curve_style = straightLineYValues) are represented"
        elif len(corners) < 3 or fault_of(corners):
            why = "only convex curves are represented"
        else:
            return corners
        self.source.losses.add(
            f"{row.table} {row.name!r}: reactive_capability_curve: {why}; min_q_mvar and max_q_mvar hold"
        )
        return None

    def _report_controllers(self) -> None:
        names = [
            f"{row.index} ({type(row.values.get('object')).__name__})"
            for row in self.source.rows("controller")
            if row.in_service
        ]
        if names:
            warn(f"{self.source.where}: controllers do not act, as in runpp by default: {listed(names)}")

    def _warn(self) -> None:
        self.costs.warn()
        if self._held:
            warn(
                f"{self.source.where}: storages that are not controllable hold their power: "
                f"{listed(map(repr, self._held))}"
            )
        if self._dc_lines:
            warn(
                f"{self.source.where}: dc lines lose loss_percent of what arrives, as in runopp, not of what "
                "is sent, as in runpp; in a power flow they hold no voltage: "
                f"{listed(map(repr, self._dc_lines))}"
            )
        if self._backward:
            warn(
                f"{self.source.where}: dc lines with p_mw of at most 0 flow backward and lose power; in "
                f"runopp they gain it: {listed(map(repr, self._backward))}"
            )
        if self._unlimited:
            warn(
                f"{self.source.where}: no min_p_mw or max_p_mw and therefore no limit, as in pandapower's "
                f"optimal power flow: {listed(map(repr, self._unlimited))}"
            )

    def _compare(self) -> None:
        """Compare what is drawn at each bus with the converter, which knows every kind of injection."""
        from pandapower.pypower import idx_bus as column

        mine = np.hstack([self._drawn, self._shunts])
        theirs = self.grid.bus[:, [column.PD, column.QD, column.GS, column.BS]]
        for row, name in self.grid.names.items():
            scale = max(1.0, float(np.abs(theirs[row]).max()))
            if self.grid.alive(row) and not np.allclose(mine[row], theirs[row], rtol=0, atol=_AGREE * scale):
                raise CaseError(
                    f"{self.source.where}: bus {name!r}: draws {_listed(mine[row])} by the tables that this "
                    f"version knows, but {_listed(theirs[row])} by pandapower's converter"
                )


def _listed(values: np.ndarray[tuple[int], np.dtype[np.float64]]) -> str:
    return "{:g} MW, {:g} MVAr and a shunt of {:g} MW, {:g} MVAr".format(*values)
