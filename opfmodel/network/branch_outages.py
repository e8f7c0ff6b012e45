"""Flows after the outage of each of many branches, all from one state: which outages it survives."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from opfmodel.network.arrays import Array, Index, PerUnitNetwork, Table
from opfmodel.network.physics import Admittance, branch_flow, polar_products
from opfmodel.network.shares import WIDE

if TYPE_CHECKING:
    from scipy.sparse.linalg import SuperLU

__all__ = ["ACOutages", "DCOutages", "Reserve"]

Complex = npt.NDArray[np.complex128]
Mask = npt.NDArray[np.bool_]

_WITHIN = 1e-6  # p.u. and rad; a smaller excess is tolerance
_SINGULAR = 1e-12
_SOLVED = 1e-8  # p.u.; largest missing power of a solution
_STEPS = 15  # most outages take five to eight
_TOGETHER = 256  # outages at a time, which bounds the memory


@dataclass(frozen=True)
class Reserve:
    """What units add after an outage, per generator and p.u.

    Attributes
    ----------
    up, down
        Largest change of active power in either direction.
    share
        Share in what the island lacks.
    q_up, q_down
        Largest change of reactive power in either direction.
    droop
        Decrease of voltage at the bus of the unit per unit of reactive power that it adds, p.u.; 0 holds
        the voltage.
    """

    up: Array
    down: Array
    share: Array
    q_up: Array
    q_down: Array
    droop: float


class DCOutages:
    r"""Linear flows after outages of branches.

    With the susceptance matrix B, its reduced inverse X and :math:`a_k` the incidence of branch k, its
    outage changes the angles by :math:`X a_k f_k / (1 - b_k a_k^T X a_k)`. Injections stay as they are.

    Parameters
    ----------
    network
        One stage, with the limits that apply after an outage.
    flow, slope
        Flow on each branch before the outage, and what it grows by with the angle across it, p.u.
    angle
        Angle across each branch, rad.
    """

    def __init__(self, network: PerUnitNetwork, flow: Array, slope: Array, angle: Array) -> None:
        self.network = network
        self.flow, self.slope, self.angle = flow, slope, angle

    def survived(self, out: Index) -> Mask:
        """Return for each branch whether flows and angles are within limits after its outage."""
        from scipy.sparse.linalg import splu

        network, branch = self.network, self.network.branch
        free = np.setdiff1d(np.arange(len(network.bus)), network.reference)
        signs = np.repeat([1.0, -1.0], len(branch))
        ends = np.concatenate([branch.from_bus, branch.to_bus])
        across = sp.csc_array((signs, (np.tile(np.arange(len(branch)), 2), ends)))[:, free]
        matrix = across.T @ sp.diags_array(self.slope) @ across
        made = []
        try:
            factors = splu(matrix.tocsc())
        except RuntimeError:
            return np.zeros(out.size, dtype=bool)
        for chosen in _batches(out):
            moved = across @ factors.solve(across[chosen].T.toarray())
            k = np.arange(chosen.size)
            with np.errstate(all="ignore"):
                change = moved * (self.flow[chosen] / (1.0 - self.slope[chosen] * moved[chosen, k]))
                flow = self.flow[:, None] + self.slope[:, None] * change
                angle = self.angle[:, None] + change
            flow[chosen, k] = angle[chosen, k] = 0.0
            made.append(_within_branches(branch, np.abs(flow), angle))
        return np.concatenate(made) if made else np.zeros(0, dtype=bool)


class ACOutages:
    r"""AC power flows after outages of branches, by compensation of one factorised Jacobian.

    From the state before the outage, Newton's method with the Jacobian J of that state, corrected for the
    branch that is lost by a matrix of rank four:

    .. math::
        (J + E_r D E_c^T)^{-1} = J^{-1} - J^{-1} E_r (I + D E_c^T J^{-1} E_r)^{-1} D E_c^T J^{-1}

    Units share what is lacking, and hold the voltage of their bus, or let it fall with the reactive power
    that they add. Source: O. Alsaç, B. Stott and W. F. Tinney, "Sparsity-oriented compensation methods for
    modified network solutions", IEEE Transactions on Power Apparatus and Systems 102(5), 1983.

    Parameters
    ----------
    network
        One stage, with the limits that apply after an outage.
    status
        Share of each branch in service before the outage.
    vm, va
        Voltages before the outage, p.u. and rad.
    reserve
        What units add.
    """

    def __init__(
        self, network: PerUnitNetwork, status: Array, vm: Array, va: Array, reserve: Reserve
    ) -> None:
        self.network, self.reserve = network, reserve
        self.vm, self.va = vm, va
        self._admittance = y = network.admittance[:, 0] * status
        self._ports = (
            y.g_ff + 1j * y.b_ff, y.g_ft + 1j * y.b_ft, y.g_tf + 1j * y.b_tf, y.g_tt + 1j * y.b_tt
        )  # fmt: skip
        self._at = np.unique(network.generator.bus)

    def survived(self, out: Index) -> Mask:
        """Return for each branch whether the grid is within limits after its outage.

        It is not if no solution was found.
        """
        if self._factors is None:
            return np.zeros(out.size, dtype=bool)
        with np.errstate(all="ignore"):
            made = [self._survived(chosen) for chosen in _batches(out)]
        return np.concatenate(made) if made else np.zeros(0, dtype=bool)

    # Equations ---------------------------------------------------------------------------

    @cached_property
    def _matrix(self) -> sp.csr_array:
        """Bus admittance matrix, shunts included."""
        branch, shunt, count = self.network.branch, self.network.shunt, len(self.network.bus)
        f, t = branch.from_bus, branch.to_bus
        rows, columns = np.concatenate([f, f, t, t]), np.concatenate([f, t, f, t])
        own = np.arange(count)
        drawn = self.network.at_buses("shunt", shunt.g) + 1j * self.network.at_buses("shunt", shunt.b)
        entries = np.concatenate([*self._ports, drawn[:, 0]])
        at = np.concatenate([rows, own]), np.concatenate([columns, own])
        return sp.csr_array(sp.coo_array((entries, at), (count, count)))

    @cached_property
    def _support(self) -> Array:
        """Reactive power that the units of each bus add per p.u. of voltage that it falls, p.u."""
        if not self.reserve.droop:
            return np.zeros(len(self.network.bus))
        able = np.clip(np.minimum(self.reserve.q_up, self.reserve.q_down), 0.0, WIDE)
        return self._of_units(able) / self.reserve.droop

    @cached_property
    def _shares(self) -> sp.csr_array:
        """Share of each bus in the slack of each island; all of it at the reference if there is no unit."""
        bus, island = self.network.generator.bus, self.network.island
        shape = len(self.network.bus), self.network.n_islands
        alone = self.network.reference[self._without_units]
        buses = np.concatenate([bus, alone])
        share = np.concatenate([self.reserve.share, np.ones(alone.size)])
        return sp.csr_array(sp.coo_array((share, (buses, island[buses])), shape))

    @cached_property
    def _without_units(self) -> Index:
        """Islands without units, which can cover no slack."""
        islands = np.arange(self.network.n_islands)
        return np.setdiff1d(islands, self.network.island[self.network.generator.bus])

    @cached_property
    def _unknown(self) -> tuple[Index, Index]:
        """Buses whose angle, and whose voltage is unknown; reactive power is balanced at the latter."""
        buses = np.arange(len(self.network.bus))
        held = np.zeros(0, dtype=np.intp) if self.reserve.droop else self._at
        return np.setdiff1d(buses, self.network.reference), np.setdiff1d(buses, held)

    @cached_property
    def _factors(self) -> SuperLU | None:
        """Factorised Jacobian of all missing powers; None if it is singular."""
        from scipy.sparse.linalg import splu

        v, (angles, magnitudes) = self.vm * np.exp(1j * self.va), self._unknown
        current = self._matrix @ v
        by_angle = (
            1j * sp.diags_array(v) @ (sp.diags_array(current) - self._matrix @ sp.diags_array(v)).conj()
        )
        by_magnitude = sp.diags_array(v) @ (self._matrix @ sp.diags_array(v / self.vm)).conj()
        by_magnitude = by_magnitude + sp.diags_array(current.conj() * v / self.vm + 1j * self._support)
        blocks = [
            [by_angle.real.tocsc()[:, angles], by_magnitude.real.tocsc()[:, magnitudes], -self._shares],
            [
                by_angle.imag.tocsr()[magnitudes].tocsc()[:, angles],
                by_magnitude.imag.tocsr()[magnitudes].tocsc()[:, magnitudes],
                None,
            ],
        ]
        try:
            return splu(sp.csc_array(sp.block_array(blocks)))
        except RuntimeError:
            return None

    def _places(self, out: Index) -> tuple[Index, Index]:
        """Return rows and columns of the Jacobian that the outage of each branch changes; -1 for none."""
        count, (angles, magnitudes) = len(self.network.bus), self._unknown
        reactive, by_angle, by_magnitude = (np.full(count, -1) for _ in range(3))
        reactive[magnitudes] = count + np.arange(magnitudes.size)
        by_angle[angles] = np.arange(angles.size)
        by_magnitude[magnitudes] = angles.size + np.arange(magnitudes.size)
        f, t = self.network.branch.from_bus[out], self.network.branch.to_bus[out]
        rows = np.stack([f, t, reactive[f], reactive[t]], axis=1)
        return rows, np.stack([by_angle[f], by_angle[t], by_magnitude[f], by_magnitude[t]], axis=1)

    def _flows(self, vm: Array, va: Array, lost: Index | None = None) -> tuple[Complex, Complex]:
        """Return the power into both ends of all branches, or of the one that is lost in each outage.

        Parameters
        ----------
        vm, va
            Voltages ``(buses, outages)``.
        """
        f, t = self.network.branch.from_bus, self.network.branch.to_bus
        y: Admittance = self._admittance[:, None]
        which: Index | slice = slice(None)
        if lost is not None:
            f, t, y, which = f[lost], t[lost], self._admittance[lost], np.arange(lost.size)
        products = polar_products(vm[f, which], vm[t, which], va[f, which] - va[t, which])
        pf, qf, pt, qt = branch_flow(y, *products)
        return pf + 1j * qf, pt + 1j * qt

    def _change(self, out: Index) -> Array:
        """Return the change of the Jacobian by the outage of each branch, ``(outages, 4, 4)``."""
        ff, ft, tf, tt = (port[out] for port in self._ports)
        v = self.vm * np.exp(1j * self.va)
        f, t = self.network.branch.from_bus[out], self.network.branch.to_bus[out]
        v_f, v_t = v[f], v[t]
        own_f, cross_f = v_f * (ff * v_f).conj(), v_f * (ft * v_t).conj()
        own_t, cross_t = v_t * (tt * v_t).conj(), v_t * (tf * v_f).conj()
        by_f = [1j * cross_f, -1j * cross_f, (2 * own_f + cross_f) / self.vm[f], cross_f / self.vm[t]]
        by_t = [-1j * cross_t, 1j * cross_t, cross_t / self.vm[f], (2 * own_t + cross_t) / self.vm[t]]
        lost = np.stack([np.stack(by_f, axis=1), np.stack(by_t, axis=1)], axis=1)
        return -np.concatenate([lost.real, lost.imag], axis=1)

    # Solution ----------------------------------------------------------------------------

    def _survived(self, out: Index) -> Mask:
        """Return which outages of a batch are survived."""
        factors, (rows, columns) = self._factors, self._places(out)
        assert factors is not None
        (angles, magnitudes), k = self._unknown, np.arange(out.size)
        own = columns >= 0
        change = self._change(out) * (rows >= 0)[:, :, None] * own[:, None, :]
        needed, place = np.unique(np.maximum(rows, 0), return_inverse=True)
        unit = np.zeros((factors.shape[0], needed.size))
        unit[needed, np.arange(needed.size)] = 1.0
        moved = factors.solve(unit)[:, place.reshape(rows.shape)]  # (unknowns, outages, 4)
        here = moved[np.maximum(columns, 0)[:, :, None], k[:, None, None], np.arange(4)]
        correction = np.eye(4) + change @ here
        singular = np.abs(np.linalg.det(correction)) < _SINGULAR
        correction[singular] = np.eye(4)
        vm, va = (np.repeat(values[:, None], out.size, axis=1) for values in (self.vm, self.va))
        slack = np.zeros((self.network.n_islands, out.size))
        before = (self.vm * np.exp(1j * self.va))[:, None]
        wanted = before * (self._matrix @ before).conj()
        branch = self.network.branch
        for step in range(_STEPS + 1):
            v = vm * np.exp(1j * va)
            power = v * (self._matrix @ v).conj()
            lost = self._flows(vm, va, out)
            np.subtract.at(power, (branch.from_bus[out], k), lost[0])
            np.subtract.at(power, (branch.to_bus[out], k), lost[1])
            missing = power - wanted + 1j * self._support[:, None] * (vm - self.vm[:, None])
            missing -= self._shares @ slack
            rest = np.vstack([missing.real, missing.imag[magnitudes]])
            largest = np.abs(rest).max(axis=0)
            if step == _STEPS or (largest <= _SOLVED).all():
                break
            rest[:, ~np.isfinite(largest)] = 0.0
            direct = factors.solve(-rest)
            there = np.where(own, direct[np.maximum(columns, 0), k[:, None]], 0.0)
            weight = np.linalg.solve(correction, change @ there[:, :, None])[:, :, 0]
            direct -= np.einsum("nkr,kr->nk", moved, weight)
            va[angles] += direct[: angles.size]
            vm[magnitudes] += direct[angles.size : angles.size + magnitudes.size]
            slack += direct[angles.size + magnitudes.size :]
        within = self._within(out, vm, va, slack, power.imag - wanted.imag)
        return np.asarray((largest <= _SOLVED) & within & ~singular)

    def _within(self, out: Index, vm: Array, va: Array, slack: Array, added: Array) -> Mask:
        """Return for which outages the solution is within the limits."""
        network, reserve, k = self.network, self.reserve, np.arange(out.size)
        bus, branch = network.bus, network.branch
        flow = np.maximum(*map(np.abs, self._flows(vm, va)))
        angle = va[branch.from_bus] - va[branch.to_bus]
        flow[out, k] = angle[out, k] = 0.0
        voltage = np.maximum(vm - bus.vm_max, bus.vm_min - vm)[self._unknown[1]]
        active = reserve.share[:, None] * slack[network.island[network.generator.bus]]
        up, down = (self._of_units(part)[self._at, None] for part in (reserve.q_up, reserve.q_down))
        reactive = np.maximum(added[self._at] - up, -added[self._at] - down)
        outside = np.vstack(
            [
                voltage,
                active - reserve.up[:, None],
                -active - reserve.down[:, None],
                reactive,
                np.abs(slack[self._without_units]),
            ]
        )
        return _within_branches(branch, flow, angle) & (outside <= _WITHIN).all(axis=0)

    def _of_units(self, values: Array) -> Array:
        """Return the sum over the units of each bus."""
        return np.bincount(self.network.generator.bus, values, len(self.network.bus)).astype(float)


def _batches(out: Index) -> Iterator[Index]:
    for first in range(0, out.size, _TOGETHER):
        yield out[first : first + _TOGETHER]


def _within_branches(branch: Table, flow: Array, angle: Array) -> Mask:
    """Return for which outages flows and angles ``(branches, outages)`` are within limits."""
    outside = np.maximum(angle - branch.angle_max, branch.angle_min - angle)
    within = (flow <= branch.rating + _WITHIN) & (outside <= _WITHIN)
    return np.asarray(within.all(axis=0))
