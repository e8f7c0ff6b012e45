"""The record of a closed loop."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from opfmodel.model import NumericStage
from opfmodel.objectives.base import Objective
from opfmodel.plan import Initial, MultiStage
from opfmodel.plugins.versions import versions
from opfmodel.results import dataset
from opfmodel.results.presented import Presented
from opfmodel.results.store import save
from opfmodel.simulation.outages import Outages
from opfmodel.simulation.plants.base import Step
from opfmodel.simulation.records import summarise

if TYPE_CHECKING:
    import xarray as xr

    from opfmodel.check import Report

__all__ = ["Run"]

Array = npt.NDArray[np.float64]


@dataclass
class Run(Presented):
    """A closed loop, finished or not.

    Attributes
    ----------
    status
        ``running``; then ``done``, the status of the plan that failed, ``unsolved`` if the plant
        found no solution in some step, or ``stopped``. Completed steps are always kept.
    termination
        Why the run ended.
    initial
        State at the first step, in physical units.
    infeasible
        Whether it ended because a plan was infeasible.
    interrupted
        Whether it ended by Ctrl-C.
    outages
        The outages that happen.
    """

    problem: MultiStage
    objective: Objective
    plans: list[dict[str, Any]] = field(default_factory=list)
    steps: list[Step] = field(default_factory=list)
    status: str = "running"
    termination: str = "the loop is still running"
    infeasible: bool = False
    interrupted: bool = False
    build_seconds: float = 0.0
    initial: Initial | None = None
    outages: Outages = field(default_factory=Outages)
    _finished: xr.Dataset | None = field(default=None, repr=False)

    def __repr__(self) -> str:
        cost = "no cost" if np.isnan(self.cost) else f"{self.cost:.6g} {self.problem.network.currency}"
        return f"Run({self.problem.network.name!r}: {len(self.steps)} steps, {self.status}, {cost})"

    def finish(self) -> None:
        """Set the status of a loop that completed all its steps."""
        unsolved = [number for number, step in enumerate(self.steps) if not step.solved]
        if unsolved:
            first = unsolved[0]
            self.status = "unsolved"
            self.termination = (
                f"the plant found no solution in {len(unsolved)} of {len(self.steps)} steps, "
                f"first in {self.problem.step_name(first)}: {self.steps[first].status}"
            )
        else:
            self.status, self.termination = "done", "all steps done"

    def _stage(self) -> NumericStage:
        """Return the realised quantities as numbers in per unit."""
        network = self.problem.window(0, len(self.steps), self.objective)
        # violations of soft limits exist only in the steps of elastic plans
        absent = {key: np.zeros_like(value) for step in self.steps for key, value in step.values.items()}
        values = {
            key: np.column_stack([step.values.get(key, zero) for step in self.steps])
            for key, zero in absent.items()
        }
        network = self.outages.without_costs(network, range(len(self.steps)), self.problem.step)
        return NumericStage(network, self.problem.step, values, self.problem.model.costed)

    @property
    def previous_pg(self) -> dict[str, float] | None:
        """Dispatch in MW before the first step; None if the first step was not ramp-limited from one."""
        before = (self.initial or {}).get("pg")
        if before is None or self.problem.generator_delay == 1:
            return None
        names = self.problem.arrays.generator.names
        return dict(zip(names, np.asarray(before, dtype=float).tolist(), strict=True))

    @property
    def cost_rate(self) -> Array:
        """Stage cost of the realised trajectory, $/h; NaN in steps without a solution of the plant."""
        return self._cost_rate(self._stage()) if self.steps else np.zeros(0)

    def _cost_rate(self, stage: NumericStage) -> Array:
        cost = self.objective.stage_cost(stage)
        rate = np.zeros(len(self.steps)) if cost is None else np.asarray(cost, dtype=float)
        return np.where([step.solved for step in self.steps], rate, np.nan)

    @property
    def cost(self) -> float:
        """Realised cost over all steps, $; NaN unless the plant found a solution in each."""
        return float(self.cost_rate.sum()) * self.problem.step

    @property
    def data(self) -> xr.Dataset:
        """Realised trajectories in physical units and the effort of each step, up to the current one."""
        if self.status == "running":  # still growing: do not cache
            return self._dataset()
        if self._finished is None:
            self._finished = self._dataset()
        return self._finished

    def _dataset(self) -> xr.Dataset:
        stage = self._stage()
        rate = self._cost_rate(stage)
        described = {name: text for step in self.steps for name, text in step.described.items()}
        quantities = {name: (kind, *described[name], stage.values[kind, name]) for kind, name in stage.values}
        made = dataset(stage.network, quantities, self.problem.times(0, len(self.steps)))
        currency = stage.network.currency
        made["cost_rate"] = ("time", rate, {"units": f"{currency}/h", "long_name": "stage cost"})
        for key, unit in (("solve_seconds", "s"), ("iterations", ""), ("plan_objective", currency)):
            values = np.array([plan[key] for plan in self.plans[: len(self.steps)]], dtype=float)
            made[key] = ("time", values, {"units": unit, "long_name": key.replace("_", " ")})
        for key, words in (
            ("plan_status", [plan["status"] for plan in self.plans[: len(self.steps)]]),
            ("plant_status", [step.status for step in self.steps]),
        ):
            made[key] = ("time", np.array(words, dtype=str), {"long_name": key.replace("_", " ")})
        controller = self.problem.formulation.name
        if self.outages.events:
            made.attrs["outage_rating"] = self.outages.rating
        made.attrs |= {
            "network": self.problem.network.name,
            "formulation": self.steps[-1].formulation if self.steps else controller,
            "controller_formulation": controller,
            "objective": type(self.problem.objective).__name__,
            "status": self.status,
            "termination": self.termination,
            "step_hours": self.problem.step,
            "cost": float(rate.sum()) * self.problem.step,
        }
        return made

    def summary(self) -> dict[str, Any]:
        """Return the key figures of the run, None for an unknown cost or uncounted iterations."""
        seconds = [plan["solve_seconds"] for plan in self.plans]
        iterations = [plan["iterations"] for plan in self.plans if plan["iterations"] is not None]
        return {
            "status": self.status,
            "termination": self.termination,
            "cost": None if not self.steps or np.isnan(self.cost) else self.cost,
            "steps": len(self.steps),
            "build_seconds": self.build_seconds,
            "solve_seconds_mean": float(np.mean(seconds)) if seconds else 0.0,
            "solve_seconds_max": float(np.max(seconds)) if seconds else 0.0,
            "iterations_mean": float(np.mean(iterations)) if iterations else None,
            "retries": {
                str(step): [f"{a['start']} ({a['solver']}): {a['status']}" for a in plan["attempts"]]
                for step, plan in enumerate(self.plans)
                if len(plan["attempts"]) > 1
            },
            "elastic_steps": sum(plan["status"] == "elastic" for plan in self.plans),
            "diagnosis": {
                str(step): plan["diagnosis"] for step, plan in enumerate(self.plans) if plan["diagnosis"]
            },
            **self.outages.summary(len(self.steps), self.problem.step),
            **summarise(self.problem, self.steps),
        }

    def check(self) -> Report | None:
        """Recompute constraints and costs of the realised trajectories; None without a completed step."""
        from opfmodel.check import check

        if not self.steps:
            return None
        problem = self.problem
        return check(problem.network, self.data, problem.profiles, previous_pg=self.previous_pg)

    def record(self) -> dict[str, Any]:
        """Return the key figures with those of the independent check, as ``summary.json`` has them."""
        return self.checked(self.check())

    def checked(self, report: Report | None) -> dict[str, Any]:
        """Return the key figures with those of a check."""
        return {
            **self.summary(),
            "currency": self.problem.network.currency,
            "max_violation": None if report is None else report.max_violation,
            "violations": {} if report is None else report.as_dict(),
            "unchecked": [] if report is None else list(report.unchecked),
            "versions": versions(),
        }

    def save(self, folder: str | Path) -> None:
        """Write ``trajectories.nc`` and ``summary.json`` to a folder, from which ``opfmodel.load_run`` reads.

        Raises
        ------
        ResultError
            The folder cannot be written.
        """
        save(self.data if self.steps else None, self.record(), Path(folder))
