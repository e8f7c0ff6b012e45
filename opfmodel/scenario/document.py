"""YAML files as plain data with the position of every value."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from opfmodel.data.faults import fault_message
from opfmodel.data.files import read_text
from opfmodel.data.yaml import Place, parse
from opfmodel.errors import (
    ConstraintError,
    HorizonError,
    OpfmodelError,
    PluginError,
    ScenarioError,
    name_fault,
    nearest,
    shown,
)
from opfmodel.network.quantities import Basis
from opfmodel.scenario.overlay import schemas
from solvers import SolverError

__all__ = ["Document", "check_name", "check_printable", "read_document", "validated"]

Key = tuple[str | int, ...]
Model = TypeVar("Model", bound=BaseModel)

_MOST_BYTES = 20_000_000
_MOST_NAME_BYTES = 120  # file systems allow 255, and a folder name may combine a scenario and a variant


@dataclass(frozen=True)
class Document:
    """The content of a YAML file with the position of every value.

    Attributes
    ----------
    content
        Dictionaries, lists, strings, numbers, booleans and None.
    origin
        What errors cite instead of a position in the file, such as an option of the command line.
    """

    path: Path
    content: Any
    place: Place
    origin: str | None = None

    @property
    def is_study(self) -> bool:
        """Whether the content is that of a study, not of a scenario."""
        keys = self.content if isinstance(self.content, dict) else ()
        return "vary" in keys or ("scenario" in keys and "network" not in keys)

    def error(self, key: Sequence[str | int], message: str) -> ScenarioError:
        """Return an error with file, line, column and key; a missing key has its parent's position."""
        place = self.place.at(key)
        name = ".".join(str(part) for part in key)
        where = self.origin or f"{self.path}:{place.line}:{place.column}"
        return ScenarioError(f"{where}: {name + ': ' if name else ''}{message}")

    @contextmanager
    def located(self, *key: str | int) -> Iterator[None]:
        """Add the position of a key to errors raised inside the block."""
        try:
            yield
        except ScenarioError:
            raise
        except (PluginError, ConstraintError, HorizonError) as error:
            raise self.error((*key, *error.key), str(error)) from error
        except (OpfmodelError, SolverError) as error:
            raise self.error(key, str(error)) from error

    def over(self, key: Key) -> Document:
        """Return the document with root positions overridden by those of the mapping at ``key``."""
        laid = self.place.at(key)._replace(line=self.place.line, column=self.place.column)
        return replace(self, place=_laid(self.place, laid))


def _laid(base: Place, over: Place) -> Place:
    """Merge the positions of two mappings; those of ``over`` take precedence."""
    if not (isinstance(base.inside, dict) and isinstance(over.inside, dict)):
        return over
    both = {key: _laid(base.inside[key], at) if key in base.inside else at for key, at in over.inside.items()}
    return over._replace(inside={**base.inside, **both})


def check_printable(document: Document, key: Key, name: str) -> None:
    """Raise :class:`ScenarioError` for a name with invisible characters."""
    if fault := name_fault(name):
        raise document.error(key, f"{name!r}: the name {fault}")


def check_name(document: Document, key: Key, name: str) -> None:
    """Raise :class:`ScenarioError` for a name that cannot name a results folder."""
    check_printable(document, key, name)
    if not name.strip(". ") or set(name) & set("/\\\0"):
        raise document.error(
            key,
            f"{name!r}: must not be empty, consist of dots, or contain / or \\; it names the results folder",
        )
    if len(name.encode()) > _MOST_NAME_BYTES:
        raise document.error(
            key, f"{shown(name)}: must have at most {_MOST_NAME_BYTES} bytes; it names the results folder"
        )


def read_document(path: str | Path) -> Document:
    """Read a YAML 1.2 file as plain data; tags are rejected.

    Raises
    ------
    ScenarioError
        The file cannot be opened, or is not YAML; the message gives line and column.
    """
    path = Path(path)
    return Document(path, *parse(read_text(path, ScenarioError, _MOST_BYTES), str(path)))


def validated(document: Document, content: Any, model: type[Model], basis: Basis | None = None) -> Model:
    """Validate the content of a document, with overrides applied, against a schema.

    Parameters
    ----------
    basis
        What the values of quantities with units depend on.

    Raises
    ------
    ScenarioError
        An unknown or missing key, a wrong type, or a value out of range; the message gives file,
        line, column and accepted values.
    """
    try:
        return model.model_validate(content, context=basis)
    except ValidationError as error:
        faults = [(_path(content, fault), fault) for fault in error.errors()]
        outer = faults[0][0]
        # each branch of a union reports an error; the deepest is the most specific
        key = max((path for path, _ in faults if path[: len(outer)] == outer), key=len)
        explained = _explained([fault for path, fault in faults if path == key], key, model)
        raise document.error(key, explained) from None


def _path(content: Any, fault: Mapping[str, Any]) -> Key:
    """Return the key of an error: pydantic's location without the union branches in it."""
    key: list[str | int] = []
    for part in fault["loc"]:
        inside = isinstance(content, dict) and part in content
        if inside or (isinstance(content, list) and isinstance(part, int)):
            content = content[part]
            key.append(part)
    return (*key, fault["loc"][-1]) if fault["type"] == "missing" else tuple(key)


def _explained(faults: Sequence[Mapping[str, Any]], key: Key, model: type[BaseModel]) -> str:
    """Return what is wrong with the value of a key, and what the branches of its type accept."""
    fault = faults[0]
    if fault["type"] == "extra_forbidden":
        known = _model_at(model, key[:-1]).model_fields
        parts = str(key[-1]).split(".")
        if len(parts) > 1 and parts[0] in known:
            return f"unknown key; nest it: {': {'.join(parts)}: ...{'}' * (len(parts) - 1)}"
        return f"unknown key; {nearest(str(key[-1]), known)}"
    value = fault.get("input")
    scalar = isinstance(value, str | int | float | bool | None) and fault["type"] != "missing"
    of_model = any(fault["type"] == "model_type" for fault in faults)
    keys = ", ".join(_model_at(model, key).model_fields) if of_model else ""
    first, *others = dict.fromkeys(map(fault_message, faults))
    message = " or ".join([first, *(other.removeprefix("must be ") for other in others)])
    return (f"{shown(value)}: " if scalar else "") + message + (f"; accepted keys are {keys}" if keys else "")


def _model_at(model: type[BaseModel], key: Key) -> type[BaseModel]:
    """Return the schema of the mapping at a path of keys."""
    for part in key:
        if str(part) in model.model_fields:
            model = next(schemas(model.model_fields[str(part)].annotation), model)
    return model
