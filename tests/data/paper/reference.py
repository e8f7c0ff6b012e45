"""Reference costs of the two step systems of Faulwasser and Engelmann, by a program of its own.

It shares nothing with opfmodel: it reads the MATPOWER files itself, states the AC equations in rectangular
voltages v = a + jb with complex admittance matrices, and hands one CasADi expression to IPOPT. It writes
``reference.json``, to which ``tests/test_paper.py`` compares opfmodel. Quantities are in per unit on 100 MVA.

    python tests/data/paper/reference.py [case5-step] [case118-step]
"""

from __future__ import annotations

import json
import logging
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]
Values = dict[str, Any]  # matrices of CasADi by quantity, (items, stages)

ROOT = Path(__file__).resolve().parents[3]
RESULT = Path(__file__).with_name("reference.json")

HORIZON, STEPS = 48, 49  # stages of one hour in a plan, steps of a closed loop
RAMP = 0.1  # per stage, as a share of p_max
STORAGE_POWER = 0.1  # limit of |ps| and |qs|
SMALL = 1e-3  # economic weight of qg² and e², $/(h p.u.²)
REGULARISATION = 1e-2  # of ps² and qs² in economic plans, $/(h p.u.²); no part of any reported cost
INPUT_WEIGHT = 0.1  # of ps² and qs² where set-points are tracked; states have weight 1


@dataclass(frozen=True)
class System:
    """A grid of N buses and G generators, a storage at every bus, and the demand."""

    v: tuple[Array, Array]  # limits of voltage magnitudes, (N,)
    reference: int  # position of the reference bus
    y_bus: Complex  # (N, N)
    ends: list[tuple[Array, Complex, Array]]  # ends of rated branches: incidence, admittance, rating
    at: Array  # incidence of the generators, (N, G)
    p: tuple[Array, Array]  # limits of generation, (G,)
    q: tuple[Array, Array]
    cost: Array  # c2, c1, c0 of the generators, (3, G)
    energy: float  # capacity of each storage
    demand: Complex  # (N, HORIZON + STEPS)


def case5_step() -> System:
    """Case 5: units at bus 1 merged, quadratic costs, all demand times 1.06, steps of 0.5 p.u. at bus 4."""
    case = read_case(ROOT / "tests" / "data" / "matpower" / "case5.m")
    case["gen"][1, [3, 4, 8, 9]] += case["gen"][0, [3, 4, 8, 9]]  # q_max, q_min, p_max, p_min
    case["gen"] = case["gen"][1:]
    cost = np.array([[10.0, 11.0, 12.0, 13.0], [1500.0, 3000.0, 4000.0, 1000.0], [0.0, 0.0, 0.0, 0.0]])
    share = 0.5 / (1.06 * 4.0)
    return system(case, cost, 2.0, stepped(case, [3], 1 + share, 1 - share, level=1.06))


def case118_step() -> System:
    """Case 118 with its own costs; demand at buses 59 and 116 is multiplied by 1.5, then by 0.8."""
    case = read_case(ROOT / "scenarios" / "data" / "case118.m")
    cost = case["gencost"][:, 4:7].T * [[1e4], [1e2], [1.0]]
    return system(case, cost, 0.5, stepped(case, [58, 115], 1.5, 0.8))


SYSTEMS = {"case5-step": case5_step, "case118-step": case118_step}


def read_case(path: Path) -> dict[str, Array]:
    """The tables of a MATPOWER file in which everything is in service and all costs are polynomials."""
    text = re.sub("%.*", "", path.read_text(encoding="utf-8"))
    tables = re.findall(r"mpc\.(bus|gen|branch|gencost) = \[(.*?)\]", text, re.DOTALL)
    return {name: np.array([row.split() for row in body.split(";")[:-1]], float) for name, body in tables}


def stepped(case: dict[str, Array], buses: list[int], up: float, down: float, level: float = 1.0) -> Complex:
    """The demand of a case, multiplied at some buses for t = 8 ... 15 and for t = 30 ... 40."""
    load = level / 100 * (case["bus"][:, 2, None] + 1j * case["bus"][:, 3, None])
    series: Complex = np.repeat(load, HORIZON + STEPS, axis=1)
    series[buses, 8:16] *= up
    series[buses, 30:41] *= down
    return series


def system(case: dict[str, Array], cost: Array, energy: float, load: Complex) -> System:
    """The tables of a case as admittance matrices and limits."""
    bus, gen, branch = case["bus"], case["gen"], case["branch"]
    position = {number: i for i, number in enumerate(bus[:, 0])}

    def incidence(numbers: Array) -> Array:
        return np.eye(len(bus))[[position[number] for number in numbers]]

    start, end = incidence(branch[:, 0]), incidence(branch[:, 1])
    series = 1 / (branch[:, 2] + 1j * branch[:, 3])[:, None]
    own = series + 0.5j * branch[:, 4, None]
    tap = np.where(branch[:, 8] == 0, 1, branch[:, 8])[:, None] * np.exp(1j * np.radians(branch[:, 9, None]))
    y_start = own / abs(tap) ** 2 * start - series / tap.conj() * end
    y_end = own * end - series / tap * start
    rated = branch[:, 5] > 0
    rating = branch[rated, 5] / 100
    return System(
        v=(bus[:, 12], bus[:, 11]),
        reference=int(np.flatnonzero(bus[:, 1] == 3)[0]),
        y_bus=start.T @ y_start + end.T @ y_end + np.diag(bus[:, 4] + 1j * bus[:, 5]) / 100,
        ends=[(start[rated], y_start[rated], rating), (end[rated], y_end[rated], rating)],
        at=incidence(gen[:, 0]).T,
        p=(gen[:, 9] / 100, gen[:, 8] / 100),
        q=(gen[:, 4] / 100, gen[:, 3] / 100),
        cost=cost,
        energy=energy,
        demand=load,
    )


def economic(grid: System, pg: Any, qg: Any, e: Any) -> Any:
    """Economic cost of states (items, stages), $."""
    c2, c1, c0 = (ca.DM(row).T for row in grid.cost)
    operation = ca.sum2(ca.mtimes(c2, pg**2) + ca.mtimes(c1, pg) + ca.sum2(c0))
    return operation + SMALL * (ca.sumsqr(qg) + ca.sumsqr(e))


def power(incidence: Array, admittance: Complex, a: Any, b: Any) -> tuple[Any, Any]:
    """Active and reactive power v conj(Y v), where the incidence picks the first voltage v = a + jb."""
    pick, g, s = (ca.sparsify(ca.DM(m)) for m in (incidence, admittance.real, admittance.imag))
    real, imaginary = ca.mtimes(g, a) - ca.mtimes(s, b), ca.mtimes(g, b) + ca.mtimes(s, a)
    a, b = ca.mtimes(pick, a), ca.mtimes(pick, b)
    return a * real + b * imaginary, b * real - a * imaginary


class Problem:
    """The optimal power flow of some stages, compiled once for all demands and initial states.

    Ramps and storages couple the stages; the state ``pg``, ``qg``, ``e`` of the first one is given, so that
    only storage acts there. ``alone``, a stage has free generators and no storage.
    """

    def __init__(self, grid: System, k: int = HORIZON, tracking: bool = False, alone: bool = False) -> None:
        n, units = grid.at.shape
        items = {"a": n, "b": n, "pg": units, "qg": units, "ps": n, "qs": n, "e": n}
        x = {name: ca.SX.sym(name, size, k + (name == "e")) for name, size in items.items()}
        pd, qd, pg_s, qg_s = (ca.SX.sym("given", size, k) for size in (n, n, units, units))
        effort = ca.sumsqr(x["ps"]) + ca.sumsqr(x["qs"])
        if tracking:
            distance = ca.veccat(x["pg"] - pg_s, x["qg"] - qg_s, x["e"][:, :k] - grid.energy / 2)
            cost = ca.sumsqr(distance) + INPUT_WEIGHT * effort
        else:
            cost = economic(grid, x["pg"], x["qg"], x["e"][:, :k]) + REGULARISATION * effort

        p, q = power(np.eye(n), grid.y_bus, x["a"], x["b"])
        at, ramp, zero = ca.sparsify(ca.DM(grid.at)), RAMP * grid.p[1], np.zeros(n)
        rows = [  # expression (items, stages), and its limits (items,)
            (ca.mtimes(at, x["pg"]) - pd - x["ps"] - p, zero, zero),
            (ca.mtimes(at, x["qg"]) - qd - x["qs"] - q, zero, zero),
            (x["e"][:, 1:] - x["e"][:, :k] - x["ps"], zero, zero),
            (x["pg"][:, 1:] - x["pg"][:, :-1], -ramp, ramp),
            (x["a"] ** 2 + x["b"] ** 2, grid.v[0] ** 2, grid.v[1] ** 2),
        ]
        for incidence, admittance, rating in grid.ends:
            flow_p, flow_q = power(incidence, admittance, x["a"], x["b"])
            rows.append((flow_p**2 + flow_q**2, 0 * rating, rating**2))
        self.row_limits = [np.concatenate([np.tile(r[i], r[0].shape[1]) for r in rows]) for i in (1, 2)]

        most = np.full(n, 0.0 if alone else STORAGE_POWER)
        b_most = np.where(np.arange(n) == grid.reference, 0.0, grid.v[1])  # v and -v are the same state
        limits = {"a": (-grid.v[1], grid.v[1]), "b": (-b_most, b_most), "pg": grid.p, "qg": grid.q}
        limits |= {"ps": (-most, most), "qs": (-most, most), "e": (zero, zero + grid.energy)}
        self.low, self.high = (
            {name: ca.repmat(ca.DM(limits[name][i]), 1, x[name].shape[1]) for name in x} for i in (0, 1)
        )
        self.middle = {name: (self.low[name] + self.high[name]) / 2 for name in x} | {"a": ca.DM.ones(n, k)}
        symbols, given = ca.veccat(*x.values()), ca.veccat(pd, qd, pg_s, qg_s)
        self.split = ca.Function("split", [symbols], list(x.values()), ["x"], list(x))
        program = {"x": symbols, "p": given, "f": cost, "g": ca.veccat(*(row[0] for row in rows))}
        options: Any = {"print_time": False, "ipopt": {"tol": 1e-8, "print_level": 0, "sb": "yes"}}
        self.solver = ca.nlpsol("solver", "ipopt", program, options)

    def solve(self, load: Complex, state: Values, goal: Sequence[Any], guess: Values | None = None) -> Values:
        """The optimum for a demand (N, k), an initial state and set-points ``pg``, ``qg``, from a guess."""
        low, high = ({name: ca.DM(limit) for name, limit in side.items()} for side in (self.low, self.high))
        for name, value in state.items():
            low[name][:, 0] = high[name][:, 0] = value
        parts = (guess or self.middle).values(), (load.real, load.imag, *goal), low.values(), high.values()
        x0, p, lbx, ubx = (ca.veccat(*part) for part in parts)
        found = self.solver(x0=x0, p=p, lbx=lbx, ubx=ubx, lbg=self.row_limits[0], ubg=self.row_limits[1])
        if (status := self.solver.stats()["return_status"]) != "Solve_Succeeded":  # to its full tolerance
            raise RuntimeError(status)
        return dict(self.split(x=found["x"]))


def single_stages(grid: System) -> Values:
    """The optimum of each step by itself, (items, HORIZON + STEPS); equal demands are solved once."""
    problem, no_goal = Problem(grid, 1, alone=True), ca.DM.zeros(2 * grid.at.shape[1])
    distinct, of_step = np.unique(grid.demand, axis=1, return_inverse=True)
    optima = [problem.solve(column[:, None], {"e": 0}, [no_goal]) for column in distinct.T]
    return {name: ca.horzcat(*(optima[i][name] for i in of_step.ravel())) for name in ("pg", "qg")}


def initial(grid: System, optima: Values) -> Values:
    """The state at the start of a closed loop: the single-stage optimum, and storages half full."""
    half = ca.DM.ones(len(grid.demand)) * grid.energy / 2
    return {name: value[:, 0] for name, value in optima.items()} | {"e": half}


def closed_loop(grid: System, optima: Values, tracking: bool) -> float:
    """Economic cost along the loop of a controller with a perfect forecast, $."""
    logging.info("tracking controller" if tracking else "economic controller")
    problem, state, guess, cost = Problem(grid, tracking=tracking), initial(grid, optima), None, 0.0
    for t in range(STEPS):
        window = slice(t, t + HORIZON)
        goal = [value[:, window] for value in optima.values()]
        plan = problem.solve(grid.demand[:, window], state, goal, guess)
        guess = {name: ca.horzcat(value[:, 1:], value[:, -1]) for name, value in plan.items()}
        cost += float(economic(grid, **state))
        state = {name: plan[name][:, 1] for name in state}
        logging.info("  t = %d: %d iterations, %.2f $ so far", t, problem.solver.stats()["iter_count"], cost)
    return cost


def single_stage_cost(grid: System, optima: Values) -> float:
    """Cost of the single-stage optima, $."""
    return float(economic(grid, optima["pg"][:, :STEPS], optima["qg"][:, :STEPS], e=ca.DM(0)))


def costs(grid: System) -> dict[str, float]:
    """J_e, J_s and J_t of a system, $."""
    optima = single_stages(grid)
    j_e, j_t = (closed_loop(grid, optima, tracking) for tracking in (False, True))
    return {"J_e": round(j_e, 2), "J_s": round(single_stage_cost(grid, optima), 2), "J_t": round(j_t, 2)}


def main(names: list[str]) -> None:
    """Compute some systems, all by default, and enter their costs into the file."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")  # on standard error
    for name in names or SYSTEMS:
        logging.info(name)
        command = f"python {Path(__file__).resolve().relative_to(ROOT).as_posix()} {name}"
        made = {"date": f"{date.today():%Y-%m-%d}", "casadi": version("casadi"), "command": command}
        entry = {"costs": costs(SYSTEMS[name]()), **made}
        known = json.loads(RESULT.read_text(encoding="utf-8")) if RESULT.exists() else {}
        RESULT.write_text(json.dumps(known | {name: entry}, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
