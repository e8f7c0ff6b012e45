"""The parts of a scenario that are plugins: profile rules, objectives, forecast and plant."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from opfmodel import plugins
from opfmodel.data.grid import Grid
from opfmodel.data.series import Profiles
from opfmodel.errors import ModelError, ProfileError
from opfmodel.forecasts import Case, Draw, Forecast, Scenarios
from opfmodel.horizon import Horizon
from opfmodel.network.arrays import per_unit
from opfmodel.network.bounds import number_within
from opfmodel.network.components import Load
from opfmodel.network.network import Network
from opfmodel.network.quantities import Basis
from opfmodel.network.series import check_finite, check_series
from opfmodel.objectives.base import Objective, WeightedSum
from opfmodel.objectives.setpoint_tracking import Setpoints
from opfmodel.plan.memory import check_memory, run_bytes, series_bytes
from opfmodel.profiles.base import Workbook
from opfmodel.scenario.document import Document, check_printable
from opfmodel.scenario.files import FILE_OPTIONS, read_fitted, repeated
from opfmodel.scenario.schema import ScenarioFile, Spec
from opfmodel.simulation import Plant

__all__ = [
    "make_forecast",
    "make_horizon",
    "make_objective",
    "make_plant",
    "make_profiles",
    "make_scenarios",
    "planned_objective",
]


def make_profiles(document: Document, settings: ScenarioFile, network: Network, grid: Grid) -> Profiles:
    """Build the time series by applying the profile rules of the file to those attached to the network.

    Parameters
    ----------
    grid
        The steps that they cover; the first series with time stamps completes it.
    """
    _check_size(document, settings, network)
    book = Workbook(network, grid, document.path.parent)
    try:
        book.series |= grid.take(network.profiles)
    except ProfileError as error:
        raise document.error(("time", "steps"), f"time series of the network: {error}") from error
    basis = settings.basis._replace(base_mva=network.base_mva)
    for number, spec in enumerate(settings.profiles):
        key = ("profiles", number)
        name, options = _single(document, key, spec)
        before = dict(book.series)
        with document.located(*key, name), _sourced(book):
            plugins.make("profile", name, options, context=basis).apply(book)
            changed = {k: values for k, values in book.series.items() if before.get(k) is not values}
            check_finite(Profiles(changed), network)
    with document.located("profiles"), _sourced(book):
        made = Profiles({key: values[: grid.steps] for key, values in book.series.items()}, grid.calendar)
        made.repeats = grid.at_end == "repeat"
        check_series(made, network)
        return made


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
        raise ProfileError(f"{book.source(error)}{error}") from error


def make_objective(
    document: Document,
    key: tuple[str | int, ...],
    spec: Spec,
    basis: Basis,
    convert: Mapping[Any, Callable[[Any], Any]] | None = None,
) -> Objective:
    """Create an objective, or the weighted sum of several.

    Parameters
    ----------
    key
        Path of keys to it in the file.
    basis
        What the values of quantities with units depend on.
    convert
        Converters from values of the file to objects, by type; see :func:`opfmodel.plugins.make`.
    """
    if not isinstance(spec, list):
        name, options = _single(document, key, spec)
        with document.located(*key, *((name,) if isinstance(spec, dict) else ())):
            made = plugins.make("objective", name, options, convert, context=basis)
            assert isinstance(made, Objective)
            return made
    parts: list[tuple[float, Objective]] = []
    for number, part in enumerate(spec):
        rest = part if isinstance(part, str) else {k: v for k, v in part.items() if k != "weight"}
        weight = 1.0 if isinstance(part, str) else part.get("weight", 1.0)
        with document.located(*key, number, "weight"):
            weight = number_within("weight", weight, at_least=0)
        parts.append((weight, make_objective(document, (*key, number), rest, basis, convert)))
    if not parts:
        raise document.error(key, "needs at least one objective")
    return WeightedSum(parts)


def make_forecast(document: Document, settings: ScenarioFile) -> Forecast:
    """Create the controller's forecast of the series."""
    name, options = _single(document, ("forecast",), settings.forecast)
    key = ("forecast", name) if isinstance(settings.forecast, dict) else ("forecast",)
    with document.located(*key):
        made = plugins.make(
            "forecast",
            name,
            options,
            {Path: lambda value: document.path.parent / str(value)},
            context=settings.basis,
        )
        assert isinstance(made, Forecast)
        return made


def make_scenarios(document: Document, settings: ScenarioFile) -> Scenarios | None:
    """Create the futures that the controller plans for; None for the forecast alone."""
    section, at = settings.controller.scenarios, ("controller", "scenarios")
    if section is None:
        return None
    cases = {}
    for case, stated in section.cases.items():
        check_printable(document, (*at, "cases", case), case)
        rules = []
        for number, spec in enumerate(stated.profiles):
            key = (*at, "cases", case, "profiles", number)
            name, options = _single(document, key, spec)
            with document.located(*key, name):
                rules.append(plugins.make("profile", name, options))
        cases[case] = Case(stated.probability, rules)
    with document.located(*at):
        draw = None if section.draw is None else Draw(**section.draw.model_dump())
        return Scenarios(section.common, cases, draw, document.path.parent)


def make_horizon(document: Document, settings: ScenarioFile, scenarios: Scenarios | None) -> Horizon:
    """Create the nodes in time of the plans."""
    step = settings.time.step
    hours = settings.controller.lengths(step)
    with document.located("controller", "horizon"):
        grid = Horizon.grid(hours, step)
    if scenarios is None:
        return grid
    with document.located("controller", "scenarios"):
        return scenarios.horizon(hours, step)


def make_plant(settings: ScenarioFile) -> Plant:
    """Create the plant of a closed loop, without history."""
    section = settings.plant
    made = plugins.make(
        "plant", section.mode, section.model_extra or {}, beside=("mode",), context=settings.basis
    )
    assert isinstance(made, Plant)
    return made


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
    document: Document, key: tuple[str | int, ...], spec: str | dict[str, Any]
) -> tuple[str, dict[str, Any]]:
    """Return name and options of a plugin, given as ``name`` or ``{name: {option: value}}``."""
    if isinstance(spec, str):
        return spec, {}
    if len(spec) != 1:
        raise document.error(key, f"must be a name, or one name with its options, not {len(spec)} keys")
    name, options = next(iter(spec.items()))
    if options is not None and not isinstance(options, dict):
        raise document.error((*key, name), "the options must be a mapping")
    return name, options or {}
