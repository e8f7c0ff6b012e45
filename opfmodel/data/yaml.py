"""YAML 1.2 parser that returns plain data together with the location of each value.

Data are built from the events of libyaml, a C library that reads a million values in two seconds. The
composer and constructors of PyYAML are not used because they implement YAML 1.1 and construct objects.
Plain scalars follow the core schema of YAML 1.2 (``yes``, ``on`` and dates are strings, ``012`` is
twelve), extended by underscores in numbers and the merge key ``<<``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple, NoReturn

import yaml

from opfmodel.data.collection import Faults
from opfmodel.data.source import Source
from opfmodel.data.syntax import syntax_fault
from opfmodel.errors import Fault, ScenarioError, name_fault, nearest, shown

__all__ = ["MOST_LEVELS", "Place", "parse"]

_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # without libyaml, PyYAML is slow but correct
MOST_LEVELS = 50
_MOST_VALUES = 2_000_000  # a few nested aliases can expand to astronomically many values
_MOST_DIGITS = 100
_WORDS: dict[str, Any] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **{sign + word: math.inf for sign in ("", "+") for word in (".inf", ".Inf", ".INF")},
    **dict.fromkeys(("-.inf", "-.Inf", "-.INF"), -math.inf),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), math.nan),
}
_INTEGER = re.compile(
    r"[-+]?(?:(0b_*[01][01_]*)|(0o_*[0-7][0-7_]*)|(0x_*[0-9a-fA-F][0-9a-fA-F_]*)|[0-9][0-9_]*)"
)
_FLOAT = re.compile(r"[-+]?(?:[0-9][0-9_]*\.[0-9_]*|\.[0-9][0-9_]*|[0-9][0-9_]*(?=[eE]))(?:[eE][-+]?[0-9]+)?")
_BASES = {None: 10, 1: 2, 2: 8, 3: 16}  # by the group that matched
_UNPRINTABLE = re.compile("[^\t\n\r\x20-\x7e\x85\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


class Place(NamedTuple):
    """Location of a value or its key in a text, with the locations of nested values.

    Attributes
    ----------
    line, column
        Numbered from 1.
    source
        The text. Values laid over those of a file come from another text.
    """

    line: int
    column: int
    source: Source
    inside: Mapping[str, Place] | Sequence[Place] = ()

    def at(self, key: Sequence[str | int]) -> Place:
        """Location of a nested value, or of its closest existing ancestor."""
        place = self
        for part in key:
            inside: Any = place.inside
            known = part in inside if isinstance(inside, dict) else part in range(len(inside))
            if not known:
                break
            place = inside[part]
        return place

    def fault(self, key: Sequence[str | int], message: str, cause: Exception | None = None) -> Fault:
        """Return a fault in a nested value."""
        place = self.at(key)
        return place.source.fault(place.line, place.column, message, key, cause)

    def over(self, base: Place) -> Place:
        """Merge the locations of two mappings, where those of this one take precedence."""
        if not (isinstance(base.inside, dict) and isinstance(self.inside, dict)):
            return self
        merged = {
            key: place.over(base.inside[key]) if key in base.inside else place
            for key, place in self.inside.items()
        }
        return self._replace(inside={**base.inside, **merged})

    def laid(self, key: Sequence[str], place: Place) -> Place:
        """Lay the location of a value over that of the same key; a missing parent is at the value."""
        if not key:
            return place.over(self)
        inside = self.inside if isinstance(self.inside, dict) else {}
        below = inside.get(key[0], place._replace(inside={}))
        return self._replace(inside={**inside, key[0]: below.laid(key[1:], place)})


def parse(text: str, source: Source | str, faults: Faults | None = None) -> tuple[Any, Place]:
    """Parse YAML into dictionaries, lists, strings, numbers, Booleans and None, with their locations.

    Parameters
    ----------
    source
        The text as cited by errors, or the name of its file.
    faults
        Collector of faults that do not make the rest unreadable, such as a duplicate key. Without it, all
        faults are raised.

    Raises
    ------
    ScenarioError
        The text is not YAML 1.2, or contains a duplicate key, a key that is not a scalar, a tag, an
        integer of more than 64 bits, more than fifty levels or more than two million values. The message
        gives line and column.
    """
    if isinstance(source, str):
        source = Source(source, text)
    found = Faults() if faults is None else faults
    try:
        content, inside = _Reader(text, source, found).document()
    except yaml.MarkedYAMLError as error:
        raise _first(found, syntax_fault(error, source)) from None
    except (yaml.YAMLError, UnicodeEncodeError):
        raise _first(found, _unprintable(text, source)) from None
    except ScenarioError as error:
        raise _first(found, *error.faults) from None
    if faults is None:
        found.settle()
    return content, Place(1, 1, source, inside)


def _first(found: Faults, *fatal: Fault) -> ScenarioError:
    """Return the error of a text that cannot be read to its end, after the faults before."""
    return ScenarioError(*found, *(fault for fault in fatal if fault not in found))


def _unprintable(text: str, source: Source) -> Fault:
    found = _UNPRINTABLE.search(text)
    if found is None:
        return Fault("not YAML", source.name)
    line, column = text.count("\n", 0, found.start()), found.start() - text.rfind("\n", 0, found.start())
    return source.fault(line + 1, column, f"not YAML: the character {found[0]!a}")


class _Node(NamedTuple):
    """A value, the locations inside it, and the number of values it contains."""

    value: Any
    inside: Any
    size: int


class _Reader:
    """Build plain data from parser events."""

    def __init__(self, text: str, source: Source, faults: Faults) -> None:
        self.source = source
        self.faults = faults
        self.path: list[str | int] = []
        self.events: Iterator[Any] = yaml.parse(text, Loader=_LOADER)
        self.anchors: dict[str, _Node] = {}
        self.count = 0

    def document(self) -> tuple[Any, Any]:
        """Value of the only document, None if there is none, and the locations inside it."""
        next(self.events)
        begin = next(self.events)
        if isinstance(begin, yaml.StreamEndEvent):
            return None, ()
        if begin.version not in (None, (1, 2)):
            number = ".".join(map(str, begin.version))
            self.refuse(begin, f"the document is YAML {number}; must be YAML 1.2")
        node = self.node(next(self.events), 0)
        next(self.events)
        after = next(self.events)
        if isinstance(after, yaml.DocumentStartEvent):
            self.refuse(after, "not YAML: found another document; only one is accepted")
        return node.value, node.inside

    def refuse(self, event: Any, message: str) -> NoReturn:
        """Raise an error at the position of an event."""
        raise ScenarioError(self.fault(event, message, ()))

    def record(self, event: Any, message: str) -> None:
        """Record a fault at the position of an event, behind which reading can go on."""
        self.faults.add(self.fault(event, message, self.path))

    def fault(self, event: Any, message: str, key: Sequence[str | int]) -> Fault:
        """Fault at the position of an event."""
        mark = event.start_mark
        return self.source.fault(mark.line + 1, mark.column + 1, message, key)

    def place(self, event: Any, inside: Any) -> Place:
        """Location of an event."""
        return Place(event.start_mark.line + 1, event.start_mark.column + 1, self.source, inside)

    def node(self, event: Any, level: int) -> _Node:
        """Value that begins with an event."""
        if isinstance(event, yaml.AliasEvent):
            return self.anchored(event)
        self.check_tag(event)
        if isinstance(event, yaml.ScalarEvent):
            self.add(event, 1)
            node = _Node(self.scalar(event), (), 1)
        elif level >= MOST_LEVELS:
            self.refuse(event, f"nested too deeply; at most {MOST_LEVELS} levels are accepted")
        else:
            self.add(event, 1)
            before = self.count
            sequence = isinstance(event, yaml.SequenceStartEvent)
            value, inside = self.sequence(level + 1) if sequence else self.mapping(level + 1)
            node = _Node(value, inside, 1 + self.count - before)
        if event.anchor is not None:
            self.anchors[event.anchor] = node
        return node

    def check_tag(self, event: Any) -> None:
        """Refuse tags, which could construct objects."""
        if event.tag is not None:
            tag = event.tag.replace("tag:yaml.org,2002:", "!!", 1)
            self.record(event, f"the tag {shown(tag)} is not accepted; use plain data")

    def add(self, event: Any, size: int) -> None:
        """Count values, and refuse too many."""
        self.count += size
        if self.count > _MOST_VALUES:
            self.refuse(event, f"expands to more than {_MOST_VALUES:,} values; use fewer values or aliases")

    def anchored(self, event: Any) -> _Node:
        """Value that an alias refers to."""
        if event.anchor not in self.anchors:
            near = nearest(event.anchor, self.anchors)
            self.record(event, f"no anchor {event.anchor!r} is complete before this alias; {near}")
            return _Node(None, (), 1)
        node = self.anchors[event.anchor]
        self.add(event, node.size)
        return node

    def sequence(self, level: int) -> tuple[list[Any], list[Place]]:
        """Values and locations up to the end of a sequence."""
        values: list[Any] = []
        places: list[Place] = []
        while not isinstance(event := next(self.events), yaml.SequenceEndEvent):
            self.path.append(len(values))
            node = self.node(event, level)
            self.path.pop()
            values.append(node.value)
            places.append(self.place(event, node.inside))
        return values, places

    def mapping(self, level: int) -> tuple[dict[str, Any], dict[str, Place]]:
        """Keys and values up to the end of a mapping; its own keys precede merged keys."""
        values: dict[str, Any] = {}
        places: dict[str, Place] = {}
        merged: list[_Node] | None = None
        while not isinstance(event := next(self.events), yaml.MappingEndEvent):
            if isinstance(event, yaml.ScalarEvent) and event.value == "<<" and event.implicit[0]:
                if merged is not None:
                    self.record(event, "not YAML: found duplicate merge key '<<'")
                merged = [*(merged or ()), *self.merged(level)]
                continue
            key = self.key(event)
            self.path.append(key)
            if key in values:
                first = f"line {places[key].line}"
                self.record(event, f"not YAML: found duplicate key {shown(key)}; the first is in {first}")
            node = self.node(next(self.events), level)
            self.path.pop()
            if key not in values:
                values[key] = node.value
                places[key] = self.place(event, node.inside)
        for node in merged or ():
            values = {**values, **{k: v for k, v in node.value.items() if k not in values}}
            places = {**places, **{k: v for k, v in node.inside.items() if k not in places}}
        return values, places

    def merged(self, level: int) -> list[_Node]:
        """Mappings referenced by a merge key: one, or a sequence in order of precedence."""
        event = next(self.events)
        node = self.node(event, level)
        nodes = [node]
        if isinstance(node.value, list):
            nodes = [_Node(v, at.inside, 1) for v, at in zip(node.value, node.inside, strict=True)]
        if not all(isinstance(each.value, dict) for each in nodes):
            self.record(event, "the value of a merge key must be a mapping or a list of mappings")
            return []
        return nodes

    def key(self, event: Any) -> str:
        """Key as a string; integers are normalized, so ``1`` and ``01`` are the same name."""
        if isinstance(event, yaml.AliasEvent):
            value = self.anchored(event).value
            text = str(value)
        elif isinstance(event, yaml.ScalarEvent):
            self.check_tag(event)
            value = self.scalar(event)
            text = str(value) if type(value) is int else event.value
            if event.anchor is not None:
                self.anchors[event.anchor] = _Node(value, (), 1)
        else:
            value = {}
            text = ""
        if isinstance(value, dict | list):
            self.refuse(event, "a key must be a word or a number, not a mapping or a list")
        if fault := name_fault(text):
            self.record(event, f"the key {shown(text)} {fault}")
        return text

    def scalar(self, event: Any) -> Any:
        """Value of a scalar: a string if quoted, otherwise resolved by the core schema."""
        text: str = event.value
        if not event.implicit[0]:
            return text
        if text in _WORDS:
            return _WORDS[text]
        if text[0] not in "+-.0123456789":
            return text
        if match := _INTEGER.fullmatch(text):
            digits = text.replace("_", "")
            number = int(digits, _BASES[match.lastindex]) if len(digits) <= _MOST_DIGITS else None
            if number is None or not -(2**63) <= number < 2**63:
                self.record(event, f"{shown(text)}: integers of more than 64 bits are not accepted")
                return 0
            return number
        return float(text.replace("_", "")) if _FLOAT.fullmatch(text) else text
