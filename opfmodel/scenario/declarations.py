"""The ``network`` section of a scenario file."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from opfmodel import plugins
from opfmodel.errors import (
    CaseError,
    ComponentError,
    NetworkError,
    PluginError,
    ProfileError,
    name_fault,
    nearest,
    shown,
)
from opfmodel.network.arrays import per_unit
from opfmodel.network.bounds import LARGEST, bounded, is_number
from opfmodel.network.cases import read_network
from opfmodel.network.component import Component
from opfmodel.network.components import BUILT_IN, Bus
from opfmodel.network.costs import Polynomial
from opfmodel.network.network import Network, name_pattern
from opfmodel.scenario.document import Document

__all__ = ["Declarations", "component_kinds"]


class Declarations:
    """Builder of the network of a scenario from its ``network`` section."""

    _OWN = ("file", "name", "base_mva", "default_cost", "lossy", "update", "remove")

    def __init__(self, document: Document, section: dict[str, Any]) -> None:
        self.document = document
        self.section = section
        kinds, self.broken = component_kinds()
        self.kinds = {kind.plural: kind for kind in kinds}

    def network(self, name: str) -> Network:
        """Build the declared network; ``name`` applies unless the section states its own."""
        known = (*self._OWN, *self.kinds)
        for key in self.section:
            if key not in known:
                broken = "".join(f"; {reason}" for reason in self.broken)
                raise self.document.error(("network", key), f"unknown key; {nearest(key, known)}{broken}")
        network = self._start(name)
        for plural in sorted(self.kinds, key=lambda p: p != "buses"):
            for component, fields in self._members(plural):
                self._declare(network, self.kinds[plural], component, fields)
        for component, fields in self._members("update"):
            self._update(network, component, fields)
        removed = self.section.get("remove") or []
        if not isinstance(removed, list):
            raise self.document.error(("network", "remove"), "must be a list of component names")
        for number, component in enumerate(removed):
            with self.document.located("network", "remove", number):
                network.remove(str(component))
        return network

    def check(self, network: Network) -> None:
        """Check that every component names existing buses; errors carry the component's position."""
        try:
            per_unit(network)
        except ComponentError as error:
            for section in (*self.kinds, "update"):
                for name, _ in self._members(section):
                    if name_pattern(name).fullmatch(error.component):
                        key = ("network", section, name, error.field)
                        raise self.document.error(key, f"{shown(error.value)}: {error.rule}") from error
            raise

    def _start(self, name: str) -> Network:
        file, base_mva = self.section.get("file"), self.section.get("base_mva")
        if file is None:
            named = self.section.get("name", name)
            if not isinstance(named, str) or name_fault(named):
                raise self.document.error(
                    ("network", "name"), f"{shown(named)}: must be text of visible characters"
                )
            with self.document.located("network", "base_mva"):
                return Network(named, 100.0 if base_mva is None else base_mva)
        if not isinstance(file, str):
            raise self.document.error(("network", "file"), "must be a path relative to this file")
        if base_mva is not None:
            raise self.document.error(("network", "base_mva"), "cannot be combined with file, which sets it")
        price = self.section.get("default_cost")
        if price is not None and not is_number(price):
            raise self.document.error(("network", "default_cost"), f"{price!r}: must be a number in $/MWh")
        lossy = self.section.get("lossy", False)
        if not isinstance(lossy, bool):
            raise self.document.error(("network", "lossy"), f"{shown(lossy)}: must be true or false")
        with self.document.located("network", "file"):
            return read_network(
                self.document.path.parent / file,
                default_cost=None if price is None else Polynomial(0.0, float(price), 0.0),
                lossy=lossy,
            )

    def _members(self, section: str) -> Iterator[tuple[str, dict[str, Any]]]:
        members = self.section.get(section) or {}
        if not isinstance(members, dict):
            raise self.document.error(("network", section), "must be a mapping from names to fields")
        for name, fields in members.items():
            if not isinstance(fields, dict):
                raise self.document.error(
                    ("network", section, name), "must be a mapping from fields to values"
                )
            yield name, fields

    def _declare(self, network: Network, kind: type[Component], name: str, fields: dict[str, Any]) -> None:
        """Declare one component, or one per bus if name and bus contain a star."""
        with self._fields(kind.plural, name):
            if str(fields.get("bus")) != "*":
                network.add(name, kind.from_mapping(name, self._shares(kind, name, fields)))
                return
            if name.count("*") != 1:
                raise ComponentError(
                    name, "bus", "*", "for one per bus, the name must contain one * as well, such as 'cell*'"
                )
            for bus in network.of(Bus):
                member = name.replace("*", bus)
                network.add(
                    member, kind.from_mapping(member, self._shares(kind, name, {**fields, "bus": bus}))
                )

    def _update(self, network: Network, name: str, fields: dict[str, Any]) -> None:
        """Change fields of every component whose name matches a pattern."""
        matching = _matching(network, name)
        if not matching:
            fault = "no component matches" if "*" in name else "no such component"
            raise self.document.error(("network", "update", name), f"{fault}; {nearest(name, network)}")
        for member in matching:
            old = network[member]
            plain = {k: getattr(old, k) for k in old.fields()}
            with self._fields("update", name):
                network.update(member, **self._shares(type(old), member, fields, plain))

    @contextmanager
    def _fields(self, section: str, name: str) -> Iterator[None]:
        try:
            yield
        except ComponentError as error:
            key = ("network", section, name, error.field)
            value = "" if error.value is None else f"{shown(error.value)}: "
            raise self.document.error(key, f"{value}{error.rule}") from error
        except (NetworkError, CaseError) as error:
            raise self.document.error(("network", section, name), str(error)) from error

    @staticmethod
    def _shares(
        kind: type[Component], name: str, fields: dict[str, Any], others: Mapping[str, Any] | None = None
    ) -> dict[str, Any]:
        """Replace shares such as ``10% of p_max`` with numbers."""
        known = {k: v for k, v in {**(others or {}), **fields}.items() if not _SHARE.fullmatch(str(v))}
        resolved = dict(fields)
        for key, value in fields.items():
            match = _SHARE.fullmatch(value) if isinstance(value, str) else None
            if match:
                resolved[key] = _share(kind.from_mapping(name, known), name, key, match)
        return resolved


_SHARE = re.compile(r"\s*([0-9]+(?:\.[0-9]*)?|\.[0-9]+)\s*%\s*of\s+(\w+)\s*")


def _share(component: Component, name: str, key: str, match: re.Match[str]) -> float:
    """Return the number for which a share of another field stands."""
    if match[2] == key:
        raise ComponentError(name, key, match[0], "is a share of itself; name another field")
    try:
        number = float(match[1]) / 100.0 * component.constant(match[2])
    except ProfileError as error:
        raise ComponentError(name, key, match[0], str(error)) from error
    if not bounded(number):
        rule = f"is {number:g}; must be a finite number of at most {LARGEST:g}"
        raise ComponentError(name, key, match[0], rule)
    return number


def _matching(network: Network, name: str) -> list[str]:
    """Return the components of a name, which may be a pattern with stars."""
    if "*" not in name:
        return [name] if name in network else []
    return list(filter(name_pattern(name).fullmatch, network))


def component_kinds() -> tuple[list[type[Component]], list[str]]:
    """Return the component classes that a scenario can declare, and why other devices failed to load.

    The classes are the built-in ones and those of devices from other packages.
    """
    known: dict[str, type[Component]] = {kind.kind: kind for kind in BUILT_IN}
    broken = []
    for name, plugin in plugins.plugins("device").items():
        if name not in known:
            try:
                component = plugin.load().component
            except PluginError as error:
                broken.append(str(error))
                continue
            taken = [kind.plural for kind in known.values()]
            if isinstance(getattr(component, "plural", None), str) and component.plural not in taken:
                known[component.kind] = component
            else:
                broken.append(f"device {name!r} of {plugin.origin}: its component must have a unique plural")
    return list(known.values()), broken
