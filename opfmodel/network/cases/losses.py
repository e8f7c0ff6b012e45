"""What a network of another format contains and opfmodel does not represent: refused, never dropped."""

from __future__ import annotations

from collections.abc import Iterator

from opfmodel.errors import CaseError
from opfmodel.network.cases.warn import warn

__all__ = ["Losses"]


class Losses:
    """Data with electrical meaning that a reader cannot represent.

    A reader reports every loss with :meth:`add` and calls :meth:`settle` once at the end, so that one
    error lists them all.

    Parameters
    ----------
    source
        The file or object that is read, for messages.
    """

    def __init__(self, source: str) -> None:
        self.source = source
        self._losses: list[str] = []

    def __iter__(self) -> Iterator[str]:
        return iter(self._losses)

    def add(self, loss: str) -> None:
        """Record what is lost: component, field, value and what opfmodel does instead."""
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
            raise CaseError(
                f"{self.source}: contains what opfmodel does not represent: {'; '.join(self._losses)}; "
                "lossy=True (lossy: true in a scenario, --lossy on the command line) reads the rest"
            )
        for loss in self._losses:
            warn(f"{self.source}: lost: {loss}")
