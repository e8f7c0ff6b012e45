"""A Newton power flow, written apart from the product: complex powers and SciPy's sparse solver."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import spsolve

import opfmodel as om
from opfmodel.network.arrays import PerUnitNetwork, per_unit


def power_flow(network: om.Network, start: dict[str, complex] | None = None) -> dict[str, complex]:
    """Voltages of the buses in service at the set-points of a network, with one slack per island.

    Parameters
    ----------
    start
        First guess, which is used if it has all buses.
    """
    arrays = per_unit(network)
    position = arrays.bus.position
    admittance, branches = _admittance(network, arrays)
    n = len(arrays.bus)
    injected = -(arrays.at_buses("load", arrays.load.p) + 1j * arrays.at_buses("load", arrays.load.q))[:, 0]
    vm, holds = np.ones(n), np.zeros(n, dtype=bool)
    for name in arrays.generator.names:
        unit = network[name]
        at = position[unit.bus]
        injected[at] += (unit.pg_set or 0.0) / arrays.base_mva
        if unit.regulates:
            holds[at], vm[at] = True, unit.vm_set or 1.0
        else:
            injected[at] += 1j * (unit.qg_set or 0.0) / arrays.base_mva
    for name in arrays.storage.names:
        unit = network[name]
        injected[position[unit.bus]] -= (unit.ps_set + 1j * unit.qs_set) / arrays.base_mva
    reference = np.zeros(n, dtype=bool)
    reference[arrays.reference] = True
    p_rows, q_rows = np.flatnonzero(~reference), np.flatnonzero(~reference & ~holds)
    va = _first_angles(arrays, branches, injected.real, p_rows)
    if start and set(start) >= set(position):
        guess = np.array([start[name] for name in arrays.bus.names])
        va, vm[q_rows] = np.angle(guess), np.abs(guess)[q_rows]
    for _ in range(40):
        v = vm * np.exp(1j * va)
        current = admittance @ v
        mismatch = v * current.conj() - injected
        residual = np.r_[mismatch.real[p_rows], mismatch.imag[q_rows]]
        if not residual.size or np.abs(residual).max() < 1e-12:
            break
        d_va = (1j * sp.diags(v) @ (sp.diags(current) - admittance @ sp.diags(v)).conj()).tocsr()
        d_vm = sp.diags(v) @ (admittance @ sp.diags(v / vm)).conj() + sp.diags(current.conj() * v / vm)
        d_vm = d_vm.tocsr()
        jacobian = sp.bmat(
            [
                [d_va.real[p_rows][:, p_rows], d_vm.real[p_rows][:, q_rows]],
                [d_va.imag[q_rows][:, p_rows], d_vm.imag[q_rows][:, q_rows]],
            ]
        )
        step = np.atleast_1d(spsolve(jacobian.tocsc(), -residual))
        va[p_rows] += step[: p_rows.size]
        vm[q_rows] += step[p_rows.size :]
    assert not residual.size or np.abs(residual).max() < 1e-8, "the power flow did not converge"
    return {name: complex(v[at]) for name, at in position.items()}


Ends = tuple[NDArray[np.intp], NDArray[np.intp]]


def _admittance(network: om.Network, arrays: PerUnitNetwork) -> tuple[sp.csr_matrix, Ends]:
    y, position, n = arrays.admittance, arrays.bus.position, len(arrays.bus)
    start = np.array([position[network[b].from_bus] for b in arrays.branch.names], dtype=int)
    end = np.array([position[network[b].to_bus] for b in arrays.branch.names], dtype=int)
    entries = [y.g_ff + 1j * y.b_ff, y.g_ft + 1j * y.b_ft, y.g_tf + 1j * y.b_tf, y.g_tt + 1j * y.b_tt]
    where = np.r_[start, start, end, end], np.r_[start, end, start, end]
    matrix = sp.csr_matrix((np.concatenate([e[:, 0] for e in entries]), where), shape=(n, n))
    shunt = arrays.at_buses("shunt", arrays.shunt.g) + 1j * arrays.at_buses("shunt", arrays.shunt.b)
    return matrix + sp.diags(shunt[:, 0]), (start, end)


def _first_angles(
    arrays: PerUnitNetwork, ends: Ends, injected: NDArray[np.float64], rows: NDArray[np.intp]
) -> NDArray[np.float64]:
    """Angles of a DC power flow with phase shifts."""
    start, end = ends
    n, t = len(arrays.bus), arrays.branch
    b = -(1.0 / (t.r + 1j * t.x)).imag[:, 0]
    power = injected.copy()
    np.add.at(power, start, b * t.shift[:, 0])
    np.add.at(power, end, -b * t.shift[:, 0])
    where = np.r_[start, start, end, end], np.r_[start, end, start, end]
    matrix = sp.csr_matrix((np.r_[b, -b, -b, b], where), shape=(n, n))
    angles = np.zeros(n)
    if rows.size:
        angles[rows] = spsolve(matrix[rows][:, rows].tocsc(), power[rows])
    return angles
