"""Reading the files named on the command line, with the overrides of its options."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from opfmodel.errors import Fault, OpfmodelError, ScenarioError

if TYPE_CHECKING:
    from opfmodel.data.series import Profiles
    from opfmodel.data.yaml import Place
    from opfmodel.network import Network
    from opfmodel.scenario import Scenario
    from opfmodel.scenario.document import Document
    from opfmodel.simulation import Controller

__all__ = [
    "check_on_infeasible",
    "controller_of",
    "is_scenario",
    "network_of",
    "read_network_file",
    "read_scenario",
    "refuse_lossy",
]


_LONGEST = 80  # characters of an option that a message repeats


def is_scenario(file: Path) -> bool:
    """Whether the suffix of a file is that of a scenario or study; any other file is a network."""
    return file.suffix.lower() in (".yaml", ".yml")


def read_scenario(
    file: Path | Document,
    variant: str | None = None,
    overrides: list[str] | None = None,
    changes: Mapping[str, tuple[str, Any]] | None = None,
) -> Scenario:
    """Read a scenario with the overrides of ``--set`` and of other options.

    Parameters
    ----------
    overrides
        Arguments of ``--set``, such as ``controller.horizon=24``.
    changes
        Name and value of other options, by the key of the scenario that they override.

    Raises
    ------
    ScenarioError
        As for :func:`opfmodel.scenario.load_scenario`; an error that an option causes cites the option.
    """
    from opfmodel.scenario import load_scenario
    from opfmodel.scenario.document import read_document

    if isinstance(file, Path) and not is_scenario(file):
        raise OpfmodelError(f"{file}: is not a scenario file; its name must end in .yaml or .yml")
    options = [_set(item) for item in overrides or []]
    options += [_option(key, option, value) for key, (option, value) in (changes or {}).items()]
    document = read_document(file) if isinstance(file, Path) else file
    values = {option.key: option.value for option in options}
    places = {option.key: option.place for option in options}
    try:
        return load_scenario(document, variant, values, places=places)
    except ScenarioError as error:
        raise ScenarioError(*_blamed(error.faults, document, variant, options)) from error


@dataclass(frozen=True)
class _Option:
    """An option of the command line that sets a key of the scenario."""

    key: str
    value: Any
    place: Place


def _set(item: str) -> _Option:
    """Read an argument of ``--set``."""
    from opfmodel.data.source import Source
    from opfmodel.data.yaml import parse

    key, equals, text = item.partition("=")
    if not equals or not key:
        raise OpfmodelError(f"--set {item}: must be KEY=VALUE, such as controller.horizon=24")
    name = f"--set {item}" if len(item) <= _LONGEST else f"--set {item[:_LONGEST]}..."
    value, place = parse(text, Source(name, text, f"--set {key}=", is_file=False))
    return _Option(key, value, place)


def _option(key: str, option: str, value: Any) -> _Option:
    """Return the option of a key that has an option of its own."""
    from opfmodel.data.source import Source
    from opfmodel.data.yaml import Place

    source = Source(f"{option} {value}", str(value), f"{option} ", is_file=False)
    return _Option(key, value, Place(1, 1, source))


def _blamed(
    faults: Iterable[Fault], document: Document, variant: str | None, options: Sequence[_Option]
) -> list[Fault]:
    """Return faults with those in the file that an option causes located at the option."""
    from opfmodel.scenario import load_scenario
    from solvers import SolverError

    blamed = list(faults)
    for option in options:
        if all(fault.line is None for fault in blamed):
            break
        others = {other.key: other.value for other in options if other is not option}
        places = {other.key: other.place for other in options if other is not option}
        without: tuple[Fault, ...] = ()
        try:
            with warnings.catch_warnings(action="ignore"):  # they have been shown
                load_scenario(document, variant, others, places=places)
        except ScenarioError as error:
            without = error.faults
        except (OpfmodelError, SolverError):
            continue
        blamed = [
            fault
            if fault.line is None or fault in without
            else replace(option.place.fault((), fault.message, fault.cause), key=fault.key)
            for fault in blamed
        ]
    return list(dict.fromkeys(blamed))


def read_network_file(file: Path, default_cost: float | None, lossy: bool = False) -> Network:
    """Read a network; generators without cost data take the default cost, $/MWh.

    Parameters
    ----------
    lossy
        Whether what opfmodel does not represent is lost with a warning instead of refused.
    """
    from opfmodel.network.cases import read_network
    from opfmodel.network.costs import Polynomial

    cost = None if default_cost is None else Polynomial(0.0, default_cost, 0.0)
    return read_network(file, default_cost=cost, lossy=lossy)


def refuse_lossy(file: Path, lossy: bool) -> None:
    """Raise :class:`OpfmodelError` for the option ``--lossy`` with a scenario, which has a key for it."""
    if lossy:
        raise OpfmodelError(
            f"{file}: --lossy applies to network files only; use --set network.lossy=true for a scenario"
        )


def check_on_infeasible(value: str | None) -> None:
    """Raise an error for a value that ``--on-infeasible`` does not accept."""
    if value not in (None, "stop", "elastic"):
        raise OpfmodelError(f"--on-infeasible {value}: must be stop or elastic")


def network_of(
    file: Path, lossy: bool, variant: str | None, overrides: list[str] | None
) -> tuple[Network, Profiles | None]:
    """Return the network of a file, and the time series of a scenario."""
    if is_scenario(file):
        refuse_lossy(file, lossy)
        scenario = read_scenario(file, variant, overrides)
        return scenario.network, scenario.profiles
    if variant is not None or overrides:
        raise OpfmodelError(f"{file}: --variant and --set apply to scenario files (.yaml) only")
    return read_network_file(file, default_cost=0.0, lossy=lossy), None  # costs play no part in it


def controller_of(
    file: Path,
    chosen: Mapping[str, Any],
    default_cost: float | None,
    lossy: bool,
    variant: str | None,
    overrides: list[str] | None,
) -> tuple[Controller, Mapping[str, Any] | None]:
    """The controller of a file, and its initial state.

    With a perfect forecast, unless the futures that it plans for are drawn from its own.
    """
    from opfmodel.plan import MultiStage
    from opfmodel.simulation import Controller

    if is_scenario(file):
        if default_cost is not None:
            raise OpfmodelError(
                f"{file}: --default-cost applies to network files only; "
                "use --set network.default_cost, a cost such as {c1: 30}"
            )
        refuse_lossy(file, lossy)
        changes = {f"controller.{key}": (f"--{key}", value) for key, value in chosen.items()}
        scenario = read_scenario(file, variant, overrides, changes)
        futures = scenario.scenarios
        forecast = None if futures is None or futures.draw is None else scenario.forecast
        commit = scenario.settings.controller.commit
        planner = Controller(
            scenario.problem, forecast, elastic=scenario.elastic, scenarios=futures, commit=commit
        )
        return planner, scenario.initial()
    if variant is not None or overrides:
        raise OpfmodelError(f"{file}: --variant and --set apply to scenario files (.yaml) only")
    return Controller(MultiStage(read_network_file(file, default_cost, lossy), **chosen)), None
