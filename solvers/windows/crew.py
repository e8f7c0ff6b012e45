"""Who solves the chains of a sweep: this process, or the workers of a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any

from solvers.errors import SolverError
from solvers.windows.chain import Chain, Found
from solvers.windows.settings import Settings
from solvers.windows.sweeps import Asked

__all__ = ["Crew", "crew"]

Crew = Callable[[Sequence[Asked]], list[list[Found]]]


@contextmanager
def crew(chains: Sequence[Chain], settings: Settings) -> Iterator[Crew]:
    """Yield a function that sweeps all chains, each by a worker of its own that keeps what it compiled."""
    if settings.scheduler is None and len(chains) == 1:
        yield lambda asked: [chain.sweep(*ask) for chain, ask in zip(chains, asked, strict=True)]
        return
    with ExitStack() as stack:
        client = stack.enter_context(_client(len(chains), settings))
        names = sorted(client.nthreads())
        submitted = [
            client.submit(_Seat, actor=True, pure=False, workers=[names[number % len(names)]])
            for number in range(len(chains))
        ]
        seats: list[Any] = [future.result() for future in submitted]
        for seat, chain in zip(seats, chains, strict=True):
            _results([seat.take(chain)])  # one after another: each is a large message
        yield lambda asked: _results([seat.sweep(*ask) for seat, ask in zip(seats, asked, strict=True)])


def _results(futures: Sequence[Any]) -> list[Any]:
    try:
        return [future.result() for future in futures]
    except (RuntimeError, OSError) as error:
        raise SolverError(
            "windows: lost a worker, most likely for lack of memory; state a larger memory or fewer "
            f"workers ({error})"
        ) from error


class _Seat:
    """A place on a worker for one chain; the scheduler would keep an argument of a task."""

    _chain: Chain

    def take(self, chain: Chain) -> None:
        self._chain = chain

    def sweep(self, *ask: Any) -> list[Found]:
        return self._chain.sweep(*ask)


@contextmanager
def _client(workers: int, settings: Settings) -> Iterator[Any]:
    """Yield a client of the stated scheduler, or of a cluster of worker processes on this machine."""
    from solvers.cluster import connected, local_cluster

    if settings.scheduler is not None:
        with connected(settings.scheduler) as client:
            yield client
        return
    from distributed import Client

    with local_cluster(workers, settings.memory) as cluster, Client(cluster) as client:
        yield client
