"""The four systems of Faulwasser and Engelmann: costs, their order, and what the paper observes."""

from __future__ import annotations

import ast
import importlib.util
import json
import sys
from functools import cache
from types import ModuleType

import numpy as np
import pytest
from conftest import DATA, SCENARIOS

import opfmodel as om
from opfmodel.check import check
from opfmodel.study.comparison import Comparison, compare, markdown

# An independent program, and the costs of the two step systems that it computed, in $; J_b is not unique.
PROGRAM = DATA / "paper" / "reference.py"
REFERENCE = json.loads(PROGRAM.with_name("reference.json").read_text(encoding="utf-8"))
SYSTEMS = [
    "case5-step",
    pytest.param("case5-random", marks=pytest.mark.slow),
    pytest.param("case118-step", marks=pytest.mark.slow(minutes=3)),
    pytest.param("case118-random", marks=pytest.mark.slow(minutes=3)),
]


@pytest.mark.parametrize("name", SYSTEMS)
def test_costs_and_that_storage_and_foresight_pay(name: str) -> None:
    """One test, since its loops take long and processes that share the tests would each run them."""
    found = compare(SCENARIOS / f"{name}.yaml")
    assert not found.failures
    if name.endswith("-step"):
        for cost, value in REFERENCE[name]["costs"].items():
            assert found.costs[cost] == pytest.approx(value, rel=5e-4), cost
    assert abs(found.difference("J_s")) < 5e-3
    assert found.costs["J_e"] < found.costs["J_s"] <= found.costs["J_t"] < found.costs["J_b"]
    if name == "case5-step":
        check_table(found)


def check_table(found: Comparison) -> None:
    """The table shows ours beside what is published."""
    shown = markdown([found]).splitlines()
    assert shown[0] == "| k$ | J_e | J_s | J_t | J_b |"
    assert shown[2].startswith("| case5-step | 972.61 | 976.35 |")
    assert shown[3] == "| published | 973.10 | 976.70 | 978.60 | 1,265.10 |"
    assert shown[4].startswith("| difference | -0.05 % |")


@cache
def reference() -> ModuleType:
    spec = importlib.util.spec_from_file_location("paper_reference", PROGRAM)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where dataclasses look for it
    spec.loader.exec_module(module)
    return module


def test_the_reference_program_shares_nothing_with_what_it_is_compared_to() -> None:
    imported = set()
    for node in ast.walk(ast.parse(PROGRAM.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            imported |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            imported.add(node.module.split(".")[0])
    assert "casadi" in imported
    assert not imported & {"opfmodel", "solvers"}


def test_the_reference_program_made_the_reference_costs() -> None:
    assert set(REFERENCE) == set(reference().SYSTEMS)
    grid = reference().case5_step()
    cost = reference().single_stage_cost(grid, reference().single_stages(grid))
    assert cost == pytest.approx(REFERENCE["case5-step"]["costs"]["J_s"], abs=0.1)


def test_a_plan_costs_what_it_costs_in_the_reference_program() -> None:
    module = reference()
    grid = module.case5_step()
    optima = module.single_stages(grid)
    goal = [values[:, : module.HORIZON] for values in optima.values()]
    plan = module.Problem(grid).solve(grid.demand[:, : module.HORIZON], module.initial(grid, optima), goal)
    cost = float(module.economic(grid, plan["pg"], plan["qg"], plan["e"][:, : module.HORIZON]))
    scenario = om.load_scenario(SCENARIOS / "case5-step.yaml")
    ours = scenario.problem.solve(initial=scenario.initial())
    assert ours.objective == pytest.approx(cost, rel=1e-6)


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
