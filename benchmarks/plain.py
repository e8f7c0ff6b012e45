"""Plain CasADi: one MX expression over all stages, default options of CasADi and IPOPT.

This baseline follows CasADi's examples, on the same arrays and with the same vectorised formulas,
so the difference lies in how the problem is assembled and solved. By default it omits the small
weight on storage power (``regularisation``) that opfmodel adds to make the problem well posed.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from benchmarks.systems import vectors
from opfmodel.network.arrays import PerUnitNetwork
from opfmodel.network.physics import branch_flow

__all__ = ["PlainProblem"]


class PlainProblem:
    """Multi-stage AC-OPF with storage, ramps and a given initial energy."""

    def __init__(  # noqa: PLR0915 - one function, as in such scripts
        self, network: PerUnitNetwork, horizon: int, weight: float = 1e-3, regularisation: float = 0.0
    ) -> None:
        network = vectors(network)
        bus, branch, gen, sto = network.bus, network.branch, network.generator, network.storage
        n, g, s = len(bus), len(gen), len(sto)
        self.horizon, self.n = horizon, n
        y = network.admittance
        f, t = branch.from_bus.tolist(), branch.to_bus.tolist()
        at_from, at_to = _incidence(n, branch.from_bus), _incidence(n, branch.to_bus)
        at_gen, at_sto = _incidence(n, gen.bus), _incidence(n, sto.bus)
        shunt_g, shunt_b = (
            network.at_buses("shunt", network.shunt.g),
            network.at_buses("shunt", network.shunt.b),
        )
        angle = np.full(n, np.inf)
        angle[network.reference] = 0.0
        limited = np.flatnonzero(np.isfinite(branch.rating)).tolist()
        pd, qd = ca.MX.sym("pd", n, horizon), ca.MX.sym("qd", n, horizon)
        energy, before = ca.MX.sym("e0", s), ca.MX.sym("pg0", g)
        parameters = ca.vertcat(ca.vec(pd), ca.vec(qd), energy, before)
        variables, rows, cost = [], [], 0
        lower, upper, start, row_lower, row_upper = [], [], [], [], []
        for k in range(horizon):
            vm, va = ca.MX.sym(f"vm{k}", n), ca.MX.sym(f"va{k}", n)
            pg, qg = ca.MX.sym(f"pg{k}", g), ca.MX.sym(f"qg{k}", g)
            ps, qs, e = ca.MX.sym(f"ps{k}", s), ca.MX.sym(f"qs{k}", s), ca.MX.sym(f"e{k}", s)
            variables += [vm, va, pg, qg, ps, qs, e]
            lower += [bus.vm_min, -angle, gen.p_min, gen.q_min, sto.power_min, sto.q_min, sto.energy_min]
            upper += [bus.vm_max, angle, gen.p_max, gen.q_max, sto.power_max, sto.q_max, sto.energy]
            middle = [0.5 * (gen.p_min + gen.p_max), 0.5 * (gen.q_min + gen.q_max)]
            start += [np.ones(n), np.zeros(n), *middle, np.zeros(s), np.zeros(s), sto.initial]
            across = va[f] - va[t]
            product = vm[f] * vm[t]
            flows = branch_flow(y, vm[f] ** 2, vm[t] ** 2, product * ca.cos(across), product * ca.sin(across))
            pf, qf, pt, qt = flows
            p = at_gen @ pg - at_sto @ ps - pd[:, k] - shunt_g * vm**2 - at_from @ pf - at_to @ pt
            q = at_gen @ qg - at_sto @ qs - qd[:, k] + shunt_b * vm**2 - at_from @ qf - at_to @ qt
            rows += [p, q, e - energy - ps]
            row_lower += [np.zeros(2 * n + s)]
            row_upper += [np.zeros(2 * n + s)]
            if limited:
                rows += [(pf**2 + qf**2)[limited], (pt**2 + qt**2)[limited]]
                row_lower += [np.full(2 * len(limited), -np.inf)]
                row_upper += [np.tile(branch.rating[limited] ** 2, 2)]
            rows.append(pg - before)
            if k == 0:
                first = sum(len(values) for values in row_lower)
                self.first_ramp = slice(first, first + g)
            row_lower.append(-gen.ramp)
            row_upper.append(gen.ramp)
            cost += ca.sum1(gen.c2 * pg**2 + gen.c1 * pg + gen.c0)
            cost += weight * (ca.sumsqr(qg) + ca.sumsqr(energy)) + regularisation * (
                ca.sumsqr(ps) + ca.sumsqr(qs)
            )
            energy, before = e, pg
        self.bounds = {
            "lbx": np.concatenate(lower),
            "ubx": np.concatenate(upper),
            "lbg": np.concatenate(row_lower),
            "ubg": np.concatenate(row_upper),
        }
        self.start = np.concatenate(start)
        self.initial = (sto.initial, None)
        stored = 2 * (n + g + s)
        self.places = {"pg": slice(2 * n, 2 * n + g), "e": slice(stored, stored + s)}
        problem = {
            "x": ca.vertcat(*variables),
            "p": parameters,
            "f": cost,
            "g": ca.vertcat(*rows),
        }
        options = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"}
        self.solver = ca.nlpsol("plain", "ipopt", problem, options)

    def solve(
        self,
        pd: np.ndarray,
        qd: np.ndarray,
        state: tuple[np.ndarray, np.ndarray | None] | None = None,
        start: np.ndarray | None = None,
    ) -> dict[str, Any]:
        """Solve for active and reactive demand, each of shape ``(buses, stages)``.

        Parameters
        ----------
        state
            Energy and last dispatch; without a dispatch the first stage has no ramp limit.
        start
            Primal values to start from, such as the last solution.
        """
        energy, dispatch = self.initial if state is None else state
        bounds = {key: values.copy() for key, values in self.bounds.items()}
        if dispatch is None:
            bounds["lbg"][self.first_ramp], bounds["ubg"][self.first_ramp] = -np.inf, np.inf
            dispatch = np.zeros(self.places["pg"].stop - self.places["pg"].start)
        given = np.concatenate([pd.ravel(order="F"), qd.ravel(order="F"), energy, dispatch])
        result = self.solver(x0=self.start if start is None else start, p=given, **bounds)
        stats = self.solver.stats()
        x = np.asarray(result["x"]).ravel()
        return {
            "x": x,
            "state": (x[self.places["e"]], x[self.places["pg"]]),
            "objective": float(result["f"]),
            "iterations": int(stats["iter_count"]),
            "status": str(stats["return_status"]),
        }


def _incidence(buses: int, at: np.ndarray) -> Any:
    """Matrix that sums component quantities at each bus."""
    return ca.DM.triplet(at.tolist(), list(range(len(at))), np.ones(len(at)).tolist(), buses, len(at))
