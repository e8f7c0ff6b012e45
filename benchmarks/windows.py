"""Long horizons by overlapping windows: whole plans, windows and workers, and a year.

python -m benchmarks.windows [--year]
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from benchmarks.harness import arguments, measure, report, timed
from benchmarks.systems import case118

WEEK = 168


def plan(stages: int, solver: str, options: dict[str, Any]) -> dict[str, Any]:
    """IEEE 118 with storage at every bus and demand of days and weeks: one plan, and its sweeps."""
    import opfmodel as om
    from solvers.backends.windows import WindowsSession

    network, _ = case118(1)
    hours = np.arange(stages)
    wave = 0.85 + 0.15 * np.sin(2 * np.pi * (hours - 8) / 24) + 0.05 * np.sin(2 * np.pi * hours / WEEK)
    series = {
        f"{name}.{key}": getattr(load, key) * wave
        for name, load in network.of(om.Load).items()
        for key in ("p", "q")
    }
    problem = om.MultiStage(
        network,
        stages,
        objective=om.Economic(1e-3, 1e-3),
        profiles=series,
        solver=solver,
        options=options,
        verbose=solver == "windows",
    )
    compiled, _ = timed(problem.compile)
    seconds, found = timed(problem.solve)
    result = {
        "compile_s": compiled,
        "solve_s": seconds,
        "iterations": found.solution.iterations,
        "objective": found.solution.objective,
        "primal_residual": found.solution.primal_residual,
        "status": found.status,
    }
    if isinstance(problem.session, WindowsSession):
        trace = problem.session.trace
        result |= {
            "overlap": problem.session.overlap,
            "sweeps": len(trace),
            "gap": trace[-1].gap,
            "jump": trace[-1].jump,
            "trace": [[sweep.seconds, sweep.objective, sweep.gap, sweep.jump] for sweep in trace],
        }
    return result


def main() -> None:
    """Measure and report; with ``--year``, a year of 8,760 hours on two workers as well, in its own file."""
    year = "--year" in sys.argv
    sys.argv = [argument for argument in sys.argv if argument != "--year"]
    options = arguments(__doc__ or "")
    if year:
        asked = {"workers": 2, "tolerance": 1e-4, "window": WEEK}
        report("windows_year", [_row("118 x 8,760, 2 workers", measure(plan, 8760, "windows", asked))])
        return
    stages, window = (96, 24) if options.quick else (672, WEEK)
    asked = {"window": window, "tolerance": 1e-6}
    whole = measure(plan, stages, "ipopt", {})
    rows = [_row(f"118 x {stages}, whole", whole)]
    for workers in (1, 2, 4):
        found = measure(plan, stages, "windows", {**asked, "workers": workers})
        if "objective" in found and "objective" in whole:
            found["excess"] = found["objective"] / whole["objective"] - 1
        rows.append(_row(f"118 x {stages}, windows, {workers} workers", found))
    goals = {
        "largest relative difference from the whole plan (goal <= 1e-5)": max(
            abs(row["excess"]) for row in rows if "excess" in row
        )
    }
    report("windows", rows, goals)


def _row(name: str, result: dict[str, Any]) -> dict[str, Any]:
    """Return a row of the table; the course of the sweeps goes to the results of the year alone."""
    trace = result.pop("trace", None)
    for second, objective, gap, jump in trace or []:
        print(f"{name}: {second:.1f} s, objective {objective:.8g}, gap {gap:.1e}, jump {jump:.1e}")
    kept = {} if trace is None or "8,760" not in name else {"trace": trace}
    return {"measurement": name, **result, **kept}


if __name__ == "__main__":
    main()
