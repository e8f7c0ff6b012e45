"""Write the table and the figure of docs/uncertainty.md from scenarios/studies/uncertainty.yaml.

opfmodel study run scenarios/studies/uncertainty.yaml --out DIR --workers 2
python -m benchmarks.uncertainty DIR
"""

from __future__ import annotations

import sys
from collections import defaultdict
from pathlib import Path
from statistics import mean, stdev
from typing import Any

import opfmodel as om
from benchmarks.harness import splice
from opfmodel.results import figures
from opfmodel.study import read_study, read_table

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "uncertainty.md"
STUDY = ROOT / "scenarios" / "studies" / "uncertainty.yaml"

Row = dict[str, Any]
HEAD = (
    "| system | error | plans for | cost, $ | stored, MWh | cost, energy valued, $ | saving, $ | moved, MWh "
    "| shed, MWh | steps with a violation | elastic plans | iterations | seconds |"
)


def scenario(**labels: str) -> om.Scenario:
    """The first scenario of the study with these labels."""
    variations = read_study(STUDY).variations()
    chosen = next(v for v in variations if labels.items() <= v.labels.items())
    return om.load_scenario(chosen.scenario, overrides=chosen.overrides)


def fan() -> om.Plan:
    """The first plan of the 5-bus system for nine scenarios, with a forecast error of 6 %."""
    loaded = scenario(**{"system": "case5-step", "forecast-error": "6 %", "controller": "tree-9"})
    planner = om.Controller(loaded.problem, loaded.forecast, scenarios=loaded.scenarios)
    return planner.plan(0, loaded.initial())


def perfect(system: str) -> tuple[Row, float]:
    """The summary of the loop of a system whose forecast is perfect, and the price of energy at its end."""
    loaded = scenario(system=system, controller="forecast")
    controller = om.Controller(loaded.problem)
    run = om.simulate(
        controller, loaded.plant(), loaded.steps, initial=loaded.initial(), objective=loaded.cost
    )
    return run.summary(), float(run.data["lmp"].isel(time=-1).mean())


def lines(rows: list[Row]) -> list[str]:
    """One line per system, error and controller: means over the seeds, savings with their deviation.

    A saving is that against the plan for the forecast alone, under the same errors; energy that a loop
    leaves in storage counts at the price at the end of the loop whose forecast is perfect.
    """
    groups: dict[tuple[str, str], dict[str, dict[int, Row]]] = defaultdict(lambda: defaultdict(dict))
    for row in rows:
        if row["status"] == "done":
            by_controller = groups[row["system"], row["forecast-error"]]
            by_controller[row["controller"]][row["forecast.noisy.seed"]] = row
    made = []
    for system in dict.fromkeys(system for system, _ in groups):
        best, price = perfect(system)
        made.append(_line(system, "none", "what happens", [best], price, best["stored_mwh"]))
        for (_, error), controllers in ((key, c) for key, c in groups.items() if key[0] == system):
            for name, runs in controllers.items():
                alone = [controllers["forecast"][seed] for seed in runs]
                made.append(_line(system, error, name, list(runs.values()), price, best["stored_mwh"], alone))
    return made


def _line(
    system: str, error: str, name: str, runs: list[Row], price: float, stored: float, alone: list[Row] = ()
) -> str:
    def valued(run: Row) -> float:
        return float(run["cost"] - price * (run["stored_mwh"] - stored))

    savings = [valued(one) - valued(run) for one, run in zip(alone, runs, strict=True)] if alone else []
    saving = "" if not savings or name == "forecast" else f"{mean(savings):,.0f}"
    if saving and len(savings) > 1:
        saving += f" ± {stdev(savings):,.0f}"
    cells = [
        f"{mean(run['cost'] for run in runs):,.0f}",
        f"{mean(run['stored_mwh'] for run in runs):,.0f}",
        f"{mean(map(valued, runs)):,.0f}",
        saving,
        f"{mean(run['redispatched_mwh'] for run in runs):,.0f}",
        f"{mean(run['shed_mwh'] for run in runs):,.2f}",
        f"{mean(run['violated_steps'] for run in runs):.1f}",
        f"{mean(run['elastic_steps'] for run in runs):.1f}",
        f"{mean(run['iterations_mean'] for run in runs):.0f}",
        f"{mean(run.get('time_solve_seconds_mean', run.get('solve_seconds_mean')) for run in runs):.2f}",
    ]
    return f"| {system} | {error} | {name} | {' | '.join(cells)} |"


def main() -> None:
    """Write the table."""
    rows = read_table(sys.argv[1])
    rule = "| --- | --- | --- |" + " ---: |" * (HEAD.count("|") - 4)
    splice(PAGE, "value of scenarios", "\n".join([HEAD, rule, *lines(rows)]))
    picture = figures.system(fan().data)
    picture.savefig(ROOT / "docs" / "figures" / "uncertainty.png", dpi=120)
    left = [row for row in rows if row["status"] != "done"]
    print(f"{PAGE} written; {len(rows) - len(left)} of {len(rows)} closed loops done")


if __name__ == "__main__":
    main()
