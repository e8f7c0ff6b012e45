"""Reserves."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from opfmodel.check.equipment.base import Equipment
from opfmodel.check.trajectories import Array, Items
from opfmodel.network.components import Generator, Reserve, Storage

__all__ = ["Reserves"]


class _Offer(NamedTuple):
    """What all units of a kind offer of one product, MW, and the product."""

    product: Reserve
    amount: Array


class Reserves(Equipment):
    """Requirements, and the headroom and energy that stand behind the offers.

    What a plant called up of the reserve of a unit, the change of its set-point, counts as headroom.
    """

    component = Reserve

    def check(self) -> None:
        """Check requirements, offers, headroom and energy."""
        checker, products = self.checker, self.items
        if not products.names:
            return
        offered = np.zeros((len(products.names), len(checker.hours)))
        for units, power, limits in self._offering():
            offers = list(self._offers(units))
            for position, (_, amount) in enumerate(offers):
                offered[position] += amount.sum(axis=0)
            if not units.names:
                continue
            excess = [np.maximum(-o.amount, o.amount - self._most(units, o)) for o in offers]
            checker.note(f"reserve offer of {units.kind}s", units.names, np.stack(excess, axis=1), "MW")
            room = limits[1] - power, power - limits[0]
            both = [self._total(offers, way) - left for way, left in zip(("up", "down"), room, strict=True)]
            over = np.stack(both, axis=1) - self._called(units)[:, None]
            over = np.where(self._surprising(units)[:, None], 0.0, over)
            checker.note(f"reserve headroom of {units.kind}s", units.names, over, "MW")
            if units.kind == "storage" and checker.has("e", "e_next"):
                self._check_energy(units, offers)
        reported = products.values("reserve_offered")
        checker.note("reserve offered", products.names, np.abs(reported - offered), "MW")
        lacking = products.values("reserve_lacking") if checker.has("reserve_lacking") else 0.0
        missing = products.number("requirement") - offered - lacking
        checker.note("reserve requirement", products.names, np.maximum(missing, -lacking), "MW")

    def _offering(self) -> Iterator[tuple[Items, Array, tuple[Array, Array]]]:
        """Yield the units of each kind that offers, the power that they inject, and its limits."""
        generators, storages = self.checker.reported(Generator), self.checker.reported(Storage)
        yield generators, generators.values("pg"), generators.left("p")
        low, high = storages.left("power")
        rating = storages.number("rating")
        limits = -np.minimum(high, rating), -np.maximum(low, -rating)
        yield storages, -storages.values("ps"), limits

    def _offers(self, units: Items) -> Iterator[_Offer]:
        """Yield the offers of the units of a kind, of each product in turn."""
        for name, product in zip(self.items.names, self.items.members, strict=True):
            quantity = f"{name}_{units.kind}"
            known = bool(units.names) and self.checker.has(quantity)
            none = np.zeros((len(units.names), len(self.checker.hours)))
            yield _Offer(product, units.values(quantity) if known else none)

    def _most(self, units: Items, offer: _Offer) -> Array:
        """Return what each unit may offer, MW, whatever its headroom."""
        product = offer.product
        most = np.array([[product.units.get(name, 0.0 if product.units else np.inf)] for name in units.names])
        if units.kind == "generator":
            most = np.minimum(most, units.number("ramp") * product.minutes / 60.0)
        return np.where((units.status() == 0) & ~self._surprising(units), 0.0, most)

    def _surprising(self, units: Items) -> npt.NDArray[np.bool_]:
        """Whether units are out of service and the controller did not know, so that it expected reserve."""
        out = units.status() == 0
        if not self.checker.has("outages_known"):
            return np.zeros_like(out)
        unknown = np.asarray(self.checker.trajectories.data["outages_known"].values) == 0
        return np.asarray(out & unknown)

    def _called(self, units: Items) -> Array:
        """Return the absolute change of the set-points of units by a plant, MW."""
        quantity = {"generator": "pg_redispatch", "storage": "ps_redispatch"}[units.kind]
        if self.checker.has(quantity):
            return units.values(quantity)
        return np.zeros((len(units.names), len(self.checker.hours)))

    @staticmethod
    def _total(offers: list[_Offer], direction: str, most_hours: float | None = None) -> Array:
        """Return the offers of one direction, MW, or their energy if each lasts at most some hours, MWh."""
        return np.asarray(
            sum(
                (1.0 if most_hours is None else min(offer.product.hours, most_hours)) * offer.amount
                for offer in offers
                if offer.product.direction == direction
            )
            + np.zeros_like(offers[0].amount)
        )

    def _check_energy(self, units: Items, offers: list[_Offer]) -> None:
        """Check the energy after a call that ends with the stage, or begins with it and ends before."""
        hours, excess = self.checker.hours, []
        start, end = units.values("e"), units.values("e_next")
        drain, gain = 1.0 / units.constant("discharge_efficiency"), units.constant("charge_efficiency")
        least, most = units.number("energy_min"), units.number("energy")
        called = drain * self._called(units) * hours
        for duration in {offer.product.hours for offer in offers} | {np.inf}:
            inside = np.minimum(duration / hours, 1.0)
            energy = (1.0 - inside) * start + inside * end
            low, high = least, most
            if duration < np.inf:  # the looser limit of both ends
                low, high = np.minimum(least, _before(least, 0.0)), np.maximum(most, _before(most, np.inf))
            excess.append(low - energy + drain * self._total(offers, "up", duration) - called)
            excess.append(energy + gain * self._total(offers, "down", duration) - high - called)
        self.checker.note("reserve energy", units.names, np.stack(excess, axis=1), "MWh")

    def cost_rate(self) -> Array:
        """Cost of the offers and of missing reserve."""
        rate = np.zeros(len(self.checker.hours))
        if not self.items.names:
            return rate
        for units, *_ in self._offering():
            for product, amount in self._offers(units):
                prices = np.array([product.cost.get(name, 0.0) for name in units.names])
                rate += prices @ amount
        if self.checker.has("reserve_lacking"):
            price = self.items.constant("lacking_cost")
            lacking = self.items.values("reserve_lacking")
            rate += np.where(np.isfinite(price), price, 0.0).T[0] @ lacking
        return rate


def _before(limit: Array, unknown: float) -> Array:
    """Return a limit in the stage before each; that before the first is not known if it varies."""
    if limit.shape[1] == 1:
        return limit
    return np.column_stack([np.full(len(limit), unknown), limit[:, :-1]])
