"""Descriptions of component fields in words, for docstrings, documentation and messages."""

from __future__ import annotations

import inspect
import math
import textwrap
from collections.abc import Mapping
from dataclasses import MISSING, Field
from typing import Any

from opfmodel.network.costs import Polynomial

__all__ = ["bounds_of", "default_of", "documented", "type_of", "unit_of"]


def documented(text: str | None, fields: Mapping[str, Field[Any]]) -> str | None:
    """Return the docstring of a class with the section on its parameters, from its fields.

    A docstring that already has such a section is unchanged, and so is None, as under ``python -OO``.
    """
    if text is None or "Parameters\n" in text:
        return text
    described = [f"{name} : {_annotation(item)}\n{_indented(item)}" for name, item in fields.items()]
    section = "\n".join(["Parameters", "----------", *described])
    return f"{inspect.cleandoc(text)}\n\n{section}\n"


def type_of(item: Field[Any]) -> str:
    """Return the type of a field in one word."""
    if item.metadata["form"] == "span" and item.metadata["symmetric"]:
        return "range or number"
    form: str = item.metadata["form"]
    if form == "choice":
        return " or ".join(item.metadata["options"])
    return {
        "span": "range",
        "flag": "boolean",
        "bus": "name",
        "adjustable": "number or range",
        "weights": "numbers by name",
    }.get(form, form)


def unit_of(item: Field[Any]) -> str:
    """Return the unit of a field; empty if it has none.

    Examples
    --------
    >>> from opfmodel.network import Branch
    >>> unit_of(Branch.fields()["r"])
    'p.u.'
    """
    if "units" in item.metadata:
        return ", ".join(item.metadata["units"])
    return "p.u." if item.metadata["unit"].startswith("p.u. ") else str(item.metadata["unit"])


def default_of(item: Field[Any]) -> str:
    """Return the default of a field as it is written in a file; ``required`` if it has none."""
    value = item.default if item.default_factory is MISSING else item.default_factory()
    if value is MISSING:
        return "required"
    if isinstance(value, str):
        return value
    if value is None or isinstance(value, bool):
        return {None: "none", True: "true", False: "false"}[value]
    if isinstance(value, Mapping):
        return "{}"
    if isinstance(value, Polynomial):
        return f"{{c2: {value.c2:g}, c1: {value.c1:g}, c0: {value.c0:g}}}"
    return f"[{', '.join(map(_number, value))}]" if isinstance(value, tuple) else _number(value)


def bounds_of(rules: Mapping[str, Any]) -> str:
    """Return the bounds of a field in words; empty if it has none.

    Examples
    --------
    >>> from opfmodel.network import Branch, Bus
    >>> bounds_of(Branch.fields()["tap"].metadata), bounds_of(Bus.fields()["base_kv"].metadata)
    ('from 0.001 to 1000', 'above 0')
    """
    least, most = rules.get("at_least", -math.inf), rules.get("at_most", math.inf)
    above = rules.get("above", -math.inf)
    if math.isfinite(least) and math.isfinite(most):
        return f"from {least:g} to {most:g}"
    worded = {"at least": least, "above": above, "at most": most}
    return ", ".join(f"{word} {value:g}" for word, value in worded.items() if math.isfinite(value))


def _annotation(item: Field[Any]) -> str:
    default = default_of(item)
    parts = [type_of(item), unit_of(item), bounds_of(item.metadata)]
    parts.append(default if default == "required" else f"default {default}")
    return ", ".join(filter(None, parts))


def _indented(item: Field[Any]) -> str:
    text = item.metadata.get("description") or "Not described."
    return textwrap.fill(text, 100, initial_indent="    ", subsequent_indent="    ")


def _number(value: float) -> str:
    return f"{value:g}".replace("inf", ".inf")
