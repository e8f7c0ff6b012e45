"""The ``constraints`` section of a scenario file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from opfmodel.data.grid import Grid
from opfmodel.errors import (
    ConstraintError,
    ModelError,
    OpfmodelError,
    ProfileError,
    QuantityError,
    raise_all,
)
from opfmodel.horizon import Horizon
from opfmodel.model import CustomConstraint, Linear, PhysicalStage
from opfmodel.objectives.economic import Economic
from opfmodel.plan import MultiStage
from opfmodel.plan.compiled import explained
from opfmodel.scenario.document import Document
from opfmodel.scenario.files import FILE_OPTIONS, read_fitted, repeated
from opfmodel.scenario.schema import ColumnSection, ConstraintSection, ScenarioFile

__all__ = ["check_constraints", "read_constraints"]


def read_constraints(document: Document, settings: ScenarioFile, grid: Grid) -> dict[str, CustomConstraint]:
    """Return the constraints of a file, by name; those with faulty limits have others, to check terms.

    Parameters
    ----------
    grid
        The steps that limits cover.
    """
    made: dict[str, CustomConstraint] = {}
    for name, section in settings.constraints.items():
        if not document.faults.broken("constraints", name):
            with document.faults, document.located("constraints", name):
                made[name] = _constraint(name, section, grid, document.path.parent)
        if name not in made:
            with suppress(ConstraintError):
                made[name] = CustomConstraint.of(name, Linear(section.terms), at_least=0.0)
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
    limits: dict[str, float | list[float]] = {}

    def errors() -> Iterator[OpfmodelError]:
        for key, value in stated.items():
            try:
                if value is not None:
                    limits[key] = _limit(value, key, grid, folder)
            except ConstraintError as error:
                yield error
        try:
            Linear(section.terms)
        except ConstraintError as error:
            yield from (error, *error.others)

    raise_all(errors())
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
    """Collect the faults of terms that do not exist or that the formulation does not publish.

    They carry the position of the term.
    """
    if not constraints:
        return
    bare = problem.variant(elastic=None, objective=Economic())  # avoids solving for set-points
    with document.faults:
        with document.located("controller"):
            model = bare.declare(Horizon.chain(1, problem.step))
        stage: Any = PhysicalStage(model)
        for name, constraint in constraints.items():
            with document.faults, document.located("constraints", name):
                linear = constraint.state
                assert isinstance(linear, Linear)
                constraint.check_price(model)
                raise_all(_errors_of_terms(linear, stage, problem))
                linear(stage)


def _errors_of_terms(linear: Linear, stage: Any, problem: MultiStage) -> Iterator[ModelError]:
    for key in linear.terms:
        try:
            linear.term(stage, key)
        except ModelError as error:
            found = explained(problem, error) if isinstance(error, QuantityError) else error
            found.key = ("terms", key)
            yield found
