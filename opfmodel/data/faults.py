"""Messages for the faults that pydantic finds in values of a file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

__all__ = ["fault_message"]

_INTEGER, _NUMBER, _FLAG = "must be an integer", "must be a number", "must be true or false"
_MESSAGES = {
    "int_type": _INTEGER,
    "int_from_float": _INTEGER,
    "int_parsing": _INTEGER,
    "int_parsing_size": _INTEGER,
    "float_type": _NUMBER,
    "float_parsing": _NUMBER,
    "bool_type": _FLAG,
    "bool_parsing": _FLAG,
    "finite_number": "must be a finite number",
    "string_type": "must be text",
    "string_unicode": "must be valid Unicode text",
    "list_type": "must be a list",
    "tuple_type": "must be a list",
    "dict_type": "must be a mapping",
    "mapping_type": "must be a mapping",
    "model_type": "must be a mapping",
    "missing": "this key is missing",
}
_OF_CONTEXT: Mapping[str, Callable[[Mapping[str, Any]], str]] = {
    "greater_than_equal": lambda context: f"must be at least {context['ge']:g}",
    "greater_than": lambda context: f"must be greater than {context['gt']:g}",
    "less_than_equal": lambda context: f"must be at most {context['le']:g}",
    "less_than": lambda context: f"must be below {context['lt']:g}",
    "literal_error": lambda context: f"must be {context['expected']}",
    "is_instance_of": lambda context: f"must be a {context['class']}",
    "value_error": lambda context: str(context["error"]),
}


def fault_message(fault: Mapping[str, Any]) -> str:
    """Return what is accepted in place of a value, from an entry of ``ValidationError.errors()``.

    Examples
    --------
    >>> fault_message({"type": "greater_than_equal", "ctx": {"ge": 1}, "msg": ""})
    'must be at least 1'
    """
    kind, message = fault["type"], str(fault["msg"])
    if kind in _OF_CONTEXT:
        return _OF_CONTEXT[kind](fault["ctx"])
    return _MESSAGES.get(kind, message[:1].lower() + message[1:])
