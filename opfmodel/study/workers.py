"""Execute runs in this process, or on a cluster: a local one, a running one, or one that Dask starts.

Each function yields records in the order in which runs finish. It writes no files; the process that
holds the study's folder does.
"""

from __future__ import annotations

import logging
import math
import re
import time
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from opfmodel.errors import StudyError
from opfmodel.study.execution import Record, execute, failure, release
from opfmodel.study.managed import ManagedCluster
from opfmodel.study.progress import Watcher
from opfmodel.study.specification import Specification
from solvers.errors import SolverError
from solvers.interrupt import interruptible

if TYPE_CHECKING:
    from distributed import Client, Future

__all__ = ["check_crew", "in_this_process", "on_cluster", "on_local_cluster", "on_managed_cluster"]

_ADDRESS = re.compile(r"(\w+://)?([^\s/:\[\]]+|\[[0-9a-fA-F:.%\w]+\]):[0-9]{1,5}(/\S*)?")
_SECONDS_IDLE = 120.0  # without an active run, after which workers are assumed to die as they start
_GLANCE = 0.5  # seconds between polls of the workers


def check_crew(scheduler: str | None, memory: str | None) -> None:
    """Raise :class:`StudyError` for invalid options of workers, even if no run is missing."""
    if memory is not None:
        from solvers.cluster import is_amount

        if not is_amount(memory):
            raise StudyError(f"memory = {memory!r}: must be an amount such as 2GiB or 600MB, at least 100MB")
    if scheduler is not None and not _ADDRESS.fullmatch(scheduler):
        raise StudyError(f"scheduler = {scheduler!r}: must be an address such as tcp://10.0.0.1:8786")


def in_this_process(specifications: Sequence[Specification], watcher: Watcher) -> Generator[Record]:
    """Execute the runs one after another."""
    try:
        for specification in specifications:
            watcher.running({"this process": specification})
            with interruptible():
                record = execute(specification)
            yield record
    finally:
        release()


def on_local_cluster(
    specifications: Sequence[Specification], watcher: Watcher, workers: int, memory: str | None
) -> Generator[Record]:
    """Execute the runs in worker processes on this machine, each with one thread.

    Parameters
    ----------
    workers
        Number of processes.
    memory
        Memory limit of each worker, such as ``"2 GiB"``; by default an equal share of the machine.

    Raises
    ------
    StudyError
        The workers do not start, or die before they start a run.
    """
    from distributed import Client

    from solvers.cluster import local_cluster

    try:
        with local_cluster(workers, memory) as cluster, Client(cluster) as client:
            yield from _runs(client, specifications, watcher, patience=_SECONDS_IDLE)
    except SolverError as error:
        raise StudyError(str(error)) from error


def on_cluster(
    specifications: Sequence[Specification], watcher: Watcher, scheduler: str
) -> Generator[Record]:
    """Execute the runs on the workers of a running Dask scheduler.

    The workers need opfmodel, but no shared files.

    Raises
    ------
    StudyError
        The scheduler does not answer, has no workers, or disappears.
    """
    from solvers.cluster import connected

    try:
        with _quiet(), connected(scheduler) as client:
            yield from _runs(client, specifications, watcher)
    except SolverError as error:
        raise StudyError(str(error)) from error


def on_managed_cluster(
    specifications: Sequence[Specification], watcher: Watcher, cluster: ManagedCluster
) -> Generator[Record]:
    """Execute the runs on a cluster that Dask starts for them; its workers may have to wait in a queue.

    Raises
    ------
    StudyError
        The cluster does not start.
    """
    from distributed import Client

    with _quiet(), cluster.started() as running, Client(running) as client:
        yield from _runs(client, specifications, watcher)


def _runs(
    client: Client,
    specifications: Sequence[Specification],
    watcher: Watcher,
    patience: float = math.inf,
) -> Generator[Record]:
    """Keep every worker busy with one run, and yield records as runs finish.

    Parameters
    ----------
    patience
        Seconds without an active run before giving up; workers of a running cluster may come and go.
    """
    from distributed import wait

    address = client.scheduler.address
    waiting = deque(specifications)
    running: dict[Future, Specification] = {}
    seen = time.monotonic()
    try:
        while waiting or running:
            # one run per worker: the death of a worker affects no other run
            for _ in range(min(len(waiting), max(len(_workers(client)) - len(running), 0))):
                specification = waiting.popleft()
                name = f"opfmodel-{specification.key}-{uuid4().hex[:8]}"
                running[client.submit(execute, specification, key=name, pure=False)] = specification
            with interruptible():  # at every glance, so that no Ctrl-C is lost in a callback
                work = _work(client, running)
            watcher.running(work)
            if work:
                seen = time.monotonic()
            elif time.monotonic() - seen > patience:
                raise StudyError(
                    f"no worker has started a run for {patience:g} s, most likely for lack of memory; "
                    "increase --memory or decrease --workers"
                )
            if not running:
                time.sleep(_GLANCE)
                continue
            try:
                done = wait(list(running), timeout=_GLANCE, return_when="FIRST_COMPLETED").done
            except TimeoutError:
                continue
            for future in done:
                seen = time.monotonic()
                yield _record(future, running.pop(future))
    except (CancelledError, OSError) as error:  # the connection was lost
        raise StudyError(
            f"lost the connection to the scheduler at {address}; finished runs are kept, "
            "and the same command resumes the study"
        ) from error
    finally:
        if client.status == "running":
            client.cancel(list(running), force=True)


def _workers(client: Client) -> dict[str, int]:
    """Return the number of threads of each worker, by address; workers come and go."""
    return dict(client.nthreads())


def _work(client: Client, running: dict[Future, Specification]) -> dict[str, Specification]:
    """Return the run on each worker, by address."""
    by_key = {future.key: specification for future, specification in running.items()}
    return {
        address: by_key[key] for address, keys in client.processing().items() for key in keys if key in by_key
    }


def _record(future: Future, specification: Specification) -> Record:
    from distributed import KilledWorker

    if future.status == "finished":
        record: Record = future.result()
        return record
    error: Any = future.exception()
    if isinstance(error, KilledWorker):
        error = StudyError(
            f"{error.allowed_failures + 1} workers died during this run, most likely for lack of memory; "
            "increase --memory or decrease --workers"
        )
    return failure(specification, error)


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep Dask's messages about connections off standard error."""
    handlers = logging.getLogger("distributed").handlers
    before = [handler.level for handler in handlers]
    for handler in handlers:
        handler.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for handler, level in zip(handlers, before, strict=True):
            handler.setLevel(level)
