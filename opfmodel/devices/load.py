"""Loads."""

from __future__ import annotations

from opfmodel.components import Load
from opfmodel.model import Device, Model
from opfmodel.network import Table

__all__ = ["LoadDevice"]


class LoadDevice(Device):
    """Demand ``p + jq`` that is served as it is; a parameter of every solve."""

    component = Load

    def declare(self, model: Model, table: Table) -> None:
        """Withdraw the demand from its bus."""
        p, q = model.parameter("load", "p"), model.parameter("load", "q")
        model.inject(table.bus, p=-p, q=-q)
