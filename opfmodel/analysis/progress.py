"""How the checks say what they are doing."""

from __future__ import annotations

from typing import Protocol

__all__ = ["Advance", "silent"]


class Advance(Protocol):
    """Called as work progresses."""

    def __call__(self, what: str, done: int = 0, of: int = 0) -> None:
        """Report what is done now, and how much of it; ``of`` is 0 if that is unknown."""
        ...


def silent(what: str, done: int = 0, of: int = 0) -> None:
    """Report nothing."""
