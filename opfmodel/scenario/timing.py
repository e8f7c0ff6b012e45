"""The ``time`` section of a scenario file, completed from time series that came with the network."""

from __future__ import annotations

from typing import Any

from opfmodel.data.calendar import Calendar, parse_stamp, zone_of
from opfmodel.network.network import Network
from opfmodel.scenario.document import Document
from opfmodel.scenario.schema import ScenarioFile

__all__ = ["settled"]


def settled(
    document: Document, settings: ScenarioFile, network: Network
) -> tuple[ScenarioFile, Calendar | None]:
    """Return the settings with a complete ``time`` section, and the calendar of the steps, if any.

    Where the section states no start, zone, step or number of steps, these are those of the time series
    attached to the network.

    Raises
    ------
    ScenarioError
        The start is not a time in the zone, or the attached series have another step, begin later or end
        earlier.
    """
    time, stated = settings.time, settings.time.model_fields_set
    attached = network.profiles
    own = attached.calendar
    zone = time.zone or ("UTC" if own is None else own.zone)
    with document.located("time", "zone"):
        zone_of(zone)
    step = own.step if own is not None and "step" not in stated else time.step
    calendar = None
    if time.start is not None:
        with document.located("time", "start"):
            calendar = Calendar(parse_stamp(time.start, zone), step, zone)
    elif own is not None:
        calendar = Calendar(own.start, step, zone)
    lead = 0
    if own is not None and calendar is not None:
        with document.located("time", "start" if own.has_step(step) else "step"):
            lead = own.steps_until(calendar)
    settled: dict[str, Any] = {"step": step}
    if attached.length is not None and "steps" not in stated:
        settled["steps"] = max(attached.length - lead - settings.controller.horizon + 1, 1)
    return settings.model_copy(update={"time": time.model_copy(update=settled)}), calendar
