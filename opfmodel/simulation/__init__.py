"""The closed loop: a controller that plans, a plant that responds, and the record of the run."""

from opfmodel.plan.attempt import Attempt
from opfmodel.simulation.checkpoint import Checkpoint
from opfmodel.simulation.controller import Controller, OnInfeasible
from opfmodel.simulation.inputs import changed, inputs
from opfmodel.simulation.loop import check_commitment, check_first_stage, check_response, simulate
from opfmodel.simulation.outages import Outage, Outages
from opfmodel.simulation.plants.base import Plant, Step
from opfmodel.simulation.plants.nominal import NominalPlant
from opfmodel.simulation.plants.power_flow import PowerFlow
from opfmodel.simulation.plants.redispatch import Redispatch
from opfmodel.simulation.run import Run

__all__ = [
    "Attempt",
    "Checkpoint",
    "Controller",
    "NominalPlant",
    "OnInfeasible",
    "Outage",
    "Outages",
    "Plant",
    "PowerFlow",
    "Redispatch",
    "Run",
    "Step",
    "changed",
    "check_commitment",
    "check_first_stage",
    "check_response",
    "inputs",
    "simulate",
]
