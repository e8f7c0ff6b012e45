"""The multi-stage AC-OPF with storage as a Pyomo model, for comparison.

Pyomo writes the model to an NL file that CasADi reads, so the same build of IPOPT solves it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pyomo.environ as pyo

from benchmarks.systems import vectors
from opfmodel.network.arrays import PerUnitNetwork
from opfmodel.network.physics import branch_flow

__all__ = ["pyomo_model", "solve_file"]


def pyomo_model(network: PerUnitNetwork, pd: np.ndarray, qd: np.ndarray, weight: float = 1e-3) -> Any:
    """State the problem of :class:`benchmarks.plain.PlainProblem` rule by rule, as is usual in Pyomo."""
    n, horizon = pd.shape
    network = vectors(network)
    bus, branch, gen, sto = network.bus, network.branch, network.generator, network.storage
    ends, at_gen, at_sto = [], _members(n, gen.bus), _members(n, sto.bus)
    ends = [_members(n, branch.from_bus), _members(n, branch.to_bus)]
    shunt_g, shunt_b = (network.at_buses("shunt", s) for s in (network.shunt.g, network.shunt.b))
    m = pyo.ConcreteModel()
    m.k, m.i = pyo.RangeSet(0, horizon - 1), pyo.RangeSet(0, n - 1)
    m.g, m.s = pyo.RangeSet(0, len(gen) - 1), pyo.RangeSet(0, len(sto) - 1)
    m.l = pyo.RangeSet(0, len(branch) - 1)
    m.vm = pyo.Var(m.i, m.k, bounds=_box(bus.vm_min, bus.vm_max), initialize=1.0)
    m.va = pyo.Var(m.i, m.k, initialize=0.0)
    m.pg = pyo.Var(m.g, m.k, bounds=_box(gen.p_min, gen.p_max), initialize=_middle(gen.p_min, gen.p_max))
    m.qg = pyo.Var(m.g, m.k, bounds=_box(gen.q_min, gen.q_max), initialize=_middle(gen.q_min, gen.q_max))
    m.ps = pyo.Var(m.s, m.k, bounds=_box(sto.power_min, sto.power_max), initialize=0.0)
    m.qs = pyo.Var(m.s, m.k, bounds=_box(sto.q_min, sto.q_max), initialize=0.0)
    m.e = pyo.Var(
        m.s, m.k, bounds=_box(sto.energy_min, sto.energy), initialize=lambda _, s, _k: sto.initial[s]
    )
    for reference in network.reference:
        for k in m.k:
            m.va[int(reference), k].fix(0.0)
    flows = {(line, k): _flow(network, m, line, k) for line in m.l for k in m.k}

    def p_balance(m: Any, i: int, k: int) -> Any:
        injected = sum(m.pg[g, k] for g in at_gen[i]) - sum(m.ps[s, k] for s in at_sto[i])
        sent = sum(flows[line, k][0] for line in ends[0][i]) + sum(flows[line, k][2] for line in ends[1][i])
        return injected - pd[i, k] - shunt_g[i] * m.vm[i, k] ** 2 == sent

    def q_balance(m: Any, i: int, k: int) -> Any:
        injected = sum(m.qg[g, k] for g in at_gen[i]) - sum(m.qs[s, k] for s in at_sto[i])
        sent = sum(flows[line, k][1] for line in ends[0][i]) + sum(flows[line, k][3] for line in ends[1][i])
        return injected - qd[i, k] + shunt_b[i] * m.vm[i, k] ** 2 == sent

    def energy(m: Any, s: int, k: int) -> Any:
        return m.e[s, k] == (m.e[s, k - 1] if k else sto.initial[s]) + m.ps[s, k]

    def ramp(m: Any, g: int, k: int) -> Any:
        if k == 0:
            return pyo.Constraint.Skip
        return pyo.inequality(-gen.ramp[g], m.pg[g, k] - m.pg[g, k - 1], gen.ramp[g])

    m.p_balance, m.q_balance = (
        pyo.Constraint(m.i, m.k, rule=p_balance),
        pyo.Constraint(m.i, m.k, rule=q_balance),
    )
    m.energy, m.ramp = pyo.Constraint(m.s, m.k, rule=energy), pyo.Constraint(m.g, m.k, rule=ramp)
    limited = [(int(line), end) for line in np.flatnonzero(np.isfinite(branch.rating)) for end in (0, 2)]
    m.rating = pyo.Constraint(
        limited,
        m.k,
        rule=lambda _, line, end, k: (
            flows[line, k][end] ** 2 + flows[line, k][end + 1] ** 2 <= branch.rating[line] ** 2
        ),
    )
    operating = sum(
        gen.c2[g] * m.pg[g, k] ** 2 + gen.c1[g] * m.pg[g, k] + gen.c0[g] + weight * m.qg[g, k] ** 2
        for g in m.g
        for k in m.k
    )
    stored = sum(weight * (m.e[s, k - 1] if k else sto.initial[s]) ** 2 for s in m.s for k in m.k)
    m.cost = pyo.Objective(expr=operating + stored)
    return m


def _flow(network: Any, m: Any, line: int, k: int) -> tuple[Any, Any, Any, Any]:
    f, t = int(network.branch.from_bus[line]), int(network.branch.to_bus[line])
    product, across = m.vm[f, k] * m.vm[t, k], m.va[f, k] - m.va[t, k]
    products = (m.vm[f, k] ** 2, m.vm[t, k] ** 2, product * pyo.cos(across), product * pyo.sin(across))
    return branch_flow(network.admittance[line], *products)


def _members(buses: int, at: np.ndarray) -> list[list[int]]:
    members: list[list[int]] = [[] for _ in range(buses)]
    for component, bus in enumerate(at):
        members[int(bus)].append(component)
    return members


def _box(lower: np.ndarray, upper: np.ndarray) -> Any:
    return lambda _, i, _k: (lower[i], upper[i])


def _middle(lower: np.ndarray, upper: np.ndarray) -> Any:
    return lambda _, i, _k: 0.5 * (lower[i] + upper[i])


def solve_file(path: Path) -> dict[str, Any]:
    """Solve an NL file with CasADi's IPOPT and its default options."""
    problem = ca.NlpBuilder()
    problem.import_nl(str(path))
    nlp = {"x": ca.vertcat(*problem.x), "f": problem.f, "g": ca.vertcat(*problem.g)}
    solver = ca.nlpsol(
        "pyomo", "ipopt", nlp, {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"}
    )
    result = solver(x0=problem.x_init, lbx=problem.x_lb, ubx=problem.x_ub, lbg=problem.g_lb, ubg=problem.g_ub)
    stats = solver.stats()
    return {
        "objective": float(result["f"]),
        "iterations": int(stats["iter_count"]),
        "status": str(stats["return_status"]),
    }
