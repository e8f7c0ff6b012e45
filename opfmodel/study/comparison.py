"""Economic control compared with single-stage optima and tracking, after Faulwasser and Engelmann."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from opfmodel.errors import OpfmodelError
from opfmodel.network.quantities import CURRENCY
from opfmodel.scenario import Scenario, load_scenario
from opfmodel.simulation import Run

__all__ = ["COSTS", "Comparison", "compare", "markdown", "rows"]

# Costs of closed loops that are variants of a scenario.
_VARIANTS = {"J_t": "setpoint-tracking", "J_b": "state-of-charge-tracking"}
COSTS = {
    "J_e": "closed loop with the scenario's controller",
    "J_s": "sum of single-stage optima, without storage and ramps",
    "J_t": "closed loop tracking the single-stage optima",
    "J_b": "closed loop tracking half-full storage",
}


@dataclass(frozen=True)
class Comparison:
    """Costs of one scenario under several controllers.

    Attributes
    ----------
    costs
        Costs by ``J_e``, ``J_s``, ``J_t``, ``J_b``; None if the scenario lacks the variant or a
        step failed.
    published
        Published costs that the scenario states.
    failures
        Errors behind missing costs, by name of the cost.
    currency
        Name of the currency of the costs.
    run
        Closed loop with the scenario's controller; None if it could not begin.
    """

    scenario: str
    costs: Mapping[str, float | None]
    published: Mapping[str, float]
    failures: Mapping[str, str]
    currency: str = CURRENCY
    run: Run | None = field(default=None, repr=False, compare=False)

    def as_dict(self) -> dict[str, Any]:
        """The comparison as plain data."""
        return {
            "scenario": self.scenario,
            **self.costs,
            "published": dict(self.published),
            "failures": dict(self.failures),
            "currency": self.currency,
        }

    def difference(self, name: str) -> float | None:
        """Return the relative difference from the published cost; None if either is missing."""
        cost, published = self.costs[name], self.published.get(name)
        return None if cost is None or published is None else cost / published - 1.0


def compare(path: str | Path, on_run: Callable[[str], None] | None = None) -> Comparison:
    """Run the closed loops of a scenario and of its tracking variants.

    Parameters
    ----------
    on_run
        Called with a short description before each run.

    Raises
    ------
    ScenarioError
        The file or one of its variants is invalid.
    KeyboardInterrupt
        The user pressed Ctrl-C during one of the runs.
    """
    costs: dict[str, float | None] = dict.fromkeys(COSTS)
    failures: dict[str, str] = {}
    report = on_run if on_run is not None else lambda _: None
    scenario = load_scenario(path)

    def loop(name: str, controlled: Scenario) -> Run | None:
        report(f"{controlled.name}: {COSTS[name]}")
        try:
            run: Run = controlled.simulate()
        except OpfmodelError as error:
            failures[name] = str(error)
            return None
        if run.interrupted:  # the loop returns normally; the comparison stops
            raise KeyboardInterrupt
        if run.status == "done":
            costs[name] = run.cost
        else:
            failures[name] = f"{run.status}: {run.termination}"
        return run

    economic = loop("J_e", scenario)
    try:
        costs["J_s"] = scenario.single_stages(scenario.steps).cost
    except OpfmodelError as error:
        failures["J_s"] = str(error)
    for name, variant in _VARIANTS.items():
        if variant in scenario.settings.variants:
            loop(name, load_scenario(path, variant))
    return Comparison(scenario.name, costs, scenario.published, failures, scenario.network.currency, economic)


def rows(comparisons: list[Comparison]) -> list[list[str]]:
    """Format costs in thousands: rows of computed costs, published costs and differences."""
    table = []
    for comparison in comparisons:
        table.append([comparison.scenario, *(_thousands(comparison.costs[name]) for name in COSTS)])
        if comparison.published:
            differences = (comparison.difference(name) for name in COSTS)
            table.append(["published", *(_thousands(comparison.published.get(name)) for name in COSTS)])
            table.append(["difference", *("–" if d is None else f"{100 * d:+.2f} %" for d in differences)])
    return table


def unit(comparisons: list[Comparison]) -> str:
    """Return the unit of the rows: ``k$``, or several if the scenarios are in different currencies."""
    return ", ".join(dict.fromkeys(f"k{comparison.currency}" for comparison in comparisons))


def markdown(comparisons: list[Comparison]) -> str:
    """Format comparisons as a Markdown table."""
    lines = [[unit(comparisons), *COSTS], ["---", *("---:" for _ in COSTS)], *rows(comparisons)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _thousands(cost: float | None) -> str:
    return "–" if cost is None else f"{cost / 1000:,.2f}"
