"""Components of opfmodel from the records of powerio."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from opfmodel.errors import CaseError, ComponentError, listed
from opfmodel.network.cases.capability import COLUMNS, fault_of_columns, polygon_of
from opfmodel.network.cases.losses import Losses
from opfmodel.network.cases.matpower import CaseFile
from opfmodel.network.cases.warn import warn
from opfmodel.network.component import Component
from opfmodel.network.components import Branch, Bus, DCLine, Generator, Load, Shunt, Storage
from opfmodel.network.costs import Cost, PiecewiseLinear, Polynomial
from opfmodel.network.network import Network

__all__ = ["Reader", "records"]


def records(case: Any, kind: str) -> Sequence[Mapping[str, Any]]:
    """Records of a rare kind, guarded by its count: powerio scans the whole case even if there are none."""
    return getattr(case, kind) if getattr(case, f"n_{kind}") else ()


class Reader:
    """Convert powerio records to components."""

    def __init__(
        self,
        path: Path,
        case: Any,
        network: Network,
        default_cost: Cost | None,
        source: CaseFile | None,
        losses: Losses,
    ) -> None:
        self.path = path
        self.losses = losses
        self.source = source
        self.case = case
        self.network = network
        self.default_cost = default_cost
        self.numbers: dict[str, int] = {}  # number of components per requested name
        self.bus_row = {record["id"]: row for row, record in enumerate(case.buses)}
        self.load_buses = {record["id"] for record in case.buses if record["kind"] == "PQ"}

    def read(self) -> Network:
        """Declare all components."""
        self._buses()
        self._branches()
        self._generators()
        for record in self.case.loads:
            bus = record["bus"]
            load = Load(str(bus), p=record["p"], q=record["q"], in_service=record["in_service"])
            self._add(f"load{bus}", load, "bus", self.bus_row.get(bus))
        for record in self.case.shunts:
            bus = record["bus"]
            shunt = Shunt(str(bus), g=record["g"], b=record["b"], in_service=record["in_service"])
            self._add(f"shunt{bus}", shunt, "bus", self.bus_row.get(bus))
        for row, record in enumerate(records(self.case, "storage")):
            self._storage(row, record)
        if self.source is not None:
            lines = records(self.case, "hvdc")
            for row, record in enumerate(lines):
                self._dc_line(row, record)
            if any(record["in_service"] for record in lines):
                warn(f"{self.path}: DC lines hold no voltage in a power flow: VF and VT are not used")
        return self.network

    def _add(self, name: str, component: Component, table: str, row: int | None) -> None:
        """Declare the component of a table row; repeated names get a numbered suffix."""
        number = self.numbers[name] = self.numbers.get(name, 0) + 1
        unique = name if number == 1 else f"{name}#{number}"
        try:
            self.network.add(unique, component)
        except ComponentError as error:
            table = "gencost" if error.field == "cost" else table
            raise CaseError(f"{self._place(table, row)}: {error}") from error

    def _place(self, table: str, row: int | None) -> str:
        """File and, if known, line of a table row."""
        if self.source is None or row is None:
            return str(self.path)
        return self.source.place(table, row)

    def _buses(self) -> None:
        for row, record in enumerate(self.case.buses):
            self._add(
                str(record["id"]),
                Bus(
                    vm=(record["vmin"], record["vmax"]),
                    base_kv=record["base_kv"] or None,
                    reference=record["kind"] == "REF",
                    va_set=record["va"] if record["kind"] == "REF" else 0.0,
                    in_service=record["kind"] != "ISOLATED",
                ),
                "bus",
                row,
            )

    def _branches(self) -> None:
        emergency = [_emergency(record) for record in self.case.branches]
        ratings = [record["rate_a"] for record in self.case.branches]
        if all(given in (None, rating) for given, rating in zip(emergency, ratings, strict=True)):
            emergency = [None] * len(emergency)  # copies of the rating state nothing
        for row, record in enumerate(self.case.branches):
            charging = record["b_fr"] + record["b_to"]
            even = record["b_fr"] == record["b_to"]
            self._add(
                f"{record['from_id']}-{record['to_id']}",
                Branch(
                    str(record["from_id"]),
                    str(record["to_id"]),
                    r=record["r"],
                    x=record["x"],
                    b=charging if even else 0.0,
                    b_from=0.0 if even else record["b_fr"],
                    b_to=0.0 if even else record["b_to"],
                    g_from=record["g_fr"],
                    g_to=record["g_to"],
                    rating=record["rate_a"] or None,
                    emergency_rating=emergency[row],
                    tap=record["tap"] or 1.0,
                    shift=record["shift"],
                    angle=_angles(record["angmin"], record["angmax"]),
                    in_service=record["in_service"],
                ),
                "branch",
                row,
            )

    def _generators(self) -> None:
        without = []
        for row, record in enumerate(self.case.generators):
            name, in_service = f"gen{row + 1}", bool(record["in_service"])
            try:
                cost = self.default_cost if record["cost"] is None else self._cost(name, row, record["cost"])
            except CaseError as error:
                if in_service:
                    raise
                warn(f"{error}; the generator is out of service and is left out")
                continue
            if cost is None:
                without.append(name)
                continue
            ramp_30 = record["caps"][8] if len(record["caps"]) > 8 else None
            self._add(
                name,
                Generator(
                    str(record["bus"]),
                    p=(record["pmin"], record["pmax"]),
                    q=(record["qmin"], record["qmax"]),
                    ramp=2.0 * ramp_30 if ramp_30 else None,
                    cost=cost,
                    pg_set=record["pg"],
                    qg_set=record["qg"],
                    vm_set=record["vg"] or None,
                    regulates=record["voltage_regulation_on"] and record["bus"] not in self.load_buses,
                    capability=self._capability(name, row, record) if in_service else None,
                    in_service=in_service,
                ),
                "gen",
                row,
            )
        if without:
            raise CaseError(
                f"{self.path}: no cost data for {listed(without)}; give a default cost "
                "(default_cost=Polynomial(0, 30, 0) in Python, --default-cost 30 on the command line, "
                "network.default_cost in a scenario)"
            )

    def _capability(
        self, name: str, row: int, record: Mapping[str, Any]
    ) -> tuple[tuple[float, float], ...] | None:
        """Capability curve of a generator in service; raises an error unless it narrows towards PC2."""
        columns = [float(value or 0.0) for value in record["caps"][: len(COLUMNS)]]
        if len(columns) < len(COLUMNS) or columns[0] == columns[1]:  # then the others mean nothing
            return None
        column, rule = fault_of_columns(columns)
        if column:
            value = columns[COLUMNS.index(column)]
            raise CaseError(f"{self._place('gen', row)}: {name}: {column} = {value:g}: {rule}")
        p = record["pmin"], record["pmax"]
        if not all(map(math.isfinite, p)):
            self.losses.add(f"{name}: a capability curve with unlimited active power; it is left out")
            return None
        return polygon_of(columns, p, (record["qmin"], record["qmax"]))

    def _cost(self, name: str, row: int, record: Mapping[str, Any]) -> Cost:
        """Cost of a generator; raises an error unless the model is known and the data are complete."""
        model, width = record["model"], 2 if record["model"] == 1 else 1
        values = [float(c) for c in record["coeffs"]][: width * int(record["ncost"])]
        if model not in (1, 2) or not values or len(values) != width * int(record["ncost"]):
            raise CaseError(
                f"{self._place('gencost', row)}: {name}: cost: model {model} with {record['ncost']} terms "
                f"and {len(values)} numbers; must be a polynomial or piecewise-linear cost"
            )
        if model == 1:
            return PiecewiseLinear(tuple(zip(values[0::2], values[1::2], strict=True)))
        while len(values) > 3 and values[0] == 0:
            values = values[1:]
        if len(values) > 3:
            raise CaseError(
                f"{self._place('gencost', row)}: {name}: cost: a polynomial of degree {len(values) - 1}; "
                "degrees up to 2 and convex piecewise-linear costs are accepted"
            )
        c2, c1, c0 = [0.0] * (3 - len(values)) + values
        return Polynomial(c2, c1, c0)

    def _storage(self, row: int, record: Mapping[str, Any]) -> None:
        number = {
            key: float(value)
            for key, value in record.items()
            if isinstance(value, int | float | str) and key not in ("bus", "uid")
        }
        for key in ("r", "x", "p_loss", "q_loss"):
            if number.get(key):
                self.losses.add(
                    f"storage{record['bus']}: {key} = {number[key]:g}: losses are modelled by the "
                    "efficiencies and standing_loss only"
                )
        rating = number.get("thermal_rating", math.inf)
        self._add(
            f"storage{record['bus']}",
            Storage(
                str(record["bus"]),
                energy=number["energy_rating"],
                power=(-number["discharge_rating"], number["charge_rating"]),
                q=(number["qmin"], number["qmax"]),
                initial=number["energy"],
                charge_efficiency=number["charge_efficiency"],
                discharge_efficiency=number["discharge_efficiency"],
                rating=rating if rating > 0 else None,
                ps_set=number["ps"] or None,
                qs_set=number["qs"] or None,
                in_service=bool(record["in_service"]),
            ),
            "storage",
            row,
        )

    def _dc_line(self, row: int, record: Mapping[str, Any]) -> None:
        name, in_service = f"dcline{row + 1}", bool(record["in_service"])
        fixed, share = record["loss0"], record["loss1"]
        p = _at_from_end(record["pmin"], fixed, share), _at_from_end(record["pmax"], fixed, share)
        if in_service and share and p[0] < 0:
            self.losses.add(
                f"{name}: LOSS1 = {share:g} with PMIN = {record['pmin']:g}: power that flows backward gains; "
                "the loss of a DC line counts in both directions"
            )
        self._add(
            name,
            DCLine(
                str(record["from"]),
                str(record["to"]),
                p=p,
                loss=share,
                loss_fixed=fixed,
                q_from=(record["qminf"], record["qmaxf"]),
                q_to=(record["qmint"], record["qmaxt"]),
                cost=self._cost_of_dc_line(name, record["cost"], p) if in_service else 0.0,
                pf_set=record["pf"],
                qf_set=record["qf"],
                qt_set=record["qt"],
                in_service=in_service,
            ),
            "dcline",
            row,
        )

    def _cost_of_dc_line(self, name: str, record: Mapping[str, Any] | None, p: tuple[float, float]) -> float:
        """Return the cost of the power on a DC line, $/MWh; a cost of another form is lost."""
        values = [] if record is None else [float(c) for c in record["coeffs"]][: int(record["ncost"])]
        if not any(values):
            return 0.0
        sign = 1.0 if p[0] >= 0 else -1.0
        linear = record is not None and record["model"] == 2 and not any((*values[:-2], values[-1]))
        if linear and sign * values[-2] > 0 and not p[0] < 0 < p[1]:
            return sign * values[-2]
        self.losses.add(
            f"{name}: its cost is left out; only one in proportion to the power that flows, at least 0, is "
            "represented"
        )
        return 0.0


def _at_from_end(limit: float, fixed: float, share: float) -> float:
    """Return a limit of MATPOWER as one of the power that enters at the from end.

    There it limits PF if it is positive, and PT if it is negative.
    """
    if limit >= 0:
        return limit
    received = limit + fixed
    return received * (1.0 - share) if received <= 0 else received / (1.0 - share)


def _emergency(record: Mapping[str, Any]) -> float | None:
    """Return the third rating of a branch, else the second; 0 and infinity state none."""
    stated = (record[key] for key in ("rate_c", "rate_b"))
    return next((value for value in stated if value and value != math.inf), None)


def _angles(low: float, high: float) -> tuple[float, float]:
    """Angle limits; MATPOWER writes 0, 0 for no limit."""
    return (-360.0, 360.0) if low == high == 0 else (low, high)
