"""Profile of a receding-horizon step: functions, linear algebra, Python.

python -m benchmarks.profile
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from benchmarks.harness import arguments, measure, median, report, timed
from benchmarks.systems import case118

FUNCTIONS = ("nlp_f", "nlp_g", "nlp_grad_f", "nlp_jac_g", "nlp_hess_l")


def profiled(horizon: int, situation: str) -> dict[str, Any]:
    """Shares of one cold or warm solve of IEEE 118 with storage at every bus."""
    import opfmodel as om

    network, series = case118(horizon + 1)
    problem = om.MultiStage(network, horizon, objective=om.Economic(1e-3, 1e-3), profiles=series)
    problem.compile()
    plan = problem.solve()
    state = plan.next_state()
    session: Any = problem.session
    options = session._plugin_options(situation) | {"record_time": True}
    solver = ca.nlpsol(
        "solver",
        "ipopt",
        session._assembly.oracle,
        {
            "grad_f": session._assembly.gradient,
            "jac_g": session._assembly.jacobian,
            "hess_lag": session._assembly.hessian,
        }
        | options,
    )
    session._current = situation, solver
    warm = situation == "moved"
    step_s, solved = timed(lambda: problem.solve(1, state, plan) if warm else problem.solve())
    stats = solver.stats()
    functions = {name.removeprefix("nlp_"): stats[f"t_wall_{name}"] for name in FUNCTIONS}
    solver_s = solved.solution.seconds
    return {
        "iterations": solved.solution.iterations,
        "step_s": step_s,
        **{f"{name}_percent": 100 * seconds / step_s for name, seconds in functions.items()},
        "linear_algebra_percent": 100 * (solver_s - sum(functions.values())) / step_s,
        "python_percent": 100 * (step_s - solver_s) / step_s,
    }


def main() -> None:
    """Measure and report."""
    options = arguments(__doc__ or "")
    horizon = 6 if options.quick else 48
    rows = [
        {
            "measurement": f"118 x {horizon}, {name}",
            **median([measure(profiled, horizon, situation) for _ in range(options.repeat)]),
        }
        for name, situation in (("cold", "cold"), ("warm", "moved"))
    ]
    report("profile", rows)


if __name__ == "__main__":
    main()
