"""What is checked of each kind of component, one file each."""

from __future__ import annotations

from opfmodel.check.equipment.base import Equipment
from opfmodel.check.equipment.budgets import Budgets
from opfmodel.check.equipment.connections import Connections
from opfmodel.check.equipment.dc_lines import DCLines
from opfmodel.check.equipment.flexible_loads import FlexibleLoads
from opfmodel.check.equipment.generators import Generators
from opfmodel.check.equipment.loads import Loads
from opfmodel.check.equipment.renewables import Renewables
from opfmodel.check.equipment.reserves import Reserves
from opfmodel.check.equipment.settings import Branches
from opfmodel.check.equipment.shunts import Shunts
from opfmodel.check.equipment.storages import Storages

__all__ = ["EQUIPMENT", "Equipment"]

EQUIPMENT: tuple[type[Equipment], ...] = (
    Branches,
    DCLines,
    Generators,
    Renewables,
    Storages,
    Connections,
    Loads,
    FlexibleLoads,
    Shunts,
    Reserves,
    Budgets,
)
