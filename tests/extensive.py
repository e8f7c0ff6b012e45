"""The extensive form of a stochastic optimal power flow, stated in plain loops on CasADi alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

import opfmodel as om


@dataclass
class Node:
    """A node of a tree: its parent, length, probability, and the demand by load in MW and MVAr.

    After an outage, ``out`` is the component that is lost, and ratings are multiplied by ``rating``. With
    ``held``, shares of the units in the slack, the response is preventive.
    """

    parent: int
    hours: float
    probability: float
    demand: dict[str, tuple[float, float]]
    out: str = ""
    rating: float = 1.0
    held: dict[str, float] | None = None


def solve(
    grid: om.Network,
    nodes: list[Node],
    energy: dict[str, float],
    formulation: str = "ac",
    dispatch: dict[str, tuple[float, float]] | None = None,
    delay: int = 0,
    risk: tuple[float, float] | None = None,
) -> dict[str, Any]:
    """Solve for all nodes at once; return the objective and the cost of each node in $.

    ``energy`` is what is stored at the beginning, in MWh. ``dispatch`` is the generation before the first
    stage, in MW and MVAr; with a delay of 1, that of the first stage.
    """
    problem = _Problem(grid, nodes, formulation)
    problem.state(energy, dispatch, delay)
    costs = [problem.cost(k) for k in range(len(nodes))]
    mean = sum(n.probability * n.hours * c for n, c in zip(nodes, costs, strict=True))
    objective = mean
    if risk is not None:
        objective = problem.averse(costs, mean, *risk)
    values = problem.solve(objective)
    found = values(objective), [n.hours * values(c) for n, c in zip(nodes, costs, strict=True)]
    lmp = {bus: [-float(m) for m in problem.multipliers(bus)] for bus in problem.buses}
    return {"objective": found[0], "costs": found[1], "lmp": lmp, "values": values, "problem": problem}


class _Problem:
    def __init__(self, grid: om.Network, nodes: list[Node], formulation: str) -> None:
        self.grid, self.nodes, self.formulation = grid, nodes, formulation
        self.base = grid.base_mva
        self.buses, self.branches = grid.of(om.Bus), grid.of(om.Branch)
        self.units, self.cells, self.loads = grid.of(om.Generator), grid.of(om.Storage), grid.of(om.Load)
        self.x: list[Any] = []
        self.bounds: list[tuple[float, float, float]] = []
        self.g: list[Any] = []
        self.rows: list[tuple[float, float]] = []
        self.balance: dict[tuple[str, int], int] = {}
        self.stages = [self.stage(k) for k in range(len(nodes))]

    def variable(self, low: float = -np.inf, high: float = np.inf, start: float = 0.0) -> Any:
        symbol = ca.MX.sym(f"x{len(self.x)}")
        self.x.append(symbol)
        self.bounds.append((low, high, float(np.clip(start, low, high))))
        return symbol

    def row(self, body: Any, low: float = 0.0, high: float = 0.0) -> int:
        self.g.append(body)
        self.rows.append((low, high))
        return len(self.g) - 1

    def stage(self, k: int) -> dict[str, Any]:
        """The variables and the network of one node, per unit."""
        base, reactive = self.base, self.formulation in ("ac", "soc")
        of: dict[str, Any] = {"pg": {}, "qg": {}, "ps": {}, "qs": {}, "e": {}, "loss": {}}
        for name, unit in self.units.items():
            on = 0.0 if name == self.nodes[k].out else 1.0 / base
            of["pg"][name] = self.variable(on * unit.p[0], on * unit.p[1], 0.5 * on * unit.p[1])
            of["qg"][name] = self.variable(on * unit.q[0], on * unit.q[1]) if reactive else 0.0
        for name, cell in self.cells.items():
            on = 0.0 if name == self.nodes[k].out else 1.0 / base
            of["ps"][name] = self.variable(-on * cell.power, on * cell.power)
            of["qs"][name] = self.variable(-on * cell.q, on * cell.q) if reactive else 0.0
            if self.nodes[k].held is None:
                of["e"][name] = self.variable(0.0, cell.energy / base, 0.5 * cell.energy / base)
        p = dict.fromkeys(self.buses, 0.0)
        q = dict.fromkeys(self.buses, 0.0)
        for name, unit in self.units.items():
            p[unit.bus] += of["pg"][name]
            q[unit.bus] += of["qg"][name]
        for name, cell in self.cells.items():
            p[cell.bus] -= of["ps"][name]
            q[cell.bus] -= of["qs"][name]
        for name, load in self.loads.items():
            demand = self.nodes[k].demand[name]
            p[load.bus] -= demand[0] / base
            q[load.bus] -= demand[1] / base
        self.now = self.nodes[k]
        of["voltage"] = getattr(self, f"flows_{self.formulation}")(p, q)
        for bus in self.buses:
            self.balance[bus, k] = self.row(p[bus])
            if reactive:
                self.row(q[bus])
        return of

    def flows_ac(self, p: dict[str, Any], q: dict[str, Any]) -> dict[str, Any]:
        vm = {name: self.variable(*bus.vm, 1.0) for name, bus in self.buses.items()}
        va = {n: self.variable(0.0, 0.0) if b.reference else self.variable() for n, b in self.buses.items()}
        for branch in self.in_service():
            f, t = branch.from_bus, branch.to_bus
            real, imaginary = (vm[f] * vm[t] * turn(va[f] - va[t]) for turn in (ca.cos, ca.sin))
            self.branch(branch, p, q, vm[f] ** 2, vm[t] ** 2, real, imaginary)
        return vm

    def flows_soc(self, p: dict[str, Any], q: dict[str, Any]) -> dict[str, Any]:
        w = {n: self.variable(b.vm[0] ** 2, b.vm[1] ** 2, 1.0) for n, b in self.buses.items()}
        for branch in self.in_service():
            f, t = branch.from_bus, branch.to_bus
            real, imaginary = self.variable(start=1.0), self.variable()
            self.row(real**2 + imaginary**2 - w[f] * w[t], -np.inf, 0.0)
            self.branch(branch, p, q, w[f], w[t], real, imaginary)
        return w

    def branch(self, branch: om.Branch, p: Any, q: Any, ff: Any, tt: Any, real: Any, imaginary: Any) -> None:
        """Power into both ends of a line without taps, from the products of its voltages."""
        y = 1.0 / complex(branch.r, branch.x)
        half = 0.5 * branch.b
        for bus, own, sign in ((branch.from_bus, ff, 1.0), (branch.to_bus, tt, -1.0)):
            active = y.real * own - y.real * real - sign * y.imag * imaginary
            drawn = -(y.imag + half) * own + y.imag * real - sign * y.real * imaginary
            p[bus] -= active
            q[bus] -= drawn
            self.row(active**2 + drawn**2, -np.inf, self.rating(branch) ** 2)

    def in_service(self) -> list[om.Branch]:
        return [branch for name, branch in self.branches.items() if name != self.now.out]

    def rating(self, branch: om.Branch) -> float:
        return self.now.rating * branch.rating / self.base

    def flows_dc(self, p: dict[str, Any], _: Any) -> None:
        va = {n: self.variable(0.0, 0.0) if b.reference else self.variable() for n, b in self.buses.items()}
        for branch in self.in_service():
            f, t = branch.from_bus, branch.to_bus
            flow = branch.x / (branch.r**2 + branch.x**2) * (va[f] - va[t])
            self.row(flow, -self.rating(branch), self.rating(branch))
            p[f] -= flow
            p[t] += flow

    def state(
        self, energy: dict[str, float], dispatch: dict[str, tuple[float, float]] | None, delay: int
    ) -> None:
        """What couples the nodes: energy, ramps, and the dispatch that siblings share."""
        shared: dict[int, int] = {}
        for k, node in enumerate(self.nodes):
            at, before = self.stages[k], None if node.parent < 0 else self.stages[node.parent]
            if node.held is not None:
                self.hold(node, at, before)
                continue
            for name in self.cells:
                start = energy[name] / self.base if before is None else before["e"][name]
                self.row(at["e"][name] - start - node.hours * at["ps"][name])
            self.ramps(node, at, before, dispatch if delay == 0 else None)
            if delay == 1 and dispatch is not None and before is None:
                given = [
                    {name: value / self.base for name, value in zip(dispatch, side, strict=True)}
                    for side in zip(*dispatch.values(), strict=True)
                ]
                self.same(at, {"pg": given[0], "qg": given[1]})
            if delay == 1 and not node.out:
                if node.parent in shared:
                    self.same(at, self.stages[shared[node.parent]])
                shared.setdefault(node.parent, k)

    def ramps(
        self, node: Node, at: Any, before: Any, dispatch: dict[str, tuple[float, float]] | None
    ) -> None:
        """Units move by their ramp from the node before, or from the dispatch before the first one."""
        hours = node.hours
        if before is not None and not node.out:
            hours = 0.5 * (node.hours + self.nodes[node.parent].hours)
        for name, unit in self.units.items():
            most = unit.ramp * hours / self.base
            if before is not None and name != node.out:
                self.row(at["pg"][name] - before["pg"][name], -most, most)
            elif before is None and dispatch is not None:
                self.row(at["pg"][name] - dispatch[name][0] / self.base, -most, most)

    def same(self, at: dict[str, Any], other: dict[str, Any]) -> None:
        """Two nodes have the same dispatch."""
        for name in self.units:
            self.row(at["pg"][name] - other["pg"][name])
            if self.formulation != "dc":
                self.row(at["qg"][name] - other["qg"][name])

    def hold(self, node: Node, at: dict[str, Any], before: dict[str, Any]) -> None:
        """After an outage, units share a slack, and storages and voltages stay."""
        kept = {name: share for name, share in node.held.items() if name != node.out}
        slack = self.variable()
        for name, share in kept.items():
            self.row(at["pg"][name] - before["pg"][name] - share / sum(kept.values()) * slack)
        for name in self.cells:
            if name != node.out:
                self.row(at["ps"][name] - before["ps"][name])
                if self.formulation != "dc":
                    self.row(at["qs"][name] - before["qs"][name])
        if self.formulation != "dc":
            for bus in {self.units[name].bus for name in kept}:
                self.row(at["voltage"][bus] - before["voltage"][bus])

    def cost(self, k: int) -> Any:
        """Cost of a node, $/h."""
        made = 0.0
        for name, unit in self.units.items():
            power = self.base * self.stages[k]["pg"][name]
            made += unit.cost.c2 * power**2 + unit.cost.c1 * power + unit.cost.c0
        return made

    def averse(self, costs: list[Any], mean: Any, level: float, weight: float) -> Any:
        """The mean and the conditional value at risk, with an excess for each leaf."""
        threshold = self.variable(start=1.0)
        tail = 0.0
        regular = {k for k, node in enumerate(self.nodes) if not node.out}
        for leaf in regular - {self.nodes[k].parent for k in regular}:
            k, total = leaf, 0.0
            while k >= 0:
                total += self.nodes[k].hours * costs[k]
                k = self.nodes[k].parent
            excess = self.variable(0.0)
            self.row(total - 1e3 * (threshold + excess), -np.inf, 0.0)
            tail += self.nodes[leaf].probability * 1e3 * excess
        return (1 - weight) * mean + weight * (1e3 * threshold + tail / (1 - level))

    def solve(self, objective: Any) -> Any:
        x, g = ca.vertcat(*self.x), ca.vertcat(*self.g)
        options = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-10}}
        solver = ca.nlpsol("extensive", "ipopt", {"x": x, "f": objective * 1e-2, "g": g}, options)
        low, high, start = np.array(self.bounds).T
        rows = np.array(self.rows)
        found = solver(x0=start, lbx=low, ubx=high, lbg=rows[:, 0], ubg=rows[:, 1])
        assert solver.stats()["success"], solver.stats()["return_status"]
        self.lam = np.asarray(found["lam_g"]).ravel() * 1e2
        return lambda quantity: float(ca.Function("read", [x], [quantity])(found["x"]))

    def multipliers(self, bus: str) -> list[float]:
        """The multiplier of the balance of a bus at each node, $/MW."""
        return [-self.lam[self.balance[bus, k]] / self.base for k in range(len(self.nodes))]
