"""YAML files as plain data with the position of every value."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from opfmodel.data.collection import Faults
from opfmodel.data.faults import fault_message
from opfmodel.data.files import read_text
from opfmodel.data.source import Source
from opfmodel.data.syntax import SPACELESS
from opfmodel.data.yaml import Place, parse
from opfmodel.errors import (
    CaseWarning,
    Fault,
    OpfmodelError,
    ProfileWarning,
    ScenarioError,
    close,
    name_fault,
    nearest,
    shown,
)
from opfmodel.network.quantities import Basis
from opfmodel.scenario.overlay import schemas
from solvers import SolverError

__all__ = ["Document", "Key", "check_name", "check_printable", "colon_hint", "read_document", "validated"]

Key = tuple[str | int, ...]
Model = TypeVar("Model", bound=BaseModel)

_MOST_BYTES = 20_000_000
_MOST_ROUNDS = 100  # of validation; of a list, each round finds one invalid item
_MOST_NAME_BYTES = 120  # file systems allow 255, and a folder name may combine a scenario and a variant


@dataclass(frozen=True)
class Document:
    """The content of a YAML file with the position of every value.

    Attributes
    ----------
    content
        Dictionaries, lists, strings, numbers, booleans and None.
    faults
        Faults found so far, at first those of the YAML that leave the rest readable, such as a duplicate
        key. A part that does not depend on others is read in a block ``with document.faults:``.
    """

    path: Path
    content: Any
    place: Place
    faults: Faults = field(default_factory=Faults, compare=False)

    @property
    def is_study(self) -> bool:
        """Whether the content is that of a study, not of a scenario."""
        keys = self.content if isinstance(self.content, dict) else ()
        return "vary" in keys or ("scenario" in keys and "network" not in keys)

    def fault(self, key: Sequence[str | int], message: str, cause: Exception | None = None) -> Fault:
        """Return a fault with file, line, column and key; a missing key has its parent's position."""
        return self.place.fault(key, message, cause)

    def error(self, key: Sequence[str | int], message: str, cause: Exception | None = None) -> ScenarioError:
        """Return an error of one :meth:`fault`."""
        return ScenarioError(self.fault(key, message, cause))

    @contextmanager
    def located(self, *key: str | int) -> Iterator[None]:
        """Add the position of a key to errors raised inside the block."""
        try:
            yield
        except ScenarioError:
            raise
        except (OpfmodelError, SolverError) as error:
            each = (error, *error.others) if isinstance(error, OpfmodelError) else (error,)
            raise ScenarioError(
                *(self.fault((*key, *getattr(e, "key", ())), str(e), e) for e in each)
            ) from error

    @contextmanager
    def warned(self, *key: str | int) -> Iterator[None]:
        """Add the position of a key to warnings of opfmodel issued inside the block."""
        with warnings.catch_warnings():
            shown = warnings.showwarning

            def show(message: Warning | str, category: type[Warning], *rest: Any, **more: Any) -> None:
                if issubclass(category, CaseWarning | ProfileWarning):
                    message = category(str(self.fault(key, str(message))))
                shown(message, category, *rest, **more)

            warnings.showwarning = show
            yield

    def collecting(self) -> Document:
        """Return the document with a collector of its own, for one reading."""
        return replace(self, faults=Faults(self.faults))

    def over(self, key: Key) -> Document:
        """Return the document with root positions overridden by those of the mapping at ``key``."""
        laid = self.place.at(key)._replace(line=self.place.line, column=self.place.column)
        return replace(self, place=laid.over(self.place))

    def laid(self, places: Mapping[str, Place]) -> Document:
        """Return the document with the positions of dotted keys replaced."""
        place = self.place
        for key, over in places.items():
            place = place.laid(key.split("."), over)
        return replace(self, place=place)


def check_printable(document: Document, key: Key, name: str) -> None:
    """Raise :class:`ScenarioError` for a name with invisible characters."""
    fault = name_fault(name)
    if fault and not document.faults.broken(*key):
        raise document.error(key, f"{name!r}: the name {fault}")


def check_name(document: Document, key: Key, name: str) -> None:
    """Collect the fault of a name that cannot name a results folder."""
    with document.faults:
        _check_name(document, key, name)


def _check_name(document: Document, key: Key, name: str) -> None:
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
    path, faults = Path(path), Faults()
    text = read_text(path, ScenarioError, _MOST_BYTES)
    content, place = parse(text, Source(str(path), text), faults)
    return Document(path, content, place, faults)


def validated(document: Document, content: Any, model: type[Model], basis: Basis | None = None) -> Model:
    """Validate the content of a document, with overrides applied, against a schema.

    Faults are collected; what is invalid has its default in the result.

    Parameters
    ----------
    basis
        What the values of quantities with units depend on.

    Raises
    ------
    ScenarioError
        So much is invalid that there is no result.
    """
    faults = document.faults
    for _ in range(_MOST_ROUNDS):
        try:
            return model.model_validate(content, context=basis)
        except ValidationError as error:
            entries = [(_path(content, fault), fault) for fault in error.errors()]
        found = sorted(_separated(entries), key=lambda entry: entry[1][0]["type"] == "missing")
        for key, of_branches in found:
            sort = of_branches[0]["type"]
            if not faults.broken(*key):
                faults.add(document.fault(key, _explained(of_branches, key, model)))
            if not key:  # nothing is left without it
                raise faults.error()
            if sort == "extra_forbidden":  # what it stands for is not missing, and its default is not meant
                for meant in close(str(key[-1]), _model_at(model, key[:-1]).model_fields):
                    faults.spoil(*key[:-1], meant)
            content = _without(content, key, sort == "missing")
    raise faults.error()


def _separated(
    entries: Sequence[tuple[Key, Mapping[str, Any]]],
) -> Iterator[tuple[Key, list[Mapping[str, Any]]]]:
    """Group what the schema reports by the value that is wrong.

    Each branch of a union reports an error; the deepest is the most specific.
    """
    by_key: dict[Key, list[Mapping[str, Any]]] = {}
    for key, fault in entries:
        by_key.setdefault(key, []).append(fault)
    inside: dict[Key, list[Key]] = {}
    for key in by_key:
        outer = next(key[:length] for length in range(len(key) + 1) if key[:length] in by_key)
        inside.setdefault(outer, []).append(key)
    for keys in inside.values():
        depth = max(map(len, keys))
        yield from ((key, by_key[key]) for key in keys if len(key) == depth)


def _without(content: Any, key: Key, missing: bool) -> Any:
    """Return content without an invalid value; an item of a list, and what is required, become empty."""
    if missing and len(key) > 1:
        return _without(content, key[:-1], False)
    head, *rest = key
    if not missing and isinstance(content, dict) and head not in content:
        return content
    copied = content.copy()
    if rest:
        copied[head] = _without(content[head], tuple(rest), False)
    elif missing or isinstance(content, list):
        copied[head] = {}
    else:
        del copied[head]
    return copied


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
    # a branch of the type that the value has says more than those of other types
    faults = [fault for fault in faults if not fault["type"].endswith("_type")] or faults
    fault, value = faults[0], faults[0].get("input")
    scalar = isinstance(value, str | int | float | bool | None) and fault["type"] != "missing"
    of_model = any(fault["type"] == "model_type" for fault in faults)
    keys = ", ".join(_model_at(model, key).model_fields) if of_model else ""
    first, *others = dict.fromkeys(map(fault_message, faults))
    message = " or ".join([first, *(other.removeprefix("must be ") for other in others)])
    of_mapping = of_model or any(fault["type"] in ("dict_type", "mapping_type") for fault in faults)
    hint = colon_hint(value) if of_mapping else ""
    return (
        (f"{shown(value)}: " if scalar else "")
        + message
        + (hint or (f"; accepted keys are {keys}" if keys else ""))
    )


def colon_hint(value: object) -> str:
    """Return the end of a message about text that suspects a missing space after a colon.

    Examples
    --------
    >>> colon_hint("horizon:48"), colon_hint("horizon")
    ("; a space is missing after the colon in 'horizon:48'", '')
    """
    match = SPACELESS.fullmatch(value) if isinstance(value, str) else None
    return f"; a space is missing after the colon in {shown(value)}" if match else ""


def _model_at(model: type[BaseModel], key: Key) -> type[BaseModel]:
    """Return the schema of the mapping at a path of keys."""
    for part in key:
        if str(part) in model.model_fields:
            model = next(schemas(model.model_fields[str(part)].annotation), model)
    return model
