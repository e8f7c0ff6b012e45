"""The command that prints the JSON Schema of input files."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from opfmodel.cli.options import JSON
from opfmodel.cli.output import print_json, print_line

__all__ = ["schema"]


def schema(
    study: Annotated[bool, typer.Option("--study", help="Print the schema of study files.")] = False,
    json_: JSON = False,
) -> int:
    """Print the JSON Schema of scenario files, with which editors complete and check them.

    It knows the components and options of all installed plugins.
    """
    from opfmodel.scenario.reference import scenario_schema
    from opfmodel.study.reference import study_schema

    made = study_schema() if study else scenario_schema()
    if json_:
        print_json(made)
    else:
        for line in json.dumps(made, indent=1, ensure_ascii=False).splitlines():
            print_line(line)
    return 0
