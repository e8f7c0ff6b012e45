"""Scenario files: a network, time series, a controller and a closed loop in one YAML document.

``docs/scenarios.md`` describes the keys. Loading a scenario reads files and executes nothing.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field

from opfmodel import plugins
from opfmodel.data.columns import read_columns
from opfmodel.data.series import Profiles
from opfmodel.data.yaml import MOST_LEVELS
from opfmodel.documents import Document, check_name, read_document, validated
from opfmodel.errors import (
    CaseError,
    ComponentError,
    ConstraintError,
    IncompatibleError,
    ModelError,
    NetworkError,
    OpfmodelError,
    PluginError,
    ProfileError,
    QuantityError,
    ScenarioError,
    name_fault,
    nearest,
    shown,
)
from opfmodel.forecasts.base import Forecast
from opfmodel.formulations.base import Formulation
from opfmodel.model import CustomConstraint, Elastic, Linear, PhysicalStage
from opfmodel.network.arrays import per_unit
from opfmodel.network.bounds import LARGEST, STEP_HOURS, bounded
from opfmodel.network.cases import read_network
from opfmodel.network.component import Component
from opfmodel.network.components import BUILT_IN, Bus, Load
from opfmodel.network.costs import Polynomial
from opfmodel.network.network import Network, name_pattern
from opfmodel.network.series import check_finite, check_series
from opfmodel.objectives.base import Objective, WeightedSum
from opfmodel.objectives.setpoint_tracking import Setpoints
from opfmodel.plan import End, MultiStage
from opfmodel.plan.memory import check_memory, run_bytes, series_bytes
from opfmodel.plan.single_stage import SingleStageSequence, single_stage_sequence
from opfmodel.profiles.base import Workbook
from opfmodel.simulation import Controller, OnInfeasible, Plant, Run, check_response, simulate
from solvers import Kind, SolverError, find

__all__ = ["Scenario", "laid_over", "load_scenario"]

Spec = str | dict[str, Any] | list[str | dict[str, Any]]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class _Time(_Section):
    step: float = Field(1.0, ge=STEP_HOURS[0], le=STEP_HOURS[1], description="hours")
    steps: int = Field(1, ge=1)


class _End(_Section):
    cyclic: bool = False
    minimum: float = Field(0.0, ge=0, le=1)
    price: float = 0.0


class _Elastic(_Section):
    limit: float = Field(Elastic.limit, gt=0, allow_inf_nan=False, description="$/MWh")
    shedding: float = Field(Elastic.shedding, gt=0, allow_inf_nan=False)
    balance: float = Field(Elastic.balance, gt=0, allow_inf_nan=False)


class _Solver(_Section):
    name: str = "auto"
    options: dict[str, Any] = Field(default_factory=dict)


class _Controller(_Section):
    horizon: int = Field(1, ge=1)
    formulation: str = "ac"
    objective: Spec | None = None
    generator_delay: Literal[0, 1] = 0
    initial_dispatch: Literal["free", "single-stage"] | None = None
    end: _End = Field(default_factory=_End)
    regularisation: float | None = Field(None, ge=0)
    on_infeasible: OnInfeasible = "stop"
    elastic: _Elastic = Field(default_factory=_Elastic)
    solver: str | _Solver = "auto"


class _Plant(BaseModel):
    model_config = ConfigDict(extra="allow", strict=True)  # the options of the plant

    mode: str = "nominal"


class _Published(_Section):
    source: str
    J_e: float | None = Field(None, description="$")
    J_s: float | None = None
    J_t: float | None = None
    J_b: float | None = None


class _File(_Section):
    name: str | None = None
    description: str = ""
    network: dict[str, Any]
    time: _Time = Field(default_factory=_Time)
    profiles: list[str | dict[str, Any]] = Field(default_factory=list)
    cost: Spec = "economic"
    controller: _Controller = Field(default_factory=_Controller)
    forecast: str | dict[str, Any] = "perfect"
    plant: _Plant = Field(default_factory=_Plant)
    constraints: dict[str, Any] = Field(default_factory=dict)
    published: _Published | None = None
    variants: dict[str, dict[str, Any]] = Field(default_factory=dict)


@dataclass
class Scenario:
    """A scenario that has been read and checked.

    Attributes
    ----------
    name
        Its name, with the variant if one was chosen.
    network, profiles
        Made from the file.
    cost
        The objective that realised costs are metered with.
    forecast
        What the controller expects of the profiles.
    settings
        The checked content of the file.
    constraints
        Linear constraints of the controller's problem, by name.
    """

    name: str
    path: Path
    network: Network
    profiles: Profiles
    cost: Objective
    objective: Objective
    forecast: Forecast
    settings: _File
    constraints: Mapping[str, CustomConstraint] = field(default_factory=dict)
    _sequences: dict[int, SingleStageSequence] = field(default_factory=dict)

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

    def problem(self, verbose: bool = False) -> MultiStage:
        """The multi-stage problem of the controller."""
        controller = self.settings.controller
        solver = controller.solver
        name, options = (solver, {}) if isinstance(solver, str) else (solver.name, solver.options)
        problem = MultiStage(
            self.network,
            controller.horizon,
            self.settings.time.step,
            formulation=_make("formulation", controller.formulation, Formulation),
            objective=self.objective,
            profiles=self.profiles,
            generator_delay=controller.generator_delay,
            end=End(**controller.end.model_dump()),
            regularisation=controller.regularisation,
            solver=name,
            options=options,
            verbose=verbose,
        )
        for name, own in self.constraints.items():
            problem.constrain(name, own.state, at_least=own.at_least, at_most=own.at_most)
        return problem

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
        names = ("pg", "qg") if self.problem().formulation.reactive else ("pg",)
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
        settings = self.settings.plant
        made = plugins.make("plant", settings.mode, settings.model_extra or {}, beside=("mode",))
        assert isinstance(made, Plant)
        return made

    def simulate(self, progress: bool = False, verbose: bool = False) -> Run:
        """Run the closed loop of the scenario."""
        return simulate(
            Controller(
                self.problem(verbose), self.forecast, self.settings.controller.on_infeasible, self.elastic
            ),
            self.plant(),
            steps=self.steps,
            initial=self.initial(),
            objective=self.cost,
            progress=progress,
        )


def load_scenario(
    path: str | Path | Document, variant: str | None = None, overrides: Mapping[str, Any] | None = None
) -> Scenario:
    """Read a scenario file.

    Parameters
    ----------
    path
        The file, or its content where it has been read already.
    variant
        One of the file's variants, whose keys are laid over the others.
    overrides
        Values by dotted key, laid over everything: ``{"controller.horizon": 24}``.

    Raises
    ------
    ScenarioError
        The file breaks its schema: an unknown key, a wrong type, a value out of range; the
        message names file, line, column and what would be accepted.
    """
    document = path if isinstance(path, Document) else read_document(path)
    content = laid_over(document, variant, overrides)
    if variant is not None:
        document = document.over(("variants", variant))
    _check_numbers(document, content)
    settings = validated(document, content, _File)
    name = document.path.stem if settings.name is None else settings.name
    check_name(document, ("name",), name)
    for each in settings.variants:
        check_name(document, ("variants", each), each)
    with _located(document, ("network",)):
        declarations = _Declarations(document, settings.network)
        network = declarations.network(name)
        declarations.check(network)
    cost = _objective(document, ("cost",), settings.cost)
    scenario = Scenario(
        name=name if variant is None else f"{name}:{variant}",
        path=document.path,
        network=network,
        profiles=_profiles(document, settings, network),
        cost=cost,
        objective=cost,
        forecast=_forecast(document, settings),
        settings=settings,
        constraints=_constraints(document, settings),
    )
    controller = settings.controller
    if controller.objective is not None:
        convert = {Setpoints: lambda value: _setpoints(value, scenario)}
        scenario.objective = _objective(document, ("controller", "objective"), controller.objective, convert)
    with _located(document, ("controller", "formulation")):
        plugins.load("formulation", controller.formulation)
    solver = controller.solver if isinstance(controller.solver, str) else controller.solver.name
    if solver != "auto":
        with _located(document, ("controller", "solver")):
            find(solver, Kind.LINEAR)
    with _located(document, ("controller",)):
        problem = scenario.problem()
    plant = _plant(document, scenario)
    # last, and in this order: parts that do not fit together must not hide a mistake
    _check_constraints(document, scenario.constraints, problem)
    with _located(document, ("forecast",)):
        check_response(scenario.forecast, plant)
    return scenario


def laid_over(
    document: Document, variant: str | None = None, overrides: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """The keys of a scenario file with a variant and overrides laid over them, not yet checked.

    Parameters
    ----------
    variant, overrides
        As :func:`load_scenario` takes them.

    Raises
    ------
    ScenarioError
        The document is not a mapping, or has no such variant.
    """
    if not isinstance(document.content, dict):
        raise document.error((), "a scenario is a mapping with the key 'network' and others")
    if "vary" in document.content:
        raise document.error(("vary",), "this is a study; 'opfmodel study run' runs it")
    content = deepcopy(document.content)
    if variant is not None:
        variants = content.get("variants") or {}
        if not isinstance(variants, dict) or variant not in variants:
            raise document.error(("variants",), f"no variant {variant!r}; {nearest(variant, variants)}")
        content = _overlay(content, variants[variant])
    for key, value in (overrides or {}).items():
        parts = key.split(".")
        if len(parts) > MOST_LEVELS:
            raise document.error((), f"{shown(key)}: there is no key of {len(parts)} parts")
        content = _overlay(content, _nested(parts, value))
    return content


# Reading the parts ------------------------------------------------------------------------------


def _check_numbers(document: Document, content: Any, key: tuple[str | int, ...] = ()) -> None:
    """Raise an error for a number that is none, or that would overflow when it is squared.

    Infinity is accepted here, for it means "no limit" in some places; options of solvers are theirs.
    """
    for part, value in content.items() if isinstance(content, dict) else enumerate(content):
        if isinstance(value, dict | list):
            if (*key, part) != ("controller", "solver"):
                _check_numbers(document, value, (*key, part))
        elif isinstance(value, int | float) and not bounded(value) and abs(value) != np.inf:
            raise document.error(
                (*key, part), f"{shown(value)}: must be a finite number of at most {LARGEST:g}"
            )


def _overlay(base: Any, over: Any) -> Any:
    """``over`` laid over ``base``: mappings key by key, anything else replaced."""
    if isinstance(base, dict) and isinstance(over, dict):
        return {**base, **{key: _overlay(base.get(key), value) for key, value in over.items()}}
    return over


def _nested(keys: list[str], value: Any) -> dict[str, Any]:
    for key in reversed(keys):
        value = {key: value}
    return dict(value)


@contextmanager
def _located(document: Document, key: tuple[str | int, ...]) -> Iterator[None]:
    """Give errors raised inside the position of ``key`` in the file."""
    try:
        yield
    except ScenarioError:
        raise
    except PluginError as error:
        raise document.error((*key, *error.key), str(error)) from error
    except (OpfmodelError, SolverError) as error:
        raise document.error(key, str(error)) from error


class _Declarations:
    """Makes the network of a scenario from its section."""

    _OWN = ("file", "name", "base_mva", "default_cost", "update", "remove")

    def __init__(self, document: Document, section: dict[str, Any]) -> None:
        self.document = document
        self.section = section
        kinds, self.broken = component_kinds()
        self.kinds = {kind.plural: kind for kind in kinds}

    def network(self, name: str) -> Network:
        known = (*self._OWN, *self.kinds)
        for key in self.section:
            if key not in known:
                broken = "".join(f"; {reason}" for reason in self.broken)
                raise self.document.error(("network", key), f"unknown key; {nearest(key, known)}{broken}")
        network = self._start(name)
        for plural in sorted(self.kinds, key=lambda p: p != "buses"):
            for component, fields in self._members(plural):
                self._declare(network, self.kinds[plural], component, fields)
        for component, fields in self._members("update"):
            self._update(network, component, fields)
        removed = self.section.get("remove") or []
        if not isinstance(removed, list):
            raise self.document.error(("network", "remove"), "must be a list of component names")
        for component in removed:
            network.remove(str(component))
        return network

    def check(self, network: Network) -> None:
        """Raise an error with the position of the component that names an unknown bus."""
        try:
            per_unit(network)
        except ComponentError as error:
            for section in (*self.kinds, "update"):
                for name, _ in self._members(section):
                    if name_pattern(name).fullmatch(error.component):
                        key = ("network", section, name, error.field)
                        raise self.document.error(key, f"{shown(error.value)}: {error.rule}") from error
            raise

    def _start(self, name: str) -> Network:
        file, base_mva = self.section.get("file"), self.section.get("base_mva")
        if file is None:
            named = self.section.get("name", name)
            if not isinstance(named, str) or name_fault(named):
                raise self.document.error(
                    ("network", "name"), f"{shown(named)}: must be text of visible characters"
                )
            with _located(self.document, ("network", "base_mva")):
                return Network(named, 100.0 if base_mva is None else base_mva)
        if not isinstance(file, str):
            raise self.document.error(("network", "file"), "must be a path, relative to this file")
        if base_mva is not None:
            raise self.document.error(("network", "base_mva"), "is given by the network file")
        price = self.section.get("default_cost")
        if price is not None and (isinstance(price, bool) or not isinstance(price, int | float)):
            raise self.document.error(("network", "default_cost"), f"{price!r}: must be a number in $/MWh")
        with _located(self.document, ("network", "file")):
            return read_network(
                self.document.path.parent / file,
                default_cost=None if price is None else Polynomial(0.0, float(price), 0.0),
            )

    def _members(self, section: str) -> Iterator[tuple[str, dict[str, Any]]]:
        members = self.section.get(section) or {}
        if not isinstance(members, dict):
            raise self.document.error(("network", section), "must be a mapping from names to fields")
        for name, fields in members.items():
            if not isinstance(fields, dict):
                raise self.document.error(
                    ("network", section, name), "must be a mapping from fields to values"
                )
            yield name, fields

    def _declare(self, network: Network, kind: type[Component], name: str, fields: dict[str, Any]) -> None:
        """Declare one component, or one at every bus where name and bus are written with a star."""
        with self._fields(kind.plural, name):
            if str(fields.get("bus")) != "*":
                network.add(name, kind.from_mapping(name, self._shares(kind, name, fields)))
                return
            if name.count("*") != 1:
                raise ComponentError(name, "bus", "*", "for one at every bus the name needs a * too: 'cell*'")
            for bus in network.of(Bus):
                member = name.replace("*", bus)
                network.add(
                    member, kind.from_mapping(member, self._shares(kind, name, {**fields, "bus": bus}))
                )

    def _update(self, network: Network, name: str, fields: dict[str, Any]) -> None:
        """Change fields of one component, or of all whose names match a pattern."""
        matching = [n for n in network if name_pattern(name).fullmatch(n)]
        if not matching:
            raise self.document.error(
                ("network", "update", name), f"no component of that name; {nearest(name, network)}"
            )
        for member in matching:
            old = network[member]
            plain = {k: getattr(old, k) for k in old.fields()}
            with self._fields("update", name):
                network.update(member, **self._shares(type(old), member, fields, plain))

    @contextmanager
    def _fields(self, section: str, name: str) -> Iterator[None]:
        try:
            yield
        except ComponentError as error:
            key = ("network", section, name, error.field)
            value = "" if error.value is None else f"{shown(error.value)}: "
            raise self.document.error(key, f"{value}{error.rule}") from error
        except (NetworkError, CaseError) as error:
            raise self.document.error(("network", section, name), str(error)) from error

    @staticmethod
    def _shares(
        kind: type[Component], name: str, fields: dict[str, Any], others: Mapping[str, Any] | None = None
    ) -> dict[str, Any]:
        """Replace values such as ``10% of p_max`` by numbers."""
        known = {k: v for k, v in {**(others or {}), **fields}.items() if not _SHARE.fullmatch(str(v))}
        resolved = dict(fields)
        for key, value in fields.items():
            match = _SHARE.fullmatch(value) if isinstance(value, str) else None
            if match:
                whole = kind.from_mapping(name, known)
                try:
                    resolved[key] = float(match[1]) / 100.0 * whole.constant(match[2])
                except ProfileError as error:
                    raise ComponentError(name, key, value, str(error)) from error
        return resolved


_SHARE = re.compile(r"\s*([0-9]+(?:\.[0-9]*)?|\.[0-9]+)\s*%\s*of\s+(\w+)\s*")


def component_kinds() -> tuple[list[type[Component]], list[str]]:
    """Classes of components that a scenario can declare, and what is wrong with devices that do not load.

    The classes are the built-in ones and those of other packages' devices.
    """
    known: dict[str, type[Component]] = {kind.kind: kind for kind in BUILT_IN}
    broken = []
    for name, plugin in plugins.plugins("device").items():
        if name not in known:
            try:
                component = plugin.load().component
            except PluginError as error:
                broken.append(str(error))
                continue
            taken = [kind.plural for kind in known.values()]
            if isinstance(getattr(component, "plural", None), str) and component.plural not in taken:
                known[component.kind] = component
            else:
                broken.append(f"device {name!r} of {plugin.origin}: its component needs a plural of its own")
    return list(known.values()), broken


def _profiles(document: Document, settings: _File, network: Network) -> Profiles:
    steps = settings.time.steps + settings.controller.horizon - 1
    _check_size(document, settings, network)
    book = Workbook(network, steps, settings.time.step, document.path.parent)
    for number, spec in enumerate(settings.profiles):
        key = ("profiles", number)
        name, options = _single(document, key, spec)
        before = dict(book.series)
        with _located(document, (*key, name)), _sourced(book):
            plugins.make("profile", name, options).apply(book)
            changed = {k: values for k, values in book.series.items() if before.get(k) is not values}
            check_finite(Profiles(changed), network)
    with _located(document, ("profiles",)), _sourced(book):
        made = Profiles(book.series)
        check_series(made, network)
        return made


def _check_size(document: Document, settings: _File, network: Network) -> None:
    """Raise an error before series are made, or a run is begun, for which there is no memory."""
    steps, horizon = settings.time.steps, settings.controller.horizon
    loads = len(network.of(Load))
    with _located(document, ("time", "steps")):
        check_memory(f"{steps:,}", run_bytes(len(network), steps) + series_bytes(loads, steps))
    with _located(document, ("controller", "horizon")):
        check_memory(f"{horizon:,} with {steps:,} steps", series_bytes(loads, steps + horizon))


@contextmanager
def _sourced(book: Workbook) -> Iterator[None]:
    """Give errors about a value from a file the line and column where it stands."""
    try:
        yield
    except ProfileError as error:
        raise ProfileError(f"{book.source(error)}{error}") from error


def _constraints(document: Document, settings: _File) -> dict[str, CustomConstraint]:
    made = {}
    steps = settings.time.steps + settings.controller.horizon - 1
    for name, values in settings.constraints.items():
        with _in_constraint(document, name):
            made[name] = _constraint(name, values, steps, document.path.parent)
    return made


def _constraint(name: str, values: object, steps: int, folder: Path) -> CustomConstraint:
    """A linear constraint from plain values.

    Parameters
    ----------
    values
        ``terms``, and ``at_least``, ``at_most`` or both, or ``equal``: each a number, a list, or
        ``{file: , column: }``.
    steps
        Number of values that a limit over time needs.
    folder
        Where relative file names start from.

    Raises
    ------
    ConstraintError
        What is wrong, with the key where it stands.
    """
    known = ("terms", "at_least", "at_most", "equal")
    if not isinstance(values, Mapping):
        raise ConstraintError(f"must be a mapping with {', '.join(known)}")
    for key in values:
        if key not in known:
            raise ConstraintError(f"unknown key; {nearest(key, known)}", key)
    terms = values.get("terms")
    if not isinstance(terms, Mapping):
        raise ConstraintError("must be a mapping from kind.quantity to factors", "terms")
    limits = {key: _limit(values[key], key, steps, folder) for key in known[1:] if key in values}
    if not limits:
        raise ConstraintError("needs a limit: at_least, at_most or equal")
    if "equal" in limits:
        if len(limits) > 1:
            raise ConstraintError("is an equation; leave out at_least and at_most", "equal")
        limits = dict.fromkeys(("at_least", "at_most"), limits["equal"])
    return CustomConstraint.of(name, Linear(terms), **limits)


def _limit(value: object, key: str, steps: int, folder: Path) -> float | list[float]:
    if isinstance(value, Mapping):
        if set(value) != {"file", "column"}:
            raise ConstraintError("must be a number, a list, or {file: , column: }", key)
        path, heading = folder / str(value["file"]), str(value["column"])
        try:
            return [float(number) for number in read_columns(path, steps, [heading]).values[heading]]
        except ProfileError as error:
            raise ConstraintError(str(error), key) from error
    numbers = []
    for number in value if isinstance(value, list) else [value]:
        if isinstance(number, bool) or not isinstance(number, int | float) or not bounded(number):
            raise ConstraintError(f"{shown(number)}: must be a finite number, or a list of one per step", key)
        numbers.append(float(number))
    if not isinstance(value, list):
        return numbers[0]
    if len(numbers) < steps:
        raise ConstraintError(f"has {len(numbers)} values; {steps} are needed, steps + horizon - 1", key)
    return numbers[:steps]


def _check_constraints(
    document: Document, constraints: Mapping[str, CustomConstraint], problem: MultiStage
) -> None:
    """Raise an error with the position of a term that is not in the network or not published.

    A term that only this formulation does not publish is reported after all others.
    """
    if not constraints:
        return
    with _located(document, ("controller",)):
        stage: Any = PhysicalStage(problem.declare(stages=1))
    unpublished: dict[tuple[str, ...], ModelError] = {}
    for name, constraint in constraints.items():
        missing: dict[tuple[str, ...], ModelError] = {}
        with _in_constraint(document, name):
            linear = constraint.state
            assert isinstance(linear, Linear)
            for key in linear.terms:
                try:
                    linear.term(stage, key)
                except QuantityError as error:
                    missing["constraints", name, "terms", key] = problem.explain(error)
            if not missing:
                linear(stage)
        unpublished |= missing
    for where, fault in sorted(unpublished.items(), key=lambda item: isinstance(item[1], IncompatibleError)):
        with _located(document, where):
            raise fault


@contextmanager
def _in_constraint(document: Document, name: str) -> Iterator[None]:
    try:
        yield
    except ConstraintError as error:
        raise document.error(("constraints", name, *error.key), str(error)) from error


def _objective(
    document: Document,
    key: tuple[str | int, ...],
    spec: Spec,
    convert: Mapping[Any, Callable[[Any], Any]] | None = None,
) -> Objective:
    if not isinstance(spec, list):
        name, options = _single(document, key, spec)
        with _located(document, (*key, name) if isinstance(spec, dict) else key):
            made = plugins.make("objective", name, options, convert)
            assert isinstance(made, Objective)
            return made
    parts: list[tuple[float, Objective]] = []
    for number, part in enumerate(spec):
        rest = part if isinstance(part, str) else {k: v for k, v in part.items() if k != "weight"}
        weight = 1.0 if isinstance(part, str) else part.get("weight", 1.0)
        if not isinstance(weight, int | float) or isinstance(weight, bool) or not 0 <= weight < np.inf:
            raise document.error((*key, number, "weight"), f"{shown(weight)}: must be a number, at least 0")
        parts.append((float(weight), _objective(document, (*key, number), rest, convert)))
    if not parts:
        raise document.error(key, "needs at least one objective")
    return WeightedSum(parts)


def _forecast(document: Document, settings: _File) -> Forecast:
    name, options = _single(document, ("forecast",), settings.forecast)
    key = ("forecast", name) if isinstance(settings.forecast, dict) else ("forecast",)
    with _located(document, key):
        made = plugins.make(
            "forecast", name, options, {Path: lambda value: document.path.parent / str(value)}
        )
        assert isinstance(made, Forecast)
        return made


def _plant(document: Document, scenario: Scenario) -> Plant:
    """The plant; an option that it does not take, or that does not fit the network, is an error."""
    with _located(document, ("plant", "mode")):
        plugins.load("plant", scenario.settings.plant.mode)
    with _located(document, ("plant",)):
        plant = scenario.plant()
        plant.check(per_unit(scenario.network))
    return plant


def _setpoints(value: Any, scenario: Scenario) -> Setpoints:
    """Set-points as a file states them; those of single stages are solved for when they are needed."""
    if value == "single-stage":
        steps = scenario.steps + scenario.settings.controller.horizon - 1
        return Setpoints(lambda: scenario.single_stages(steps).setpoints().values)
    if not isinstance(value, dict):
        raise ModelError(
            f"set-points {value!r}: must be 'single-stage', {{file: PATH}} or {{component.quantity: values}}"
        )
    if set(value) == {"file"}:
        value = read_columns(scenario.path.parent / str(value["file"]), scenario.steps).values
    given = Setpoints(value)
    given.arrays(per_unit(scenario.network))  # so that a mistake has its place in the file
    return given


def _single(
    document: Document, key: tuple[str | int, ...], spec: str | dict[str, Any]
) -> tuple[str, dict[str, Any]]:
    """Name and options of a plugin: ``name`` or ``{name: {option: value}}``."""
    if isinstance(spec, str):
        return spec, {}
    if len(spec) != 1:
        raise document.error(key, f"must be a name, or one name with its options, not {len(spec)} keys")
    name, options = next(iter(spec.items()))
    if options is not None and not isinstance(options, dict):
        raise document.error((*key, name), "the options must be a mapping")
    return name, options or {}


def _make(sort: str, name: str, kind: type[Any]) -> Any:
    made = plugins.load(sort, name)()
    if not isinstance(made, kind):
        raise PluginError(f"{sort} {name!r} is not a {kind.__name__}")
    return made
