"""Writing of networks as MATPOWER cases with powerio."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from opfmodel.data.writing import replace
from opfmodel.errors import CaseError, listed
from opfmodel.network.cases.capability import COLUMNS, Trapezoid, trapezoid_of
from opfmodel.network.cases.losses import Losses
from opfmodel.network.cases.warn import warn
from opfmodel.network.component import Component
from opfmodel.network.components import Branch, Bus, DCLine, Generator, Load, Shunt, Storage
from opfmodel.network.costs import PiecewiseLinear, Polynomial
from opfmodel.network.network import Network

__all__ = ["find_losses", "tables_of", "write_network"]

_WRITTEN = (Bus, Branch, DCLine, Generator, Storage, Load, Shunt)  # kinds that a case has


def write_network(network: Network, path: str | Path, *, lossy: bool = True) -> Path:
    """Write a network as a MATPOWER case, version 2.

    Buses keep their numbers if all names are positive integers, and are numbered from 1 otherwise.
    Storages are written to the table ``mpc.storage`` of PowerModels, DC lines to ``mpc.dcline`` and, if they
    have costs, ``mpc.dclinecost``.

    Parameters
    ----------
    lossy
        Whether data that the format cannot represent are left out with a :class:`CaseWarning`; otherwise
        they are an error, and nothing is written.

    Raises
    ------
    CaseError
        The file cannot be written, its name does not end in ``.m``, the power range of a storage in
        service does not include 0, or something would be lost and ``lossy`` is false.
    """
    import powerio

    path = Path(path)
    if path.suffix != ".m":
        raise CaseError(f"{path}: the name of a MATPOWER case must end in .m")
    names = network.of(Bus)
    plain = all(re.fullmatch("[1-9][0-9]{0,14}", name) for name in names)
    ids = {name: int(name) if plain else i for i, name in enumerate(names, start=1)}
    losses = Losses(str(path), writing=True)
    find_losses(network, losses)
    for name, line in network.of(DCLine).items():
        for loss in _losses_of_dc_line(line):
            losses.add(f"{name}: {loss}")
    losses.settle(lossy)
    if not plain:
        warn(f"{path}: buses are numbered from 1 in order of declaration")
    if any(bus.x is not None for bus in network.of(Bus).values()):
        warn(f"{path}: the places of buses on the map are left out")
    tables = tables_of(network, ids)
    module = powerio.PioModule.from_value(powerio.from_ppc(tables))
    emitted = powerio.emit(module, "matpower")
    for diagnostic in emitted.diagnostics:
        warn(f"{path}: {diagnostic.message} [{diagnostic.code}]")
    more = _dc_line_tables(network, ids) + _storage_table(path, network, ids)
    text = str(emitted.text).replace("mpc = from_ppc", f"mpc = {_identifier(path.stem)}")
    try:
        replace({path: (text + more).encode()})
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        raise CaseError(f"{path}: cannot be written: {getattr(error, 'strerror', None) or error}") from error
    return path


def tables_of(network: Network, ids: Mapping[str, int]) -> dict[str, Any]:
    """Return the tables of MATPOWER as rows of numbers, without storages.

    Parameters
    ----------
    ids
        Number of each bus.
    """
    buses, generators = network.of(Bus), network.of(Generator).values()
    branches = network.of(Branch).values()
    stated = any(branch.emergency_rating is not None for branch in branches)
    return {
        "version": 2,
        "baseMVA": network.base_mva,
        "bus": _bus_rows(network, ids),
        "gen": [_generator_row(g, buses, ids, network.base_mva) for g in generators],
        "branch": [_branch_row(b, ids, stated) for b in branches],
        "gencost": _cost_rows(generators),
    }


def find_losses(network: Network, losses: Losses) -> None:
    """Report what a MATPOWER case cannot represent."""
    for kind in network.kinds():
        if kind not in _WRITTEN and network.of(kind):
            losses.add(f"{kind.plural} {listed(network.of(kind))}: MATPOWER has no such equipment")
    if network.profiles:
        losses.add(f"{len(network.profiles)} time series: a case holds constant values")
    for loss in _losses_of_demand(network):
        losses.add(loss)
    for name in network:
        for loss in _losses_of(network[name]):
            losses.add(f"{name}: {loss}")
    regulated = _regulated(network)
    for name, generator in network.of(Generator).items():
        if generator.in_service and generator.regulates != regulated[generator.bus]:
            losses.add(
                f"{name}: regulates = {str(generator.regulates).lower()}: "
                "the generators at one bus all hold its voltage, or none does"
            )
        for loss in _losses_of_generator(generator):
            losses.add(f"{name}: {loss}")


def _losses_of_generator(generator: Generator) -> Iterator[str]:
    if generator.capability is not None and _trapezoid(generator) is None:
        yield (
            "capability: MATPOWER has one sloped line above and one below, which narrow towards "
            "the maximum of active power; it is left out"
        )
    if generator.participation is not None:
        yield "participation is left out"
    if generator.in_service and generator.on != 1.0:
        yield f"on = {generator.on:g} is left out; the limits and costs are those of on = 1"
    of_commitment = ("start_cost", "min_up", "min_down", "hours_on")
    stated = [key for key in of_commitment if getattr(generator, key) != Generator.fields()[key].default]
    if stated:
        yield f"{listed(stated)}: data of a commitment are left out"


def _losses_of_demand(network: Network) -> Iterator[str]:
    idle = [n for n in network if isinstance(network[n], Load | Shunt) and not network[n].in_service]
    if idle:
        yield f"{listed(idle)}: MATPOWER has no status for loads and shunts; they are left out"
    for name, load in network.of(Load).items():
        if load.in_service and load.shed_cost is not None:
            yield f"{name}: shed_cost is left out"


def _losses_of(component: Component) -> Iterator[str]:
    for key in ("tap", "shift", "b"):
        if isinstance(getattr(component, key, None), tuple):
            yield f"{key} is adjustable; a case holds one value, that nearest to its default"
    if isinstance(component, Branch):
        yield from _losses_of_branch(component)
    if isinstance(component, Storage):
        yield from _losses_of_storage(component)


def _losses_of_branch(branch: Branch) -> Iterator[str]:
    if branch.g or branch.g_from or branch.g_to or branch.b_from != branch.b_to:
        yield "MATPOWER has no branch shunt conductance or uneven charging; they are left out"
    if branch.emergency_rating == 0:
        yield "emergency_rating = 0: MATPOWER's 0 means that none is stated"


def _losses_of_storage(storage: Storage) -> Iterator[str]:
    if storage.standing_loss or storage.energy_min:
        yield "standing_loss and energy_min are left out"
    if storage.throughput_cost or storage.wanted is not None or storage.recovery_cost is not None:
        yield "throughput_cost, wanted and recovery_cost are left out"
    if storage.exclusive:
        yield "exclusive is left out"
    if storage.capability is not None:
        yield "capability is left out"


def _losses_of_dc_line(line: DCLine) -> Iterator[str]:
    if not line.in_service:
        return
    backward = line.constant("p_min") < 0
    if backward and line.loss:
        yield "in MATPOWER, power that flows backward gains by the loss"
    if backward and line.cost and line.constant("p_max") > 0:
        yield "in MATPOWER, the cost is earned on power that flows backward"


def _regulated(network: Network) -> dict[str, bool]:
    """Whether the generators at each bus hold its voltage; idle ones count where there are no others."""
    regulated = {name: bus.reference for name, bus in network.of(Bus).items()}
    running = {g.bus for g in network.of(Generator).values() if g.in_service}
    for generator in network.of(Generator).values():
        if generator.in_service or generator.bus not in running:
            regulated[generator.bus] |= generator.regulates
    return regulated


def _bus_rows(network: Network, ids: Mapping[str, int]) -> list[list[float]]:
    demand = {name: [0.0, 0.0, 0.0, 0.0] for name in ids}
    for load in network.of(Load).values():
        if load.in_service:
            demand[load.bus][0] += load.p
            demand[load.bus][1] += load.q
    for shunt in network.of(Shunt).values():
        if shunt.in_service:
            demand[shunt.bus][2] += shunt.g
            demand[shunt.bus][3] += shunt.neutral("b")
    regulated = _regulated(network)
    rows = []
    for name, bus in network.of(Bus).items():
        kind = 4 if not bus.in_service else 3 if bus.reference else 2 if regulated[name] else 1
        voltage = [1.0, bus.va_set, bus.base_kv or 0.0]
        rows.append([ids[name], kind, *demand[name], 1, *voltage, 1, bus.vm[1], bus.vm[0]])
    return rows


def _generator_row(
    generator: Generator, buses: Mapping[str, Bus], ids: Mapping[str, int], base_mva: float
) -> list[float]:
    curve = _trapezoid(generator) or Trapezoid(generator.p, generator.q, (0.0,) * len(COLUMNS))
    (p_min, p_max), (q_min, q_max) = curve.p, curve.q
    ramp_30 = 0.0 if generator.ramp is None else generator.ramp / 2
    p, q, vm = (
        _set_point(stated, default, limits)
        for stated, default, limits in (
            (generator.pg_set, 0.0, generator.p),
            (generator.qg_set, 0.0, generator.q),
            (generator.vm_set, 1.0, buses[generator.bus].vm),
        )
    )
    row = [ids[generator.bus], p, q, q_max, q_min, vm, base_mva]
    return [*row, float(generator.in_service), p_max, p_min, *curve.columns, 0.0, 0.0, ramp_30, 0.0, 0.0]


def _trapezoid(generator: Generator) -> Trapezoid | None:
    """Return the capability curve of a generator in MATPOWER's form; None if it has none or no such form."""
    if generator.capability is None:
        return None
    return trapezoid_of(generator.capability, generator.p, generator.q)


def _set_point(stated: float | None, default: float, limits: tuple[float, float]) -> float:
    """Return the set-point of a power flow, by default the value within the limits closest to ``default``."""
    return min(max(default, limits[0]), limits[1]) if stated is None else stated


def _branch_row(branch: Branch, ids: Mapping[str, int], stated: bool) -> list[float]:
    """Return the row of a branch, in a case that states emergency ratings or repeats the rating for them."""
    rating = 0.0 if branch.rating is None else branch.rating
    emergency = (branch.emergency_rating or 0.0) if stated else rating
    charging = branch.b + 2 * min(branch.b_from, branch.b_to, key=abs)
    row = [ids[branch.from_bus], ids[branch.to_bus], branch.r, branch.x, charging, rating, *[emergency] * 2]
    tap, shift = branch.neutral("tap"), branch.neutral("shift")
    ratio = 0.0 if tap == 1 and shift == 0 else tap
    return [*row, ratio, shift, float(branch.in_service), *branch.angle]


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


def _dc_line_tables(network: Network, ids: Mapping[str, int]) -> str:
    """Return the tables of DC lines and, if there are any, of their costs."""
    lines = network.of(DCLine).values()
    if not lines:
        return ""
    columns = "fbus tbus status pf pt qf qt vf vt pmin pmax qminf qmaxf qmint qmaxt loss0 loss1"
    rows, costs = [], []
    for line in lines:
        p, q_from, q_to = (
            (line.constant(f"{key}_min"), line.constant(f"{key}_max")) for key in ("p", "q_from", "q_to")
        )
        stated = ((line.pf_set, p), (line.qf_set, q_from), (line.qt_set, q_to))
        pf, qf, qt = (_set_point(value, 0.0, limits) for value, limits in stated)
        ends = [_of_matpower(limit, line) for limit in p]
        values = [
            ids[line.from_bus], ids[line.to_bus], int(line.in_service), pf,
            pf - line.loss_fixed - line.loss * pf, qf, qt, 1, 1, *ends, *q_from, *q_to,
            line.loss_fixed, line.loss,
        ]  # fmt: skip
        rows.append("\t" + "\t".join(_plain(v) for v in values) + ";")
        costs.append(f"\t2\t0\t0\t2\t{_plain(line.cost if p[1] > 0 else -line.cost)}\t0;")
    text = ["", f"%column_names% {columns}", "mpc.dcline = [", *rows, "];", ""]
    if any(line.cost for line in lines):
        text += ["mpc.dclinecost = [", *costs, "];", ""]
    return "\n".join(text)


def _of_matpower(limit: float, line: DCLine) -> float:
    """Return a limit of MATPOWER, which is one of the power that leaves at the to end if it is negative."""
    return limit if limit >= 0 else limit / (1.0 - line.loss) - line.loss_fixed


def _storage_table(path: Path, network: Network, ids: Mapping[str, int]) -> str:
    columns = (
        "storage_bus ps qs energy energy_rating charge_rating discharge_rating charge_efficiency "
        "discharge_efficiency thermal_rating qmin qmax r x p_loss q_loss status"
    )
    rows = []
    for name, declared in network.of(Storage).items():
        storage = declared.resolved()
        assert storage.initial is not None
        ends = [v if isinstance(v, tuple) else (-v, v) for v in (storage.power, storage.q)]
        (p_min, p_max), (q_min, q_max) = ends
        if storage.in_service and (p_min > 0 or p_max < 0):
            raise CaseError(
                f"{path}: {name}: power = {storage.power}: MATPOWER requires a range that includes 0"
            )
        rating = 0.0 if storage.rating is None else storage.rating
        values = [
            ids[storage.bus], storage.ps_set or 0, storage.qs_set or 0, storage.initial, storage.energy,
            p_max, -p_min, storage.charge_efficiency, storage.discharge_efficiency, rating, q_min, q_max,
            0, 0, 0, 0, int(storage.in_service),
        ]  # fmt: skip
        rows.append("\t" + "\t".join(_plain(v) for v in values) + ";")
    if not rows:
        return ""
    return "\n".join(["", f"%column_names% {columns}", "mpc.storage = [", *rows, "];", ""])


def _plain(number: float) -> str:
    """Format a number for a file; the ``repr`` of NumPy numbers includes their type."""
    return repr(number if isinstance(number, int) else float(number))


def _identifier(name: str) -> str:
    cleaned = "".join(c if c.isalnum() else "_" for c in name)
    return cleaned if cleaned[:1].isalpha() else f"case_{cleaned}"
