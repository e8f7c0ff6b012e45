"""Schema of scenario files: keys with their types, bounds and descriptions.

The tables of ``docs/scenarios.md`` and the JSON Schema are generated from it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, FailFast, Field, field_validator, model_validator

from opfmodel.data.resampling import Resample
from opfmodel.model import Elastic
from opfmodel.network.bounds import STEP_HOURS
from opfmodel.network.quantities import CURRENCY, Basis, In, currency_fault
from opfmodel.plan.extent import AtEnd
from opfmodel.plan.security import Security
from opfmodel.scenario.overlay import Choice, Inside
from opfmodel.simulation import OnInfeasible

if TYPE_CHECKING:
    from pydantic import GetJsonSchemaHandler
    from pydantic_core import CoreSchema

__all__ = [
    "MOST_VARIANTS",
    "ColumnSection",
    "ConstraintSection",
    "NetworkSection",
    "Of",
    "ScenarioFile",
    "Section",
    "Spec",
]

One = str | dict[str, Any]


class _FirstError(FailFast):
    """Stop at the first invalid entry of a list, which can have a million of them."""

    __hash__ = object.__hash__  # so that a union can contain the list


List = Annotated[list[One], _FirstError()]
Spec = One | List

# How mappings choose: ``{name: {option: value}}``, or a name beside its options.
_BY_KEY = Choice(lambda values: frozenset(values) or None, lambda name: {name: {}})
_BY_MODE = Choice(
    lambda values: values.get("mode"),
    lambda name: {"mode": name},
    common=("outages", "known", "minutes", "rating"),
)
_BY_NAME = Choice(lambda values: values.get("name"), lambda name: {"name": name})
_BY_FORM = Choice(lambda values: "points" in values if values else None)
_BY_SOURCE = Choice(lambda values: "draw" if "draw" in values else "cases" if "cases" in values else None)
# The costs, which are the only mappings in fields of components: <section>.<component>.<field>.
_COSTS = Inside(3, _BY_FORM)

MOST_VARIANTS = 200


@dataclass(frozen=True)
class Of:
    """Mark of a key whose value is a plugin, components or overrides: what its JSON Schema is to contain."""

    sort: str

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Name the sort, for :mod:`opfmodel.scenario.reference` to replace."""
        return {"x-sort": self.sort}


class Section(BaseModel):
    """Keys of a mapping; others are refused, and types are not converted."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class NetworkSection(Section):
    """The grid: a network file, components by name, and changes to them."""

    model_config = ConfigDict(extra="allow")  # components by name, in sections named after their kind

    file: str | None = Field(
        None,
        description="network file to start from: MATPOWER, PSS/E, pandapower, PyPSA and others, or "
        "`simbench:CODE`",
    )
    name: str | None = Field(
        None, description="name of a network without a file; by default that of the scenario"
    )
    base_mva: Annotated[float | None, In("MVA")] = Field(
        None,
        description="power base of impedances and of weights in per unit, from 1e-6 to 1e9, by default 100; "
        "given by the file if there is one",
    )
    default_cost: Annotated[float | None, In("$/MWh")] = Field(
        None, description="cost of generators for which the file states none"
    )
    lossy: bool = Field(
        False,
        description="whether to accept that data of the file without counterpart are lost, with a warning "
        "for each; by default they are an error",
    )
    update: Annotated[dict[str, dict[str, Any]] | None, Of("update")] = Field(
        None,
        description="changes to fields, by component name or pattern (`gen*`), after all declarations",
    )
    remove: list[str | int] | None = Field(
        None, description="names of components to remove, after all other changes"
    )

    @property
    def components(self) -> dict[str, Any]:
        """Mappings of components by the plural of their kind, and keys that are unknown."""
        return self.model_extra or {}


class TimeSection(Section):
    start: str | None = Field(
        None,
        description="beginning of the first step, ISO 8601; without an offset it is in the zone; by default "
        "that of the network's series, else of the first file with times",
    )
    zone: str | None = Field(
        None,
        description="time zone of times without an offset and of everything shown, such as `Europe/Berlin`; "
        "by default that of the network's series, else `UTC`",
    )
    step: Annotated[float, Field(ge=STEP_HOURS[0], le=STEP_HOURS[1]), In("h")] = Field(
        1.0,
        description="length of a stage, from 1e-6 to 1e6 h; if it is not stated, that of the network's "
        "series or of the first file with times counts",
    )
    steps: int = Field(
        1,
        ge=1,
        description="steps of the closed loop, at least 1; if it is not stated, as many as the network's "
        "series allow",
    )
    at_end: AtEnd = Field("error", description="what plans do that look beyond the data")


class EndSection(Section):
    cyclic: bool = Field(
        False, description="whether stored energy at the end of a plan equals that at its start"
    )
    minimum: float = Field(
        0.0,
        ge=0,
        le=1,
        description="minimum stored energy at the end of a plan as a share of the capacity, from 0 to 1",
    )
    price: Annotated[float, In("$/MWh")] = Field(
        0.0, description="value of the energy stored at the end of a plan"
    )


Price = Annotated[float, Field(gt=0, allow_inf_nan=False), In("$/MWh")]


class ElasticSection(Section):
    limit: Price = Field(Elastic.limit, description="penalty price of violated limits")
    shedding: Price = Field(Elastic.shedding, description="penalty price of load shedding")
    balance: Price = Field(Elastic.balance, description="penalty price of unserved balance")


class SolverSection(Section):
    name: str = Field("auto", description="name of the back end or solver, if it has options")
    options: dict[str, Any] = Field(
        default_factory=dict, description="options passed to the solver unchanged"
    )


class HorizonSection(Section):
    hours: list[Annotated[float, In("h")]] = Field(
        min_length=1,
        description="length of each stage, a multiple of `time.step`; in a closed loop the first is one step",
    )


class CaseSection(Section):
    probability: float = Field(description="above 0; the probabilities of all cases sum to 1")
    profiles: Annotated[List, Of("profile")] = Field(
        default_factory=list,
        description="profile rules that change the expected series after the common stages",
    )


class DrawSection(Section):
    number: int = Field(description="paths to draw")
    keep: int | None = Field(None, description="paths to keep after reduction, or give `splits`")
    splits: dict[str | int, int] | None = Field(
        None,
        description="number of children of every node at the end of a number of stages, by that number, in "
        "place of `keep` and `common`: `{2: 3, 6: 2}` are six paths",
    )
    seed: int = Field(0, description="seed of the random numbers")


class RiskSection(Section):
    level: float = Field(
        description="plans minimise (1 - `weight`) times the mean plus `weight` times the mean of the worst "
        "1 - `level` of the scenarios' costs; from 0 to below 1"
    )
    weight: float = Field(description="weight of the worst costs, from 0 to below 1")


class ScenariosSection(Section):
    common: Annotated[int, Field(ge=0)] | None = Field(
        None,
        description="stages at the beginning that all futures share, by default 1; at least 1 in a closed "
        "loop",
    )
    cases: dict[str, CaseSection] = Field(default_factory=dict, description="named futures")
    draw: DrawSection | None = Field(None, description="paths drawn from the forecast, in place of cases")
    risk: RiskSection | None = Field(
        None, description="risk aversion; by default plans minimise the expected cost"
    )


class ContingenciesSection(Section):
    branches: list[str] = Field(default_factory=list, description="names or patterns of branches")
    generators: list[str] = Field(default_factory=list, description="names or patterns of generators")
    storages: list[str] = Field(default_factory=list, description="names or patterns of storages")
    renewables: list[str] = Field(default_factory=list, description="names or patterns of renewables")
    dc_lines: list[str] = Field(default_factory=list, description="names or patterns of DC lines")
    connections: list[str] = Field(default_factory=list, description="names or patterns of connections")


class SecuritySection(Section):
    contingencies: Literal["all"] | ContingenciesSection = Field(
        "all", description="`all`: every branch whose outage does not split the grid; or a mapping"
    )
    response: Literal["corrective", "preventive"] = Field(
        "corrective",
        description="`corrective`: units and storages act within `minutes`; `preventive`: they hold what was "
        "planned",
    )
    minutes: Annotated[float, In("min")] = Field(
        Security.minutes, description="time for a corrective response"
    )
    participation: dict[str, float] | None = Field(
        None,
        description="weights of units in a preventive response, by name; by default those of the units",
    )
    rating: float = Field(
        Security.rating, description="multiple of the rating of a branch that applies after an outage"
    )
    screen: bool = Field(
        Security.screen,
        description="whether problems include only the contingencies that would not be survived without; the "
        "plan is the same",
    )


class ControllerSection(Section):
    horizon: Annotated[int, Field(ge=1)] | HorizonSection = Field(
        1, description="stages of a plan, at least 1; or a mapping with `hours`"
    )
    scenarios: Annotated[ScenariosSection | None, _BY_SOURCE] = Field(
        None, description="futures that plans take into account"
    )
    security: SecuritySection | None = Field(None, description="outages that plans must survive")
    formulation: Annotated[str, Of("formulation")] = Field(
        "ac", description="equations of the grid in the plans"
    )
    objective: Annotated[Spec | None, _BY_KEY, Of("objective")] = Field(
        None, description="objective that plans minimise; by default that of `cost`"
    )
    generator_delay: Literal[0, 1] = Field(0, description="delay of the dispatch in stages")
    commit: Literal["declared", "milp"] = Field(
        "declared",
        description="which units run: as `on` declares, or by a mixed-integer program of the DC model, "
        "solved before the plan of `opfmodel solve` or the loop of `opfmodel run`",
    )
    initial_dispatch: Literal["free", "single-stage"] | None = Field(
        None,
        description="`single-stage`: the AC optimum of the first demand without storage, whatever the "
        "formulation; `free`: chosen by the first plan; by default `single-stage` with a delay of 1, else "
        "`free`",
    )
    end: EndSection = Field(default_factory=EndSection, description="end of the horizon")
    regularisation: float | None = Field(
        None,
        ge=0,
        description="weight in $/(h p.u.²) on the squares of storage power, in per unit on 100 MVA or, if "
        "smaller, on the power of ten at or below the capacity of the system; not part of reported costs; by "
        "default 0.01 for `economic`, `loss-minimisation` and `voltage-deviation`, else 0",
    )
    on_infeasible: OnInfeasible = Field(
        "stop", description="what follows an infeasible problem; `elastic`: continue with an elastic plan"
    )
    limits: Literal["hard", "soft"] = Field(
        "hard",
        description="`soft`: every plan is elastic, and penalties are traded against cost in one solve",
    )
    elastic: ElasticSection = Field(
        default_factory=ElasticSection, description="penalty prices of elastic plans"
    )
    solver: Annotated[str | SolverSection, _BY_NAME] = Field(
        "auto",
        description="back end (`ipopt`, `clarabel`, `osqp`, `qp`, `conic`, `expanded`, `windows`), solver "
        "(`scs`) or both (`conic:scs`)",
    )

    def lengths(self, step: float) -> list[float]:
        """Hours of each stage of a plan, for a given length of a step."""
        return self.horizon.hours if isinstance(self.horizon, HorizonSection) else [step] * self.horizon

    @property
    def back_end(self) -> SolverSection:
        """Solver and options; a bare name has no options."""
        return self.solver if isinstance(self.solver, SolverSection) else SolverSection(name=self.solver)


class OutageSection(Section):
    """A component that trips in the closed loop, under the name of its kind."""

    branch: str | None = Field(None, description="name of a branch")
    generator: str | None = Field(None, description="name of a generator, in place of a branch")
    storage: str | None = Field(None, description="name of a storage, in place of a branch")
    renewable: str | None = Field(None, description="name of a renewable, in place of a branch")
    dc_line: str | None = Field(None, description="name of a DC line, in place of a branch")
    connection: str | None = Field(None, description="name of a connection, in place of a branch")
    step: int = Field(ge=0, description="step of the loop at whose beginning it trips, from 0 on")
    hours: Annotated[float, In("h")] = Field(
        gt=0, description="how long it is out of service, a multiple of `time.step`"
    )

    @property
    def named(self) -> dict[str, str]:
        """Name of the component, by kind."""
        given = {
            "branch": self.branch,
            "generator": self.generator,
            "storage": self.storage,
            "renewable": self.renewable,
            "dc_line": self.dc_line,
            "connection": self.connection,
        }
        return {kind: name for kind, name in given.items() if name is not None}


class PlantSection(BaseModel):
    model_config = ConfigDict(extra="allow", strict=True)  # the options of the plant

    mode: str = Field(
        "nominal",
        description="name of the plant",
    )
    outages: list[OutageSection] = Field(
        default_factory=list, description="components that trip in the loop, and return"
    )
    known: int | None = Field(
        None,
        ge=0,
        description="steps after a trip until the controller knows; by default 1, and 0 for `nominal`, which "
        "takes no others",
    )
    minutes: Annotated[float, In("min")] | None = Field(
        None,
        description="time in which units respond while the controller does not know; by default that of "
        "`controller.security`, else 15",
    )
    rating: float | None = Field(
        None,
        description="multiple of the rating of a branch meanwhile, if it has no emergency rating; by default "
        "that of `controller.security`, else 1",
    )

    @property
    def options(self) -> dict[str, Any]:
        """Options of the plant itself."""
        return self.model_extra or {}

    @model_validator(mode="before")
    @classmethod
    def _of_name(cls, value: Any) -> Any:
        """Accept the name of a plant without options."""
        return _BY_MODE.spelt_out(value)


class ColumnSection(Section):
    """A column of a CSV file, with one value per step."""

    file: str = Field(description="CSV file")
    column: str | int = Field(description="heading of a column")
    time_column: str | int | None = Field(None, description="heading of the column of times")
    resample: Resample | None = Field(None, description="how values of another step are converted")


Numbers = Annotated[list[float], _FirstError()]
Limit = float | Numbers | ColumnSection | None


class ConstraintSection(Section):
    """A linear constraint on plans, in every stage."""

    terms: dict[str, float] = Field(
        description="factors of the sum by `kind.quantity` or `component.quantity`"
    )
    at_least: Limit = Field(None, description="minimum of the sum; at least one of the two limits is needed")
    at_most: Limit = Field(None, description="maximum of the sum")
    equal: Limit = Field(None, description="fixed value of the sum, in place of the two limits")


Cost = Annotated[float | None, In("$")]


class CheckpointSection(Section):
    """How often a run writes what it needs to resume."""

    steps: int | None = Field(None, ge=1, description="write after so many steps, at least 1")
    seconds: Annotated[float, Field(ge=0), In("s")] | None = Field(
        None,
        description="write after a step that ends more than so many seconds after the last writing; 30 if no "
        "number of steps is stated",
    )


class PublishedSection(Section):
    source: str = Field(description="reference for these costs")
    J_e: Cost = Field(None, description="cost of the closed loop")
    J_s: Cost = Field(None, description="cost of the single-stage optima")
    J_t: Cost = Field(None, description="cost of the closed loop that tracks the single-stage optima")
    J_b: Cost = Field(None, description="cost of the closed loop that tracks half-full storage")


class ScenarioFile(Section):
    """The content of a scenario file."""

    name: str | None = Field(
        None,
        description="name of the scenario and its results folder, by default that of the file; at most 120 "
        "bytes, visible characters only, without / and \\",
    )
    description: str = Field("", description="free text")
    currency: str = Field(
        CURRENCY, description="name of the currency of all costs and prices, with which results are labelled"
    )
    network: Annotated[NetworkSection, _COSTS] = Field(description="the grid")
    time: TimeSection = Field(default_factory=TimeSection, description="steps of the closed loop")
    profiles: Annotated[List, Of("profile")] = Field(
        default_factory=list, description="rules that make time series, applied in order"
    )
    cost: Annotated[Spec, _BY_KEY, Of("objective")] = Field(
        "economic", description="objective that meters the realised cost"
    )
    controller: ControllerSection = Field(
        default_factory=ControllerSection, description="the controller, which solves a plan in each step"
    )
    forecast: Annotated[One, _BY_KEY, Of("forecast")] = Field(
        "perfect", description="what the controller expects of the series"
    )
    plant: Annotated[PlantSection, _BY_MODE, Of("plant")] = Field(
        default_factory=PlantSection,
        description="plant that responds to the plans, `nominal` by default; its options are keys next to "
        "`mode`, and `plant: redispatch` stands for `plant: {mode: redispatch}`",
    )
    constraints: dict[str, ConstraintSection] = Field(
        default_factory=dict, description="linear constraints on plans, by name"
    )
    checkpoint: CheckpointSection = Field(
        default_factory=CheckpointSection,
        description="how often `opfmodel run` writes what it needs to resume",
    )
    published: PublishedSection | None = Field(
        None, description="costs from the literature; `opfmodel table` prints them beside the computed ones"
    )
    variants: Annotated[dict[str, dict[str, Any]], Of("variants")] = Field(
        default_factory=dict,
        description="overrides of keys, by name of the variant, at most 200; select one with --variant",
    )

    @field_validator("currency")
    @classmethod
    def _of_currency(cls, name: str) -> str:
        if fault := currency_fault(name):
            raise ValueError(fault)
        return name

    @field_validator("variants", mode="before")
    @classmethod
    def _few(cls, variants: Any) -> Any:
        if isinstance(variants, dict) and len(variants) > MOST_VARIANTS:
            raise ValueError(
                f"there are {len(variants):,} variants; at most {MOST_VARIANTS} are accepted; "
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
        return self.time.steps + self.ahead - 1

    @property
    def ahead(self) -> int:
        """Number of steps that a plan covers."""
        horizon = self.controller.horizon
        if isinstance(horizon, int):
            return horizon
        return max(math.ceil(sum(horizon.hours) / self.time.step - 1e-6), 1)
