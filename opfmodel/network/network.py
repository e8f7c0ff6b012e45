"""Network of named components on a common power base.

    >>> import opfmodel as om
    >>> grid = om.Network("two-bus", base_mva=100)
    >>> grid.north = om.Bus(vm=(0.95, 1.05), reference=True)
    >>> grid.south = om.Bus(vm=(0.95, 1.05))
    >>> grid.tie = om.Branch("north", "south", r=0.01, x=0.1, rating=120)
    >>> grid.coal = om.Generator("north", p=(0, 200), cost=om.Polynomial(0.01, 15, 0))
    >>> grid.town = om.Load("south", p=90, q=30)
    >>> grid
    Network('two-bus': 2 buses, 1 branch, 1 generator, 1 load)

Assigning an attribute names the component; in loops, use :meth:`Network.add`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any, TypeVar, cast

from opfmodel.data.notebook import pairs
from opfmodel.data.series import Profiles
from opfmodel.errors import ComponentError, NetworkError, name_fault, nearest, raise_all
from opfmodel.network.bounds import BASE_MVA, is_number
from opfmodel.network.component import Component, plain_value
from opfmodel.network.components import BUILT_IN, Bus, Generator, Load, Renewable, Storage
from opfmodel.network.fields import INF
from opfmodel.network.quantities import CURRENCY, currency_fault

__all__ = ["Network", "name_pattern"]

C = TypeVar("C", bound="Component")
T = TypeVar("T")


class Network:
    """Named components on a common power base.

    Parameters
    ----------
    name
        Name of the network.
    base_mva
        Power base of the branch impedances and admittances, from 1e-6 to 1e9 MVA. Results do not depend
        on it, because internal per-unit values refer to :attr:`scale_mva`.
    currency
        Name of the currency of all costs and prices, with which results are labelled.

    Examples
    --------
    ``grid.north = Bus()`` and ``grid.add("north", Bus())`` are equivalent, and so are
    ``grid["north"]`` and ``grid.north``.
    """

    name: str
    base_mva: float
    currency: str
    _components: dict[str, Component]
    _derived: dict[Callable[[Network], Any], Any]
    _classes: dict[str, type[Component]]
    _profiles: Profiles
    _aliases: dict[str, str | None]

    def __init__(self, name: str = "network", base_mva: float = 100.0, currency: str = CURRENCY) -> None:
        least, most = BASE_MVA
        if not is_number(base_mva) or not least <= base_mva <= most:
            raise NetworkError(
                f"network {name!r}: base_mva = {base_mva!r}: must be a number from {least:g} to {most:g} MVA"
            )
        if fault := name_fault(str(name)):
            raise NetworkError(f"network {name!r}: the name {fault}")
        object.__setattr__(self, "name", str(name))
        object.__setattr__(self, "base_mva", float(base_mva))
        object.__setattr__(self, "_components", {})
        object.__setattr__(self, "_derived", {})
        self.set_currency(currency)
        object.__setattr__(self, "_classes", {kind.kind: kind for kind in BUILT_IN})
        object.__setattr__(self, "_profiles", Profiles())
        object.__setattr__(self, "_aliases", {})

    @property
    def capacity_mva(self) -> float:
        """Largest of total generation, total load and total charging power, MW; ignores unlimited units."""
        generators, storages = self.of(Generator).values(), self.of(Storage).values()
        charging = (s.power[1] if isinstance(s.power, tuple) else s.power for s in storages if s.in_service)
        sums = (
            sum(abs(g.p[1]) for g in generators if g.in_service and abs(g.p[1]) < INF)
            + sum(r.available for r in self.of(Renewable).values() if r.in_service),
            sum(abs(load.p) for load in self.of(Load).values() if load.in_service),
            sum(power for power in charging if power < INF),
        )
        return float(max(sums))

    @property
    def scale_mva(self) -> float:
        """Power base of the internal per-unit values, MVA, on which quantities are of order one.

        100 MVA or, for smaller systems, the largest power of ten that does not exceed the capacity. It
        is independent of ``base_mva``.
        """
        capacity = self.capacity_mva
        return min(100.0, 10.0 ** math.floor(math.log10(capacity))) if capacity > 0 else 100.0

    def set_currency(self, currency: str) -> None:
        """Name the currency of all costs and prices, as for a network from a file; no value is converted.

        Raises
        ------
        NetworkError
            The name is not that of a currency.
        """
        if fault := currency_fault(currency):
            raise NetworkError(f"network {self.name!r}: currency = {currency!r}: {fault}")
        object.__setattr__(self, "currency", currency)
        self._derived.clear()

    def add(self, name: str, component: Component) -> Component:
        """Declare a component under a name.

        Raises
        ------
        NetworkError
            The name is already in use, or has invisible characters.
        ComponentError
            A field of the component is invalid. For a component out of service, only the types of
            its fields are checked; see :meth:`Component.check_declared`.
        """
        if not isinstance(component, Component):
            raise NetworkError(
                f"network {self.name!r}: {name} = {component!r}: must be a component (Bus, Branch, ...)"
            )
        name = str(name)
        if fault := name_fault(name):
            raise NetworkError(f"network {self.name!r}: the name {name!r} {fault}")
        if name in self._components:
            raise NetworkError(
                f"network {self.name!r}: the name {name!r} is used by a {self._components[name].kind}; "
                "names must be unique"
            )
        component.check_declared(name)
        self._set(name, component)
        return component

    def update(self, name: str, /, **changes: Any) -> Component:
        """Replace fields of a declared component: ``grid.update("coal", ramp=30)``.

        Fields are checked as by :meth:`add`, so a component that is put in service,
        ``grid.update("coal", in_service=True)``, must satisfy all rules. The new values replace attached
        time series of these fields.
        """
        old = self[name]
        known = old.fields()
        raise_all(
            ComponentError(name, key, value, f"unknown field of a {old.kind}; {nearest(key, known)}")
            for key, value in changes.items()
            if key not in known
        )
        new = replace(old, **{k: plain_value(old.fields()[k], v) for k, v in changes.items()})  # type: ignore[type-var]
        new.check_declared(name)
        self._set(name, new)
        self._detach(name, [quantity for key in changes for quantity in old.quantities(key)])
        return new

    def remove(self, name: str) -> Component:
        """Remove a component and its attached time series from the network, and return it."""
        component = self[name]
        self._set(name, None)
        self._detach(name)
        return component

    def _detach(self, component: str, fields: Collection[str] | None = None) -> None:
        """Remove the attached time series of fields of a component; by default of all."""
        series = self._profiles
        kept = {
            key: values
            for key, values in series.items()
            if key.component != component or not (fields is None or key.field in fields)
        }
        if len(kept) < len(series):
            self.attach(Profiles(kept, series.calendar))

    def _set(self, name: str, component: Component | None) -> None:
        """Change the components; every change goes through here to clear the cache."""
        if component is None:
            del self._components[name]
        else:
            first = self._classes.setdefault(component.kind, type(component))
            if first is not type(component):
                raise NetworkError(
                    f"network {self.name!r}: {name} = {component!r}: the kind {component.kind!r} is that of "
                    f"{first.__name__}; a class of components needs a kind of its own"
                )
            self._components[name] = component
        self._derived.clear()

    @property
    def profiles(self) -> Profiles:
        """Time series that came with the network, as from PyPSA; problems use them unless given others."""
        return self._profiles

    def attach(self, profiles: Profiles) -> None:
        """Attach time series, in place of those attached before; problems check them."""
        object.__setattr__(self, "_profiles", profiles)

    @property
    def aliases(self) -> Mapping[str, str | None]:
        """Bus that carries each bus of the source, None for a dead one, in the order of the source.

        Readers fill it where buses of the source are fused by closed switches or without supply, and where
        the network has buses that the source does not list: it then has an entry for every bus of the
        source, also for those that carry themselves. Otherwise it is empty.
        """
        return MappingProxyType(self._aliases)

    def alias(self, aliases: Mapping[str, str | None]) -> None:
        """Set :attr:`aliases`, in place of those set before.

        Raises
        ------
        NetworkError
            An entry names no bus of the network.
        """
        for name, bus in aliases.items():
            if bus is not None and not isinstance(self._components.get(bus), Bus):
                raise NetworkError(
                    f"network {self.name!r}: alias {name!r} = {bus!r}: no such bus; "
                    f"{nearest(str(bus), self.of(Bus))}"
                )
        object.__setattr__(self, "_aliases", dict(aliases))

    def derived(self, make: Callable[[Network], T]) -> T:
        """Result of ``make(network)``, cached until a component changes."""
        if make not in self._derived:
            self._derived[make] = make(self)
        return cast(T, self._derived[make])

    def of(self, kind: type[C]) -> dict[str, C]:
        """All components of a class by name, in order of declaration."""
        return {n: c for n, c in self._components.items() if isinstance(c, kind)}

    def kinds(self) -> list[type[Component]]:
        """Classes of the components, in order of first declaration."""
        return list(dict.fromkeys(type(c) for c in self._components.values()))

    def copy(self) -> Network:
        """Return an independent copy with the same components."""
        twin = Network(self.name, self.base_mva, self.currency)
        twin._components.update(self._components)
        twin._derived.update(self._derived)
        twin._classes.update(self._classes)
        twin.attach(self.profiles)
        twin._aliases.update(self._aliases)
        return twin

    __copy__ = copy

    def __getitem__(self, name: str) -> Component:
        try:
            return self._components[str(name)]
        except KeyError:
            raise NetworkError(
                f"network {self.name!r} has no component {name!r}; {nearest(str(name), self._components)}"
            ) from None

    def __contains__(self, name: object) -> bool:
        return name in self._components

    def __iter__(self) -> Iterator[str]:
        return iter(self._components)

    def __len__(self) -> int:
        return len(self._components)

    def __getattr__(self, name: str) -> Component:
        if name.startswith("_"):
            raise AttributeError(name)
        try:
            return self[name]
        except NetworkError as error:
            raise AttributeError(str(error)) from None

    def __setattr__(self, name: str, value: Any) -> None:
        if hasattr(type(self), name) or name in ("name", "base_mva", "currency"):
            raise NetworkError(
                f"network {self.name!r}: {name!r} is an attribute of Network; use add({name!r}, ...) "
                "or another name"
            )
        self.add(name, value)

    def __delattr__(self, name: str) -> None:
        self.remove(name)

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._components]

    def __repr__(self) -> str:
        counts = []
        for kind in self.kinds():
            n = len(self.of(kind))
            counts.append(f"{n} {kind.kind if n == 1 else kind.plural}")
        return f"Network({self.name!r}: {', '.join(counts) or 'empty'})"

    def _repr_html_(self) -> str:
        """Show the numbers of components in a notebook."""
        counts = {kind.plural.replace("_", " "): f"{len(self.of(kind)):,}" for kind in self.kinds()}
        series = {"time series": f"{len(self.profiles):,}"} if self.profiles else {}
        return pairs(self.name, {**counts, "base": f"{self.base_mva:g} MVA", **series})


def name_pattern(name: str) -> re.Pattern[str]:
    """Compile a name with ``*`` wildcards: ``gas*`` matches all names that begin with ``gas``."""
    return re.compile("".join(".*" if c == "*" else re.escape(c) for c in name))
