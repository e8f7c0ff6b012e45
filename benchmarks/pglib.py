"""Optima of opfmodel compared with those of PGLib, for every case in tests/data/pglib.

python -m benchmarks.pglib writes docs/pglib.md.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from datetime import date
from importlib.metadata import version
from pathlib import Path

import numpy as np

import opfmodel as om

ROOT = Path(__file__).parent.parent
CASES = ROOT / "tests" / "data" / "pglib"
PAGE = ROOT / "docs" / "pglib.md"


@dataclass(frozen=True)
class Result:
    """One case: the published values and the plans of opfmodel."""

    case: str
    published: dict[str, str]
    ac: om.Plan
    rectangular: om.Plan
    dc: om.Plan
    soc: om.Plan

    @property
    def ac_difference(self) -> float:
        """Relative difference of the AC optimum."""
        return self.ac.objective / float(self.published["ac_usd_per_h"]) - 1

    @property
    def rectangular_difference(self) -> float:
        """Relative difference of the AC optimum found in rectangular coordinates."""
        return self.rectangular.objective / float(self.published["ac_usd_per_h"]) - 1

    @property
    def dc_difference(self) -> float | None:
        """Relative difference of the DC optimum; None if PGLib reports infeasibility."""
        dc = self.published["dc_usd_per_h"]
        return None if dc == "inf." else self.dc.objective / float(dc) - 1

    @property
    def soc_gap(self) -> float:
        """Gap of the SOC relaxation to the AC optimum of opfmodel, percent."""
        return 100 * self.soc.relaxation_gap(self.ac)

    @property
    def soc_difference(self) -> float:
        """Difference of the gaps in percentage points."""
        return self.soc_gap - float(self.published["soc_gap_percent"])


def solve(case: str, published: dict[str, str]) -> Result:
    """Solve one case in all formulations that PGLib has columns for."""
    network = om.read_network(CASES / f"{case}.m")
    plans = {
        name: om.MultiStage(network, formulation=name).solve()
        for name in ("ac", "ac-rectangular", "dc", "soc")
    }
    return Result(case, published, plans["ac"], plans["ac-rectangular"], plans["dc"], plans["soc"])


def page(results: list[Result]) -> str:
    """The page in Markdown."""
    packages = ("opfmodel", "casadi", "qpsolvers", "clarabel", "cvxpy")
    versions = ", ".join(f"{name} {version(name)}" for name in packages)
    lines = [
        "# PGLib",
        "",
        "Optima of opfmodel compared with those published for the IEEE PES Power Grid Library",
        "(`tests/data/pglib/baseline.csv`), in $/h. Published costs have five significant digits, so",
        "relative differences of up to 5e-5 are rounding. PGLib marks infeasible DC problems with `inf.`.",
        "`make pglib` writes this page; `tests/test_pglib.py` tests the optima.",
        "",
        "| case | AC, PGLib | `ac` | `ac-rectangular` | DC, PGLib | `dc` | SOC gap, PGLib | `soc` gap |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
        *(_row(result) for result in results),
        _largest(results),
        "",
        "Status of the plans, by formulation (solver):",
        "",
        *_statuses(results),
        "",
        f"{date.today():%Y-%m-%d}; {versions}.",
        "",
    ]
    return "\n".join(lines)


def _row(r: Result) -> str:
    dc = f"{r.dc.objective:,.2f}" if r.dc.optimal else r.dc.status.replace("_", " ")
    cells = [
        r.case.removeprefix("pglib_opf_"),
        _published(r.published["ac_usd_per_h"]),
        f"{r.ac.objective:,.2f}",
        f"{r.rectangular.objective:,.2f}",
        _published(r.published["dc_usd_per_h"]),
        dc,
        f"{r.published['soc_gap_percent']} %",
        f"{r.soc_gap:.3f} %",
    ]
    return f"| {' | '.join(cells)} |"


def _published(text: str) -> str:
    """Format a published cost with its number of digits."""
    if text == "inf.":
        return text
    decimals = 4 - int(np.floor(np.log10(float(text))))
    return f"{float(text):,.{max(0, decimals)}f}"


def _largest(results: list[Result]) -> str:
    def largest(name: str) -> float:
        values = (getattr(result, name) for result in results)
        return max(abs(value) for value in values if value is not None)

    ac, rectangular, dc = (largest(f"{name}_difference") for name in ("ac", "rectangular", "dc"))
    soc = largest("soc_difference")
    return f"| **largest difference** | | {ac:.1e} | {rectangular:.1e} | | {dc:.1e} | | {soc:.3f} points |"


def _statuses(results: list[Result]) -> list[str]:
    lines = []
    for name, attribute in (("ac", "ac"), ("ac-rectangular", "rectangular"), ("dc", "dc"), ("soc", "soc")):
        plans = [getattr(result, attribute) for result in results]
        solvers = sorted({plan.solution.solver for plan in plans})
        counts = {status: sum(p.status == status for p in plans) for status in {p.status for p in plans}}
        counted = ", ".join(f"{count} {status.replace('_', ' ')}" for status, count in sorted(counts.items()))
        lines.append(f"- `{name}` ({', '.join(solvers)}): {counted}")
    return lines


def main() -> None:
    """Solve all cases and write the page."""
    with (CASES / "baseline.csv").open(encoding="utf-8") as stream:
        results = [solve(row["case"], row) for row in csv.DictReader(stream)]
    text = page(results)
    PAGE.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
