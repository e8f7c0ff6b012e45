"""The ``constraints`` section of a scenario file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from opfmodel.data.columns import read_columns
from opfmodel.errors import (
    ConstraintError,
    ModelError,
    OpfmodelError,
    ProfileError,
    QuantityError,
    close,
    nearest,
    raise_all,
    shown,
)
from opfmodel.model import CustomConstraint, Linear, PhysicalStage
from opfmodel.network.bounds import bounded, is_number
from opfmodel.objectives.economic import Economic
from opfmodel.plan import MultiStage
from opfmodel.scenario.document import Document
from opfmodel.scenario.schema import ScenarioFile

__all__ = ["check_constraints", "read_constraints"]


def read_constraints(document: Document, settings: ScenarioFile) -> dict[str, CustomConstraint]:
    """Return the constraints of a file, by name; those with faulty limits have others, to check terms."""
    made: dict[str, CustomConstraint] = {}
    for name, values in settings.constraints.items():
        if document.faults.broken("constraints", name):
            continue
        with document.faults, document.located("constraints", name):
            made[name] = _constraint(name, values, settings.length, document.path.parent)
        terms = values.get("terms") if isinstance(values, Mapping) else None
        if name not in made and isinstance(terms, Mapping):
            with suppress(ConstraintError):
                made[name] = CustomConstraint.of(name, Linear(terms), at_least=0.0)
    return made


def _constraint(name: str, values: object, steps: int, folder: Path) -> CustomConstraint:
    """Build a linear constraint from plain values.

    Parameters
    ----------
    values
        ``terms`` and the limits: ``at_least``, ``at_most`` or both, or ``equal``. Each limit is a
        number, a list, or ``{file: , column: }``.
    steps
        Number of values required of a time-varying limit.
    folder
        Folder to which file names are relative.

    Raises
    ------
    ConstraintError
        The constraint is malformed; the error carries the key.
    """
    known = ("terms", "at_least", "at_most", "equal")
    if not isinstance(values, Mapping):
        raise ConstraintError(f"must be a mapping; accepted keys are {', '.join(known)}")
    limits: dict[str, float | list[float]] = {}

    def errors() -> Iterator[OpfmodelError]:
        yield from _errors_of_keys(values, known)
        for key in known[1:]:
            try:
                if key in values:
                    limits[key] = _limit(values[key], key, steps, folder)
            except ConstraintError as error:
                yield error
        if isinstance(values.get("terms"), Mapping):
            try:
                Linear(values["terms"])
            except ConstraintError as error:
                yield from (error, *error.others)

    raise_all(errors())
    if not limits:
        raise ConstraintError("needs a limit: at_least, at_most or equal")
    if "equal" in limits:
        if len(limits) > 1:
            raise ConstraintError("cannot be combined with at_least or at_most", "equal")
        limits = dict.fromkeys(("at_least", "at_most"), limits["equal"])
    return CustomConstraint.of(name, Linear(values["terms"]), **limits)


def _errors_of_keys(values: Mapping[str, Any], known: Sequence[str]) -> Iterator[ConstraintError]:
    for key in values:
        if key not in known:
            yield ConstraintError(f"unknown key; {nearest(key, known)}", key)
    meant = {name for key in values if key not in known for name in close(key, known)}
    if not isinstance(values.get("terms"), Mapping) and ("terms" in values or "terms" not in meant):
        yield ConstraintError("must be a mapping from kind.quantity to a factor", "terms")


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
        if not (is_number(number) and bounded(number)):
            raise ConstraintError(
                f"{shown(number)}: must be a finite number, or a list with one per step", key
            )
        numbers.append(float(number))
    if not isinstance(value, list):
        return numbers[0]
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
            model = bare.declare(stages=1)
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
            found = problem.explain(error) if isinstance(error, QuantityError) else error
            found.key = ("terms", key)
            yield found
