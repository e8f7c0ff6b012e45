"""What a network and a format do not share: refused in reading and writing, never dropped."""

from __future__ import annotations

from collections.abc import Iterator

from opfmodel.errors import CaseError
from opfmodel.network.cases.warn import warn

__all__ = ["Losses"]

_MOST = 30  # listed in one error


class Losses:
    """Data with electrical meaning that a reader cannot represent, or that a writer cannot write.

    A reader reports every loss with :meth:`add` and calls :meth:`settle` once at the end, so that one
    error lists them all; a writer calls it before it writes.

    Parameters
    ----------
    source
        The file or object that is read or written, for messages.
    writing
        Whether the file cannot hold what is lost; otherwise opfmodel does not represent it.
    """

    def __init__(self, source: str, *, writing: bool = False) -> None:
        self.source = source
        self.writing = writing
        self._losses: list[str] = []

    def __iter__(self) -> Iterator[str]:
        return iter(self._losses)

    def add(self, loss: str) -> None:
        """Record what is lost: component, field, value and what is done instead."""
        self._losses.append(loss)

    def settle(self, lossy: bool) -> None:
        """Raise an error that lists the losses, or warn about each of them if the user accepts them.

        Raises
        ------
        CaseError
            Something is lost, and ``lossy`` is false.
        """
        if not self._losses:
            return
        if not lossy:
            raise CaseError(f"{self.source}: {self._refusal()}")
        for loss in self._losses:
            warn(f"{self.source}: lost: {loss}")

    def _refusal(self) -> str:
        more = len(self._losses) - _MOST
        listed = "; ".join(self._losses[:_MOST]) + (f"; and {more} more" if more > 0 else "")
        if self.writing:
            return (
                f"cannot hold all of the network: {listed}; "
                "lossy=True (--lossy on the command line) writes the rest"
            )
        return (
            f"contains what opfmodel does not represent: {listed}; "
            "lossy=True (lossy: true in a scenario, --lossy on the command line) reads the rest"
        )
