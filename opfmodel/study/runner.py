"""Running a study: what is there is skipped, what is missing is made and written down."""

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
from opfmodel.study.document import Study
from opfmodel.study.execution import Record
from opfmodel.study.progress import Watcher, described, live
from opfmodel.study.provenance import machine, revision, versions
from opfmodel.study.specification import Snapshot, Specification
from opfmodel.study.store import Store, untrusted
from opfmodel.study.workers import check_crew, in_this_process, on_cluster, on_local_cluster

__all__ = ["Outcome", "run_study"]


@dataclass(frozen=True)
class Outcome:
    """What a start of a study came to.

    Attributes
    ----------
    total
        Runs of the study; the sum of ``done``, ``failed``, ``skipped`` and those still ``waiting``.
    done
        Made by this start.
    failed
        Failed, in this start or in an earlier one and not repeated.
    skipped
        Done by an earlier start.
    interrupted
        Whether Ctrl-C ended it.
    failures
        What each failed run failed of, by its labels.
    notes
        What its user should know.
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
    memory: str | None = None,
    retry: Literal["failed", "all"] | None = None,
    progress: bool = False,
) -> Outcome:
    """Make the runs of a study that its folder does not have yet.

    All files are read once at the start, so that a file edited meanwhile changes nothing until the
    next start. Ctrl-C ends the study; finished runs are kept.

    Parameters
    ----------
    folder
        Where records and table are; it is made if need be.
    workers
        Processes of this machine, each with one thread; 0 runs everything in this process. By
        default as many as there are processors for this process.
    scheduler
        Address of a running Dask scheduler, whose workers are used instead.
    memory
        What each local worker may use, such as ``"2 GiB"``.
    retry
        Repeat what ``failed``, or ``all``.
    progress
        Whether to show a line per worker and the time left on standard error.

    Raises
    ------
    StudyError
        The folder is in use, the scheduler does not answer, or an option is not what it must be.
    ResultError
        The folder cannot be written; what is in it is kept.
    """
    if scheduler is not None and (workers is not None or memory is not None):
        raise StudyError("workers and memory are for this machine; a running scheduler has its own")
    if workers is not None and workers < 0:
        raise StudyError(f"workers = {workers}: must be 0 (no processes besides this one) or more")
    check_crew(scheduler, memory)
    began = time.perf_counter()
    store = Store(Path(folder))
    with store.locked():
        snapshot = Snapshot()
        runs = snapshot.specifications(study)
        options = {"workers": workers, "scheduler": scheduler, "memory": memory, "retry": retry}
        there, faults = store.records(run.key for run in runs)
        notes = _notes(store.index_fault(), faults)
        store.begin(runs, {**_about(study), "options": options})
        missing = _missing(runs, there, retry)
        made: set[str] = set()
        interrupted = False
        shown = live(study.name, len(missing)) if progress and missing else nullcontext(Watcher())
        with shown as watcher, closing(_crew(missing, watcher, workers, scheduler, memory)) as records:
            try:
                for record in records:
                    made.add(record.key)  # first: Ctrl-C may come between the two
                    store.write(record)
                    watcher.finished()
            except KeyboardInterrupt:
                interrupted = True
            except StudyError:
                store.write_table()
                raise
        store.write_table()
        notes += [
            f"{path} changed after the study had read it; the table is of what was read, "
            "and the same command brings it up to date"
            for path in snapshot.changed()
        ]
        return _outcome(store, runs, made, notes, interrupted, time.perf_counter() - began)


def _notes(index_fault: str | None, faults: list[str]) -> list[str]:
    """What to tell of files in the folder that are not what had been written."""
    notes = [] if index_fault is None else [f"{index_fault}; it was written anew"]
    return [*notes, f"{untrusted(faults)}; their runs are repeated"] if faults else notes


def _missing(
    runs: list[Specification], records: Mapping[str, Record], retry: str | None
) -> list[Specification]:
    """The runs to make, each key once."""
    missing = []
    for key, run in {run.key: run for run in runs}.items():
        record = records.get(key)
        if record is None or retry == "all" or (retry == "failed" and record.failed):
            missing.append(run)
    return missing


def _crew(
    runs: list[Specification],
    watcher: Watcher,
    workers: int | None,
    scheduler: str | None,
    memory: str | None,
) -> Generator[Record]:
    if not runs or workers == 0:
        return in_this_process(runs, watcher)
    if scheduler is not None:
        return on_cluster(runs, watcher, scheduler)
    count = _processors() if workers is None else workers
    return on_local_cluster(runs, watcher, min(count, len(runs)), memory)


def _processors() -> int:
    """How many processors this process may use."""
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
        failed=failed,  # not the number of names: 1 and "1" are two labels and one name
        skipped=len(fine) - done,
        interrupted=interrupted,
        seconds=seconds,
        table=store.table,
        failures=failures,
        notes=tuple(notes),
    )
