"""Custom constraints: the limited quantity, its limits, and the resulting rows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.errors import ConstraintError, ModelError, name_fault, nearest, raise_all, shown
from opfmodel.model.elastic import Soft
from opfmodel.model.model import Model
from opfmodel.model.stage import Stage
from opfmodel.network.arrays import Index
from opfmodel.network.bounds import bounded, is_number
from opfmodel.network.network import name_pattern
from opfmodel.network.units import scale
from solvers import Constraint, Expression, Sum, total

__all__ = ["CustomConstraint", "Linear", "PhysicalStage"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CustomConstraint:
    """A user-defined constraint: a function of the stage, and limits that may vary over time.

    Attributes
    ----------
    state
        Function of a stage in physical units. It returns a comparison, or a quantity or total to which
        the limits below apply. :class:`Linear` is one such function.
    at_least, at_most
        Limits in physical units: a number, or one value per time step; infinite if absent.
    """

    name: str
    state: Callable[[Stage], Any]
    at_least: Array
    at_most: Array

    @classmethod
    def of(
        cls,
        name: str,
        state: Callable[[Stage], Any],
        at_least: npt.ArrayLike | None = None,
        at_most: npt.ArrayLike | None = None,
    ) -> CustomConstraint:
        """Create a constraint and check its name and limits.

        Raises
        ------
        ConstraintError
            Results cannot have a price of that name; a limit is not a number or a vector of numbers, or the
            two limits cross, where ``key`` names the limit.
        """
        _check_name(name)
        lower, upper = _limit("at_least", at_least, -np.inf), _limit("at_most", at_most, np.inf)
        steps = min((limit.size for limit in (lower, upper) if limit.ndim), default=1)
        low, high = (
            np.broadcast_to(limit[:steps] if limit.ndim else limit, steps) for limit in (lower, upper)
        )
        crossed = np.flatnonzero(low > high)
        if crossed.size:
            first = crossed[0]
            raise ConstraintError(f"at_least = {low[first]:g} is above at_most = {high[first]:g}", "at_least")
        return cls(name, state, lower, upper)

    @property
    def limited(self) -> bool:
        """Whether limits were given in addition to the function."""
        return bool(np.isfinite(self.at_least).any() or np.isfinite(self.at_most).any())

    @property
    def length(self) -> int | None:
        """Number of values of its limits; None if none changes in time."""
        return min((limit.size for limit in (self.at_least, self.at_most) if limit.ndim), default=None)

    @property
    def price(self) -> str:
        """Name of the price in results."""
        return f"{self.name}_price"

    @property
    def rows(self) -> str:
        """Name of the rows, distinct from every quantity of a formulation or device."""
        return f"constraint {self.name}"

    def window(self, start: int, stages: int, repeats: bool = False) -> tuple[Array, Array]:
        """Return the limits of ``stages`` stages from step ``start``.

        Parameters
        ----------
        repeats
            Whether the values begin again after their end.

        Raises
        ------
        ModelError
            A limit has too few values.
        """
        limits = []
        for side, values in (("at_least", self.at_least), ("at_most", self.at_most)):
            if not values.ndim:
                limits.append(np.full(stages, values))
                continue
            if len(values) < start + stages and not repeats:
                raise ModelError(
                    f"constraint {self.name!r}: {side} has {len(values)} values; "
                    f"steps {start} to {start + stages - 1} need {start + stages}"
                )
            limits.append(values[np.arange(start, start + stages) % len(values)])
        return limits[0], limits[1]

    def declare(self, model: Model) -> None:
        """Add the rows, make them soft in an elastic problem, and report their shadow price.

        Raises
        ------
        QuantityError
            The function uses a quantity that is not published.
        ModelError, SolverError
            The function does not return a comparison, quantity or total, or the program cannot express it.
        """
        self.check_price(model)
        stated = self._stated(model)
        rows = model.build.constrain(self.rows, stated)
        items, stages = rows.index.shape
        soft = Soft(
            "constraint", np.arange(items), "", "is missed by {}", "is exceeded by {}",
            names=(self.name,) * items, timed=stages == model.stage.stages,
        )  # fmt: skip
        limits = (self.at_least, self.at_most) if self.limited else (stated.lower, stated.upper)
        nodes = np.arange(stages) if soft.timed else None
        lower, upper = limits
        model.soften("constraint", rows, soft, lower, upper, nodes=nodes)
        if soft.timed:
            model.price(
                "" if items == 1 else f"{self.name}_item", self.price,
                lambda solution, _: -solution.dual(rows.name),
                "$/h", f"increase in cost per unit increase of the right-hand side of {self.name!r}",
            )  # fmt: skip
        elif self.limited:
            raise ModelError("at_least and at_most apply to every stage; use >= or <= for some of them")

    def check_price(self, model: Model) -> None:
        """Raise :class:`ConstraintError` if a quantity or price has the name of the price."""
        if model.has_name(self.price):
            raise ConstraintError(f"the results already have {self.price!r}; choose another name")

    def _stated(self, model: Model) -> Constraint:
        """Return the comparison given by the function, or one whose limits are set in every solve."""
        stated = self.state(PhysicalStage(model))
        if isinstance(stated, Expression | Sum) and self.limited:
            return Constraint(stated, -np.inf, np.inf)
        if not isinstance(stated, Constraint):
            wanted = "a quantity or a total" if self.limited else "a comparison of quantities"
            raise ModelError(f"must return {wanted}, not {_described(stated)}")
        if self.limited:
            raise ModelError("already returns a comparison; omit at_least and at_most")
        return stated


def _check_name(name: object) -> None:
    """Raise :class:`ConstraintError` unless a variable in a results file can have the name."""
    fault = "must be a text" if not isinstance(name, str) else name_fault(name)
    if name == "":
        fault = "is empty"
    elif "/" in str(name):
        fault = "has a '/', which names in results files cannot have"
    if fault:
        raise ConstraintError(f"the name {fault}")


def _described(stated: object) -> str:
    """Describe what a function returned: the kind if it is symbolic, else the value."""
    kinds = {Expression: "a quantity", Sum: "a total", Constraint: "a comparison"}
    return kinds[type(stated)] if type(stated) in kinds else shown(stated)


def _limit(side: str, given: npt.ArrayLike | None, absent: float) -> Array:
    """Return a limit as a number or a vector over time steps."""
    values = np.asarray(absent if given is None else given)
    if (
        values.ndim > 1
        or values.dtype.kind not in "if"
        or (values == -absent).any()
        or np.isnan(values).any()
    ):
        raise ConstraintError(f"{side} = {given!r}: must be a number or one number per time step", side)
    return values.astype(float)


class PhysicalStage:
    """A model with quantities in physical units, for custom constraints."""

    def __init__(self, model: Model) -> None:
        self.network = model.network
        self.step = model.stage.step
        self._model = model

    def __getattr__(self, kind: str) -> Any:
        if kind.startswith("_"):
            raise AttributeError(kind)
        if kind not in self.network.tables:
            raise ModelError(
                f"there is no component kind {shown(kind)}; {nearest(kind, self.network.tables)}"
            )
        return _PhysicalQuantities(self._model, kind)

    def has(self, name: str) -> bool:
        """Whether a quantity is published."""
        return self._model.has(name)

    @property
    def operating_cost(self) -> Any:
        """Operating cost of all devices, $/h."""
        return self._model.stage.operating_cost


class _PhysicalQuantities:
    def __init__(self, model: Model, kind: str) -> None:
        self._model = model
        self._kind = kind

    def __contains__(self, name: str) -> bool:
        return name in getattr(self._model.stage, self._kind)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        value = getattr(getattr(self._model.stage, self._kind), name)
        table = self._model.network.tables[self._kind]
        published = self._model.published.get(name)
        if published is not None and published.kind == self._kind:
            return value * scale(published.unit, table.base_mva)
        if table.arrays[name].dtype.kind != "f":
            return value
        if name not in table.units:
            raise ModelError(f"{self._kind}.{name} has no physical unit; use a field of the components")
        return value * scale(table.units[name], table.base_mva)


# Linear totals -------------------------------------------------------------------------------------


class Linear:
    r"""A weighted total of quantities and data, one value per stage, in physical units.

    .. math::
        y(k) = \sum_t f_t \sum_{i \in t} x_i(k)

    Parameters
    ----------
    terms
        Factors :math:`f_t` by term: ``kind.quantity`` for all components of a kind (``generator.pg``),
        ``component.quantity`` for one component (``coal.pg``), or a pattern with stars (``gas*.pg``). A
        quantity is either published or a field of the network (``p_max``, with its time series).
        Components out of service count as zero.

    Examples
    --------
    A minimum spinning reserve::

        problem.constrain("reserve", Linear({"generator.p_max": 1, "generator.pg": -1}), at_least=100)
    """

    def __init__(self, terms: Mapping[str, float]) -> None:
        if not terms:
            raise ConstraintError("needs at least one term, such as generator.pg: 1", "terms")
        raise_all(_errors_of_factors(terms))
        self.terms = dict(terms)

    def __call__(self, stage: Stage) -> Sum:
        """Return the total for a stage in physical units.

        Raises
        ------
        ConstraintError
            A term matches nothing in the network or is infinite, or every term is fixed data.
        QuantityError
            A quantity is not published.
        """
        result = sum((self.term(stage, key) for key in self.terms), start=0.0)
        if not isinstance(result, Sum):
            raise ConstraintError(
                "every term is fixed data; include a decision variable, such as generator.pg", "terms"
            )
        return result

    def term(self, stage: Stage, key: str) -> Any:
        """Return one term: a :class:`solvers.Sum`, or numbers if it is fixed data."""
        owner, _, quantity = key.rpartition(".")
        result: Any = 0.0
        for kind, members in _select(stage, owner, quantity, key):
            result = result + self.terms[key] * total(_values(stage, kind, quantity, members, key))
        return result


def _errors_of_factors(terms: Mapping[str, float]) -> Iterator[ConstraintError]:
    for key, factor in terms.items():
        if not (is_number(factor) and bounded(factor)):
            yield ConstraintError(f"{shown(factor)}: the factor must be a finite number", "terms", key)
        owner, dot, quantity = str(key).rpartition(".")
        if not (owner and dot and quantity):
            yield ConstraintError(
                "write kind.quantity (generator.pg) or component.quantity (coal.pg)", "terms", key
            )


def _select(stage: Stage, owner: str, quantity: str, key: str) -> list[tuple[str, Index]]:
    """Return the kinds and positions of the components that the first part of a term matches."""
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
        raise ConstraintError(f"there is no component or kind {shown(owner)}; {near}", "terms", key)
    having = [(kind, index) for kind, index in found if quantity in getattr(stage, kind)]
    return having or found  # if none has the quantity, the first one raises the error


def _values(stage: Stage, kind: str, quantity: str, members: Index, key: str) -> Any:
    """Return the values of a quantity for some components: decision variables or data."""
    values = getattr(getattr(stage, kind), quantity)[members]
    if isinstance(values, np.ndarray):
        if values.dtype.kind != "f" or values.ndim != 2:
            raise ConstraintError(f"{kind}.{quantity} is not a numeric quantity", "terms", key)
        endless = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if endless.size:
            name = stage.network.tables[kind].names[members[endless[0]]]
            raise ConstraintError(f"{name}.{quantity} is unlimited; set a finite limit", "terms", key)
    return values
