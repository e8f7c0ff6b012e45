"""Trajectories as labelled arrays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from opfmodel.network import PerUnitNetwork
from opfmodel.units import scale

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["dataset"]

Array = npt.NDArray[np.float64]


def dataset(
    network: PerUnitNetwork, quantities: Mapping[str, tuple[str, str, str, Array]], times: Array
) -> xr.Dataset:
    """A dataset in physical units from per-unit arrays.

    Parameters
    ----------
    network
        Arrays of the network, with the time series of the window.
    quantities
        ``(kind, unit, description, values)`` by name; values of shape ``(items, stages)``.
    times
        Hours at which the stages begin.

    Returns
    -------
    xarray.Dataset
        Dimensions ``time`` and one per kind of component; also the demand ``pd``, ``qd`` of each bus.
    """
    import xarray as xr

    made = xr.Dataset(coords={"time": ("time", times, {"units": "h", "long_name": "start of the stage"})})
    for kind in ("bus", *(kind for kind, _, _, _ in quantities.values())):
        if kind not in made.coords:
            made = made.assign_coords({kind: list(network.tables[kind].names)})
    demand = {
        name: ("bus", unit, f"{sort} demand", _demand(network, field, len(times)))
        for name, field, unit, sort in (("pd", "p", "MW", "active"), ("qd", "q", "MVAr", "reactive"))
    }
    for name, (kind, unit, description, values) in {**quantities, **demand}.items():
        physical = values * scale(unit, network.base_mva)
        made[name] = (("time", kind), physical.T, {"units": unit, "long_name": description})
    return made


def _demand(network: PerUnitNetwork, field: str, stages: int) -> Array:
    values = network.load.arrays[field]
    if values.ndim == 1:
        values = np.repeat(values[:, None], stages, axis=1)
    return network.at_buses("load", values)
