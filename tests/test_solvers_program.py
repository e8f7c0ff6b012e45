"""Blocks, expressions, builders and instances: stating a program."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import solvers
from solvers import (
    Degree,
    Evaluator,
    Kind,
    ProgramBuilder,
    ProgramError,
    classify,
    largest,
    largest_by,
    prepare,
    total,
)
from solvers.expression import _UFUNCS
from solvers.folding import fold_affine


def evaluate(
    build: ProgramBuilder, expression: solvers.Expression, values: dict[str, np.ndarray]
) -> np.ndarray:
    """Value of an expression at given values of the variables."""
    build.output("wanted", expression)
    program = build.build()
    x = np.zeros(program.n_variables)
    for name, array in values.items():
        x[program.variables[name].slice] = array.ravel(order="F")
    return Evaluator(program).outputs(x, program.default.parameters)["wanted"]


arrays = st.integers(0, 2**32 - 1).map(lambda seed: np.random.default_rng(seed).uniform(0.5, 2.0, (3, 4)))


@given(a=arrays, b=arrays)
def test_arithmetic_means_what_it_means_for_arrays(a: np.ndarray, b: np.ndarray) -> None:
    def formula(x, y):  # the same text for both engines
        per_item, per_stage = np.array([1.0, 2.0, 3.0])[:, None], np.array([[1.0, -1.0, 0.5, 2.0]])
        return (
            np.sin(x) * y**2 - per_item / x + per_stage * np.exp(-y) + np.sqrt(x * y) - (2 - np.log(x))
        ) / 3.0 + (-x)

    build = ProgramBuilder()
    x, y = build.variable("x", 3, 4), build.variable("y", 3, 4)
    assert_allclose(evaluate(build, formula(x, y), {"x": a, "y": b}), formula(a, b), rtol=1e-12)


# Functions, each with an interval on which it is smooth; of two arguments both are drawn from it.
FUNCTIONS: dict[np.ufunc, tuple[float, float]] = {
    np.positive: (-2, 2), np.negative: (-2, 2), np.reciprocal: (0.5, 2), np.square: (-2, 2), np.sqrt: (0.5, 2),
    np.cbrt: (-2, -0.5), np.exp: (-2, 2), np.exp2: (-2, 2), np.expm1: (-1e-6, 1e-6), np.log: (0.5, 2),
    np.log2: (0.5, 2), np.log10: (0.5, 2), np.log1p: (-1e-6, 1e-6), np.deg2rad: (-90, 90),
    np.radians: (-90, 90), np.rad2deg: (-2, 2), np.degrees: (-2, 2), np.sin: (-2, 2), np.cos: (-2, 2),
    np.tan: (-1, 1), np.arcsin: (-0.8, 0.8), np.arccos: (-0.8, 0.8), np.arctan: (-2, 2), np.sinh: (-2, 2),
    np.cosh: (-2, 2), np.tanh: (-2, 2), np.arcsinh: (-2, 2), np.arccosh: (1.5, 3), np.arctanh: (-0.8, 0.8),
    np.add: (-2, 2), np.subtract: (-2, 2), np.multiply: (-2, 2), np.true_divide: (0.5, 2),
    np.power: (0.5, 2), np.float_power: (0.5, 2), np.hypot: (0.5, 2), np.arctan2: (0.5, 2),
}  # fmt: skip


def test_every_function_is_tested() -> None:
    assert set(FUNCTIONS) == set(_UFUNCS)


@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda f: f.__name__)
@given(data=st.data())
@settings(max_examples=20)
def test_functions_are_those_of_numpy_with_their_gradients(function: np.ufunc, data: st.DataObject) -> None:
    low, high = FUNCTIONS[function]
    inside = st.floats(low, high)
    given = [data.draw(st.lists(inside, min_size=2, max_size=2)) for _ in range(function.nin)]
    at = np.array(given)  # (arguments, items)
    build = ProgramBuilder()
    arguments = [build.variable(f"x{i}", 2) for i in range(function.nin)]
    build.minimize(function(*arguments))
    build.output("values", function(*arguments))
    program = build.build()
    evaluator, none = Evaluator(program), program.default.parameters
    assert_allclose(
        evaluator.outputs(at.ravel(), none)["values"].ravel(), function(*at), rtol=1e-13, atol=1e-19
    )
    step = 1e-6 * max(abs(low), abs(high))
    slopes = [
        (function(*(at + step * e[:, None])) - function(*(at - step * e[:, None]))) / (2 * step)
        for e in np.eye(function.nin)
    ]
    assert_allclose(evaluator.gradient(at.ravel(), none), np.concatenate(slopes), rtol=1e-6, atol=1e-8)


@given(a=arrays, rows=st.lists(st.integers(0, 2), min_size=1, max_size=5), first=st.integers(0, 3))
def test_slicing_means_what_it_means_for_arrays(a: np.ndarray, rows: list[int], first: int) -> None:
    build = ProgramBuilder()
    x = build.variable("x", 3, 4)
    product = (x * np.arange(1.0, 4.0)[:, None])[rows, first:]
    expected = (a * np.arange(1.0, 4.0)[:, None])[rows, first:]
    assert product.shape == expected.shape
    assert_allclose(evaluate(build, product, {"x": a}), expected)


@pytest.mark.parametrize("stages", [2, 50])
def test_what_repeats_in_time_is_stored_once(stages: int) -> None:
    build = ProgramBuilder()
    ratio = np.arange(1.0, 4.0)[:, None]
    x = build.variable("x", 3, stages, lower=-ratio, upper=ratio)
    flow = (x * ratio)[[0, 1, 1, 2]]
    build.add(flow, into=build.rows("balance", 4, stages))
    build.output("flow", flow)
    program = build.build()
    assert program.n_parameters == 4  # the ratios of the four flows
    block = program.variables["x"]
    assert_allclose(block.upper, np.broadcast_to(ratio, (3, stages)))
    for view in (block.lower, block.upper, block.value):
        assert not view.flags.writeable and view.strides[1] == 0
    assert all(index.size == 4 for index in program.outputs["flow"].parameters)


def test_equal_quantities_cancel() -> None:
    build = ProgramBuilder()
    x = build.variable("x", 3, 4)
    assert evaluate(build, x[[0, 1]] - x[:2], {"x": np.ones((3, 4))}).tolist() == np.zeros((2, 4)).tolist()
    assert (x[[0, 1]] - x[:2]).formula.is_zero()


def test_a_total_reaches_rows_and_costs() -> None:
    build = ProgramBuilder()
    x = build.variable("x", 3, 2, lower=0.0)
    build.minimize(2 * total(np.array([1.0, 2.0, 3.0])[:, None] * x) + 5.0)
    build.constrain("enough", total(x) - 1.0 >= np.array([2.0, 4.0]))
    solution = solvers.solve(build.build())
    assert solution.objective == pytest.approx(2 * (3.0 + 5.0) + 2 * 5.0, abs=1e-5)
    assert_allclose(solution.value("x")[0], [3.0, 5.0], atol=1e-6)


def test_totals_of_numbers_are_sums_per_stage() -> None:
    assert total(np.arange(6.0).reshape(2, 3)).tolist() == [3.0, 5.0, 7.0]


@given(a=arrays)
def test_the_largest_is_exact_when_minimised(a: np.ndarray) -> None:
    build = ProgramBuilder()
    x = build.variable("x", 3, 4, lower=a, upper=a)
    build.minimize(largest(1.0, x, 3.0 - 2.0 * x))
    expected = np.maximum.reduce([np.ones_like(a), a, 3.0 - 2.0 * a])
    assert solvers.solve(build.build()).objective == pytest.approx(expected.sum(), rel=1e-6)
    assert_allclose(largest(1.0, a, 3.0 - 2.0 * a), expected)


def test_a_program_says_which_variables_are_maxima_whatever_they_are_called() -> None:
    build = ProgramBuilder()
    x = build.variable("largest_1", 3, 4, 0.0, 1.0)
    build.rows("largest_1_piece_1", 3, 4)
    build.minimize(largest(0.0, x - 0.5))
    build.minimize(largest_by(np.array([0, 0, 1]), 2.0 * x, 2))
    program = build.build()
    first, second = program.epigraphs
    assert (first.variables.shape, len(first.pieces)) == ((3, 4), 2)
    assert (second.variables.shape, [rows.shape for rows in second.pieces]) == ((2, 4), [(3, 4)])
    known = {*first.pieces, *second.pieces}
    assert {name for name, rows in program.rows.items() if rows not in known} == {"largest_1_piece_1"}
    assert program.variables["largest_1"] not in (first.variables, second.variables)


@given(a=arrays)
def test_the_largest_of_totals_has_one_value_per_stage(a: np.ndarray) -> None:
    build = ProgramBuilder()
    x = build.variable("x", 3, 4, a, a)
    build.minimize(2.0 * largest(0.0, total(x) - 4.0, 3.0 - total(x)))
    expected = largest(0.0, total(a) - 4.0, 3.0 - total(a))
    assert expected.shape == (4,)
    assert solvers.solve(build.build()).objective == pytest.approx(2.0 * expected.sum(), abs=1e-6)
    with pytest.raises(ProgramError, match=r"one value per stage.* 3 items"):
        largest(x, total(x))


def test_a_cone_of_nothing_is_none() -> None:
    build = ProgramBuilder()
    x = build.variable("x", 2, lower=1.0)
    build.cone("empty", x[np.zeros(0, dtype=int)], x[np.zeros(0, dtype=int)])
    build.minimize(x)
    assert not build.build().cones
    assert classify(build.build()).kind is Kind.LINEAR


def test_terms_added_to_the_same_row_are_summed() -> None:
    build = ProgramBuilder()
    x = build.variable("x", 4, 3)
    rows = build.rows("pairs", 2, 3)
    build.add(x, into=rows[[0, 1, 0, 1]])
    build.add(10.0 * x[[0, 0]], into=rows)
    program = build.build()
    values = np.arange(12.0).reshape(4, 3)
    out = (
        Evaluator(program).rows(values.ravel(order="F"), program.default.parameters).reshape(2, 3, order="F")
    )
    assert_allclose(out[0], values[0] + values[2] + 10 * values[0])
    assert_allclose(out[1], values[1] + values[3] + 10 * values[0])


def test_a_template_can_be_placed_by_index_arrays() -> None:
    import casadi as ca

    v, q = ca.SX.sym("v", 2), ca.SX.sym("q")
    template = solvers.Template("products", v, q, ca.vertcat(v[0] * v[1], q * v[0]))
    build = ProgramBuilder()
    build.variable("x", 3)
    build.parameter("weight", 1, value=7.0)
    build.rows("out", 2)
    build.add(
        template,
        variables=np.array([[0, 1], [1, 2]]),
        parameters=np.array([[0, 0]]),
        into=np.array([[0, 0], [1, -1]]),
    )
    program = build.build()
    rows = Evaluator(program).rows(np.array([2.0, 3.0, 5.0]), program.default.parameters)
    assert rows.tolist() == [2 * 3 + 3 * 5, 7 * 2]


def test_degrees_and_kinds_are_derived() -> None:
    def kind(state) -> solvers.Structure:
        build = ProgramBuilder()
        x = build.variable("x", 2)
        state(build, x)
        return classify(build.build())

    assert kind(lambda b, x: b.minimize(3 * x)).kind is Kind.LINEAR
    assert kind(lambda b, x: b.minimize(x**2)).kind is Kind.QUADRATIC
    conic = kind(lambda b, x: b.cone("disc", 1.0, x[:1], x[1:]))
    assert (conic.kind, conic.culprits) == (Kind.CONIC, ("disc",))
    nonlinear = kind(lambda b, x: b.constrain("wave", np.sin(x) <= 0.5))
    assert (nonlinear.kind, nonlinear.culprits) == (Kind.NONLINEAR, ("wave",))
    assert kind(lambda b, x: b.constrain("square", x**2 <= 1.0)).kind is Kind.NONLINEAR
    build = ProgramBuilder()
    x = build.variable("x", 1)
    build.minimize(x**3)
    assert build.build().costs[0].template.degree is Degree.NONLINEAR


def test_instances_change_numbers_and_nothing_else() -> None:
    build = ProgramBuilder()
    build.variable("x", 2, 3, lower=0.0, upper=1.0)
    build.parameter("d", 2, 3, value=1.0)
    build.rows("r", 1, 3)
    program = build.build()
    at = program.instance(
        {"d": [1.0, 2.0]}, lower={"r": -1.0}, upper={"x": [[5.0, 6.0, 7.0]]}, start={"x": 0.5}
    )
    assert program.parameters["d"].read(at.parameters).tolist() == [[1, 1, 1], [2, 2, 2]]
    assert program.rows["r"].read(at.row_lower).tolist() == [[-1, -1, -1]]
    assert program.variables["x"].read(at.upper).tolist() == [[5, 6, 7], [5, 6, 7]]
    assert program.default.upper.max() == 1.0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda p: p.instance({"nope": 1.0}), "parameter block 'nope'.*: d$"),
        (lambda p: p.instance({"d": np.ones((5, 5))}), r"block 'd'.*\(5, 5\).*\(2, 3\)"),
        (lambda p: p.instance({"d": np.nan}), "block 'd', item 0, stage 0: .*not a number"),
        (
            lambda p: p.instance(lower={"x": 2.0}),
            "item 0, stage 0: lower bound 2 .* upper bound 1",
        ),
    ],
)
def test_bad_numbers_are_named(call, message: str) -> None:
    build = ProgramBuilder()
    build.variable("x", 2, 3, lower=0.0, upper=1.0)
    build.parameter("d", 2, 3)
    with pytest.raises(ProgramError, match=message):
        call(build.build())


@pytest.mark.parametrize(
    ("misuse", "message"),
    [
        (abs, r"absolute value is not smooth; write largest\(x, -x\)"),
        (np.abs, r"absolute value is not smooth; write largest\(x, -x\)"),
        (np.fabs, r"absolute value is not smooth; write largest\(x, -x\)"),
        (lambda x: np.maximum(0.0, x), r"maximum is not smooth; write largest\(x, y\)"),
        (lambda x: np.minimum(x, 1.0), r"minimum is not smooth; write -largest\(-x, -y\)"),
        (np.sign, "sign is not smooth"),
        (np.floor, "numpy.floor .*: add, arccos, .*tanh"),
        (np.sum, "numpy.sum .* total, .*tanh"),
        (np.add.reduce, "numpy.add.reduce .* total, .*tanh"),
        (lambda x: np.clip(x, 0.0, 1.0), "numpy.clip .*largest"),
        (lambda x: np.where(np.ones((2, 1)) > 0, x, 0.0), "numpy.where"),
        (lambda x: np.sin(x, where=np.ones((2, 1), dtype=bool)), "numpy.sin .*where"),
        (lambda x: np.ones(2) < x, "write <= or >="),
        (lambda x: max(0, x), r"largest\(0, x\)"),
        (lambda x: x[5], "5: there are 2 items"),
        (lambda x: x["a"], "'a': there are 2 items"),
        (lambda x: np.exp(total(x)), "numpy.exp .*sums"),
        (lambda x: np.multiply(x, total(x)), "numpy.multiply .*sums"),
        (lambda x: np.sum(total(x)), "numpy.sum"),
    ],
)
def test_a_function_that_is_not_available_is_named_with_those_that_are(misuse, message: str) -> None:
    x = ProgramBuilder().variable("x", 2)
    with pytest.raises(ProgramError, match=message):
        misuse(x)


def test_arrays_combine_with_sums_from_either_side() -> None:
    build = ProgramBuilder()
    x, array = build.variable("x", 2, 3), np.array([1.0, 2.0, 3.0])
    values = np.arange(6.0).reshape((2, 3))
    for stated, wanted in (
        (array + total(x), array + values.sum(axis=0)),
        (array - total(x), array - values.sum(axis=0)),
        (array * total(x), array * values.sum(axis=0)),
        (np.float64(2.0) * total(x), 2.0 * values.sum(axis=0)),
    ):
        rows = build.constrain(f"sum {len(build._rows)}", stated == 0.0)
        found = Evaluator(build.build()).rows(values.ravel(order="F"), build.build().default.parameters)
        assert_allclose(found[rows.index[0]], wanted)
    for constraint, bounds in ((array <= total(x), (0.0, np.inf)), (array >= total(x), (-np.inf, 0.0))):
        assert (constraint.lower, constraint.upper) == bounds


def test_misuse_of_expressions_is_refused() -> None:
    build, other = ProgramBuilder("one"), ProgramBuilder("two")
    x, y = build.variable("x", 2), other.variable("y", 2)
    with pytest.raises(ProgramError, match="two different programs"):
        x + y
    with pytest.raises(ProgramError, match=r"\(2, 1\) and \(3, 1\)"):
        x + np.ones(3)
    with pytest.raises(ProgramError, match="already"):
        build.rows("x", 1)
    with pytest.raises(ProgramError, match="no truth value"):
        bool(x <= 1.0)
    with pytest.raises(ProgramError, match="multiplied by numbers"):
        total(x) * total(x)
    with pytest.raises(ProgramError, match="power"):
        total(x) ** 2
    with pytest.raises(ProgramError, match=r"'z'.* lower bound 1 .* upper bound 0"):
        build.variable("z", 1, lower=1.0, upper=0.0)


def test_a_parameter_that_is_program_data_in_part_keeps_the_other_coefficients_constant() -> None:
    build = ProgramBuilder("partly")
    x = build.variable("x", 3, 2, 0.0, 10.0)
    p = build.parameter("p", 3, 2, [[2.0], [3.0], [4.0]], fixed=np.array([[True], [False], [True]]))
    build.constrain("row", p * x >= 6.0)
    build.minimize(total(x))
    program = build.build()
    folded = fold_affine(program, program.constraints, program.n_rows)
    assert [placement.count for placement in folded.rest] == [2]
    assert folded.a.nnz == 4
    session = prepare(program, "clarabel")
    for value in (3.0, 1.5):
        solution = session.solve(program.instance({"p": [[99.0], [value], [99.0]]}))
        assert solution.variable("x")[:, 0] == pytest.approx([3.0, 6.0 / value, 1.5], abs=1e-6)
