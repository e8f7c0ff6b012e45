"""Who makes the runs: this process, the workers of a local cluster, or those of a running one.

Each is an iterator of records in the order in which runs finish. It owns no file: what it yields is
written by the process that holds the study's folder.
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
from opfmodel.study.execution import Record, execute, failure
from opfmodel.study.progress import Watcher
from opfmodel.study.specification import Specification

if TYPE_CHECKING:
    from distributed import Client, Future

__all__ = ["check_crew", "in_this_process", "on_cluster", "on_local_cluster"]

_ADDRESS = re.compile(r"(\w+://)?([^\s/:\[\]]+|\[[0-9a-fA-F:.%\w]+\]):[0-9]{1,5}(/\S*)?")
_PATIENCE = 30.0  # seconds to wait for a scheduler, and for a first worker
_SECONDS_IDLE = 120.0  # without a run in work, after which workers are taken to die as they start
_GLANCE = 0.5  # seconds between two looks at what the workers do
_LEAST_MEMORY = 100_000_000  # bytes; Python and the libraries alone take more


def check_crew(scheduler: str | None, memory: str | None) -> None:
    """Raise :class:`StudyError` for options that no crew could be had with, also where none is needed."""
    if memory is not None:
        from dask.utils import parse_bytes

        try:
            enough = parse_bytes(memory) >= _LEAST_MEMORY
        except ValueError:
            enough = False
        if not enough:
            raise StudyError(f"memory = {memory!r}: must be an amount such as 2GiB or 600MB, at least 100MB")
    if scheduler is not None and not _ADDRESS.fullmatch(scheduler):
        raise StudyError(f"scheduler = {scheduler!r}: must be an address such as tcp://10.0.0.1:8786")


def in_this_process(specifications: Sequence[Specification], watcher: Watcher) -> Generator[Record]:
    """Make the runs one after another."""
    for specification in specifications:
        watcher.running({"this process": specification})
        yield execute(specification)


def on_local_cluster(
    specifications: Sequence[Specification], watcher: Watcher, workers: int, memory: str | None
) -> Generator[Record]:
    """Make the runs on worker processes of this machine, each with one thread.

    Parameters
    ----------
    workers
        Number of processes.
    memory
        What each may use, such as ``"2 GiB"``; by default an equal share of the machine's.

    Raises
    ------
    StudyError
        The workers do not start, or die before they take up a run.
    """
    from distributed import Client

    from opfmodel.study.cluster import local_cluster

    with local_cluster(workers, memory) as cluster, Client(cluster) as client:
        yield from _runs(client, specifications, watcher, patience=_SECONDS_IDLE)


def on_cluster(
    specifications: Sequence[Specification], watcher: Watcher, scheduler: str
) -> Generator[Record]:
    """Make the runs on the workers of a running Dask scheduler, which need opfmodel and share no files.

    Raises
    ------
    StudyError
        The scheduler does not answer, has no worker, or goes away.
    """
    from distributed import Client

    with _quiet():
        try:
            client = Client(scheduler, timeout=_PATIENCE)
        except (
            OSError,
            ValueError,
            TypeError,
            RuntimeError,
        ) as error:  # the last two: TLS without keys, or none
            raise StudyError(f"no scheduler answers at {scheduler!r}: {error}") from error
        with client:
            try:
                client.wait_for_workers(1, timeout=_PATIENCE)
            except TimeoutError:
                raise StudyError(
                    f"the scheduler at {scheduler} has no worker; start some with 'dask worker {scheduler}'"
                ) from None
            yield from _runs(client, specifications, watcher)


def _runs(
    client: Client,
    specifications: Sequence[Specification],
    watcher: Watcher,
    patience: float = math.inf,
) -> Generator[Record]:
    """Keep every worker busy with one run, and yield the records as they come.

    Parameters
    ----------
    patience
        Seconds without a run in work after which to give up; workers of a cluster come and go.
    """
    from distributed import wait

    address = client.scheduler.address
    waiting = deque(specifications)
    running: dict[Future, Specification] = {}
    seen = time.monotonic()
    try:
        while waiting or running:
            # one run per worker: a worker that dies takes one run with it and throws suspicion on no other
            for _ in range(min(len(waiting), max(len(_workers(client)) - len(running), 0))):
                specification = waiting.popleft()
                name = f"opfmodel-{specification.key}-{uuid4().hex[:8]}"
                running[client.submit(execute, specification, key=name, pure=False)] = specification
            work = _work(client, running)
            watcher.running(work)
            if work:
                seen = time.monotonic()
            elif time.monotonic() - seen > patience:
                raise StudyError(
                    f"no worker has taken up a run for {patience:g} s: they die as they start, most likely "
                    "for want of memory; give each more (--memory) or have fewer of them (--workers)"
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
    except (CancelledError, OSError) as error:  # the connection broke
        raise StudyError(
            f"the scheduler at {address} is gone; finished runs are kept: start again to go on"
        ) from error
    finally:
        if client.status == "running":
            client.cancel(list(running), force=True)


def _workers(client: Client) -> dict[str, int]:
    """Threads of each worker by address; workers come and go."""
    return dict(client.nthreads())


def _work(client: Client, running: dict[Future, Specification]) -> dict[str, Specification]:
    """What each worker does, by its address."""
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
            f"{error.allowed_failures + 1} workers died over this run, most likely for want of memory; "
            "give each more (--memory) or have fewer of them (--workers)"
        )
    return failure(specification, error)


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep Dask's own talk about connections from standard error."""
    handlers = logging.getLogger("distributed").handlers
    before = [handler.level for handler in handlers]
    for handler in handlers:
        handler.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for handler, level in zip(handlers, before, strict=True):
            handler.setLevel(level)
