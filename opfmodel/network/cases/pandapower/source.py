"""A pandapower network as it is read: rows of its tables, and the name of each element."""

from __future__ import annotations

import contextlib
import copy
import importlib.util
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

from opfmodel.errors import CaseError, listed, name_fault, shown
from opfmodel.network.cases.losses import Losses
from opfmodel.network.cases.pandapower.tables import ELEMENTS, KNOWN, UNMODELLED

__all__ = ["Row", "Source", "element_names", "is_missing", "refusals"]

_LARGEST_INDEX = 10_000_000
_LONGEST = 300  # characters of an error of pandapower


class Row:
    """A row of a table, whose missing and empty values have defaults."""

    def __init__(self, where: str, table: str, name: str, index: int, values: Mapping[str, Any]) -> None:
        self.label = f"{where}: {table} {name!r}"
        self.table = table
        self.name = name
        self.index = index
        self.values = values

    def number(self, column: str, default: float = math.nan) -> float:
        """Number in a column; the default if there is no such column or no value."""
        value = self._value(column)
        if value is None:
            return default
        try:
            return float(value)
        except (TypeError, ValueError):
            raise CaseError(f"{self.label}: {column} = {shown(value)}: must be a number") from None

    def given(self, column: str) -> float:
        """Number in a column that must have a value."""
        value = self.number(column)
        if math.isnan(value):
            raise CaseError(f"{self.label}: {column} has no value; must be a number")
        return value

    def flag(self, column: str, default: bool) -> bool:
        """Boolean in a column; the default if there is no such column or no value."""
        value = self._value(column)
        return default if value is None else bool(value)

    def text(self, column: str) -> str:
        """Text in a column, empty if there is none."""
        value = self._value(column)
        return "" if value is None else str(value)

    def limits(self, quantity: str) -> tuple[float, float]:
        """``min_<quantity>`` and ``max_<quantity>``; infinite where there is no value."""
        return self.number(f"min_{quantity}", -math.inf), self.number(f"max_{quantity}", math.inf)

    @property
    def in_service(self) -> bool:
        """Whether the element is in service."""
        return self.flag("in_service", True)

    def _value(self, column: str) -> Any:
        value = self.values.get(column)
        return None if is_missing(value) else value


class Source:
    """A pandapower network, the names of its elements, and what is lost.

    Parameters
    ----------
    net
        The network, which is copied.
    where
        File or network, for messages.

    Notes
    -----
    An element keeps its pandapower name if this is visible text and no other element has it;
    otherwise its name is its table and its index, such as ``load3``.
    """

    def __init__(self, net: Any, where: str) -> None:
        _check_tables(net, where)
        with refusals(where):
            self.net = copy.deepcopy(net)
        self.where = where
        self.losses = Losses(where)
        self._names = element_names(self.net)
        for table in UNMODELLED:
            self._drop(table)
        self._report_unknown_tables()

    def rows(self, table: str) -> Iterator[Row]:
        """Rows of a table; none if the network has no such table."""
        if table not in self.net:
            return
        frame = self.net[table]
        for index, values in zip(frame.index, frame.to_dict("records"), strict=True):
            yield Row(self.where, table, self.name(table, index), int(index), values)

    def controllable(self, table: str, row: Row) -> bool:
        """Whether an optimal power flow decides about an element, with pandapower's defaults."""
        return row.flag("controllable", table == "gen")

    def name(self, table: str, index: int) -> str:
        """Name of an element."""
        return self._names.get((table, int(index)), f"{table}{index}")

    def _report_unknown_tables(self) -> None:
        """Report equipment in tables of later versions of pandapower; tables of users have no service."""
        for table, frame in self.net.items():
            own = table in KNOWN or table.startswith(("_", "res_"))
            if own or "in_service" not in getattr(frame, "columns", ()):
                continue
            count = sum(row.in_service for row in self.rows(table))
            if count:
                elements = "1 element" if count == 1 else f"{count} elements"
                self.losses.add(f"{table}: {elements} in service, of a kind that this version does not know")

    def _drop(self, table: str) -> None:
        """Report the elements of a table that have no counterpart, and remove them."""
        for row in self.rows(table):
            if row.in_service:
                self.losses.add(f"{table} {row.name!r}: {UNMODELLED[table]}; it is left out")
        if table in self.net:
            self.net[table] = self.net[table].iloc[:0]


@contextlib.contextmanager
def refusals(where: str) -> Iterator[None]:
    """Turn the errors that pandapower raises for invalid data into :class:`CaseError`."""
    try:
        yield
    except _invalid() as error:
        text = str(error) if isinstance(error, UserWarning) else f"{type(error).__name__}: {error}"
        raise CaseError(f"{where}: pandapower cannot convert the network: {text[:_LONGEST]}") from error


def _invalid() -> tuple[type[Exception], ...]:
    """What pandapower raises for data that it does not accept; with numba, also errors of its compiler."""
    found: list[type[Exception]] = [ArithmeticError, AttributeError, LookupError, NotImplementedError]
    found += [TypeError, UserWarning, ValueError]
    if importlib.util.find_spec("numba") is not None:
        from numba.core.errors import NumbaError

        found.append(NumbaError)
    return tuple(found)


def _check_tables(net: Any, where: str) -> None:
    """Raise :class:`CaseError` unless tables are tables, with distinct columns and indices in bounds.

    The lookups of pandapower are dense arrays over the indices.
    """
    import pandas as pd

    for table in sorted(KNOWN & set(net.keys())):
        frame = net[table]
        if not isinstance(frame, pd.DataFrame):
            raise CaseError(f"{where}: {table} is a {type(frame).__name__}; must be a table")
        for what, labels in (("column", frame.columns), ("index", frame.index)):
            if not labels.is_unique:
                repeated = listed(map(str, labels[labels.duplicated()].unique()))
                raise CaseError(f"{where}: {table}: repeated labels of {what}: {repeated}; must differ")
        for index in frame.index:
            if not (hasattr(index, "__index__") and 0 <= index <= _LARGEST_INDEX):
                raise CaseError(
                    f"{where}: {table}: index {shown(index)}: must be an integer from 0 to {_LARGEST_INDEX:,}"
                )


def is_missing(value: object) -> bool:
    """Whether a value of a table is None, NaN or NA."""
    return value is None or repr(value) in ("nan", "<NA>", "NaT", "np.float64(nan)")


def element_names(net: Any) -> dict[tuple[str, int], str]:
    """Names of all elements by table and index, unique in the whole network; see :class:`Source`."""
    elements = [
        (table, int(index), value)
        for table in ELEMENTS
        if table in net
        for index, value in zip(
            net[table].index,
            net[table]["name"] if "name" in net[table] else [None] * len(net[table]),
            strict=True,
        )
    ]
    numbered = {f"{table}{index}": (table, index) for table, index, _ in elements}
    count = Counter(_text(value) for _, _, value in elements)
    names = {}
    for table, index, value in elements:
        text = _text(value)
        own = numbered.get(text, (table, index)) == (table, index)
        names[table, index] = text if text and count[text] == 1 and own else f"{table}{index}"
    return names


def _text(value: object) -> str:
    """Name in a table as text; empty unless it can name a component."""
    if isinstance(value, bool) or not (isinstance(value, str) or hasattr(value, "__index__")):
        return ""
    text = str(value).strip()
    return "" if name_fault(text) else text
