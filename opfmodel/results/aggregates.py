"""Sums over the components of a dataset, and the choice of buses, for figures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from opfmodel.errors import ResultError, listed, nearest, shown

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["at_bus", "chosen", "generation", "injections", "members", "named_buses", "stages", "total"]

_MOST_BUSES = 7  # of a network of which all are shown by default
_MOST_NAMES = 5  # in a message
_GENERATED = (("generator", "pg"), ("renewable", "renewable_p"))
_SHOWN = ("renewable_p", "flexible_load_p")  # as generation and demand


def stages(data: xr.Dataset) -> str:
    """Dimension of the stages: nodes of a tree, or time."""
    return "node" if "node" in data.dims else "time"


def total(data: xr.Dataset, quantity: str) -> Any:
    """Sum of a quantity over all components; zero if it is absent."""
    if quantity not in data:
        return np.zeros(data.sizes[stages(data)])
    array = data[quantity]
    return array.sum([d for d in array.dims if d != stages(data)]).values


def generation(data: xr.Dataset) -> Any:
    """Active power of all generators and renewables."""
    return sum(total(data, quantity) for _, quantity in _GENERATED)


def injections(data: xr.Dataset) -> list[str]:
    """Names of the injections of further kinds, ``<kind>_p``, by component or summed at the buses."""
    named = [str(n) for n in data if str(n).endswith("_p") and str(n) not in _SHOWN]
    return [n for n in named if data[n].dims in {(stages(data), at) for at in ("bus", n.removesuffix("_p"))}]


def members(data: xr.Dataset, kind: str, bus: str) -> list[str]:
    """Names of the components of a kind at a bus; of the kind ``bus``, the bus itself."""
    if kind == "bus":
        return [bus]
    if f"{kind}_bus" not in data.variables:
        return []
    return [c for c, b in zip(data[kind].values, data[f"{kind}_bus"].values, strict=True) if b == bus]


def at_bus(data: xr.Dataset, quantity: str, kind: str, bus: str) -> Any:
    """Sum of a quantity over the components at a bus; None without components."""
    if quantity not in data:
        return None
    found = members(data, kind, bus)
    return data[quantity].sel({kind: found}).sum(kind).values if found else None


def chosen(data: xr.Dataset, names: Sequence[str] | None) -> list[str]:
    """Return the buses to show; by default all of a few, or those with the highest demand or generation.

    Raises
    ------
    ResultError
        There are no buses of these names.
    """
    known = [str(b) for b in data["bus"].values]
    if names is not None:
        unknown = [name for name in dict.fromkeys(names) if name not in known]
        if unknown:
            hint = nearest(unknown[0] if len(unknown) == 1 else "", known)
            raise ResultError(f"no bus is named {listed(map(shown, unknown), _MOST_NAMES)}; {hint}")
        return list(dict.fromkeys(names))
    if len(known) <= _MOST_BUSES:
        return known
    weight = dict.fromkeys(known, 0.0)
    for bus in known:
        weight[bus] = float(np.abs(data["pd"].sel(bus=bus)).max())
        for kind, quantity in _GENERATED:
            generated = at_bus(data, quantity, kind, bus)
            if generated is not None:
                weight[bus] = max(weight[bus], float(np.abs(generated).max()))
    return sorted(sorted(known, key=lambda b: -weight[b])[:4], key=known.index)


def named_buses(data: xr.Dataset, texts: Sequence[str]) -> list[str]:
    """Return the names in texts, each of which is the name of a bus or several names with commas between.

    Examples
    --------
    >>> import xarray as xr
    >>> named_buses(xr.Dataset(coords={"bus": ["1", "2", "3", "north, 1"]}), ["1, 3", "north, 1"])
    ['1', '3', 'north, 1']
    """
    known = {str(bus) for bus in data["bus"].values}
    parts = ([text] if text in known else text.split(",") for text in texts)
    return [name if name in known else name.strip() for names in parts for name in names]
