"""Reading of network files: each format has one reader, chosen by the file or by the name of the format."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from opfmodel.network.cases.pandapower import read_pandapower
from opfmodel.network.cases.powerio import read_powerio
from opfmodel.network.cases.pypsa import read_pypsa
from opfmodel.network.cases.simbench import read_simbench
from opfmodel.network.costs import Cost
from opfmodel.network.network import Network

__all__ = ["read_network"]


class _Reader(Protocol):
    """Reader of a format; it returns None for a file of another format, which it must not refuse."""

    def __call__(
        self, path: Path, format: str | None, *, default_cost: Cost | None, lossy: bool
    ) -> Network | None: ...


_READERS: Sequence[_Reader] = (read_simbench, read_pandapower, read_pypsa)
"""Readers of single formats, in order; powerio reads the files that none of them knows, or refuses them."""


def read_network(
    path: str | Path, *, default_cost: Cost | None = None, format: str | None = None, lossy: bool = False
) -> Network:
    """Read a network file.

    Buses are named after their number or identifier, generators ``gen1, gen2, ...`` in file order,
    branches ``FROM-TO`` (with suffixes ``#2``, ``#3`` for parallel branches), and loads, shunts and
    storages ``loadBUS``, ``shuntBUS`` and ``storageBUS``; readers of single formats, such as
    :func:`opfmodel.from_pandapower`, keep the names of the file.

    Parameters
    ----------
    path
        File, folder of a PyPSA CSV export, or a grid of SimBench, such as ``simbench:1-MV-rural--2-sw``.
        File, or folder of a PyPSA CSV export. PyPSA's folders and netCDF files are read with PyPSA, if it
        is installed, as by :func:`from_pypsa`.
    default_cost
        Cost of generators without cost data, for example in PSS/E files.
    format
        Name of the format, such as ``"psse"``, if it cannot be inferred from the file.
    lossy
        Whether to accept that data with electrical meaning are lost because opfmodel does not represent
        them. Each loss is then a :class:`CaseWarning`; otherwise one error lists all of them.

    Raises
    ------
    CaseError
        The file is missing, not a regular file, corrupt or in an unknown format; it contains invalid
        data; generators lack cost data and no ``default_cost`` is given; or something would be lost and
        ``lossy`` is false.

    Notes
    -----
    Equipment out of service is kept unchanged (:meth:`opfmodel.network.Component.check_declared`).
    """
    path = Path(path)
    for reader in _READERS:
        network = reader(path, format, default_cost=default_cost, lossy=lossy)
        if network is not None:
            return network
    return read_powerio(path, format, default_cost=default_cost, lossy=lossy)
