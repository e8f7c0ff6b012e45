"""Reserves."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from opfmodel.model import Bound, Device, Model, Soft, Stage
from opfmodel.network.arrays import Array, Index, PerUnitNetwork, Table
from opfmodel.network.components import Reserve
from solvers import Expression, Solution, total

__all__ = ["ReserveDevice"]


class _Power(NamedTuple):
    """The active power of a kind of unit: its quantity, its sign as an injection, and its limits."""

    quantity: str
    sign: float
    lower: Callable[[Table], Array]
    upper: Callable[[Table], Array]


# Kinds of units that offer reserve; another one also needs to be among those that fields of Reserve name.
_OFFERING: Mapping[str, _Power] = {
    "generator": _Power("pg", 1.0, lambda t: t.p_min, lambda t: t.p_max),
    "storage": _Power(
        "ps",
        -1.0,
        lambda t: np.maximum(t.power_min, -t.rating),
        lambda t: np.minimum(t.power_max, t.rating),
    ),
}


class _Offer(NamedTuple):
    """What some units of one kind offer of a product: its position, theirs, and MW in the regular nodes."""

    product: int
    members: Index
    amount: Expression


class ReserveDevice(Device):
    r"""Reserve products, for which units keep headroom and storages energy.

    With the offers :math:`r` of unit i for the products j of one direction, all at least zero,

    .. math::
        p_i + \sum_j r_{ij} \le p_i^{max} \;\text{(up)}, \quad
        p_i - \sum_j r_{ij} \ge p_i^{min} \;\text{(down)}, \quad
        r_{ij} \le \min\Bigl(\bar r_{ij},\; ramp_i \frac{minutes_j}{60}\Bigr), \quad
        \sum_i r_{ij} + lacking_j \ge requirement_j

    where :math:`p` is the power injected. The energy of a storage at the end of the stage, and for shorter
    durations also that after each duration from its start, must suffice:

    .. math::
        e_{min} + \frac{1}{\eta_d} \sum_j h_j r_{ij} \le e(k+1) \;\text{(up)}, \quad
        e(k+1) + \eta_c \sum_j h_j r_{ij} \le energy \;\text{(down)}

    Cost: prices of the offers and of the reserve that is missing. Contingencies need no reserve.
    """

    component = Reserve
    physical = False

    def declare(self, model: Model, table: Table) -> None:
        """Declare ``reserve_offered``, ``reserve_lacking`` and the offers ``<product>_<kind of unit>``."""
        nodes = np.arange(len(model.horizon.regular))
        offered = _decided(model, "reserve", "reserve_offered", np.inf, nodes, "reserve offered by all units")
        if not len(table):
            return
        sums = model.limit("reserve", "reserve_sum", len(table), 0.0, 0.0, nodes=nodes)
        model.build.add(-offered, into=sums)
        enough: Any = offered
        if np.isfinite(table.lacking_cost).any():
            enough = offered + _decided(
                model, "reserve", "reserve_lacking", _may_lack, nodes, "required reserve that is missing"
            )
        soft = Soft("reserve", np.arange(len(table)), "MW", below="lacks {}")
        model.rows("reserve", "reserve_requirement", enough, "requirement", np.inf, soft, nodes)
        model.price("reserve", "reserve_price", _price, "$/MWh", "cost of one more MW of required reserve")
        for kind, power in _OFFERING.items():
            offers = list(_offers(model, table, kind, nodes))
            for offer in offers:
                model.build.add(offer.amount, into=sums[np.full(offer.members.size, offer.product)])
            for direction in ("up", "down"):
                chosen = [offer for offer in offers if table.direction[offer.product] == direction]
                if chosen:
                    _keep_headroom(model, kind, power, chosen, direction, nodes)
                    if kind == "storage":
                        _keep_energy(model, table.hours[:, 0], chosen, direction, nodes)

    def cost(self, stage: Stage) -> Any:
        """Return the cost of the offers and of missing reserve, $/h."""
        table = stage.network.tables["reserve"]
        costs = []
        for kind in _OFFERING:
            owner, member, price = (table.arrays[f"cost_{kind}{end}"] for end in ("_owner", "_member", ""))
            for product in np.unique(owner):
                own = owner == product
                amount = getattr(getattr(stage, kind), f"{table.names[product]}_{kind}")
                costs.append(total(price[own] * amount[member[own]]))
        priced = np.flatnonzero(np.isfinite(table.lacking_cost))
        if priced.size:
            costs.append(total(table.lacking_cost[priced] * stage.reserve.reserve_lacking[priced]))
        return sum(costs[1:], start=costs[0]) if costs else None


def _decided(model: Model, kind: str, name: str, most: Bound, nodes: Index, about: str) -> Expression:
    """Declare and publish an amount in the regular nodes.

    Its variable has another name, so that it is neither a set-point that plants pursue nor a response to an
    outage, and a steady state is inside its limits whatever is offered.
    """
    amount = model.variable(kind, f"{name} decided", 0.0, most, unit="MW", nodes=nodes, publish=False)
    model.publish(kind, name, amount, unit="MW", description=about)
    return amount


def _may_lack(table: Table) -> Array:
    return np.where(np.isfinite(table.lacking_cost), table.requirement, 0.0)


def _price(solution: Solution, _: PerUnitNetwork) -> Array:
    return -solution.dual("reserve_requirement")  # as a requirement it is a lower limit


def _offers(model: Model, table: Table, kind: str, nodes: Index) -> Iterator[_Offer]:
    """Declare and publish what the units of a kind offer of each product."""
    units = model.network.tables[kind]
    for product, name in enumerate(table.names):
        members, most = np.arange(len(units)), np.full((len(units), 1), np.inf)
        if table.units_stated[product]:
            own = table.arrays[f"units_{kind}_owner"] == product
            members, most = table.arrays[f"units_{kind}_member"][own], table.arrays[f"units_{kind}"][own]
        if not members.size:
            continue
        most_in_time = _most(members, most, float(table.minutes[product, 0]) / 60.0)
        about = f"reserve offered as {name!r}"
        amount = _decided(model, kind, f"{name}_{kind}", most_in_time, nodes, about)
        yield _Offer(product, members, amount[members])


def _most(members: Index, most: Array, hours: float) -> Callable[[Table], Array]:
    """Return the function of a table of units that limits what they offer within some time."""

    def upper(units: Table) -> Array:
        stated = np.zeros((len(units), 1))
        stated[members] = most
        reach = hours * units.ramp if "ramp" in units.arrays else np.inf
        return np.where(units.status > 0, np.minimum(stated, reach), 0.0)

    return upper


def _keep_headroom(
    model: Model, kind: str, power: _Power, offers: Sequence[_Offer], direction: str, nodes: Index
) -> None:
    """Keep the injected power, moved by all offers of one direction, within the limits of the units."""
    able = _able(offers)
    sign = power.sign if direction == "up" else -power.sign  # of the quantity when its reserve is called up
    limit = power.upper if sign > 0 else power.lower
    most = _of(limit, able, sign)
    rows = model.limit(kind, f"reserve headroom {direction} {kind}", able.size, -np.inf, most, nodes=nodes)
    quantity = getattr(getattr(model, kind), power.quantity)
    model.build.add(sign * quantity[able][:, nodes], into=rows)
    for offer in offers:
        model.build.add(offer.amount, into=rows[np.searchsorted(able, offer.members)])


def _keep_energy(model: Model, hours: Array, offers: Sequence[_Offer], direction: str, nodes: Index) -> None:
    """Keep enough energy, or room for it, in storages to deliver all offers of one direction.

    At the end of the stage for the duration of every product; and if a product lasts less than a stage, also
    when it was called up at the start of the stage for as long: a storage that charges may have enough later.
    """
    lasting = {float(hours[offer.product]) for offer in offers} - {0.0}
    if not lasting:
        return
    storage, able, up = model.network.storage, _able(offers), direction == "up"
    length = model.horizon.hours[None, nodes]
    unit = min(lasting)  # in MW of the product with the shortest duration, as the softened rows are priced
    factor = -1.0 / storage.discharge_efficiency if up else storage.charge_efficiency
    start, end = (getattr(model.storage, name)[able][:, nodes] for name in ("e", "e_next"))
    for duration in [*sorted(h for h in lasting if h < length.max()), np.inf]:
        share = np.minimum(duration / length, 1.0)
        energy = end if duration == np.inf else (1.0 - share) * start + share * end
        limit = _of(_looser(model, up, inside=duration < np.inf), able, 1.0 / unit)
        low: Bound = limit if up else -np.inf
        high: Bound = np.inf if up else limit
        soft = Soft(
            "reserve energy", able, "MW",
            below="lacks the energy to deliver {} of its reserve" if up else "",
            above="" if up else "lacks the room to absorb {} of its reserve",
            price="balance",
        )  # fmt: skip
        name = f"reserve energy {direction}" + ("" if duration == np.inf else f" {duration:g} h")
        rows = model.limit("storage", name, able.size, low, high, soft, nodes)
        model.build.add(energy / unit, into=rows)
        for offer in offers:
            if hours[offer.product] > 0.0:
                lasts = min(float(hours[offer.product]), duration) / unit
                into = rows[np.searchsorted(able, offer.members)]
                model.build.add(lasts * factor[offer.members] * offer.amount, into=into)


def _looser(model: Model, up: bool, inside: bool) -> Callable[[Table], Array]:
    """Return the limit of stored energy: that at the end of a stage, or inside it the looser of both ends.

    Of the limit before the first stage nothing is known if it varies.
    """
    parent = model.horizon.parent
    loosest, none = (np.minimum, 0.0) if up else (np.maximum, np.inf)

    def limit(storages: Table) -> Array:
        own: Array = storages.energy_min if up else storages.energy
        if not inside or own.shape[1] == 1:
            return own
        return np.asarray(loosest(own, np.where(parent < 0, none, own[:, parent])))

    return limit


def _able(offers: Sequence[_Offer]) -> Index:
    """Return the positions of the units that offer anything, in ascending order."""
    return np.unique(np.concatenate([offer.members for offer in offers]))


def _of(limit: Callable[[Table], Array], items: Index, factor: float) -> Callable[[Table], Array]:
    """Return a multiple of a limit of some items."""
    return lambda table: np.asarray(factor * limit(table)[items])
