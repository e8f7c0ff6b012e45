"""Who makes the runs: this process, the workers of a local cluster, or those of a running one.

Each is an iterator of records in the order in which runs finish. It owns no file: what it yields is
written by the process that holds the study's folder.
"""

from __future__ import annotations

import logging
import re
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
from solvers.threads import THREAD_VARIABLES

if TYPE_CHECKING:
    from distributed import Client, Future

__all__ = ["check_crew", "in_this_process", "on_cluster", "on_local_cluster"]

_ADDRESS = re.compile(r"(\w+://)?([^\s/:\[\]]+|\[[0-9a-fA-F:.%\w]+\]):[0-9]{1,5}(/\S*)?")
_DEATHS = 3  # of workers over one run, before it is given up
_PATIENCE = 30.0  # seconds to wait for a scheduler, and for a first worker
_GLANCE = 0.5  # seconds between two looks at what the workers do

# Ctrl-C reaches every process of a terminal; workers leave it to the one that started them.
_IGNORE_CTRL_C = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"

_CONFIGURATION = {
    "distributed.scheduler.allowed-failures": _DEATHS - 1,
    "distributed.scheduler.worker-ttl": None,  # a long solve is no sign of death; a closed connection is
    # nothing is kept in a worker's memory that could be spilled, and to pause would be for ever
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.terminate": 0.95,
}


def check_crew(scheduler: str | None, memory: str | None) -> None:
    """Raise :class:`StudyError` for options that no crew could be had with, also where none is needed."""
    if memory is not None:
        from dask.utils import parse_bytes

        try:
            enough = parse_bytes(memory) > 0
        except ValueError:
            enough = False
        if not enough:
            raise StudyError(f"memory = {memory!r}: must be an amount such as 2GiB or 600MB")
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
    """
    import dask
    from distributed import Client, LocalCluster

    with dask.config.set(_CONFIGURATION):
        try:
            cluster = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                memory_limit=memory or "auto",
                dashboard_address=None,
                silence_logs=logging.CRITICAL,
                env=dict.fromkeys(THREAD_VARIABLES, "1"),
                preload=[_IGNORE_CTRL_C],
            )
        except ValueError as error:
            raise StudyError(f"memory = {memory!r}: {error}") from error
        with cluster, Client(cluster) as client:
            yield from _runs(client, specifications, watcher)


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
        except (OSError, ValueError, TimeoutError) as error:
            raise StudyError(f"no scheduler answers at {scheduler!r}: {error}") from error
        with client:
            try:
                client.wait_for_workers(1, timeout=_PATIENCE)
            except TimeoutError:
                raise StudyError(
                    f"the scheduler at {scheduler} has no worker; start some with 'dask worker {scheduler}'"
                ) from None
            yield from _runs(client, specifications, watcher)


def _runs(client: Client, specifications: Sequence[Specification], watcher: Watcher) -> Generator[Record]:
    """Keep every worker busy with one run, and yield the records as they come."""
    from distributed import wait

    address = client.scheduler.address
    waiting = deque(specifications)
    running: dict[Future, Specification] = {}
    try:
        while waiting or running:
            # one run per worker: a worker that dies takes one run with it and throws suspicion on no other
            for _ in range(min(len(waiting), max(len(_workers(client)) - len(running), 0))):
                specification = waiting.popleft()
                name = f"opfmodel-{specification.key}-{uuid4().hex[:8]}"
                running[client.submit(execute, specification, key=name, pure=False)] = specification
            watcher.running(_work(client, running))
            try:
                done = wait(list(running), timeout=_GLANCE, return_when="FIRST_COMPLETED").done
            except TimeoutError:
                continue
            for future in done:
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
