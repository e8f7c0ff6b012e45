"""Access to a PyPSA network: the components that are read, their names here, and their values."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.errors import CaseError, shown

__all__ = ["PREFIXES", "UNNAMED", "Array", "Source", "Value", "check_numbers"]

Array = npt.NDArray[np.float64]
Value = float | Array

PREFIXES = {
    "lines": "line",
    "transformers": "transformer",
    "generators": "generator",
    "loads": "load",
    "storage_units": "storage_unit",
    "stores": "store",
    "shunt_impedances": "shunt",
    "links": "link",
}
"""Classes that are read besides buses, and the prefix of a name that components of several classes have."""
UNNAMED = "Unnamed Network"
"""PyPSA's name of a network without one."""


def check_numbers(column: Any, place: str) -> None:
    """Raise :class:`CaseError` unless a pandas Series consists of numbers; NaN is one."""
    if column.dtype.kind in "fiub":
        return
    for label, value in column.items():
        try:
            float(value)
        except (TypeError, ValueError):
            raise CaseError(f"{place}: {label}: {shown(value)}: must be a number") from None


class Source:
    """A PyPSA network as it is read.

    Attributes
    ----------
    n
        The ``pypsa.Network``.
    title
        What messages call it.
    hours
        Length of a snapshot, h.
    buses
        Names of the buses that are represented, those with alternating current.
    names
        Name of each component in opfmodel, by class and name in PyPSA.
    """

    def __init__(self, n: Any, title: str, hours: float) -> None:
        self.n = n
        self.title = title
        self.hours = hours
        for class_name in ("buses", *PREFIXES):
            index = self.static(class_name).index
            if not index.is_unique:
                repeated = str(index[index.duplicated()][0])
                raise CaseError(f"{title}: {class_name}: the name {repeated!r} is used twice")
            self._check_numbers(getattr(n.c, class_name))
        carriers = self.static("buses").carrier
        self.buses = [bus for bus in carriers.index if carriers.at[bus] == "AC"]
        self._members = {name: list(self._at_buses(name)) for name in PREFIXES}
        self.names = self._unique_names()

    @staticmethod
    def title_of(n: Any) -> str:
        """Return what messages call a network."""
        return "PyPSA network" if n.name in ("", UNNAMED) else f"PyPSA network {n.name!r}"

    @property
    def network_name(self) -> str:
        """Name of the network in opfmodel."""
        return "network" if self.n.name in ("", UNNAMED) else str(self.n.name)

    def static(self, class_name: str) -> Any:
        """Return the table of a class."""
        return getattr(self.n.c, class_name).static

    def members(self, class_name: str) -> list[Any]:
        """Return the names, in PyPSA, of the components of a class at buses that are represented."""
        return self._members[class_name]

    def active(self, class_name: str) -> list[Any]:
        """Return those members of a class that are active."""
        active = self.static(class_name).active
        return [name for name in self.members(class_name) if active.at[name]]

    def storages(self) -> Iterator[tuple[str, Any]]:
        """Yield class and name of all active storage units and stores."""
        for class_name in ("storage_units", "stores"):
            for name in self.active(class_name):
                yield class_name, name

    def cyclic(self, class_name: str, name: Any) -> bool:
        """Whether the energy of a storage ends where it begins."""
        column = "e_cyclic" if class_name == "stores" else "cyclic_state_of_charge"
        return bool(self.static(class_name)[column].at[name])

    def value(self, class_name: str, name: Any, attribute: str) -> Value:
        """Return the value of an attribute: one number, or one per snapshot."""
        components = getattr(self.n.c, class_name)
        dynamic = components.dynamic.get(attribute)
        if dynamic is not None and name in dynamic.columns:
            return np.asarray(dynamic[name].to_numpy(), dtype=float)
        if attribute not in components.static:  # an older PyPSA
            return math.nan
        return float(components.static[attribute].at[name])

    def first(self, class_name: str, name: Any, attribute: str) -> float:
        """Return the value of an attribute in the first snapshot."""
        return float(np.ravel(self.value(class_name, name, attribute))[0])

    def energy(self, class_name: str, name: Any) -> tuple[Array, Array]:
        """Return the limits of the energy of a storage at the end of each snapshot, MWh."""
        row = self.static(class_name).loc[name]
        low: Value
        high: Value
        if class_name == "stores":
            low = float(row.e_nom) * self.value(class_name, name, "e_min_pu")
            high = float(row.e_nom) * self.value(class_name, name, "e_max_pu")
            fixed = self.value(class_name, name, "e_set")
        else:
            low, high = 0.0, float(row.p_nom) * float(row.max_hours)
            fixed = self.value(class_name, name, "state_of_charge_set")
        return np.atleast_1d(np.fmax(low, fixed)), np.atleast_1d(np.fmin(high, fixed))

    def ramp_limits(self, name: Any) -> tuple[Value, Value]:
        """Return the upward and downward ramp limits of a generator, per unit and snapshot; NaN for none."""
        up, down = (self.value("generators", name, f"ramp_limit_{way}") for way in ("up", "down"))
        return up, down

    def link_power(self, name: Any) -> tuple[Value, Value]:
        """Return the limits of the power that a link draws from its first bus, MW."""
        p_nom = self.first("links", name, "p_nom")
        low, high = (np.asarray(self.value("links", name, f"p_{end}_pu")) for end in ("min", "max"))
        # 0 times infinity is 0
        return tuple(np.where(pu == 0.0, 0.0, pu * np.where(pu == 0.0, 0.0, p_nom)) for pu in (low, high))  # type: ignore[return-value]

    def _check_numbers(self, components: Any) -> None:
        """Raise :class:`CaseError` for a text where PyPSA has a number; it accepts any, in time series."""
        defaults = components.defaults
        for attribute in defaults.index[defaults.typ.isin([float])]:
            for table in (components.static, components.dynamic.get(attribute)):
                if table is None or (table is components.static and attribute not in table):
                    continue
                columns = {attribute: table[attribute]} if table is components.static else table
                for name, column in columns.items():
                    check_numbers(column, f"{self.title}: {components.list_name} {name}")

    def _at_buses(self, class_name: str) -> Iterator[Any]:
        table, represented = self.static(class_name), set(self.buses)
        columns = [column for column in ("bus", "bus0", "bus1") if column in table]
        known = set(self.static("buses").index)
        for name, *buses in table[columns].itertuples():
            for column, bus in zip(columns, buses, strict=True):
                if bus not in known:
                    what = PREFIXES[class_name].replace("_", " ")
                    raise CaseError(f"{self.title}: {what} {name!r}: {column} = {bus!r}: no such bus")
            if represented.issuperset(buses):
                yield name

    def _unique_names(self) -> dict[tuple[str, Any], str]:
        names = {("buses", bus): str(bus) for bus in self.buses}
        uses = Counter(names.values())
        for members in self._members.values():
            uses.update(str(name) for name in members)
        taken = set(uses)
        for class_name, members in self._members.items():
            for member in members:
                name = str(member)
                if uses[name] > 1:
                    name = f"{PREFIXES[class_name]}_{name}"
                    while name in taken:
                        name += "_"
                    taken.add(name)
                names[class_name, member] = name
        return names
