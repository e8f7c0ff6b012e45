"""Clusters that Dask starts for one study: jobs of SLURM, and processes on machines reached by SSH."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from opfmodel.errors import StudyError
from opfmodel.scenario.document import read_document, validated

__all__ = ["ManagedCluster", "read_cluster"]


class ClusterFile(BaseModel):
    """The content of a cluster file: one sort of cluster, with the arguments of its class."""

    model_config = ConfigDict(extra="forbid", strict=True)

    slurm: dict[str, Any] | None = Field(
        None, description="arguments of dask_jobqueue.SLURMCluster, and the number of workers"
    )
    ssh: dict[str, Any] | None = Field(None, description="arguments of distributed.SSHCluster")


# The class, and the package that it needs; Dask does not require it.
_CLASSES = {
    "slurm": ("dask_jobqueue", "SLURMCluster", "dask-jobqueue"),
    "ssh": ("distributed", "SSHCluster", "asyncssh"),
}


@dataclass(frozen=True)
class ManagedCluster:
    """A cluster as a cluster file states it.

    Attributes
    ----------
    path
        The file.
    kind
        ``slurm`` or ``ssh``.
    options
        Arguments of Dask's class.
    workers
        Number of workers to request; None where the arguments determine it.
    """

    path: Path
    kind: str
    options: dict[str, Any]
    workers: int | None

    def check_installed(self) -> None:
        """Raise :class:`StudyError` if a package is missing that the class needs."""
        module, _, package = _CLASSES[self.kind]
        for name in (module, package.replace("-", "_")):
            try:
                _imported(name)
            except ImportError as error:
                raise StudyError(
                    f"{self.path}: {self.kind}: needs the package {package} ({error}); pip install {package}"
                ) from error

    @contextmanager
    def started(self) -> Iterator[Any]:
        """Start the cluster, and end it with the context.

        Raises
        ------
        StudyError
            The package is missing, or the class refuses its arguments or fails to start.
        """
        self.check_installed()
        module, name, _ = _CLASSES[self.kind]
        with ExitStack() as stack:
            try:
                cluster = stack.enter_context(getattr(_imported(module), name)(**self.options))
                if self.workers is not None:
                    cluster.scale(self.workers)
            except Exception as error:  # Dask's classes raise errors of several libraries
                reason = " ".join(str(error).split()) or type(error).__name__
                raise StudyError(
                    f"{self.path}: {self.kind}: the cluster could not be started: {reason}"
                ) from error
            yield cluster


def _imported(name: str) -> ModuleType:
    """Import a module; dask_jobqueue replaces the handler of Ctrl-C when it is imported."""
    before = signal.getsignal(signal.SIGINT)
    try:
        return import_module(name)
    finally:
        if signal.getsignal(signal.SIGINT) is not before:
            signal.signal(signal.SIGINT, before)


def read_cluster(path: str | Path) -> ManagedCluster:
    """Read a cluster file.

    Raises
    ------
    ScenarioError
        The file cannot be read, or states no cluster or several; the message gives line and column.
    """
    document = read_document(path)
    if not isinstance(document.content, dict):
        raise document.error((), f"must be a mapping with one key: {' or '.join(_CLASSES)}")
    file = validated(document, document.content, ClusterFile)
    document.faults.settle()
    stated = {kind: options for kind in _CLASSES if (options := getattr(file, kind)) is not None}
    if len(stated) != 1:
        raise document.error((), f"must have one key: {' or '.join(_CLASSES)}")
    ((kind, options),) = stated.items()
    workers = options.pop("workers", None) if kind == "slurm" else None
    if kind == "slurm" and (not isinstance(workers, int) or isinstance(workers, bool) or workers < 1):
        raise document.error((kind, "workers"), "must be the number of workers, at least 1")
    return ManagedCluster(document.path, kind, options, workers)
