"""What is kept of a run of a scenario: trajectories, summary and the independent check."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from opfmodel.scenario.scenario import Scenario
from opfmodel.simulation import Run

if TYPE_CHECKING:
    import xarray as xr

    from opfmodel.check import Report

__all__ = ["Results", "results_of"]


class Results(NamedTuple):
    """Results of a run.

    Attributes
    ----------
    data
        Trajectories; None without a completed step.
    summary
        Key figures of the run and of its check.
    report
        The independent check of the trajectories; None without a completed step.
    """

    data: xr.Dataset | None
    summary: dict[str, Any]
    report: Report | None


def results_of(scenario: Scenario, run: Run) -> Results:
    """Check the trajectories of a run, and return what :func:`opfmodel.results.save` writes."""
    report = run.check()
    data = run.data.assign_attrs(scenario=scenario.name) if run.steps else None
    return Results(data, {"scenario": scenario.name, **run.checked(report)}, report)
