"""Laying variants and overrides over the content of a scenario file, as its schema directs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any, get_args

from pydantic import BaseModel

__all__ = ["Choice", "Inside", "laid", "schemas"]

Values = Mapping[str, Any]


@dataclass(frozen=True)
class Choice:
    """Mark of a field whose mapping chooses one of several things, each with keys of its own.

    Attributes
    ----------
    chosen
        What a mapping chooses; None if it leaves the choice open.
    in_full
        Mapping for which a bare name stands; None if the field has no bare names.
    common
        Keys that mean the same whatever is chosen.
    """

    chosen: Callable[[Values], object]
    in_full: Callable[[str], dict[str, Any]] | None = None
    common: tuple[str, ...] = ()

    def spelt_out(self, value: Any) -> Any:
        """Return the mapping for which a bare name stands, anything else unchanged."""
        return self.in_full(value) if self.in_full is not None and isinstance(value, str) else value

    def differs(self, below: Values, over: Values) -> bool:
        """Whether two mappings choose different things."""
        one, other = self.chosen(below), self.chosen(over)
        return one is not None and other is not None and one != other


@dataclass(frozen=True)
class Inside:
    """Mark of a field without a schema of its own, at some depth below which all mappings are choices."""

    depth: int
    choice: Choice


def laid(content: Any, overrides: Sequence[Values], schema: type[BaseModel]) -> Any:
    """Lay overrides over the content of a file, each over the ones before it.

    Mappings are merged key by key, anything else is replaced. Where a mapping chooses a plugin, one
    that chooses another replaces it, because the options of one have no meaning for the other. What
    the overrides choose together counts: options that one of them sets for the plugin that another
    chooses are kept in any order.
    """
    whole = _Field(schema)
    together: Any = reduce(whole.merged, overrides, {})
    return reduce(whole.merged, overrides, whole.cleared(content, together))


@dataclass(frozen=True)
class _Field:
    """A place in the content: the schema of its mapping, its choice, and the choices inside it."""

    schema: type[BaseModel] | None = None
    choice: Choice | None = None
    inside: Inside | None = None

    def at(self, key: str) -> _Field:
        """Return the place of a key of the mapping."""
        if self.inside is not None:
            depth = self.inside.depth - 1
            return (
                _Field(inside=replace(self.inside, depth=depth))
                if depth
                else _Field(choice=self.inside.choice)
            )
        if self.schema is None or key not in self.schema.model_fields:
            return _Field()
        field = self.schema.model_fields[key]
        marks = {type(mark): mark for mark in field.metadata}
        return _Field(next(schemas(field.annotation), None), marks.get(Choice), marks.get(Inside))

    def merged(self, below: Any, over: Any) -> Any:
        """Merge a value over another one."""
        below = self._spelt_out(below)
        if not (isinstance(below, dict) and isinstance(over, dict)):
            return over
        if self._differs(below, over):
            below = self._common(below)
        return {**below, **{key: self.at(key).merged(below.get(key), value) for key, value in over.items()}}

    def cleared(self, below: Any, over: Any) -> Any:
        """Empty every mapping of a value whose choice another value replaces."""
        below = self._spelt_out(below)
        if not (isinstance(below, dict) and isinstance(over, dict)):
            return below
        if self._differs(below, over):
            return self._common(below)
        kept = {key: self.at(key).cleared(below[key], value) for key, value in over.items() if key in below}
        return {**below, **kept}

    def _spelt_out(self, value: Any) -> Any:
        return value if self.choice is None else self.choice.spelt_out(value)

    def _common(self, values: Values) -> dict[str, Any]:
        """Return the keys that stay when a choice is replaced."""
        common = () if self.choice is None else self.choice.common
        return {key: values[key] for key in common if key in values}

    def _differs(self, below: Values, over: Values) -> bool:
        return self.choice is not None and self.choice.differs(below, over)


def schemas(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the schemas among the alternatives of an annotation."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from schemas(part)
