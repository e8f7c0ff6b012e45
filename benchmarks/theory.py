"""Write the tables and the figure of docs/theory.md: every check of every system.

python -m benchmarks.theory [SCENARIO ...]
runs the checks of the named systems, by default of all, and writes the page from all results known.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import opfmodel as om
from benchmarks.harness import RESULTS, splice
from opfmodel.analysis.analyze import CHECKS
from opfmodel.analysis.figure import turnpike_figure
from opfmodel.analysis.finding import Finding, Verdict
from opfmodel.results.store import write_record

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "theory.md"
FIGURE = ROOT / "docs" / "figures" / "turnpike.png"
SYSTEMS = ("case5-step", "case5-random", "case118-step", "case118-random", "case33bw")

Checks = dict[str, dict[str, Any]]


def measure(system: str) -> None:
    """Run all checks of a system and keep what they find, with the seconds that each takes."""
    scenario = om.load_scenario(ROOT / "scenarios" / f"{system}.yaml")
    checks: Checks = {}
    for name in CHECKS:
        began = time.perf_counter()
        found = om.analyze(scenario, [name]).checks[name]
        checks[name] = {**found.as_dict(), "seconds": time.perf_counter() - began}
        print(f"{system}: {name}: {found.verdict}: {found.explanation}", flush=True)
        write_record(checks, RESULTS / "theory" / f"{system}.json")


def known() -> dict[str, Checks]:
    """The results of the systems that have been run."""
    files = {system: RESULTS / "theory" / f"{system}.json" for system in SYSTEMS}
    return {s: json.loads(file.read_text(encoding="utf-8")) for s, file in files.items() if file.exists()}


def table(head: str, rows: Iterable[Iterable[str]]) -> str:
    """A table in Markdown whose first two columns are text."""
    rule = "| --- | --- |" + " ---: |" * (head.count("|") - 3)
    return "\n".join([head, rule, *(f"| {' | '.join(row)} |" for row in rows)])


def _verdicts(results: dict[str, Checks]) -> str:
    head = f"| system | {' | '.join(name.replace('_', ' ') for name in CHECKS)} | seconds |"
    rows = []
    for system, checks in results.items():
        words = [checks[name]["verdict"] if name in checks else "" for name in CHECKS]
        rows.append([system, *words, f"{sum(check['seconds'] for check in checks.values()):.0f}"])
    rule = "| --- |" + " --- |" * len(CHECKS) + " ---: |"
    return "\n".join([head, rule, *(f"| {' | '.join(row)} |" for row in rows)])


def _steady_state(results: dict[str, Checks]) -> str:
    head = (
        "| system | verdict | cost, $/h | binding limits | pieces of the path | longest, share of the path |"
    )
    rows = []
    for system, found in _of(results, "steady_state"):
        path = found["path"]
        share = path["longest_piece"] / path["length"] if path["length"] else 0.0
        cells = [f"{found['cost']:,.2f}", str(len(found["active"])), str(path["pieces"]), f"{share:.3f}"]
        rows.append([system, found["verdict"], *cells])
    return table(head, rows)


def _dissipativity(results: dict[str, Checks]) -> str:
    head = (
        "| system | verdict | smallest eigenvalue of Q | alpha | certified | lower, $/h | upper, $/h "
        "| least along a loop, $/h |"
    )
    rows = []
    for system, found in _of(results, "dissipativity"):
        numbers = ("curvature", "alpha", "alpha_certified", "lower", "upper")
        cells = [_shown(found[key]) for key in numbers]
        rows.append([system, found["verdict"], *cells, _shown(found["along_closed_loop"]["least"])])
    return table(head, rows)


def _turnpike(results: dict[str, Checks]) -> str:
    head = "| system | verdict | epsilon, p.u. | estimated arc, steps | horizons | steps outside |"
    rows = []
    for system, found in _of(results, "turnpike"):
        swept = [", ".join(map(str, found[key])) for key in ("horizons", "outside")]
        rows.append(
            [
                system,
                found["verdict"],
                f"{found['epsilon']:.3g}",
                f"{found['expected_arc'] or math.inf:.0f}",
                *swept,
            ]
        )
    return table(head, rows)


def _practical_stability(results: dict[str, Checks]) -> str:
    head = "| system | verdict | tolerance, p.u. | horizons | distance at the end, p.u. | smallest horizon |"
    rows = []
    for system, found in _of(results, "practical_stability"):
        ends = [", ".join(map(str, found["horizons"])), ", ".join(f"{d:.3g}" for d in found["distance"])]
        smallest = "none" if found["smallest_horizon"] is None else str(found["smallest_horizon"])
        rows.append([system, found["verdict"], f"{found['tolerance']:.3g}", *ends, smallest])
    return table(head, rows)


def _recursive_feasibility(results: dict[str, Checks]) -> str:
    head = (
        "| system | verdict | least multiple of the change | least increase, MW | least decrease, MW "
        "| weakest bus | its margin, MW |"
    )
    rows = []
    for system, found in _of(results, "recursive_feasibility"):
        least = [found[f"least_{side}"] for side in ("change", "up", "down")]
        cells = ["" if each is None else f"{_rounded(each['value'])} (step {each['step']})" for each in least]
        buses = {name: margin for name, margin in found["buses"]["up_mw"].items() if margin is not None}
        weakest = min(buses, key=lambda name: buses[name])
        rows.append([system, found["verdict"], *cells, weakest, _rounded(buses[weakest])])
    return table(head, rows)


def _performance_bound(results: dict[str, Checks]) -> str:
    variants = ("as it is", "without ramps", "without storage", "without ramps and storage")
    head = f"| system | verdict | bound, $ | {' | '.join(f'V_N {name}' for name in variants)} | ramps bind |"
    rows = []
    for system, found in _of(results, "performance_bound"):
        values = [found["variants"][name] for name in variants]
        cells = ["" if value is None else f"{value / found['bound'] - 1:+.4%}" for value in values]
        ramps = str(len(found["binding_ramps"]))
        rows.append([system, found["verdict"], f"{found['bound']:,.2f}", *cells, ramps])
    return table(head, rows)


def _of(results: dict[str, Checks], name: str) -> Iterable[tuple[str, dict[str, Any]]]:
    return ((system, checks[name]) for system, checks in results.items() if name in checks)


def _rounded(value: float) -> str:
    return f"{round(value, 3) + 0.0:.4g}"


def _shown(value: float | None) -> str:
    return "none" if value is None else f"{value:.4g}"


TABLES = {
    "verdicts": _verdicts,
    "steady state": _steady_state,
    "dissipativity": _dissipativity,
    "turnpike": _turnpike,
    "practical stability": _practical_stability,
    "recursive feasibility": _recursive_feasibility,
    "performance bound": _performance_bound,
}


def draw(results: dict[str, Checks]) -> None:
    """Draw the turnpike of the first system."""
    system, found = next(iter(_of(results, "turnpike")))
    finding = Finding(Verdict(found["verdict"]), "", "", found["tolerance"], found)
    turnpike_figure(finding, system).savefig(FIGURE, dpi=120)


def main() -> None:
    """Run the checks and write the page."""
    for system in sys.argv[1:] or SYSTEMS:
        measure(system)
    results = known()
    for name, make in TABLES.items():
        splice(PAGE, name, make(results))
    draw(results)
    print(f"{PAGE} written")


if __name__ == "__main__":
    main()
