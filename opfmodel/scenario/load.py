"""Read a scenario file into one network and one problem, without executing anything in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np

from opfmodel import plugins
from opfmodel.data.grid import Grid
from opfmodel.data.series import Profiles
from opfmodel.data.source import Source
from opfmodel.data.yaml import MOST_LEVELS, Place
from opfmodel.errors import ScenarioError, nearest, shown
from opfmodel.horizon import Horizon
from opfmodel.model import Elastic
from opfmodel.network.arrays import per_unit
from opfmodel.network.bounds import LARGEST, bounded
from opfmodel.network.network import Network
from opfmodel.network.quantities import CURRENCY, Basis, currency_fault
from opfmodel.objectives.base import Objective
from opfmodel.objectives.setpoint_tracking import Setpoints
from opfmodel.plan import End, MultiStage, Risk, Security
from opfmodel.scenario.constraints import check_constraints, read_constraints
from opfmodel.scenario.declarations import Declarations
from opfmodel.scenario.document import Document, check_name, read_document, validated
from opfmodel.scenario.overlay import laid
from opfmodel.scenario.parts import (
    make_forecast,
    make_horizon,
    make_objective,
    make_outages,
    make_plant,
    make_profiles,
    make_rules,
    make_scenarios,
    planned_objective,
)
from opfmodel.scenario.scenario import Scenario
from opfmodel.scenario.schema import ScenarioFile
from opfmodel.scenario.timing import completed, settled
from opfmodel.simulation import Plant, check_response
from solvers import Kind, find

__all__ = ["laid_over", "load_scenario"]


def load_scenario(
    path: str | Path | Document,
    variant: str | None = None,
    overrides: Mapping[str, Any] | None = None,
    *,
    places: Mapping[str, Place] | None = None,
) -> Scenario:
    """Read a scenario file.

    Parameters
    ----------
    path
        The file, or a document that has already been read.
    variant
        Name of a variant, whose keys override the others.
    overrides
        Values by dotted key, such as ``{"controller.horizon": 24}``; they override everything else.
    places
        Where the overrides were written, by dotted key; errors cite these positions.

    Raises
    ------
    ScenarioError
        The file violates its schema: an unknown key, a wrong type, or a value out of range; the
        message gives file, line, column and accepted values of every fault.
    """
    document = (path if isinstance(path, Document) else read_document(path)).collecting()
    content = laid_over(document, variant, overrides)
    if variant is not None:
        document = document.over(("variants", variant))
    document = document.laid(_places(document, overrides or {}, places or {}))
    _check_numbers(document, content)
    settings = validated(document, content, ScenarioFile, _basis(content))
    name = document.path.stem if settings.name is None else settings.name
    check_name(document, ("name",), name)
    for each in settings.variants:
        check_name(document, ("variants", each), each)
    title = name if variant is None else f"{name}:{variant}"
    scenario = _Reader(document, settings).scenario(name, title)
    document.faults.settle()
    assert scenario is not None
    return scenario


def _basis(content: Mapping[str, Any]) -> Basis:
    """Return what the values of quantities depend on; a currency that is none is found by the schema."""
    currency = content.get("currency", CURRENCY)
    return Basis(CURRENCY if currency_fault(currency) else currency)


def _places(
    document: Document, overrides: Mapping[str, Any], places: Mapping[str, Place]
) -> dict[str, Place]:
    """Return the position of every override, which is that of no line unless it is known."""
    unknown = Place(1, 1, Source(f"{document.path}: overrides", is_file=False))
    return {key: places.get(key, unknown) for key in overrides}


class _Reader:
    """Reader of the parts of a scenario, which collects the faults of all."""

    def __init__(self, document: Document, settings: ScenarioFile) -> None:
        self.document = document
        self.settings = settings

    def scenario(self, name: str, title: str) -> Scenario | None:
        """Return the scenario; None if there is a fault."""
        document, settings, faults = self.document, self.settings, self.document.faults
        scenario: Scenario | None = None
        declarations = Declarations(document, settings)
        network = declarations.network(name)
        declarations.check(network)
        cost = make_objective(document, ("cost",), settings.cost, settings.basis)
        rules = make_rules(document, settings, network)
        forecast = make_forecast(document, settings)
        plant = self._plant()
        scenarios = make_scenarios(document, settings)
        grid = Grid(settings.length, settings.time.step)
        if declarations.complete and not faults.broken("time"):
            with faults:
                settings, grid = settled(document, settings, network)
        profiles = Profiles()
        if declarations.complete:
            profiles = make_profiles(document, settings, network, grid, rules)
            if not (faults.broken("time") or faults.broken("profiles")):
                with faults:
                    settings = completed(document, settings, grid)
        constraints = read_constraints(document, settings, grid)
        if not declarations.complete:
            return None

        def single_stages() -> Setpoints:
            assert scenario is not None
            return scenario.single_stages(grid.steps).setpoints()

        objective = planned_objective(document, settings, network, cost, grid, single_stages)
        horizon = make_horizon(document, settings, scenarios)
        outages = make_outages(document, settings, per_unit(network))
        problem = self._problem(settings, network, profiles, objective, horizon, outages)
        if problem is None:
            return None
        for own in constraints.values():
            with faults, document.located("constraints", own.name):
                problem.constrain(own.name, own.state, at_least=own.at_least, at_most=own.at_most)
        check_constraints(document, constraints, problem)
        if plant is not None:
            with faults, document.located("plant"):
                plant.check(problem.arrays)
                if not faults.broken("plant", "outages"):
                    plant.outages.check(problem)
            if forecast is not None:
                with faults, document.located("forecast"):
                    check_response(forecast, plant)
        if faults or forecast is None:
            return None
        scenario = Scenario(title, document, problem, cost, forecast, scenarios, settings, grid)
        with faults:
            scenario.check_forecast()
        return scenario

    def _plant(self) -> Plant | None:
        """Return the plant; None if there is a fault."""
        if self.document.faults.broken("plant"):
            return None
        with self.document.faults:
            with self.document.located("plant", "mode"):
                plugins.load("plant", self.settings.plant.mode)
            with self.document.located("plant"):
                return make_plant(self.settings)
        return None

    def _problem(
        self,
        settings: ScenarioFile,
        network: Network,
        profiles: Profiles,
        objective: Objective,
        horizon: Horizon,
        outages: Sequence[str],
    ) -> MultiStage | None:
        """Build the problem of the ``controller`` section, without custom constraints.

        In place of what is invalid there are defaults, so that names can be checked.
        """
        document, controller, faults = self.document, settings.controller, self.document.faults
        formulation, solver = "ac", controller.back_end
        with faults, document.located("controller", "formulation"):
            plugins.load("formulation", controller.formulation)
            formulation = controller.formulation
        if solver.name != "auto":
            with faults, document.located("controller", "solver"):
                find(solver.name, Kind.LINEAR)
        risk = None if controller.scenarios is None else controller.scenarios.risk
        averse = None
        with faults, document.located("controller", "scenarios", "risk"):
            averse = None if risk is None else Risk(**risk.model_dump())
        secure = None
        with faults, document.located("controller", "security"):
            secure = None if controller.security is None else Security(**controller.security.model_dump())
        sound = not faults
        try:
            with document.located("controller"):
                return MultiStage(
                    network,
                    horizon,
                    formulation=formulation,
                    objective=objective,
                    profiles=profiles if sound else None,
                    generator_delay=controller.generator_delay,
                    end=End(**controller.end.model_dump()),
                    at_end="shrink"
                    if settings.time.at_end == "shrink"
                    else "error",  # what repeats is complete
                    regularisation=controller.regularisation,
                    elastic=Elastic(**controller.elastic.model_dump(), traded=True)
                    if controller.limits == "soft"
                    else None,
                    risk=averse,
                    security=secure,
                    outages=outages,
                    solver=solver.name,
                    options=solver.options,
                )
        except ScenarioError as error:
            if sound:
                faults.add(*error.faults)
        return None


def laid_over(
    document: Document, variant: str | None = None, overrides: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return the keys of a scenario file with a variant and overrides applied, without validation.

    Parameters
    ----------
    variant, overrides
        As for :func:`load_scenario`.

    Raises
    ------
    ScenarioError
        The document or the variant is not a mapping, or there is no such variant.
    """
    if not isinstance(document.content, dict):
        raise document.error((), "a scenario is a mapping with at least the key 'network'")
    if document.is_study:
        key = "vary" if "vary" in document.content else "scenario"
        raise document.error((key,), "this file is a study; run it with 'opfmodel study run'")
    content: Any = deepcopy(document.content)
    if variant is not None:
        variants = content.get("variants") or {}
        if not isinstance(variants, dict) or variant not in variants:
            raise document.error(("variants",), f"no variant {variant!r}; {nearest(variant, variants)}")
        over = variants[variant]
        if not isinstance(over, dict):
            raise document.error(
                ("variants", variant), f"{shown(over)}: must be a mapping of keys to override"
            )
        content = laid(content, [over], ScenarioFile)
    nested = []
    for key, value in (overrides or {}).items():
        parts = key.split(".")
        if len(parts) > MOST_LEVELS:
            raise document.error((), f"{shown(key)}: has {len(parts)} parts; a key has at most {MOST_LEVELS}")
        nested.append(_nested(parts, value))
    laid_out: dict[str, Any] = laid(content, nested, ScenarioFile)
    return laid_out


def _check_numbers(document: Document, content: Any, key: tuple[str | int, ...] = ()) -> None:
    """Collect the faults of NaN, and of numbers that would overflow when squared.

    Infinity is accepted here because some fields use it for "no limit". Solver options are not checked.
    """
    for part, value in content.items() if isinstance(content, dict) else enumerate(content):
        if isinstance(value, dict | list):
            if (*key, part) != ("controller", "solver"):
                _check_numbers(document, value, (*key, part))
        elif isinstance(value, int | float) and not bounded(value) and abs(value) != np.inf:
            message = f"{shown(value)}: must be a finite number of at most {LARGEST:g}"
            document.faults.add(document.fault((*key, part), message))


def _nested(keys: list[str], value: Any) -> dict[str, Any]:
    for key in reversed(keys):
        value = {key: value}
    return dict(value)
