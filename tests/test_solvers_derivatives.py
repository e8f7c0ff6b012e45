"""Derivatives of whole programs and of every template against finite differences."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from conftest import demand, everything, examples
from hypothesis import given, settings
from hypothesis import strategies as st

import opfmodel as om
from opfmodel.plugins import plugins
from solvers import Evaluator, Placement, Program, ProgramBuilder, largest, total
from solvers.template import Degree, Template

STEP = 1e-6
FORMULATIONS = [n for n, p in plugins("formulation").items() if p.origin == "opfmodel"]


@cache
def program(formulation: str) -> Program:
    """A program with every built-in device and feature, on three stages."""
    grid = everything()
    grid.update("battery", exclusive=True)
    problem = om.MultiStage(
        grid,
        horizon=3,
        formulation=formulation,
        objective=om.Economic(1e-3, 1e-3),
        profiles=demand(3),
        end=om.End(cyclic=True, price=3.0),
    )
    return problem.compile()


def placements(formulation: str) -> list[Placement]:
    p = program(formulation)
    return [*p.constraints, *p.costs, *p.cone_values]


@pytest.mark.parametrize("formulation", FORMULATIONS)
@given(seed=st.integers(0, 2**32 - 1))
@examples(10)
def test_template_derivatives(formulation: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    for placement in placements(formulation):
        check_template(placement.template, rng)


def check_template(template: Template, rng: np.random.Generator) -> None:
    """Jacobian and Hessian at a random point against differences."""
    v = rng.uniform(-1.5, 1.5, template.n_variables)
    q = rng.uniform(-1.5, 1.5, template.n_parameters)
    weights = rng.normal(size=template.n_outputs)
    jacobian = np.zeros((template.n_outputs, template.n_variables))
    jacobian[template.jacobian_pattern] = np.asarray(template.jacobian(v, q)).ravel()
    hessian = np.zeros((template.n_variables,) * 2)
    hessian[template.hessian_pattern] = np.asarray(template.hessian(v, q, weights)).ravel()
    hessian = hessian + np.tril(hessian, -1).T

    def value(at: np.ndarray) -> np.ndarray:
        return np.asarray(template.value(at, q)).ravel()

    def slope(at: np.ndarray) -> np.ndarray:
        out = np.zeros_like(jacobian)
        out[template.jacobian_pattern] = np.asarray(template.jacobian(at, q)).ravel()
        return weights @ out

    for exact, approximate in ((jacobian, differences(value, v)), (hessian, differences(slope, v))):
        error = np.abs(exact - approximate).max(initial=0)
        assert error <= 1e-6 * (1 + np.abs(exact).max(initial=0)), template
    if template.degree <= Degree.LINEAR:
        assert template.hessian_pattern[0].size == 0, template


def differences(function, at: np.ndarray) -> np.ndarray:
    """Central differences of a vector function: one column per variable."""
    columns = [(function(at + STEP * e) - function(at - STEP * e)) / (2 * STEP) for e in np.eye(at.size)]
    return np.array(columns).T.reshape(-1, at.size) if at.size else np.zeros((0, 0))


@pytest.mark.parametrize("formulation", FORMULATIONS)
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=5)
def test_whole_program_along_random_directions(formulation: str, seed: int) -> None:
    p = program(formulation)
    check_along_directions(p, np.random.default_rng(seed))


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_a_variable_that_enters_a_template_twice(seed: int) -> None:
    build = ProgramBuilder()
    x = build.variable("x", 3, 2, start=0.3)
    index = [0, 0, 1, 2]
    build.minimize(np.exp(x[index] * x[[0, 1, 1, 0]]))
    rows = build.rows("r", 2, 2)
    build.add((np.sin(x[[0, 1]] * x[[0, 2]]), x[[1, 1]] ** 3), into=(rows, rows[[1, 0]]))
    build.constrain("s", total(x**2 * largest(0.0, x)) <= 3.0)
    check_along_directions(build.build(), np.random.default_rng(seed))


def check_along_directions(p: Program, rng: np.random.Generator) -> None:
    """Gradient, Jacobian and Hessian times a random direction against differences."""
    evaluator, at = Evaluator(p), p.default
    x = np.clip(at.start, -5, 5) + rng.uniform(-0.1, 0.1, p.n_variables)
    d, lam = rng.normal(size=p.n_variables), rng.normal(size=p.n_rows)
    d /= np.linalg.norm(d)

    def along(function):
        return (function(x + STEP * d) - function(x - STEP * d)) / (2 * STEP)

    def close(exact, approximate) -> bool:
        return np.abs(exact - approximate).max(initial=0) <= 1e-5 * (1 + np.abs(exact).max(initial=0))

    q = at.parameters
    assert close(evaluator.gradient(x, q) @ d, along(lambda z: evaluator.objective(z, q)))
    assert close(evaluator.jacobian(x, q) @ d, along(lambda z: evaluator.rows(z, q)))
    upper = evaluator.hessian(x, q, 0.7, lam)
    full = upper + upper.T
    full.setdiag(upper.diagonal())

    def lagrangian_slope(z):
        return 0.7 * evaluator.gradient(z, q) + evaluator.jacobian(z, q).T @ lam

    assert close(full @ d, along(lagrangian_slope))
    values, jacobian = evaluator.cones(x, q)
    assert values.size == p.n_cone_values
    assert close(jacobian @ d, along(lambda z: evaluator.cones(z, q)[0]))
