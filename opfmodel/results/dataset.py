"""Trajectories as labelled arrays in physical units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from opfmodel.data.calendar import Times
from opfmodel.network.arrays import PerUnitNetwork
from opfmodel.network.quantities import in_currency
from opfmodel.network.units import scale
from opfmodel.results.limits import limits

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["DEMAND", "dataset"]

Array = npt.NDArray[np.float64]

DEMAND = {"pd": ("p", "MW", "active"), "qd": ("q", "MVAr", "reactive")}
"""What every dataset has beside the quantities: field of the loads, unit and sort by name."""


def dataset(
    network: PerUnitNetwork, quantities: Mapping[str, tuple[str, str, str, Array]], times: Times
) -> xr.Dataset:
    """Build a dataset in physical units from per-unit arrays.

    Parameters
    ----------
    network
        Network arrays with the time series of the window.
    quantities
        ``(kind, unit, description, values)`` by name, with values of shape ``(items, stages)``. The
        kind "" means the entire system. The items of a kind that the network lacks are numbered.
    times
        Start of each stage.

    Returns
    -------
    xarray.Dataset
        Dimensions ``time`` and one per kind of component. Includes the demand ``pd``, ``qd`` of each bus,
        and the limits of the quantities, as ``vm_min``, ``vm_max`` and ``pg_ramp``, over ``time`` only where
        they vary.
    """
    import xarray as xr

    made = xr.Dataset(coords={"time": times.coordinate()})
    made = made.assign_coords({"bus": list(network.bus.names)})
    for kind, _, _, values in quantities.values():
        if kind and kind not in made.coords:
            table = network.tables.get(kind)
            made = made.assign_coords({kind: np.arange(len(values)) if table is None else list(table.names)})
            if table is not None and "bus" in table.arrays:
                at = [network.bus.names[b] for b in table.bus]
                made = made.assign_coords({f"{kind}_bus": (kind, at, {"long_name": f"bus of the {kind}"})})
    demand = {
        name: ("bus", unit, f"{sort} demand", _demand(network, field, len(times.steps)))
        for name, (field, unit, sort) in DEMAND.items()
    }
    for name, (kind, unit, description, values) in {**quantities, **demand}.items():
        physical = values * scale(unit, network.base_mva)
        attributes = {"units": in_currency(unit, network.currency), "long_name": description}
        made[name] = (("time", kind), physical.T, attributes) if kind else ("time", physical[0], attributes)
    for name, kind, unit, description, values in limits(network, quantities):
        if name not in quantities:
            physical = values * scale(unit, network.base_mva)
            attributes = {"units": unit, "long_name": description}
            varying = values.shape[1] > 1
            made[name] = (
                (("time", kind), physical.T, attributes) if varying else (kind, physical[:, 0], attributes)
            )
    return made


def _demand(network: PerUnitNetwork, field: str, stages: int) -> Array:
    values = network.load.arrays[field]
    return network.at_buses("load", np.broadcast_to(values, (len(values), stages)))
