"""Mutations of files: pure functions of the content and of a random generator.

A :class:`Mutation` names an operator, the file and a seed, so a list of them can be repeated and shortened.
An operator returns the content unchanged where it does not apply.
"""

from __future__ import annotations

import json
import random
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from opfmodel.data.yaml import parse
from opfmodel.errors import OpfmodelError
from opfmodel.study.sealed import sealed

from . import containers
from .values import JSON_VALUES, KEYS, TEXTS, VALUES, WORDS

__all__ = ["FAMILIES", "OPERATORS", "Content", "Mutation", "Special", "draw", "mutated"]


class Special(StrEnum):
    """What may stand in the place of a file."""

    FOLDER = "folder"
    PIPE = "pipe"
    LOOP = "a symbolic link to itself"
    DEVICE = "a symbolic link to /dev/zero"
    NONE = "nothing"


Content = bytes | Special
Operator = Callable[[random.Random, bytes], Content]
_MOST_BYTES = 5_000_000


@dataclass(frozen=True)
class Mutation:
    """One change of one file."""

    file: str
    operator: str
    seed: int


def mutated(files: Mapping[str, bytes], mutations: Sequence[Mutation]) -> dict[str, Content]:
    """Apply mutations in order."""
    changed: dict[str, Content] = dict(files)
    for mutation in mutations:
        content = changed[mutation.file]
        if isinstance(content, bytes):
            result = OPERATORS[mutation.operator](random.Random(mutation.seed), content)
            changed[mutation.file] = result if isinstance(result, Special) else result[:_MOST_BYTES]
    return changed


def draw(rng: random.Random, targets: Mapping[str, Sequence[str]]) -> list[Mutation]:
    """Draw one to four mutations of the target files from the families of operators given for each.

    Mutations of the structure come first, as they need a content that can be parsed.
    """
    drawn = []
    for _ in range(rng.choice((1, 1, 1, 1, 2, 3))):
        file = rng.choice(list(targets))
        operator = rng.choice(FAMILIES[rng.choice(targets[file])])
        drawn.append(Mutation(file, operator, rng.getrandbits(32)))
    order = list(OPERATORS)
    return sorted(drawn, key=lambda mutation: order.index(mutation.operator))


# Structure: nested data -------------------------------------------------------------------------


def _places(content: Any) -> Iterator[tuple[Any, Any]]:
    """Yield every container in nested data with each of its keys."""
    for key, value in list(content.items() if isinstance(content, dict) else enumerate(content)):
        yield content, key
        if isinstance(value, dict | list):
            yield from _places(value)


def _changed_value(rng: random.Random, content: Any, values: Sequence[str]) -> None:
    """Replace one or two values, by an odd one or by another value of the same content."""
    for _ in range(rng.choice((1, 1, 1, 2))):
        parent, key = rng.choice(list(_places(content)))
        other, there = rng.choice(list(_places(content)))
        parent[key] = rng.choice((deepcopy(other[there]), f"@{rng.randrange(len(values))}@"))


def _changed_key(rng: random.Random, content: Any, values: Sequence[str]) -> None:
    """Rename, remove, add or move a key."""
    mappings = [place for place in _places(content) if isinstance(place[0], dict)]
    if not mappings:
        return
    parent, key = rng.choice(mappings)
    known = [key for _, key in mappings]
    sort, value = rng.choice(("rename", "remove", "add", "move")), deepcopy(parent[key])
    if sort == "add":
        parent[rng.choice((*KEYS, *known))] = rng.choice((value, f"@{rng.randrange(len(values))}@"))
    elif sort == "rename":
        renamed = {rng.choice((*KEYS, *known)) if k == key else k: v for k, v in parent.items()}
        parent.clear()
        parent.update(renamed)
    else:
        del parent[key]
    if sort == "move":
        rng.choice([content, *(place for place, _ in mappings)])[key] = value


Change = Callable[[random.Random, Any, Sequence[str]], None]


def _dumped(content: Any, values: Sequence[str]) -> str:
    """Return the content as JSON, which is YAML, with placeholders replaced by odd values."""
    text = json.dumps(content, ensure_ascii=False)
    return re.sub(r'"@(\d+)@"', lambda found: values[int(found[1]) % len(values)], text)


def _in_yaml(change: Change) -> Operator:
    def operator(rng: random.Random, content: bytes) -> bytes:
        try:
            data, _ = parse(_text(content), "")
        except OpfmodelError:
            return content
        if not isinstance(data, dict) or not data:
            return content
        change(rng, data, VALUES)
        return _bytes(_dumped(data, VALUES))

    return operator


def _loaded(text: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return None


def _in_json(change: Change) -> Operator:
    def operator(rng: random.Random, content: bytes) -> bytes:
        data = _loaded(_text(content))
        if not isinstance(data, dict | list) or not data:
            return content
        change(rng, data, JSON_VALUES)
        return _bytes(_dumped(data, JSON_VALUES))

    return operator


def _in_nested_json(change: Change) -> Operator:
    """Change JSON within a text of a JSON file, as the tables of pandapower are."""

    def operator(rng: random.Random, content: bytes) -> bytes:
        data = _loaded(_text(content))
        if not isinstance(data, dict):
            return content
        texts = [
            (parent, key)
            for parent, key in _places(data)
            if isinstance(parent[key], str) and parent[key][:1] in ("{", "[") and _loaded(parent[key])
        ]
        if not texts:
            return content
        parent, key = rng.choice(texts)
        inside = _loaded(parent[key])
        change(rng, inside, JSON_VALUES)
        parent[key] = _dumped(inside, JSON_VALUES)
        return json.dumps(data).encode()

    return operator


def _sealed_again(change: Change) -> Operator:
    """Change a sealed file of a study and seal it again, so that its content is read."""

    def operator(rng: random.Random, content: bytes) -> bytes:
        data = _loaded(_text(content))
        if not isinstance(data, dict) or "checksum" not in data:
            return content
        del data["checksum"]
        change(rng, data, JSON_VALUES)
        data = _loaded(_dumped(data, JSON_VALUES))
        if not isinstance(data, dict):
            return content
        return sealed(data).encode("utf-8", "replace")

    return operator


# Text -------------------------------------------------------------------------------------------


def _text(content: bytes) -> str:
    return content.decode("utf-8", "surrogateescape")


def _bytes(text: str) -> bytes:
    return text.encode("utf-8", "surrogatepass" if re.search("[\ud800-\udc7f]", text) else "surrogateescape")


_WORD = re.compile(r"[^\s,;|=:(){}\[\]]+")


def _changed_word(rng: random.Random, content: bytes) -> bytes:
    """Replace a word by an odd one or by another word of the file."""
    text = _text(content)
    words = list(_WORD.finditer(text))
    if not words:
        return content
    old, other = rng.choice(words), rng.choice(words)
    return _bytes(text[: old.start()] + rng.choice((rng.choice(WORDS), other[0])) + text[old.end() :])


def _changed_text(rng: random.Random, content: bytes) -> bytes:
    """Delete characters, or insert odd ones."""
    text = _text(content)
    at = rng.randrange(len(text) + 1)
    if rng.random() < 0.3:
        return _bytes(text[:at] + text[at + rng.choice((1, 1, 5, 40)) :])
    odd = rng.choice((*TEXTS, rng.choice(VALUES)))
    return (
        text[:at].encode("utf-8", "surrogateescape")
        + odd.encode("utf-8", "surrogatepass")
        + text[at + rng.choice((0, 1)) :].encode("utf-8", "surrogateescape")
    )


def _changed_column(rng: random.Random, content: bytes) -> bytes:
    """Drop, duplicate, blank or swap columns of a table, in all rows."""
    rows = [line.split(b",") for line in content.split(b"\n")]
    width = len(rows[0])
    one, other, sort = rng.randrange(width), rng.randrange(width), rng.randrange(4)
    for row in rows:
        if len(row) != width:
            continue
        if sort == 0:
            del row[one]
        elif sort == 1:
            row.insert(other, row[one])
        elif sort == 2:
            row[one], row[other] = row[other], row[one]
        elif row is not rows[0]:
            row[one] = b""
    return b"\n".join(b",".join(row) for row in rows)


def _lines(sort: str) -> Operator:
    def operator(rng: random.Random, content: bytes) -> bytes:
        lines = content.splitlines(keepends=True)
        if not lines:
            return content
        one, other = rng.randrange(len(lines)), rng.randrange(len(lines))
        if sort == "swap":
            lines[one], lines[other] = lines[other], lines[one]
        elif sort == "drop":
            del lines[one : one + rng.choice((1, 1, 5))]
        elif sort == "duplicate":
            lines.insert(one, lines[other])
        else:
            lines[one] = rng.choice((b" ", b"  ", b"\t", b"   ")) + lines[one]
        return b"".join(lines)

    return operator


# Bytes ------------------------------------------------------------------------------------------


def _flip(rng: random.Random, content: bytes) -> bytes:
    if not content:
        return content
    changed = bytearray(content)
    for _ in range(rng.choice((1, 1, 4, 32))):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _insert(rng: random.Random, content: bytes) -> bytes:
    at = rng.randrange(len(content) + 1)
    odd = rng.choice((rng.randbytes(rng.choice((1, 4, 100))), b"\xff" * 8, bytes(8)))
    return content[:at] + odd + content[at + rng.choice((0, len(odd))) :]


def _delete(rng: random.Random, content: bytes) -> bytes:
    at = rng.randrange(len(content) + 1)
    return content[:at] + content[at + rng.choice((1, 8, 500)) :]


def _truncate(rng: random.Random, content: bytes) -> bytes:
    return content[: rng.randrange(len(content) + 1)]


def _splice(rng: random.Random, content: bytes) -> bytes:
    at, start = rng.randrange(len(content) + 1), rng.randrange(len(content) + 1)
    return content[:at] + content[start : start + rng.choice((4, 64, 2000))] + content[at:]


def _repeat(rng: random.Random, content: bytes) -> bytes:
    at = rng.randrange(len(content) + 1)
    part = content[at : at + rng.choice((1, 10, 1000))]
    return content[:at] + part * rng.choice((2, 10, 1000)) + content[at:]


# Whole files ------------------------------------------------------------------------------------


def _replaced(by: Callable[[bytes], Content]) -> Operator:
    return lambda _, content: by(content)


def _utf16(content: bytes) -> bytes:
    return content.decode("utf-8", "replace").encode("utf-16")


OPERATORS: dict[str, Operator] = {
    **containers.OPERATORS,
    "sealed value": _sealed_again(_changed_value),
    "sealed key": _sealed_again(_changed_key),
    "nested value": _in_nested_json(_changed_value),
    "nested key": _in_nested_json(_changed_key),
    "json value": _in_json(_changed_value),
    "json key": _in_json(_changed_key),
    "yaml value": _in_yaml(_changed_value),
    "yaml key": _in_yaml(_changed_key),
    "column": _changed_column,
    "word": _changed_word,
    "text": _changed_text,
    "swap lines": _lines("swap"),
    "drop lines": _lines("drop"),
    "duplicate lines": _lines("duplicate"),
    "indent": _lines("indent"),
    "flip": _flip,
    "insert": _insert,
    "delete": _delete,
    "truncate": _truncate,
    "splice": _splice,
    "repeat": _repeat,
    "empty": _replaced(lambda _: b""),
    "byte-order mark": _replaced(lambda content: b"\xef\xbb\xbf" + content),
    "carriage returns": _replaced(lambda content: content.replace(b"\n", b"\r")),
    "utf-16": _replaced(_utf16),
    "gzip": _replaced(containers.compressed),
    **{f"{special.name.lower()}": _replaced(lambda _, special=special: special) for special in Special},
}

FAMILIES: Mapping[str, Sequence[str]] = {
    "bytes": ("flip", "insert", "delete", "truncate", "splice", "repeat"),
    "lines": ("swap lines", "drop lines", "duplicate lines", "indent"),
    "words": ("word", "word", "text"),
    "columns": ("column",),
    "yaml": ("yaml value", "yaml value", "yaml key"),
    "json": ("json value", "json key"),
    "nested": ("nested value", "nested key"),
    "sealed": ("sealed value", "sealed key"),
    **containers.FAMILIES,
    "file": (
        *("empty", "byte-order mark", "carriage returns", "utf-16", "gzip"),
        *(special.name.lower() for special in Special),
    ),
}
