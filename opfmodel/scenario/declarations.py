"""The ``network`` section of a scenario file."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cached_property
from typing import Any

from opfmodel import plugins
from opfmodel.errors import (
    CaseError,
    ComponentError,
    Fault,
    NetworkError,
    OpfmodelError,
    PluginError,
    ProfileError,
    ScenarioError,
    name_fault,
    nearest,
    raise_all,
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
from opfmodel.scenario.document import Document, Key, colon_hint
from opfmodel.scenario.schema import NetworkSection, ScenarioFile

__all__ = ["SHARE", "Declarations", "component_kinds"]


class Declarations:
    """Builder of the network of a scenario from its ``network`` section.

    Every fault is collected. A component with a fault is in the network with stand-ins for its values,
    so that what refers to it by name can be checked.

    Attributes
    ----------
    complete
        Whether the network has a component for every name that is meant to be declared.
    """

    def __init__(self, document: Document, settings: ScenarioFile) -> None:
        self.document = document
        self.section = settings.network
        self.currency = settings.currency
        self.faults = document.faults
        self.complete = not self.faults.lost("network")
        kinds, self.broken = component_kinds()
        self.kinds = {kind.plural: kind for kind in kinds}

    def network(self, name: str) -> Network:
        """Build the declared network; ``name`` applies unless the section states its own."""
        known = (*NetworkSection.model_fields, *self.kinds)
        for key in self.section.components:
            if key not in known:
                broken = "".join(f"; {reason}" for reason in self.broken)
                self._refuse((key,), f"unknown key; {nearest(key, known)}{broken}")
                self.complete = False
        network = self._start(name)
        network.set_currency(self.currency)
        self.basis = Basis(self.currency, network.base_mva)
        for plural in sorted(self.kinds, key=lambda p: p != "buses"):
            for component, fields in self._members(plural):
                self._declare(network, self.kinds[plural], component, fields)
        for component, fields in (self.section.update or {}).items():
            self._update(network, component, fields)
        for number, removed in enumerate(map(str, self.section.remove or ())):
            if removed in network or self.complete:
                with self.faults, self.document.located("network", "remove", number):
                    network.remove(removed)
        return network

    def check(self, network: Network) -> None:
        """Check that every component names existing buses; errors carry the component's position."""
        try:
            per_unit(network)
        except ComponentError as error:
            if not self.complete:
                return
            for each in (error, *error.others):
                assert isinstance(each, ComponentError)
                key, fault = self._key(each.component), f"{shown(each.value)}: {each.rule}"
                self.faults.add(self.document.fault((*key, *each.field.split(".", 1)), fault, each))
                self._stand_in(network, each.component, type(network[each.component]), {})
            with suppress(ComponentError):
                per_unit(network)
                return
            self.complete = False
        except NetworkError as error:
            if not self.faults.broken("network"):
                self._refuse((), str(error), error)
            self.complete = False

    def _key(self, component: str) -> Key:
        """Return the path of keys to what declares a component; to the file, if that does."""
        literal, patterns = self._declared
        if component in literal:
            return literal[component]
        matching = (key for name, key in patterns.items() if name_pattern(name).fullmatch(component))
        return next(matching, ("network", "file"))

    @cached_property
    def _declared(self) -> tuple[dict[str, Key], dict[str, Key]]:
        """Path of keys to every declaration, by name and by pattern."""
        names: tuple[dict[str, Key], dict[str, Key]] = ({}, {})
        for section, members in {**self.section.components, "update": self.section.update}.items():
            for name in members if isinstance(members, dict) else ():
                names["*" in name].setdefault(name, ("network", section, name))
        return names

    def _refuse(self, key: Key, message: str, cause: Exception | None = None) -> None:
        """Collect a fault in the section."""
        self.faults.add(self.document.fault(("network", *key), message, cause))

    def _start(self, name: str) -> Network:
        """Return the network of the file or an empty one, which also stands in if there is a fault."""
        network, file = Network(), self.section.file
        with self.faults:
            network = self._empty(name) if file is None else self._read(file)
        self.complete &= not self.faults.lost("network", "file")
        return network

    def _empty(self, name: str) -> Network:
        named, base_mva = self.section.name, self._sound("base_mva")
        if named is not None and (fault := name_fault(named)):
            self._refuse(("name",), f"{shown(named)}: the name {fault}")
            named = None
        with self.document.located("network", "base_mva"):
            return Network(name if named is None else named, 100.0 if base_mva is None else base_mva)

    def _sound(self, key: str) -> Any:
        """Return a value of the section; None in place of one with a fault."""
        return None if self.faults.lost("network", key) else getattr(self.section, key)

    def _read(self, file: str) -> Network:
        price = self._sound("default_cost")
        if self.section.base_mva is not None:
            self._refuse(("base_mva",), "cannot be combined with file, which sets it")
        with self.document.located("network", "file"), self.document.warned("network", "file"):
            return read_network(
                self.document.path.parent / file,
                default_cost=None if price is None else Polynomial(0.0, price, 0.0),
                lossy=self.section.lossy,
            )

    def _members(self, section: str) -> Iterator[tuple[str, dict[str, Any]]]:
        members = self.section.components.get(section, {})
        if members is None:  # a key without a value
            return
        if not isinstance(members, dict):
            hint = colon_hint(members)
            self._refuse((section,), f"{shown(members)}: must be a mapping from names to fields{hint}")
            self.complete = False
            return
        for name, fields in members.items():
            if isinstance(fields, dict):
                yield name, fields
                continue
            hint = colon_hint(fields)
            self._refuse((section, name), f"{shown(fields)}: must be a mapping from fields to values{hint}")
            yield name, {}

    def _declare(self, network: Network, kind: type[Component], pattern: str, fields: dict[str, Any]) -> None:
        """Declare one component, or one per bus if name and bus contain a star."""
        for name, values in self._expanded(network, kind, pattern, fields):
            if not self.faults.broken("network", kind.plural, pattern):
                with self.faults, self._fields(kind.plural, pattern):
                    network.add(name, kind.from_mapping(name, self._plain(kind, pattern, values)))
            if name not in network:
                self._stand_in(network, name, kind, values)

    def _expanded(
        self, network: Network, kind: type[Component], pattern: str, fields: dict[str, Any]
    ) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield names and fields of the components for which a declaration stands."""
        if str(fields.get("bus")) != "*":
            yield pattern, fields
            return
        if pattern.count("*") == 1:
            for bus in network.of(Bus):
                yield pattern.replace("*", bus), {**fields, "bus": bus}
            return
        rule = "for one per bus, the name must contain one * as well, such as 'cell*'"
        with self.faults, self._fields(kind.plural, pattern):
            raise ComponentError(pattern, "bus", "*", rule)
        self.complete = False

    def _stand_in(
        self, network: Network, name: str, kind: type[Component], fields: Mapping[str, Any]
    ) -> None:
        """Put a valid component in place of one with a fault; its values have no meaning.

        It keeps the names of its buses, so that they are checked.
        """
        if name in network:
            network.remove(name)
        self.complete &= "*" not in name  # it may stand for one per bus
        buses = {key: str(fields[key]) for key in kind.bus_fields() if isinstance(fields.get(key), str | int)}
        plain = _stand_ins(kind, list(network.of(Bus)))
        for values in ({**plain, **buses}, plain):
            with suppress(
                ComponentError, NetworkError, TypeError
            ):  # TypeError: of a device of another package
                network.add(name, kind(**values))
                return
        self.complete = False

    def _update(self, network: Network, pattern: str, fields: dict[str, Any]) -> None:
        """Change fields of every component whose name matches a pattern."""
        matching = _matching(network, pattern)
        if not matching and self.complete:
            fault = "no component matches" if "*" in pattern else "no such component"
            self._refuse(("update", pattern), f"{fault}; {nearest(pattern, network)}")
        for member in matching:
            old = network[member]
            plain = {k: getattr(old, k) for k in old.fields()}
            if self.faults.broken(*self._key(member)):
                continue  # a stand-in
            with self.faults, self._fields("update", pattern):
                network.update(member, **self._plain(type(old), member, fields, plain))

    @contextmanager
    def _fields(self, section: str, name: str) -> Iterator[None]:
        """Add the position of the fields of a component to errors raised inside the block."""
        try:
            yield
        except (ComponentError, NetworkError, CaseError) as error:
            raise ScenarioError(
                *(self._of_field(section, name, each) for each in (error, *error.others))
            ) from error

    def _of_field(self, section: str, name: str, error: OpfmodelError) -> Fault:
        if not isinstance(error, ComponentError):
            return self.document.fault(("network", section, name), str(error), error)
        value = "" if error.value is None else f"{shown(error.value)}: "
        return self.document.fault(("network", section, name, error.field), f"{value}{error.rule}", error)

    def _plain(
        self,
        kind: type[Component],
        name: str,
        fields: dict[str, Any],
        others: Mapping[str, Any] | None = None,
    ) -> dict[str, Any]:
        """Replace quantities such as ``200 MWh`` and shares such as ``10% of p_max`` with numbers."""
        plain, errors = dict(fields), []
        shares: dict[str, re.Match[str]] = {}
        for key, value in fields.items():
            match = SHARE.fullmatch(value) if isinstance(value, str) and _of_numbers(kind, key) else None
            if match:
                shares[key] = match
                continue
            try:
                plain |= without_units(kind, name, {key: value}, self.basis)
            except ComponentError as error:
                errors.append(error)
        wrong = {*shares, *(error.field for error in errors)}
        stated = {**(others or {}), **plain}
        stand_ins = _stand_ins(kind, [])
        # with numbers in place of the shares, of which the field may be required
        whole = {key: stand_ins.get(key, 1.0) if key in shares else value for key, value in stated.items()}
        faulty = bool(errors) or any(kind.errors_of_mapping(name, whole, wrong))
        component = kind(**(stand_ins if faulty else kind.converted(whole)))
        for key, match in shares.items():
            try:
                plain[key] = _share(component, name, key, match, shares)
            except ComponentError as error:
                errors.append(error)
        if faulty or errors:
            errors += kind.errors_of_mapping(name, {**(others or {}), **plain}, wrong)
        raise_all(errors)
        return plain


def _of_numbers(kind: type[Component], key: str) -> bool:
    return key in kind.fields() and kind.fields()[key].metadata["form"] in ("number", "span")


SHARE = re.compile(r"\s*([0-9]+(?:\.[0-9]*)?|\.[0-9]+)\s*%\s*of\s+(\w+)\s*")
"""A share of another field of the component: ``10% of p_max``."""


def _share(component: Component, name: str, key: str, match: re.Match[str], shares: Collection[str]) -> float:
    """Return the number for which a share of another field stands.

    Parameters
    ----------
    shares
        Fields that are shares, of which none can be one.
    """
    if match[2] == key:
        raise ComponentError(name, key, match[0], "is a share of itself; name another field")
    of = match[2] if match[2] in component.fields() else match[2].rpartition("_")[0]  # the end of a range
    if of in shares:
        raise ComponentError(name, key, match[0], "is a share of a share; name a field that is a number")
    try:
        number = float(match[1]) / 100.0 * component.constant(match[2])
    except ProfileError as error:
        raise ComponentError(name, key, match[0], str(error)) from error
    if not bounded(number):
        rule = f"is {number:g}; must be a finite number of at most {LARGEST:g}"
        raise ComponentError(name, key, match[0], rule)
    return number


def _stand_ins(kind: type[Component], buses: list[str]) -> dict[str, Any]:
    """Return finite values for the required fields of a component."""
    values: dict[str, Any] = {"number": 1.0, "span": (0.0, 1.0), "weights": {}}
    own = iter(buses)  # each end of a branch has another bus
    made = {}
    for key in kind.required():
        form = kind.fields()[key].metadata["form"]
        if form in values or form == "bus":
            made[key] = next(own, "") if form == "bus" else values[form]
    return made


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
