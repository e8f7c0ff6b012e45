"""Write the table and the figure of docs/security.md from the loops of scenarios/case5-outage.yaml.

python -m benchmarks.outage
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import opfmodel as om
from benchmarks.harness import splice
from opfmodel.check import check

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "security.md"
SCENARIO = ROOT / "scenarios" / "case5-outage.yaml"
BRANCH, RATING = "4-5", 240.0
LOOPS = {"not secured": {}, "secured": {"variant": "secured"}, "told at once": {"variant": "told"}}
COLOURS = {"not secured": "#D55E00", "secured": "#0072B2"}
HEAD = (
    "| loop | cost, $ | stored at the end, MWh | largest flow on 4-5, MVA | above the rating, MVA "
    "| shed, MWh | moved, MWh | iterations of a plan | seconds |"
)


def loading(run: om.Run) -> np.ndarray:
    """Apparent power on the branch that is loaded most, MVA, at its worse end."""
    flows = run.data.sel(branch=BRANCH)
    return np.maximum(np.hypot(flows["pf"], flows["qf"]), np.hypot(flows["pt"], flows["qt"])).values


def line(name: str, run: om.Run) -> str:
    """The figures of a loop."""
    summary = run.summary()
    cells = [
        f"{run.cost:,.0f}",
        f"{summary['stored_mwh']:.0f}",
        f"{loading(run).max():.1f}",
        f"{summary['largest_flow_excess']:.1f}",
        f"{summary['shed_mwh']:.1f}",
        f"{summary['redispatched_mwh']:.1f}",
        f"{summary['iterations_mean']:.0f}",
        f"{summary['solve_seconds_mean']:.2f}",
    ]
    return f"| {name} | {' | '.join(cells)} |"


def drawn(runs: dict[str, om.Run]) -> Figure:
    """Loading of the branch and unserved demand in the loops."""
    figure = Figure(figsize=(7.2, 4.2), layout="constrained")
    flow, shed = figure.subplots(2, 1, sharex=True)
    for name, colour in COLOURS.items():
        data = runs[name].data
        hours = np.append(data["time"].values, data["time"].values[-1] + 1)
        unserved = data["p_unserved"].sum("load").values + data["p_shortage"].sum("bus").values
        for axis, values in ((flow, 100 * loading(runs[name]) / RATING), (shed, np.maximum(unserved, 0.0))):
            style = "-" if name == "secured" else "--"
            axis.step(
                hours, np.append(values, values[-1]), where="post", label=name, color=colour, linestyle=style
            )
    status, known = data["branch_status"].sel(branch="1-4").values, data["outages_known"].values
    limit = np.where(known > 0, 100.0, 100.0 * data.attrs["outage_rating"])
    flow.step(hours, np.append(limit, limit[-1]), where="post", color="k", linewidth=0.8, label="limit")
    for hour in np.flatnonzero(status == 0):
        for axis in (flow, shed):
            axis.axvspan(hour, hour + 1, color="0.5", alpha=0.15 if known[hour] else 0.35, linewidth=0)
    flow.set_ylabel(f"loading of {BRANCH} [%]")
    shed.set_ylabel("unserved demand [MW]")
    shed.set_xlabel("time [h]")
    flow.legend(loc="upper left", ncols=3, fontsize="small")
    flow.set_title("outage of 1-4 from hour 12 to 15; dark: the controller does not know", fontsize="medium")
    for axis in (flow, shed):
        axis.grid(alpha=0.3, linewidth=0.5)
    return figure


def main() -> None:
    """Run the loops; write table and figure."""
    runs = {name: om.load_scenario(SCENARIO, **options).simulate() for name, options in LOOPS.items()}
    for name, run in runs.items():
        worst = check(run.problem.network, run.data, run.problem.profiles).worst
        print(f"{name}: {run.status}, worst violation: {worst.family} {worst}")
    rule = "| --- |" + " ---: |" * (HEAD.count("|") - 2)
    splice(PAGE, "loops with an outage", "\n".join([HEAD, rule, *(line(n, r) for n, r in runs.items())]))
    drawn(runs).savefig(ROOT / "docs" / "figures" / "outage.png", dpi=120)


if __name__ == "__main__":
    main()
