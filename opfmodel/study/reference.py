"""JSON Schema of study files."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Mapping
from typing import Any

from opfmodel.scenario.reference import DIALECT, PARTIAL, scenario_schema, section_keys
from opfmodel.study.document import StudyFile

__all__ = ["study_schema"]

Schema = dict[str, Any]


def study_schema(origins: Collection[str] | None = None) -> Schema:
    """Return the JSON Schema (draft 2020-12) of study files.

    The dotted keys of the sections of a scenario are listed with their values. Others, such as those of
    components, are checked against the scenario when the study is read.

    Parameters
    ----------
    origins
        As for :func:`opfmodel.scenario.reference.scenario_schema`.
    """
    scenario = scenario_schema(origins)
    keys = section_keys(scenario, scenario["$defs"][PARTIAL]["properties"])
    chosen: Schema = {"scenario": {"type": "string"}, "variant": {"type": ["string", "null"]}}
    own = StudyFile.model_json_schema()["properties"]
    for value in own.values():
        del value["title"]
    own["set"] |= {"$ref": "#/$defs/keys"}
    axes = {key: _axis({"$ref": f"#/$defs/keys/properties/{key}"}) for key in keys}
    axes |= {key: _axis(value) for key, value in chosen.items()}
    own["vary"] |= {"type": "object", "properties": axes, "additionalProperties": _axis({})}
    added = {
        "keys": {"type": "object", "properties": keys},
        "point": {"$ref": "#/$defs/keys", "properties": chosen},
    }
    return {
        "$schema": DIALECT,
        "title": "opfmodel study",
        "type": "object",
        "properties": own,
        "additionalProperties": False,
        "$defs": {**added, **_reachable(keys, scenario["$defs"])},
    }


def _reachable(schema: Schema, defs: Mapping[str, Schema]) -> dict[str, Schema]:
    """Definitions to which a schema refers, directly or through others."""
    found: dict[str, Schema] = {}
    waiting = [schema]
    while waiting:
        text = json.dumps(waiting.pop())
        new = {name: defs[name] for name in re.findall(r'"#/\$defs/([\w-]+)"', text) if name not in found}
        found |= new
        waiting += new.values()
    return dict(sorted(found.items()))


def _axis(value: Mapping[str, Any]) -> Schema:
    """Schema of an axis: values of one key, or named sets of keys."""
    points = {"type": "object", "minProperties": 1, "additionalProperties": {"$ref": "#/$defs/point"}}
    return {"anyOf": [{"type": "array", "minItems": 1, "items": dict(value)}, points]}
