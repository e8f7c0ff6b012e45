"""YAML files as plain data that remembers where each value stands."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from opfmodel.data.files import read_text
from opfmodel.data.yaml import Place, parse
from opfmodel.errors import (
    ConstraintError,
    OpfmodelError,
    PluginError,
    ScenarioError,
    name_fault,
    nearest,
    shown,
)
from solvers import SolverError

__all__ = ["Document", "check_name", "check_printable", "read_document", "validated"]

Key = tuple[str | int, ...]
Model = TypeVar("Model", bound=BaseModel)

_MOST_BYTES = 20_000_000
_MOST_NAME_BYTES = 120  # a file system takes 255, and a folder may have the names of a scenario and a variant


@dataclass(frozen=True)
class Document:
    """The content of a YAML file and the position of every value in it.

    Attributes
    ----------
    content
        Dictionaries, lists, strings, numbers, booleans and None.
    """

    path: Path
    content: Any
    place: Place

    def error(self, key: Sequence[str | int], message: str) -> ScenarioError:
        """An error that names file, line, column and key; of a missing key the parent's position."""
        place = self.place.at(key)
        name = ".".join(str(part) for part in key)
        return ScenarioError(
            f"{self.path}:{place.line}:{place.column}: {name + ': ' if name else ''}{message}"
        )

    @contextmanager
    def located(self, *key: str | int) -> Iterator[None]:
        """Give errors that are raised inside the position of a key."""
        try:
            yield
        except ScenarioError:
            raise
        except (PluginError, ConstraintError) as error:
            raise self.error((*key, *error.key), str(error)) from error
        except (OpfmodelError, SolverError) as error:
            raise self.error(key, str(error)) from error

    def over(self, key: Key) -> Document:
        """The document with the positions of the mapping at ``key`` for the same keys at the root."""
        laid = self.place.at(key)._replace(line=self.place.line, column=self.place.column)
        return replace(self, place=_laid(self.place, laid))


def _laid(base: Place, over: Place) -> Place:
    """The places of two mappings, the latter's first."""
    if not (isinstance(base.inside, dict) and isinstance(over.inside, dict)):
        return over
    both = {key: _laid(base.inside[key], at) if key in base.inside else at for key, at in over.inside.items()}
    return over._replace(inside={**base.inside, **both})


def check_printable(document: Document, key: Key, name: str) -> None:
    """Raise :class:`ScenarioError` for a name with characters that cannot be seen."""
    if fault := name_fault(name):
        raise document.error(key, f"{name!r}: the name {fault}")


def check_name(document: Document, key: Key, name: str) -> None:
    """Raise :class:`ScenarioError` for a name that cannot be that of a folder of results."""
    check_printable(document, key, name)
    if not name.strip(". ") or set(name) & set("/\\\0"):
        raise document.error(
            key, f"{name!r}: is the name of a folder of results: it cannot be empty, dots, or hold / or \\"
        )
    if fault := name_fault(name):
        raise document.error(key, f"{name!r}: {fault}")
    if len(name.encode()) > _MOST_NAME_BYTES:
        raise document.error(
            key, f"{shown(name)}: is the name of a folder: it has at most {_MOST_NAME_BYTES} bytes"
        )


def read_document(path: str | Path) -> Document:
    """Read a YAML 1.2 file; tags are refused, so that nothing in it can be more than data.

    Raises
    ------
    ScenarioError
        The file cannot be opened, or is not YAML; the message names line and column.
    """
    path = Path(path)
    return Document(path, *parse(read_text(path, ScenarioError, _MOST_BYTES), str(path)))


def validated(document: Document, content: Any, model: type[Model]) -> Model:
    """The content of a document, or what became of it, checked by a schema.

    Raises
    ------
    ScenarioError
        An unknown key, a missing one, a wrong type or a value out of range; the message names
        file, line and column and what would be accepted.
    """
    try:
        return model.model_validate(content)
    except ValidationError as error:
        faults = [(_path(content, fault), fault) for fault in error.errors()]
        outer = faults[0][0]
        # of what the branches of a union complain about, the deepest tells most
        key, fault = max((f for f in faults if f[0][: len(outer)] == outer), key=lambda f: len(f[0]))
        raise document.error(key, _explained(fault, key, model)) from None


def _path(content: Any, fault: Mapping[str, Any]) -> Key:
    """Where an error stands: pydantic's location without the branches of unions that it names."""
    key: list[str | int] = []
    for part in fault["loc"]:
        inside = isinstance(content, dict) and part in content
        if inside or (isinstance(content, list) and isinstance(part, int)):
            content = content[part]
            key.append(part)
    return (*key, fault["loc"][-1]) if fault["type"] == "missing" else tuple(key)


def _explained(fault: Mapping[str, Any], key: Key, model: type[BaseModel]) -> str:
    if fault["type"] == "extra_forbidden":
        return f"unknown key; {nearest(str(key[-1]), _model_at(model, key[:-1]).model_fields)}"
    if fault["type"] == "missing":
        return "this key is missing"
    value = fault.get("input")
    given = f"{shown(value)}: " if isinstance(value, str | int | float | bool | None) else ""
    if fault["type"] in ("model_type", "dict_type"):
        keys = list(_model_at(model, key).model_fields) if fault["type"] == "model_type" else []
        return f"{given}must be a mapping" + (f" with keys of {', '.join(keys)}" if keys else "")
    if fault["type"] == "value_error":
        return f"{given}{fault['ctx']['error']}"
    return f"{given}{fault['msg'][0].lower()}{fault['msg'][1:]}"


def _model_at(model: type[BaseModel], key: Key) -> type[BaseModel]:
    """The schema of the mapping at a path of keys."""
    for part in key:
        if str(part) in model.model_fields:
            model = next(_models(model.model_fields[str(part)].annotation), model)
    return model


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    """The schemas among the alternatives of an annotation."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _models(part)
