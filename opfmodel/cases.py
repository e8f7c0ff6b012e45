"""Network files, read and written through powerio.

Reading covers MATPOWER ``.m``, PSS/E ``.raw``, pandapower JSON, PyPSA CSV folders and the other
formats of powerio. What the reader finds remarkable reaches the user as :class:`CaseWarning`;
equipment in service that opfmodel does not model is an error, never silently left out.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from opfmodel.components import (
    Branch,
    Bus,
    Component,
    Cost,
    Generator,
    Load,
    Network,
    PiecewiseLinear,
    Polynomial,
    Shunt,
    Storage,
)
from opfmodel.data.files import check_file, is_folder
from opfmodel.errors import CaseError, CaseWarning, ComponentError, OpfmodelError, visible
from opfmodel.matpower import CaseFile, read_case

__all__ = ["read_network", "write_network"]


def read_network(path: str | Path, *, default_cost: Cost | None = None, format: str | None = None) -> Network:
    """Read a network file.

    Buses are named by their number or identifier, generators ``gen1, gen2, ...`` in the order of
    the file, branches ``FROM-TO`` (with ``#2``, ``#3`` for parallel ones), loads, shunts and
    storages ``loadBUS``, ``shuntBUS`` and ``storageBUS``.

    Parameters
    ----------
    path
        The file, or the folder of a PyPSA CSV export.
    default_cost
        Cost of generators for which the file states none, for instance in PSS/E files.
    format
        Name of the format if it cannot be told from the file, for instance ``"psse"``.

    Raises
    ------
    CaseError
        The file is missing, not a regular one, damaged, of an unknown format, has generators without
        cost and no ``default_cost`` is given, or holds equipment in service that opfmodel does not
        model or data that break a rule.

    Notes
    -----
    Equipment out of service is kept as it is (:meth:`opfmodel.components.Component.check_declared`),
    unless its cost cannot be stated, when it is left out with a warning. The tables of MATPOWER files
    are checked by :mod:`opfmodel.matpower` first.
    """
    path = Path(path)
    module, source = _parse(path, format)
    case = _balanced(path, module.value)
    try:
        name = path.stem if case.name in ("", "case") else str(case.name)
        return _Reader(path, case, Network(name, case.base_mva), default_cost, source).read()
    except CaseError:
        raise
    except OpfmodelError as error:
        raise CaseError(f"{path}: {error}") from error


def _parse(path: Path, format: str | None) -> tuple[Any, CaseFile | None]:
    """What powerio makes of a file; its warnings and ours are given."""
    import powerio

    source = read_case(path) if _is_matpower(path, format) else None
    try:
        if source is not None:
            module = powerio.parse(source.text.encode(), format="matpower", name=path.name)
        else:
            for file in sorted(path.iterdir()) if is_folder(path) else [path]:
                if not is_folder(file):
                    check_file(file, CaseError)
            # powerio refuses symbolic links; a user who names one means what it points to.
            module = powerio.parse(str(path.resolve()), format=format)
    except (powerio.PowerIOError, OSError, UnicodeError) as error:
        raise CaseError(f"{path}: cannot be read as a network: {error}") from error
    diagnostics = list(module.diagnostics)
    if source is not None:
        if source.changes and any(d.code == _NOT_EVALUATED for d in diagnostics):
            # powerio evaluates all of them or none; unlike it we know the lines.
            source.remarks.append(source.unevaluated(source.changes))
            diagnostics = [d for d in diagnostics if d.code != _NOT_EVALUATED]
        for remark in source.remarks:
            _warn(remark)
    for diagnostic in diagnostics:
        _warn(f"{path}: {diagnostic.message} [{diagnostic.code}]")
    return module, source


_NOT_EVALUATED = "READ.MATPOWER.INDEXED_ASSIGNMENT"


def _is_matpower(path: Path, format: str | None) -> bool:
    import powerio

    if format is None:
        return path.suffix.lower() == ".m"
    known = powerio.resolve_format(format)
    return known is not None and known.token == "matpower"


def _balanced(path: Path, value: Any) -> Any:
    """The balanced network inside whatever powerio returned."""
    import powerio

    if isinstance(value, powerio.TimeSeries):
        _warn(f"{path}: the file holds {len(value)} snapshots; the network of the first is taken")
        value = value[0]
    if hasattr(value, "network"):
        value = value.network
    if not isinstance(value, powerio.BalancedNetwork):
        raise CaseError(f"{path}: holds a {type(value).__name__}, not a balanced transmission network")
    if any(switch["closed"] for switch in value.switches):
        value = value.merge_buses(closed_switches=True).network
        _warn(f"{path}: buses joined by closed switches were merged")
    unmodelled = {
        "hvdc": "HVDC lines",
        "static_var_compensators": "static var compensators",
        "transformers_3w": "three-winding transformers",
    }
    for kind, what in unmodelled.items():
        members = [record for record in _records(value, kind) if record["in_service"]]
        if members:
            raise CaseError(
                f"{path}: {len(members)} {what} in service, which opfmodel does not model; "
                "take them out of service, or replace them by branches, generators and loads"
            )
    return value


def _records(case: Any, kind: str) -> Sequence[Mapping[str, Any]]:
    """The records of a kind that is seldom there: powerio walks through the case even for none."""
    return getattr(case, kind) if getattr(case, f"n_{kind}") else ()


class _Reader:
    """Turns powerio's records into components."""

    def __init__(
        self,
        path: Path,
        case: Any,
        network: Network,
        default_cost: Cost | None,
        source: CaseFile | None,
    ) -> None:
        self.path = path
        self.source = source
        self.case = case
        self.network = network
        self.default_cost = default_cost
        self.numbers: dict[str, int] = {}  # how many components ask for a name
        self.bus_row = {record["id"]: row for row, record in enumerate(case.buses)}

    def read(self) -> Network:
        """Declare everything."""
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
        for row, record in enumerate(_records(self.case, "storage")):
            self._storage(row, record)
        return self.network

    def _add(self, name: str, component: Component, table: str, row: int | None) -> None:
        """Declare the component of a row of a table, numbering the second and later ones of a name."""
        number = self.numbers[name] = self.numbers.get(name, 0) + 1
        unique = name if number == 1 else f"{name}#{number}"
        try:
            self.network.add(unique, component)
        except ComponentError as error:
            table = "gencost" if error.field == "cost" else table
            raise CaseError(f"{self._place(table, row)}: {error}") from error

    def _place(self, table: str, row: int | None) -> str:
        """The file, and the line where it is known."""
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
                    in_service=record["kind"] != "ISOLATED",
                ),
                "bus",
                row,
            )

    def _branches(self) -> None:
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
                _warn(f"{error}; the generator is out of service and left out")
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
                    in_service=in_service,
                ),
                "gen",
                row,
            )
        if without:
            raise CaseError(
                f"{self.path}: no cost data for {_listing(without)}; give a cost for generators without "
                "(default_cost=Polynomial(0, 30, 0) in Python, --default-cost 30 on the command line, "
                "network.default_cost in a scenario)"
            )

    def _cost(self, name: str, row: int, record: Mapping[str, Any]) -> Cost:
        """The cost of a generator; an error unless it is one of the two forms, and complete."""
        model, width = record["model"], 2 if record["model"] == 1 else 1
        values = [float(c) for c in record["coeffs"]][: width * int(record["ncost"])]
        if model not in (1, 2) or not values or len(values) != width * int(record["ncost"]):
            raise CaseError(
                f"{self._place('gencost', row)}: {name}: cost: model {model} with {record['ncost']} terms "
                f"and {len(values)} numbers; a polynomial or piecewise-linear cost is needed"
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
        losses = [key for key in ("r", "x", "p_loss", "q_loss") if number.get(key)]
        if losses:
            _warn(
                f"{self.path}: storage at bus {record['bus']}: {', '.join(losses)} are left out; "
                "state losses by efficiencies and standing_loss"
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
                in_service=bool(record["in_service"]),
            ),
            "storage",
            row,
        )


def _angles(low: float, high: float) -> tuple[float, float]:
    """MATPOWER writes 0, 0 where there is no limit."""
    return (-360.0, 360.0) if low == high == 0 else (low, high)


# Writing ----------------------------------------------------------------------------------------


def write_network(network: Network, path: str | Path) -> Path:
    """Write a network as a MATPOWER case, version 2.

    Buses keep their numbers if all names are positive integers and are numbered from 1 otherwise.
    Storages are written as the table ``mpc.storage`` that PowerModels uses. What the format
    cannot hold is reported as :class:`CaseWarning`.

    Raises
    ------
    CaseError
        The file cannot be written, or its name does not end in ``.m``.
    """
    import powerio

    path = Path(path)
    if path.suffix != ".m":
        raise CaseError(f"{path}: a MATPOWER case ends in .m")
    names = network.of(Bus)
    plain = all(re.fullmatch("[1-9][0-9]{0,14}", name) for name in names)
    ids = {name: int(name) if plain else i for i, name in enumerate(names, start=1)}
    if not plain:
        _warn(f"{path}: buses are numbered from 1 in the order of their declaration")
    idle = [n for n in network if isinstance(network[n], Load | Shunt) and not network[n].in_service]
    if idle:
        _warn(f"{path}: {_listing(idle)}: MATPOWER has no status of loads and shunts; they are left out")
    tables = {
        "version": 2,
        "baseMVA": network.base_mva,
        "bus": _bus_rows(network, ids),
        "gen": [_generator_row(g, ids, network.base_mva) for g in network.of(Generator).values()],
        "branch": [_branch_row(path, n, b, ids) for n, b in network.of(Branch).items()],
        "gencost": _cost_rows(network.of(Generator).values()),
    }
    module = powerio.PioModule.from_value(powerio.from_ppc(tables))
    emitted = powerio.emit(module, "matpower")
    for diagnostic in emitted.diagnostics:
        _warn(f"{path}: {diagnostic.message} [{diagnostic.code}]")
    text = str(emitted.text).replace("mpc = from_ppc", f"mpc = {_identifier(path.stem)}")
    try:
        path.write_text(text + _storage_table(path, network, ids), encoding="utf-8")
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        raise CaseError(f"{path}: cannot be written: {getattr(error, 'strerror', None) or error}") from error
    return path


def _bus_rows(network: Network, ids: Mapping[str, int]) -> list[list[float]]:
    demand = {name: [0.0, 0.0, 0.0, 0.0] for name in ids}
    for load in network.of(Load).values():
        if load.in_service:
            demand[load.bus][0] += load.p
            demand[load.bus][1] += load.q
    for shunt in network.of(Shunt).values():
        if shunt.in_service:
            demand[shunt.bus][2] += shunt.g
            demand[shunt.bus][3] += shunt.b
    with_generator = {g.bus for g in network.of(Generator).values()}
    rows = []
    for name, bus in network.of(Bus).items():
        kind = 4 if not bus.in_service else 3 if bus.reference else 2 if name in with_generator else 1
        rows.append(
            [ids[name], kind, *demand[name], 1, 1.0, 0.0, bus.base_kv or 0.0, 1, bus.vm[1], bus.vm[0]]
        )
    return rows


def _generator_row(generator: Generator, ids: Mapping[str, int], base_mva: float) -> list[float]:
    (p_min, p_max), (q_min, q_max) = generator.p, generator.q
    ramp_30 = 0.0 if generator.ramp is None else generator.ramp / 2
    row = [ids[generator.bus], max(p_min, 0.0), 0.0, q_max, q_min, 1.0, base_mva]
    return [*row, float(generator.in_service), p_max, p_min, *[0.0] * 8, ramp_30, 0.0, 0.0]


def _branch_row(path: Path, name: str, branch: Branch, ids: Mapping[str, int]) -> list[float]:
    if branch.g or branch.g_from or branch.g_to or branch.b_from != branch.b_to:
        _warn(f"{path}: {name}: MATPOWER has no shunt conductance or uneven charging; they are left out")
    rating = 0.0 if branch.rating is None else branch.rating
    charging = branch.b + 2 * min(branch.b_from, branch.b_to, key=abs)
    row = [ids[branch.from_bus], ids[branch.to_bus], branch.r, branch.x, charging, rating, rating, rating]
    ratio = 0.0 if branch.tap == 1 and branch.shift == 0 else branch.tap
    return [*row, ratio, branch.shift, float(branch.in_service), *branch.angle]


def _cost_rows(generators: Iterable[Generator]) -> list[list[float]]:
    rows: list[list[float]] = []
    for generator in generators:
        cost = generator.cost
        if isinstance(cost, PiecewiseLinear):
            rows.append([1, 0, 0, len(cost.points), *(v for point in cost.points for v in point)])
        else:
            assert isinstance(cost, Polynomial)
            rows.append([2, 0, 0, 3, cost.c2, cost.c1, cost.c0])
    width = max((len(r) for r in rows), default=0)
    return [r + [0.0] * (width - len(r)) for r in rows]


def _storage_table(path: Path, network: Network, ids: Mapping[str, int]) -> str:
    columns = (
        "storage_bus ps qs energy energy_rating charge_rating discharge_rating charge_efficiency "
        "discharge_efficiency thermal_rating qmin qmax r x p_loss q_loss status"
    )
    rows = []
    for name, declared in network.of(Storage).items():
        storage = declared.resolved()
        assert storage.initial is not None
        if storage.standing_loss or storage.energy_min:
            _warn(f"{path}: {name}: standing_loss and energy_min are left out")
        ends = [v if isinstance(v, tuple) else (-v, v) for v in (storage.power, storage.q)]
        (p_min, p_max), (q_min, q_max) = ends
        if storage.in_service and (p_min > 0 or p_max < 0):
            raise CaseError(f"{path}: {name}: power = {storage.power}: MATPOWER needs a range around 0")
        rating = 0.0 if storage.rating is None else storage.rating
        values = [
            ids[storage.bus], 0, 0, storage.initial, storage.energy, p_max, -p_min,
            storage.charge_efficiency, storage.discharge_efficiency, rating, q_min, q_max,
            0, 0, 0, 0, int(storage.in_service),
        ]  # fmt: skip
        rows.append("\t" + "\t".join(_plain(v) for v in values) + ";")
    if not rows:
        return ""
    return "\n".join(["", f"%column_names% {columns}", "mpc.storage = [", *rows, "];", ""])


def _plain(number: float) -> str:
    """A number as a file has it; NumPy's would be written with their type."""
    return repr(number if isinstance(number, int) else float(number))


def _identifier(name: str) -> str:
    cleaned = "".join(c if c.isalnum() else "_" for c in name)
    return cleaned if cleaned[:1].isalpha() else f"case_{cleaned}"


def _listing(names: Sequence[str]) -> str:
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")


def _warn(message: str) -> None:
    warnings.warn(visible(message), CaseWarning, stacklevel=3)
