"""Schema of scenario files; ``docs/scenarios.md`` documents the keys."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from opfmodel.model import Elastic
from opfmodel.network.bounds import STEP_HOURS
from opfmodel.simulation import OnInfeasible

__all__ = ["ScenarioFile", "Spec"]

Spec = str | dict[str, Any] | list[str | dict[str, Any]]


class Section(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class TimeSection(Section):
    step: float = Field(1.0, ge=STEP_HOURS[0], le=STEP_HOURS[1], description="hours")
    steps: int = Field(1, ge=1)


class EndSection(Section):
    cyclic: bool = False
    minimum: float = Field(0.0, ge=0, le=1)
    price: float = 0.0


class ElasticSection(Section):
    limit: float = Field(Elastic.limit, gt=0, allow_inf_nan=False, description="$/MWh")
    shedding: float = Field(Elastic.shedding, gt=0, allow_inf_nan=False)
    balance: float = Field(Elastic.balance, gt=0, allow_inf_nan=False)


class SolverSection(Section):
    name: str = "auto"
    options: dict[str, Any] = Field(default_factory=dict)


class ControllerSection(Section):
    horizon: int = Field(1, ge=1)
    formulation: str = "ac"
    objective: Spec | None = None
    generator_delay: Literal[0, 1] = 0
    initial_dispatch: Literal["free", "single-stage"] | None = None
    end: EndSection = Field(default_factory=EndSection)
    regularisation: float | None = Field(None, ge=0)
    on_infeasible: OnInfeasible = "stop"
    elastic: ElasticSection = Field(default_factory=ElasticSection)
    solver: str | SolverSection = "auto"

    @property
    def back_end(self) -> SolverSection:
        """Solver and options; a bare name has no options."""
        return self.solver if isinstance(self.solver, SolverSection) else SolverSection(name=self.solver)


class PlantSection(BaseModel):
    model_config = ConfigDict(extra="allow", strict=True)  # the options of the plant

    mode: str = "nominal"


class PublishedSection(Section):
    source: str
    J_e: float | None = Field(None, description="$")
    J_s: float | None = None
    J_t: float | None = None
    J_b: float | None = None


class ScenarioFile(Section):
    """The content of a scenario file."""

    name: str | None = None
    description: str = ""
    network: dict[str, Any]
    time: TimeSection = Field(default_factory=TimeSection)
    profiles: list[str | dict[str, Any]] = Field(default_factory=list)
    cost: Spec = "economic"
    controller: ControllerSection = Field(default_factory=ControllerSection)
    forecast: str | dict[str, Any] = "perfect"
    plant: PlantSection = Field(default_factory=PlantSection)
    constraints: dict[str, Any] = Field(default_factory=dict)
    published: PublishedSection | None = None
    variants: dict[str, dict[str, Any]] = Field(default_factory=dict)

    @property
    def length(self) -> int:
        """Required length of time series, which must cover the horizon of the last plan."""
        return self.time.steps + self.controller.horizon - 1
