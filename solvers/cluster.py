"""Dask clusters for a study or a solve: a running one, or one on this machine.

Connections within this machine require TLS keys that are generated for the cluster and exist only in
the memory of its processes. It serves no web pages. Worker processes import this module.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import Any

import dask
from dask.utils import parse_bytes
from distributed import Client, Nanny, Scheduler, Security, SpecCluster, Worker

from solvers.errors import SolverError
from solvers.threads import THREAD_VARIABLES

__all__ = ["DEATHS", "connected", "is_amount", "local_cluster"]

DEATHS = 3  # of workers during one run, before the run is abandoned
_PATIENCE = 30.0  # seconds to wait for a running scheduler, and for a first worker of it
_LEAST_MEMORY = 100_000_000  # bytes; Python and the libraries alone need more
_SECONDS_TO_START = 300.0  # per worker; many start at once

_CONFIGURATION = {
    # nannies restart their workers; Dask would close a nanny whose worker is away 15 s after any death
    "distributed.deploy.lost-worker-timeout": "365 days",
    "distributed.scheduler.allowed-failures": DEATHS - 1,
    "distributed.scheduler.worker-ttl": None,  # a long solve is not a dead worker; a closed connection is
    # workers hold no data that could be spilled, and a paused worker would never resume
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.terminate": 0.95,
}


class _Scheduler(Scheduler):  # type: ignore[misc]
    def start_http_server(self, *_: Any, **__: Any) -> None:
        """Serve no web pages; Dask does so even without a dashboard."""


class _Worker(Worker):  # type: ignore[misc]
    def __init__(self, *arguments: Any, **options: Any) -> None:
        # Ctrl-C reaches every process of a terminal; the main process handles it
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        super().__init__(*arguments, **options)

    def start_http_server(self, *_: Any, **__: Any) -> None:
        """Serve no web pages."""


def is_amount(memory: object) -> bool:
    """Whether a value is an amount of memory that a worker can do with, such as ``"2 GiB"``."""
    try:
        return isinstance(memory, str) and parse_bytes(memory) >= _LEAST_MEMORY
    except ValueError:
        return False


@contextmanager
def connected(address: str) -> Iterator[Client]:
    """Connect to a running scheduler that has workers.

    Raises
    ------
    SolverError
        It does not answer, or has no workers.
    """
    try:
        client = Client(address, timeout=_PATIENCE)
    except (
        OSError,
        ValueError,
        TypeError,
        RuntimeError,
    ) as error:  # TypeError: TLS without keys; RuntimeError: TLS required, but not used
        raise SolverError(f"no scheduler answers at {address!r}: {error}") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=_PATIENCE)
        except TimeoutError:
            raise SolverError(
                f"the scheduler at {address} has no workers; start some with 'dask worker {address}'"
            ) from None
        yield client


@contextmanager
def local_cluster(workers: int, memory: str | None) -> Iterator[SpecCluster]:
    """Start a scheduler in this process and single-threaded workers in separate processes.

    Parameters
    ----------
    workers
        Number of worker processes.
    memory
        Memory limit of each worker, such as ``"2 GiB"``; by default an equal share of the machine.

    Raises
    ------
    SolverError
        A worker did not start.
    """
    folder = tempfile.TemporaryDirectory(prefix="opfmodel-", ignore_cleanup_errors=True)
    with folder as own, _configured(own), _one_thread():
        place = {"host": "127.0.0.1", "protocol": "tls://", "security": Security.temporary()}
        options = {
            "worker_class": _Worker,
            "nthreads": 1,
            "memory_limit": memory or "auto",
            "env": {"TMPDIR": own},  # for files left by killed workers
            "death_timeout": _SECONDS_TO_START,
            "silence_logs": logging.CRITICAL,
            **place,
        }
        with _started(
            scheduler={"cls": _Scheduler, "options": {"port": 0, "dashboard": False, **place}},
            workers={number: {"cls": Nanny, "options": options} for number in range(workers)},
            security=place["security"],
            silence_logs=logging.CRITICAL,
        ) as cluster:
            yield cluster


def _configured(folder: str) -> dask.config.set:
    """Configure Dask to keep the files of a cluster in a private folder.

    Every process of a cluster searches its folder first when it imports. If other users could write
    there, as they can to Dask's default folder below ``/tmp``, they could run code in the cluster.
    """
    return dask.config.set({**_CONFIGURATION, "temporary-directory": folder})


def _started(**options: Any) -> SpecCluster:
    """Start a cluster; on Ctrl-C, close it as soon as it has started."""
    with ThreadPoolExecutor(1, initializer=_block_ctrl_c) as thread:
        starting = thread.submit(SpecCluster, **options)
        try:
            return starting.result()
        except KeyboardInterrupt:
            if starting.exception() is None:
                starting.result().close()
            raise
        except (RuntimeError, OSError) as error:
            raise SolverError(f"the workers could not be started: {_reason(error)}") from error


def _block_ctrl_c() -> None:
    """Block Ctrl-C in processes started by this thread; the main process handles it."""
    if sys.platform != "win32":
        resource_tracker.ensure_running()  # starting it later would unblock the signal
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})


def _reason(error: BaseException) -> str:
    """Return the root cause of an error in one line."""
    while error.__cause__ is not None:
        error = error.__cause__
    return " ".join(str(error).split()) or type(error).__name__


@contextmanager
def _one_thread() -> Iterator[None]:
    """Limit linear algebra in child processes to one thread; restore the environment at the end."""
    before = dict(os.environ)
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        os.environ.clear()  # Dask adds variables, too
        os.environ.update(before)
