"""First problem of ``case5-step`` in every formulation, for the table in docs/backends.md.

python -m benchmarks.formulations
"""

from __future__ import annotations

from pathlib import Path

import opfmodel as om

SCENARIO = Path(__file__).parent.parent / "scenarios" / "case5-step.yaml"
FORMULATIONS = ("ac", "ac-rectangular", "soc", "dc-losses", "dc", "dc-matpower", "copperplate")


def solve(formulation: str) -> om.Plan:
    """First plan, from the same initial dispatch for every formulation."""
    scenario = om.load_scenario(SCENARIO, overrides={"controller.formulation": formulation})
    return scenario.problem.solve(initial=scenario.initial())


def table() -> str:
    """The table in Markdown."""
    plans = {name: solve(name) for name in FORMULATIONS}
    lines = [
        "| formulation | solver | status | objective [$] | iterations | gap to `ac` "
        "| cone slack [p.u.] | angle mismatch [deg] |",
        "| --- | --- | --- | ---: | ---: | ---: | ---: | ---: |",
    ]
    for name, plan in plans.items():
        facts = plan.relaxation
        gap = 100 * plan.relaxation_gap(plans["ac"])
        cells = [
            f"`{name}`",
            plan.solution.solver,
            plan.status.replace("_", " "),
            f"{plan.objective:,.1f}",
            str(plan.solution.iterations),
            f"{gap + 0.0:.2f} %".replace("-0.00", "0.00"),
            f"{facts['largest_cone_slack']:.0e}" if facts else "",
            f"{facts['largest_angle_mismatch']:.2f}" if facts else "",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    print(table())
