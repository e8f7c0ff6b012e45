"""Values of a network that are accepted but look wrong, and why."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from opfmodel.network.components import Branch, Bus, DCLine, Generator, Load, Shunt, Storage
from opfmodel.network.costs import Cost, PiecewiseLinear, Polynomial
from opfmodel.network.fields import INF
from opfmodel.network.network import Network

__all__ = ["Suspicion", "grouped", "suspicions"]

_HIGH_VOLTAGE = 50.0  # kV, above which the reactance of lines exceeds their resistance
_TINY = 1e-5  # p.u. on 100 MVA: a metre of line
_TAPS = (0.8, 1.25)
_NARROW = 1.0  # degrees
_WIDE_VM = (0.5, 1.5)  # p.u.
_LARGE = 1000.0  # times the demand
_LOSS = 0.1  # of what a DC line sends


@dataclass(frozen=True)
class Suspicion:
    """A value that is accepted but looks wrong.

    Attributes
    ----------
    component, kind
        Name and kind; empty and ``"network"`` for the network as a whole.
    field, value
        The field and its value.
    why
        Why it is suspicious.
    """

    component: str
    kind: str
    field: str
    value: Any
    why: str


def suspicions(network: Network, graph: Any, demand: float) -> Iterator[Suspicion]:
    """Yield the suspicions about costs and about single components in service.

    Parameters
    ----------
    graph
        Buses and branches in service.
    demand
        Largest total demand, MW, with which limits are compared.
    """
    costs = [unit.cost for unit in network.of(Generator).values() if unit.in_service]
    if costs and all(_is_free(cost) for cost in costs):
        yield Suspicion("", "network", "cost", 0, "no generator costs anything")
    elif len(costs) > 1 and all(cost == costs[0] for cost in costs):
        yield Suspicion("", "network", "cost", repr(costs[0]), "all generators cost the same")
    buses = network.of(Bus)
    most = _LARGE * max(demand, 1.0)
    rules: dict[type, Callable[[Any], _Found]] = {
        Generator: lambda unit: _of_generator(unit, most),
        Storage: _of_storage,
        DCLine: lambda line: _of_dc_line(line, most),
        Load: _of_load,
        Shunt: _of_shunt,
    }
    fed = {bus for line in network.of(DCLine).values() if line.in_service for bus in line.buses}
    twins: dict[tuple[Any, ...], str] = {}
    for name, component in ((name, network[name]) for name in network):
        if not component.in_service:
            continue
        if isinstance(component, Bus):
            alone = len(graph) > 1 and not graph.degree(name) and name not in fed
            found = _of_bus(component, alone)
        elif isinstance(component, Branch):
            kv = min((buses[end].base_kv or 0.0) for end in component.buses)
            found = _of_branch(component, kv, network.base_mva, most)
            twin = twins.setdefault(_identity(component), name)
            if twin != name:
                yield Suspicion(name, "branch", "to_bus", twin, "all its data are those of another branch")
        elif type(component) in rules:
            found = rules[type(component)](component)
        else:
            continue
        for field, value, why in found:
            yield Suspicion(name, component.kind, field, value, why)


def grouped(found: Iterable[Suspicion]) -> dict[tuple[str, str, str], list[Suspicion]]:
    """Group suspicions of the same kind, field and reason."""
    groups: dict[tuple[str, str, str], list[Suspicion]] = defaultdict(list)
    for one in found:
        groups[one.kind, one.field, one.why].append(one)
    return groups


_Found = Iterator[tuple[str, Any, str]]


def _of_bus(bus: Bus, alone: bool) -> _Found:
    low, high = bus.vm
    if alone:
        yield "in_service", True, "no branch in service leads to it"
    if low == high:
        yield "vm", bus.vm, "its voltage is fixed"
    elif low < _WIDE_VM[0] or high > _WIDE_VM[1]:
        yield "vm", bus.vm, "these limits limit nothing"


def _identity(branch: Branch) -> tuple[Any, ...]:
    return (frozenset(branch.buses), branch.r, branch.x, branch.b, branch.rating, branch.tap, branch.shift)


def _of_branch(branch: Branch, kv: float, base_mva: float, most: float) -> _Found:
    to_100_mva = 100.0 / base_mva
    if math.hypot(branch.r, branch.x) * to_100_mva < _TINY:
        yield "r, x", (branch.r, branch.x), "a tiny impedance, which makes problems ill-conditioned"
    elif kv >= _HIGH_VOLTAGE and branch.r > abs(branch.x):
        yield "r, x", (branch.r, branch.x), f"r is larger than x at {_HIGH_VOLTAGE:g} kV or more"
    if branch.x < 0:
        yield "x", branch.x, "a negative reactance: a series capacitor, or a part of a transformer"
    if branch.r < 0:
        yield "r", branch.r, "a negative resistance generates power"
    if branch.rating is None or branch.rating == INF:
        yield "rating", branch.rating, "no rating"
    elif branch.rating == 0:
        yield "rating", branch.rating, "a branch that may carry nothing"
    elif branch.rating > most:
        yield "rating", branch.rating, "a rating that limits nothing"
    taps = branch.tap if isinstance(branch.tap, tuple) else (branch.tap, branch.tap)
    if not _TAPS[0] <= taps[0] <= taps[1] <= _TAPS[1]:
        yield "tap", branch.tap, f"outside the usual range from {_TAPS[0]:g} to {_TAPS[1]:g}"
    low, high = branch.angle
    if high - low < _NARROW:
        yield "angle", branch.angle, "a range of less than one degree"


def _of_generator(unit: Generator, most: float) -> _Found:
    low, high = unit.p
    if low == high == 0 and unit.q[0] == unit.q[1]:
        yield "p", unit.p, "generates nothing"
    elif high > most or low < -most:
        yield "p", unit.p, "limits far beyond the demand"
    if not math.isfinite(unit.q[0]) or not math.isfinite(unit.q[1]):
        yield "q", unit.q, "no limit of reactive power"
    if unit.ramp == 0:
        yield "ramp", 0.0, "its power cannot change"
    cost = unit.cost
    if isinstance(cost, Polynomial) and 2 * cost.c2 * low + cost.c1 < 0 and math.isfinite(low):
        yield "cost", repr(cost), "the cost falls with the power at p_min"


def _of_storage(storage: Storage) -> _Found:
    discharge, charge = -storage.constant("power_min"), storage.constant("power_max")
    usable = storage.energy - storage.energy_min
    if usable <= 0:
        yield "energy", storage.energy, "can store nothing"
    elif charge <= 0 or discharge <= 0:
        yield "power", storage.power, "cannot charge" if charge <= 0 else "cannot discharge"
    elif charge * storage.charge_efficiency * 24 < usable:
        yield "power, energy", (storage.power, storage.energy), "cannot be filled in a day"
    if storage.charge_efficiency * storage.discharge_efficiency < 0.5:
        round_trip = (storage.charge_efficiency, storage.discharge_efficiency)
        yield "charge_efficiency, discharge_efficiency", round_trip, "more than half of the energy is lost"


def _of_dc_line(line: DCLine, most: float) -> _Found:
    low, high = line.constant("p_min"), line.constant("p_max")
    if low == high == 0:
        yield "p", line.p, "a DC line that may carry nothing"
    elif high > most or low < -most:
        yield "p", line.p, "limits far beyond the demand"
    if line.loss > _LOSS:
        yield "loss", line.loss, "more than a tenth of what is sent is lost"
    if line.loss_fixed > max(abs(low), abs(high)):
        yield "loss_fixed", line.loss_fixed, "loses more than it may carry"


def _of_load(load: Load) -> _Found:
    if load.p < 0:
        yield "p", load.p, "a negative demand injects power"
    if load.p and abs(load.q) > 2 * abs(load.p):
        yield "p, q", (load.p, load.q), "a power factor below 0.45"


def _of_shunt(shunt: Shunt) -> _Found:
    if shunt.g < 0:
        yield "g", shunt.g, "a negative conductance generates power"


def _is_free(cost: Cost) -> bool:
    if isinstance(cost, PiecewiseLinear):
        return all(value == 0 for _, value in cost.points)
    return isinstance(cost, Polynomial) and cost.c2 == cost.c1 == 0
