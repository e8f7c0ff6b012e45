"""A program cut into chains of windows."""

from __future__ import annotations

from collections.abc import Sequence

from solvers.program import Program
from solvers.windows.staged import Staged
from solvers.windows.window import Span, Window

__all__ = ["Partition", "spans"]


def spans(stages: int, length: int, overlap: int, leaders: frozenset[int] = frozenset({0})) -> list[Span]:
    """Return windows of equal length that cover the stages; the last one is up to a half longer or shorter.

    Parameters
    ----------
    length
        Stages that a window has of its own.
    overlap
        Stages by which each is extended into the next one.
    leaders
        Numbers of the windows that are also extended into the one before them, whose end they do not know.
    """
    count = max(1, round(stages / length)) if stages > length + overlap else 1
    begins = [length * number for number in range(count)]
    ends = [*begins[1:], stages]
    return [
        Span(
            max(begin - overlap, 0) if number in leaders else begin,
            begin,
            end,
            min(end + overlap, stages) if end < stages else stages,
        )
        for number, (begin, end) in enumerate(zip(begins, ends, strict=True))
    ]


class Partition:
    """A program cut into chains of windows.

    Attributes
    ----------
    chains
        Windows by chain.
    programs
        Programs by structure.
    """

    def __init__(self, staged: Staged, chains: Sequence[Sequence[Span]]) -> None:
        self.staged = staged
        self.chains = [[Window(staged, span) for span in chain] for chain in chains]
        alike: dict[bytes, list[Window]] = {}
        for window in self.windows:
            alike.setdefault(window.structure, []).append(window)
        self.programs: dict[bytes, Program] = {
            structure: windows[0].program(windows) for structure, windows in alike.items()
        }

    @property
    def windows(self) -> list[Window]:
        """All windows in the order of time."""
        return [window for chain in self.chains for window in chain]
