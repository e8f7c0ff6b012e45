"""The set-points of a network as per-unit arrays: what a power flow holds at every bus."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from opfmodel.errors import ModelError, nearest
from opfmodel.network.arrays import Array, Index, PerUnitNetwork, Table
from opfmodel.network.bounds import number_within
from opfmodel.network.shares import WIDE, divide

__all__ = ["Held", "held", "slack_shares"]

_ENDS = ("from", "to")


@dataclass(frozen=True, eq=False)
class Held:
    """What is held in a power flow.

    Attributes
    ----------
    network
        The network with ``pg_set``, ``qg_set``, ``ps_set``, ``qs_set`` and the set-points of other kinds
        filled in.
    regulates
        Mask of the generators that hold the voltage of their bus.
    reference
        Reference bus of each island, where a generator holds the voltage.
    at, vm
        Buses whose voltage is held, in ascending order, and their voltages, p.u.
    va
        Angle of the reference bus of each island, rad.
    """

    network: PerUnitNetwork
    regulates: npt.NDArray[np.bool_]
    reference: Index
    at: Index
    vm: Array
    va: Array
    notes: tuple[str, ...]

    @cached_property
    def first_at_reference(self) -> Array:
        """Shares of a single slack: 1 for the first generator that regulates a reference bus, else 0."""
        bus = self.network.generator.bus
        shares = np.zeros(bus.size)
        for reference in self.reference:
            shares[np.flatnonzero(self.regulates & (bus == reference))[0]] = 1.0
        return shares

    @property
    def extra_range(self) -> tuple[Array, Array]:
        """Limits of the reactive power of the generators at :attr:`at`, beyond their set-points, p.u."""
        table = self.network.generator
        which = np.searchsorted(self.at, table.bus[self.regulates])

        def total(field: str) -> Array:
            values: Array = table.arrays[field][self.regulates, 0]
            return np.bincount(which, values, self.at.size).astype(float)

        base = total("qg_set")
        return total("q_min") - base, total("q_max") - base

    def linear_angles(self, shares: Array) -> Array:
        r"""Angles of a linear power flow :math:`p_f = (\theta_f - \theta_t - \phi) / |z|`, rad.

        A start for Newton's method only; unlike the DC formulations it has a solution also for
        branches without or with negative reactance.
        """
        from scipy.sparse.linalg import spsolve

        network, branch = self.network, self.network.branch
        count = len(network.bus)
        weight = (1.0 / np.hypot(branch.r, branch.x))[:, 0]
        ends = np.concatenate([branch.from_bus, branch.to_bus])
        signs = np.repeat([1.0, -1.0], len(branch))
        incidence = sp.csr_array((signs, (np.tile(np.arange(len(branch)), 2), ends)), (len(branch), count))
        laplacian = (incidence.T @ sp.diags_array(weight) @ incidence).tocsc()
        power = self._injections(shares) + incidence.T @ (weight * branch.shift[:, 0])
        angles = self.va[network.island].copy()
        free = np.ones(count, dtype=bool)
        free[self.reference] = False
        unknown = np.flatnonzero(free)
        if unknown.size:
            known = laplacian[unknown][:, self.reference] @ angles[self.reference]
            angles[unknown] = spsolve(laplacian[unknown][:, unknown], power[unknown] - known)
        return angles

    def _injections(self, shares: Array) -> Array:
        """Active power injected into each bus at 1 p.u., if generators share what their island lacks."""
        network = self.network
        total = network.at_buses("generator", network.generator.pg_set)
        total = total + network.at_buses("renewable", network.renewable.p_set)
        for kind, field in (
            ("load", "p"),
            ("storage", "ps_set"),
            ("flexible_load", "flexible_load_p_set"),
            ("shunt", "g"),
        ):
            total = total - network.at_buses(kind, network.tables[kind].arrays[field])
        lines = network.tables["dc_line"]
        arrives = 1.0 - lines.loss
        np.subtract.at(total, lines.from_bus, lines.forward_set - lines.backward_set)
        np.subtract.at(
            total, lines.to_bus, lines.backward_set / arrives - arrives * lines.forward_set + lines.loss_fixed
        )
        lacking = -np.bincount(network.island, total[:, 0])
        total[:, 0] += network.at_buses("generator", shares * lacking[network.island[network.generator.bus]])
        return np.asarray(total[:, 0])


def held(network: PerUnitNetwork) -> Held:
    """Return what the declared set-points hold.

    Raises
    ------
    ModelError
        No generator in service holds the voltage of an island.
    """
    table = network.generator
    units = network.renewable
    regulates = table.regulates
    notes = list(network.notes)
    reference = _references(network, notes)
    at, vm = _voltages(network, notes)
    ready = network.with_series(
        {
            ("generator", "pg_set"): _given(table, "pg_set", "p"),
            ("generator", "qg_set"): np.where(
                regulates[:, None], np.clip(table.q_min, -WIDE, WIDE), _given(table, "qg_set", "q")
            ),
            ("storage", "ps_set"): _or_zero(network.storage.ps_set),
            ("storage", "qs_set"): _or_zero(network.storage.qs_set),
            ("renewable", "p_set"): _uncurtailed(units),
            ("renewable", "q_set"): np.clip(0.0, units.q_min, units.q_max),
            ("flexible_load", "flexible_load_p_set"): _or_zero(network.tables["flexible_load"].p_set),
            **_of_dc_lines(network.tables["dc_line"]),
        }
    )
    return Held(ready, regulates, reference, at, vm, network.bus.va_set[reference, 0], tuple(notes))


def slack_shares(points: Held, participation: Mapping[str, float] | None) -> Array:
    """Return the share of each generator in the slack of its island; shares sum to one per island.

    Raises
    ------
    ModelError
        A factor is negative, or belongs to no generator in service.
    """
    table = points.network.generator
    weights = participation_of(table, points.regulates[:, None], participation)[:, 0]
    return divide(weights, points.network.island[table.bus])


def participation_of(
    table: Table, able: npt.NDArray[np.bool_], participation: Mapping[str, float] | None
) -> Array:
    """Return the weight of each generator in a distributed slack, ``(generators, nodes)``.

    Parameters
    ----------
    able
        Generators that participate in proportion to their capacity, unless they declare another weight,
        ``(generators, nodes)``.
    participation
        Weights by name, in place of those declared; others do not participate.

    Raises
    ------
    ModelError
        A weight is negative, or belongs to no generator in service.
    """
    default = np.where(able, np.clip(table.p_max, 0.0, WIDE), 0.0)
    declared = table.participation / table.base_mva
    weights = np.where(np.isfinite(declared), declared, default)
    if participation is not None:
        for name, factor in participation.items():
            number_within(f"participation: {name}", factor, at_least=0)
            if name not in table.position:
                known = nearest(name, table.names)
                raise ModelError(f"participation: no generator in service is named {name!r}; {known}")
        stated = np.array([[float(participation.get(name, 0.0))] for name in table.names])
        weights = np.broadcast_to(stated.reshape(-1, 1), weights.shape)
    return np.asarray(weights)


def _given(table: Table, field: str, limits: str) -> Array:
    """Return set-points; those not given are 0, within the limits."""
    values: Array = table.arrays[field]
    nearest_zero = np.clip(0.0, table.arrays[f"{limits}_min"], table.arrays[f"{limits}_max"])
    return np.where(np.isfinite(values), values, nearest_zero)


def _uncurtailed(units: Table) -> Array:
    """Return what is available, as far as ratings and capability curves permit."""
    return np.asarray(np.minimum(units.available, np.minimum(units.rating, units.capability_p_max)))


def _of_dc_lines(table: Table) -> dict[tuple[str, str], Array]:
    """Return the set-points of DC lines; each end sends or receives."""
    pf = _given(table, "pf_set", "p")
    forward = np.where(table.loss > 0, np.maximum(pf, 0.0), pf)
    reactive = {("dc_line", f"q{end[0]}_set"): _given(table, f"q{end[0]}_set", f"q_{end}") for end in _ENDS}
    return {("dc_line", "forward_set"): forward, ("dc_line", "backward_set"): forward - pf, **reactive}


def _or_zero(values: Array) -> Array:
    return np.where(np.isfinite(values), values, 0.0)


def _references(network: PerUnitNetwork, notes: list[str]) -> Index:
    """Return the reference bus of each island; where nothing regulates it, the first that is."""
    bus, names = network.generator.bus[network.generator.regulates], network.bus.names
    chosen = network.reference.copy()
    for island, reference in enumerate(network.reference):
        if reference in bus:
            continue
        candidates = bus[network.island[bus] == island]
        if not candidates.size:
            raise ModelError(
                f"{names[reference]}: no generator in service holds the voltage of the island of this bus; "
                "one with regulates = True is required, or its buses out of service"
            )
        chosen[island] = candidates.min()
        notes.append(
            f"no generator holds the voltage of the reference bus {names[reference]!r}; "
            f"{names[chosen[island]]!r} is used"
        )
    return chosen


def _voltages(network: PerUnitNetwork, notes: list[str]) -> tuple[Index, Array]:
    """Return the buses whose voltage is held, and the voltages; of several for one bus the last counts."""
    table, bus = network.generator, network.bus
    held: dict[int, float] = {}
    for unit in np.flatnonzero(table.regulates):
        here, wanted = int(table.bus[unit]), float(table.vm_set[unit, 0])
        if not np.isfinite(wanted):
            held.setdefault(here, np.nan)
            continue
        before = held.get(here, np.nan)
        if np.isfinite(before) and before != wanted:
            notes.append(
                f"bus {bus.names[here]!r}: generators hold {before:g} and {wanted:g} p.u.; "
                f"vm_set of {table.names[unit]!r} is used"
            )
        held[here] = wanted
    at = np.array(sorted(held), dtype=np.intp)
    vm = np.array([held[int(b)] for b in at], dtype=float)
    default = np.clip(1.0, bus.vm_min[at, 0], bus.vm_max[at, 0])
    return at, np.where(np.isfinite(vm), vm, default)
