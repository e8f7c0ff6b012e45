"""Outages: what a component that is out of service is limited to, as data of a solve.

A solve may state components that are out of service from now on, and each contingency of a secure plan takes
some out in one node. Both are data: a status of zero, and limits of zero.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from opfmodel.errors import ModelError, SecurityError, listed, nearest, shown
from opfmodel.horizon import Horizon
from opfmodel.model import Model
from opfmodel.network.arrays import OUTAGES, Index, PerUnitNetwork
from opfmodel.network.islands import connected
from solvers import Program

__all__ = [
    "COSTS",
    "STATUS",
    "check_declared",
    "check_stated",
    "check_whole",
    "cut_off",
    "free_rows",
    "idle",
    "lost_fields",
    "splitting",
    "status_at",
    "without",
]

Array = npt.NDArray[np.float64]
Fields = dict[tuple[str, str], Array]
Status = Mapping[str, Array]  # 1 in service, 0 while it is out, ``(items, nodes)`` by kind

# What a component that is out of service is limited to.
_LOST: Mapping[str, Mapping[str, float]] = {kind.kind: {"status": 0.0, **kind.lost} for kind in OUTAGES}
STATUS = "", "1 in service, 0 while it is out of service"
"""Unit and description of a status in results."""
# Cost of a generator that does not generate, and its starts; they count in no contingency.
COSTS = ("c0", "segment_offset", "starts")


def check_declared(names: Iterable[str], network: PerUnitNetwork) -> tuple[str, ...]:
    """Return the names of components whose outage solves may state.

    Raises
    ------
    ModelError
        No component that can go out has this name.
    SecurityError
        The outage of a branch splits the grid.
    """
    made = _names(names, "outages")
    *kinds, last = _LOST
    known = [name for kind in _LOST for name in network.tables[kind].names]
    for name in made:
        if name not in known:
            raise ModelError(
                f"outages: {shown(name)}: no {', '.join(kinds)} or {last} in service has this name; "
                f"{nearest(str(name), known)}"
            )
        check_whole((name,), network, "outages")
    return made


def check_stated(names: Iterable[str], declared: Sequence[str], network: PerUnitNetwork) -> tuple[str, ...]:
    """Return the names of the components that a solve takes as out of service.

    Raises
    ------
    ModelError
        A component is not among those declared.
    SecurityError
        Together, the outages split the grid.
    """
    made = _names(names, "out")
    for name in made:
        if name not in declared:
            raise ModelError(
                f"out: {shown(name)}: the problem does not declare this outage; declared: "
                f"{listed(declared) or 'none'}; add it by MultiStage(..., outages=[...])"
            )
    check_whole(made, network, "out")
    return made


def _names(names: Iterable[str], what: str) -> tuple[str, ...]:
    """Return names without repetition, or raise an error if they are none."""
    if isinstance(names, str) or not isinstance(names, Iterable):
        raise ModelError(f"{what} = {shown(names)}: must be a list of names")
    made = tuple(names)
    for name in made:
        if not isinstance(name, str):
            raise ModelError(f"{what}: {shown(name)}: must be a name")
    return tuple(dict.fromkeys(made))


def check_whole(out: Sequence[str], network: PerUnitNetwork, what: str, *place: str | int) -> None:
    """Raise :class:`SecurityError` with a place if outages split the grid."""
    if not set(out) & set(network.branch.names):
        return
    rest = set(range(len(network.bus)))
    for part in connected(rest, (ends for _, *ends in _branches(network, out))):
        if not set(part).isdisjoint(network.reference.tolist()):
            rest.difference_update(part)
    if rest:
        load = float(_demand(network)[list(rest)].sum())
        one = len(out) == 1
        raise SecurityError(
            f"{what}: {listed(map(repr, out))}: {'its outage splits' if one else 'these outages split'} the "
            f"grid and {'cuts' if one else 'cut'} off {load:.4g} MW of demand",
            *place,
        )


def _branches(network: PerUnitNetwork, out: Iterable[str] = ()) -> Iterator[tuple[str, int, int]]:
    """Yield name and ends of the branches that are left."""
    branch, lost = network.branch, set(out)
    ends = zip(branch.names, branch.from_bus.tolist(), branch.to_bus.tolist(), strict=True)
    yield from (each for each in ends if each[0] not in lost)


def _demand(network: PerUnitNetwork) -> Array:
    """Return the peak demand at each bus, MW."""
    return np.asarray(network.at_buses("load", network.load.p).max(axis=1) * network.base_mva)


def splitting(network: PerUnitNetwork, out: Iterable[str] = ()) -> dict[str, float]:
    """Return the branches whose outage splits the grid, with the peak demand that they cut off, MW."""
    return {name: load for name, load, _ in cut_off(network, out)}


def cut_off(network: PerUnitNetwork, out: Iterable[str] = ()) -> list[tuple[str, float, float]]:
    """Return each branch whose outage splits the grid, with peak demand and capacity that it cuts off, MW.

    Those of the part of the island without the reference bus.

    Parameters
    ----------
    out
        Components that are out of service already; they do not split it.
    """
    import networkx as nx

    circuits: dict[frozenset[int], list[str]] = {}
    for name, f, t in _branches(network, out):
        circuits.setdefault(frozenset((f, t)), []).append(name)
    graph = nx.Graph()
    graph.add_nodes_from(range(len(network.bus)))
    graph.add_edges_from((f, t) for _, f, t in _branches(network, out))
    demand = _demand(network)
    capacity = sum(
        network.at_buses(kind, network.tables[kind].arrays[field]).max(axis=1) * network.base_mva
        for kind, field in (("generator", "p_max"), ("renewable", "available"))
    )
    made = []
    for bridge in list(nx.bridges(graph)):
        names = circuits[frozenset(bridge)]
        if len(names) > 1:
            continue  # circuits in parallel
        graph.remove_edge(*bridge)
        parts = [nx.node_connected_component(graph, bus) for bus in bridge]
        cut = next((part for part in parts if not part & set(network.reference.tolist())), parts[-1])
        graph.add_edge(*bridge)
        buses = list(cut)
        made.append((names[0], float(demand[buses].sum()), float(capacity[buses].sum())))
    return made


# As data -----------------------------------------------------------------------------------------


def lost_fields(network: PerUnitNetwork, horizon: Horizon, outages: Sequence[str]) -> list[tuple[str, str]]:
    """Return the fields that change if a component goes out, by ``(kind, field)``.

    Parameters
    ----------
    outages
        Components whose outage solves may state.
    """
    out = {*outages, *(name for names in horizon.out for name in names)}
    made = []
    for kind, fields in _LOST.items():
        table = network.tables[kind]
        if out & set(table.names):
            made += [(kind, field) for field in fields]
        if set(outages) & set(table.names):
            made += [(kind, field) for field in COSTS if table.arrays.get(field, np.zeros(0)).size]
    return made


def idle(network: PerUnitNetwork, horizon: Horizon, out: Sequence[str]) -> Index:
    """Return the contingencies that cannot happen: what they take out is out, or would now split the grid."""
    if not (out and horizon.contingencies.size):
        return np.zeros(0, dtype=np.intp)
    never = {*out, *splitting(network, out)}
    return np.array([n for n in horizon.contingencies if never & set(horizon.out[n])], dtype=np.intp)


def status_at(
    network: PerUnitNetwork, horizon: Horizon, out: Sequence[str] = (), idle: Index | None = None
) -> dict[str, Array]:
    """Return the status of the components at the nodes, by kind.

    Parameters
    ----------
    out
        Components that are out of service in every node.
    idle
        Contingencies that cannot happen.
    """
    never = set() if idle is None else set(idle.tolist())
    made = {}
    for kind in _LOST:
        table = network.tables[kind]
        values = made[kind] = np.ones((len(table), len(horizon)))
        for node, names in enumerate(horizon.out):
            gone = () if node in never else names
            values[[table.position[name] for name in gone if name in table.position], node] = 0.0
        values[[table.position[name] for name in out if name in table.position]] = 0.0
    return made


def without(
    series: Mapping[tuple[str, str], Array],
    network: PerUnitNetwork,
    status: Status,
    fields: Iterable[tuple[str, str]],
) -> Fields:
    """Return series in which the components that are out of service are limited to nothing.

    Parameters
    ----------
    fields
        The fields that change; see :func:`lost_fields`.
    """
    made = dict(series)
    for kind, field in fields:
        table = network.tables[kind]
        values = series.get((kind, field), table.arrays[field])
        out = status[kind] == 0.0
        if field == "segment_offset":
            out = out[table.segment_owner]
        made[kind, field] = np.where(out, _LOST[kind].get(field, 0.0), values)
    return made


def free_rows(model: Model, program: Program, nodes: Index) -> Iterator[tuple[str, tuple[Array, Array]]]:
    """Yield the bounds that free the rows of some nodes, by block; NaN where they are left as they are."""
    for name, block in program.rows.items():
        source = model.bounds.get(name)
        own = np.arange(model.stages) if source is None or source.nodes is None else source.nodes
        if own.size == block.stages and np.isin(own, nodes).any():
            free = np.where(np.broadcast_to(np.isin(own, nodes), block.shape), np.inf, np.nan)
            yield name, (-free, free)
