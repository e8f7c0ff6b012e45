"""Run a study: skip runs that have a record, execute and record the others."""

from __future__ import annotations

import os
import time
from collections.abc import Generator, Mapping
from contextlib import closing, nullcontext
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from opfmodel.errors import StudyError
from opfmodel.plugins.versions import versions
from opfmodel.study.document import Study
from opfmodel.study.execution import Record
from opfmodel.study.managed import ManagedCluster, read_cluster
from opfmodel.study.progress import Watcher, described, live
from opfmodel.study.provenance import machine, revision
from opfmodel.study.specification import Snapshot, Specification
from opfmodel.study.store import Store, untrusted
from opfmodel.study.workers import (
    check_crew,
    in_this_process,
    on_cluster,
    on_local_cluster,
    on_managed_cluster,
)
from solvers.interrupt import interruptible

__all__ = ["Outcome", "run_study"]


@dataclass(frozen=True)
class Outcome:
    """Outcome of one start of a study.

    Attributes
    ----------
    total
        Number of runs: the sum of ``done``, ``failed``, ``skipped`` and ``waiting``.
    done
        Runs completed by this start.
    failed
        Runs that failed in this start, or in an earlier one without being repeated.
    skipped
        Runs completed by an earlier start.
    interrupted
        Whether Ctrl-C ended the study.
    failures
        Error of each failed run, by its labels.
    notes
        Notes for the user.
    """

    total: int
    done: int
    failed: int
    skipped: int
    interrupted: bool
    seconds: float
    table: Path
    failures: Mapping[str, str]
    notes: tuple[str, ...] = ()

    @property
    def waiting(self) -> int:
        """Runs without a record."""
        return self.total - self.done - self.failed - self.skipped

    @property
    def complete(self) -> bool:
        """Whether every run is done."""
        return self.done + self.skipped == self.total

    def as_dict(self) -> dict[str, Any]:
        """The outcome as plain data."""
        return {**asdict(self), "waiting": self.waiting, "table": str(self.table)}


def run_study(
    study: Study,
    folder: str | Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    cluster: str | Path | None = None,
    memory: str | None = None,
    retry: Literal["failed", "all"] | None = None,
    progress: bool = False,
) -> Outcome:
    """Execute the runs of a study that have no record in its folder yet.

    All files are read once, at the start; later edits take effect at the next start. Ctrl-C ends
    the study; finished runs are kept.

    Parameters
    ----------
    folder
        Folder of records and table; created if necessary.
    workers
        Number of processes on this machine, each with one thread; 0 runs everything in this
        process. The default is the number of processors available to this process.
    scheduler
        Address of a running Dask scheduler, whose workers are used instead.
    cluster
        Cluster file, see :mod:`opfmodel.study.managed`: Dask starts the cluster for this study.
    memory
        Memory limit of each local worker, such as ``"2 GiB"``.
    retry
        Which recorded runs to repeat: ``failed`` or ``all``.
    progress
        Whether to show a line per worker and the time left on standard error.

    Raises
    ------
    StudyError
        The folder is in use, the scheduler does not answer, the cluster does not start, or an option is
        invalid.
    ScenarioError
        The cluster file is invalid.
    ResultError
        The folder cannot be written; its contents are kept.
    """
    if scheduler is not None and cluster is not None:
        raise StudyError("scheduler and cluster exclude each other: use a running cluster, or start one")
    if (scheduler or cluster) is not None and (workers is not None or memory is not None):
        elsewhere = "scheduler" if cluster is None else "cluster"
        raise StudyError(
            f"workers and memory cannot be combined with {elsewhere}, whose workers are used instead"
        )
    if workers is not None and workers < 0:
        raise StudyError(f"workers = {workers}: must be at least 0; 0 runs everything in this process")
    check_crew(scheduler, memory)
    managed = None if cluster is None else read_cluster(cluster)
    if managed is not None:
        managed.check_installed()
    began = time.perf_counter()
    store = Store(Path(folder))
    with store.locked():
        snapshot = Snapshot()
        runs = snapshot.specifications(study)
        options = {"workers": workers, "scheduler": scheduler, "memory": memory, "retry": retry}
        options["cluster"] = None if managed is None else managed.kind
        there, faults = store.records(run.key for run in runs)
        notes = _notes(store.index_fault(), faults)
        store.begin(runs, {**_about(study), "options": options})
        missing = _missing(runs, store, there, retry)
        made: set[str] = set()
        interrupted = False
        shown = live(study.name, len(missing)) if progress and missing else nullcontext(Watcher())
        with (
            shown as watcher,
            closing(_crew(missing, watcher, workers, scheduler, managed, memory)) as records,
        ):
            try:
                with interruptible():
                    for record in records:
                        made.add(record.key)  # first, since Ctrl-C may arrive between the two
                        store.write(record)
                        watcher.finished()
            except KeyboardInterrupt:
                interrupted = True
            except StudyError:
                store.write_table()
                raise
        store.write_table()
        notes += [
            f"{path} changed after the study had read it; the table is based on the earlier content, "
            "and the same command updates it"
            for path in snapshot.changed()
        ]
        return _outcome(store, runs, made, notes, interrupted, time.perf_counter() - began)


def _notes(index_fault: str | None, faults: list[str]) -> list[str]:
    """Return notes on files in the folder that cannot be trusted."""
    notes = [] if index_fault is None else [f"{index_fault}; it was rewritten"]
    return [*notes, f"{untrusted(faults)}; their runs are repeated"] if faults else notes


def _missing(
    runs: list[Specification], store: Store, records: Mapping[str, Record], retry: str | None
) -> list[Specification]:
    """Return the runs to execute, each key once: those without a record, or without what is to be kept."""
    missing = []
    for key, run in {run.key: run for run in runs}.items():
        record = records.get(key)
        known = record is not None and not (run.keeps_trajectories and not store.keeps(record))
        if record is None or not known or retry == "all" or (retry == "failed" and record.failed):
            missing.append(run)
    return missing


def _crew(
    runs: list[Specification],
    watcher: Watcher,
    workers: int | None,
    scheduler: str | None,
    managed: ManagedCluster | None,
    memory: str | None,
) -> Generator[Record]:
    if not runs or workers == 0:
        return in_this_process(runs, watcher)
    if managed is not None:
        return on_managed_cluster(runs, watcher, managed)
    if scheduler is not None:
        return on_cluster(runs, watcher, scheduler)
    count = _processors() if workers is None else workers
    return on_local_cluster(runs, watcher, min(count, len(runs)), memory)


def _processors() -> int:
    """Return the number of processors available to this process."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _about(study: Study) -> dict[str, Any]:
    return {
        "study": study.name,
        "file": str(study.path),
        "revision": revision(study.path.parent),
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "process": os.getpid(),
        "machine": machine(),
        "versions": versions(),
    }


def _outcome(
    store: Store,
    runs: list[Specification],
    made: set[str],
    notes: list[str],
    interrupted: bool,
    seconds: float,
) -> Outcome:
    found, _ = store.records(run.key for run in runs)
    records = [(run, found.get(run.key)) for run in runs]
    failures = {
        described(run.labels): str(r.result["error"]) for run, r in records if r is not None and r.failed
    }
    failed = sum(r is not None and r.failed for _, r in records)
    fine = [record.key for _, record in records if record is not None and not record.failed]
    done = sum(key in made for key in fine)
    return Outcome(
        total=len(runs),
        done=done,
        failed=failed,  # not len(failures): the labels 1 and "1" have the same description
        skipped=len(fine) - done,
        interrupted=interrupted,
        seconds=seconds,
        table=store.table,
        failures=failures,
        notes=tuple(notes),
    )
