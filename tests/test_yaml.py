"""YAML: values of scalars, locations of values, and refused input."""

from __future__ import annotations

import math
from typing import Any

import pytest

from opfmodel.data.yaml import parse
from opfmodel.errors import ScenarioError


def read(text: str) -> Any:
    return parse(text, "file")[0]


@pytest.mark.parametrize(
    ("word", "value"),
    [
        *((word, word) for word in ("yes", "no", "on", "off", "y", "n", "Yes", "tRue", "NaN", "inf", "=", "1.2.3", "e3")),
        *((word, word) for word in ("2019-07-22", "2019-07-22T10:00:00Z", "12:30:45", "0o8", "0x", "0b", "_1", "+", "0x_")),
        *((word, True) for word in ("true", "True", "TRUE")),
        *((word, False) for word in ("false", "False", "FALSE")),
        *((word, None) for word in ("null", "Null", "NULL", "~", "")),
        *((word, 12) for word in ("12", "012", "+12", "0o14", "0b1100", "0xc", "0xC", "1_2", "12_")),
        ("-0x1F", -31), ("1_000", 1000), ("089", 89), ("-0", 0), (f"{2**63 - 1}", 2**63 - 1), (f"-{2**63}", -(2**63)),
        *((word, 1000.0) for word in ("1e3", "1E3", "1e+3", "1.e3", "1000.0", "1_000.0", "1000.", "+1e3")),
        (".5", 0.5), ("-.5e-3", -0.0005), (".5e3", 500.0), ("1e400", math.inf), ("-1e400", -math.inf),
        *((word, math.inf) for word in (".inf", "+.inf", ".Inf", ".INF")), ("-.inf", -math.inf),
        ('"12"', "12"), ("'true'", "true"), ('"a\\e"', "a\x1b"), ("|\n  x\n  y\n", "x\ny\n"), (">-\n  x\n  y\n", "x y"),
    ],
)  # fmt: skip
def test_the_core_schema(word: str, value: object) -> None:
    made = read(f"a: {word}\n")["a"]
    assert (type(made), made) == (type(value), value)


def test_not_a_number() -> None:
    assert all(math.isnan(read(f"[{word}]")[0]) for word in (".nan", ".NaN", ".NAN"))


def test_documents() -> None:
    assert read("") is None
    assert read("# nothing\n") is None
    assert read("--- 5\n...\n") == 5
    assert read("%YAML 1.2\n---\na: on\n") == {"a": "on"}
    assert read("a: {b, 'c':1, d: [x:y, http://z]}") == {"a": {"b": None, "c": 1, "d": ["x:y", "http://z"]}}


def test_keys_are_text_and_numbers_have_one_spelling() -> None:
    content = read("{1: a, 02: b, 0x3: c, true: d, 1.50: e, ~: f, on: g, 2019-07-22: h}")
    assert list(content) == ["1", "2", "3", "true", "1.50", "~", "on", "2019-07-22"]


def test_anchors_aliases_and_merge_keys() -> None:
    text = "base: &b {x: 1, y: 2}\nover: &o {y: 3, z: 4}\nc: {w: 0, <<: [*b, *o], y: 5}\nd: {<<: *o}\ne: *b\n'<<': 1\n"
    content = read(text)
    assert content["c"] == {"w": 0, "y": 5, "x": 1, "z": 4}
    assert list(content["c"]) == ["w", "y", "x", "z"]  # own keys first
    assert (content["d"], content["e"], content["<<"]) == ({"y": 3, "z": 4}, {"x": 1, "y": 2}, 1)
    assert read("a: &yes true\nb: *yes\n") == {"a": True, "b": True}
    assert read("a: &x 1\nb: &x 2\nc: *x\n*x : d")["c"] == 2


def test_every_value_has_a_location() -> None:
    text = "base: &b\n  x: 1\nlist:\n  - 5\n  - {k: v, <<: *b}\nalias: *b\nflow: [[é, 3],\n  4]\n"
    _, place = parse(text, "file")
    for key, where in (
        ((), (1, 1)),
        (("base",), (1, 1)),
        (("base", "x"), (2, 3)),
        (("list", 0), (4, 5)),
        (("list", 1, "k"), (5, 6)),
        (("list", 1, "x"), (2, 3)),  # merged
        (("alias",), (6, 1)),
        (("alias", "x"), (2, 3)),
        (("flow", 0, 1), (7, 12)),
        (("flow", 1), (8, 3)),
        (("list", 7), (3, 1)),  # missing: closest existing ancestor
        (("list", "k"), (3, 1)),
        (("none", "k"), (1, 1)),
        (("base", "x", "k", 0), (2, 3)),
    ):
        assert place.at(key)[:2] == where, key


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: 1\nb: {c: 1, c: 2}", ":2:11: .*duplicate key 'c'"),
        ("1: a\n'1': b", ":2:1: .*duplicate key '1'"),
        ("a: &a {x: 1}\nc: {<<: *a, <<: *a}", ":2:13: .*duplicate merge key"),
        ("c: {<<: 5}", ":1:9: .*the value of a merge key must be a mapping"),
        ("c: {<<: [5]}", ":1:9: .*the value of a merge key must be a mapping"),
        ("a: !t 3", ":1:4: .*the tag '!t' is not accepted"),
        ("a: !!python/object:os.system {}", ":1:4: .*the tag '!!python/object:os.system' is not"),
        ("a: !!omap [b: 1]", ":1:4: .*the tag '!!omap' is not"),
        ("a: !!set {b}", ":1:4: .*the tag '!!set' is not"),
        ("a: !!binary aGVsbG8=", ":1:4: .*the tag '!!binary' is not"),
        ("a: !!timestamp 2019-07-22", ":1:4: .*the tag '!!timestamp' is not"),
        ("!!str a: 1", ":1:1: .*the tag '!!str' is not"),
        ("? {a: b}\n: 1", ":1:3: a key must be a word or a number"),
        ("x: &x [1]\n*x : 1", ":2:1: a key must be a word or a number"),
        ("a: &x [*x]", ":1:8: .*no anchor 'x'"),
        ("a: *nope", ":1:4: .*no anchor 'nope'"),
        ("a: 1\n---\nb: 2", ":2:1: .*another document"),
        ("a: 1\n%YAML 1.2\n---\nb: 2", ":2:1: .*another document"),
        ("%YAML 1.1\n---\na: on", ":1:1: .*YAML 1.1"),
        ("%YAML 3.0\n---\na: on", ":1:1: not YAML"),
        (f"a: {2**63}", rf":1:4: a: '{2**63}': integers of more than 64 bits"),
        (f"a: -{2**63 + 1}", ":1:4: .*integers of more than 64 bits"),
        (f"a: {'9' * 5000}", ":1:4: .*integers of more than 64 bits"),
        (f"a: 0x{'f' * 5000}", ":1:4: .*integers of more than 64 bits"),
        ('"a\\e": 1', r":1:1: the key 'a\\x1b'"),
        ("a: \x1b", r":1:4: not YAML: the character '\\x1b'"),
        ("a: 1\nbc: \x00", r":2:5: not YAML: the character '\\x00'"),
        ("a: \udc80", r":1:4: not YAML: the character '\\udc80'"),
        ("a: b: c", ":1:5: not YAML"),
        ("a: 1\nb: [1, 2", ":2:4: not YAML"),
        ("a: 1\nb: 'c\n\n", ":2:4: not YAML"),
        ("a:\n  - b\n c: 1", ":3:2: not YAML"),
        (f"a: {'[' * 60}{']' * 60}", r":1:53: nested too deeply"),
        ("[" * 100_000, "not YAML|nested too deeply"),
        ("{a: " * 100_000, "not YAML|nested too deeply"),
        ("- " * 100_000, "nested too deeply"),
        ("? " * 100_000, "a key must be a word|nested too deeply"),
    ],
)  # fmt: skip
def test_invalid_input_is_refused(text: str, message: str) -> None:
    with pytest.raises(ScenarioError, match=f"file.*{message}") as caught:
        read(text)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 500


def test_the_expansion_of_aliases_is_limited() -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [" + ", ".join([f"*a{i - 1}"] * 8) + "]" for i in range(1, 10)]
    with pytest.raises(ScenarioError, match="expands to more than"):
        read("\n".join(lines))
