"""Discovery of plugins in this and other packages, and their construction from file options."""

from __future__ import annotations

import inspect
import json
import pkgutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Any, get_type_hints

from opfmodel.data.faults import fault_message
from opfmodel.errors import OpfmodelError, PluginError, close, nearest, raise_all, shown

if TYPE_CHECKING:
    from pydantic import TypeAdapter

__all__ = ["GROUPS", "Plugin", "hidden", "load", "make", "plugins", "rescan"]

GROUPS = {
    "objective": "opfmodel.objectives",
    "formulation": "opfmodel.formulations",
    "device": "opfmodel.devices",
    "profile": "opfmodel.profiles",
    "forecast": "opfmodel.forecasts",
    "plant": "opfmodel.plants",
}

# Base class of each sort of plugin, by name because they live in higher layers.
_BASES = {
    "objective": "opfmodel.objectives.base:Objective",
    "formulation": "opfmodel.formulations.base:Formulation",
    "device": "opfmodel.model:Device",
    "profile": "opfmodel.profiles.base:ProfileRule",
    "forecast": "opfmodel.forecasts.base:Forecast",
    "plant": "opfmodel.simulation:Plant",
}

# Attribute with the name of a class. Results and networks use it, so it must match the entry point.
_NAMES = {"formulation": "name", "device": "component.kind"}

# Sorts whose name alone would not say what they are, in messages.
_CALLED = {"profile": "profile rule"}


@dataclass(frozen=True)
class Plugin:
    """An entry point that provides a plugin.

    Attributes
    ----------
    origin
        Distribution that provides it.
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
            The module cannot be imported, or the entry point is not a class of this sort and name.
        """
        where = f"{_called(self.sort)} {self.name!r} from {self.origin} cannot be loaded ({self.point.value})"
        try:
            loaded = self.point.load()
        except (Exception, SystemExit) as error:  # a third-party module may raise anything
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
                raise PluginError(f"{where}: its {_NAMES[self.sort]} is {named!r}; must be {self.name!r}")
        return loaded


def plugins(sort: str) -> dict[str, Plugin]:
    """All plugins of a sort by name; those of this package take precedence."""
    found: dict[str, Plugin] = {}
    for plugin in _every(sort):
        found.setdefault(plugin.name, plugin)
    return dict(sorted(found.items()))


def hidden(sort: str) -> list[tuple[Plugin, Plugin]]:
    """Shadowed plugins, each with the plugin that takes precedence."""
    winners = plugins(sort)
    return [(p, winners[p.name]) for p in _every(sort) if p is not winners[p.name]]


@cache
def _every(sort: str) -> tuple[Plugin, ...]:
    """All plugins of a sort, first those of this package, then by origin."""
    found = []
    for point in _installed().select(group=GROUPS[sort]):
        origin = point.dist.name if point.dist is not None else "unknown"
        found.append(Plugin(sort, point.name, origin, point))
    return tuple(sorted(found, key=lambda plugin: (plugin.origin != "opfmodel", plugin.origin)))


@cache
def _installed() -> Any:
    """All entry points, read once: finding those of one group reads every distribution, too."""
    return entry_points()


def rescan() -> None:
    """Discard the cached plugins, to find those installed since."""
    _every.cache_clear()
    _installed.cache_clear()


def load(sort: str, name: str) -> Any:
    """Load the class of a plugin.

    Raises
    ------
    PluginError
        There is no plugin of that name, or it cannot be loaded.
    """
    known = plugins(sort)
    if name not in known:
        raise PluginError(f"there is no {_called(sort)} {shown(name)}; {nearest(name, known)}")
    return known[name].load()


def make(
    sort: str,
    name: str,
    options: Mapping[str, Any],
    convert: Mapping[Any, Callable[[Any], Any]] | None = None,
    beside: Iterable[str] = (),
    context: object = None,
) -> Any:
    """Construct a plugin from the options of a file.

    Parameters
    ----------
    options
        Keyword arguments of the constructor, checked against its annotations. Types of plain data are not
        converted, so that the text ``"2"`` is no number; numbers must be finite.
    convert
        Functions that convert file values, by the annotated type of the option.
    beside
        Other keys next to the options in the file, suggested for misspelt options.
    context
        What annotations of the options need to validate values, such as the basis of quantities with units.

    Raises
    ------
    PluginError
        The plugin or an option is unknown, a required option is missing, or a value has the wrong type.
        The attribute ``option`` names the option that is unknown or has the wrong type; ``others`` has the
        errors of the other options.
    """
    from pydantic import ConfigDict, TypeAdapter, ValidationError

    cls, called = load(sort, name), f"{_called(sort)} {name!r}"
    accepted = {
        p.name: p
        for p in inspect.signature(cls).parameters.values()
        if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)
    }
    hints = get_type_hints(cls.__init__, include_extras=True)
    checked = {}

    def errors() -> Iterator[PluginError]:
        misplaced = [key for key in options if key not in accepted and close(key, beside)]
        for key, value in options.items():
            if misplaced and key not in misplaced:
                continue  # its plugin may be another one
            if key not in accepted:
                known = nearest(key, (*accepted, *beside))
                yield PluginError(f"{called} has no option {key!r}; {known}", key)
                continue
            hint = hints.get(key, Any)
            converter = (convert or {}).get(hint)
            adapter = TypeAdapter(hint, config=ConfigDict(arbitrary_types_allowed=True, allow_inf_nan=False))
            try:
                plain = value if converter is None else converter(value)
                checked[key] = _validated(adapter, plain, context)
            except ValidationError as error:
                fault = error.errors()[0]
                path, at = _path(value, fault["loc"])
                named = ".".join(str(part) for part in (key, *path))
                yield PluginError(f"{called}: {named} = {shown(at)}: {fault_message(fault)}", key, *path)
            except OpfmodelError as error:
                for each in (error, *error.others):
                    yield PluginError(str(each), key, *each.key)
        required = [k for k, p in accepted.items() if p.default is p.empty]
        missing = [] if misplaced else [k for k in required if k not in options]
        misspelt = {known for k in options if k not in accepted for known in close(k, accepted)}
        for key in missing:
            if key not in misspelt:
                yield PluginError(f"{called} requires the option {key!r}")

    raise_all(errors())
    return cls(**checked)


def _validated(adapter: TypeAdapter[Any], value: Any, context: object) -> Any:
    """Validate an option: plain data as JSON, in which a strict check takes lists for tuples."""
    try:
        text = json.dumps(value)
    except TypeError:  # an object
        return adapter.validate_python(value, context=context)
    return adapter.validate_json(text, strict=True, context=context)


def _called(sort: str) -> str:
    return _CALLED.get(sort, sort)


def _path(value: Any, location: tuple[str | int, ...]) -> tuple[list[str | int], Any]:
    """Path of keys inside an option to the invalid value, without union branches, and that value."""
    path: list[str | int] = []
    at: Any = value
    for part in location:
        inside = part in at if isinstance(at, Mapping) else isinstance(at, list) and isinstance(part, int)
        if inside:
            at = at[part]
            path.append(part)
    return path, at
