"""Security: what it costs and how long it takes, from 5 buses to 118 buses over a day.

python -m benchmarks.security
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import opfmodel as om
from benchmarks.harness import arguments, measure, median, report, splice, timed
from benchmarks.systems import PGLIB, case118
from opfmodel.network.cases import read_network

PAGE = Path(__file__).parent.parent / "docs" / "security.md"
RAMP = 0.4  # of the capacity per hour, where a case states no ramp
HEAD = (
    "| system | ratings after an outage | outages tested | not survived without security | no plan survives "
    "| corrective, cost | rounds | included | times unsecured | preventive, cost | rounds | included "
    "| times unsecured |"
)


@dataclass(frozen=True)
class System:
    """A system of the table: a case, stages, storage at every bus, and the ratings after an outage."""

    case: str
    rating: float
    stages: int = 1
    storage: bool = False
    preventive: bool = True


SYSTEMS = {
    "5 buses": System("case5_pjm", 1.2),
    "PGLib 14": System("case14_ieee", 1.2),
    "PGLib 30": System("case30_as", 1.2),
    "PGLib 39": System("case39_epri", 1.2),
    "PGLib 118": System("case118_ieee", 1.2, preventive=False),
    "PGLib 118, 24 stages, storage": System("case118_ieee", 1.2, 24, storage=True, preventive=False),
    "IEEE 118 without ratings, 24 stages, storage": System("", 1.0, 24, storage=True, preventive=False),
}


def made(system: System) -> tuple[om.Network, dict[str, np.ndarray]]:
    """The network of a system and its time series."""
    if not system.case:
        return case118(system.stages)
    network = read_network(PGLIB / f"pglib_opf_{system.case}.m")
    for name, unit in network.of(om.Generator).items():
        network.update(name, ramp=RAMP * unit.p[1])
    for bus in list(network.of(om.Bus)) if system.storage else ():
        network.add(f"cell{bus}", om.Storage(bus, energy=50, power=10, q=10))
    if system.stages == 1:
        return network, {}
    shape = 0.85 + 0.15 * np.sin(2 * np.pi * (np.arange(system.stages) - 8) / 24)
    loads = network.of(om.Load).items()
    return network, {f"{n}.{key}": value * shape for n, d in loads for key, value in (("p", d.p), ("q", d.q))}


def problem(system: System, security: om.Security | None) -> om.MultiStage:
    """The problem of a system."""
    network, series = made(system)
    return om.MultiStage(
        network, system.stages, profiles=series, objective=om.Economic(1e-3, 1e-3), security=security
    )


def unsecured(name: str) -> dict[str, Any]:
    """Compile and solve a system without security."""
    seconds, plan = timed(problem(SYSTEMS[name], None).solve)
    return {"seconds": seconds, "cost": plan.objective, "iterations": plan.solution.iterations}


def secured(name: str, response: str, left_out: tuple[str, ...] = ()) -> dict[str, Any]:
    """Compile and solve a system with security; its time includes screening."""
    system = SYSTEMS[name]
    everything = problem(system, om.Security(rating=system.rating)).screening.responses.outages
    outages: Any = {"branches": [out for out in everything if out not in left_out]} if left_out else "all"
    stated = problem(system, om.Security(outages, response, rating=system.rating))
    seconds, plan = timed(stated.solve)
    return {
        "seconds": seconds,
        "status": plan.status,
        "cost": plan.objective,
        "outages": (len(everything) - len(left_out)) * system.stages,
        "violated": len(plan.rounds[0].violated),
        "suspects": sorted({outcome.out for outcome in plan.rounds[0].violated}),
        "rounds": len(plan.rounds),
        "included": plan.rounds[-1].included,
        "iterations": plan.solution.iterations,
        "testing_s": sum(each.seconds for each in plan.rounds),
    }


def hopeless(name: str, response: str, suspects: list[str]) -> tuple[str, ...]:
    """The outages that no plan survives, even if it had to survive no other."""
    system = SYSTEMS[name]
    found = []
    for out in suspects:
        alone = om.Security({"branches": [out]}, response, rating=system.rating)
        if not problem(system, alone).solve().optimal:
            found.append(out)
    return tuple(found)


def assessed(name: str, response: str) -> dict[str, Any]:
    """A secure plan, without the outages that no plan survives."""
    first = measure(secured, name, response)
    if "error" in first or first["status"].endswith("optimal"):
        return {**first, "left_out": ()}
    left_out = hopeless(name, response, first["suspects"])
    again = measure(secured, name, response, left_out)
    return {**again, "violated": first.get("violated"), "outages": first.get("outages"), "left_out": left_out}


def ratings(system: System) -> str:
    """The ratings after an outage, in words."""
    branches = made(system)[0].of(om.Branch).values()
    if all(branch.rating is None for branch in branches):
        return "unlimited"
    stated = any(branch.emergency_rating is not None for branch in branches)
    return "of the file" if stated else f"x {system.rating:g}"


def line(name: str, free: Mapping[str, Any], found: Mapping[str, Mapping[str, Any]]) -> str:
    """A line of the table."""
    corrective = found["corrective"]
    hopeless = [", ".join(corrective["left_out"])]
    if more := set(found.get("preventive", {}).get("left_out", ())) - set(corrective["left_out"]):
        hopeless.append(f"preventive: {', '.join(sorted(more))}")
    cells = [
        ratings(SYSTEMS[name]),
        f"{corrective['outages']:,}",
        f"{corrective['violated']:,}",
        "; ".join(filter(None, hopeless)),
    ]
    for response in ("corrective", "preventive"):
        each = found.get(response)
        if each is None:
            cells += ["not tried", "", "", ""]
        elif not str(each.get("status")).endswith("optimal"):
            cells += ["no plan", str(each.get("rounds", "")), str(each.get("included", "")), ""]
        else:
            cost = 100.0 * (each["cost"] / free["cost"] - 1.0)
            ratio = each["seconds"] / free["seconds"]
            cells += [f"{cost:+.2f} %", str(each["rounds"]), str(each["included"]), f"{ratio:.0f}"]
    return f"| {name} | {' | '.join(cells)} |"


def main() -> None:
    """Measure and report; write the table of docs/security.md."""
    options = arguments(__doc__ or "")
    names = list(SYSTEMS)[:2] if options.quick else list(SYSTEMS)
    rows, lines, goals = [], [], {}
    for name in names:
        free = median([measure(unsecured, name) for _ in range(options.repeat)])
        responses = ["corrective", "preventive"] if SYSTEMS[name].preventive else ["corrective"]
        found = {response: assessed(name, response) for response in responses}
        lines.append(line(name, free, found))
        print(lines[-1], flush=True)
        rows.append({"measurement": f"{name}, without security", **free})
        for response, each in found.items():
            kept = {key: value for key, value in each.items() if key not in ("suspects", "left_out")}
            rows.append({"measurement": f"{name}, {response}", **kept})
        if SYSTEMS[name].stages > 1:
            ratio = found["corrective"]["seconds"] / free["seconds"]
            goals[f"{name}: times the unsecured problem (goal <= 10)"] = ratio
    report("security", rows, goals)
    if not options.quick:
        rule = "| --- | ---: | ---: | ---: | --- |" + " ---: |" * 8
        splice(PAGE, "cost of security", "\n".join([HEAD, rule, *lines]))


if __name__ == "__main__":
    main()
