"""Iterations and time of different starts for the next problem of a receding horizon.

python -m benchmarks.warm_start
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import arguments, measure, report

SCENARIOS = Path(__file__).parent.parent / "scenarios"
# First step and number of steps to solve for each system.
WINDOWS = {
    "case5-step": (0, 12),
    "case5-random": (0, 14),
    "case118-step": (2, 5),
    "case118-random": (8, 6),
}
PUSHES = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push")


def pushed(push: float, **options: Any) -> dict[str, Any]:
    """IPOPT options for a warm start that is moved off its bounds by ``push``."""
    return {f"warm_start_{name}": push for name in PUSHES} | options


# Number of stages at the end that stay in place (None: the last is repeated), and IPOPT options.
STARTS: dict[str, tuple[int | None, dict[str, Any]]] = {
    "last stage repeated, push 1e-6": (None, pushed(1e-6)),
    "last stage stays, push 1e-6": (1, pushed(1e-6)),
    "last 8 stages stay, push 1e-6": (8, pushed(1e-6)),
    "last stage stays, push 1e-3": (1, pushed(1e-3)),
    "last stage stays, push 1e-2": (1, pushed(1e-2)),
    "last stage stays, push 1e-1": (1, pushed(1e-1)),
    "last stage stays, push 1e-3, mu_init 1e-3": (1, pushed(1e-3, mu_init=1e-3)),
    "last stage stays, push 1e-3, adaptive": (1, pushed(1e-3, mu_strategy="adaptive")),
}
# IPOPT options of complete closed loops, in which all other pushes are 1e-2.
LOOPS: dict[str, dict[str, Any]] = {
    "closed loop, multipliers 1e-2": {"warm_start_mult_bound_push": 1e-2},
    "closed loop, multipliers 1e-4": {"warm_start_mult_bound_push": 1e-4},
    "closed loop, multipliers by the last step (the default)": {},
}


def moved(solution: Any, keep: int | None) -> Any:
    """A solution shifted ahead by one stage; the last ``keep`` stages stay, or the last is repeated."""
    from solvers import Start

    def shift(vector: np.ndarray, blocks: Any) -> np.ndarray:
        out = vector.copy()
        for block in blocks:
            stage = np.arange(block.stages)
            ahead = np.minimum(stage + 1, block.stages - 1)
            if keep is not None and block.stages > 1:
                ahead = np.where(stage < block.stages - keep - 1, ahead, stage)
            out[block.slice] = block.read(vector)[..., ahead].ravel(order="F")
        return out

    program = solution.program
    variables, rows = program.variables.values(), program.rows.values()
    return Start(
        shift(solution.x, variables),
        shift(solution.lam_x, variables),
        shift(solution.lam_g, rows),
        shift(solution.z, program.cones.values()),
        moved=1,
    )


def starts(name: str, quick: bool) -> dict[str, Any]:
    """Iterations and seconds of all solves but the first, for every start."""
    import opfmodel as om

    first, count = WINDOWS[name]
    overrides = {"controller.horizon": 6} if quick else {}
    scenario = om.load_scenario(SCENARIOS / f"{name}.yaml", overrides=overrides)
    problem = scenario.problem
    instances, cold = _loop(problem, scenario, first, count)
    rows: dict[str, Any] = {"cold": _figures(cold[1:])}
    for label, (keep, options) in STARTS.items():
        other = problem.variant(elastic=None)
        other.options = options
        session = other.session
        rows[label] = _figures(
            [
                session.solve(instance, moved(before, keep))
                for before, instance in zip(cold, instances[1:], strict=False)
            ]
        )
    session = problem.session
    alone: Callable[[Any], Any] = lambda solution: type(solution.start())(moved(solution, 1).x)  # noqa: E731
    rows["primal values alone"] = _figures(
        [session.solve(instance, alone(b)) for b, instance in zip(cold, instances[1:], strict=False)]
    )
    rows["the same problem again"] = _figures([session.solve(s.instance, s.start()) for s in cold[1:]])
    return {"rows": rows}


def loops(name: str, quick: bool) -> dict[str, Any]:
    """Iterations and seconds of the warm steps of a closed loop, for every push of the multipliers."""
    import opfmodel as om

    rows: dict[str, Any] = {}
    for label, options in LOOPS.items():
        overrides: dict[str, Any] = {"controller.solver": {"name": "ipopt", "options": options}}
        if quick:
            overrides |= {"controller.horizon": 6, "time.steps": 6}
        run = om.load_scenario(SCENARIOS / f"{name}.yaml", overrides=overrides).simulate()
        plans = run.plans[1:]
        iterations = [plan["iterations"] for plan in plans]
        rows[label] = {
            "iterations": float(np.mean(iterations)),
            "most": max(iterations),
            "seconds": float(np.mean([plan["solve_seconds"] for plan in plans])),
            "failed": len(run.summary()["retries"]),
        }
    return {"rows": rows}


def _loop(problem: Any, scenario: Any, first: int, count: int) -> tuple[list[Any], list[Any]]:
    """Instances and cold solutions of part of a closed loop, which begins at the single-stage optimum."""
    import opfmodel as om

    metered = om.MultiStage(scenario.network, objective=scenario.cost, profiles=scenario.profiles)
    data = om.single_stage_sequence(metered, 1, first).data
    state: Any = {name: data[name].values[0] for name in ("pg", "qg")}
    solutions = []
    for time in range(first, first + count):
        plan = problem.solve(time, state)
        solutions.append(plan.solution)
        state = plan.next_state()
    return [solution.instance for solution in solutions], solutions


def _figures(solutions: list[Any]) -> dict[str, float]:
    iterations = [solution.iterations for solution in solutions]
    return {
        "iterations": float(np.mean(iterations)),
        "most": max(iterations),
        "seconds": float(np.mean([solution.seconds for solution in solutions])),
        "failed": sum(not solution.status.is_optimal for solution in solutions),
    }


def main() -> None:
    """Measure and report."""
    options = arguments(__doc__ or "")
    names = list(WINDOWS)[:1] if options.quick else list(WINDOWS)
    rows: dict[str, dict[str, Any]] = {}
    for name in names:
        for measured in (starts, loops):
            result = measure(measured, name, options.quick)
            if "error" in result:
                raise SystemExit(result["error"])
            for label, figures in result["rows"].items():
                row = rows.setdefault(label, {"measurement": label})
                row |= {f"{name}, {key}": value for key, value in figures.items()}
    report("warm_start", list(rows.values()))


if __name__ == "__main__":
    main()
