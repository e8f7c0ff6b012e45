"""Catalogue of the installed plugins and back ends."""

from __future__ import annotations

import inspect
import re
from dataclasses import asdict, dataclass
from importlib.metadata import entry_points
from typing import Any

from opfmodel.errors import PluginError
from opfmodel.plugins.registry import GROUPS, hidden, plugins
from solvers import back_ends, broken_back_ends, installed

__all__ = ["Entry", "catalogue", "described", "first_line"]


@dataclass(frozen=True)
class Entry:
    """Catalogue entry of a plugin or back end.

    Attributes
    ----------
    summary
        First line of its docstring, or the reason why it is unavailable.
    options
        Options it accepts, with their defaults if any: ``loads=null``.
    broken
        Whether it is unavailable.
    """

    sort: str
    name: str
    origin: str
    summary: str
    broken: bool = False
    options: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Convert the entry to plain data; the sort is called ``kind``."""
        entry = asdict(self)
        return {"kind": entry.pop("sort"), **entry}


def catalogue() -> list[Entry]:
    """List all plugins by sort and name, including those that fail to load or are shadowed."""
    entries = []
    for sort in GROUPS:
        for plugin in plugins(sort).values():
            try:
                loaded = plugin.load()
                entry = Entry(sort, plugin.name, plugin.origin, first_line(loaded), options=_options(loaded))
            except PluginError as error:
                entry = Entry(sort, plugin.name, plugin.origin, f"BROKEN: {error}", True)
            entries.append(entry)
        for plugin, winner in hidden(sort):
            summary = f"BROKEN: shadowed by the {sort} of the same name from {winner.origin}"
            entries.append(Entry(sort, plugin.name, plugin.origin, summary, True))
    origins = {p.name: p.dist.name if p.dist else "unknown" for p in entry_points(group="solvers.backends")}
    broken_ends = broken_back_ends()
    for name, end in back_ends().items():
        if name not in broken_ends:
            called = ", ".join(installed(end)) or "none installed"
            summary = f"{first_line(type(end))} Solves: {end.accepts}. Solvers: {called}."
            entries.append(Entry("back end", name, origins.get(name, "unknown"), summary))
    for name, reason in broken_ends.items():
        entries.append(Entry("back end", name, origins.get(name, "unknown"), f"BROKEN: {reason}", True))
    return entries


def first_line(cls: type) -> str:
    """First line of the docstring of a class, without markup."""
    return _plain((inspect.getdoc(cls) or "no documentation").splitlines()[0])


def described(cls: type) -> dict[str, str]:
    """What the docstring of a class says about each of its parameters, in one line without markup."""
    section = (inspect.getdoc(cls) or "").partition("Parameters\n----------\n")[2]
    found = re.findall(r"^(\w[\w, ]*).*\n((?:    .*\n?|\n(?=    ))+)", section, flags=re.MULTILINE)
    return {
        name: _plain(" ".join(text.split())) for names, text in found for name in names.strip().split(", ")
    }


def _plain(text: str) -> str:
    """Text without the markup of reStructuredText."""
    text = re.sub(r":(\w+):`([^`]*)`", lambda match: _formula(match[2]), text)
    return text.replace("``", "")


def _formula(text: str) -> str:
    r"""Formula or reference as plain text: ``\tan(\lambda)`` becomes tan(lambda)."""
    return text.removeprefix("~").replace("\\", "")


def _options(cls: type) -> tuple[str, ...]:
    """Keyword arguments of a constructor, with their defaults."""
    return tuple(
        p.name if p.default is p.empty else f"{p.name}={_shown(p.default)}"
        for p in inspect.signature(cls).parameters.values()
        if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)
    )


def _shown(default: Any) -> str:
    """Format a default as in a scenario file."""
    if isinstance(default, tuple | list):
        return f"[{', '.join(_shown(value) for value in default)}]"
    if default is None or isinstance(default, bool):
        return {None: "null", True: "true", False: "false"}[default]
    return f"{default:g}" if isinstance(default, float) else str(default)
