"""JSON Schema of scenario files, from the declarations that read them.

The keys are those of :mod:`opfmodel.scenario.schema`, the fields those of the component classes, and the
options those of the constructors of the plugins. Whatever only a network can decide, such as whether a bus
exists, is left to :func:`opfmodel.scenario.load_scenario`.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from typing import Any

from opfmodel.scenario.component_schema import add_components, components, kind_schemas
from opfmodel.scenario.plugin_schema import plugin_schemas, without_titles
from opfmodel.scenario.schema import MOST_VARIANTS, PlantSection, ScenarioFile

__all__ = ["DIALECT", "PARTIAL", "scenario_schema", "section_keys"]

DIALECT = "https://json-schema.org/draft/2020-12/schema"
PARTIAL = "overrides"
"""Name of the schema of a variant: a scenario of which nothing is required."""

Schema = dict[str, Any]


def scenario_schema(origins: Collection[str] | None = None) -> Schema:
    """Return the JSON Schema (draft 2020-12) of scenario files.

    Parameters
    ----------
    origins
        Distributions whose plugins and components are known; all that are installed by default.
    """
    keys = without_titles(ScenarioFile.model_json_schema())
    of_plant = without_titles(PlantSection.model_json_schema())
    beside = {name: each for name, each in of_plant["properties"].items() if name != "mode"}
    defs = {
        **keys.pop("$defs"),
        **of_plant["$defs"],
        **kind_schemas(origins),
        **plugin_schemas(origins, beside),
    }
    add_components(defs["NetworkSection"], components(origins))
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
