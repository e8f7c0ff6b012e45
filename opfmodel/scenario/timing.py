"""The ``time`` section of a scenario file, completed from time series that came with the network."""

from __future__ import annotations

from opfmodel.data.calendar import Calendar, parse_stamp, zone_of
from opfmodel.data.grid import Grid
from opfmodel.network.network import Network
from opfmodel.scenario.document import Document
from opfmodel.scenario.schema import ScenarioFile

__all__ = ["completed", "settled"]


def settled(document: Document, settings: ScenarioFile, network: Network) -> tuple[ScenarioFile, Grid]:
    """Return the settings with a number of steps, and the steps that the time series cover.

    Where the section states no start, zone, step or number of steps, these are those of the time series
    attached to the network; start and step may then still be those of a file.

    Raises
    ------
    ScenarioError
        The start is not a time in the zone, or the attached series have another step or begin later.
    """
    time, stated = settings.time, settings.time.model_fields_set
    attached = network.profiles
    own = attached.calendar
    zone = time.zone if time.zone is not None or own is None else own.zone
    with document.located("time", "zone"):
        zone_of(zone or "UTC")
    start = None if own is None else own.start
    if time.start is not None:
        with document.located("time", "start"):
            start = parse_stamp(time.start, zone or "UTC")
    step = time.step if "step" in stated else None if own is None else own.step
    lead = 0
    if own is not None and start is not None and step is not None:
        with document.located("time", "start" if own.has_step(step) else "step"):
            lead = own.steps_until(Calendar(start, step, own.zone))
    if step is not None:
        time = time.model_copy(update={"step": step})
        settings = settings.model_copy(update={"time": time})
    if attached.length is not None and "steps" not in stated:
        ahead = settings.ahead - 1 if time.at_end == "error" else 0
        time = time.model_copy(update={"steps": max(attached.length - lead - ahead, 1)})
        settings = settings.model_copy(update={"time": time})
    return settings, Grid(settings.length, step, start, zone, time.at_end, time.steps)


def completed(document: Document, settings: ScenarioFile, grid: Grid) -> ScenarioFile:
    """Return the settings with the step of the time series.

    Raises
    ------
    ScenarioError
        A zone is stated, but neither a start nor a series with time stamps; or the hours of the stages are
        stated, but not the step.
    """
    if settings.time.zone is not None and grid.calendar is None:
        raise document.error(
            ("time", "zone"), "there are no times: state time.start, or give a file a column of times"
        )
    if not isinstance(settings.controller.horizon, int) and grid.hours != settings.time.step:
        raise document.error(
            ("time", "step"),
            f"must be stated, {grid.hours:g} h as in the files, because controller.horizon gives hours",
        )
    return settings.model_copy(update={"time": settings.time.model_copy(update={"step": grid.hours})})
