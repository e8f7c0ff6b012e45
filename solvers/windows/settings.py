"""The options of windows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal

from solvers.errors import SolverOptionError

__all__ = ["Settings"]


@dataclass(frozen=True)
class Settings:
    """The options of windows; all others are those of the back end of the windows.

    Attributes
    ----------
    window
        Stages that a window has of its own; ``auto``: as many as make 120,000 variables.
    overlap
        Stages by which a window is extended; ``auto``: what measured decay makes the least work.
    tolerance
        Relative gap at which sweeps end.
    sweeps
        Most sweeps.
    proximal
        Weight of the proximal term at the end of a window: the change of the price of a variable over its
        range, relative to the price.
    workers
        Processes that share the windows of a sweep, each with one thread.
    memory
        Memory limit of each, such as ``2GiB``; by default an equal share of the machine.
    scheduler
        Address of a running Dask scheduler; ``workers`` of its workers share them instead.
    """

    window: int | Literal["auto"] = "auto"
    overlap: int | Literal["auto"] = "auto"
    tolerance: float = 1e-6
    sweeps: int = 50
    proximal: float = 0.1
    workers: int = 1
    memory: str | None = None
    scheduler: str | None = None

    def __post_init__(self) -> None:
        for name in ("window", "overlap"):
            if getattr(self, name) != "auto":
                self._whole(name, " or 'auto'")
        for name in ("sweeps", "workers"):
            self._whole(name)
        for name, rule, low in (("tolerance", "above 0", 0.0), ("proximal", "of at least 0", -1e-300)):
            value = getattr(self, name)
            if isinstance(value, bool) or not (isinstance(value, float | int) and value > low):
                raise SolverOptionError(f"windows: {name} = {value!r}: must be a number {rule}")
        if not (self.scheduler is None or isinstance(self.scheduler, str)):
            raise SolverOptionError(f"windows: scheduler = {self.scheduler!r}: must be a text")
        if self.memory is not None:
            from solvers.cluster import is_amount

            if not is_amount(self.memory):
                raise SolverOptionError(
                    f"windows: memory = {self.memory!r}: must be an amount such as 2GiB, at least 100MB"
                )

    def _whole(self, name: str, more: str = "") -> None:
        value = getattr(self, name)
        if isinstance(value, bool) or not (isinstance(value, int) and value >= 1):
            raise SolverOptionError(
                f"windows: {name} = {value!r}: must be a whole number of at least 1{more}"
            )

    @classmethod
    def split(cls, options: Mapping[str, Any]) -> tuple[Settings, dict[str, Any]]:
        """Return the settings among some options, and the other options."""
        names = {field.name for field in fields(cls)}
        own = {name: value for name, value in options.items() if name in names}
        return cls(**own), {name: value for name, value in options.items() if name not in names}
