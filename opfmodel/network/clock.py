"""Quantities of components that follow from the clock; see :attr:`Component.clocked`."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from opfmodel.data.calendar import Times
from opfmodel.network.arrays import PerUnitNetwork
from opfmodel.network.network import Network
from opfmodel.network.units import scale

__all__ = ["check_clocked", "clocked", "clocked_fields"]

Fields = dict[tuple[str, str], npt.NDArray[np.float64]]


def clocked(network: Network, arrays: PerUnitNetwork, times: Times) -> Fields:
    """Quantities that follow from the clock, per unit ``(items, steps)`` by ``(kind, field)``."""
    out: Fields = {}
    for kind, field in clocked_fields(arrays):
        table = arrays.tables[kind]
        values = [network[name].resolved().at_clock(times)[field] for name in table.names]
        out[kind, field] = np.array(values) / scale(table.units[field], arrays.base_mva)
    return out


def check_clocked(
    network: Network, arrays: PerUnitNetwork, times: Times, lengths: npt.NDArray[np.intp]
) -> None:
    """Raise :class:`IncompatibleError` if stages cannot represent what follows from the clock.

    Parameters
    ----------
    times, lengths
        The beginning of each stage, and its number of steps.
    """
    for kind in dict.fromkeys(kind for kind, _ in clocked_fields(arrays)):
        for name in arrays.tables[kind].names:
            network[name].resolved().check_clock(name, times, lengths)


def clocked_fields(arrays: PerUnitNetwork) -> list[tuple[str, str]]:
    """``(kind, field)`` pairs of the quantities that follow from the clock, of components in service."""
    return [
        (kind, field)
        for kind, table in arrays.tables.items()
        for field, clocked in table.kind.clocked.items()
        if len(table) and (clocked.of is None or np.isfinite(table.arrays[clocked.of]).any())
    ]
