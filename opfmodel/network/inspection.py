"""What a network contains, and which of its data look wrong: a summary in plain values, without solving."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.data.series import Profiles, SeriesKey
from opfmodel.network.arrays import per_unit
from opfmodel.network.components import Branch, Bus, Connection, DCLine, Generator, Load, Renewable, Storage
from opfmodel.network.network import Network
from opfmodel.network.suspicions import Suspicion, suspicions

__all__ = ["Inspection", "Island", "Level", "inspect", "topology"]

_SOURCES: tuple[tuple[type[Any], str, Callable[[Any], float]], ...] = (
    (Generator, "p_max", lambda unit: unit.p[1]),
    (Renewable, "available", lambda unit: unit.available),
    (Connection, "p_max", lambda unit: unit.p[1]),
)


@dataclass(frozen=True)
class Island:
    """A part of the network without connection to the others but DC lines; powers in MW.

    Attributes
    ----------
    import_mw
        Maximum power that DC lines from other islands deliver.
    """

    buses: int
    capacity_mw: float
    demand_mw: float
    import_mw: float = 0.0


@dataclass(frozen=True)
class Level:
    """A nominal voltage: its buses, the branches between them, and those to another level."""

    base_kv: float | None
    buses: int
    branches: int
    transformers: int


@dataclass(frozen=True)
class Inspection:
    """Summary of a network; powers in MW.

    Attributes
    ----------
    in_service, out_of_service
        Number of components by plural of their kind.
    islands
        In descending size.
    loops
        Number of independent loops, counting parallel branches; 0 if the network is radial.
    levels
        In descending voltage.
    capacity_mw
        Maximum generation and import, renewables included; infinity if a unit has no limit.
    storage_mw, storage_mwh
        Maximum discharging power and energy capacity of the storages.
    demand_mw
        Total demand without time series, in which negative loads count as negative.
    peak_mw, peak_step, steps
        Maximum of the total demand over time, and its step of so many; equal to ``demand_mw`` and 0
        without time series.
    spare_mw
        Minimum over time of the generation capacity minus the demand.
    suspicions
        Data that look wrong.
    notes
        What a problem would leave out or choose.
    """

    name: str
    base_mva: float
    in_service: Mapping[str, int]
    out_of_service: Mapping[str, int]
    islands: tuple[Island, ...]
    loops: int
    levels: tuple[Level, ...]
    capacity_mw: float
    storage_mw: float
    storage_mwh: float
    demand_mw: float
    peak_mw: float
    peak_step: int
    steps: int
    spare_mw: float
    suspicions: tuple[Suspicion, ...]
    notes: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Convert to plain data."""
        return asdict(self)


def inspect(network: Network, profiles: Mapping[Any, npt.ArrayLike] | None = None) -> Inspection:
    """Summarise a network and find suspicious data.

    Parameters
    ----------
    profiles
        Time series; by default those attached to the network.

    Raises
    ------
    ComponentError, NetworkError
        As for :func:`opfmodel.network.per_unit`: a component names no bus, for example.
    """
    series = network.profiles if profiles is None else Profiles.of(profiles)
    notes = per_unit(network).notes
    parts = topology(network)
    demand = _over_time(network, series, Load, "p", lambda load: load.p)
    each = [_over_time(network, series, kind, field, value) for kind, field, value in _SOURCES]
    capacity = np.sum(each, axis=0)
    peak = int(np.argmax(demand))
    running = [s for s in network.of(Storage).values() if s.in_service]
    islands, loops = _islands(network, parts)
    spare = float((capacity - demand).min())
    found = (*_of_the_whole(demand, spare, islands), *suspicions(network, parts, float(np.abs(demand).max())))
    kinds = [kind for kind in network.kinds() if network.of(kind)]
    return Inspection(
        network.name,
        network.base_mva,
        {kind.plural: sum(c.in_service for c in network.of(kind).values()) for kind in kinds},
        {kind.plural: sum(not c.in_service for c in network.of(kind).values()) for kind in kinds},
        islands,
        loops,
        _levels(network),
        float(capacity.max()),
        sum(-s.constant("power_min") for s in running),
        sum(s.energy for s in running),
        sum(load.p for load in network.of(Load).values() if load.in_service),
        float(demand[peak]),
        peak,
        len(demand),
        spare,
        tuple(found),
        notes,
    )


def topology(network: Network) -> Any:
    """Buses and branches in service as a NetworkX multigraph; the keys of its edges are branch names.

    Nodes have the places ``x`` and ``y`` of their buses, None if unknown.
    """
    import networkx as nx

    graph = nx.MultiGraph()
    graph.add_nodes_from(
        (name, {"x": bus.x, "y": bus.y}) for name, bus in network.of(Bus).items() if bus.in_service
    )
    for name, branch in network.of(Branch).items():
        if branch.in_service and branch.from_bus in graph and branch.to_bus in graph:
            graph.add_edge(branch.from_bus, branch.to_bus, key=name)
    return graph


# Summary ------------------------------------------------------------------------------------------


def _over_time(
    network: Network, series: Profiles, kind: Any, field: str, constant: Callable[[Any], float]
) -> npt.NDArray[np.float64]:
    """Total of a field over the components in service of a kind, per step."""
    total = np.zeros(max(1, series.length or 1))
    for name, component in network.of(kind).items():
        if component.in_service:
            values = series.get(SeriesKey(name, field))
            total = total + (constant(component) if values is None else np.asarray(values)[: len(total)])
    return total


def _islands(network: Network, graph: Any) -> tuple[tuple[Island, ...], int]:
    import networkx as nx

    place: dict[str, int] = {}
    parts = sorted(nx.connected_components(graph), key=len, reverse=True)
    for number, members in enumerate(parts):
        place |= dict.fromkeys(members, number)
    capacity, demand, imported = ([0.0] * len(parts) for _ in range(3))
    for kind, _, value in _SOURCES:
        for unit in network.of(kind).values():
            if unit.in_service and unit.bus in place:
                capacity[place[unit.bus]] += value(unit)
    for load in network.of(Load).values():
        if load.in_service and load.bus in place:
            demand[place[load.bus]] += load.p
    for line in network.of(DCLine).values():
        if line.in_service and place.keys() >= set(line.buses) and len({place[b] for b in line.buses}) > 1:
            for bus, delivered in zip(line.buses, line.delivered_mw, strict=True):
                imported[place[bus]] += delivered
    islands = tuple(
        Island(len(p), *powers) for p, *powers in zip(parts, capacity, demand, imported, strict=True)
    )
    return islands, graph.number_of_edges() - graph.number_of_nodes() + len(parts)


def _levels(network: Network) -> tuple[Level, ...]:
    kv = {name: bus.base_kv for name, bus in network.of(Bus).items() if bus.in_service}
    inside: Counter[float | None] = Counter()
    between: Counter[float | None] = Counter()
    for branch in network.of(Branch).values():
        if branch.in_service and branch.from_bus in kv and branch.to_bus in kv:
            ends = {kv[branch.from_bus], kv[branch.to_bus]}
            (inside if len(ends) == 1 else between).update(ends)
    levels = Counter(kv.values())
    order = sorted(levels, key=lambda level: -1.0 if level is None else level, reverse=True)
    return tuple(Level(level, levels[level], inside[level], between[level]) for level in order)


def _of_the_whole(
    demand: npt.NDArray[np.float64], spare: float, islands: tuple[Island, ...]
) -> Iterator[Suspicion]:
    """Suspicions about capacity and demand."""
    if spare < 0:
        why = "the demand exceeds the generation capacity by so many MW"
        yield Suspicion("", "network", "capacity", round(-spare, 6), why)
    if demand.max() <= 0:
        yield Suspicion("", "network", "demand", float(demand.max()), "no demand")
    for number, island in enumerate(islands, start=1):
        if len(islands) > 1 and island.demand_mw > island.capacity_mw + island.import_mw:
            fed = f", with {island.import_mw:g} MW by DC lines" if island.import_mw else ""
            why = (
                f"island {number} of {island.buses} buses has less capacity than its {island.demand_mw:g} MW"
                f"{fed}"
            )
            yield Suspicion("", "network", "capacity", island.capacity_mw, why)
