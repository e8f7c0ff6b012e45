"""The ``constraints`` section of a scenario file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from opfmodel.data.columns import read_columns
from opfmodel.errors import (
    ConstraintError,
    IncompatibleError,
    ModelError,
    ProfileError,
    QuantityError,
    nearest,
    shown,
)
from opfmodel.horizon import Horizon
from opfmodel.model import CustomConstraint, Linear, PhysicalStage
from opfmodel.network.bounds import bounded, is_number
from opfmodel.objectives.economic import Economic
from opfmodel.plan import MultiStage
from opfmodel.scenario.document import Document
from opfmodel.scenario.schema import ScenarioFile

__all__ = ["check_constraints", "read_constraints"]


def read_constraints(document: Document, settings: ScenarioFile) -> dict[str, CustomConstraint]:
    """Return the constraints of a file, by name.

    Raises
    ------
    ScenarioError
        A constraint is malformed.
    """
    made = {}
    for name, values in settings.constraints.items():
        with document.located("constraints", name):
            made[name] = _constraint(name, values, settings.length, document.path.parent)
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
    for key in values:
        if key not in known:
            raise ConstraintError(f"unknown key; {nearest(key, known)}", key)
    terms = values.get("terms")
    if not isinstance(terms, Mapping):
        raise ConstraintError("must be a mapping from kind.quantity to a factor", "terms")
    limits = {key: _limit(values[key], key, steps, folder) for key in known[1:] if key in values}
    if not limits:
        raise ConstraintError("needs a limit: at_least, at_most or equal")
    if "equal" in limits:
        if len(limits) > 1:
            raise ConstraintError("cannot be combined with at_least or at_most", "equal")
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
