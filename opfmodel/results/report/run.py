"""The page of a run or a plan."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from opfmodel.results.report.futures import Futures, futures
from opfmodel.results.report.grid import loading, network, prices, voltages
from opfmodel.results.report.happened import deviations, effort, outages
from opfmodel.results.report.moments import Moments
from opfmodel.results.report.page import Notes, Page, Section, Table, Tile, Tiles
from opfmodel.results.report.sheet import Sheet, amount
from opfmodel.results.report.units import dispatch, storage

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["report_page"]

_TOLERATED = 1e-5  # p.u.: solvers leave as much
_ATTRIBUTES = (
    "scenario", "network", "formulation", "controller_formulation", "objective", "step_hours", "status",
    "termination",
)  # fmt: skip


def report_page(
    data: xr.Dataset,
    summary: Mapping[str, Any] | None = None,
    analysis: Mapping[str, Any] | None = None,
    scenarios: Mapping[str, tuple[float, float, xr.Dataset]] | None = None,
) -> Page:
    """Return the page of a run or a plan.

    Parameters
    ----------
    data
        Trajectories over ``time``, those of the most probable scenario if there are several.
    summary
        Figures of the run, as ``summary.json`` has them.
    analysis
        Verdicts of the theory, as ``analysis.json`` has them.
    scenarios
        Probability, cost and trajectories of each scenario of a plan.
    """
    sheet = Sheet(Moments.of(data), summary or {})
    every: Futures = {
        name: (probability, cost, Sheet(Moments.of(own), sheet.summary))
        for name, (probability, cost, own) in (scenarios or {}).items()
    }
    made = [
        _overview(sheet),
        dispatch(sheet),
        prices(sheet),
        loading(sheet),
        voltages(sheet),
        storage(sheet),
        network(sheet),
        deviations(sheet),
        futures(every),
        outages(sheet),
        theory(analysis),
        effort(sheet),
        provenance(sheet),
    ]
    title = str(data.attrs.get("scenario") or data.attrs.get("network") or "run")
    stages, status = data.sizes["time"], sheet.summary.get("status", data.attrs.get("status", ""))
    about = f"{stages:,} {'stage' if stages == 1 else 'stages'}, {data.sizes['bus']:,} buses, {status}"
    return Page(title, about, [section for section in made if section is not None], sheet.arrays)


def theory(analysis: Mapping[str, Any] | None) -> Section | None:
    """The verdicts on what the theory of economic NMPC promises."""
    checks = (analysis or {}).get("checks") or {}
    if not checks:
        return None
    rows = [[name.replace("_", " "), each["verdict"], each["explanation"]] for name, each in checks.items()]
    return Section("Theory", [Table("What the theory promises", ["check", "verdict", "because"], rows)])


def provenance(sheet: Sheet) -> Section:
    """What the results were made from, and with which versions."""
    attributes, summary = sheet.data.attrs, sheet.summary
    rows: list[list[Any]] = [
        [name.replace("_", " "), str(attributes[name])] for name in _ATTRIBUTES if name in attributes
    ]
    if "trajectories_sha256" in summary:
        rows.append(["SHA-256 of the trajectories", summary["trajectories_sha256"]])
    parts = [Table("Run", ["what", "value"], rows)]
    versions = summary.get("versions") or {}
    if versions:
        parts.append(Table("Versions", ["package", "version"], [list(pair) for pair in versions.items()]))
    inputs = summary.get("inputs") or {}
    if inputs:
        parts.append(
            Table("Digests of the inputs", ["input", "digest"], [[k, str(v)] for k, v in inputs.items()])
        )
    return Section("Provenance", parts)


def _overview(sheet: Sheet) -> Section:
    warnings = list(_warnings(sheet))
    parts: list[Any] = [Notes(warnings)] if warnings else []
    parts.append(Tiles(list(_tiles(sheet))))
    if sheet.moments.note:
        parts.append(Notes([sheet.moments.note], mild=True))
    return Section("In short", parts)


def _warnings(sheet: Sheet) -> Iterator[str]:
    """What a reader must not miss."""
    summary = sheet.summary
    status = str(summary.get("status", "done"))
    if status not in ("done", "running") and "optimal" not in status:
        yield f"The run ended early: {status}: {summary.get('termination', '')}"
    violation = summary.get("max_violation")
    if violation is not None and violation > _TOLERATED:
        yield f"A limit is violated by {violation:.1e} p.u.; see Limits and redispatch."
    if summary.get("unsolved_steps"):
        yield f"The plant found no solution in {summary['unsolved_steps']} steps."
    if summary.get("elastic_steps"):
        yield f"In {summary['elastic_steps']} steps no plan met all limits; they have soft limits."
    for step, sentences in (summary.get("diagnosis") or {}).items():
        for sentence in sentences:
            yield f"Step {step}: {sentence}"
    yield from map(str, summary.get("notes") or ())


def _tiles(sheet: Sheet) -> Iterator[Tile]:
    """Figures in short."""
    data, summary = sheet.data, sheet.summary
    stages = np.ones(data.sizes["time"])
    hours = data["hours"].values if "hours" in data.coords else stages * data.attrs.get("step_hours", 1.0)
    currency, cost = str(summary.get("currency", "$")), summary.get("cost", data.attrs.get("cost"))
    demand = data["pd"].sum("bus").values
    energy = float(np.sum(demand * hours))

    def share(part: float) -> str:
        return f"{100 * part / energy:.2f} % of the demand" if energy > 0 else ""

    def total(values: Any) -> float:
        return float(np.sum(values * hours))

    yield Tile("cost", amount(cost, currency), f"over {float(hours.sum()):,g} h")
    yield Tile("demand", amount(energy, "MWh"), f"peak {amount(float(demand.max()), 'MW')}")
    if energy > 0 and cost is not None and np.isfinite(cost):
        yield Tile("cost per demand", amount(float(cost) / energy, f"{currency}/MWh"))
    if sheet.has("pf", "pt"):
        lost = total((data["pf"] + data["pt"]).sum("branch").values)
        yield Tile("branch losses", amount(lost, "MWh"), share(lost))
    if sheet.has("renewable_p"):
        made = total(data["renewable_p"].sum("renewable").values)
        yield Tile("renewable", amount(made, "MWh"), share(made))
    if sheet.has("e_next", "ps"):
        charged = total(np.clip(data["ps"].values, 0.0, None).sum(axis=1))
        left = float(data["e_next"].values[-1].sum())
        yield Tile("stored at the end", amount(left, "MWh"), f"{amount(charged, 'MWh')} charged")
    for key in ("redispatched_mwh", "shed_mwh", "curtailed_mwh"):
        if key in summary:
            yield Tile(key.removesuffix("_mwh"), amount(summary[key], "MWh"))
    if summary.get("max_violation") is not None:
        yield Tile("largest violation", f"{summary['max_violation']:.1e} p.u.", "by the independent check")
    if summary.get("solve_seconds_mean") is not None:
        iterations = summary.get("iterations_mean")
        note = "" if iterations is None else f", {iterations:.1f} iterations"
        yield Tile("solve time", f"{summary['solve_seconds_mean']:.3f} s", f"mean of a step{note}")
