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
from opfmodel.network.bounds import LARGEST, bounded
from opfmodel.network.cases import read_network
from opfmodel.network.component import Component
from opfmodel.network.components import BUILT_IN, Bus
from opfmodel.network.costs import Polynomial
from opfmodel.network.network import Network, name_pattern
from opfmodel.network.quantities import Basis
from opfmodel.network.written import without_units
from opfmodel.scenario.document import Document
from opfmodel.scenario.schema import NetworkSection, ScenarioFile

__all__ = ["SHARE", "Declarations", "component_kinds"]


class Declarations:
    """Builder of the network of a scenario from its ``network`` section."""

    def __init__(self, document: Document, settings: ScenarioFile) -> None:
        self.document = document
        self.section = settings.network
        self.currency = settings.currency
        kinds, self.broken = component_kinds()
        self.kinds = {kind.plural: kind for kind in kinds}

    def network(self, name: str) -> Network:
        """Build the declared network; ``name`` applies unless the section states its own."""
        known = (*NetworkSection.model_fields, *self.kinds)
        for key in self.section.components:
            if key not in known:
                broken = "".join(f"; {reason}" for reason in self.broken)
                raise self.document.error(("network", key), f"unknown key; {nearest(key, known)}{broken}")
        network = self._start(name)
        network.set_currency(self.currency)
        self.basis = Basis(self.currency, network.base_mva)
        for plural in sorted(self.kinds, key=lambda p: p != "buses"):
            for component, fields in self._members(plural):
                self._declare(network, self.kinds[plural], component, fields)
        for component, fields in (self.section.update or {}).items():
            self._update(network, component, fields)
        for number, removed in enumerate(self.section.remove or ()):
            with self.document.located("network", "remove", number):
                network.remove(str(removed))
        return network

    def check(self, network: Network) -> None:
        """Check that every component names existing buses; errors carry the component's position."""
        try:
            per_unit(network)
        except ComponentError as error:
            stated = {kind: dict(self._members(kind)) for kind in self.kinds}
            for section, members in {**stated, "update": self.section.update or {}}.items():
                for name in members:
                    if name_pattern(name).fullmatch(error.component):
                        key = ("network", section, name, error.field)
                        raise self.document.error(key, f"{shown(error.value)}: {error.rule}") from error
            raise

    def _start(self, name: str) -> Network:
        section = self.section
        if section.file is None:
            named = name if section.name is None else section.name
            if fault := name_fault(named):
                raise self.document.error(("network", "name"), f"{shown(named)}: the name {fault}")
            with self.document.located("network", "base_mva"):
                return Network(named, 100.0 if section.base_mva is None else section.base_mva)
        if section.base_mva is not None:
            raise self.document.error(("network", "base_mva"), "cannot be combined with file, which sets it")
        price = section.default_cost
        with self.document.located("network", "file"):
            return read_network(
                self.document.path.parent / section.file,
                default_cost=None if price is None else Polynomial(0.0, price, 0.0),
                lossy=section.lossy,
            )

    def _members(self, section: str) -> Iterator[tuple[str, dict[str, Any]]]:
        members = self.section.components.get(section, {})
        if members is None:  # a key without a value
            return
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
                network.add(name, kind.from_mapping(name, self._plain(kind, name, fields)))
                return
            if name.count("*") != 1:
                raise ComponentError(
                    name, "bus", "*", "for one per bus, the name must contain one * as well, such as 'cell*'"
                )
            for bus in network.of(Bus):
                member = name.replace("*", bus)
                network.add(
                    member, kind.from_mapping(member, self._plain(kind, name, {**fields, "bus": bus}))
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
                network.update(member, **self._plain(type(old), member, fields, plain))

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

    def _plain(
        self,
        kind: type[Component],
        name: str,
        fields: dict[str, Any],
        others: Mapping[str, Any] | None = None,
    ) -> dict[str, Any]:
        """Replace quantities such as ``200 MWh`` and shares such as ``10% of p_max`` with numbers."""
        fields = without_units(kind, name, fields, self.basis)
        shares = {
            key: match
            for key, value in fields.items()
            if _of_numbers(kind, key) and isinstance(value, str) and (match := SHARE.fullmatch(value))
        }
        known = {k: v for k, v in {**(others or {}), **fields}.items() if k not in shares}
        for key, match in shares.items():
            if match[2] == key:
                raise ComponentError(name, key, match[0], "is a share of itself; name another field")
            fields[key] = _share(kind.from_mapping(name, known), name, key, match)
        return fields


def _of_numbers(kind: type[Component], key: str) -> bool:
    return key in kind.fields() and kind.fields()[key].metadata["form"] in ("number", "span")


SHARE = re.compile(r"\s*([0-9]+(?:\.[0-9]*)?|\.[0-9]+)\s*%\s*of\s+(\w+)\s*")
"""A share of another field of the component: ``10% of p_max``."""


def _share(component: Component, name: str, key: str, match: re.Match[str]) -> float:
    """Return the number for which a share of another field stands."""
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
