"""Built-in kinds of components, one file each.

Quantities are in physical units: MW, MVAr, MVA, MWh, hours, degrees and $. Impedances are per unit on the
network"s ``base_mva``, and voltages are per unit.
"""

from __future__ import annotations

from opfmodel.network.component import Component
from opfmodel.network.components.branch import Branch
from opfmodel.network.components.budget import Budget
from opfmodel.network.components.bus import Bus
from opfmodel.network.components.connection import Connection
from opfmodel.network.components.dc_line import DCLine
from opfmodel.network.components.flexible_load import FlexibleLoad
from opfmodel.network.components.generator import Generator
from opfmodel.network.components.load import Load
from opfmodel.network.components.renewable import Renewable
from opfmodel.network.components.reserve import Reserve
from opfmodel.network.components.shunt import Shunt
from opfmodel.network.components.storage import Storage

__all__ = [
    "BUILT_IN",
    "Branch",
    "Budget",
    "Bus",
    "Connection",
    "DCLine",
    "FlexibleLoad",
    "Generator",
    "Load",
    "Renewable",
    "Reserve",
    "Shunt",
    "Storage",
]

BUILT_IN: tuple[type[Component], ...] = (
    Bus,
    Branch,
    DCLine,
    Generator,
    Renewable,
    Storage,
    Connection,
    Load,
    FlexibleLoad,
    Shunt,
    Reserve,
    Budget,
)
"""Kinds of this package; devices from other packages define their own."""
