"""Base class of components: dataclasses whose fields describe their checks and array layout."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, fields
from functools import cache
from typing import Any, ClassVar, NamedTuple, Self, TypeVar, dataclass_transform

import numpy as np
import numpy.typing as npt

from opfmodel.data.calendar import Times
from opfmodel.errors import ComponentError, ProfileError, close, nearest, raise_all
from opfmodel.network.costs import COEFFICIENT_UNITS, Cost, PiecewiseLinear, Polynomial
from opfmodel.network.describe import documented
from opfmodel.network.fields import (
    INF,
    TableField,
    is_adjustable,
    is_flag,
    rules_of_adjustable,
    rules_of_number,
    rules_of_points,
    rules_of_span,
    rules_of_weights,
    type_of_adjustable,
    type_of_bus,
    type_of_choice,
    type_of_flag,
    type_of_number,
    type_of_points,
    type_of_span,
    type_of_weights,
)

__all__ = ["Clocked", "Component", "component", "plain_value"]


def _type_of_cost(name: str, key: str, value: object, _: Mapping[str, Any]) -> None:
    if not isinstance(value, Cost):
        raise ComponentError(
            name,
            key,
            value,
            "must be a Polynomial or PiecewiseLinear; in a file {c2: , c1: , c0: } in $/MW²h, "
            "$/MWh, $/h or {points: [[MW, $/h], ...]}",
        )
    value.check_types(name, key)


def _rules_of_cost(name: str, key: str, value: Cost, _: Mapping[str, Any]) -> None:
    value.check(name, key)


_Check = Callable[[str, str, Any, Mapping[str, Any]], None]
_TYPES: Mapping[str, _Check] = {
    "number": type_of_number,
    "span": type_of_span,
    "flag": type_of_flag,
    "bus": type_of_bus,
    "choice": type_of_choice,
    "cost": _type_of_cost,
    "weights": type_of_weights,
    "adjustable": type_of_adjustable,
    "points": type_of_points,
}
_RULES: Mapping[str, _Check] = {
    "number": rules_of_number,
    "span": rules_of_span,
    "cost": _rules_of_cost,
    "weights": rules_of_weights,
    "adjustable": rules_of_adjustable,
    "points": rules_of_points,
}


class Clocked(NamedTuple):
    """A quantity in the arrays of a kind of component that follows from the clock.

    Attributes
    ----------
    unit
        Its physical unit.
    over
        Its value over a stage of several steps: ``mean``, ``min`` or ``max``.
    loosest
        The value with which programs are built, before it is known; of a limit, the loosest.
    of
        Optional field without which a component has no such quantity, which is then 0.
        Its value over a stage of several steps: ``mean``, ``min``, ``max``, or ``last``.
    """

    unit: str
    over: str = "mean"
    loosest: float = 0.0
    of: str | None = None


class Component:
    """Base class of all components of a network.

    A subclass is a frozen dataclass whose fields are made by :func:`number`, :func:`span`,
    :func:`flag`, :func:`choice`, :func:`weights` and :func:`at_bus`. These state how a field is checked,
    converted to per unit and laid out in arrays, and describe it in its docstring, in documentation and in
    the schema of scenario files; a new kind of component needs nothing else.

    Attributes
    ----------
    kind, plural
        Name of the dimension in results, and name of the section in scenario files.
    lost
        Quantities of the arrays that are different while a component is out of service, and their values, if
        it can go out while the network is operated.
    clocked
        Quantities of the arrays that follow from the clock, by name; see :meth:`at_clock`.
    governs
        Fields on which other quantities of the arrays depend in each stage, and these; see :meth:`in_stages`.
        Those that are no fields are 0 where nothing governs them.
    """

    kind: ClassVar[str]
    plural: ClassVar[str]
    lost: ClassVar[Mapping[str, float]] = {}
    clocked: ClassVar[Mapping[str, Clocked]] = {}
    governs: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    in_service: bool

    def __init_subclass__(cls) -> None:
        """Add a section on the parameters to the docstring, from the descriptions of the fields."""
        super().__init_subclass__()
        own = {name: item for name, item in vars(cls).items() if isinstance(item, Field)}
        inherited = getattr(cls, "__dataclass_fields__", {})  # with those of the class itself, as of kind
        declared = {name: item for name, item in {**inherited, **own}.items() if "form" in item.metadata}
        cls.__doc__ = documented(cls.__doc__, declared)

    def __new__(cls, *_: Any, **values: Any) -> Self:
        """Refuse unknown fields and suggest the closest known ones."""
        known = cls.fields()
        for key, value in values.items():
            if key not in known:
                raise ComponentError(cls.__name__, key, value, f"unknown field; {nearest(key, known)}")
        return super().__new__(cls)

    def check_types(self, name: str) -> None:
        """Raise :class:`ComponentError` unless every field has the right type.

        A number field holds a number, including NaN and infinity, or None if it is optional. A span
        holds a pair of numbers, a flag true or false, a bus field the name of a bus, and a cost field
        a :class:`Cost` with numeric parameters. Types are checked even if the component is out of
        service, because arrays, files and later updates rely on them.
        """
        values = {key: getattr(self, key) for key in self.fields()}
        raise_all(self._errors(name, values, in_service=False))

    def check(self, name: str) -> None:
        """Raise :class:`ComponentError` unless the component may be in service.

        Checks the type and the rules of each field, and that no number exceeds another one that limits it.
        A subclass calls this method first and then checks its own rules.
        """
        raise_all(self._errors(name, {key: getattr(self, key) for key in self.fields()}, in_service=True))
        raise_all(self._crossed(name))

    @classmethod
    def _errors(cls, name: str, values: Mapping[str, Any], in_service: bool) -> Iterator[ComponentError]:
        """Yield the errors of fields, each regarded by itself: types, and rules if in service."""
        sound = cls._sound_defaults()
        for key, metadata, check_type, check_rules in cls._checks():
            value, default = values.get(key, MISSING), sound.get(key, MISSING)
            if value is default or value is MISSING or (type(value) is float and value == default):
                continue
            try:
                if check_type is not None:
                    check_type(name, key, value, metadata)
                if check_rules is not None and in_service:
                    check_rules(name, key, value, metadata)
            except ComponentError as error:
                yield error

    @classmethod
    @cache
    def _sound_defaults(cls) -> Mapping[str, Any]:
        """Defaults that are valid in service, which most values of a network file are."""
        made: dict[str, Any] = {}
        for key, metadata, *checks in cls._checks():
            default = cls.fields()[key].default
            try:
                for check in filter(None, checks):
                    check("", key, default, metadata)
            except ComponentError:
                continue
            made[key] = default
        return made

    def _crossed(self, name: str) -> Iterator[ComponentError]:
        """Yield the errors of numbers that exceed another one that limits them."""
        for key, other in self.ordered():
            value, limit = getattr(self, key), getattr(self, other)
            if None not in (value, limit) and value > limit:
                yield ComponentError(name, key, value, f"must be at most {other} = {limit:g}")

    @classmethod
    @cache
    def ordered(cls) -> tuple[tuple[str, str], ...]:
        """Pairs of numbers of which the first must not exceed the second.

        Examples
        --------
        >>> from opfmodel.network import Storage
        >>> Storage.ordered()
        (('energy_min', 'energy'),)
        """
        pairs = ((key, item.metadata.get("not_above")) for key, item in cls.fields().items())
        return tuple((key, other) for key, other in pairs if other is not None)

    def check_declared(self, name: str) -> None:
        """Raise :class:`ComponentError` unless a network may contain the component.

        A component in service must pass :meth:`check`. A component out of service must only pass
        :meth:`check_types`: its values are not used, so invalid data of retired units, such as a
        minimum above the maximum, are kept unchanged until it is put in service.
        """
        if is_flag(self.in_service) and not self.in_service:
            self.check_types(name)
        else:
            self.check(name)

    def at_clock(self, times: Times) -> Mapping[str, npt.NDArray[np.float64]]:  # noqa: ARG002
        """Return the quantities in :attr:`clocked` in physical units, one value per step.

        Parameters
        ----------
        times
            The beginnings of the steps; its ``clock`` has the local times in hours.
        """
        return {}

    def check_clock(self, name: str, times: Times, lengths: npt.NDArray[np.intp]) -> None:
        """Raise :class:`IncompatibleError` if stages cannot represent what follows from the clock.

        Parameters
        ----------
        times
            The beginnings of the stages.
        lengths
            Number of steps of each stage.
        """

    @classmethod
    def in_stages(
        cls,
        arrays: Mapping[str, npt.NDArray[Any]],  # noqa: ARG003
        before: Mapping[str, npt.NDArray[np.float64]],  # noqa: ARG003
        hours: npt.NDArray[np.float64],  # noqa: ARG003
    ) -> Mapping[str, npt.NDArray[np.float64]]:
        """Return the quantities in :attr:`governs`, ``(items, stages)``.

        Parameters
        ----------
        arrays
            All quantities of the kind as declared, in per unit.
        before
            The fields in :attr:`governs` in the stage before each.
        hours
            Mean length of each stage and the one before it.
        """
        return {}

    @classmethod
    def at_start(
        cls,
        arrays: Mapping[str, npt.NDArray[Any]],  # noqa: ARG003
    ) -> Mapping[str, npt.NDArray[np.float64]]:
        """Return the fields in :attr:`governs` before step 0, ``(items, 1)``; NaN if not known."""
        return {}

    def resolved(self) -> Self:
        """Return the component with defaults that depend on other fields filled in."""
        return self

    @classmethod
    @cache
    def fields(cls) -> Mapping[str, Field[Any]]:
        """Fields of the dataclass by name."""
        return {f.name: f for f in fields(cls)}  # type: ignore[arg-type]

    @classmethod
    def required(cls) -> list[str]:
        """Names of the fields without a default."""
        fields = cls.fields().items()
        return [key for key, item in fields if item.default is MISSING and item.default_factory is MISSING]

    @classmethod
    @cache
    def _checks(cls) -> tuple[tuple[str, Mapping[str, Any], _Check | None, _Check | None], ...]:
        """Key, metadata, type check and rule check of each field."""
        forms = [(key, item.metadata, item.metadata["form"]) for key, item in cls.fields().items()]
        return tuple((key, metadata, _TYPES.get(form), _RULES.get(form)) for key, metadata, form in forms)

    @classmethod
    @cache
    def table_fields(cls) -> Mapping[str, TableField]:
        """Quantities in the arrays of this kind, by name: ``p_min`` and ``p_max`` for a span ``p``.

        Examples
        --------
        >>> from opfmodel.network import Load
        >>> list(Load.table_fields())
        ['p', 'q', 'shed_cost']
        """
        made = {}
        for name, item in cls.fields().items():
            form, unit = item.metadata["form"], item.metadata["unit"]
            for quantity in cls.quantities(name):
                own = COEFFICIENT_UNITS[quantity] if form == "cost" else unit
                made[quantity] = TableField(form, own, item.metadata.get("series", True))
        return made | {name: TableField("clock", own.unit, False) for name, own in cls.clocked.items()}

    @classmethod
    @cache
    def over(cls, key: str) -> str:
        """Return how a quantity combines over several steps: ``mean``, ``min``, ``max`` or ``last``.

        Power, demand and cost are averaged, so that energy is kept; of limits the tighter counts.

        Examples
        --------
        >>> from opfmodel.network import Branch, Bus, Generator
        >>> Generator.over("p_max"), Branch.over("rating"), Bus.over("vm_min")
        ('mean', 'min', 'max')
        """
        known = cls.fields()
        if key in cls.clocked:
            return cls.clocked[key].over
        if key in known:
            return str(known[key].metadata.get("over", "mean"))
        stem, _, end = key.rpartition("_")
        if end not in ("min", "max") or stem not in known or known[stem].metadata["averaged"]:
            return "mean"
        return "max" if end == "min" else "min"

    @classmethod
    def quantities(cls, key: str) -> tuple[str, ...]:
        """Names in the arrays of this kind of the quantities that a field states.

        Examples
        --------
        >>> from opfmodel.network import Generator
        >>> Generator.quantities("p"), Generator.quantities("cost"), Generator.quantities("bus")
        (('p_min', 'p_max'), ('c2', 'c1', 'c0'), ())
        """
        ends = f"{key}_min", f"{key}_max"
        named = {
            "number": (key,),
            "span": ends,
            "cost": tuple(COEFFICIENT_UNITS),
            "adjustable": (key, *ends),
        }
        return named.get(cls.fields()[key].metadata["form"], ())

    def constant(self, field: str) -> float:
        """Declared value of a quantity of the arrays, such as ``p``, ``p_max`` or ``c1``.

        Raises
        ------
        ProfileError
            The component has no such number. For a span, the message names its two ends.
        """
        component, known = self.resolved(), self.fields()
        stem, _, end = field.rpartition("_")
        of = self.table_fields().get(field)
        if of is not None and of.form == "number":
            value = getattr(component, field)
            return INF if value is None else float(value)  # None is "no limit"
        if of is not None and of.form == "adjustable":
            value = getattr(component, field if field in known else stem)
            if field in known or not is_adjustable(value):
                return component.neutral(field if field in known else stem)
            return float(value[end == "max"])
        if of is not None and of.form == "span":
            pair = getattr(component, stem)
            return float(pair[end == "max"] if isinstance(pair, tuple) else (pair if end == "max" else -pair))
        if field in component.of_cost:
            return float(component.of_cost[field])
        span = field in known and known[field].metadata["form"] == "span"
        known_numbers = f"it has {field}_min and {field}_max" if span else nearest(field, self.numbers)
        raise ProfileError(f"a {self.kind} has no number {field!r}; {known_numbers}")

    @property
    def of_cost(self) -> Mapping[str, float]:
        """Numbers of its cost functions that may have a time series, such as ``c1`` or ``slope_2``."""
        costs = [getattr(self, key) for key, item in self.fields().items() if item.metadata["form"] == "cost"]
        return {key: value for cost in costs for key, value in cost.numbers.items()}

    @property
    def numbers(self) -> list[str]:
        """Names of the numbers that have a constant value and may have a time series."""
        plain = [key for key, item in self.table_fields().items() if item.form in ("number", "span")]
        return [*plain, *self.of_cost]

    @classmethod
    @cache
    def bus_fields(cls) -> tuple[str, ...]:
        """Names of the fields that refer to a bus."""
        return tuple(name for name, item in cls.fields().items() if item.metadata["form"] == "bus")

    @classmethod
    @cache
    def weight_fields(cls) -> Mapping[str, tuple[str, ...]]:
        """Fields that hold numbers for other components, and the kinds of these."""
        forms = cls.fields().items()
        return {key: item.metadata["of"] for key, item in forms if item.metadata["form"] == "weights"}

    @classmethod
    def unlimited(cls, key: str) -> float | None:
        """Value that means "no limit" in a quantity of the arrays, ±infinity; None if it must be finite.

        Examples
        --------
        >>> from opfmodel.network import Branch, Generator, Load
        >>> Branch.unlimited("rating"), Generator.unlimited("q_min"), Load.unlimited("p")
        (inf, -inf, None)
        """
        known = cls.fields()
        if key in known and known[key].metadata["form"] == "number":
            return None if known[key].metadata["finite"] else INF
        stem, _, end = key.rpartition("_")
        default: Any = known[stem].default if end in ("min", "max") and stem in known else None
        value = float(default[end == "max"]) if isinstance(default, tuple) else 0.0
        return value if math.isinf(value) else None

    def neutral(self, key: str) -> float:
        """Return the constant in an adjustable field or, of a range, the value nearest to the default.

        Examples
        --------
        >>> from opfmodel.network import Branch
        >>> Branch("a", "b", r=0, x=0.1, tap=(1.02, 1.1)).neutral("tap")
        1.02
        """
        value, default = getattr(self, key), float(self.fields()[key].default)  # type: ignore[arg-type]
        return float(np.clip(default, *value) if is_adjustable(value) else value)

    @property
    def buses(self) -> tuple[str, ...]:
        """Names of the buses to which the component is connected."""
        return tuple(getattr(self, name) for name in self.bus_fields())

    @classmethod
    def from_mapping(cls, name: str, values: Mapping[str, Any]) -> Self:
        """Make a component from the plain values of a scenario file.

        Raises
        ------
        ComponentError
            A field is unknown, missing, or invalid (see :meth:`check_declared`).
        """
        if not set(cls.required()) <= values.keys() <= cls.fields().keys():
            raise_all(cls.errors_of_mapping(name, values))
        component = cls(**cls.converted(values))
        component.check_declared(name)
        return component

    @classmethod
    def errors_of_mapping(
        cls, name: str, values: Mapping[str, Any], wrong: Collection[str] = ()
    ) -> Iterator[ComponentError]:
        """Yield the errors of unknown and missing fields, and of each value regarded by itself.

        Parameters
        ----------
        wrong
            Fields whose values are known to be wrong.
        """
        known = cls.fields()
        unknown = [key for key in values if key not in known]
        missing = [key for key in cls.required() if key not in values]
        meant = {field for key in unknown for field in close(key, known)}
        if len(unknown) == len(missing) == 1:
            meant |= set(missing)
        for key in unknown:
            rule = f"unknown field of a {cls.kind}; {nearest(key, known)}"
            yield ComponentError(name, key, values[key], rule)
        for key in missing:
            if key not in meant:
                yield ComponentError(name, key, None, f"required for a {cls.kind}")
        checked = {key: value for key, value in cls.converted(values).items() if key not in wrong}
        in_service = values.get("in_service", True)
        yield from cls._errors(name, checked, in_service=not is_flag(in_service) or bool(in_service))

    @classmethod
    def converted(cls, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values of known fields as a component holds them: lists as tuples, costs as objects."""
        known = cls.fields()
        return {key: plain_value(known[key], value) for key, value in values.items() if key in known}


_Kind = TypeVar("_Kind", bound=Component)


@dataclass_transform(frozen_default=True)
def component(cls: type[_Kind]) -> type[_Kind]:
    """Make a class of components a frozen dataclass, and say on assignment how to change a component."""
    made = dataclass(frozen=True)(cls)

    def refuse(_: Component, key: str, value: object) -> None:
        raise ComponentError(
            cls.__name__, key, value, f"components do not change; use network.update(name, {key}=...)"
        )

    made.__setattr__ = refuse  # type: ignore[assignment,method-assign]
    return made


def plain_value(item: Field[Any], value: Any) -> Any:
    """Convert a value from a file for a field: lists to tuples, mappings to costs."""
    form = item.metadata["form"]
    if form == "cost" and isinstance(value, Mapping):
        if set(value) == {"points"} and isinstance(value["points"], Sequence):
            return PiecewiseLinear(
                tuple(tuple(p) if isinstance(p, Sequence) else (p,) for p in value["points"])
            )
        if set(value) <= {"c2", "c1", "c0"}:
            return Polynomial(**value)
    if form == "weights" and isinstance(value, Mapping):
        return {str(name): number for name, number in value.items()}
    if form == "bus" and isinstance(value, int) and not isinstance(value, bool):
        return str(value)
    listed = form in ("span", "adjustable", "points")
    if listed and isinstance(value, Sequence) and not isinstance(value, str):
        return tuple(tuple(point) if isinstance(point, list) else point for point in value)
    return value
