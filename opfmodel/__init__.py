"""Declarative multi-stage AC optimal power flow with storage, in receding horizon.

>>> import opfmodel as om
>>> grid = om.Network("one-bus")
>>> grid.bus = om.Bus()
>>> grid.unit = om.Generator("bus", p=(0, 100), cost=om.Polynomial(0, 20, 0))
>>> grid.town = om.Load("bus", p=50)
>>> plan = om.MultiStage(grid, horizon=2).solve()
>>> plan.status
'globally_optimal'
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from opfmodel.cases import read_network, write_network
    from opfmodel.components import (
        Branch,
        Bus,
        Generator,
        Load,
        Network,
        PiecewiseLinear,
        Polynomial,
        Shunt,
        Storage,
    )
    from opfmodel.data.series import Profiles
    from opfmodel.errors import OpfmodelError
    from opfmodel.forecasts import Forecast
    from opfmodel.model import Elastic
    from opfmodel.objectives.base import Objective
    from opfmodel.objectives.economic import Economic
    from opfmodel.objectives.linear_quadratic import LinearQuadratic
    from opfmodel.objectives.loss_minimisation import LossMinimisation
    from opfmodel.objectives.setpoint_tracking import Setpoints, SetpointTracking
    from opfmodel.objectives.state_of_charge_tracking import StateOfChargeTracking
    from opfmodel.objectives.stored_energy_value import StoredEnergyValue
    from opfmodel.objectives.voltage_deviation import VoltageDeviation
    from opfmodel.plan import End, MultiStage, Plan
    from opfmodel.plan.single_stage import SingleStageSequence, single_stage_sequence
    from opfmodel.scenario import Scenario, load_scenario
    from opfmodel.simulation import Controller, NominalPlant, Plant, PowerFlow, Redispatch, Run, simulate
    from solvers.expression import largest, total

# Public names and where they live; imported at first use, so that "import opfmodel" stays light.
_HOMES = {
    "opfmodel.cases": ("read_network", "write_network"),
    "opfmodel.components": (
        "Branch",
        "Bus",
        "Generator",
        "Load",
        "Network",
        "PiecewiseLinear",
        "Polynomial",
        "Shunt",
        "Storage",
    ),
    "opfmodel.model": ("Elastic",),
    "opfmodel.errors": ("OpfmodelError",),
    "opfmodel.forecasts": ("Forecast",),
    "opfmodel.objectives.base": ("Objective",),
    "opfmodel.objectives.economic": ("Economic",),
    "opfmodel.objectives.linear_quadratic": ("LinearQuadratic",),
    "opfmodel.objectives.loss_minimisation": ("LossMinimisation",),
    "opfmodel.objectives.setpoint_tracking": (
        "SetpointTracking",
        "Setpoints",
    ),
    "opfmodel.objectives.state_of_charge_tracking": ("StateOfChargeTracking",),
    "opfmodel.objectives.stored_energy_value": ("StoredEnergyValue",),
    "opfmodel.objectives.voltage_deviation": ("VoltageDeviation",),
    "opfmodel.plan": ("End", "MultiStage", "Plan"),
    "opfmodel.data.series": ("Profiles",),
    "opfmodel.scenario": ("Scenario", "load_scenario"),
    "opfmodel.plan.single_stage": ("SingleStageSequence", "single_stage_sequence"),
    "opfmodel.simulation": (
        "Controller",
        "NominalPlant",
        "Plant",
        "PowerFlow",
        "Redispatch",
        "Run",
        "simulate",
    ),
    "solvers.expression": ("largest", "total"),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}

__all__ = [
    "Branch",
    "Bus",
    "Controller",
    "Economic",
    "Elastic",
    "End",
    "Forecast",
    "Generator",
    "LinearQuadratic",
    "Load",
    "LossMinimisation",
    "MultiStage",
    "Network",
    "NominalPlant",
    "Objective",
    "OpfmodelError",
    "PiecewiseLinear",
    "Plan",
    "Plant",
    "Polynomial",
    "PowerFlow",
    "Profiles",
    "Redispatch",
    "Run",
    "Scenario",
    "SetpointTracking",
    "Setpoints",
    "Shunt",
    "SingleStageSequence",
    "StateOfChargeTracking",
    "Storage",
    "StoredEnergyValue",
    "VoltageDeviation",
    "largest",
    "load_scenario",
    "read_network",
    "simulate",
    "single_stage_sequence",
    "total",
    "write_network",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'opfmodel' has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return __all__
