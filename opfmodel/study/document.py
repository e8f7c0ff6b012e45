"""Study files: a base scenario and the axes along which it varies."""

from __future__ import annotations

import itertools
import json
import math
from collections import ChainMap
from collections.abc import Iterable, Iterator, Mapping, Set
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field

from opfmodel.data.notebook import pairs
from opfmodel.errors import Fault, IncompatibleError, ScenarioError, shown
from opfmodel.scenario import laid_over, load_scenario
from opfmodel.scenario.document import Document, check_name, check_printable, read_document, validated
from opfmodel.study.files import check_relative

__all__ = ["Axis", "Study", "StudyFile", "Variation", "read_study"]

Changes = Mapping[str, Any]
Key = tuple[str | int, ...]
Keys = tuple[str, ...]
Keep = Literal["figures", "trajectories"]
Starts = Literal["cold", "warm"]

_MOST_RUNS = 100_000  # each run has a record and a row


class StudyFile(BaseModel):
    """The content of a study file."""

    model_config = ConfigDict(extra="forbid", strict=True)

    name: str | None = Field(
        None,
        description="name of the study and of its results folder, by default that of the file; the rules are "
        "those of scenario names",
    )
    description: str = Field("", description="free text")
    scenario: str | None = Field(None, description="scenario file; required, here or as an axis")
    variant: str | None = Field(
        None, description="variant of the scenario; as an axis, null is the scenario itself"
    )
    set: dict[str, Any] = Field(
        default_factory=dict,
        description="dotted keys of the scenario, the same in every run unless an axis sets them",
    )
    keep: Keep = Field(
        "figures",
        description="what is kept of every run: the figures of its row in the table, or its trajectories as "
        "well, as 'opfmodel run' writes them",
    )
    starts: Starts = Field(
        "cold",
        description="how the first plan of a run starts: cold, or warm from that of the last run on the same "
        "worker whose problem differs in numbers only; then iterations depend on the order of the runs",
    )
    vary: dict[str, Any] = Field(
        default_factory=dict,
        description="axes of the grid; the study runs every combination, the last axis varying fastest",
    )


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
    keep
        Whether ``figures`` are kept of every run, or ``trajectories`` as well.
    starts
        Whether the first plan of a run starts ``cold``, or ``warm`` from that of another run.
    """

    name: str
    path: Path
    base: Changes
    axes: tuple[Axis, ...]
    keep: Keep = "figures"
    starts: Starts = "cold"

    def __repr__(self) -> str:
        axes = ", ".join(f"{axis.name} ({len(axis.labels)})" for axis in self.axes)
        return f"Study({self.name!r}: {len(self)} runs over {axes or 'no axis'})"

    def _repr_html_(self) -> str:
        """Show the axes in a notebook."""
        axes = {axis.name: ", ".join(map(str, axis.labels)) for axis in self.axes}
        return pairs(f"{self.name}: {len(self)} runs", {**axes, "keeps": self.keep, "starts": self.starts})

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
    faults = document.faults
    if not isinstance(document.content, dict):
        raise document.error((), "a study is a mapping with the keys 'scenario' and 'vary'")
    if "network" in document.content:
        raise document.error(("network",), "this file is a scenario; run it with 'opfmodel run'")
    file = validated(document, document.content, StudyFile)
    for key in ("scenario", "variant"):
        if key in file.set:
            faults.add(document.fault(("set", key), "is a key of the study; move it out of 'set'"))
    with faults:
        _check_bundle(document, ("set",), file.set)
    base = {"scenario": file.scenario, "variant": file.variant, **file.set}
    made = (_axis(document, name, content) for name, content in file.vary.items())
    axes = tuple(axis for axis in made if axis is not None)
    with faults:
        _check_axes(document, axes)
    varied = any("scenario" in changes for axis in axes for changes in axis.changes)
    if not (file.scenario or varied or faults.broken("scenario") or faults.broken("vary")):
        faults.add(document.fault(("scenario",), "this key is missing"))
    runs = math.prod(len(axis.labels) for axis in axes)
    if runs > _MOST_RUNS:
        message = f"the grid has {runs:,} runs; at most {_MOST_RUNS:,} are accepted"
        faults.add(document.fault(("vary",), message))
    name = document.path.stem if file.name is None else file.name
    check_name(document, ("name",), name)
    study = Study(name, document.path, base, axes, file.keep, file.starts)
    faults.settle()
    _Trial(document, study).check()
    faults.settle()
    return study


def _axis(document: Document, name: str, content: Any) -> Axis | None:
    """Build an axis from a list of values of one key, or from named sets of keys; None if it is neither."""
    key: Key = ("vary", name)
    labels: tuple[Any, ...]
    changes: tuple[Any, ...]
    if isinstance(content, list):
        labels, places = tuple(_label(value) for value in content), tuple(range(len(content)))
        changes = tuple({name: value} for value in content)
    elif isinstance(content, dict):
        labels = places = tuple(content)
        changes = tuple(content.values())
    else:
        message = f"{shown(content)}: must be a list of values, or a mapping from names to sets of keys"
        document.faults.add(document.fault(key, message))
        return None
    with document.faults:
        if not labels:
            raise document.error(key, "needs at least one value")
        check_printable(document, key, name)
    positions = tuple((*key, place) for place in places)
    known: set[tuple[type, Any]] = set()  # with the type: 1 == True
    for position, label, bundle in zip(positions, labels, changes, strict=True):
        with document.faults:
            check_printable(document, position, str(label))
            if not isinstance(bundle, dict):
                raise document.error(position, "must be a mapping from dotted keys to values")
            _check_bundle(document, position, bundle)
            if (type(label), label) in known:
                raise document.error(position, f"{label!r} is listed twice")
            known.add((type(label), label))
    mappings = tuple(bundle if isinstance(bundle, dict) else {} for bundle in changes)
    return Axis(name, labels, mappings, positions)


def _label(value: Any) -> Any:
    """Return numbers, text and None unchanged; mappings and lists as JSON; others, such as dates, as text."""
    if isinstance(value, Mapping | list):
        return json.dumps(value, default=str)
    return value if isinstance(value, str | int | float | None) else str(value)


class _Claim(NamedTuple):
    """A key and what sets it."""

    key: str
    owner: str


class _Claims:
    """Which owner sets which keys; no two set the same key, or one inside a value that another sets."""

    def __init__(self) -> None:
        self._ends: dict[Keys, str] = {}
        self._starts: dict[Keys, str] = {}

    def add(self, owner: str, paths: Set[Keys]) -> _Claim | None:
        """Add the keys of an owner, or return the first that an earlier owner sets."""
        for path in sorted(paths):
            for start in _starts(path):
                if start in self._ends:
                    return _Claim(".".join(start), self._ends[start])
            if path in self._starts:
                return _Claim(".".join(path), self._starts[path])
        for path in paths:
            self._ends[path] = owner
            self._starts |= dict.fromkeys(_starts(path), owner)
        return None


def _check_axes(document: Document, axes: tuple[Axis, ...]) -> None:
    """Raise an error if two axes set the same key."""
    claims, owners = _Claims(), dict[str, str]()
    for axis in axes:
        for key in sorted(axis.keys & owners.keys()):  # of two mappings, a run would take only one
            raise document.error(("vary", axis.name), f"{key!r} is already varied by {owners[key]!r}")
        owners |= dict.fromkeys(axis.keys, axis.name)
        if taken := claims.add(axis.name, {path for changes in axis.changes for path in _paths(changes)}):
            raise document.error(("vary", axis.name), f"{taken.key!r} is already varied by {taken.owner!r}")


def _check_bundle(document: Document, position: Key, changes: Changes) -> None:
    """Raise an error if two dotted keys of a mapping set the same key of the scenario."""
    claims = _Claims()
    for key, value in changes.items():
        if taken := claims.add(key, set(_paths({key: value}))):
            raise document.error((*position, key), f"{taken.key!r} is already set by {taken.owner!r}")


def _starts(path: Keys) -> list[Keys]:
    """Return the beginnings of a path, and the path."""
    return [path[:length] for length in range(1, len(path) + 1)]


def _paths(changes: Changes) -> Iterator[Keys]:
    """Yield the paths of all keys that dotted keys set, descending into mappings."""
    for key, value in changes.items():
        yield from _ends(tuple(key.split(".")), value)


def _ends(path: Keys, value: Any) -> Iterator[Keys]:
    if isinstance(value, Mapping) and value:
        for key, inner in value.items():
            yield from _ends((*path, key), inner)
    else:
        yield path


class _Trial:
    """Reading of the scenario at every point of every axis; each file is read once."""

    def __init__(self, document: Document, study: Study) -> None:
        self.document = document
        self.study = study
        self.scenarios: dict[Path, Document] = {}

    def check(self) -> None:
        """Collect the faults of the scenario, located at the line of the study that caused them."""
        study, origin = self.study, (0,) * len(self.study.axes)
        common = left = self.faults(study.variation(origin))
        for key, variation in self.prefixes() if common else ():
            found = self.faults(variation)
            self.blame(key, [fault for fault in left if fault in found])
            left = [fault for fault in left if fault not in found]
        for number, axis in enumerate(study.axes):
            for place in range(1, len(axis.labels)):
                point = (*origin[:number], place, *origin[number + 1 :])
                found = self.faults(study.variation(point))
                self.blame(axis.positions[place], [fault for fault in found if fault not in common])

    def prefixes(self) -> Iterator[tuple[Key, Variation]]:
        """Yield what is added one by one to the scenario in the first run, with the variation so far."""
        study = self.study
        known = study.base["scenario"] is not None
        if known:
            bare = {key: study.base[key] for key in ("scenario", "variant")}
            yield ("scenario",), replace(study, base=bare).variation(())
            yield ("set",), study.variation(())
        for number, axis in enumerate(study.axes):
            known = known or "scenario" in axis.keys
            if known:
                yield axis.positions[0], study.variation((0,) * (number + 1))

    def blame(self, key: Key, faults: Iterable[Fault]) -> None:
        """Collect faults of a scenario at a key of the study."""
        for fault in faults:
            said = str(fault) if fault.line is not None or not fault.key else fault.statement
            self.document.faults.add(self.document.fault(key, said, fault.cause))

    def faults(self, variation: Variation) -> list[Fault]:
        """Return why a scenario or a study rejects a variation, unless parts of it cannot be combined."""
        try:
            scenario = self.scenario(variation.scenario)
            load_scenario(scenario, variation.variant, variation.overrides)
            check_relative(scenario, laid_over(scenario, variation.variant, variation.overrides))
        except ScenarioError as error:
            return [fault for fault in error.faults if not isinstance(fault.cause, IncompatibleError)]
        return []

    def scenario(self, path: Path) -> Document:
        """Return the content of a scenario file."""
        if path not in self.scenarios:
            self.scenarios[path] = read_document(path)
        return self.scenarios[path]
