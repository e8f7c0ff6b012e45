"""The modelling interface of devices, formulations and objectives.

A :class:`Model` collects the declarations of one plan into a program. A :class:`NumericStage` offers
the same quantities as arrays, so a cost is written once, compiled for a solver and evaluated on a
trajectory.
"""

from opfmodel.model.constraint import CustomConstraint, Linear, PhysicalStage
from opfmodel.model.declared import Bound, BoundSource, Injection, Price, Published, State
from opfmodel.model.device import Device
from opfmodel.model.elastic import Elastic, Shortage, Side, Slack, Soft
from opfmodel.model.model import Model
from opfmodel.model.peak import declare_peak
from opfmodel.model.setting import Setting, declare_setting
from opfmodel.model.stage import NumericStage, Quantities, Stage
from solvers import largest, total

__all__ = [
    "Bound",
    "BoundSource",
    "CustomConstraint",
    "Device",
    "Elastic",
    "Injection",
    "Linear",
    "Model",
    "NumericStage",
    "PhysicalStage",
    "Price",
    "Published",
    "Quantities",
    "Setting",
    "Shortage",
    "Side",
    "Slack",
    "Soft",
    "Stage",
    "State",
    "declare_peak",
    "declare_setting",
    "largest",
    "total",
]
