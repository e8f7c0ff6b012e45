"""Plans: a network, horizon, formulation and objective compiled into one program, and its results."""

from opfmodel.plan.end import End
from opfmodel.plan.multistage import MultiStage
from opfmodel.plan.request import Initial
from opfmodel.plan.result import Plan
from opfmodel.plan.risk import Risk
from opfmodel.plan.security import Security

__all__ = ["End", "Initial", "MultiStage", "Plan", "Risk", "Security"]
