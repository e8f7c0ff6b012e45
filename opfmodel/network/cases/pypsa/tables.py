"""Validity of the tables of a PyPSA network, which may hold anything: names and types of values."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from opfmodel.errors import CaseError, nearest, shown

__all__ = ["check_tables"]

_NUMBERS = {"float": "a number", "int": "an integer", "bool": "true or false"}
_KINDS = {"float": "buif", "int": "buif", "bool": "b"}  # NumPy kinds of columns


def check_tables(n: Any, title: str) -> None:
    """Raise an error unless names are unique, series have components, and values their types.

    Raises
    ------
    CaseError
        With class, component, attribute and value.
    """
    for components in n.components:
        label = components.name
        for what, index in (("", components.static.index), *_columns(components)):
            if not index.is_unique:
                name = index[index.duplicated()][0]
                raise CaseError(f"{title}: {label}{what}: the name {shown(name)} occurs twice")
        for attribute, columns in _columns(components):
            unknown = columns.difference(components.static.index)
            if len(unknown):
                near = nearest(str(unknown[0]), map(str, components.static.index))
                raise CaseError(
                    f"{title}: {label}{attribute}: {shown(unknown[0])}: no such component; {near}"
                )
        types = components.defaults["typ"]
        for attribute, column in _values(components):
            kind = types[attribute].__name__ if attribute in types.index else "str"
            if kind in _KINDS and column.dtype.kind not in _KINDS[kind]:
                place, value = next(_odd(column, kind), (None, column.dtype))
                owner = "" if column.name == attribute else f" of {shown(column.name)}"
                where = "" if place is None else f" at {place}"
                raise CaseError(
                    f"{title}: {label} {attribute}{owner}: {shown(value)}{where}: must be {_NUMBERS[kind]}"
                )


def _columns(components: Any) -> Iterator[tuple[str, Any]]:
    for attribute, series in components.dynamic.items():
        yield f" {attribute}", series.columns


def _values(components: Any) -> Iterator[tuple[str, Any]]:
    """Yield attribute and column of all values that do not vary and of those that do."""
    for attribute in components.static:
        yield str(attribute), components.static[attribute]
    for attribute, series in components.dynamic.items():
        for name in series:
            yield str(attribute), series[name]


def _odd(column: Any, kind: str) -> Iterator[tuple[Any, Any]]:
    """Yield place and value of what has not the type of an attribute."""
    for place, value in column.items():
        if kind == "bool" and not isinstance(value, bool):
            yield place, value
        elif kind != "bool":
            try:
                float(value)
            except (TypeError, ValueError):
                yield place, value
