"""Writing of networks as JSON files of pandapower.

Pandapower's own converter makes the tables of buses, branches and generators. The result is read back and
compared with the network, quantity by quantity; whatever differs is a loss.
"""

from __future__ import annotations

import importlib.util
import json
import warnings
from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.data.writing import replace
from opfmodel.errors import CaseError, listed
from opfmodel.network.cases.losses import Losses
from opfmodel.network.cases.warn import warn
from opfmodel.network.cases.write import find_losses, tables_of
from opfmodel.network.components import Branch, Bus, DCLine, Generator, Load, Shunt, Storage
from opfmodel.network.costs import PiecewiseLinear
from opfmodel.network.network import Network
from opfmodel.network.physics import branch_admittance

__all__ = ["write_pandapower"]

_TOLERANCE = 1e-9  # relative, of a round trip through ohms, kiloamperes and percent
_NO_RATING = 99_999.0  # kA or MVA, which pandapower's converter writes
_INSTALL = "pip install 'opfmodel[pandapower]'"


def write_pandapower(network: Network, path: str | Path, *, lossy: bool = False) -> Path:
    """Write a network as a JSON file of pandapower.

    Buses keep their names; branches and generators get those of pandapower.

    Parameters
    ----------
    lossy
        Whether what the file cannot hold, such as angle limits, ramps and storages, is left out with a
        warning instead of refused.

    Raises
    ------
    CaseError
        pandapower is not installed, the file cannot be written, or something would be lost and ``lossy``
        is false.
    """
    path = Path(path)
    if importlib.util.find_spec("pandapower") is None:
        raise CaseError(f"{path}: writing needs pandapower, which is not installed: {_INSTALL}")
    import pandapower

    losses = Losses(str(path), writing=True)
    for loss in _unsupported(network):
        losses.add(loss)
    net = _converted(network, path)
    for loss in _differences(network, _read_back(net)):
        losses.add(loss)
    losses.settle(lossy)
    warn(f"{path}: branches and generators are renamed by pandapower")
    text = pandapower.to_json(net, None)
    try:
        replace({path: text.encode()})
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        raise CaseError(f"{path}: cannot be written: {getattr(error, 'strerror', None) or error}") from error
    return path


def _unsupported(network: Network) -> Iterator[str]:
    """What the tables have no place for."""
    running = {name: c for name in network if (c := network[name]).in_service}
    limited = [
        n for n, c in running.items() if isinstance(c, Branch) and (c.angle[0] > -360 or c.angle[1] < 360)
    ]
    if limited:
        yield f"angle limits of {listed(limited)}"
    emergency = [n for n, c in running.items() if isinstance(c, Branch) and c.emergency_rating is not None]
    if emergency:
        yield f"emergency ratings of {listed(emergency)}"
    ramping = [n for n, c in running.items() if isinstance(c, Generator) and c.ramp is not None]
    if ramping:
        yield f"ramps of {listed(ramping)}"
    curved = [n for n, c in running.items() if isinstance(c, Generator) and c.capability is not None]
    if curved:
        yield f"capability curves of {listed(curved)}"
    stored = [n for n, c in running.items() if isinstance(c, Storage)]
    if stored:
        yield f"storages {listed(stored)}"
    direct = [n for n, c in running.items() if isinstance(c, DCLine)]
    if direct:
        yield f"dc lines {listed(direct)}"
    found = Losses("")
    find_losses(network, found)
    yield from (loss for loss in found if loss.partition(":")[0] not in {*stored, *curved})


def _converted(network: Network, path: Path) -> Any:
    from pandapower.converter.pypower.from_ppc import from_ppc

    names = list(network.of(Bus))
    plain = network.copy()
    for name, unit in network.of(Generator).items():
        if unit.capability is not None:
            plain.update(name, capability=None)
    case = tables_of(plain, {name: number for number, name in enumerate(names, start=1)})
    for row in case["bus"]:
        row[2:6] = [0.0] * 4  # loads and shunts follow one by one, with their names
    ppc = {
        "version": "2",
        "baseMVA": network.base_mva,
        **{name: np.array(case[name], dtype=float) for name in ("bus", "gen", "branch", "gencost")},
    }
    try:
        with warnings.catch_warnings(action="ignore"):
            net = from_ppc(ppc)
    except (ArithmeticError, LookupError, TypeError, UserWarning, ValueError) as error:
        raise CaseError(f"{path}: pandapower cannot convert the network: {error}") from error
    for table in ("ext_grid", "gen", "sgen"):
        net[table]["controllable"] = True  # otherwise an optimum holds their voltage or power
    for table, rating in (("line", "max_i_ka"), ("trafo", "sn_mva")):
        unlimited = net[table][rating] >= _NO_RATING
        net[table]["max_loading_percent"] = np.where(unlimited, np.nan, 100.0)
    net.bus["name"] = names
    _add_places(net, network)
    net.name = network.name
    _add_loads_and_shunts(net, network)
    return net


def _add_places(net: Any, network: Network) -> None:
    """Write the places of buses as points in GeoJSON, as pandapower does."""
    points = [
        None if b.x is None or b.y is None else json.dumps({"type": "Point", "coordinates": [b.x, b.y]})
        for b in network.of(Bus).values()
    ]
    if any(points):
        net.bus["geo"] = points


def _add_loads_and_shunts(net: Any, network: Network) -> None:
    import pandapower

    place = dict(zip(net.bus["name"], net.bus.index, strict=True))
    for name, load in network.of(Load).items():
        pandapower.create_load(
            net, place[load.bus], load.p, load.q, name=name, in_service=load.in_service, controllable=False
        )
    for name, shunt in network.of(Shunt).items():
        pandapower.create_shunt(
            net, place[shunt.bus], -shunt.neutral("b"), shunt.g, name=name, in_service=shunt.in_service
        )


def _read_back(net: Any) -> Network:
    from opfmodel.network.cases.pandapower import from_pandapower

    with warnings.catch_warnings(action="ignore"):
        return from_pandapower(net, lossy=True)


# Comparison -------------------------------------------------------------------------------------


def _differences(network: Network, again: Network) -> Iterator[str]:
    """Quantities of the components in service that differ between two networks with the same bus names."""
    buses = [name for name, bus in network.of(Bus).items() if bus.in_service]
    others = [name for name, bus in again.of(Bus).items() if bus.in_service]
    if set(buses) != set(others):
        yield f"buses {listed(sorted(set(buses) ^ set(others)))}"
        return
    one, other = _quantities(network, buses), _quantities(again, buses)
    for what, values in one.items():
        places = [
            place
            for place in sorted({*values, *other[what]})
            if not _same(values.get(place, ()), other[what].get(place, ()))
        ]
        if places:
            yield f"{what} at {listed(places)}: not the same when read back"


def _same(one: Any, other: Any) -> bool:
    a, b = np.ravel(np.asarray(one)), np.ravel(np.asarray(other))
    if a.size != b.size:
        return not np.any(a) and not np.any(b)
    return bool(np.all(np.isclose(a, b, rtol=_TOLERANCE, atol=1e-12)))


_Values = Mapping[str, Any]


def _quantities(network: Network, buses: list[str]) -> dict[str, _Values]:
    """Quantities by bus or pair of buses, in an order that does not depend on names of components."""
    running = [network[name] for name in network if network[name].in_service]
    demand: dict[str, Any] = defaultdict(lambda: np.zeros(2))
    fixed: dict[str, Any] = defaultdict(lambda: np.zeros(2))
    units: dict[str, list[list[float]]] = defaultdict(list)
    ratings: dict[str, list[float]] = defaultdict(list)
    for c in running:
        if isinstance(c, Load):
            demand[c.bus] += (c.p, c.q)
        elif isinstance(c, Shunt):
            fixed[c.bus] += (c.g, c.b)
        elif isinstance(c, Generator):
            units[c.bus].append([*c.p, *c.q, *_cost(c)])
        elif isinstance(c, Branch):
            ratings[_pair(c)].append(np.inf if c.rating is None else float(c.rating))
    return {
        "voltage limits": {name: network.of(Bus)[name].vm for name in buses},
        "demand": demand,
        "shunts": fixed,
        "generators": {bus: [v for unit in sorted(rows) for v in unit] for bus, rows in units.items()},
        "ratings": {pair: sorted(values) for pair, values in ratings.items()},
        "admittances": _admittances([c for c in running if isinstance(c, Branch)]),
    }


def _cost(unit: Generator) -> tuple[float, ...]:
    cost: Any = unit.cost
    if isinstance(cost, PiecewiseLinear):
        return tuple(v for point in cost.points for v in point)
    return (cost.c2, cost.c1, cost.c0)


def _pair(branch: Branch) -> str:
    return "-".join(sorted(branch.buses))


def _admittances(branches: list[Branch]) -> dict[str, npt.NDArray[np.complex128]]:
    """Sum of the two-port matrices of the branches between each pair of buses, in sorted order."""
    total: dict[str, Any] = defaultdict(lambda: np.zeros((2, 2), dtype=complex))
    for c in branches:
        g, b = c.g / 2, c.b / 2
        ends = c.g_from + g, c.b_from + b, c.g_to + g, c.b_to + b
        values = (c.r, c.x, *ends, c.neutral("tap"), np.deg2rad(c.neutral("shift")))
        r, x, g_from, b_from, g_to, b_to, tap, shift = (np.asarray(value) for value in values)
        y = branch_admittance(r, x, g_from, b_from, g_to, b_to, tap, shift)
        matrix = np.array(
            [[y.g_ff + 1j * y.b_ff, y.g_ft + 1j * y.b_ft], [y.g_tf + 1j * y.b_tf, y.g_tt + 1j * y.b_tt]]
        )
        flipped = list(c.buses) != sorted(c.buses)
        total[_pair(c)] += matrix[::-1, ::-1] if flipped else matrix
    return dict(total)
