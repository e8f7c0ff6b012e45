"""The paper's figures of closed-loop trajectories for its four systems, and what it says of them.

benchmarks.paper writes them to docs/figures/ and describes them in docs/paper-table.md.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from PIL import Image

from opfmodel.results import binding
from opfmodel.results.figures import paper

FOLDER = Path(__file__).parent.parent / "docs" / "figures"
HIGH, LOW = slice(8, 16), slice(30, 41)  # steps of high and low demand in the paper
_COLOURS = 128  # of an image, which a quarter of the bytes then suffices for
_MOST_NAMES = 8
_UNSTATED = "(not mentioned)"
_ACTIVE = 1e-3  # MW; less charging power is none


@dataclass(frozen=True)
class Shown:
    """A figure: its scenario, what it shows, and the buses that the paper selects."""

    scenario: str
    heading: str
    buses: tuple[str, ...] | None = None

    @property
    def steps(self) -> bool:
        """Whether the demand is constant but for two steps."""
        return self.scenario.endswith("-step")

    @property
    def file(self) -> Path:
        """File of the figure."""
        return FOLDER / f"paper-{self.scenario}.png"

    @property
    def command(self) -> str:
        """The command that draws it."""
        chosen = "" if self.buses is None else f" --buses {','.join(self.buses)}"
        return f"opfmodel plot results/{self.scenario} --paper{chosen}"


SELECTED = ("21", "59", "89", "116")
FIGURES = (
    Shown("case5-step", "5-bus system, demand steps"),
    Shown("case5-random", "5-bus system, random demand"),
    Shown("case118-step", "118-bus system, demand steps", SELECTED),
    Shown("case118-random", "118-bus system, random demand", SELECTED),
)


def section(runs: dict[str, xr.Dataset]) -> str:
    """Draw the figure of every run by scenario, and return what the paper and the runs say of each."""
    parts = []
    for shown in (figure for figure in FIGURES if figure.scenario in runs):
        data = runs[shown.scenario]
        draw(shown, data)
        rows = "\n".join(f"| {paper_says} | {found} |" for paper_says, found in facts(shown, data))
        parts.append(
            f"### {shown.heading}\n\n    {shown.command}\n\n"
            f"![Closed loop of the {shown.heading}](figures/{shown.file.name})\n\n"
            f"| the paper | {shown.scenario} |\n| --- | --- |\n{rows}"
        )
    return "\n\n".join(parts)


def draw(shown: Shown, data: xr.Dataset) -> None:
    """Write the figure of a run as a PNG of few colours."""
    stream = io.BytesIO()
    paper(data, shown.buses).savefig(stream, format="png", dpi=150)
    image = Image.open(stream).convert("RGB").quantize(_COLOURS, dither=Image.Dither.NONE)
    image.save(shown.file, optimize=True)


def facts(shown: Shown, data: xr.Dataset) -> Iterator[tuple[str, str]]:
    """Yield what the paper says of a figure, and what the data have of it."""
    at_limit = binding(data)
    yield _shifting(shown, data)
    if shown.scenario == "case5-step":
        yield _fast_ramp(data)
    yield _ramps(shown, data, at_limit)
    yield _voltages(shown, data, at_limit)
    yield (
        "P^g - P^d - P^s - P^loss = 0 for all t",
        f"at most {np.abs(balance(data)).max():.0e} MW, with P^loss summed over the flows of all branches",
    )
    yield _UNSTATED, _storages(data, at_limit)


def balance(data: xr.Dataset) -> np.ndarray:
    """Return P^g - P^d - P^s - P^loss in every step, MW, with the losses of the branches from their flows."""
    losses = (data["pf"] + data["pt"]).sum("branch")
    left = data["pg"].sum("generator") - data["pd"].sum("bus") - data["ps"].sum("storage") - losses
    return np.asarray(left.values)


def _shifting(shown: Shown, data: xr.Dataset) -> tuple[str, str]:
    charging, demand = data["ps"].sum("storage").values, data["pd"].sum("bus").values
    if shown.steps:
        claim = "storages discharge in high demand (t = 8 … 15) and charge in low demand (t = 30 … 40)"
        (high, discharged), (low, charged) = _mean(charging[HIGH]), _mean(charging[LOW])
        return claim, (
            f"P^s is {high} MW on average at t = 8 … 15 ({discharged}), {low} MW at t = 30 … 40 ({charged}); "
            f"storages that charge in high demand: {_against(data, HIGH, 1)}, "
            f"that discharge in low demand: {_against(data, LOW, -1)}"
        )
    claim = "energy is shifted from low to high demand"
    if "case5" in shown.scenario:
        claim += ", as at t = 20 … 35"
    above = demand > demand.mean()
    (high, discharged), (low, charged) = _mean(charging[above]), _mean(charging[~above])
    return claim, (
        f"P^s is {high} MW on average in the {above.sum()} steps with demand above its mean ({discharged}), "
        f"{low} MW in the others ({charged})"
    )


def _mean(charging: np.ndarray) -> tuple[str, str]:
    """Return the mean power and how many steps have its sign."""
    mean = charging.mean()
    word = "charging" if mean > 0 else "discharging"
    same = (np.sign(mean) * charging > _ACTIVE).sum()
    return f"{mean:+.1f}", f"{word} in {same} of {charging.size} steps"


def _against(data: xr.Dataset, steps: slice, sign: int) -> str:
    """Return how many storages have a mean power of a sign in some steps, opposite to that of their sum."""
    means = sign * data["ps"].isel(time=steps).mean("time")
    return f"{int((means > _ACTIVE).sum())} of {means.size}"


def _fast_ramp(data: xr.Dataset) -> tuple[str, str]:
    charging = data["ps"].sum("storage").values
    return (
        "at t = 30, storage ramps from -0.2 p.u. to 0.2 p.u. (from -20 MW to 20 MW) in one step",
        f"P^s changes from {charging[29]:.1f} MW to {charging[30]:.1f} MW",
    )


def _ramps(shown: Shown, data: xr.Dataset, at_limit: xr.Dataset) -> tuple[str, str]:
    claim = "ramp limits of generators are active"
    if shown.scenario == "case5-step":
        claim += " at the demand steps, t = 30 and t = 40"
    active = at_limit["pg_ramp"] != 0
    where = {
        str(unit): np.flatnonzero(active.sel(generator=unit).values).tolist()
        for unit in data["generator"].values
    }
    where = {unit: steps for unit, steps in where.items() if steps}
    steps = int(active.any("generator").sum())
    if not where:
        share = np.abs(data["pg"].diff("time")) / data["pg_ramp"]
        largest = share.max("time").idxmax("generator").item()
        jump = np.abs(data["pd"].sum("bus").diff("time")).max().item()
        return claim, (
            f"at no step; the largest change is {100 * share.max().item():.0f} % of the limit, of {largest}. "
            f"Demand changes by {jump:,.0f} MW at most, and storages can charge or discharge "
            f"{data['ps_max'].sum().item():,.0f} MW"
        )
    listed = "; ".join(f"{unit} at t = {_numbers(ts)}" for unit, ts in where.items())
    if sum(map(len, where.values())) > _MOST_NAMES:
        listed = ", ".join(f"{unit} ({len(ts)})" for unit, ts in where.items())
        listed = f"at {steps} of {active.sizes['time'] - 1} steps; steps by unit: {listed}"
    return claim, listed


def _voltages(shown: Shown, data: xr.Dataset, at_limit: xr.Dataset) -> tuple[str, str]:
    claim = "upper limits of voltages are active" if "118" in shown.scenario else _UNSTATED
    upper = at_limit["vm"] > 0
    buses = [str(bus) for bus in data["bus"].values[upper.any("time").values]]
    count = upper.sum("bus").values
    number = f"{count.min()}" if count.min() == count.max() else f"{count.min()} to {count.max()}"
    named = f"buses {_numbers(buses)}" if len(buses) > 1 else f"bus {_numbers(buses)}"
    lower = int((at_limit["vm"] < 0).any("time").sum())
    return claim, (
        f"at the upper limit: {number} of {data.sizes['bus']} buses in each step, {named} over all steps; "
        f"at the lower limit: {lower or 'none'}"
    )


def _storages(data: xr.Dataset, at_limit: xr.Dataset) -> str:
    full, empty = ((at_limit["e"] == side).any("time").sum().item() for side in (1, -1))
    first, last = data["e"][0].sum().item(), data["e_next"][-1].sum().item()
    return (
        f"of {data.sizes['storage']} storages, {empty or 'none'} are empty and {full or 'none'} full "
        f"at the end of some step; E starts at {first:,.0f} MWh and ends at {last:,.0f} MWh"
    )


def _numbers(items: Sequence[object]) -> str:
    *others, last = map(str, items) if items else ("none",)
    return f"{', '.join(others)} and {last}" if others else last
