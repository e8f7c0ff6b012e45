"""The ``constraints`` section of a scenario file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from opfmodel.data.grid import Grid
from opfmodel.errors import (
    ConstraintError,
    IncompatibleError,
    ModelError,
    ProfileError,
    QuantityError,
)
from opfmodel.horizon import Horizon
from opfmodel.model import CustomConstraint, Linear, PhysicalStage
from opfmodel.objectives.economic import Economic
from opfmodel.plan import MultiStage
from opfmodel.scenario.document import Document
from opfmodel.scenario.files import FILE_OPTIONS, read_fitted, repeated
from opfmodel.scenario.schema import ColumnSection, ConstraintSection, ScenarioFile

__all__ = ["check_constraints", "read_constraints"]


def read_constraints(document: Document, settings: ScenarioFile, grid: Grid) -> dict[str, CustomConstraint]:
    """Return the constraints of a file, by name.

    Parameters
    ----------
    grid
        The steps that limits cover.

    Raises
    ------
    ScenarioError
        A constraint is malformed.
    """
    made = {}
    for name, values in settings.constraints.items():
        with document.located("constraints", name):
            made[name] = _constraint(name, values, grid, document.path.parent)
    return made


def _constraint(name: str, section: ConstraintSection, grid: Grid, folder: Path) -> CustomConstraint:
    """Build a linear constraint.

    Parameters
    ----------
    grid
        The steps that a limit covers.
    folder
        Folder to which file names are relative.

    Raises
    ------
    ConstraintError
        The constraint is malformed; the error carries the key.
    """
    stated = {"at_least": section.at_least, "at_most": section.at_most, "equal": section.equal}
    limits = {key: _limit(value, key, grid, folder) for key, value in stated.items() if value is not None}
    if not limits:
        raise ConstraintError("needs a limit: at_least, at_most or equal")
    if "equal" in limits:
        if len(limits) > 1:
            raise ConstraintError("cannot be combined with at_least or at_most", "equal")
        limits = dict.fromkeys(("at_least", "at_most"), limits["equal"])
    return CustomConstraint.of(name, Linear(section.terms), **limits)


def _limit(
    value: float | list[float] | ColumnSection, key: str, grid: Grid, folder: Path
) -> float | list[float]:
    if isinstance(value, ColumnSection):
        path, heading = folder / value.file, str(value.column)
        options = value.model_dump(include=set(FILE_OPTIONS), exclude_none=True)
        try:
            fitted = read_fitted(path, grid, [heading], **options)
            return [float(number) for number in fitted.values[heading]]
        except ProfileError as error:
            raise ConstraintError(str(error), key) from error
    if not isinstance(value, list):
        return value
    steps, numbers = grid.steps, value
    if grid.at_end == "repeat":
        numbers = repeated(numbers, steps)
    if len(numbers) < steps:
        raise ConstraintError(f"has {len(numbers)} values; {steps} are needed (steps + horizon - 1)", key)
    return numbers[:steps]


def check_constraints(
    document: Document, constraints: Mapping[str, CustomConstraint], problem: MultiStage
) -> None:
    """Check that every term exists in the network and is published by the formulation.

    Errors carry the position of the term. Terms that only this formulation lacks are reported last.
    """
    if not constraints:
        return
    bare = problem.variant(elastic=None, objective=Economic())  # avoids solving for set-points
    with document.located("controller"):
        model = bare.declare(Horizon.chain(1, problem.step))
    stage: Any = PhysicalStage(model)
    unpublished: dict[tuple[str, ...], ModelError] = {}
    for name, constraint in constraints.items():
        missing: dict[tuple[str, ...], ModelError] = {}
        with document.located("constraints", name):
            linear = constraint.state
            assert isinstance(linear, Linear)
            constraint.check_price(model)
            for key in linear.terms:
                try:
                    linear.term(stage, key)
                except QuantityError as error:
                    missing["constraints", name, "terms", key] = problem.explain(error)
            if not missing:
                linear(stage)
        unpublished |= missing
    for where, fault in sorted(unpublished.items(), key=lambda item: isinstance(item[1], IncompatibleError)):
        with document.located(*where):
            raise fault
