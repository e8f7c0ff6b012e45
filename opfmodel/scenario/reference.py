"""JSON Schema of scenario files, from the declarations that read them.

The keys are those of :mod:`opfmodel.scenario.schema`, the fields those of the component classes, and the
options those of the constructors of the plugins. Whatever only a network can decide, such as whether a bus
exists, is left to :func:`opfmodel.scenario.load_scenario`.
"""

from __future__ import annotations

import inspect
import json
from collections.abc import Collection, Mapping
from dataclasses import MISSING, Field
from typing import Any, get_type_hints

from pydantic import ConfigDict, PydanticInvalidForJsonSchema, TypeAdapter

from opfmodel.errors import PluginError
from opfmodel.network.component import Component
from opfmodel.network.components import BUILT_IN
from opfmodel.network.costs import COEFFICIENT_UNITS, POINT_UNITS
from opfmodel.network.describe import bounds_of, unit_of
from opfmodel.network.quantities import quantity_schema
from opfmodel.plugins import plugins
from opfmodel.plugins.catalogue import described, first_line
from opfmodel.scenario.declarations import SHARE, component_kinds
from opfmodel.scenario.schema import MOST_VARIANTS, ScenarioFile

__all__ = ["DIALECT", "PARTIAL", "scenario_schema", "section_keys"]

DIALECT = "https://json-schema.org/draft/2020-12/schema"
PARTIAL = "overrides"
"""Name of the schema of a variant: a scenario of which nothing is required."""

_SORTS = ("objective", "profile", "forecast", "plant")
Schema = dict[str, Any]


def scenario_schema(origins: Collection[str] | None = None) -> Schema:
    """Return the JSON Schema (draft 2020-12) of scenario files.

    Parameters
    ----------
    origins
        Distributions whose plugins and components are known; all that are installed by default.
    """
    keys = _without_titles(ScenarioFile.model_json_schema())
    defs = {**keys.pop("$defs"), **_kinds(origins), **_plugins(origins)}
    _add_components(defs["NetworkSection"], _components(origins))
    partial = {name: _partial(schema) for name, schema in {**defs, PARTIAL: keys}.items()}
    differ = _differing(defs, partial)
    made = {name: _resolved(schema, set()) for name, schema in defs.items()}
    made |= {_partial_name(name): _resolved(partial[name], differ) for name in differ}
    root = _resolved(keys, set())
    return {"$schema": DIALECT, "title": "opfmodel scenario", **root, "$defs": dict(sorted(made.items()))}


def section_keys(
    schema: Schema, keys: Mapping[str, Schema], prefix: str = "", named: bool = False
) -> dict[str, Schema]:
    """Return the schemas of dotted keys, such as ``controller.end.price``, of a mapping and its sections.

    Parameters
    ----------
    schema
        The schema with the definitions to which others refer.
    named
        Whether to include the keys of sections that the user names, as ``constraints.NAME.terms``.
    """
    found: dict[str, Schema] = {}
    for key, value in keys.items():
        found[prefix + key] = value
        parts = [(f"{prefix}{key}.", part) for part in (value, *value.get("anyOf", ()))]
        if named and isinstance(value.get("additionalProperties"), dict):
            parts.append((f"{prefix}{key}.NAME.", value["additionalProperties"]))
        for inside, part in parts:
            name = part.get("$ref", "").rpartition("/")[2]
            if name.endswith("Section"):
                found |= section_keys(schema, schema["$defs"][name]["properties"], inside, named)
    return found


# Components -------------------------------------------------------------------------------------------


def _components(origins: Collection[str] | None) -> list[type[Component]]:
    known = {
        plugin.name for plugin in plugins("device").values() if origins is None or plugin.origin in origins
    }
    return [kind for kind in component_kinds()[0] if kind in BUILT_IN or kind.kind in known]


def _kinds(origins: Collection[str] | None) -> dict[str, Schema]:
    return {kind.kind: _component(kind) for kind in _components(origins)}


def _component(kind: type[Component]) -> Schema:
    """Schema of a component: types always, bounds only in service, as the classes check them."""
    fields = kind.fields()
    bounds = {name: bound for name, item in fields.items() if (bound := _bounds(item))}
    out = {"properties": {"in_service": {"const": False}}, "required": ["in_service"]}
    return {
        "type": "object",
        "description": first_line(kind),
        "properties": {name: _field(item) for name, item in fields.items()},
        "required": [name for name, item in fields.items() if item.default is MISSING],
        "additionalProperties": False,
        **({"if": out, "else": {"properties": bounds}} if bounds else {}),
    }


def _field(item: Field[Any]) -> Schema:
    rules, described = item.metadata, _sentence(item)
    number = _number(rules["unit"])
    form: list[Schema]
    if rules["form"] == "number":
        form = [*_shared(number), *([{"type": "null"}] if rules["optional"] else [])]
    elif rules["form"] == "span":
        pair = {"type": "array", "items": {"anyOf": number}, "minItems": 2, "maxItems": 2}
        form = [pair, *_shared(number)] if rules["symmetric"] else [pair]
    elif rules["form"] == "cost":
        form = _cost()
    else:
        form = [{"type": "boolean"}] if rules["form"] == "flag" else [{"type": "string"}, {"type": "integer"}]
    made: Schema = form[0] if len(form) == 1 else {"anyOf": form}
    default = {} if not isinstance(item.default, bool | int | float) else {"default": item.default}
    return {"description": described, **default, **made}


def _sentence(item: Field[Any]) -> str:
    """Description of a field with its unit and bounds, as editors show it."""
    facts = ", ".join(filter(None, (unit_of(item), bounds_of(item.metadata))))
    text = str(item.metadata.get("description", ""))
    return f"{text} [{facts}]".strip() if facts else text


def _number(unit: str) -> list[Schema]:
    return [{"type": "number"}, quantity_schema(unit)]


def _shared(number: list[Schema]) -> list[Schema]:
    """Schemas of a number that may also be a share of another field."""
    return [*number, {"type": "string", "pattern": f"^{SHARE.pattern}$", "description": "share of a field"}]


def _cost() -> list[Schema]:
    coefficients = {name: {"anyOf": _number(unit)} for name, unit in COEFFICIENT_UNITS.items()}
    point = {
        "type": "array",
        "prefixItems": [{"anyOf": _number(unit)} for unit in POINT_UNITS],
        "minItems": len(POINT_UNITS),
        "maxItems": len(POINT_UNITS),
    }
    return [
        {"type": "object", "properties": coefficients, "additionalProperties": False},
        {
            "type": "object",
            "properties": {"points": {"type": "array", "items": point}},
            "required": ["points"],
            "additionalProperties": False,
        },
    ]


def _bounds(item: Field[Any]) -> Schema:
    """Bounds of the numbers of a field; text with a unit is not compared."""
    words = {"at_least": "minimum", "above": "exclusiveMinimum", "at_most": "maximum"}
    bounds = {
        word: item.metadata[rule]
        for rule, word in words.items()
        if abs(item.metadata.get(rule, float("inf"))) < float("inf")
    }
    return {"prefixItems": [bounds]} if bounds and item.metadata["form"] == "span" else bounds


def _add_components(network: Schema, kinds: list[type[Component]]) -> None:
    """Give the schema of the network its sections of components, by name."""
    may_be_empty = {"type": ["object", "null"]}  # a null has no members to check
    for kind in kinds:
        network["properties"][kind.plural] = {
            "description": f"{kind.plural} by name",
            **may_be_empty,
            "additionalProperties": {"$ref": f"#/$defs/{kind.kind}"},
        }
    fields = [{"$ref": f"#/$defs/{kind.kind}", "x-partial": True} for kind in kinds]
    network["properties"]["update"] |= {**may_be_empty, "additionalProperties": {"anyOf": fields}}
    network["additionalProperties"] = False


# Plugins ----------------------------------------------------------------------------------------------


def _plugins(origins: Collection[str] | None) -> dict[str, Schema]:
    """Schemas of the options of plugins, as ``objective-economic``, and of where plugins are chosen."""
    classes: dict[str, dict[str, Any]] = {sort: {} for sort in (*_SORTS, "formulation")}
    for sort, found in classes.items():
        for name, plugin in plugins(sort).items():
            if origins is None or plugin.origin in origins:
                try:
                    found[name] = plugin.load()
                except PluginError:  # it cannot be used either
                    continue
    beside = [sort for sort in _SORTS if sort != "plant"]
    made = {f"{sort}-{name}": _options(cls) for sort in beside for name, cls in classes[sort].items()}
    chosen = {sort: _chosen(sort, classes[sort]) for sort in beside}
    weighted = _one_of("objective", classes["objective"])
    weighted["properties"]["weight"] = {"type": "number", "minimum": 0, "description": "factor of this part"}
    weighted["maxProperties"] = 2
    parts = {"type": "array", "items": {"anyOf": [_bare(classes["objective"]), weighted]}, "minItems": 1}
    chosen["objective"]["anyOf"].append(parts)
    return {
        **made,
        **chosen,
        "plant": _plant(classes["plant"]),
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
        schema: Schema = _without_titles(adapter.json_schema())
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


def _plant(classes: Mapping[str, Any]) -> Schema:
    """Schema of the plant, whose options are beside its mode."""
    modes = []
    for name, cls in classes.items():
        options = _options(cls)
        options["properties"] = {"mode": {"const": name}, **options["properties"]}
        if name != "nominal":
            options["required"] = ["mode", *options["required"]]
        modes.append(options)
    return {"anyOf": [_bare(classes), *modes]}


# From the schemas of pydantic to one JSON Schema -------------------------------------------------------


def _partial_name(name: str) -> str:
    return name if name == PARTIAL else f"{PARTIAL}-{name}"


def _differing(defs: Mapping[str, Schema], partial: Mapping[str, Schema]) -> set[str]:
    """Names of the definitions that are not the same where nothing is required."""
    differ = {name for name in partial if partial[name] != defs.get(name)}
    while more := {name for name, refs in _references(defs).items() if refs & differ} - differ:
        differ |= more
    return differ


def _references(defs: Mapping[str, Schema]) -> dict[str, set[str]]:
    """Names of the definitions to which each definition refers, also by a mark."""
    found = {}
    for name, schema in defs.items():
        text = json.dumps(schema)
        found[name] = {
            other for other in defs if f'#/$defs/{other}"' in text or f'"x-sort": "{other}"' in text
        }
    return found


def _partial(schema: Any) -> Any:
    """Schema without what only a complete scenario must satisfy."""
    if isinstance(schema, list):
        return [_partial(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    if "x-all" in schema:
        return {"enum": schema["x-all"]}
    dropped = ("required", "if", "else", "minProperties")
    made = {}
    for key, value in schema.items():
        if key == "properties":
            made[key] = {name: _partial(part) for name, part in value.items()}
        elif key not in dropped:
            made[key] = _partial(value)
    return made


def _resolved(schema: Any, differ: set[str]) -> Any:
    """Schema with references in place of the marks of this module.

    Parameters
    ----------
    differ
        Names of the definitions to refer to in the form in which nothing is required.
    """
    if isinstance(schema, list):
        return [_resolved(part, differ) for part in schema]
    if not isinstance(schema, dict):
        return schema

    def reference(name: str) -> Schema:
        return {"$ref": f"#/$defs/{_partial_name(name) if name in differ or 'x-partial' in schema else name}"}

    made = {key: _resolved(value, differ) for key, value in schema.items() if not key.startswith("x-")}
    if "$ref" in made:
        made |= reference(made["$ref"].removeprefix("#/$defs/"))
    if "x-null" in schema:
        made = {"anyOf": [made, {"type": "null"}]}
    sort = schema.get("x-sort", "")
    if sort == "variants":
        made |= {"type": "object", "additionalProperties": reference(PARTIAL), "maxProperties": MOST_VARIANTS}
    elif sort == "profile":
        made |= {"type": "array", "items": reference("profile")}
    elif sort == "objective" and made.get("default", "") is None:
        made["anyOf"] = [reference("objective"), {"type": "null"}]
    elif sort and sort != "update":
        made |= reference(sort)
    return made


def _without_titles(schema: Any) -> Any:
    """Schema without the titles that pydantic makes of names."""
    if isinstance(schema, list):
        return [_without_titles(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    return {k: _without_titles(v) for k, v in schema.items() if not (k == "title" and isinstance(v, str))}
