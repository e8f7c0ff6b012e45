"""The rules of a plugin's options: what a scenario file can say."""

from __future__ import annotations

import inspect
import json
import re
from typing import Any, get_type_hints

from opfmodel.objectives.setpoint_tracking import Setpoints
from solvers.testing import Contract

__all__ = ["check_documentation", "check_options"]

_SPELT = (Setpoints,)  # scenario files have words of their own for these


def check_documentation(rules: Contract, cls: type[Any]) -> None:
    """The class has a first line of documentation of its own, which ``opfmodel list`` shows."""
    first = (cls.__doc__ or "").strip().partition("\n")[0]
    rules.require(first.endswith("."), "is documented by a first line that is a sentence", repr(first))


def check_options(rules: Contract, cls: type[Any]) -> None:
    """Every option is a documented keyword with a type that plain data can have, and a plain default."""
    from pydantic import TypeAdapter

    check_documentation(rules, cls)
    with rules.rule("annotates its options with types that can be resolved"):
        hints = get_type_hints(cls.__init__)
    documentation = inspect.getdoc(cls) or ""
    for name, option in inspect.signature(cls).parameters.items():
        named = option.kind in (option.POSITIONAL_OR_KEYWORD, option.KEYWORD_ONLY)
        rules.require(named, "names its options one by one", f"*{name}")
        rules.require(name in hints, "annotates its options with types that can be resolved", name)
        with rules.rule("takes options that a file can have"):
            if hints[name] not in _SPELT:
                TypeAdapter(hints[name]).json_schema()
            json.dumps(None if option.default is option.empty else option.default)
        described = re.search(rf"^([\w, ]*\W)?{name}(\W[\w, ]*)?$\n    ", documentation, flags=re.MULTILINE)
        rules.require(described, "documents its options under Parameters", name)
