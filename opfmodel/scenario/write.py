"""Writing of a network as a scenario file, from which it is read back exactly."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from dataclasses import MISSING
from pathlib import Path
from typing import Any

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


def write_scenario(network: Network, path: str | Path, *, lossy: bool = False) -> Path:
    """Write the ``network`` section of a scenario file; fields at their defaults are left out.

    Reading the file gives equal components and the same power base.

    Parameters
    ----------
    lossy
        Whether what the file cannot hold is left out with a warning instead of refused: attached time
        series, and components out of service with numbers that a scenario file does not accept.

    Raises
    ------
    CaseError
        The file cannot be written, its name does not end in ``.yaml`` or ``.yml``, or something would be
        lost and ``lossy`` is false.
    """
    path = Path(path)
    if path.suffix.lower() not in (".yaml", ".yml"):
        raise CaseError(f"{path}: the name of a scenario file must end in .yaml or .yml")
    losses = Losses(str(path), writing=True)
    if network.profiles:
        losses.add(f"{len(network.profiles)} time series: {listed(map(str, network.profiles))}")
    lines = ["network:", f"  name: {scalar(network.name)}", f"  base_mva: {scalar(network.base_mva)}"]
    for kind in network.kinds():
        lines.append(f"  {kind.plural}:")
        for name, component in network.of(kind).items():
            odd = [key for key, value in _numbers(component) if not (bounded(value) or math.isinf(value))]
            if odd:
                losses.add(f"{name}: {', '.join(odd)}: not a finite number; the component is left out")
                continue
            lines.append(f"    {scalar(name)}: {_fields(component)}")
    losses.settle(lossy)
    try:
        replace({path: ("\n".join(lines) + "\n").encode()})
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        raise CaseError(f"{path}: cannot be written: {getattr(error, 'strerror', None) or error}") from error
    return path


def scalar(value: Any) -> str:
    """Format a value as YAML 1.2 in one line, such that the same value is read."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, str):
        plain = _PLAIN.fullmatch(value) and value.lower() not in _WORDS
        return value if plain else json.dumps(value, ensure_ascii=False)
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
        if item.default is MISSING or getattr(component, key) != item.default
    }
    return _mapping({key: _cost(value) for key, value in stated.items()})


def _cost(value: Any) -> Any:
    if isinstance(value, Polynomial):
        return {"c2": value.c2, "c1": value.c1, "c0": value.c0}
    return {"points": value.points} if isinstance(value, PiecewiseLinear) else value


def _mapping(values: dict[str, Any]) -> str:
    inside = (f"{k}: {_mapping(v) if isinstance(v, dict) else scalar(v)}" for k, v in values.items())
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
