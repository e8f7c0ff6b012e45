"""The inputs that determine the result of a run, and their key."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from opfmodel.data.files import read_bytes
from opfmodel.errors import ScenarioError
from opfmodel.plugins.versions import versions
from opfmodel.scenario import laid_over
from opfmodel.scenario.document import Document, read_document
from opfmodel.study.document import Study, Variation
from opfmodel.study.files import named_files

__all__ = ["Inputs", "Snapshot", "Specification"]

# Keys of a scenario that do not affect results once the variant is selected.
_WORDS = ("name", "description", "published", "variants", "checkpoint")


@dataclass(frozen=True)
class Inputs:
    """The files of a run, with their content when they were read.

    Attributes
    ----------
    root
        Folder that contains all files.
    scenario
        The scenario file, relative to ``root``.
    files
        Content by name relative to ``root``.
    """

    root: Path
    scenario: str
    files: Mapping[str, bytes]

    @contextmanager
    def unpacked(self) -> Iterator[tuple[Path, Path]]:
        """Write a temporary copy of the files; yield its root and its scenario file."""
        with TemporaryDirectory(prefix="opfmodel-") as folder:
            copy = Path(folder)
            for name, content in self.files.items():
                (copy / name).parent.mkdir(parents=True, exist_ok=True)
                (copy / name).write_bytes(content)
            yield copy, copy / self.scenario

    @property
    def data(self) -> dict[str, str]:
        """Digest of every file except the scenario, by name relative to the scenario's folder."""
        folder = os.path.dirname(self.scenario)  # noqa: PTH120 - a name inside root, not a path
        return {
            os.path.relpath(name, folder or "."): hashlib.sha256(content).hexdigest()
            for name, content in sorted(self.files.items())
            if name != self.scenario
        }


@dataclass(frozen=True)
class Specification:
    """One run: everything that its result depends on, and nothing else.

    Attributes
    ----------
    labels
        The point on each axis; names the run, but is not part of the key.
    variant, overrides
        Variant and overrides of the scenario.
    content
        Keys of the scenario with variant and overrides applied.
    versions
        Versions of the packages that affect the result.
    keeps_trajectories
        Whether the record has the trajectories of the run; not part of the key.
    starts_warm
        Whether the first plan may start from that of another run, so that iterations depend on the order of
        the runs.
    """

    labels: Mapping[str, Any]
    variant: str | None
    overrides: Mapping[str, Any]
    content: Mapping[str, Any]
    inputs: Inputs
    versions: Mapping[str, str]
    keeps_trajectories: bool = False
    starts_warm: bool = False

    @cached_property
    def key(self) -> str:
        """Digest of content, data files, versions and warm starts: 32 hexadecimal digits."""
        starts = {"starts": "warm"} if self.starts_warm else {}
        text = json.dumps(
            {"content": self.content, "data": self.inputs.data, "versions": self.versions, **starts},
            sort_keys=True,
            default=str,  # a date in YAML
        )
        return hashlib.sha256(text.encode()).hexdigest()[:32]


class Snapshot:
    """The files of a study, each read once; all runs see the same content."""

    def __init__(self) -> None:
        self._documents: dict[Path, Document] = {}
        self._files: dict[Path, bytes] = {}

    def specifications(self, study: Study) -> list[Specification]:
        """Return the runs of a study in the order of its grid."""
        return [self._specification(study, variation) for variation in study.variations()]

    def changed(self) -> list[Path]:
        """Return the files that have changed since they were read."""
        return [path for path, content in self._files.items() if not _holds(path, content)]

    def _specification(self, study: Study, variation: Variation) -> Specification:
        path = variation.scenario
        if path not in self._documents:
            before = self._file(path)
            self._documents[path] = read_document(path)
            if not _holds(path, before):
                raise ScenarioError(f"{path}: changed while it was being read; start again")
        document = self._documents[path]
        try:
            content = laid_over(document, variation.variant, variation.overrides)
        except ScenarioError:  # rejected as a combination: the run will fail with this error
            content = {"refused": {"scenario": document.content, "variant": variation.variant}}
        content = {k: v for k, v in content.items() if k not in _WORDS}
        return Specification(
            labels=variation.labels,
            variant=variation.variant,
            overrides=variation.overrides,
            content=content,
            inputs=self._inputs(document, content),
            versions=versions(),
            keeps_trajectories=study.keep == "trajectories",
            starts_warm=study.starts == "warm",
        )

    def _inputs(self, document: Document, content: Mapping[str, Any]) -> Inputs:
        """Return the scenario file and every file named by a text in its content."""
        paths = [document.path, *named_files(document, content)]
        absolute = {os.path.abspath(path): path for path in paths}  # noqa: PTH100 - keep symbolic links
        root = os.path.commonpath([os.path.dirname(name) for name in absolute])  # noqa: PTH120
        names = {os.path.relpath(name, root): self._file(path) for name, path in absolute.items()}
        return Inputs(Path(root), next(iter(names)), names)

    def _file(self, path: Path) -> bytes:
        if path not in self._files:
            self._files[path] = read_bytes(path, ScenarioError)
        return self._files[path]


def _holds(path: Path, content: bytes) -> bool:
    try:
        return read_bytes(path, ScenarioError) == content
    except ScenarioError:
        return False
