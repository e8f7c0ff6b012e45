"""Schema of scenario files; ``docs/scenarios.md`` documents the keys."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, FailFast, Field, field_validator, model_validator

from opfmodel.model import Elastic
from opfmodel.network.bounds import STEP_HOURS
from opfmodel.network.quantities import CURRENCY, Basis, In, currency_fault
from opfmodel.scenario.overlay import Choice, Inside
from opfmodel.simulation import OnInfeasible

__all__ = ["ScenarioFile", "Spec"]

One = str | dict[str, Any]


class _FirstError(FailFast):
    """Stop at the first invalid entry of a list, which can have a million of them."""

    __hash__ = object.__hash__  # so that a union can contain the list


List = Annotated[list[One], _FirstError()]
Spec = One | List

# How mappings choose: ``{name: {option: value}}``, or a name beside its options.
_BY_KEY = Choice(lambda values: frozenset(values) or None, lambda name: {name: {}})
_BY_MODE = Choice(lambda values: values.get("mode"), lambda name: {"mode": name})
_BY_NAME = Choice(lambda values: values.get("name"), lambda name: {"name": name})
_BY_FORM = Choice(lambda values: "points" in values if values else None)
# The costs, which are the only mappings in fields of components: <section>.<component>.<field>.
_COSTS = Inside(3, _BY_FORM)

_MOST_VARIANTS = 200


class Section(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class TimeSection(Section):
    start: str | None = Field(None, description="beginning of the first step, ISO 8601")
    zone: str | None = Field(None, description="time zone, such as Europe/Berlin")
    step: Annotated[float, Field(ge=STEP_HOURS[0], le=STEP_HOURS[1]), In("h")] = 1.0
    steps: int = Field(1, ge=1)


class EndSection(Section):
    cyclic: bool = False
    minimum: float = Field(0.0, ge=0, le=1)
    price: Annotated[float, In("$/MWh")] = 0.0


Price = Annotated[float, Field(gt=0, allow_inf_nan=False), In("$/MWh")]
Cost = Annotated[float | None, In("$")]


class ElasticSection(Section):
    limit: Price = Elastic.limit
    shedding: Price = Elastic.shedding
    balance: Price = Elastic.balance


class SolverSection(Section):
    name: str = "auto"
    options: dict[str, Any] = Field(default_factory=dict)


class ControllerSection(Section):
    horizon: int = Field(1, ge=1)
    formulation: str = "ac"
    objective: Annotated[Spec | None, _BY_KEY] = None
    generator_delay: Literal[0, 1] = 0
    initial_dispatch: Literal["free", "single-stage"] | None = None
    end: EndSection = Field(default_factory=EndSection)
    regularisation: float | None = Field(None, ge=0)
    on_infeasible: OnInfeasible = "stop"
    elastic: ElasticSection = Field(default_factory=ElasticSection)
    solver: Annotated[str | SolverSection, _BY_NAME] = "auto"

    @property
    def back_end(self) -> SolverSection:
        """Solver and options; a bare name has no options."""
        return self.solver if isinstance(self.solver, SolverSection) else SolverSection(name=self.solver)


class PlantSection(BaseModel):
    model_config = ConfigDict(extra="allow", strict=True)  # the options of the plant

    mode: str = "nominal"

    @model_validator(mode="before")
    @classmethod
    def _of_name(cls, value: Any) -> Any:
        """Accept the name of a plant without options."""
        return _BY_MODE.spelt_out(value)


class PublishedSection(Section):
    source: str
    J_e: Cost = None
    J_s: Cost = None
    J_t: Cost = None
    J_b: Cost = None


class ScenarioFile(Section):
    """The content of a scenario file."""

    name: str | None = None
    description: str = ""
    currency: str = CURRENCY
    network: Annotated[dict[str, Any], _COSTS]
    time: TimeSection = Field(default_factory=TimeSection)
    profiles: List = Field(default_factory=list)
    cost: Annotated[Spec, _BY_KEY] = "economic"
    controller: ControllerSection = Field(default_factory=ControllerSection)
    forecast: Annotated[One, _BY_KEY] = "perfect"
    plant: Annotated[PlantSection, _BY_MODE] = Field(default_factory=PlantSection)
    constraints: dict[str, Any] = Field(default_factory=dict)
    published: PublishedSection | None = None
    variants: dict[str, dict[str, Any]] = Field(default_factory=dict)

    @field_validator("currency")
    @classmethod
    def _of_currency(cls, name: str) -> str:
        if fault := currency_fault(name):
            raise ValueError(fault)
        return name

    @field_validator("variants", mode="before")
    @classmethod
    def _few(cls, variants: Any) -> Any:
        if isinstance(variants, dict) and len(variants) > _MOST_VARIANTS:
            raise ValueError(
                f"there are {len(variants):,} variants; at most {_MOST_VARIANTS} are accepted; "
                "a study has no such limit"
            )
        return variants

    @property
    def basis(self) -> Basis:
        """What the values of quantities with units depend on, besides the power base."""
        return Basis(self.currency)

    @property
    def length(self) -> int:
        """Required length of time series, which must cover the horizon of the last plan."""
        return self.time.steps + self.controller.horizon - 1
