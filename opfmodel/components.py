"""Public import path of the components of :mod:`opfmodel.network`, for devices from other packages."""

from opfmodel.network.component import Component
from opfmodel.network.components import (
    BUILT_IN,
    Branch,
    Budget,
    Bus,
    Connection,
    DCLine,
    FlexibleLoad,
    Generator,
    Load,
    Renewable,
    Reserve,
    Shunt,
    Storage,
)
from opfmodel.network.costs import Cost, PiecewiseLinear, Polynomial
from opfmodel.network.fields import (
    TableField,
    adjustable,
    at_bus,
    choice,
    flag,
    in_service,
    number,
    points,
    span,
    weights,
)
from opfmodel.network.network import Network, name_pattern

__all__ = [
    "BUILT_IN",
    "Branch",
    "Budget",
    "Bus",
    "Component",
    "Connection",
    "Cost",
    "DCLine",
    "FlexibleLoad",
    "Generator",
    "Load",
    "Network",
    "PiecewiseLinear",
    "Polynomial",
    "Renewable",
    "Reserve",
    "Shunt",
    "Storage",
    "TableField",
    "adjustable",
    "at_bus",
    "choice",
    "flag",
    "in_service",
    "name_pattern",
    "number",
    "points",
    "span",
    "weights",
]
