"""YAML files as plain data that remembers where each value stands."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.scalarbool import ScalarBoolean

from opfmodel.errors import ScenarioError, nearest

__all__ = ["Document", "check_name", "check_printable", "read_document", "validated"]

Key = tuple[str | int, ...]
Model = TypeVar("Model", bound=BaseModel)

_MOST_BYTES = 20_000_000
_MOST_VALUES = 2_000_000  # a few nested aliases can stand for more values than there are atoms
_TAGS = ("map", "seq", "str", "int", "float", "bool", "null", "merge")


@dataclass(frozen=True)
class Document:
    """The content of a YAML file and the position of every value in it.

    Attributes
    ----------
    content
        Dictionaries, lists, strings, numbers, booleans and None.
    positions
        Line and column, from 1, by path of keys.
    """

    path: Path
    content: Any
    positions: Mapping[Key, tuple[int, int]]

    def error(self, key: Sequence[str | int], message: str) -> ScenarioError:
        """An error that names file, line, column and key; of a missing key the parent's position."""
        known = tuple(key)
        while known and known not in self.positions:
            known = known[:-1]
        line, column = self.positions.get(known, (1, 1))
        name = _printable(".".join(str(part) for part in key))
        return ScenarioError(f"{self.path}:{line}:{column}: {name + ': ' if name else ''}{message}")

    def over(self, key: Key) -> Document:
        """The document with the positions of the mapping at ``key`` for the same keys at the root."""
        laid = {where[len(key) :]: at for where, at in self.positions.items() if where[: len(key)] == key}
        return replace(self, positions={**self.positions, **{k: at for k, at in laid.items() if k}})


def check_printable(document: Document, key: Key, name: str) -> None:
    """Raise :class:`ScenarioError` for a name with characters that a terminal would obey or not show."""
    if not name.isprintable():
        raise document.error(key, f"{name!r}: a name has printable characters alone")


def check_name(document: Document, key: Key, name: str) -> None:
    """Raise :class:`ScenarioError` for a name that cannot be that of a folder of results."""
    check_printable(document, key, name)
    if not name.strip(". ") or set(name) & set("/\\\0"):
        raise document.error(
            key, f"{name!r}: is the name of a folder of results: it cannot be empty, dots, or hold / or \\"
        )


def read_document(path: str | Path) -> Document:
    """Read a YAML 1.2 file; tags are refused, so that nothing in it can be more than data.

    Raises
    ------
    ScenarioError
        The file is missing or is not YAML; the message names line and column.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.error import MarkedYAMLError, YAMLError

    path = Path(path)
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise ScenarioError(
                f"{path}: larger than {_MOST_BYTES // 1_000_000} MB; put series into data files"
            )
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ScenarioError(f"{path}: there is no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{path}: cannot be read: {error}") from error
    yaml = YAML(typ="rt", pure=True)
    try:
        tree = yaml.load(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"{mark.line + 1}:{mark.column + 1}: " if mark is not None else " "
        raise ScenarioError(f"{path}:{where}not YAML: {error.problem or error.context}") from None
    except (YAMLError, ValueError) as error:
        raise ScenarioError(f"{path}: not YAML: {error}") from None
    except RecursionError:
        raise ScenarioError(f"{path}: nested too deeply") from None
    positions: dict[Key, tuple[int, int]] = {}
    reader = _Plain(path, positions)
    try:
        return Document(path, reader.convert(tree, ()), positions)
    except RecursionError:
        raise ScenarioError(
            f"{path}: nested too deeply; does an alias stand inside its own anchor?"
        ) from None


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
    shown = f"{value!r}: " if isinstance(value, str | int | float | bool | None) else ""
    if fault["type"] in ("model_type", "dict_type"):
        keys = list(_model_at(model, key).model_fields) if fault["type"] == "model_type" else []
        return f"{shown}must be a mapping" + (f" with keys of {', '.join(keys)}" if keys else "")
    if fault["type"] == "value_error":
        return f"{shown}{fault['ctx']['error']}"
    return f"{shown}{fault['msg'][0].lower()}{fault['msg'][1:]}"


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


def _printable(text: str) -> str:
    """A text with escapes in place of what cannot be printed."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


class _Plain:
    """Turns ruamel's objects into plain ones and notes where they stand."""

    def __init__(self, path: Path, positions: dict[Key, tuple[int, int]]) -> None:
        self.path = path
        self.positions = positions
        self.count = 0

    def convert(self, node: Any, key: Key) -> Any:
        """The plain value of a node at a path of keys."""
        self.count += 1
        if self.count > _MOST_VALUES:
            raise ScenarioError(f"{self.path}: expands to more than {_MOST_VALUES} values; too many aliases?")
        tag = getattr(getattr(node, "tag", None), "value", None)
        if tag is not None and str(tag).removeprefix("tag:yaml.org,2002:") not in _TAGS:
            line, column = self.positions.get(key, (1, 1))
            raise ScenarioError(
                f"{self.path}:{line}:{column}: the tag {tag} is not accepted; plain data only"
            )
        if isinstance(node, CommentedMap):
            return {str(k): self._child(node, k, (*key, str(k)), node.lc.key) for k in node}
        if isinstance(node, CommentedSeq):
            return [self._child(node, i, (*key, i), node.lc.item) for i in range(len(node))]
        return _scalar(node)

    def _child(self, node: Any, index: Any, key: Key, position: Any) -> Any:
        try:
            line, column = position(index)
            self.positions[key] = (line + 1, column + 1)
        except KeyError:
            pass  # came in by a merge key and stands elsewhere; the parent's position will do
        return self.convert(node[index], key)


def _scalar(node: Any) -> Any:
    """A plain Python value instead of ruamel's subclass of it."""
    if isinstance(node, ScalarBoolean):  # an int: what a truth value with an anchor is read as
        return bool(node)
    for kind in (bool, int, float, str):
        if isinstance(node, kind):
            return kind(node)
    return node
