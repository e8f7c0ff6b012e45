"""How plugins are found, in this package and in others', and made from the options of a file."""

from __future__ import annotations

import inspect
import pkgutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, get_type_hints

from opfmodel.errors import PluginError, nearest, shown

__all__ = ["GROUPS", "Plugin", "hidden", "load", "make", "plugins", "rescan"]

GROUPS = {
    "objective": "opfmodel.objectives",
    "formulation": "opfmodel.formulations",
    "device": "opfmodel.devices",
    "profile": "opfmodel.profiles",
    "forecast": "opfmodel.forecasts",
    "plant": "opfmodel.plants",
}

# What a plugin must be a subclass of; by name, because these live in layers above.
_BASES = {
    "objective": "opfmodel.objectives.base:Objective",
    "formulation": "opfmodel.formulations.base:Formulation",
    "device": "opfmodel.model:Device",
    "profile": "opfmodel.profiles.base:ProfileRule",
    "forecast": "opfmodel.forecasts.base:Forecast",
    "plant": "opfmodel.simulation:Plant",
}

# Where a class says its own name, which must be that of its entry point: results and networks use it.
_NAMES = {"formulation": "name", "device": "component.kind"}


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
            Its module does not import, or what it names is not a class of this sort and name.
        """
        where = f"{self.sort} {self.name!r} of {self.origin} cannot be loaded ({self.point.value})"
        try:
            loaded = self.point.load()
        except (Exception, SystemExit) as error:  # a third party's module may raise anything
            raise PluginError(f"{where}: {type(error).__name__}: {error}") from error
        base: type[Any] = pkgutil.resolve_name(_BASES[self.sort])
        if not (isinstance(loaded, type) and issubclass(loaded, base)):
            raise PluginError(
                f"{where}: {loaded!r} is not a subclass of {_BASES[self.sort].replace(':', '.')}"
            )
        if self.sort in _NAMES:
            named: Any = loaded
            for part in _NAMES[self.sort].split("."):
                named = getattr(named, part, None)
            if named != self.name:
                raise PluginError(f"{where}: its {_NAMES[self.sort]} is {named!r}, and must be {self.name!r}")
        return loaded


def plugins(sort: str) -> dict[str, Plugin]:
    """All plugins of a sort by name; this package's own win over others of the same name."""
    found: dict[str, Plugin] = {}
    for plugin in _every(sort):
        found.setdefault(plugin.name, plugin)
    return dict(sorted(found.items()))


def hidden(sort: str) -> list[tuple[Plugin, Plugin]]:
    """Plugins that cannot be reached, each with the one that has its name."""
    winners = plugins(sort)
    return [(p, winners[p.name]) for p in _every(sort) if p is not winners[p.name]]


@cache
def _every(sort: str) -> tuple[Plugin, ...]:
    """All plugins of a sort, this package's own first, then by origin."""
    found = []
    for point in entry_points(group=GROUPS[sort]):
        origin = point.dist.name if point.dist is not None else "unknown"
        found.append(Plugin(sort, point.name, origin, point))
    return tuple(sorted(found, key=lambda plugin: (plugin.origin != "opfmodel", plugin.origin)))


def rescan() -> None:
    """Look for plugins again, when one was installed while the program runs."""
    _every.cache_clear()


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


def make(
    sort: str,
    name: str,
    options: Mapping[str, Any],
    convert: Mapping[Any, Callable[[Any], Any]] | None = None,
    beside: Iterable[str] = (),
) -> Any:
    """An object of a plugin's class from options as a file has them.

    Parameters
    ----------
    options
        Keyword arguments of the constructor, checked against its annotations; numbers are finite.
    convert
        How values of a file become objects of a type, for options annotated with it.
    beside
        Keys that stand beside the options in a file, for which one of them may be a mistake.

    Raises
    ------
    PluginError
        An unknown plugin or option, a missing option, or a value of the wrong type; the attribute
        ``option`` names the option.
    """
    from pydantic import ConfigDict, TypeAdapter, ValidationError

    cls = load(sort, name)
    accepted = {
        p.name: p
        for p in inspect.signature(cls).parameters.values()
        if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)
    }
    hints = get_type_hints(cls.__init__)
    checked = {}
    for key, value in options.items():
        if key not in accepted:
            known = nearest(key, (*accepted, *beside))
            raise PluginError(f"{sort} {name!r} has no option {key!r}; {known}", key)
        hint = hints.get(key, Any)
        converter = (convert or {}).get(hint)
        try:
            adapter = TypeAdapter(hint, config=ConfigDict(arbitrary_types_allowed=True, allow_inf_nan=False))
            checked[key] = adapter.validate_python(value if converter is None else converter(value))
        except ValidationError as error:
            fault = error.errors()[0]
            path, at = _path(value, fault["loc"])
            reason = fault["msg"].removeprefix("Value error, ")
            named = ".".join(str(part) for part in (key, *path))
            raise PluginError(f"{sort} {name!r}: {named} = {shown(at)}: {reason}", key, *path) from None
    missing = [k for k, p in accepted.items() if p.default is p.empty and k not in checked]
    if missing:
        raise PluginError(f"{sort} {name!r} needs the option {missing[0]!r}")
    return cls(**checked)


def _path(value: Any, location: tuple[str | int, ...]) -> tuple[list[str | int], Any]:
    """Keys inside an option that lead to a mistake, and the value there; branches of unions are no keys."""
    path: list[str | int] = []
    at: Any = value
    for part in location:
        inside = part in at if isinstance(at, Mapping) else isinstance(at, list) and isinstance(part, int)
        if inside:
            at = at[part]
            path.append(part)
    return path, at
