"""A scenario that has been read and checked."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from opfmodel.data.series import Profiles
from opfmodel.forecasts.base import Forecast
from opfmodel.model import Elastic
from opfmodel.network.network import Network
from opfmodel.objectives.base import Objective
from opfmodel.plan import MultiStage
from opfmodel.plan.single_stage import SingleStageSequence, single_stage_sequence
from opfmodel.scenario.parts import make_plant
from opfmodel.scenario.schema import ScenarioFile
from opfmodel.simulation import Controller, Plant, Run, simulate

__all__ = ["Scenario"]


@dataclass(frozen=True, eq=False)
class Scenario:
    """A scenario that has been read and checked.

    Attributes
    ----------
    name
        Its name, with the variant if one was chosen.
    problem
        The multi-stage problem of the controller; compiled when it is first solved.
    cost
        The objective that realised costs are metered with.
    forecast
        What the controller expects of the profiles.
    settings
        The checked content of the file.
    """

    name: str
    path: Path
    problem: MultiStage
    cost: Objective
    forecast: Forecast
    settings: ScenarioFile
    _sequences: dict[int, SingleStageSequence] = field(default_factory=dict)

    @property
    def network(self) -> Network:
        """The declared network."""
        return self.problem.network

    @property
    def profiles(self) -> Profiles:
        """The time series, as they happen."""
        return self.problem.profiles

    @property
    def steps(self) -> int:
        """Number of steps of the closed loop."""
        return self.settings.time.steps

    @property
    def published(self) -> dict[str, float]:
        """Costs that the literature reports for the scenario, in $."""
        published = self.settings.published
        return {} if published is None else published.model_dump(exclude={"source"}, exclude_none=True)

    @property
    def elastic(self) -> Elastic:
        """Prices at which limits give way where a problem has no solution."""
        return Elastic(**self.settings.controller.elastic.model_dump())

    def initial(self) -> dict[str, npt.NDArray[np.float64]] | None:
        """The dispatch that the first problem starts from, in physical units; None leaves it free.

        A single-stage optimum is that of the AC equations whatever the controller's formulation, so
        that all formulations start from the same dispatch.

        Raises
        ------
        OpfmodelError
            The single-stage problem of the first step has no solution.
        """
        controller = self.settings.controller
        wanted = controller.initial_dispatch
        if wanted is None:
            wanted = "single-stage" if controller.generator_delay == 1 else "free"
        if wanted == "free":
            return None
        data = self.single_stages(1).data
        names = ("pg", "qg") if self.problem.formulation.reactive else ("pg",)
        return {name: np.asarray(data[name].values[0]) for name in names}

    def single_stages(self, steps: int) -> SingleStageSequence:
        """The AC optima of the first steps by themselves, with the costs that are metered.

        Raises
        ------
        OpfmodelError
            A step has no solution.
        """
        if steps not in self._sequences:
            problem = MultiStage(
                self.network, step=self.settings.time.step, objective=self.cost, profiles=self.profiles
            )
            self._sequences[steps] = single_stage_sequence(problem, steps)
        return self._sequences[steps]

    def plant(self) -> Plant:
        """What responds to the plans of the controller; a new one, without a past."""
        return make_plant(self.settings)

    def simulate(self, progress: bool = False) -> Run:
        """Run the closed loop of the scenario."""
        return simulate(
            Controller(self.problem, self.forecast, self.settings.controller.on_infeasible, self.elastic),
            self.plant(),
            steps=self.steps,
            initial=self.initial(),
            objective=self.cost,
            progress=progress,
        )
