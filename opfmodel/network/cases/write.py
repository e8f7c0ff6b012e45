"""Writing of networks as MATPOWER cases with powerio."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from opfmodel.data.writing import replace
from opfmodel.errors import CaseError, listed
from opfmodel.network.cases.warn import warn
from opfmodel.network.components import Branch, Bus, Generator, Load, Shunt, Storage
from opfmodel.network.costs import PiecewiseLinear, Polynomial
from opfmodel.network.network import Network

__all__ = ["write_network"]


def write_network(network: Network, path: str | Path) -> Path:
    """Write a network as a MATPOWER case, version 2.

    Buses keep their numbers if all names are positive integers, and are numbered from 1 otherwise.
    Storages are written to the table ``mpc.storage`` of PowerModels. Data that the format cannot
    represent are left out with a :class:`CaseWarning`.

    Raises
    ------
    CaseError
        The file cannot be written, its name does not end in ``.m``, or the power range of a storage in
        service does not include 0.
    """
    import powerio

    path = Path(path)
    if path.suffix != ".m":
        raise CaseError(f"{path}: the name of a MATPOWER case must end in .m")
    _warn_of_set_points(path, network)
    names = network.of(Bus)
    plain = all(re.fullmatch("[1-9][0-9]{0,14}", name) for name in names)
    ids = {name: int(name) if plain else i for i, name in enumerate(names, start=1)}
    if not plain:
        warn(f"{path}: buses are numbered from 1 in order of declaration")
    idle = [n for n in network if isinstance(network[n], Load | Shunt) and not network[n].in_service]
    if idle:
        warn(f"{path}: {listed(idle)}: MATPOWER has no status for loads and shunts; they are left out")
    tables = {
        "version": 2,
        "baseMVA": network.base_mva,
        "bus": _bus_rows(network, ids),
        "gen": [_generator_row(network, g, ids) for g in network.of(Generator).values()],
        "branch": [_branch_row(path, n, b, ids) for n, b in network.of(Branch).items()],
        "gencost": _cost_rows(network.of(Generator).values()),
    }
    module = powerio.PioModule.from_value(powerio.from_ppc(tables))
    emitted = powerio.emit(module, "matpower")
    for diagnostic in emitted.diagnostics:
        warn(f"{path}: {diagnostic.message} [{diagnostic.code}]")
    text = str(emitted.text).replace("mpc = from_ppc", f"mpc = {_identifier(path.stem)}")
    try:
        replace({path: (text + _storage_table(path, network, ids)).encode()})
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
    regulated = {g.bus for g in network.of(Generator).values() if g.regulates}
    rows = []
    for name, bus in network.of(Bus).items():
        kind = 4 if not bus.in_service else 3 if bus.reference else 2 if name in regulated else 1
        voltage = [1.0, bus.va_set, bus.base_kv or 0.0]
        rows.append([ids[name], kind, *demand[name], 1, *voltage, 1, bus.vm[1], bus.vm[0]])
    return rows


def _generator_row(network: Network, generator: Generator, ids: Mapping[str, int]) -> list[float]:
    (p_min, p_max), (q_min, q_max) = generator.p, generator.q
    bus = network[generator.bus]
    assert isinstance(bus, Bus)
    pg, qg, vm = (
        _within(default, limits) if value is None else value
        for value, default, limits in (
            (generator.pg_set, 0.0, generator.p),
            (generator.qg_set, 0.0, generator.q),
            (generator.vm_set, 1.0, bus.vm),
        )
    )
    ramp_30 = 0.0 if generator.ramp is None else generator.ramp / 2
    row = [ids[generator.bus], pg, qg, q_max, q_min, vm, network.base_mva]
    return [*row, float(generator.in_service), p_max, p_min, *[0.0] * 8, ramp_30, 0.0, 0.0]


def _within(value: float, limits: tuple[float, float]) -> float:
    """Return the number within limits that is nearest to a value."""
    return min(max(value, limits[0]), limits[1])


def _warn_of_set_points(path: Path, network: Network) -> None:
    """Warn of set-points that have no column: what a generator does follows from the type of its bus."""
    generators = network.of(Generator)
    regulated = {g.bus for g in generators.values() if g.regulates}
    regulated |= {name for name, bus in network.of(Bus).items() if bus.reference}
    mixed = [name for name, g in generators.items() if not g.regulates and g.bus in regulated]
    if mixed:
        warn(f"{path}: {listed(mixed)}: MATPOWER lets all generators of a bus regulate its voltage, or none")
    weighted = [name for name, g in generators.items() if g.participation is not None]
    if weighted:
        warn(f"{path}: {listed(weighted)}: participation is left out")


def _branch_row(path: Path, name: str, branch: Branch, ids: Mapping[str, int]) -> list[float]:
    if branch.g or branch.g_from or branch.g_to or branch.b_from != branch.b_to:
        warn(
            f"{path}: {name}: MATPOWER has no branch shunt conductance or uneven charging; they are left out"
        )
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
            warn(f"{path}: {name}: standing_loss and energy_min are left out")
        ends = [v if isinstance(v, tuple) else (-v, v) for v in (storage.power, storage.q)]
        (p_min, p_max), (q_min, q_max) = ends
        if storage.in_service and (p_min > 0 or p_max < 0):
            raise CaseError(
                f"{path}: {name}: power = {storage.power}: MATPOWER requires a range that includes 0"
            )
        rating = 0.0 if storage.rating is None else storage.rating
        values = [
            ids[storage.bus], storage.ps_set or 0, storage.qs_set or 0,
            storage.initial, storage.energy, p_max, -p_min, storage.charge_efficiency,
            storage.discharge_efficiency, rating, q_min, q_max,
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
