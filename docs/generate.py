"""Write what is generated from declarations: JSON Schemas, and tables of the documentation.

    python docs/generate.py

A table stands between ``<!-- generated: NAME -->`` and ``<!-- end -->``. ``tests/test_schema.py`` fails if a
file is not current.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import Field
from pathlib import Path
from typing import Any

from opfmodel.network import Component
from opfmodel.network.components import BUILT_IN
from opfmodel.network.describe import bounds_of, default_of, type_of, unit_of
from opfmodel.scenario.reference import scenario_schema, section_keys
from opfmodel.study.reference import study_schema

ROOT = Path(__file__).resolve().parents[1]
OURS = {"opfmodel"}  # whatever else is installed

# Where the page says more about a key.
_LINKS = {
    "network": "[Network](#network)",
    "network.file": "[inputs.md](inputs.md)",
    "network.lossy": "[inputs.md](inputs.md#what-is-refused)",
    "time.start": "[Time](inputs.md#time)",
    "time.at_end": "[The end of the data](inputs.md#the-end-of-the-data)",
    "controller.horizon.hours": "[uncertainty.md](uncertainty.md#uneven-steps)",
    "controller.scenarios": "[uncertainty.md](uncertainty.md)",
    "controller.scenarios.draw.splits": "[uncertainty.md](uncertainty.md#trees-that-split-more-than-once)",
    "controller.security": "[security.md](security.md)",
    "profiles": "[Profile rules](#profile-rules)",
    "cost": "[Objectives](#objectives)",
    "controller.formulation": "[backends.md](backends.md)",
    "controller.generator_delay": "[model.md](model.md)",
    "controller.on_infeasible": "[plants.md](plants.md#elastic-problems)",
    "controller.limits": "[plants.md](plants.md#elastic-problems)",
    "controller.solver": "[backends.md](backends.md)",
    "forecast": "[Forecasts](#forecasts)",
    "plant": "[Plants](#plants)",
    "constraints": "[Constraints](#constraints)",
    "variants": "[studies](studies.md), which have no such limit",
}
_LIKE_AT_LEAST = ("constraints.NAME.at_most.", "constraints.NAME.equal.")  # their keys are listed once
_TYPES = {"string": "text", "object": "mapping", "array": "list"}


def generated() -> dict[Path, str]:
    """Return the content of all generated files, by path."""
    schemas = {"scenario": scenario_schema(OURS), "study": study_schema(OURS)}
    files = {
        ROOT / "scenarios" / f"{name}.schema.json": json.dumps(schema, indent=1, ensure_ascii=False) + "\n"
        for name, schema in schemas.items()
    }

    def of_constraint(key: str) -> bool:
        return key.startswith("constraints.NAME.") and not key.startswith(_LIKE_AT_LEAST)

    def of_scenario(key: str) -> bool:
        return not key.startswith(("network.", "constraints."))

    tables: dict[str, Callable[[], str]] = {
        "keys of a scenario": lambda: _keys(schemas["scenario"], of_scenario),
        "keys of a network": lambda: _keys(schemas["scenario"], lambda key: key.startswith("network.")),
        "keys of a constraint": lambda: _keys(schemas["scenario"], of_constraint),
        "keys of a study": lambda: _keys(schemas["study"], lambda _: True),
        "fields of components": _fields,
    }
    for page in (ROOT / "docs").glob("*.md"):
        text = page.read_text(encoding="utf-8")
        for name, table in tables.items():
            before, mark, rest = text.partition(f"<!-- generated: {name} -->")
            if mark:
                text = f"{before}{mark}\n\n{table()}\n<!-- end -->{rest.partition('<!-- end -->')[2]}"
                files[page] = text
    return files


def _table(*rows: tuple[str, ...]) -> str:
    head, *body = (f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |" for row in rows)
    return "\n".join([head, f"| {' | '.join('---' for _ in rows[0])} |", *body]) + "\n"


# Components


def _fields() -> str:
    rows = [("field", "type", "unit", "default", "bounds", "series", "meaning")]
    for kind in BUILT_IN:
        rows.append((f"**`{kind.plural}`**", *("" for _ in rows[0][1:])))
        rows += [_field(kind, name, item) for name, item in kind.fields().items()]
    return _table(*rows)


def _field(kind: type[Component], name: str, item: Field[Any]) -> tuple[str, ...]:
    series = kind.quantities(name) if item.metadata.get("series", True) else ()
    default = default_of(item)
    return (
        f"`{name}`",
        type_of(item),
        unit_of(item),
        f"`{default}`" if default.startswith(("[", "{")) else default,
        bounds_of(item.metadata),
        ", ".join(f"`{quantity}`" for quantity in series),
        item.metadata["description"].removesuffix("."),
    )


# Keys


def _keys(schema: dict[str, Any], chosen: Callable[[str], bool]) -> str:
    rows = [("key", "type", "unit", "default", "meaning")]
    for key, value in section_keys(schema, schema["properties"], named=True).items():
        if chosen(key) and (key == "network" or not value.get("$ref", "").endswith("Section")):
            rows.append(_key(schema, key, value))
    return _table(*rows)


def _key(schema: Mapping[str, Any], key: str, value: Mapping[str, Any]) -> tuple[str, ...]:
    types, unit = _type(value)
    meaning = value.get("description", "")
    if key in _LINKS:
        meaning += f"; see {_LINKS[key]}"
    owner = schema
    for part in key.split(".")[:-1]:
        if part == "NAME":
            continue
        owner = _section(schema, owner["properties"][part])
    required = key.rpartition(".")[2] in owner.get("required", ())
    return f"`{key}`", types, unit, "required" if required else _default(value), meaning


def _section(schema: Mapping[str, Any], value: Mapping[str, Any]) -> Mapping[str, Any]:
    parts = [value, *value.get("anyOf", ()), *filter(None, [value.get("additionalProperties")])]
    (name,) = (p["$ref"].rpartition("/")[2] for p in parts if p.get("$ref", "").endswith("Section"))
    found: Mapping[str, Any] = schema["$defs"][name]
    return found


def _default(value: Mapping[str, Any]) -> str:
    default = value.get("default")
    if default in (None, "", [], {}):
        return "none"
    if isinstance(default, bool):
        return str(default).lower()
    return f"{default:g}" if isinstance(default, float | int) else f"`{default}`"


def _type(value: Mapping[str, Any]) -> tuple[str, str]:
    """Words for the types that a key accepts, and the unit of its number."""
    if "enum" in value:
        return " or ".join(f"`{choice}`" for choice in value["enum"]), ""
    if "$ref" in value and "type" not in value:
        name = value["$ref"].rpartition("/")[2]
        return {"formulation": "name"}.get(name, "mapping" if name.endswith("Section") else name), ""
    if "anyOf" in value:
        found = [_type(part) for part in value["anyOf"] if part.get("type") != "null"]
        quantities = [part["description"] for part in value["anyOf"] if "pattern" in part]
        words = dict.fromkeys(word for word, _ in found if word != "quantity")
        return " or ".join(words), quantities[0] if quantities else "".join(unit for _, unit in found)
    kinds = value.get("type", "")
    word = kinds if isinstance(kinds, str) else kinds[0]  # the other is null
    return "quantity" if "pattern" in value else _TYPES.get(word, word), ""


def main() -> None:
    """Write every file."""
    for path, text in generated().items():
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
