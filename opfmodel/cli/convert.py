"""Commands that write files to start from: a network in another format, a commented scenario."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from opfmodel.cli.options import FILE, JSON
from opfmodel.cli.output import WarningPrinter, print_json, print_line
from opfmodel.cli.reading import is_scenario, read_network_file, read_scenario
from opfmodel.errors import CaseError, CaseWarning, OpfmodelError

if TYPE_CHECKING:
    from opfmodel.network import Network

__all__ = ["convert", "init"]

LOSSY = Annotated[bool, typer.Option("--lossy", help="Warn about what is lost, instead of refusing it.")]
DEFAULT_COST = Annotated[
    float | None, typer.Option(help="Cost in $/MWh of generators without cost data in a network file.")
]
_LOST = ": lost: "  # as the warnings of opfmodel.network.cases.losses have it


def convert(
    file: FILE,
    to: Annotated[
        Path, typer.Argument(help="File to write: MATPOWER .m, scenario .yaml or pandapower .json.")
    ],
    default_cost: DEFAULT_COST = None,
    lossy: LOSSY = False,
    json_: JSON = False,
) -> int:
    """Convert a network to another format.

    What one of the formats cannot hold is refused, or lost with a warning if --lossy accepts it.
    """
    write = _writer(to)
    if to.exists() and to.resolve() == file.resolve():
        raise OpfmodelError(f"{to}: is the file to convert; choose another name")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", CaseWarning)
        written = [str(path) for path in write(_network(file, default_cost, lossy), to, lossy=lossy)]
    messages = [str(one.message) for one in caught if issubclass(one.category, CaseWarning)]
    losses = [message for message in messages if _LOST in message]
    show_warning = WarningPrinter()
    for message in messages:
        show_warning(message, CaseWarning)
    if json_:
        others = [message for message in messages if _LOST not in message]
        print_json({"status": "done", "written": written, "warnings": others, "losses": losses})
    else:
        print_line(f"{', '.join(written)}: written" + (f"; {len(losses)} losses" if losses else ""))
    return 0


def _writer(to: Path) -> Callable[..., Sequence[Path]]:
    suffix = to.suffix.lower()
    if suffix == ".m":
        return _write_matpower
    if suffix in (".yaml", ".yml"):
        from opfmodel.scenario.write import write_scenario

        return write_scenario
    if suffix == ".json":
        return _write_pandapower
    accepted = ".m, .yaml and .json (pandapower)"
    raise OpfmodelError(
        f"{to}: no format is written under {suffix or 'this name'!r}; accepted are {accepted}"
    )


def _write_pandapower(network: Network, to: Path, *, lossy: bool) -> Sequence[Path]:
    from opfmodel.network.cases.pandapower.write import write_pandapower

    return [write_pandapower(network, to, lossy=lossy)]


def _write_matpower(network: Network, to: Path, *, lossy: bool) -> Sequence[Path]:
    from opfmodel.network.cases import write_network

    return [write_network(network, to, lossy=lossy)]


def _network(file: Path, default_cost: float | None, lossy: bool) -> Network:
    """The network of a file; a scenario has more than a network, which is lost."""
    if not is_scenario(file):
        return read_network_file(file, default_cost, lossy)
    from opfmodel.network.cases.losses import Losses

    scenario = read_scenario(file)
    losses = Losses(str(file), writing=True)
    if scenario.profiles:
        losses.add(f"{len(scenario.profiles)} time series of the scenario")
    losses.settle(lossy)
    return scenario.network


def init(
    path: Annotated[Path, typer.Argument(help="Scenario file to write.")] = Path("scenario.yaml"),
    from_: Annotated[Path | None, typer.Option("--from", help="Network file to start from.")] = None,
    lossy: LOSSY = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False,
    json_: JSON = False,
) -> int:
    """Write a commented scenario that runs as it is."""
    from opfmodel.data.writing import replace
    from opfmodel.scenario.template import template

    if not is_scenario(path):
        raise OpfmodelError(f"{path}: the name of a scenario file must end in .yaml or .yml")
    if os.path.lexists(path) and not force:
        raise OpfmodelError(f"{path}: exists; --force overwrites it")
    if from_ is None:
        text = template()
    else:
        network, price = _priced(from_, lossy)
        # what is no file has a name, as the grids of SimBench
        file = os.path.relpath(from_.resolve(), path.resolve().parent) if from_.exists() else str(from_)
        text = template(network, file, lossy=lossy, price=price)
    try:
        replace({path: text.encode()})
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        raise OpfmodelError(
            f"{path}: cannot be written: {getattr(error, 'strerror', None) or error}"
        ) from error
    if json_:
        print_json({"status": "done", "written": [str(path)], "warnings": [], "losses": []})
    else:
        print_line(f"{path}: written; run it with: opfmodel run {path}")
    return 0


def _priced(file: Path, lossy: bool) -> tuple[Network, bool]:
    """Read a network, and state whether its generators need a default cost."""
    try:
        return read_network_file(file, None, lossy), False
    except CaseError as error:
        if "no cost data" not in str(error):
            raise
    return read_network_file(file, 30.0, lossy), True
