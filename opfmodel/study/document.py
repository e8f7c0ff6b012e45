"""Study files: a base scenario and the axes along which it varies."""

from __future__ import annotations

import itertools
import json
import math
from collections import ChainMap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from opfmodel.errors import IncompatibleError, ScenarioError
from opfmodel.scenario import load_scenario
from opfmodel.scenario.document import Document, check_name, check_printable, read_document, validated

__all__ = ["Axis", "Study", "Variation", "read_study"]

Changes = Mapping[str, Any]
Key = tuple[str | int, ...]

_MOST_RUNS = 100_000  # each run has a record and a row


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)

    name: str | None = None
    description: str = ""
    scenario: str | None = None
    variant: str | None = None
    set: dict[str, Any] = Field(default_factory=dict)
    vary: dict[str, Any] = Field(default_factory=dict)


@dataclass(frozen=True)
class Axis:
    """One axis of the grid of a study.

    Attributes
    ----------
    name
        A dotted key of the scenario, ``scenario`` or ``variant``; for sets of keys, any name.
    labels
        Label of each point in the table.
    changes
        Keys set by each point.
    positions
        Position of each point in the file.
    """

    name: str
    labels: tuple[Any, ...]
    changes: tuple[Changes, ...]
    positions: tuple[Key, ...]

    @property
    def keys(self) -> set[str]:
        """All keys set by the axis."""
        return {key for changes in self.changes for key in changes}


@dataclass(frozen=True)
class Variation:
    """One run of a study: a scenario, a variant, and overrides.

    Attributes
    ----------
    labels
        Label of the point on each axis, by name of the axis.
    """

    labels: Mapping[str, Any]
    scenario: Path
    variant: str | None
    overrides: Mapping[str, Any]


@dataclass(frozen=True)
class Study:
    """A study file that has been read and validated.

    Attributes
    ----------
    base
        Keys set in every run unless an axis overrides them.
    """

    name: str
    path: Path
    base: Changes
    axes: tuple[Axis, ...]

    def __len__(self) -> int:
        """Number of runs."""
        return math.prod(len(axis.labels) for axis in self.axes)

    def variations(self) -> Iterator[Variation]:
        """Yield all runs; the last axis varies fastest."""
        for point in itertools.product(*(range(len(axis.labels)) for axis in self.axes)):
            yield self.variation(point)

    def variation(self, point: tuple[int, ...]) -> Variation:
        """Return the run at a point of the grid, given by indices on all axes or on the first few."""
        placed = list(zip(self.axes, point, strict=False))
        changes = [axis.changes[place] for axis, place in placed]
        keys = {**self.base, **ChainMap(*map(dict, changes))}
        scenario, variant = keys.pop("scenario"), keys.pop("variant", None)
        return Variation(
            {axis.name: axis.labels[place] for axis, place in placed},
            self.path.parent / str(scenario),
            None if variant is None else str(variant),
            keys,
        )


def read_study(path: str | Path) -> Study:
    """Read a study file and check every point of every axis, with the other axes at their first.

    Incompatible parts (:class:`IncompatibleError`), such as an objective that needs quantities a
    formulation lacks, are accepted; those runs become failed rows of the table.

    Raises
    ------
    ScenarioError
        The file violates its schema, or sets a key that the scenario rejects; the message gives
        file, line and column.
    """
    document = read_document(path)
    if not isinstance(document.content, dict):
        raise document.error((), "a study is a mapping with the keys 'scenario' and 'vary'")
    if "network" in document.content:
        raise document.error(("network",), "this file is a scenario; run it with 'opfmodel run'")
    file = validated(document, document.content, _File)
    for key in ("scenario", "variant"):
        if key in file.set:
            raise document.error(("set", key), "is a key of the study; move it out of 'set'")
    base = {"scenario": file.scenario, "variant": file.variant, **file.set}
    axes = tuple(_axis(document, name, content) for name, content in file.vary.items())
    for one, other in itertools.combinations(axes, 2):
        for key in sorted(_common(one, other)):
            raise document.error(("vary", other.name), f"{key!r} is already varied by {one.name!r}")
    if file.scenario is None and not any("scenario" in changes for a in axes for changes in a.changes):
        raise document.error(("scenario",), "this key is missing")
    runs = math.prod(len(axis.labels) for axis in axes)
    if runs > _MOST_RUNS:
        raise document.error(("vary",), f"the grid has {runs:,} runs; at most {_MOST_RUNS:,} are accepted")
    name = document.path.stem if file.name is None else file.name
    check_name(document, ("name",), name)
    study = Study(name, document.path, base, axes)
    _check(document, study)
    return study


def _axis(document: Document, name: str, content: Any) -> Axis:
    """Build an axis from a list of values of one key, or from named sets of keys."""
    key: Key = ("vary", name)
    labels: tuple[Any, ...]
    changes: tuple[Changes, ...]
    if isinstance(content, list):
        labels, places = tuple(_label(value) for value in content), tuple(range(len(content)))
        changes = tuple({name: value} for value in content)
    elif isinstance(content, dict):
        labels = places = tuple(content)
        changes = tuple(content.values())
    else:
        raise document.error(key, "must be a list of values, or a mapping from names to sets of keys")
    if not labels:
        raise document.error(key, "needs at least one value")
    check_printable(document, key, name)
    positions = tuple((*key, place) for place in places)
    for number, (label, bundle) in enumerate(zip(labels, changes, strict=True)):
        check_printable(document, positions[number], str(label))
        if not isinstance(bundle, dict):
            raise document.error(positions[number], "must be a mapping from dotted keys to values")
        if (type(label), label) in [(type(other), other) for other in labels[:number]]:
            raise document.error(positions[number], f"{label!r} is listed twice")
    return Axis(name, labels, changes, positions)


def _label(value: Any) -> Any:
    """Return numbers, text and None unchanged; mappings and lists as JSON; others, such as dates, as text."""
    if isinstance(value, Mapping | list):
        return json.dumps(value, default=str)
    return value if isinstance(value, str | int | float | None) else str(value)


def _common(one: Axis, other: Axis) -> set[str]:
    """Return the keys that both axes set, or that one sets within a value that the other sets."""
    ends = [
        {
            end
            for changes in axis.changes
            for key, value in changes.items()
            for end in _ends(key.split("."), value)
        }
        for axis in (one, other)
    ]
    starts = [{end[:length] for end in of for length in range(1, len(end) + 1)} for of in ends]
    within = (ends[0] & starts[1]) | (ends[1] & starts[0])
    return (one.keys & other.keys) | {".".join(key) for key in within}


def _ends(path: Sequence[str], value: Any) -> Iterator[tuple[str, ...]]:
    """Yield the paths of all keys that a value sets, descending into mappings."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _ends([*path, key], inner)
    else:
        yield tuple(path)


def _check(document: Document, study: Study) -> None:
    """Check every point of every axis; an error is located at the line of the study that caused it."""
    origin = (0,) * len(study.axes)
    error = _refusal(study.variation(origin))
    if error is not None:
        raise document.error(_culprit(study), str(error)) from error
    for number, axis in enumerate(study.axes):
        for place in range(1, len(axis.labels)):
            error = _refusal(study.variation((*origin[:number], place, *origin[number + 1 :])))
            if error is not None:
                raise document.error(axis.positions[place], str(error)) from error


def _culprit(study: Study) -> Key:
    """Return what makes the first run invalid: the scenario, ``set``, or the first point of an axis."""
    bare = {key: study.base[key] for key in ("scenario", "variant")}
    if study.base["scenario"] is not None:
        if _refusal(replace(study, base=bare).variation(())) is not None:
            return ("scenario",)
        if _refusal(study.variation(())) is not None:
            return ("set",)
    for number, axis in enumerate(study.axes[:-1]):
        point = (0,) * (number + 1)
        known = study.base["scenario"] is not None or any(
            "scenario" in a.keys for a in study.axes[: number + 1]
        )
        if known and _refusal(study.variation(point)) is not None:
            return axis.positions[0]
    return study.axes[-1].positions[0]


def _refusal(variation: Variation) -> ScenarioError | None:
    """Return the error with which a scenario rejects a variation, if any."""
    try:
        load_scenario(variation.scenario, variation.variant, variation.overrides)
    except ScenarioError as error:
        return None if isinstance(error.__cause__, IncompatibleError) else error
    return None
