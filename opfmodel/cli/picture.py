"""Drawing of a network in characters of the terminal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from opfmodel.network.layout import positions

__all__ = ["bars", "picture"]

_COLUMNS, _ROWS = 72, 20
_DOTS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))  # of a Braille character, by column and row
_BRAILLE = 0x2800


def picture(graph: Any) -> Iterator[str]:
    """Draw a network with branches of dots and buses of filled circles, line by line."""
    placed = positions(graph)
    wide, high = _COLUMNS * 2 - 1, _ROWS * 4 - 1
    spots = {bus: (round(x * wide), round((1 - y) * high)) for bus, (x, y) in placed.items()}
    cells: dict[tuple[int, int], int] = {}
    for one, other in set(graph.edges()):
        for x, y in _line(spots[one], spots[other]):
            cells[x // 2, y // 4] = cells.get((x // 2, y // 4), 0) | _DOTS[x % 2][y % 4]
    characters = {cell: chr(_BRAILLE + dots) for cell, dots in cells.items()}
    characters |= {(x // 2, y // 4): "●" for x, y in spots.values()}
    for row in range(_ROWS):
        yield "".join(characters.get((column, row), " ") for column in range(_COLUMNS)).rstrip()


def _line(start: tuple[int, int], end: tuple[int, int]) -> Iterator[tuple[int, int]]:
    steps = max(abs(end[0] - start[0]), abs(end[1] - start[1]), 1)
    for step in range(steps + 1):
        yield tuple(round(a + (b - a) * step / steps) for a, b in zip(start, end, strict=True))  # type: ignore[misc]


def bars(counts: Mapping[str, int], width: int = 40) -> Sequence[str]:
    """Draw counts as bars with their labels."""
    most = max(counts.values(), default=1)
    label = max((len(name) for name in counts), default=0)
    return [f"{name:>{label}}  {'█' * max(1, round(n / most * width))} {n}" for name, n in counts.items()]
