"""Optima and voltages of PyPSA networks compared with PyPSA's own.

python -m benchmarks.imports_pypsa writes the tables of docs/inputs.md.
"""

from __future__ import annotations

import importlib
import logging
import sys
import warnings
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

from benchmarks.harness import splice

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "inputs.md"
sys.path.insert(0, str(ROOT / "tests"))

CASES = ("case9", "case14", "case30", "case39", "case57", "case118", "case300")


def optima() -> Iterator[tuple[str, int, float, str, float, float]]:
    """Network, snapshots, step, end, the optimum of PyPSA in $ and the relative difference."""
    import pypsa_networks

    chosen: list[tuple[str, int, float, bool]] = [
        *(("meshed", 12, hours, cyclic) for hours in (0.25, 1.0, 3.0) for cyclic in (False, True)),
        *((name, 24, 1.0, cyclic) for name in ("case14", "case30", "case118") for cyclic in (False, True)),
        ("case118", 96, 0.25, True),
    ]
    for name, steps, hours, cyclic in chosen:
        n: Any = (
            pypsa_networks.meshed(steps, hours, cyclic)
            if name == "meshed"
            else pypsa_networks.of_case(name, steps, hours, cyclic)
        )
        expected, found = pypsa_networks.optima(n)
        assert expected is not None and found is not None, name
        yield name, steps, hours, "cyclic" if cyclic else "free", expected, abs(found / expected - 1)


def voltages() -> Iterator[tuple[str, int, float]]:
    """Case, buses, and the largest difference of a complex voltage, p.u."""
    import pypsa
    from pypsa_networks import difference

    for name in CASES:
        n = pypsa.Network()
        n.import_from_pypower_ppc(getattr(importlib.import_module(f"pypower.{name}"), name)())
        yield name, len(n.buses), difference(n)


def main() -> None:
    """Write the tables."""
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("ignore")
    tools = f"PyPSA {version('pypsa')} with HiGHS {version('highspy')}"
    optimal = [
        f"| network | snapshots | step, h | end | {tools}, $ | relative difference |",
        "| --- | ---: | ---: | --- | ---: | ---: |",
        *(
            f"| {name} | {steps} | {hours:g} | {end} | {expected:,.2f} | {relative:.1e} |"
            for name, steps, hours, end, expected, relative in optima()
        ),
    ]
    splice(PAGE, "PyPSA optima", "\n".join(optimal))
    flows = [
        "| network | buses | largest difference of a voltage, p.u. |",
        "| --- | ---: | ---: |",
        *(f"| {name} | {buses} | {most:.1e} |" for name, buses, most in voltages()),
    ]
    splice(PAGE, "PyPSA voltages", "\n".join(flows))


if __name__ == "__main__":
    main()
