"""The closed loop: a controller that plans, a plant that answers, and what happened."""

from opfmodel.simulation.loop import Controller, OnInfeasible, Run, check_answer, simulate
from opfmodel.simulation.plants import NominalPlant, Plant, PowerFlow, Redispatch, Step

__all__ = [
    "Controller",
    "NominalPlant",
    "OnInfeasible",
    "Plant",
    "PowerFlow",
    "Redispatch",
    "Run",
    "Step",
    "check_answer",
    "simulate",
]
