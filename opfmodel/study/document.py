"""The study file: a base scenario and the axes along which it varies."""

from __future__ import annotations

import itertools
import json
import math
from collections import ChainMap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from opfmodel.documents import Document, read_document, validated
from opfmodel.errors import ModelError, ScenarioError
from opfmodel.scenario import load_scenario

__all__ = ["Axis", "Study", "Variation", "read_study"]

Changes = Mapping[str, Any]


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
    """One thing that varies.

    Attributes
    ----------
    name
        A dotted key of the scenario, ``scenario`` or ``variant``; or a name of the study's own for
        bundles of keys.
    labels
        What the table shows for each point of the axis.
    changes
        The keys that each point sets.
    """

    name: str
    labels: tuple[Any, ...]
    changes: tuple[Changes, ...]

    @property
    def keys(self) -> set[str]:
        """All keys that the axis sets."""
        return {key for changes in self.changes for key in changes}


@dataclass(frozen=True)
class Variation:
    """One run of a study: a scenario, one of its variants, and keys laid over it.

    Attributes
    ----------
    labels
        The point on each axis, by the axis' name.
    """

    labels: Mapping[str, Any]
    scenario: Path
    variant: str | None
    overrides: Mapping[str, Any]


@dataclass(frozen=True)
class Study:
    """A study file that has been read and checked.

    Attributes
    ----------
    base
        Keys that every run sets unless an axis says otherwise.
    """

    name: str
    path: Path
    base: Changes
    axes: tuple[Axis, ...]

    def __len__(self) -> int:
        """Number of runs."""
        return math.prod(len(axis.labels) for axis in self.axes)

    def variations(self) -> Iterator[Variation]:
        """All runs; the last axis varies fastest."""
        for point in itertools.product(*(range(len(axis.labels)) for axis in self.axes)):
            yield self.variation(point)

    def variation(self, point: tuple[int, ...]) -> Variation:
        """The run at a point of the grid, given by its position on each axis."""
        changes = [axis.changes[place] for axis, place in zip(self.axes, point, strict=True)]
        keys = {**self.base, **ChainMap(*map(dict, changes))}
        scenario, variant = keys.pop("scenario"), keys.pop("variant", None)
        return Variation(
            {axis.name: axis.labels[place] for axis, place in zip(self.axes, point, strict=True)},
            self.path.parent / str(scenario),
            None if variant is None else str(variant),
            keys,
        )


def read_study(path: str | Path) -> Study:
    """Read a study file and try every point of every axis, the other axes at their first.

    Runs whose parts do not fit together (:class:`ModelError`: an objective that needs what a
    formulation lacks) are accepted: they become failed rows of the table.

    Raises
    ------
    ScenarioError
        The file breaks its schema, or sets a key that the scenario refuses; the message names
        file, line and column.
    """
    document = read_document(path)
    if not isinstance(document.content, dict):
        raise document.error((), "a study is a mapping with the keys 'scenario' and 'vary'")
    file = validated(document, document.content, _File)
    for key in ("scenario", "variant"):
        if key in file.set:
            raise document.error(("set", key), "is a key of the study itself; write it outside 'set'")
    base = {"scenario": file.scenario, "variant": file.variant, **file.set}
    axes = tuple(_axis(document, name, content) for name, content in file.vary.items())
    for one, other in itertools.combinations(axes, 2):
        for key in sorted(one.keys & other.keys):
            raise document.error(("vary", other.name), f"{key!r} is varied by {one.name!r} already")
    if file.scenario is None and not any("scenario" in axis.keys for axis in axes):
        raise document.error(("scenario",), "this key is missing")
    study = Study(file.name or document.path.stem, document.path, base, axes)
    _check(document, study)
    return study


def _axis(document: Document, name: str, content: Any) -> Axis:
    """An axis from a list of values of one key, or from named bundles of keys."""
    key = ("vary", name)
    if isinstance(content, list):
        labels = tuple(_label(value) for value in content)
        changes: tuple[Changes, ...] = tuple({name: value} for value in content)
    elif isinstance(content, dict):
        for label, bundle in content.items():
            if bundle is not None and not isinstance(bundle, dict):
                raise document.error((*key, label), "must be a mapping from dotted keys to values")
        labels = tuple(content)
        changes = tuple(bundle or {} for bundle in content.values())
    else:
        raise document.error(key, "must be a list of values, or a mapping from names to keys and values")
    if not labels:
        raise document.error(key, "needs at least one value")
    for place, label in enumerate(labels):
        if (type(label), label) in [(type(other), other) for other in labels[:place]]:
            raise document.error((*key, place), f"{label!r} is there twice")
    return Axis(name, labels, changes)


def _label(value: Any) -> Any:
    """A number, text or None as it is; anything else as JSON."""
    return value if isinstance(value, str | int | float | None) else json.dumps(value)


def _check(document: Document, study: Study) -> None:
    origin = (0,) * len(study.axes)
    _try(document, study, origin, ("scenario",) if study.base["scenario"] is not None else ("vary",))
    for number, axis in enumerate(study.axes):
        place = ("vary", axis.name)
        bundles = isinstance(document.content["vary"][axis.name], dict)
        for point, label in enumerate(axis.labels):
            here = (*origin[:number], point, *origin[number + 1 :])
            _try(document, study, here, (*place, str(label) if bundles else point))


def _try(document: Document, study: Study, point: tuple[int, ...], key: tuple[str | int, ...]) -> None:
    variation = study.variation(point)
    if variation.scenario == study.path.parent / "None":
        raise document.error(key, "names no scenario")
    try:
        load_scenario(variation.scenario, variation.variant, variation.overrides)
    except ScenarioError as error:
        if not isinstance(error.__cause__, ModelError):
            raise document.error(key, str(error)) from error
