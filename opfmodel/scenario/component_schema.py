"""JSON Schemas of components, from the fields of their classes."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import Field
from typing import Any

from opfmodel.network.component import Component
from opfmodel.network.components import BUILT_IN
from opfmodel.network.costs import COEFFICIENT_UNITS, POINT_UNITS
from opfmodel.network.describe import bounds_of, unit_of
from opfmodel.network.quantities import quantity_schema
from opfmodel.plugins import plugins
from opfmodel.plugins.catalogue import first_line
from opfmodel.scenario.declarations import SHARE, component_kinds

__all__ = ["add_components", "components", "kind_schemas"]

Schema = dict[str, Any]


def components(origins: Collection[str] | None) -> list[type[Component]]:
    """Return the built-in kinds of components, and those of devices from some distributions or from all."""
    known = {
        plugin.name for plugin in plugins("device").values() if origins is None or plugin.origin in origins
    }
    return [kind for kind in component_kinds()[0] if kind in BUILT_IN or kind.kind in known]


def kind_schemas(origins: Collection[str] | None) -> dict[str, Schema]:
    """Return the schema of each kind of component, by the name of the kind."""
    return {kind.kind: _component(kind) for kind in components(origins)}


def _component(kind: type[Component]) -> Schema:
    """Schema of a component: types always, bounds only in service, as the classes check them."""
    fields = kind.fields()
    bounds = {name: bound for name, item in fields.items() if (bound := _bounds(item))}
    out = {"properties": {"in_service": {"const": False}}, "required": ["in_service"]}
    return {
        "type": "object",
        "description": first_line(kind),
        "properties": {name: _field(item) for name, item in fields.items()},
        "required": kind.required(),
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
    elif rules["form"] == "adjustable":
        form = [*number, {"type": "array", "items": {"anyOf": number}, "minItems": 2, "maxItems": 2}]
    elif rules["form"] == "cost":
        form = _cost()
    elif rules["form"] == "points":
        form = [{"type": "array", "items": _point(rules["units"]), "minItems": 3}, {"type": "null"}]
    elif rules["form"] == "weights":
        form = [{"type": "object", "additionalProperties": {"anyOf": number}}]
    elif rules["form"] == "choice":
        form = [{"enum": list(rules["options"])}]
    else:
        form = [{"type": "boolean"}] if rules["form"] == "flag" else [{"type": "string"}, {"type": "integer"}]
    made: Schema = form[0] if len(form) == 1 else {"anyOf": form}
    default = {} if not isinstance(item.default, bool | int | float | str) else {"default": item.default}
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
    return [
        {"type": "object", "properties": coefficients, "additionalProperties": False},
        {
            "type": "object",
            "properties": {"points": {"type": "array", "items": _point(POINT_UNITS)}},
            "required": ["points"],
            "additionalProperties": False,
        },
    ]


def _point(units: Sequence[str]) -> Schema:
    return {
        "type": "array",
        "prefixItems": [{"anyOf": _number(unit)} for unit in units],
        "minItems": len(units),
        "maxItems": len(units),
    }


def _bounds(item: Field[Any]) -> Schema:
    """Bounds of the numbers of a field; text with a unit is not compared."""
    words = {"at_least": "minimum", "above": "exclusiveMinimum", "at_most": "maximum"}
    bounds = {
        word: item.metadata[rule]
        for rule, word in words.items()
        if abs(item.metadata.get(rule, float("inf"))) < float("inf")
    }
    return {"prefixItems": [bounds]} if bounds and item.metadata["form"] == "span" else bounds


def add_components(network: Schema, kinds: list[type[Component]]) -> None:
    """Give the schema of the network its sections of components, by name."""
    may_be_empty = {"type": ["object", "null"]}  # a null has no members to check
    for kind in kinds:
        network["properties"][kind.plural] = {
            "description": f"{kind.plural.replace('_', ' ')} by name",
            **may_be_empty,
            "additionalProperties": {"$ref": f"#/$defs/{kind.kind}"},
        }
    fields = [{"$ref": f"#/$defs/{kind.kind}", "x-partial": True} for kind in kinds]
    network["properties"]["update"] |= {**may_be_empty, "additionalProperties": {"anyOf": fields}}
    network["additionalProperties"] = False
