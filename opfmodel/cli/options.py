"""Arguments and options shared by several commands."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

__all__ = ["FILE", "JSON", "LOSSY", "ON_INFEASIBLE", "OUT", "SCENARIO", "SET", "VARIANT", "VERBOSE"]

FILE = Annotated[
    Path, typer.Argument(help="Network file (MATPOWER .m, PSS/E .raw, ...) or scenario file (.yaml).")
]
SCENARIO = Annotated[Path, typer.Argument(help="Scenario file (.yaml).")]
OUT = Annotated[Path | None, typer.Option(help="Results folder; results/NAME by default.")]
JSON = Annotated[bool, typer.Option("--json", help="Print the result as one JSON object.")]
LOSSY = Annotated[
    bool,
    typer.Option(
        "--lossy", help="Warn about what a network file loses when it is read, instead of refusing it."
    ),
]
VERBOSE = Annotated[bool, typer.Option("--verbose", "-v", help="Print solver iterations on standard error.")]
VARIANT = Annotated[str | None, typer.Option(help="Variant of the scenario.")]
SET = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Override a dotted scenario key; repeatable."),
]
ON_INFEASIBLE = Annotated[
    str | None,
    typer.Option(
        metavar="stop|elastic",
        help="If a problem is infeasible: stop, or soften its limits at penalty prices.",
    ),
]
