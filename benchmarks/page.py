"""Write docs/benchmarks.md from the results in ``benchmarks/results``; other sections stay as they are.

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

Machines are shared and noisy, so only ratios within one run are meaningful. Each measurement runs in its
own process. Repeated measurements show the median, and tools that are compared run in turn. `make bench`
installs the other tools, runs all benchmarks and writes this page. The raw results, with the machine and all
package versions, are in `benchmarks/results/`. You can also run each benchmark alone with the command shown;
all of them accept `--repeat N` and `--quick`.

The baseline, plain CasADi (`benchmarks/plain.py`), follows CasADi's examples: one MX expression over all
stages on the same arrays, with the default options of CasADi and IPOPT. It omits the small weight on storage
power that opfmodel adds to make the problem well posed.
"""

SECTIONS: dict[str, tuple[str, str]] = {
    "compile": (
        "Compilation and cold solve",
        """IEEE 118 with storage at every bus and 48 stages: the time from the declared network to a solver
that is ready to start, and the first solve. The other rows are a single stage of PGLib's 9,241-bus
case, plain CasADi without and with opfmodel's weight, and a Pyomo model. CasADi reads the Pyomo
model from an NL file, so the same build of IPOPT solves it. (A solver linked with AMPL's library
would differentiate the file faster than CasADi's reader does.)""",
    ),
    "receding": (
        "Receding horizon",
        """Five steps after the first, each started from the previous one; plain CasADi starts from its
last primal values. The remaining rows are the closed loops of the paper's systems: 49 steps with
a horizon of 48, of which the means are those of the 48 warm steps. Overhead is the part of a step
spent outside the solver: Python code, updating instance data and reading results.""",
    ),
    "growth": (
        "Growth",
        """Growth with the horizon (IEEE 118, storage at every bus; a step is the mean of two warm steps)
and with the size of the network (single stages of PGLib cases, and three of them over a day with 20
storage units), memory of a problem alone, and a command from its start to its end.""",
    ),
    "windows": (
        "Windows",
        """IEEE 118 with storage at every bus: a plan of four weeks as a whole and by overlapping windows of a
week, on one worker and on more. `excess` is the relative difference from the whole plan, `gap` its bound;
the memory of workers is not in `peak`. [scale.md](scale.md) has a plan of a year.""",
    ),
    "tree": (
        "Trees of scenarios",
        """IEEE 118 with storage at every bus and 1, 3, 5 and 9 scenarios of 24 stages that share two: cold
from the plan for the expected future (the default) and from the midpoint of the bounds, and warm steps
of a closed loop.
[uncertainty.md](uncertainty.md) has results.""",
    ),
    "security": (
        "Security",
        """The outage of every branch that does not split the grid, after every stage: compile and solve,
screening included, and the same problem without security. `violated` is what the plan without security
does not survive, `testing` the time that testing plans took.
[security.md](security.md#what-it-costs) has what security costs.""",
    ),
    "peers": (
        "Single-stage AC-OPF compared with pandapower and PYPOWER",
        """The same PGLib data, passed as MATPOWER arrays. Times run from data in memory to the optimum and
exclude imports. pandapower limits currents instead of apparent power and therefore solves a
slightly different problem. Rows without figures did not converge.""",
    ),
    "warm_start": (
        "Warm starts",
        "Ways to start the next problem; [warm-start.md](warm-start.md) discusses the results.",
    ),
    "profile": (
        "Where the time goes",
        "One cold and one warm solve of IEEE 118 × 48, in percent of the total time of a step.",
    ),
    "backends": (
        "Back ends",
        """DC with storage at every bus, the first problem and the next one; single-stage SOC; and PyPSA's
linear optimal power flow and opfmodel's on the same DC data with linear costs.
[backends.md](backends.md) explains how to choose a back end.""",
    ),
    "study": ("Studies", "24 closed loops of the 5-bus system, 49 steps each, on one worker and on two."),
}


TAIL = """## Missed goals and possible improvements

- **The machine** of the sections dated December 2026 takes 2.2 to 2.5 times as long as the other for the
  same solve. Goals in seconds are for the faster one; there `opfmodel solve` of 14 and of 2,000 buses would
  take 0.5 and 2.4 s, if all of it shortens alike.
- **Memory**: a closed loop takes 2.2 MB per stage of 118 buses with storage, half of what it took; complete
  loops of the 118-bus systems need 380 MB.
- **The time of a cold solve** grows with the horizon by an exponent above the goal of 1.3: from 6 to 96
  stages the iterations increase from 16 to 26 and the time per iteration grows with an exponent of 1.25.
  Warm steps, which make up a closed loop, grow in proportion to the horizon. A better starting point for
  the first problem would help.
- **9,241 buses over a day** with 20 storage units had no plan after 2,500 s. An iteration takes 14 s there,
  and after 20 of them the infeasibility has fallen from 126 to 2: steps are short, a tenth and less.
- **Compilation takes more than a tenth of a cold solve** below about 3,000 buses: creating the functions
  and the solver takes 0.05 to 0.3 s, whatever the size. Reusing compiled templates between problems would
  help.
- **Linear algebra takes nine tenths of a step**, in MUMPS with the small generic BLAS of CasADi's wheel.
  Functions and derivatives take a tenth, Python next to nothing. A faster factorisation would help: another
  linear solver (`linear_solver` is passed to IPOPT unchanged), or one that exploits the stage structure.
- **Security** over a day of 118 buses takes 8 times as long as without, but 24 times with the ratings of
  PGLib (goal: 10): nine tenths of it are the problems of the outages that no common response survives, at
  a tenth of a second each. Solving them side by side would help.
- Realised costs over a few steps differ by 1e-5 between opfmodel and plain CasADi because the optimum is
  flat in the timing of storage use. Objectives of plans from the same state agree to 1e-7.
"""


def section(name: str, title: str, text: str) -> str:
    """One benchmark: its description, its table, and its ratios and goals."""
    path = RESULTS / f"{name}.json"
    lines = [f"## {title}", "", text, "", f"`python -m benchmarks.{name}`", ""]
    if not path.exists():
        command = lines[-2]
        _, _, measured = PAGE.read_text(encoding="utf-8").partition(f"\n{command}\n\n")
        measured = measured.partition("\n## ")[0] or "Not measured yet.\n"
        return "\n".join([*lines, measured])
    content = json.loads(path.read_text(encoding="utf-8"))
    rows: list[dict[str, Any]] = content["rows"]
    columns = list(dict.fromkeys(key for row in rows for key in row))
    lines += [_line(["", *(_heading(column) for column in columns[1:])])]
    lines += [_line(["---", *("---:" for _ in columns[1:])])]
    lines += [_line([format_cell(row.get(column)) for column in columns]) for row in rows]
    if content["goals"]:
        lines += ["", _line(["ratio or goal", "measured"]), _line(["---", "---:"])]
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
