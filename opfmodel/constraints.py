"""Linear constraints over named quantities, as scenario files state them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.components import name_pattern
from opfmodel.data.columns import read_columns
from opfmodel.errors import ConstraintError, ProfileError, nearest
from opfmodel.model import Stage
from opfmodel.network import Index
from opfmodel.text import shown
from opfmodel.units import bounded
from solvers import Sum, total

__all__ = ["Limited", "Linear"]

Array = npt.NDArray[np.float64]


class Linear:
    r"""A weighted total of quantities and data, one value per stage, in physical units.

    .. math::
        y(k) = \sum_t f_t \sum_{i \in t} x_i(k)

    Parameters
    ----------
    terms
        Factors :math:`f_t` by what they multiply: ``kind.quantity`` for all components of a kind
        (``generator.pg``), ``component.quantity`` for one (``coal.pg``), or a pattern with stars
        (``gas*.pg``). Quantities are published ones and fields of the network (``p_max``, with
        its time series). What is out of service counts as zero.

    Examples
    --------
    The spinning reserve, to be limited from below::

        problem.constrain("reserve", Linear({"generator.p_max": 1, "generator.pg": -1}), at_least=100)
    """

    def __init__(self, terms: Mapping[str, float]) -> None:
        if not terms:
            raise ConstraintError("needs at least one term, for instance generator.pg: 1", "terms")
        for key, factor in terms.items():
            if isinstance(factor, bool) or not isinstance(factor, int | float) or not bounded(factor):
                raise ConstraintError(f"{shown(factor)}: the factor must be a finite number", "terms", key)
            owner, dot, quantity = str(key).rpartition(".")
            if not (owner and dot and quantity):
                raise ConstraintError(
                    "write kind.quantity (generator.pg) or component.quantity (coal.pg)", "terms", key
                )
        self.terms = dict(terms)

    def __call__(self, stage: Stage) -> Sum:
        """The total, from the quantities of a stage in physical units.

        Raises
        ------
        ConstraintError
            A term names nothing in the network, or a number that is infinite; or no term is decided.
        QuantityError
            A quantity is not published here.
        """
        result = sum((self.term(stage, key) for key in self.terms), start=0.0)
        if not isinstance(result, Sum):
            raise ConstraintError("no term is a quantity that is decided", "terms")
        return result

    def term(self, stage: Stage, key: str) -> Any:
        """One term: a :class:`solvers.Sum`, or numbers if nothing in it is decided."""
        owner, _, quantity = key.rpartition(".")
        result: Any = 0.0
        for kind, members in _select(stage, owner, quantity, key):
            result = result + self.terms[key] * total(_values(stage, kind, quantity, members, key))
        return result


@dataclass(frozen=True)
class Limited:
    """A linear total and its limits: numbers, or one value per time step.

    Attributes
    ----------
    at_least, at_most
        None where there is no such limit; the same for an equation.
    """

    linear: Linear
    at_least: float | list[float] | None
    at_most: float | list[float] | None

    @classmethod
    def from_mapping(cls, values: object, steps: int, folder: Path) -> Limited:
        """Make a constraint from plain values, as a scenario file has them.

        Parameters
        ----------
        values
            ``terms``, and ``at_least``, ``at_most`` or both, or ``equal``: each a number, a list, or
            ``{file: , column: }``.
        steps
            Number of values that a limit over time needs.
        folder
            Where relative file names start from.

        Raises
        ------
        ConstraintError
            What is wrong, with the key where it stands.
        """
        known = ("terms", "at_least", "at_most", "equal")
        if not isinstance(values, Mapping):
            raise ConstraintError(f"must be a mapping with {', '.join(known)}")
        for key in values:
            if key not in known:
                raise ConstraintError(f"unknown key; {nearest(key, known)}", key)
        terms = values.get("terms")
        if not isinstance(terms, Mapping):
            raise ConstraintError("must be a mapping from kind.quantity to factors", "terms")
        limits = {key: _limit(values[key], key, steps, folder) for key in known[1:] if key in values}
        if not limits:
            raise ConstraintError("needs a limit: at_least, at_most or equal")
        if "equal" in limits:
            if len(limits) > 1:
                raise ConstraintError("is an equation; leave out at_least and at_most", "equal")
            return cls(Linear(terms), limits["equal"], limits["equal"])
        made = cls(Linear(terms), limits.get("at_least"), limits.get("at_most"))
        made._check_order()
        return made

    def _check_order(self) -> None:
        if self.at_least is None or self.at_most is None:
            return
        low, high = np.broadcast_arrays(self.at_least, self.at_most)
        crossed = np.flatnonzero(low > high)
        if crossed.size:
            least, most = low.flat[crossed[0]], high.flat[crossed[0]]
            raise ConstraintError(f"at_least = {least:g} is above at_most = {most:g}", "at_least")


def _limit(value: object, key: str, steps: int, folder: Path) -> float | list[float]:
    if isinstance(value, Mapping):
        if set(value) != {"file", "column"}:
            raise ConstraintError("must be a number, a list, or {file: , column: }", key)
        path, heading = folder / str(value["file"]), str(value["column"])
        try:
            return [float(number) for number in read_columns(path, steps, [heading]).values[heading]]
        except ProfileError as error:
            raise ConstraintError(str(error), key) from error
    numbers = []
    for number in value if isinstance(value, list) else [value]:
        if isinstance(number, bool) or not isinstance(number, int | float) or not bounded(number):
            raise ConstraintError(f"{shown(number)}: must be a finite number, or a list of one per step", key)
        numbers.append(float(number))
    if not isinstance(value, list):
        return numbers[0]
    if len(numbers) < steps:
        raise ConstraintError(f"has {len(numbers)} values; {steps} are needed, steps + horizon - 1", key)
    return numbers[:steps]


def _select(stage: Stage, owner: str, quantity: str, key: str) -> list[tuple[str, Index]]:
    """Kinds and positions of the components that the first part of a term stands for."""
    tables = stage.network.tables
    if owner in tables and not any(owner in table.position for table in tables.values()):
        return [(owner, np.arange(len(tables[owner])))]
    pattern = name_pattern(owner)
    members = {
        kind: np.array([i for i, name in enumerate(table.names) if pattern.fullmatch(name)], dtype=np.intp)
        for kind, table in tables.items()
    }
    found = [(kind, index) for kind, index in members.items() if index.size]
    if not found and owner not in stage.network.left_out:
        near = nearest(owner, [*tables, *(name for table in tables.values() for name in table.names)])
        raise ConstraintError(f"there is no component and no kind {owner!r}; {near}", "terms", key)
    having = [(kind, index) for kind, index in found if quantity in getattr(stage, kind)]
    return having or found  # where none has the quantity, the first says so


def _values(stage: Stage, kind: str, quantity: str, members: Index, key: str) -> Any:
    """Values of a quantity of some components, decided or given."""
    values = getattr(getattr(stage, kind), quantity)[members]
    if isinstance(values, np.ndarray):
        if values.dtype.kind != "f" or values.ndim != 2:
            raise ConstraintError(f"{kind}.{quantity} is not a quantity", "terms", key)
        endless = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if endless.size:
            name = stage.network.tables[kind].names[members[endless[0]]]
            raise ConstraintError(f"{name}.{quantity} has no limit; give it one", "terms", key)
    return values
