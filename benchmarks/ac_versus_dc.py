"""Write docs/ac-versus-dc.md from the results of scenarios/studies/ac-versus-dc.yaml.

opfmodel study run scenarios/studies/ac-versus-dc.yaml --out DIR --workers 2
python -m benchmarks.ac_versus_dc DIR
"""

from __future__ import annotations

import sys
from datetime import date
from pathlib import Path
from typing import Any

from opfmodel.study import read_table

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "ac-versus-dc.md"
TEXT = Path(__file__).parent / "ac_versus_dc.md"  # template of the page: conclusions and tables

POWER_FLOW = {
    "cost": "cost k$",
    "redispatched_mwh": "balancing MWh",
    "largest_flow_excess": "flow MVA",
    "largest_vm_excess": "voltage p.u.",
    "largest_qg_excess": "reactive MVAr",
    "violated_steps": "steps",
}
REDISPATCH = {
    "cost": "cost k$",
    "redispatched_mwh": "moved MWh",
    "shed_mwh": "shed MWh",
    "elastic_steps": "elastic plans",
}


def tables(rows: list[dict[str, Any]]) -> str:
    """One table per system and objective: a row per formulation, columns for both plants."""
    known = {
        (r["system"], r["controller"], r["controller.formulation"], r["plant.mode"]): r
        for r in rows
        if r["status"] == "done"
    }
    systems, objectives, formulations = (
        list(dict.fromkeys(key[position] for key in known)) for position in range(3)
    )
    parts = []
    for system in systems:
        for objective in objectives:
            parts += [f"### {system}, {objective}", "", _head()]
            for name in formulations:
                flow, moved = (
                    known.get((system, objective, name, mode)) for mode in ("power-flow", "redispatch")
                )
                cells = [_figure(flow, column) for column in POWER_FLOW]
                cells += [_figure(moved, column) for column in REDISPATCH]
                parts.append(f"| `{name}` | {' | '.join(cells)} |")
            parts.append("")
    return "\n".join(parts)


def _head() -> str:
    columns = [f"pf: {title}" for title in POWER_FLOW.values()]
    columns += [f"rd: {title}" for title in REDISPATCH.values()]
    return f"| controller | {' | '.join(columns)} |\n| --- |" + " ---: |" * len(columns)


def _figure(row: dict[str, Any] | None, column: str) -> str:
    if row is None:
        return "–"
    value = row[column]
    if column == "cost":
        return f"{value / 1000:,.2f}"
    if column in ("violated_steps", "elastic_steps"):
        return str(value)
    return f"{value:.3f}" if column == "largest_vm_excess" else f"{value:,.1f}"


def main() -> None:
    """Write the page."""
    rows = read_table(sys.argv[1])
    failed = [row for row in rows if row["status"] != "done"]
    text = TEXT.read_text(encoding="utf-8")
    stamp = f"{date.today():%Y-%m-%d}; {len(rows) - len(failed)} of {len(rows)} closed loops done."
    PAGE.write_text(text.format(tables=tables(rows), stamp=stamp), encoding="utf-8")
    print(f"{PAGE} written; {stamp}")
    for row in failed:
        print({key: row[key] for key in ("system", "plant.mode", "controller", "status", "error")})


if __name__ == "__main__":
    main()
