"""Scenarios: a network, time series, a controller and a closed loop in one YAML document."""

from opfmodel.scenario.load import laid_over, load_scenario
from opfmodel.scenario.scenario import Scenario

__all__ = ["Scenario", "laid_over", "load_scenario"]
