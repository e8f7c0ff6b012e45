"""The commands by name, and how their errors are reported."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from importlib.metadata import version
from io import TextIOWrapper
from typing import Annotated, Any, NoReturn

import typer

from opfmodel.cli import (
    analyze,
    convert,
    inspect,
    look,
    powerflow,
    report,
    run,
    schema,
    security,
    solve,
    study,
)
from opfmodel.cli.output import WarningPrinter, print_faults, print_json, print_line, remark
from opfmodel.cli.signals import ended_by_signals
from opfmodel.errors import Fault, OpfmodelError, shown

__all__ = ["app", "main"]

app = typer.Typer(
    help="Multi-stage AC optimal power flow with storage, in a receding horizon.",
    invoke_without_command=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
app.command("solve")(solve.solve)
app.command("powerflow")(powerflow.powerflow)
app.command("security")(security.security)
app.command("analyze")(analyze.analyze)
app.command("run")(run.run)
app.command("table")(run.table)
app.command("validate")(inspect.validate)
app.command("plot")(run.plot)
app.command("report")(report.report)
app.command("list")(inspect.list_plugins)
app.command("schema")(schema.schema)
app.command("info")(look.info)
app.command("convert")(convert.convert)
app.command("init")(convert.init)
app.command("doctor")(look.doctor)

study_app = typer.Typer(help="Run and tabulate parameter studies.", invoke_without_command=True)
app.add_typer(study_app, name="study")
study_app.command("run")(study.run)
study_app.command("table")(study.table)

_CTRL_C = 130  # exit status of Typer


def _print_version(wanted: bool) -> None:
    if wanted:
        print_line(f"opfmodel {version('opfmodel')}")
        raise typer.Exit


@app.callback()
def _opfmodel(
    context: typer.Context,
    _: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    _require_command(context)


@study_app.callback()
def _study(context: typer.Context) -> None:
    _require_command(context)


def _require_command(context: typer.Context) -> None:
    """Without a command, print the usage on standard error and exit with status 2."""
    if context.invoked_subcommand is None:
        for line in context.get_help().splitlines():
            remark(line)
        raise typer.Exit(2)


def main() -> NoReturn:
    """Run the command line; errors in the input go to standard error, with exit status 2."""
    as_json = "--json" in sys.argv[1:]
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # as standard error does: no name can fail to print
    warnings.showwarning = WarningPrinter()
    try:
        with ended_by_signals():
            code = app(prog_name="opfmodel", standalone_mode=False)
    except typer.Exit as stop:
        sys.exit(stop.exit_code)
    except (typer.Abort, KeyboardInterrupt):
        _fail((Fault("interrupted"),), as_json, code=1)
    except Exception as error:
        faults = _mistakes(error)
        if not faults:
            raise
        _fail(faults, as_json)
    if code == _CTRL_C:
        _fail((Fault("interrupted"),), as_json, code=1)
    sys.exit(code or 0)


def _mistakes(error: Exception) -> tuple[Fault, ...]:
    """What is wrong in the user's input; nothing for a fault of the program."""
    if isinstance(error, OpfmodelError):
        return error.faults
    if hasattr(error, "format_message"):  # wrong usage of the command line
        return (Fault(_usage(error)),)
    from solvers import SolverError

    return (Fault(str(error)),) if isinstance(error, SolverError) else ()


def _usage(error: Any) -> str:
    """Message of wrong usage; Typer has the values of options checked by pydantic, in the words of that."""
    for fault in error.__cause__.errors()[:1] if hasattr(error.__cause__, "errors") else ():
        from opfmodel.data.faults import fault_message

        own = fault["type"] == "value_error"  # the words of Typer, with the value
        error.message = fault_message(fault) if own else f"{shown(fault['input'])}: {fault_message(fault)}"
    return str(error.format_message())


def _fail(faults: Sequence[Fault], as_json: bool, code: int = 2) -> NoReturn:
    print_faults(faults)
    if as_json:
        print_json({"error": "\n".join(map(str, faults)), "faults": [fault.as_dict() for fault in faults]})
    sys.exit(code)
