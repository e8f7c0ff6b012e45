"""Growth of time and memory with the number of scenarios in a tree.

python -m benchmarks.tree
"""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.growth import exponent
from benchmarks.harness import arguments, measure, median, report, timed
from benchmarks.systems import case118

SCENARIOS = (1, 3, 5, 9)
STAGES, COMMON, SPREAD = 24, 2, 0.06


def tree_118(scenarios: int) -> dict[str, Any]:
    """IEEE 118 with storage at every bus, 24 stages in each scenario: compile, cold solve, two warm steps.

    The cold solve begins at the plan for the expected future, ``midpoint`` at the midpoint of the bounds.
    """
    import opfmodel as om
    from opfmodel.profiles.scale import Scale

    network, series = case118(STAGES + 2)
    factors = np.linspace(1.0 - SPREAD, 1.0 + SPREAD, scenarios) if scenarios > 1 else [1.0]
    cases = {
        f"case {number}": om.Case(1.0 / scenarios, [Scale(float(factor))])
        for number, factor in enumerate(factors, start=1)
    }
    futures = om.Scenarios(common=COMMON, cases=cases)
    horizon = futures.horizon([1.0] * STAGES)
    problem = om.MultiStage(network, horizon, objective=om.Economic(1e-3, 1e-3), profiles=series)
    compiled, _ = timed(problem.compile)
    run = om.simulate(om.Controller(problem, scenarios=futures), steps=3)
    warm = [plan["step_seconds"] for plan in run.plans[1:]]
    first = om.Controller(problem, scenarios=futures).plan(0, None)
    bare, found = timed(lambda: problem.session.solve(first.solution.instance))
    assert found.status.is_optimal
    return {
        "nodes": len(horizon),
        "compile_s": compiled,
        "cold_s": run.plans[0]["step_seconds"],
        "midpoint_s": bare,
        "step_s": float(np.mean(warm)),
        "iterations": run.plans[0]["iterations"],
        "midpoint_iterations": found.iterations,
        "warm_iterations": float(np.mean([plan["iterations"] for plan in run.plans[1:]])),
        "status": run.status,
    }


def main() -> None:
    """Measure and report."""
    options = arguments(__doc__ or "")
    numbers = SCENARIOS[:2] if options.quick else SCENARIOS
    found = {n: median([measure(tree_118, n) for _ in range(options.repeat)]) for n in numbers}
    rows = [{"measurement": f"{n} scenarios x {STAGES} stages", **result} for n, result in found.items()]
    nodes = [result["nodes"] for result in found.values()]
    goals = {
        f"exponent of {what} with the number of nodes (goal <= 1.2)": exponent(
            nodes, [result[what] for result in found.values()]
        )
        for what in ("compile_s", "cold_s", "step_s", "peak_mb")
        if all(what in result for result in found.values())
    }
    report("tree", rows, goals)


if __name__ == "__main__":
    main()
