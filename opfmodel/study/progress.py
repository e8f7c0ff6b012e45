"""Progress display of a study: a line per worker, the number of finished runs, and the time left."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from opfmodel.errors import visible
from opfmodel.study.specification import Specification

__all__ = ["Watcher", "described", "live"]


class Watcher:
    """Observer of a running study; this base class shows nothing."""

    def running(self, work: Mapping[str, Specification]) -> None:
        """Report the active runs, by name of the worker."""

    def finished(self) -> None:
        """Report that one more run has a record."""


def described(labels: Mapping[str, Any]) -> str:
    """Return the point on each axis in one line."""
    return " ".join(f"{name}={value}" for name, value in labels.items()) or "the scenario as it is"


@contextmanager
def live(name: str, runs: int) -> Iterator[Watcher]:
    """Display progress on standard error while the context is active."""
    from rich.console import Console, Group
    from rich.live import Live
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
    from rich.text import Text

    period = 3600.0  # runs can be slow: average the speed over many
    bar = Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        speed_estimate_period=period,
    )
    task = bar.add_task(name, total=runs)
    watcher = _Live(lambda: bar.advance(task))
    with Live(
        console=Console(stderr=True),
        transient=True,
        get_renderable=lambda: Group(
            *(Text(line, no_wrap=True, overflow="ellipsis") for line in watcher.lines()), bar
        ),
    ):
        yield watcher


class _Live(Watcher):
    def __init__(self, advance: Any) -> None:
        self._advance = advance
        self._since: dict[tuple[str, str], float] = {}
        self._work: Mapping[str, Specification] = {}

    def running(self, work: Mapping[str, Specification]) -> None:
        now = time.monotonic()
        self._since = {(w, s.key): self._since.get((w, s.key), now) for w, s in work.items()}
        self._work = work

    def finished(self) -> None:
        self._advance()

    def lines(self) -> Sequence[str]:
        """Return a line per worker with its run and the elapsed time."""
        now = time.monotonic()
        return [
            visible(
                f"{worker}  {now - self._since.get((worker, run.key), now):5.0f} s  {described(run.labels)}"
            )
            for worker, run in sorted(self._work.items())
        ]
