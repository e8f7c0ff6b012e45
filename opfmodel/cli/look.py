"""Commands that look: at the data of a network before it is solved, and at the installation."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from opfmodel.cli.options import FILE, JSON, LOSSY, SET, VARIANT
from opfmodel.cli.output import print_json, print_line, print_notes, print_pairs, print_table, solver_output
from opfmodel.cli.reading import is_scenario, read_network_file, read_scenario, refuse_lossy

if TYPE_CHECKING:
    from opfmodel.cli.installation import Installation
    from opfmodel.network.inspection import Inspection
    from opfmodel.network.suspicions import Suspicion

__all__ = ["doctor", "info"]

_MOST_DRAWN = 300  # buses; more do not fit on a terminal
_MOST_LISTED = 3


def info(
    file: FILE,
    out: Annotated[Path | None, typer.Option(help="Save a map of the network: PNG, PDF or SVG.")] = None,
    picture: Annotated[bool, typer.Option(help="Draw the network on the terminal.")] = True,
    lossy: LOSSY = False,
    variant: VARIANT = None,
    set_: SET = None,
    json_: JSON = False,
) -> int:
    """Summarise a network and point out suspicious data, without solving anything.

    Shows size, islands, capacity against peak demand and voltage levels.
    """
    from opfmodel.network.inspection import inspect, topology

    if is_scenario(file):
        refuse_lossy(file, lossy)
        scenario = read_scenario(file, variant, set_)
        network, profiles = scenario.network, scenario.profiles
    else:
        network = read_network_file(file, default_cost=0.0, lossy=lossy)
        profiles = network.profiles
    found = inspect(network, profiles)
    if out is not None:
        from opfmodel.results.map import save_map

        save_map(network, out)
    if json_:
        print_json({**found.as_dict(), "picture": None if out is None else str(out)})
        return 0
    print_notes(found.notes)
    _print_summary(found)
    print_line("")
    print_table(
        ["kV", "buses", "branches", "to other levels"],
        [
            ["unknown" if level.base_kv is None else f"{level.base_kv:g}", str(level.buses),
             str(level.branches), str(level.transformers)]
            for level in found.levels
        ],
        numbers=True,
    )  # fmt: skip
    if picture:
        print_line("")
        for line in _drawing(topology(network)):
            print_line(line)
    print_line("")
    _print_suspicions(found.suspicions)
    if out is not None:
        print_line(f"map: {out}")
    return 0


def _print_summary(found: Inspection) -> None:
    islands = found.islands
    sizes = ", ".join(str(island.buses) for island in islands[:5]) + (", ..." if len(islands) > 5 else "")
    spare = "no limit" if found.spare_mw == float("inf") else f"{found.spare_mw:,.2f} MW"
    peak = f"{found.peak_mw:,.2f} MW"
    if found.steps > 1:
        peak += f" at step {found.peak_step} of {found.steps}"
    storage = {}
    if found.storage_mwh:
        storage["storage"] = f"{found.storage_mw:,.2f} MW, {found.storage_mwh:,.2f} MWh"
    size = {
        kind: f"{count:,}" + (f" and {idle:,} out of service" if idle else "")
        for kind, count in found.in_service.items()
        for idle in (found.out_of_service[kind],)
    }
    print_pairs(
        {
            "network": found.name,
            "base": f"{found.base_mva:g} MVA",
            **size,
            "islands": "1" if len(islands) == 1 else f"{len(islands)} of {sizes} buses",
            "topology": "radial" if found.loops == 0 else f"meshed, {found.loops:,} loops",
            "capacity": f"{found.capacity_mw:,.2f} MW",
            "peak demand": peak,
            "spare": spare,
            **storage,
        }
    )


def _drawing(graph: Any) -> Iterator[str]:
    """A drawing of a small network; of a large one, how many branches the buses have."""
    from opfmodel.cli.picture import bars, picture

    if 1 < len(graph) <= _MOST_DRAWN:
        yield from picture(graph)
    elif len(graph) > 1:
        degrees = Counter(min(degree, 10) for _, degree in graph.degree())
        yield "branches per bus"
        yield from bars({("10+" if d == 10 else str(d)): degrees[d] for d in sorted(degrees)})


def _print_suspicions(suspicions: tuple[Suspicion, ...]) -> None:
    from opfmodel.network.suspicions import grouped

    if not suspicions:
        print_line("no suspicious data")
        return
    rows = []
    for (kind, field, why), members in grouped(suspicions).items():
        shown = [f"{m.component} ({_value(m.value)})" if m.component else _value(m.value) for m in members]
        more = len(shown) - _MOST_LISTED
        rows.append(
            (kind, field, ", ".join(shown[:_MOST_LISTED]) + (f" and {more} more" if more > 0 else ""), why)
        )
    print_table(["kind", "field", "suspicious", "why"], rows, prose=True)


def _value(value: Any) -> str:
    if isinstance(value, tuple):
        return ", ".join(map(_value, value))
    return f"{value:g}" if isinstance(value, int | float) else "none" if value is None else str(value)


def doctor(json_: JSON = False) -> int:
    """Report versions, optional packages and back ends, and solve a small problem with each of them."""
    from opfmodel.cli.installation import examine

    with solver_output(False):
        found = examine()
    if json_:
        print_json(found.as_dict())
    else:
        _print_installation(found)
    return 0 if found.healthy else 1


def _print_installation(found: Installation) -> None:
    print_pairs({**found.versions, **found.machine})
    print_line("")
    print_table(
        ["optional package", "version", "enables"],
        [
            (p.name, p.version or "missing", p.enables if p.version else f"{p.enables}: {p.install}")
            for p in found.optional
        ],
        prose=True,
    )
    print_line("")
    print_table(
        ["back end", "solver", "formulation", "self-test"],
        [
            (t.back_end, t.solver, t.formulation, f"{'' if t.passed else 'FAILED: '}{t.status}, {t.detail}")
            for t in found.tests
        ]
        + [(name, "", "", f"FAILED: {reason}") for name, reason in found.broken.items()],
        prose=True,
    )
