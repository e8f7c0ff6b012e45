"""A scenario that has been read and validated."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.data.grid import Grid
from opfmodel.data.series import Profiles
from opfmodel.errors import IncompatibleError
from opfmodel.forecasts import Forecast, Scenarios
from opfmodel.model import Elastic
from opfmodel.network.network import Network
from opfmodel.objectives.base import Objective
from opfmodel.plan import MultiStage
from opfmodel.plan.commitment import committed_ahead
from opfmodel.plan.single_stage import SingleStageSequence, single_stage_sequence
from opfmodel.scenario.document import Document
from opfmodel.scenario.parts import make_plant
from opfmodel.scenario.schema import ScenarioFile
from opfmodel.simulation import Checkpoint, Controller, Plant, Run, check_first_stage, simulate

__all__ = ["Scenario"]


@dataclass(frozen=True, eq=False)
class Scenario:
    """A scenario that has been read and validated.

    Attributes
    ----------
    name
        Name of the scenario, followed by that of the variant, if any.
    document
        The file, with the positions of its keys and of those of the variant.
    problem
        The multi-stage problem of the controller; compiled when first solved.
    cost
        Objective with which realised costs are evaluated.
    forecast
        The controller's forecast of the profiles.
    scenarios
        The futures that the controller plans for; None for the forecast alone.
    settings
        Validated content of the file.
    grid
        The steps that the time series cover.
    """

    name: str
    document: Document
    problem: MultiStage
    cost: Objective
    forecast: Forecast
    scenarios: Scenarios | None
    settings: ScenarioFile
    grid: Grid
    _sequences: dict[int, SingleStageSequence] = field(default_factory=dict)

    @property
    def path(self) -> Path:
        """The scenario file."""
        return self.document.path

    @property
    def network(self) -> Network:
        """The declared network."""
        return self.problem.network

    @property
    def profiles(self) -> Profiles:
        """The actual time series."""
        return self.problem.profiles

    @property
    def steps(self) -> int:
        """Number of steps of the closed loop."""
        return self.settings.time.steps

    @property
    def published(self) -> dict[str, float]:
        """Costs reported in the literature for this scenario, $."""
        published = self.settings.published
        return {} if published is None else published.model_dump(exclude={"source"}, exclude_none=True)

    @property
    def elastic(self) -> Elastic:
        """Violation prices for infeasible problems."""
        return Elastic(**self.settings.controller.elastic.model_dump())

    @property
    def starts_from_single_stage(self) -> bool:
        """Whether the first problem starts from the single-stage AC optimum; otherwise it is free."""
        controller = self.settings.controller
        default = "single-stage" if controller.generator_delay == 1 else "free"
        return (controller.initial_dispatch or default) == "single-stage"

    def initial(self) -> dict[str, npt.NDArray[np.float64]] | None:
        """Return the dispatch from which the first problem starts, in physical units; None if free.

        The single-stage optimum always uses the AC equations, so all formulations start from the
        same dispatch.

        Raises
        ------
        OpfmodelError
            The single-stage problem of the first step has no solution.
        """
        if not self.starts_from_single_stage:
            return None
        data = self.single_stages(1).data
        names = ("pg", "qg") if self.problem.formulation.reactive else ("pg",)
        return {name: np.asarray(data[name].values[0]) for name in names}

    def single_stages(self, steps: int) -> SingleStageSequence:
        """Return the single-stage AC optima of the first steps under the objective ``cost``.

        Raises
        ------
        OpfmodelError
            A step has no solution.
        """
        if steps not in self._sequences:
            self._sequences[steps] = single_stage_sequence(self.single_stage(), steps)
        return self._sequences[steps]

    def single_stage(self) -> MultiStage:
        """Return the problem of a single stage with the AC equations and the objective ``cost``."""
        return MultiStage(
            self.network, step=self.settings.time.step, objective=self.cost, profiles=self.profiles
        )

    def plant(self) -> Plant:
        """Return a new plant, without history."""
        return make_plant(self.settings)

    def check_forecast(self) -> None:
        """Raise :class:`ScenarioError` if the first or the last forecast of the loop cannot be made."""
        steps = sorted({0, self.steps - 1})
        with self.document.located("forecast"):
            controller = Controller(self.problem, self.forecast)
            for time in steps:
                controller.expected(time)
        if self.scenarios is not None:
            with self.document.located("controller", "scenarios"):
                controller = Controller(self.problem, self.forecast, scenarios=self.scenarios)
                for time in steps:
                    controller.expected(time)

    def committed_problem(self) -> MultiStage:
        """Return the problem of the closed loop: with the status of the units if the controller commits them.

        They are committed once, before the loop, over all steps that its plans see. So the commitment knows
        the realised series, and forecasts must be perfect.

        Raises
        ------
        ScenarioError
            The forecast is not perfect, or there is no commitment.
        """
        problem, forecast = self.problem, self.forecast
        if self.settings.controller.commit == "declared":
            return problem
        with self.document.located("controller", "commit"):
            if not forecast.perfect:
                raise IncompatibleError(
                    f"milp: needs a perfect forecast in a closed loop, not {type(forecast).__name__}: units "
                    "are committed for the realised series; or state the series that opfmodel.commit returns"
                )
            return committed_ahead(problem, self.steps, self.initial())

    def loop(self) -> dict[str, Any]:
        """Return the arguments of :func:`opfmodel.simulate` for the closed loop, with a new plant.

        Raises
        ------
        ScenarioError
            The first or the last forecast of the loop cannot be made; the message gives the position
            of the key ``forecast``.
        """
        with self.document.located("controller"):
            check_first_stage(self.problem)
        self.check_forecast()
        controller = Controller(
            self.committed_problem(),
            self.forecast,
            self.settings.controller.on_infeasible,
            self.elastic,
            self.scenarios,
        )
        return {
            "controller": controller,
            "plant": self.plant(),
            "steps": self.steps,
            "initial": self.initial(),
            "objective": self.cost,
        }

    def checkpoint(self, folder: str | Path) -> Checkpoint:
        """Return a folder for the checkpoints of the loop, which are as frequent as the file states."""
        return Checkpoint(folder, **self.settings.checkpoint.model_dump())

    def simulate(self, progress: bool = False, checkpoint: str | Path | Checkpoint | None = None) -> Run:
        """Run the closed loop of the scenario.

        Parameters
        ----------
        progress, checkpoint
            As for :func:`opfmodel.simulate`; checkpoints in a folder are as frequent as the file states.

        Raises
        ------
        ScenarioError
            As for :meth:`loop`.
        """
        kept = self.checkpoint(checkpoint) if isinstance(checkpoint, str | Path) else checkpoint
        return simulate(**self.loop(), progress=progress, checkpoint=kept)
