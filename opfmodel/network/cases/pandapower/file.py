"""JSON files of pandapower, read by pandapower or, where that loses nothing, by powerio."""

from __future__ import annotations

import importlib.util
import json
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from opfmodel.data.files import read_text
from opfmodel.errors import CaseError, listed
from opfmodel.network.cases.pandapower.source import is_missing

__all__ = ["load", "pandapower_text"]

_CLASS = re.compile(r'\\*"_class\\*"\s*:\s*\\*"pandapowerNet\\*"')
_MODULE = re.compile(r'\\*"_module\\*"\s*:\s*\\*"([^"\\]*)')
# pandapower imports the modules that a file names; a file has no business with others than these.
_MODULES = {"builtins", "geopandas", "networkx", "numpy", "pandapower", "pandas", "shapely", "simbench"}
_INSTALL = "pip install 'opfmodel[pandapower]'"


def pandapower_text(path: Path, format: str | None) -> str | None:
    """Text of a file if it is a JSON file of pandapower, else None."""
    import powerio

    if format is None:
        if path.suffix.lower() != ".json" or not path.is_file():
            return None
        text = read_text(path, CaseError)
        return text if _CLASS.search(text) else None
    known = powerio.resolve_format(format)
    return read_text(path, CaseError) if known and known.token == "pandapower-json" else None


def load(path: Path, text: str) -> Any:
    """Load a network with pandapower; None if pandapower is not installed and powerio loses nothing.

    Raises
    ------
    CaseError
        The text is no network of pandapower, or names modules that do not belong in one; or pandapower is
        not installed, and powerio drops or changes something.
    """
    if importlib.util.find_spec("pandapower") is None:
        _check_without_pandapower(path, text)
        return None
    for module in _MODULE.findall(text):
        if module.split(".")[0] not in _MODULES:
            raise CaseError(
                f"{path}: refers to the Python module {module!r}; "
                f"a pandapower file may refer to {', '.join(sorted(_MODULES))}"
            )
    import pandapower
    from pandapower import io_utils

    not_allowed = getattr(io_utils, "DeserializationNotAllowed", ValueError)  # since 3.5
    try:
        with warnings.catch_warnings(action="ignore"):
            net = pandapower.from_json_string(text, convert=False)
            # powerio writes the old columns of loads beside the new ones, which pandapower cannot convert.
            if "load" in net and "const_z_p_percent" in net["load"]:
                old = ["const_z_percent", "const_i_percent"]
                net["load"] = net["load"].drop(columns=old, errors="ignore")
            return pandapower.convert_format(net)
    except (ArithmeticError, AttributeError, ImportError, LookupError, TypeError, ValueError) as error:
        raise CaseError(f"{path}: pandapower cannot read it: {type(error).__name__}: {error}") from error
    except (NotImplementedError, RecursionError, UserWarning, not_allowed) as error:
        raise CaseError(f"{path}: pandapower cannot read it: {error}") from error


# Without pandapower -------------------------------------------------------------------------------


def _check_without_pandapower(path: Path, text: str) -> None:
    """Raise :class:`CaseError` if a file holds anything that powerio's reader drops or changes.

    Only tables and values that it was seen to represent faithfully are accepted.
    """
    dropped = sorted(set(_dropped(path, text)))
    if dropped:
        raise CaseError(
            f"{path}: reading {listed(dropped, most=10)} needs pandapower, which is not installed: {_INSTALL}"
        )


def _dropped(path: Path, text: str) -> Iterator[str]:
    try:
        content = json.loads(text)["_object"]
        for table, value in content.items():
            if table.startswith("res_") or not isinstance(value, dict) or value.get("_class") != "DataFrame":
                continue
            frame = json.loads(value["_object"])
            for row in frame["data"]:
                yield from _dropped_values(table, dict(zip(frame["columns"], row, strict=True)))
    except (AttributeError, LookupError, RecursionError, TypeError, ValueError) as error:
        raise CaseError(f"{path}: not a JSON file of pandapower: {error}") from error


def _dropped_values(table: str, row: Mapping[str, Any]) -> Iterator[str]:
    """What is dropped of a row."""
    if table not in _FAITHFUL:
        yield table
        return
    for column, accepted in _FAITHFUL[table].items():
        value = row.get(column)
        if not accepted(None if is_missing(value) else value, row):
            yield f"{table}.{column}"


_Rule = Callable[[Any, Mapping[str, Any]], bool]


def _none(value: Any, _: Mapping[str, Any]) -> bool:
    return not value


def _not_false(value: Any, _: Mapping[str, Any]) -> bool:
    return value is not False


def _true(value: Any, _: Mapping[str, Any]) -> bool:
    return value is True


def _neutral(value: Any, row: Mapping[str, Any]) -> bool:
    return value is None or value == row.get("tap_neutral")


_FAITHFUL: Mapping[str, Mapping[str, _Rule]] = {
    "bus": {},
    "line": {},
    "ext_grid": {"controllable": _true},  # otherwise it holds its voltage in an optimum
    "gen": {"controllable": _not_false, "reactive_capability_curve": _none},
    "load": dict.fromkeys(
        (
            "controllable",
            "const_z_percent",
            "const_i_percent",
            "const_z_p_percent",
            "const_i_p_percent",
            "const_z_q_percent",
            "const_i_q_percent",
        ),
        _none,
    ),
    "shunt": {"step_dependency_table": _none},
    "trafo": {
        "i0_percent": _none,
        "pfe_kw": _none,
        "tap_pos": _neutral,
        "tap2_pos": _none,
        "tap_dependency_table": _none,
    },
    "poly_cost": dict.fromkeys(("cq0_eur", "cq1_eur_per_mvar", "cq2_eur_per_mvar2"), _none),
    "measurement": {},
    "group": {},
}
"""Tables and columns that powerio represents, and the values that it represents."""
