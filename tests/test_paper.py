"""The four systems of Faulwasser and Engelmann: costs, their order, and what the paper observes."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from conftest import SCENARIOS

import opfmodel as om
from opfmodel.check import check
from opfmodel.study.comparison import Comparison, compare, markdown

# Costs of the two step systems from an independent program, in $; J_b is not unique.
INDEPENDENT = {
    "case5-step": {"J_e": 972.61e3, "J_s": 976.35e3, "J_t": 976.85e3},
    "case118-step": {"J_e": 6309.98e3, "J_s": 6386.57e3, "J_t": 6386.81e3},
}
SYSTEMS = [
    "case5-step",
    "case5-random",
    pytest.param("case118-step", marks=pytest.mark.slow),
    pytest.param("case118-random", marks=pytest.mark.slow),
]


@cache
def comparison(name: str) -> Comparison:
    return compare(SCENARIOS / f"{name}.yaml")


@pytest.mark.parametrize("name", SYSTEMS)
def test_costs(name: str) -> None:
    found = comparison(name)
    assert not found.failures
    for cost, value in INDEPENDENT.get(name, {}).items():
        assert found.costs[cost] == pytest.approx(value, rel=5e-4), cost
    assert abs(found.difference("J_s")) < 5e-3


@pytest.mark.parametrize("name", SYSTEMS)
def test_storage_and_foresight_pay(name: str) -> None:
    costs = comparison(name).costs
    assert costs["J_e"] < costs["J_s"] <= costs["J_t"] < costs["J_b"]


def test_the_table_shows_ours_beside_what_is_published() -> None:
    shown = markdown([comparison("case5-step")]).splitlines()
    assert shown[0] == "| k$ | J_e | J_s | J_t | J_b |"
    assert shown[2].startswith("| case5-step | 972.61 | 976.35 |")
    assert shown[3] == "| published | 973.10 | 976.70 | 978.60 | 1,265.10 |"
    assert shown[4].startswith("| difference | -0.05 % |")


def test_ramps_are_active_at_the_demand_steps_of_the_5_bus_system() -> None:
    scenario = om.load_scenario(SCENARIOS / "case5-step.yaml")
    run = scenario.simulate()
    ramp = np.array([g.ramp for g in scenario.network.of(om.Generator).values()])
    used = np.abs(np.diff(run.data["pg"].values, axis=0)) / ramp  # row t: the change into step t + 1
    at_limit = (used > 0.999).any(axis=1)
    assert at_limit[[7, 15, 29, 40]].all()  # into 8 and 30, where demand changes, and back after 15 and 40
    assert at_limit.sum() == 4


@pytest.mark.slow
def test_upper_voltage_bounds_are_active_in_the_118_bus_system() -> None:
    scenario = om.load_scenario(SCENARIOS / "case118-step.yaml", overrides={"time.steps": 6})
    run = scenario.simulate()
    assert run.status == "done"
    most = np.array([bus.vm[1] for bus in scenario.network.of(om.Bus).values()])
    assert ((run.data["vm"].values > most - 1e-6).sum(axis=1) >= 1).all()
    series = scenario.profiles
    assert check(scenario.network, run.data, series).max_violation <= 1e-6
