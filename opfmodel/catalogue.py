"""What is installed: every objective, formulation, device, profile rule and back end."""

from __future__ import annotations

import inspect
from dataclasses import asdict, dataclass
from importlib.metadata import entry_points
from typing import Any

from opfmodel import plugins
from opfmodel.errors import PluginError
from solvers import back_ends, broken_back_ends, installed

__all__ = ["Entry", "catalogue"]


@dataclass(frozen=True)
class Entry:
    """One plugin.

    Attributes
    ----------
    summary
        First line of its documentation, or why it could not be loaded.
    broken
        Whether it could not be loaded.
    """

    sort: str
    name: str
    origin: str
    summary: str
    broken: bool = False

    def as_dict(self) -> dict[str, Any]:
        """The entry as plain data."""
        return asdict(self)


def catalogue() -> list[Entry]:
    """All plugins by sort and name; one that does not load or is out of reach is said to be so."""
    entries = []
    for sort in plugins.GROUPS:
        for plugin in plugins.plugins(sort).values():
            try:
                summary, broken = _first_line(plugin.load()), False
            except PluginError as error:
                summary, broken = f"BROKEN: {error}", True
            entries.append(Entry(sort, plugin.name, plugin.origin, summary, broken))
        for plugin, winner in plugins.hidden(sort):
            summary = f"BROKEN: out of reach behind the {sort} of the same name of {winner.origin}"
            entries.append(Entry(sort, plugin.name, plugin.origin, summary, True))
    origins = {p.name: p.dist.name if p.dist else "unknown" for p in entry_points(group="solvers.backends")}
    broken_ends = broken_back_ends()
    for name, end in back_ends().items():
        if name not in broken_ends:
            called = ", ".join(installed(end)) or "nothing installed"
            summary = f"{_first_line(type(end))} Solves: {end.accepts}. Solvers: {called}."
            entries.append(Entry("back end", name, origins.get(name, "unknown"), summary))
    for name, reason in broken_ends.items():
        entries.append(Entry("back end", name, origins.get(name, "unknown"), f"BROKEN: {reason}", True))
    return entries


def _first_line(cls: type) -> str:
    return (inspect.getdoc(cls) or "no documentation").splitlines()[0]
