"""Collecting the faults of a file, so that one error reports them all."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from types import TracebackType
from typing import Self

from opfmodel.errors import MOST_FAULTS, Fault, ScenarioError

__all__ = ["Faults"]


class Faults:
    """The faults found so far while the parts of a file are read.

    A part is a block ``with faults:``; a :class:`ScenarioError` raised inside ends the part and is kept,
    and reading goes on behind the block with the next part. Blocks can be nested. What depends on a part
    asks :meth:`broken` first, so that no fault is reported for what follows from another. In the end,
    :meth:`settle` raises one error with all faults.

    Parameters
    ----------
    found
        Faults found earlier.

    Examples
    --------
    >>> faults = Faults()
    >>> for number in (1, 2):
    ...     with faults:
    ...         raise ScenarioError(Fault(f"{number} is wrong", "s.yaml", number, 1, ("key", number)))
    >>> faults.broken("key"), faults.broken("other")
    (True, False)
    >>> faults.settle()
    Traceback (most recent call last):
    opfmodel.errors.ScenarioError: s.yaml:1:1: key.1: 1 is wrong
    s.yaml:2:1: key.2: 2 is wrong
    """

    def __init__(self, found: Iterable[Fault] = ()) -> None:
        self._found = dict.fromkeys(found)
        self._spoilt: list[tuple[str | int, ...]] = []
        self._cause: BaseException | None = None

    def __len__(self) -> int:
        return len(self._found)

    def __iter__(self) -> Iterator[Fault]:
        return iter(self._found)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        if not isinstance(error, ScenarioError) or len(self) > MOST_FAULTS:
            return False
        self._cause = self._cause or error.__cause__
        self.add(*error.faults)
        return True

    def add(self, *faults: Fault) -> None:
        """Add faults; the same one is kept once.

        Raises
        ------
        ScenarioError
            There are too many to go on.
        """
        self._found |= dict.fromkeys(faults)
        if len(self) > MOST_FAULTS:
            found = list(self._found)[:MOST_FAULTS]
            more = Fault(f"more than {MOST_FAULTS} errors; the rest is not checked", found[0].file)
            self._found = dict.fromkeys((*found, more))
            self.settle()

    def spoil(self, *key: str | int) -> None:
        """Take a key as broken without a fault of its own, because of a fault elsewhere."""
        self._spoilt.append(key)

    def broken(self, *key: str | int) -> bool:
        """Whether there is a fault at a key, inside its value, or in a value that contains it."""
        return any(_overlap(fault, key) for fault in self._keys())

    def lost(self, *key: str | int) -> bool:
        """Whether there is a fault at a key, or in a value that contains it."""
        return any(fault == key[: len(fault)] for fault in self._keys())

    def _keys(self) -> Iterator[tuple[str | int, ...]]:
        yield from (fault.key for fault in self._found if fault.key)
        yield from self._spoilt

    def error(self) -> ScenarioError:
        """Return one error with all faults, in order of position."""
        error = ScenarioError(*sorted(self._found, key=_position))
        error.__cause__ = self._cause
        return error

    def settle(self) -> None:
        """Raise the error if there are faults."""
        if self._found:
            raise self.error()


def _overlap(one: Sequence[str | int], other: Sequence[str | int]) -> bool:
    return all(a == b for a, b in zip(one, other, strict=False))


def _position(fault: Fault) -> tuple[bool, str, int, int]:
    """Order of faults: by file and position, last those without a position."""
    return fault.line is None, fault.file or "", fault.line or 0, fault.column or 0
