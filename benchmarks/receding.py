"""Warm steps of a receding horizon compared with plain CasADi, and closed loops of the paper's systems.

python -m benchmarks.receding
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import arguments, measure, median, report
from benchmarks.systems import case118, demand, vectors

SCENARIOS = Path(__file__).parent.parent / "scenarios"
SYSTEMS = ("case5-step", "case5-random", "case118-step", "case118-random")
LOOP = 49  # steps of the paper's closed loops


def opfmodel_steps(horizon: int, steps: int) -> dict[str, Any]:
    """Solve the first problem cold, then ``steps`` more as a controller does."""
    import opfmodel as om

    network, series = case118(horizon + steps)
    problem = om.MultiStage(network, horizon, objective=om.Economic(1e-3, 1e-3), profiles=series)
    run = om.simulate(problem, steps=steps + 1)
    warm = run.plans[1:]
    seconds = [plan["step_seconds"] for plan in warm]
    return {
        "cold_s": run.plans[0]["step_seconds"],
        "step_s": float(np.mean(seconds)),
        "solver_s": float(np.mean([plan["solve_seconds"] for plan in warm])),
        "iterations": float(np.mean([plan["iterations"] for plan in warm])),
        "cost": run.cost,
        "status": run.status,
    }


def plain_steps(horizon: int, steps: int) -> dict[str, Any]:
    """Solve the same problems with plain CasADi, each started from the last primal solution."""
    from benchmarks.plain import PlainProblem
    from opfmodel.network.arrays import per_unit

    network, series = case118(horizon + steps)
    arrays = per_unit(network)
    problem = PlainProblem(arrays, horizon)
    state, start, seconds, iterations, cost = None, None, [], [], 0.0
    for step in range(steps + 1):
        pd, qd = demand(arrays, series, step, horizon)
        began = time.perf_counter()
        result = problem.solve(pd, qd, state, start)
        seconds.append(time.perf_counter() - began)
        iterations.append(result["iterations"])
        state, start = result["state"], result["x"]
        assert state is not None
        generator, dispatch = vectors(arrays).generator, state[1]
        cost += float((generator.c2 * dispatch**2 + generator.c1 * dispatch + generator.c0).sum())
    return {
        "cold_s": seconds[0],
        "step_s": float(np.mean(seconds[1:])),
        "iterations": float(np.mean(iterations[1:])),
        "cost": cost,
        "status": result["status"],
    }


def closed_loop(name: str, steps: int | None = None) -> dict[str, Any]:
    """The closed loop of a scenario, as a user runs it."""
    import opfmodel as om

    overrides = {} if steps is None else {"time.steps": steps}
    scenario = om.load_scenario(SCENARIOS / f"{name}.yaml", overrides=overrides)
    began = time.perf_counter()
    run = scenario.simulate()
    total = time.perf_counter() - began
    solver = sum(plan["solve_seconds"] for plan in run.plans)
    stepping = sum(plan["step_seconds"] for plan in run.plans)
    warm = run.plans[1:]
    return {
        "loop_s": total,
        "step_s": float(np.mean([plan["step_seconds"] for plan in warm])),
        "largest_s": max(plan["step_seconds"] for plan in run.plans),
        "iterations": float(np.mean([plan["iterations"] for plan in warm])),
        "overhead_percent": 100 * (1 - solver / stepping),
        "cost": run.cost,
        "status": run.status,
    }


def main() -> None:
    """Measure and report."""
    options = arguments(__doc__ or "")
    horizon, steps = (6, 3) if options.quick else (48, 5)
    measurements: list[tuple[str, Any, tuple[Any, ...]]] = [
        (f"opfmodel 118 x {horizon}, {steps} steps", opfmodel_steps, (horizon, steps)),
        (f"plain CasADi 118 x {horizon}, {steps} steps", plain_steps, (horizon, steps)),
    ]
    runs: dict[str, list[dict[str, Any]]] = {name: [] for name, _, _ in measurements}
    for _ in range(options.repeat):
        for name, function, given in measurements:
            runs[name].append(measure(function, *given))
    ours, plain = (median(list_) for list_ in runs.values())
    rows = [{"measurement": name, **median(list_)} for name, list_ in runs.items()]
    loops = {name: measure(closed_loop, name, 3 if options.quick else None) for name in SYSTEMS}
    rows += [{"measurement": f"closed loop {name}", **loop} for name, loop in loops.items()]
    extrapolated = plain["cold_s"] + (LOOP - 1) * plain["step_s"]
    goals = {
        "warm step, plain / opfmodel (goal >= 20)": plain["step_s"] / ours["step_s"],
        "warm step, plain / opfmodel case118-step (goal >= 45)": plain["step_s"]
        / loops["case118-step"]["step_s"],
        "cold, plain / opfmodel": plain["cold_s"] / ours["cold_s"],
        "loop of 49 steps, plain extrapolated / opfmodel case118-step (goal >= 20)": extrapolated
        / loops["case118-step"]["loop_s"],
        "overhead per step, case118-step, percent (goal <= 5)": loops["case118-step"]["overhead_percent"],
    }
    report("receding", rows, goals)


if __name__ == "__main__":
    main()
