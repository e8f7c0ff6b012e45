"""Trajectories as labelled arrays in physical units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from opfmodel.data.calendar import Times
from opfmodel.data.labelled import Labelled, Variable
from opfmodel.network.arrays import PerUnitNetwork
from opfmodel.network.quantities import in_currency
from opfmodel.network.units import scale
from opfmodel.results.limits import limits

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["DEMAND", "dataset", "labelled"]

Array = npt.NDArray[np.float64]

_ENDS = ("bus", "from_bus", "to_bus")  # fields that hold a bus

DEMAND = {"pd": ("p", "MW", "active"), "qd": ("q", "MVAr", "reactive")}
"""What every dataset has beside the quantities: field of the loads, unit and sort by name."""


def dataset(
    network: PerUnitNetwork, quantities: Mapping[str, tuple[str, str, str, Array]], times: Times
) -> xr.Dataset:
    """Build a dataset in physical units from per-unit arrays; see :func:`labelled`."""
    return labelled(network, quantities, times).dataset()


def labelled(
    network: PerUnitNetwork, quantities: Mapping[str, tuple[str, str, str, Array]], times: Times
) -> Labelled:
    """Label per-unit arrays, and convert them to physical units.

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
    Labelled
        Dimensions ``time`` and one per kind of component, whose buses and, if known, places are coordinates.
        Includes the demand ``pd``, ``qd`` of each bus,
        and the limits of the quantities, as ``vm_min``, ``vm_max`` and ``pg_ramp``, over ``time`` only where
        they vary.
    """
    dimension, moments, about = times.coordinate()
    made = Labelled({"time": Variable((dimension,), moments, about)})
    made.coords["bus"] = Variable(("bus",), np.array(list(network.bus.names)), {})
    for axis in "xy":
        place = network.bus.arrays[axis][:, 0]
        if np.isfinite(place).any():
            about = {"long_name": f"place of the bus, {axis}"}
            made.coords[f"bus_{axis}"] = Variable(
                ("bus",), np.where(np.isfinite(place), place, np.nan), about
            )
    for kind, _, _, values in quantities.values():
        if kind and kind not in made.coords:
            table = network.tables.get(kind)
            names = np.arange(len(values)) if table is None else np.array(list(table.names))
            made.coords[kind] = Variable((kind,), names, {})
            for end in _ENDS:
                if table is not None and end in table.arrays:
                    at = np.array([network.bus.names[b] for b in table.arrays[end]])
                    about = {"long_name": f"{end.replace('_', ' ')} of the {kind}"}
                    made.coords[f"{kind}_{end}"] = Variable((kind,), at, about)
    demand = {
        name: ("bus", unit, f"{sort} demand", _demand(network, field, len(times.steps)))
        for name, (field, unit, sort) in DEMAND.items()
    }
    for name, (kind, unit, description, values) in {**quantities, **demand}.items():
        physical = values * scale(unit, network.base_mva)
        attributes = {"units": in_currency(unit, network.currency), "long_name": description}
        dims, part = (("time", kind), physical.T) if kind else (("time",), physical[0])
        made.data_vars[name] = Variable(dims, part, attributes)
    for name, kind, unit, description, values in limits(network, quantities):
        if name not in quantities:
            physical = values * scale(unit, network.base_mva)
            attributes = {"units": unit, "long_name": description}
            dims, part = (("time", kind), physical.T) if values.shape[1] > 1 else ((kind,), physical[:, 0])
            made.data_vars[name] = Variable(dims, part, attributes)
    return made


def _demand(network: PerUnitNetwork, field: str, stages: int) -> Array:
    values = network.load.arrays[field]
    return network.at_buses("load", np.broadcast_to(values, (len(values), stages)))
