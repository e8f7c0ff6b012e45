"""docs/benchmarks.md from the figures that the benchmarks wrote to ``benchmarks/results``.

python -m benchmarks.page
"""

from __future__ import annotations

import json
from datetime import date
from pathlib import Path
from typing import Any

from benchmarks.harness import RESULTS, format_cell

PAGE = Path(__file__).parent.parent / "docs" / "benchmarks.md"

HEAD = """# Benchmarks

What counts is the ratio within one run: machines are shared and noisy. Every measurement is a process of
its own; where it is repeated the median is shown, and what is compared is measured in turn. `make bench`
installs what is compared with, runs everything and writes this page; the raw figures, with the machine and
all versions, are in `benchmarks/results/`. Each benchmark also runs alone, as stated, and takes `--repeat N`
and `--quick`.

The plain recipe (`benchmarks/plain.py`) is what one writes by following CasADi's examples: one MX expression
over all stages on the same arrays, default options of CasADi and IPOPT. It states the problem as it is; the
small weight on storage power that opfmodel adds to make the problem well posed is a setting of opfmodel's
solver.
"""

SECTIONS: dict[str, tuple[str, str]] = {
    "compile": (
        "Compiling and solving cold",
        """IEEE 118 with storage at every bus and 48 stages, from the declared network to a solver that is
ready to start, and its first solve; a single stage of PGLib's 9,241-bus case; the plain recipe,
without and with opfmodel's weight; and a Pyomo model, written to an NL file that CasADi reads,
so that the same build of IPOPT solves it. (A solver with AMPL's library would differentiate the
file faster than CasADi's reader does.)""",
    ),
    "receding": (
        "Receding horizon",
        """Five steps after the first, each started from the one before; the plain recipe starts from its
last primal values. Then the closed loops of the paper's systems, 49 steps with a horizon of 48.
Overhead is what a step takes beside the solver: Python, numbers of the next problem, reading
results.""",
    ),
    "growth": (
        "Growth",
        """With the horizon (IEEE 118, storage at every bus; a step is the mean of two warm ones) and with
the size of the network (one stage of PGLib's cases; 1,354 buses over a day with 20 storages).""",
    ),
    "peers": (
        "Single-stage AC-OPF beside pandapower and PYPOWER",
        """The same PGLib data through MATPOWER's arrays; from data in memory to the optimum, imports
excluded. pandapower limits currents, not apparent power, and so solves a slightly different
problem; where a row has no figure the tool did not converge.""",
    ),
    "warm_start": (
        "Warm starts",
        "Ways to start the next problem; [warm-start.md](warm-start.md) says what follows.",
    ),
    "profile": (
        "Where the time goes",
        "One cold and one warm solve of IEEE 118 × 48, in percent of the time a user waits.",
    ),
    "backends": (
        "Back ends",
        """DC with storage at every bus, first problem and the next one; SOC of one stage; PyPSA's linear
optimal power flow and ours on the same DC data with linear costs. [backends.md](backends.md)
says what follows for the choice of a back end.""",
    ),
    "study": ("Studies", "24 closed loops of 49 steps of the 5-bus system, on one worker and on two."),
}


TAIL = """## What is not reached, and the next lever

- **Compiling** IEEE 118 × 48 and 9,241 × 1 within 0.6 and 1.5 s is reached on a quiet machine (see
  Growth) and was missed in the run above, when the machine was not quite idle.
- **Memory** of one compiled and solved problem is well below 400 MB; whole closed loops of the 118-bus
  systems need some 480 MB, with their results and the problem of the single-stage optima.
- **Growth of a cold solve with the horizon** is steeper than the goal of 1.3: from 6 to 96 stages the
  iterations grow from 16 to 26 and the time of one with an exponent of 1.25. Warm steps, which a closed
  loop consists of, grow in proportion to the horizon. The lever is the starting point of the first
  problem.
- **Compiling is more than a tenth of a cold solve** below some 3,000 buses: 0.07 to 0.2 s go into
  making functions and a solver, whatever the size. The lever is to keep compiled templates between
  problems.
- **Nine tenths of a step are linear algebra** in MUMPS with the small generic BLAS of CasADi's wheel.
  Functions and their derivatives take a tenth, Python next to nothing. The lever is the factorisation:
  another linear solver (`linear_solver` reaches IPOPT unchanged), or one that knows the stages.
- Realised costs of a few steps differ by 1e-5 between opfmodel and the plain recipe, because the
  optimum is flat in when storage is used; the objectives of plans from the same state agree to 1e-7.
"""


def section(name: str, title: str, text: str) -> str:
    """One benchmark: what it measures, its table, and how its goals were met."""
    path = RESULTS / f"{name}.json"
    lines = [f"## {title}", "", text, "", f"`python -m benchmarks.{name}`", ""]
    if not path.exists():
        return "\n".join([*lines, "Not measured yet.", ""])
    content = json.loads(path.read_text(encoding="utf-8"))
    rows: list[dict[str, Any]] = content["rows"]
    columns = list(dict.fromkeys(key for row in rows for key in row))
    lines += [_line(["", *(_heading(column) for column in columns[1:])])]
    lines += [_line(["---", *("---:" for _ in columns[1:])])]
    lines += [_line([format_cell(row.get(column)) for column in columns]) for row in rows]
    if content["goals"]:
        lines += ["", _line(["ratio or goal", "reached"]), _line(["---", "---:"])]
        lines += [_line([goal, format_cell(value)]) for goal, value in content["goals"].items()]
    return "\n".join([*lines, "", f"{content['date']}; {_machine(content['machine'])}.", ""])


def _line(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _heading(column: str) -> str:
    unit = {"s": "s", "mb": "MB", "percent": "%"}.get(column.rpartition("_")[2])
    return (
        column.replace("_", " ")
        if unit is None
        else f"{column.rpartition('_')[0].replace('_', ' ')} [{unit}]"
    )


def _machine(machine: dict[str, Any]) -> str:
    versions = ", ".join(f"{name} {number}" for name, number in machine["versions"].items())
    return f"{machine['processor']}, {machine['cores']} cores; Python {machine['python']}, {versions}"


def main() -> None:
    """Write the page."""
    sections = [section(name, title, text) for name, (title, text) in SECTIONS.items()]
    PAGE.write_text("\n".join([HEAD, *sections, TAIL]), encoding="utf-8")
    print(f"{PAGE} written, {date.today():%Y-%m-%d}")


if __name__ == "__main__":
    main()
