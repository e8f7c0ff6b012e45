"""Writing of a network and its time series as a scenario, from which they are read back exactly."""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections.abc import Iterator
from dataclasses import MISSING
from pathlib import Path
from typing import Any

import numpy as np

from opfmodel.data.series import Profiles
from opfmodel.data.writing import replace
from opfmodel.errors import CaseError, listed
from opfmodel.network.bounds import bounded
from opfmodel.network.cases.losses import Losses
from opfmodel.network.component import Component
from opfmodel.network.costs import PiecewiseLinear, Polynomial
from opfmodel.network.network import Network

__all__ = ["scalar", "write_scenario"]

_PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_.\-]*")
_WORDS = {"true", "false", "null"}


def write_scenario(network: Network, path: str | Path, *, lossy: bool = False) -> tuple[Path, ...]:
    """Write a network as a scenario file; fields at their defaults are left out.

    Reading the file gives equal components, the same power base, and the time series attached to the
    network, which are written to a CSV file of the same name beside it.

    Parameters
    ----------
    lossy
        Whether what the files cannot hold is left out with a warning instead of refused: components out of
        service with numbers that a scenario file does not accept, and steps beyond the shortest series.

    Returns
    -------
    tuple of Path
        The scenario file, and that of the time series if there are any.

    Raises
    ------
    CaseError
        A file cannot be written, the name does not end in ``.yaml`` or ``.yml``, or something would be
        lost and ``lossy`` is false.
    """
    path = Path(path)
    if path.suffix.lower() not in (".yaml", ".yml"):
        raise CaseError(f"{path}: the name of a scenario file must end in .yaml or .yml")
    losses = Losses(str(path), writing=True)
    lines = _network(network, losses)
    contents = {}
    if network.profiles:
        table = path.with_suffix(".csv")
        lines += _time(network.profiles, table, losses)
        contents[table] = _table(network.profiles).encode()
    losses.settle(lossy)
    contents[path] = ("\n".join(lines) + "\n").encode()
    try:
        replace(contents)
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        raise CaseError(f"{path}: cannot be written: {getattr(error, 'strerror', None) or error}") from error
    return tuple(reversed(contents))


def _network(network: Network, losses: Losses) -> list[str]:
    """Lines of the section ``network``."""
    lines = ["network:", f"  name: {scalar(network.name)}", f"  base_mva: {scalar(network.base_mva)}"]
    for kind in network.kinds():
        lines.append(f"  {kind.plural}:")
        for name, component in network.of(kind).items():
            odd = [key for key, value in _numbers(component) if not (bounded(value) or math.isinf(value))]
            if odd:
                losses.add(f"{name}: {', '.join(odd)}: not a finite number; the component is left out")
                continue
            lines.append(f"    {scalar(name)}: {_fields(component)}")
    return lines


def _time(profiles: Profiles, table: Path, losses: Losses) -> list[str]:
    """Lines of the sections ``time`` and ``profiles``."""
    steps = profiles.length or 0
    longer = [str(key) for key, values in profiles.items() if len(values) > steps]
    if longer:
        losses.add(f"steps after {steps} of the series {listed(longer)}")
    time: dict[str, Any] = {"steps": steps}
    if profiles.calendar is not None:
        start = str(np.datetime_as_string(profiles.calendar.start, unit="auto"))
        clock = "" if "T" in start else "T00:00"
        time |= {
            "start": f"{start}{clock}+00:00",
            "zone": profiles.calendar.zone,
            "step": profiles.calendar.step,
        }
    return ["", f"time: {_mapping(time)}", "", "profiles:", f"  - table: {{file: {scalar(table.name)}}}"]


def _table(profiles: Profiles) -> str:
    """Text of a CSV file of the series."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([str(key) for key in profiles])
    columns = [values.tolist() for values in profiles.values()]
    writer.writerows([repr(value) for value in row] for row in zip(*columns, strict=False))
    return text.getvalue()


def scalar(value: Any) -> str:
    """Format a value as YAML 1.2 in one line, such that the same value is read."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, str):
        plain = _PLAIN.fullmatch(value) and value.lower() not in _WORDS
        quoted = json.dumps(value, ensure_ascii=False)
        return value if plain else "".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in quoted)
    if isinstance(value, int):
        return repr(int(value))
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(scalar, value))}]"
    number = float(value)  # the repr of NumPy's numbers has their type
    if math.isnan(number):
        return ".nan"
    return repr(number) if math.isfinite(number) else ".inf" if number > 0 else "-.inf"


def _fields(component: Component) -> str:
    """Fields of a component that differ from their defaults, as a flow mapping."""
    stated = {
        key: getattr(component, key)
        for key, item in component.fields().items()
        if getattr(component, key)
        != (item.default if item.default_factory is MISSING else item.default_factory())
    }
    return _mapping({key: _cost(value) for key, value in stated.items()})


def _cost(value: Any) -> Any:
    if isinstance(value, Polynomial):
        return {"c2": value.c2, "c1": value.c1, "c0": value.c0}
    return {"points": value.points} if isinstance(value, PiecewiseLinear) else value


def _mapping(values: dict[str, Any]) -> str:
    inside = (f"{scalar(k)}: {_mapping(v) if isinstance(v, dict) else scalar(v)}" for k, v in values.items())
    return f"{{{', '.join(inside)}}}"


def _numbers(component: Component) -> Iterator[tuple[str, float]]:
    """All numbers of a component, by field."""
    for key in component.fields():
        yield from ((key, number) for number in _flat(_cost(getattr(component, key))))


def _flat(value: Any) -> Iterator[float]:
    if isinstance(value, dict | tuple | list):
        for inner in value.values() if isinstance(value, dict) else value:
            yield from _flat(inner)
    elif value is not None and not isinstance(value, str | bool):
        yield float(value)
