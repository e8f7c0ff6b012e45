"""JSON Schemas of plugins, from the parameters of their constructors."""

from __future__ import annotations

import inspect
from collections.abc import Collection, Mapping
from typing import Any, get_type_hints

from pydantic import ConfigDict, PydanticInvalidForJsonSchema, TypeAdapter

from opfmodel.errors import PluginError
from opfmodel.plugins import plugins
from opfmodel.plugins.catalogue import described, first_line

__all__ = ["plugin_schemas", "without_titles"]

_SORTS = ("objective", "profile", "forecast", "plant")
Schema = dict[str, Any]


def plugin_schemas(origins: Collection[str] | None, beside: Mapping[str, Schema]) -> dict[str, Schema]:
    """Schemas of the options of plugins, as ``objective-economic``, and of the places that choose one.

    Parameters
    ----------
    beside
        Keys that all plants have beside their options.
    """
    classes: dict[str, dict[str, Any]] = {sort: {} for sort in (*_SORTS, "formulation")}
    for sort, found in classes.items():
        for name, plugin in plugins(sort).items():
            if origins is None or plugin.origin in origins:
                try:
                    found[name] = plugin.load()
                except PluginError:  # it cannot be used either
                    continue
    others = [sort for sort in _SORTS if sort != "plant"]
    made = {f"{sort}-{name}": _options(cls) for sort in others for name, cls in classes[sort].items()}
    chosen = {sort: _chosen(sort, classes[sort]) for sort in others}
    weighted = _one_of("objective", classes["objective"])
    weighted["properties"]["weight"] = {"type": "number", "minimum": 0, "description": "factor of this part"}
    weighted["maxProperties"] = 2
    parts = {"type": "array", "items": {"anyOf": [_bare(classes["objective"]), weighted]}, "minItems": 1}
    chosen["objective"]["anyOf"].append(parts)
    return {
        **made,
        **chosen,
        "plant": _plant(classes["plant"], beside),
        "formulation": {"enum": list(classes["formulation"])},
    }


def _options(cls: type[Any]) -> Schema:
    """Schema of the options of a plugin: the parameters of its constructor."""
    hints, texts = get_type_hints(cls.__init__, include_extras=True), described(cls)
    properties, required = {}, []
    for name, option in inspect.signature(cls).parameters.items():
        properties[name] = {**_type(hints.get(name, Any)), "description": texts.get(name, "")}
        if option.default is option.empty:
            required.append(name)
        elif isinstance(option.default, bool | int | float | str):
            properties[name]["default"] = option.default
    return {
        "type": "object",
        "description": first_line(cls),
        "properties": properties,
        "required": required,
        "additionalProperties": False,
    }


def _type(hint: Any) -> Schema:
    """Schema of a type; anything where JSON Schema has no words for it."""
    try:
        adapter = TypeAdapter(hint, config=ConfigDict(arbitrary_types_allowed=True))
        schema: Schema = without_titles(adapter.json_schema())
    except PydanticInvalidForJsonSchema:
        return {}
    return schema


def _bare(classes: Mapping[str, Any]) -> Schema:
    """Schema of a name that stands for a plugin without options."""
    complete = [name for name, cls in classes.items() if not _options(cls)["required"]]
    return {"enum": complete, "x-all": list(classes)}


def _one_of(sort: str, classes: Mapping[str, Any]) -> Schema:
    """Schema of a mapping from the name of one plugin to its options."""
    return {
        "type": "object",
        "properties": {name: {"$ref": f"#/$defs/{sort}-{name}", "x-null": True} for name in classes},
        "minProperties": 1,
        "maxProperties": 1,
        "additionalProperties": False,
    }


def _chosen(sort: str, classes: Mapping[str, Any]) -> Schema:
    return {"anyOf": [_bare(classes), _one_of(sort, classes)]}


def _plant(classes: Mapping[str, Any], beside: Mapping[str, Schema]) -> Schema:
    """Schema of the plant, whose options are beside its mode."""
    modes = []
    for name, cls in classes.items():
        options = _options(cls)
        options["properties"] = {"mode": {"const": name}, **options["properties"], **beside}
        if name != "nominal":
            options["required"] = ["mode", *options["required"]]
        modes.append(options)
    return {"anyOf": [_bare(classes), *modes]}


def without_titles(schema: Any) -> Any:
    """Schema without the titles that pydantic makes of names."""
    if isinstance(schema, list):
        return [without_titles(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    return {k: without_titles(v) for k, v in schema.items() if not (k == "title" and isinstance(v, str))}
