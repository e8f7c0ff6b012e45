"""What trajectories read from a file must have, so that whatever uses them can rely on it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from opfmodel.data.calendar import zone_of
from opfmodel.errors import ProfileError, ResultError, shown
from opfmodel.network.components import BUILT_IN
from opfmodel.results.limits import LIMITS, RAMPS, RATINGS

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["check_trajectories"]

_REQUIRED = ("time", "bus", "pd", "qd")

# Dimensions of the quantities that other modules use by name.
_DIMENSIONS: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys(("pd", "qd", "vm", "va"), ("time", "bus")),
    **dict.fromkeys(("pg", "qg"), ("time", "generator")),
    **dict.fromkeys(("ps", "qs", "e", "e_next"), ("time", "storage")),
    **dict.fromkeys(("pf", "qf", "pt", "qt"), ("time", "branch")),
    **dict.fromkeys(("renewable_p", "renewable_q"), ("time", "renewable")),
    **dict.fromkeys(
        ("dc_line_pf", "dc_line_pt", "dc_line_loss", "dc_line_qf", "dc_line_qt"), ("time", "dc_line")
    ),
    **{f"{kind.kind}_status": ("time", kind.kind) for kind in BUILT_IN if kind.lost},
    **dict.fromkeys(("cost_rate", "outages_known"), ("time",)),
    "generator_bus": ("generator",),
    "storage_bus": ("storage",),
    "renewable_bus": ("renewable",),
    **dict.fromkeys(("bus_x", "bus_y"), ("bus",)),
    **dict.fromkeys(("branch_from_bus", "branch_to_bus"), ("branch",)),
}
# Kind of the limits, which vary over time or are constant.
_LIMITS = {
    **{f"{name}_{end}": limit.kind for name, limit in LIMITS.items() for end in ("min", "max")},
    **{f"{name}_ramp": kind for name, (kind, _, _) in RAMPS.items()},
    **{name: kind for kind, name, _, _ in RATINGS.values()},
}
_MEMBERSHIPS = ("generator_bus", "storage_bus", "renewable_bus", "branch_from_bus", "branch_to_bus")
# What a quantity is shown with.
_TOGETHER = {
    "pf": "pt",
    "pt": "pf",
    "e": "e_next",
    "e_next": "e",
    "pg": "generator_bus",
    "ps": "storage_bus",
    "renewable_p": "renewable_bus",
}


def check_trajectories(data: xr.Dataset) -> None:
    """Raise an error unless a dataset has the structure that :func:`opfmodel.results.dataset` builds.

    Raises
    ------
    ResultError
        A variable is missing, or has other dimensions, other values or other attributes.
    """
    for name in _REQUIRED:
        _require(name in data.variables, f"{name!r} is missing")
    for name, needed in _TOGETHER.items():
        _require(name not in data or needed in data.variables, f"{name!r} lacks {needed!r}")
    for name, dimensions in _DIMENSIONS.items():
        if name in data.variables:
            _require(
                data[name].dims == dimensions,
                f"{name}: has the dimensions {shown(data[name].dims)}; must have {dimensions}",
            )
    for name, kind in _LIMITS.items():
        if name in data.variables:
            _require(
                data[name].dims in ((kind,), ("time", kind)),
                f"{name}: has the dimensions {shown(data[name].dims)}; must have {(kind,)}, or also 'time'",
            )
    for name in ("bus", *{str(dimension) for dimension in data.dims} - {"time", "bus"}):
        _check_names(data, name)
    for key, variable in data.variables.items():
        name = str(key)
        if name in _MEMBERSHIPS:
            _require(_is_text(variable.values), f"{name}: must be names of buses")
        elif (
            name in _DIMENSIONS or name in _LIMITS or name.endswith("_p")
        ):  # such as the injections of devices of other packages
            _require(variable.dtype.kind in "biuf", f"{name}: {variable.dtype}: must be numbers")
    rating = data.attrs.get("outage_rating", 1.0)
    _require(
        _is_number(rating) and 0 < float(rating) < math.inf,
        f"outage_rating = {shown(rating)}: must be a positive number",
    )
    _check_time(data)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool | np.bool_)


def _require(kept: bool, what: str) -> None:
    if not kept:
        raise ResultError(what)


def _check_names(data: xr.Dataset, dimension: str) -> None:
    """Check the names along a dimension; without a coordinate, its items are numbered."""
    if dimension not in data.coords:
        _require(dimension != "bus", "bus: has no names")
        return
    names = data[dimension]
    _require(names.dims == (dimension,), f"{dimension}: must have one dimension, of its own name")
    values = names.values.tolist()
    _require(_is_text(values) or names.dtype.kind in "iu", f"{dimension}: {names.dtype}: must be names")
    _require(len(set(values)) == len(values), f"{dimension}: a name occurs twice")


def _is_text(values: Any) -> bool:
    return all(isinstance(value, str) for value in values)


def _check_time(data: xr.Dataset) -> None:
    time = data["time"]
    _require(time.dims == ("time",), "time: must have one dimension, of its own name")
    _require(time.size > 0, "time: has no steps")
    dated = bool(np.issubdtype(time.dtype, np.datetime64))
    _require(dated or time.dtype.kind in "iuf", f"time: {time.dtype}: must be hours or time stamps")
    finite = not np.isnat(time.values).any() if dated else bool(np.isfinite(time.values).all())
    rising = all(before < after for before, after in pairwise(time.values))
    _require(finite and rising, "time: must rise from step to step")
    step = data.attrs.get("step_hours", 1.0)
    _require(
        _is_number(step) and 0 < float(step) < _MOST_HOURS and math.isfinite(step),
        f"step_hours = {shown(step)}: must be a positive number",
    )
    try:
        zone_of(str(time.attrs.get("zone", "UTC")))
    except ProfileError as error:
        raise ResultError(f"time: {error}") from error


_MOST_HOURS = 1e6  # steps of a hundred years; longer ones leave the calendar
