"""Networks of pandapower, in memory and in JSON files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from opfmodel.errors import CaseError, OpfmodelError
from opfmodel.network.cases.pandapower.costs import Costs
from opfmodel.network.cases.pandapower.file import load, pandapower_text
from opfmodel.network.cases.pandapower.grid import Grid
from opfmodel.network.cases.pandapower.source import Source
from opfmodel.network.cases.pandapower.units import Units
from opfmodel.network.costs import Cost
from opfmodel.network.network import Network

__all__ = ["convert", "from_pandapower", "read_pandapower"]


def from_pandapower(
    net: Any, *, default_cost: Cost | None = None, lossy: bool = False, name: str | None = None
) -> Network:
    """Convert a pandapower network.

    Buses and branches are those of pandapower's own converter with the options of ``runpp``: switches,
    fused buses, taps, three-winding transformers, wards and impedances arrive as pandapower sees them. What
    injects is read from the tables, with ``controllable``, limits, costs and set-points as in ``runopp`` and
    ``runpp``. Fused buses become one; :attr:`Network.aliases` states which.

    Parameters
    ----------
    net
        A ``pandapowerNet``, which is not changed.
    default_cost
        Cost of units that an optimal power flow decides and that have no cost data; by default they cost
        nothing, as in pandapower, with a warning.
    lossy
        Accept that data without counterpart are lost, with a warning for each.
    name
        Name of the network; by default the one that it has in pandapower.

    Raises
    ------
    CaseError
        The network is not valid, or something would be lost.
    """
    return convert(net, "pandapower", default_cost, lossy, name)


def read_pandapower(
    path: Path, format: str | None, *, default_cost: Cost | None = None, lossy: bool = False
) -> Network | None:
    """Read a JSON file of pandapower.

    Returns None if the file has another format, or if pandapower is not installed and the file holds only
    what powerio reads faithfully. Parameters and errors are those of :func:`from_pandapower`.
    """
    text = pandapower_text(path, format)
    net = None if text is None else load(path, text)
    if net is None:
        return None
    return convert(net, str(path), default_cost, lossy, str(net.get("name") or "") or path.stem)


def convert(net: Any, where: str, default_cost: Cost | None, lossy: bool, name: str | None) -> Network:
    """Convert a pandapower network that comes from ``where``, for messages."""
    if not hasattr(net, "bus") or not hasattr(net, "sn_mva"):
        raise CaseError(f"{where}: a {type(net).__name__}; must be a network of pandapower")
    source = Source(net, where)
    try:
        network = Network(name or str(net.get("name") or "") or "pandapower", float(net.sn_mva))
        grid = Grid(source)
        grid.declare(network)
        Units(source, grid, Costs(source, default_cost)).declare(network)
    except CaseError:
        raise
    except OpfmodelError as error:
        raise CaseError(f"{where}: {error}") from error
    source.losses.settle(lossy)
    return network
