"""Finding objectives, formulations, devices and profiles, in this package and in others'."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from opfmodel.errors import PluginError, nearest

__all__ = ["GROUPS", "Plugin", "load", "plugins"]

GROUPS = {
    "objective": "opfmodel.objectives",
    "formulation": "opfmodel.formulations",
    "device": "opfmodel.devices",
}


@dataclass(frozen=True)
class Plugin:
    """An entry point: what it is, whose it is, and how to load it.

    Attributes
    ----------
    origin
        Name of the distribution that provides it.
    """

    sort: str
    name: str
    origin: str
    point: EntryPoint

    def load(self) -> Any:
        """Import the class.

        Raises
        ------
        PluginError
            Its module does not import.
        """
        try:
            return self.point.load()
        except Exception as error:  # a third party's module may raise anything
            raise PluginError(
                f"{self.sort} {self.name!r} of {self.origin} cannot be loaded "
                f"({self.point.value}): {type(error).__name__}: {error}"
            ) from error


@cache
def plugins(sort: str) -> dict[str, Plugin]:
    """All plugins of a sort by name; this package's own win over others of the same name."""
    found: dict[str, Plugin] = {}
    for point in entry_points(group=GROUPS[sort]):
        origin = point.dist.name if point.dist is not None else "unknown"
        if point.name not in found or origin == "opfmodel":
            found[point.name] = Plugin(sort, point.name, origin, point)
    return dict(sorted(found.items()))


def load(sort: str, name: str) -> Any:
    """The class of a plugin.

    Raises
    ------
    PluginError
        No plugin of that name; the message names the nearest.
    """
    known = plugins(sort)
    if name not in known:
        raise PluginError(f"there is no {sort} {name!r}; {nearest(name, known)}")
    return known[name].load()
