"""A Dask cluster of this machine for one study.

Only who has the keys of the cluster can connect to it: they are made for it, live in the memory of
its processes, and end with it. It serves no web pages. It is imported by its workers.
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
from distributed import Nanny, Scheduler, Security, SpecCluster, Worker

from opfmodel.errors import StudyError
from solvers.threads import THREAD_VARIABLES

__all__ = ["DEATHS", "local_cluster"]

DEATHS = 3  # of workers over one run, before it is given up
_SECONDS_TO_START = 300.0  # for a worker; many start at once

_CONFIGURATION = {
    "distributed.scheduler.allowed-failures": DEATHS - 1,
    "distributed.scheduler.worker-ttl": None,  # a long solve is no sign of death; a closed connection is
    # nothing is kept in a worker's memory that could be spilled, and to pause would be for ever
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.terminate": 0.95,
}


class _Scheduler(Scheduler):  # type: ignore[misc]
    def start_http_server(self, *_: Any, **__: Any) -> None:
        """Serve no web pages; Dask's own does even where there is no dashboard."""


class _Worker(Worker):  # type: ignore[misc]
    def __init__(self, *arguments: Any, **options: Any) -> None:
        # Ctrl-C reaches every process of a terminal; workers leave it to the one that started them
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        super().__init__(*arguments, **options)

    def start_http_server(self, *_: Any, **__: Any) -> None:
        """Serve no web pages."""


@contextmanager
def local_cluster(workers: int, memory: str | None) -> Iterator[SpecCluster]:
    """A scheduler in this process and workers in processes of their own, each with one thread.

    Parameters
    ----------
    workers
        Number of processes.
    memory
        What each may use, such as ``"2 GiB"``; by default an equal share of the machine's.

    Raises
    ------
    StudyError
        A worker did not start.
    """
    folder = tempfile.TemporaryDirectory(prefix="opfmodel-", ignore_cleanup_errors=True)
    with folder as own, _configured(own), _one_thread():
        place = {"host": "127.0.0.1", "protocol": "tls://", "security": Security.temporary()}
        options = {
            "worker_class": _Worker,
            "nthreads": 1,
            "memory_limit": memory or "auto",
            "env": {"TMPDIR": own},  # for what a killed worker leaves
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
    """Dask's configuration for a cluster whose files are in a folder of its own.

    Every part of a cluster imports from its folder before all others, so that one to which other
    users can write, as they can to Dask's own below ``/tmp``, would be as good as an open port.
    """
    return dask.config.set({**_CONFIGURATION, "temporary-directory": folder})


def _started(**options: Any) -> SpecCluster:
    """A cluster that has started; one that Ctrl-C finds half started is closed."""
    with ThreadPoolExecutor(1, initializer=_block_ctrl_c) as thread:
        starting = thread.submit(SpecCluster, **options)
        try:
            return starting.result()
        except KeyboardInterrupt:
            if starting.exception() is None:
                starting.result().close()
            raise
        except (RuntimeError, OSError) as error:
            raise StudyError(f"the workers could not be started: {_reason(error)}") from error


def _block_ctrl_c() -> None:
    """Keep Ctrl-C from the processes that this thread starts, which are to leave it to this process."""
    if sys.platform != "win32":
        resource_tracker.ensure_running()  # its start would unblock it
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})


def _reason(error: BaseException) -> str:
    """What an error comes from in the end, in one line."""
    while error.__cause__ is not None:
        error = error.__cause__
    return " ".join(str(error).split()) or type(error).__name__


@contextmanager
def _one_thread() -> Iterator[None]:
    """An environment for processes whose linear algebra has one thread, put back in the end."""
    before = dict(os.environ)
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        os.environ.clear()  # of what Dask has added too
        os.environ.update(before)
