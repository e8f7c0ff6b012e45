"""Commands that solve nothing: validate a file, list what is installed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from opfmodel.cli import show
from opfmodel.cli.options import FILE, JSON, LOSSY, SET, VARIANT
from opfmodel.cli.output import print_json, print_line, print_notes
from opfmodel.cli.reading import is_scenario, read_network_file, read_scenario, refuse_lossy
from opfmodel.errors import ScenarioError

if TYPE_CHECKING:
    from opfmodel.scenario import Scenario
    from opfmodel.scenario.document import Document

__all__ = ["list_plugins", "validate"]


def validate(
    file: FILE, lossy: LOSSY = False, variant: VARIANT = None, set_: SET = None, json_: JSON = False
) -> int:
    """Check a scenario, study or network file without solving it.

    A scenario is checked with each of its variants unless one is given: one stage of its problem is
    compiled, and the first and the last forecast are made.
    """
    from opfmodel.network.arrays import per_unit
    from opfmodel.scenario.document import read_document

    if is_scenario(file):
        refuse_lossy(file, lossy)
        document = read_document(file)
        if document.is_study:
            return _validate_study(file, json_)
        loaded = _rehearsed(document, variant, set_)
        network, notes = loaded.network, loaded.problem.notes
    else:
        network = read_network_file(file, default_cost=0.0, lossy=lossy)
        notes = per_unit(network).notes
    if json_:
        counts = {kind.plural: len(network.of(kind)) for kind in network.kinds()}
        print_json({"valid": True, **counts, "islands": per_unit(network).n_islands, "notes": list(notes)})
    else:
        print_notes(notes)
        print_line(f"{file}: valid; {network!r}")
    return 0


def _rehearsed(document: Document, variant: str | None, overrides: list[str] | None) -> Scenario:
    """Read a scenario and, unless one is given, all its variants; one error reports the faults of all."""
    from opfmodel.data.collection import Faults
    from opfmodel.scenario.rehearsal import rehearse

    faults, loaded = Faults(), None
    with faults:
        loaded = read_scenario(document, variant, overrides)
        rehearse(loaded)
    declared = document.content.get("variants") if isinstance(document.content, dict) else None
    for name in declared if variant is None and isinstance(declared, dict) else ():
        try:
            rehearse(read_scenario(document, name, overrides))
        except ScenarioError as error:
            new = [fault for fault in error.faults if fault not in faults]
            faults.add(*(replace(fault, message=f"{fault.message} (variant {name!r})") for fault in new))
    faults.settle()
    assert loaded is not None
    return loaded


def _validate_study(file: Path, as_json: bool) -> int:
    from opfmodel.study import read_study

    study = read_study(file)
    axes = {axis.name: len(axis.labels) for axis in study.axes}
    if as_json:
        print_json({"valid": True, "runs": len(study), "axes": axes})
    else:
        grid = " x ".join(f"{n} {name}" for name, n in axes.items())
        print_line(f"{file}: valid; {len(study)} runs: {grid}")
    return 0


def list_plugins(json_: JSON = False) -> int:
    """List installed plugins with their origin and options."""
    from opfmodel.plugins.catalogue import catalogue

    entries = catalogue()
    if json_:
        print_json({"plugins": [entry.as_dict() for entry in entries]})
    else:
        show.entries(entries)
    return 0
