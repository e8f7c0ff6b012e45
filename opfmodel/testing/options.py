"""Rules for the options of plugins, which scenario files must be able to express."""

from __future__ import annotations

import inspect
import json
import re
from typing import Any, get_type_hints

from opfmodel.objectives.setpoint_tracking import Setpoints
from solvers.testing import Contract

__all__ = ["check_documentation", "check_options"]

_SPELT = (Setpoints,)  # scenario files have a special notation for these


def check_documentation(rules: Contract, cls: type[Any]) -> None:
    """The class has a docstring, whose first line ``opfmodel list`` shows."""
    first = (cls.__doc__ or "").strip().partition("\n")[0]
    rules.require(first.endswith("."), "has a docstring whose first line ends with a full stop", repr(first))


def check_options(rules: Contract, cls: type[Any]) -> None:
    """Every option is a documented keyword with a type and a default that plain data can express."""
    from pydantic import TypeAdapter

    check_documentation(rules, cls)
    with rules.rule("annotates its options with resolvable types"):
        hints = get_type_hints(cls.__init__)
    documentation = inspect.getdoc(cls) or ""
    for name, option in inspect.signature(cls).parameters.items():
        named = option.kind in (option.POSITIONAL_OR_KEYWORD, option.KEYWORD_ONLY)
        rules.require(named, "names every option", f"*{name}")
        rules.require(name in hints, "annotates its options with resolvable types", name)
        with rules.rule("has options that a file can express"):
            if hints[name] not in _SPELT:
                TypeAdapter(hints[name]).json_schema()
            json.dumps(None if option.default is option.empty else option.default)
        described = re.search(rf"^([\w, ]*\W)?{name}(\W[\w, ]*)?$\n    ", documentation, flags=re.MULTILINE)
        rules.require(described, "documents its options under Parameters", name)
