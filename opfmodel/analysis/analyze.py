"""All checks of a scenario, by name."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from opfmodel.analysis.dissipativity import STATEMENT as DISSIPATIVITY
from opfmodel.analysis.dissipativity import check_dissipativity
from opfmodel.analysis.finding import Finding, Verdict
from opfmodel.analysis.performance_bound import STATEMENT as PERFORMANCE
from opfmodel.analysis.performance_bound import check_performance_bound
from opfmodel.analysis.practical_stability import STATEMENT as STABILITY
from opfmodel.analysis.practical_stability import check_practical_stability
from opfmodel.analysis.progress import Advance, silent
from opfmodel.analysis.recursive_feasibility import STATEMENT as FEASIBILITY
from opfmodel.analysis.recursive_feasibility import check_recursive_feasibility
from opfmodel.analysis.steady_state import STATEMENT as STEADY
from opfmodel.analysis.steady_state import check_steady_state
from opfmodel.analysis.subject import NoSteadyStateError, Subject
from opfmodel.analysis.turnpike import STATEMENT as TURNPIKE
from opfmodel.analysis.turnpike import check_turnpike
from opfmodel.errors import ModelError, nearest, shown
from opfmodel.network.bounds import integer
from opfmodel.scenario import Scenario

__all__ = ["CHECKS", "Analysis", "analyze"]


@dataclass(frozen=True, repr=False)
class Analysis:
    """What the checks of a scenario found.

    Attributes
    ----------
    scenario
        Name of the scenario.
    step
        Step whose demand was held constant.
    checks
        Findings by name of the check.
    """

    scenario: str
    step: int
    checks: Mapping[str, Finding]

    def __repr__(self) -> str:
        verdicts = ", ".join(f"{name}: {finding.verdict.value}" for name, finding in self.checks.items())
        return f"Analysis({self.scenario!r}, step {self.step}: {verdicts})"

    @property
    def violated(self) -> bool:
        """Whether a check is violated."""
        return any(finding.verdict is Verdict.VIOLATED for finding in self.checks.values())

    def as_dict(self) -> dict[str, Any]:
        """Return the analysis as plain values."""
        checks = {name: finding.as_dict() for name, finding in self.checks.items()}
        return {"scenario": self.scenario, "step": self.step, "checks": checks}


@dataclass(frozen=True, eq=False)
class _Work:
    """A scenario and what its checks share."""

    scenario: Scenario
    step: int
    horizons: Sequence[int] | None
    advance: Advance

    @cached_property
    def subject(self) -> Subject:
        return Subject(self.scenario.problem, self.step, self.advance)

    def steady_state(self) -> Finding:
        subject = self.subject
        x = subject.stored(0.5)
        given = self.scenario.problem.arrays.storage.initial[:, 0] * subject.unit
        for state in subject.states:
            if state.name == "e":
                x[state.where] = np.where(np.isfinite(given), given, x[state.where])
        return check_steady_state(subject, x)

    def recursive_feasibility(self) -> Finding:
        self.advance("the closed loop of the scenario")
        run = self.scenario.simulate()
        return check_recursive_feasibility(self.scenario.problem, run, self.advance)


# The checks in the order of the paper, what they test, and how they are run.
CHECKS: Mapping[str, tuple[str, Callable[[_Work], Finding]]] = {
    "steady_state": (STEADY, _Work.steady_state),
    "dissipativity": (DISSIPATIVITY, lambda work: check_dissipativity(work.subject)),
    "turnpike": (TURNPIKE, lambda work: check_turnpike(work.subject, work.horizons)),
    "practical_stability": (STABILITY, lambda work: check_practical_stability(work.subject)),
    "recursive_feasibility": (FEASIBILITY, _Work.recursive_feasibility),
    "performance_bound": (PERFORMANCE, lambda work: check_performance_bound(work.subject)),
}


def analyze(
    scenario: Scenario,
    only: str | Iterable[str] = (),
    *,
    step: int = 0,
    horizons: Sequence[int] | None = None,
    advance: Advance = silent,
) -> Analysis:
    """Check by numbers what the theory of economic NMPC promises for a scenario.

    Sources: Faulwasser and Engelmann (2019), by the numbers of their statements.

    Parameters
    ----------
    only
        Name or names of the checks, of :data:`CHECKS`; all of them by default.
    step
        Step whose demand, limits and costs are held constant where the theory assumes a constant disturbance.
    horizons
        Horizons of the turnpike, in steps; by default to well beyond the expected arcs.
    advance
        Called as work progresses, with what is being done.

    Raises
    ------
    ModelError
        A check is unknown, the step is beyond the data, or there are not two horizons.

    Examples
    --------
    >>> from pathlib import Path
    >>> import opfmodel as om
    >>> scenario = om.load_scenario(Path("scenarios/case5-step.yaml"))
    >>> om.analyze(scenario, ["performance_bound"]).checks["performance_bound"].verdict.value
    'holds'
    """
    if not isinstance(scenario, Scenario):
        raise ModelError(f"scenario = {shown(scenario)}: must be a Scenario; see load_scenario")
    wanted = list(dict.fromkeys([only] if isinstance(only, str) else only)) or list(CHECKS)
    for name in wanted:
        if name not in CHECKS:
            raise ModelError(f"check {name!r}: no such check; {nearest(name, CHECKS)}")
    known = scenario.profiles.length
    integer("step", step, at_least=0)
    if known is not None and step >= known:
        raise ModelError(f"step = {step}: the time series have {known} steps, 0 to {known - 1}")
    for horizon in horizons or ():
        integer("horizons", horizon, at_least=2)
    if horizons is not None and len(set(horizons)) < 2:
        raise ModelError(
            f"horizons = {shown(list(horizons))}: must be at least two different numbers of steps"
        )
    work = _Work(scenario, step, None if horizons is None else sorted(set(horizons)), advance)
    findings = {}
    for name in wanted:
        statement, check = CHECKS[name]
        try:
            findings[name] = check(work)
        except NoSteadyStateError as error:
            absent = name == "steady_state" and error.proven
            missing = Verdict.VIOLATED if absent else Verdict.UNDECIDED
            findings[name] = Finding(missing, statement, str(error), 0.0)
    return Analysis(scenario.name, step, findings)
