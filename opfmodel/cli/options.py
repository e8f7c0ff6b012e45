"""Arguments and options that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

__all__ = ["FILE", "JSON", "ON_INFEASIBLE", "OUT", "SCENARIO", "SET", "VARIANT", "VERBOSE"]

FILE = Annotated[
    Path, typer.Argument(help="A network file (MATPOWER .m, PSS/E .raw, ...) or a scenario (.yaml).")
]
SCENARIO = Annotated[Path, typer.Argument(help="A scenario file (.yaml).")]
OUT = Annotated[Path | None, typer.Option(help="Folder of the results; results/NAME by default.")]
JSON = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]
VERBOSE = Annotated[
    bool, typer.Option("--verbose", "-v", help="Show the solver's iterations on standard error.")
]
VARIANT = Annotated[str | None, typer.Option(help="A variant of the scenario.")]
SET = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Override a key of the scenario: controller.horizon=24."),
]
ON_INFEASIBLE = Annotated[
    str | None,
    typer.Option(
        metavar="stop|elastic",
        help="When a problem has no solution: stop, or let limits give way at a price.",
    ),
]
