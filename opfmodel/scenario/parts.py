"""The parts of a scenario that are plugins: profile rules, objectives, forecast and plant."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from opfmodel import plugins
from opfmodel.data.grid import Grid
from opfmodel.data.series import Profiles
from opfmodel.errors import ModelError, ProfileError, ScenarioError, nearest, shown
from opfmodel.forecasts import Case, Draw, Forecast, Scenarios
from opfmodel.horizon import Horizon
from opfmodel.network.arrays import OUTAGES, PerUnitNetwork, per_unit
from opfmodel.network.bounds import number_within
from opfmodel.network.components import Load
from opfmodel.network.network import Network
from opfmodel.network.quantities import Basis
from opfmodel.network.series import check_finite, check_series
from opfmodel.objectives.base import Objective, WeightedSum
from opfmodel.objectives.economic import Economic
from opfmodel.objectives.setpoint_tracking import Setpoints
from opfmodel.plan.memory import check_memory, run_bytes, series_bytes
from opfmodel.plan.outages import check_declared
from opfmodel.profiles.base import ProfileRule, Workbook
from opfmodel.scenario.document import Document, check_printable, colon_hint
from opfmodel.scenario.files import FILE_OPTIONS, read_fitted, repeated
from opfmodel.scenario.schema import ScenarioFile, Spec
from opfmodel.simulation import Outage, Plant

__all__ = [
    "Rule",
    "make_forecast",
    "make_horizon",
    "make_objective",
    "make_outages",
    "make_plant",
    "make_profiles",
    "make_rules",
    "make_scenarios",
    "planned_objective",
]


@dataclass(frozen=True)
class Rule:
    """A profile rule of a file, with its path of keys."""

    key: tuple[str | int, ...]
    rule: ProfileRule


def make_rules(document: Document, settings: ScenarioFile, network: Network) -> list[Rule]:
    """Create the profile rules, without those that have a fault."""
    rules, basis = [], settings.basis._replace(base_mva=network.base_mva)
    for number, spec in enumerate(settings.profiles):
        key = ("profiles", number)
        if document.faults.broken(*key):
            continue
        with document.faults:
            name, options = _single(document, key, spec, "profile")
            with document.located(*key, name):
                made = plugins.make("profile", name, options, context=basis)
                rules.append(Rule((*key, name), made))
    return rules


def make_profiles(
    document: Document,
    settings: ScenarioFile,
    network: Network,
    grid: Grid,
    rules: Iterable[Rule],
) -> Profiles:
    """Build the time series by applying the profile rules of the file to those attached to the network.

    If there is a fault in the network, in a rule or in the length of the series, the rules behind it are
    applied in order to check the names in them; errors in values would only follow from that fault.

    Parameters
    ----------
    grid
        The steps that they cover; the first series with time stamps completes it.
    """
    faults = document.faults
    sections = ("network", "time", "controller", "profiles")
    found = len(faults)
    with faults:
        _check_size(document, settings, network)
    if len(faults) > found:
        raise faults.error()  # nothing of this length can be built, not even to check the rest
    book = Workbook(network, grid, document.path.parent)
    if not faults.broken("time"):
        with faults, document.located("time", "steps"):
            book.series |= _attached(network, grid)
    for each in rules:
        sound = not any(map(faults.broken, sections))
        with faults, document.located(*each.key), _sourced(book), _checked(sound), document.warned(*each.key):
            before = dict(book.series)
            each.rule.apply(book)
            changed = {k: values for k, values in book.series.items() if before.get(k) is not values}
            check_finite(Profiles(changed), network)
    if any(map(faults.broken, sections)):
        return Profiles()
    with faults, document.located("profiles"), _sourced(book):
        made = Profiles({key: values[: grid.steps] for key, values in book.series.items()}, grid.calendar)
        made.repeats = grid.at_end == "repeat"
        check_series(made, network)
        return made
    return Profiles()


@contextmanager
def _checked(sound: bool) -> Iterator[None]:
    """Drop what follows from an earlier fault: errors about values, and warnings."""
    with warnings.catch_warnings():
        if not sound:
            warnings.simplefilter("ignore")
        try:
            yield
        except ProfileError as error:
            if sound or error.series is None:
                raise


def _attached(network: Network, grid: Grid) -> Profiles:
    """Return the time series attached to the network, for the steps."""
    try:
        return grid.take(network.profiles)
    except ProfileError as error:
        raise ProfileError(f"time series of the network: {error}") from error


def _check_size(document: Document, settings: ScenarioFile, network: Network) -> None:
    """Raise an error, before building any series, if series or results would not fit in memory."""
    steps, horizon = settings.time.steps, settings.ahead
    loads = len(network.of(Load))
    with document.located("time", "steps"):
        check_memory(f"{steps:,}", run_bytes(len(network), steps) + series_bytes(loads, steps))
    with document.located("controller", "horizon"):
        check_memory(f"{horizon:,} with {steps:,} steps", series_bytes(loads, steps + horizon))


@contextmanager
def _sourced(book: Workbook) -> Iterator[None]:
    """Add line and column to errors about a value that was read from a file."""
    try:
        yield
    except ProfileError as error:
        for each in (error, *error.others):
            if isinstance(each, ProfileError):
                each.args = (f"{book.source(each)}{each}",)
        raise


def make_objective(
    document: Document,
    key: tuple[str | int, ...],
    spec: Spec,
    basis: Basis,
    convert: Mapping[Any, Callable[[Any], Any]] | None = None,
) -> Objective:
    """Create an objective, or the weighted sum of several; the default in place of one with a fault.

    Parameters
    ----------
    key
        Path of keys to it in the file.
    basis
        What the values of quantities with units depend on.
    convert
        Converters from values of the file to objects, by type; see :func:`opfmodel.plugins.make`.
    """
    made: Objective = Economic()
    if document.faults.broken(*key):
        return made
    if not isinstance(spec, list):
        with document.faults:
            name, options = _single(document, key, spec, "objective", *(("weight",) if key[1:] else ()))
            with document.located(*key, *((name,) if isinstance(spec, dict) else ())):
                made = plugins.make("objective", name, options, convert, context=basis)
        return made
    parts: list[tuple[float, Objective]] = []
    for number, part in enumerate(spec):
        rest = part if isinstance(part, str) else {k: v for k, v in part.items() if k != "weight"}
        weight = 1.0 if isinstance(part, str) else part.get("weight", 1.0)
        made = make_objective(document, (*key, number), rest, basis, convert)
        with document.faults, document.located(*key, number, "weight"):
            parts.append((number_within("weight", weight, at_least=0), made))
    if not spec:
        document.faults.add(document.fault(key, "needs at least one objective"))
    return WeightedSum(parts) if parts else made


def make_forecast(document: Document, settings: ScenarioFile) -> Forecast | None:
    """Create the controller's forecast of the series; None if there is a fault."""
    if document.faults.broken("forecast"):
        return None
    with document.faults:
        name, options = _single(document, ("forecast",), settings.forecast, "forecast")
        with document.located("forecast", *((name,) if isinstance(settings.forecast, dict) else ())):
            made: Forecast = plugins.make(
                "forecast",
                name,
                options,
                {Path: lambda value: document.path.parent / str(value)},
                context=settings.basis,
            )
            return made
    return None


def make_scenarios(document: Document, settings: ScenarioFile) -> Scenarios | None:
    """Create the futures that the controller plans for; None for the forecast alone or with a fault."""
    section, at = settings.controller.scenarios, ("controller", "scenarios")
    if section is None or document.faults.broken(*at):
        return None
    cases = {}
    for case, stated in section.cases.items():
        with document.faults:
            check_printable(document, (*at, "cases", case), case)
        rules = []
        for number, spec in enumerate(stated.profiles):
            key = (*at, "cases", case, "profiles", number)
            with document.faults:
                name, options = _single(document, key, spec, "profile")
                with document.located(*key, name):
                    rules.append(plugins.make("profile", name, options))
        cases[case] = Case(stated.probability, rules)
    with document.faults, document.located(*at):
        draw = None
        if section.draw is not None:
            splits = section.draw.splits
            depths = None if splits is None else {_integer(key): count for key, count in splits.items()}
            draw = Draw(section.draw.number, section.draw.keep, section.draw.seed, depths)
        return Scenarios(section.common, cases, draw, document.path.parent)
    return None


def _integer(key: str | int) -> Any:
    """Return a key of a mapping as a number, unchanged if it is none."""
    try:
        return int(key)
    except ValueError:
        return key


def make_horizon(document: Document, settings: ScenarioFile, scenarios: Scenarios | None) -> Horizon:
    """Create the nodes in time of the plans; a single one if there is a fault."""
    step = settings.time.step
    hours = settings.controller.lengths(step)
    made = Horizon.chain(1, step)
    with document.faults:
        with document.located("controller", "horizon"):
            made = Horizon.grid(hours, step)
        if scenarios is not None:
            with document.located("controller", "scenarios"):
                made = scenarios.horizon(hours, step)
    return made


def make_plant(settings: ScenarioFile) -> Plant:
    """Create the plant of a closed loop, without history."""
    section = settings.plant
    made = plugins.make(
        "plant", section.mode, section.options, beside=type(section).model_fields, context=settings.basis
    )
    assert isinstance(made, Plant)
    if not section.outages:
        return made
    events = [Outage(name, each.step, each.hours) for each in section.outages for name in each.named.values()]
    return made.with_outages(events, section.known, section.minutes, section.rating)


def make_outages(document: Document, settings: ScenarioFile, network: PerUnitNetwork) -> list[str]:
    """Return the names of the components that trip in the loop, without those that have a fault."""
    names: list[str] = []
    for number, section in enumerate(settings.plant.outages):
        at, named = ("plant", "outages", number), section.named
        if len(named) != 1:
            kinds = ", ".join(kind.kind for kind in OUTAGES)
            text = f"names {len(named)} components; must name one, of the kind {kinds}"
            document.faults.add(document.fault(at, text))
            continue
        [(kind, name)] = named.items()
        table = network.tables[kind]
        if name not in table.position:
            text = f"{shown(name)}: no {kind} in service has this name; {nearest(name, table.names)}"
            document.faults.add(document.fault((*at, kind), text))
            continue
        with document.faults, document.located(*at):
            names += check_declared([name], network)
    return names


def planned_objective(
    document: Document,
    settings: ScenarioFile,
    network: Network,
    cost: Objective,
    grid: Grid,
    single_stages: Callable[[], Setpoints],
) -> Objective:
    """Return the objective that plans minimise: that of the controller, or the cost.

    Parameters
    ----------
    grid
        The steps of the time series.
    single_stages
        Returns the single-stage optima; called only when they are used.
    """
    stated = settings.controller.objective
    if stated is None:
        return cost

    def setpoints(value: Any) -> Setpoints:
        return _setpoints(value, document, grid, network, single_stages)

    return make_objective(
        document, ("controller", "objective"), stated, settings.basis, {Setpoints: setpoints}
    )


def _setpoints(
    value: Any, document: Document, grid: Grid, network: Network, single_stages: Callable[[], Setpoints]
) -> Setpoints:
    """Convert set-points from a scenario file.

    Parameters
    ----------
    grid
        The steps that a file or a list of values covers.
    single_stages
        Solves for the single-stage optima; called only when they are used.
    """
    if value == "single-stage":
        return Setpoints(lambda: single_stages().values)
    if not isinstance(value, dict):
        raise ModelError(
            f"set-points {value!r}: must be 'single-stage', {{file: PATH}} or {{component.quantity: values}}"
        )
    if "file" in value and set(value) <= {"file", *FILE_OPTIONS}:
        value = read_fitted(document.path.parent / str(value["file"]), grid, **value).values
    elif grid.at_end == "repeat":
        value = {key: repeated(values, grid.steps) for key, values in value.items()}
    given = Setpoints(value)
    given.arrays(per_unit(network))  # so that errors are located in the file
    return given


def _single(
    document: Document, key: tuple[str | int, ...], spec: str | dict[str, Any], sort: str, *beside: str
) -> tuple[str, dict[str, Any]]:
    """Return name and options of a plugin, given as ``name`` or ``{name: {option: value}}``.

    Parameters
    ----------
    sort
        Sort of the plugin.
    beside
        Other keys that are accepted next to the name.
    """
    if isinstance(spec, str):
        return spec, {}
    if len(spec) != 1:
        strange = [name for name in spec if name not in plugins.plugins(sort)]
        if len(strange) == len(spec) - 1 and beside:
            raise ScenarioError(
                *(document.fault((*key, name), f"unknown key; {nearest(name, beside)}") for name in strange)
            )
        raise document.error(key, f"must be a name, or one name with its options, not {len(spec)} keys")
    name, options = next(iter(spec.items()))
    if options is not None and not isinstance(options, dict):
        hint = colon_hint(options)
        raise document.error((*key, name), f"{shown(options)}: the options must be a mapping{hint}")
    return name, options or {}
