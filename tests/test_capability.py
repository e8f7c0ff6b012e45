"""Capability curves: polygons of active and reactive power, in problems, plants, checks and files."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import opfmodel as om
from opfmodel.check import check
from opfmodel.errors import CaseError, CaseWarning, ComponentError
from opfmodel.network import per_unit, read_network, write_network
from opfmodel.network.cases.capability import polygon_of, trapezoid_of
from opfmodel.network.polygon import fault_of, half_planes, inside_box
from opfmodel.plan.response import _within_curves

DIAMOND = ((5.0, 0.0), (0.0, 5.0), (-5.0, 0.0), (0.0, -5.0))
PRECISE = {"tol": 1e-10, "bound_relax_factor": 0.0}


# Against PYPOWER -----------------------------------------------------------------------------------

# PC1 PC2 QC1MIN QC1MAX QC2MIN QC2MAX by generator, of which some bind at the optimum.
CURVES = {
    "case9": {0: (10, 250, -20, 20, -5, 2), 1: (10, 300, -100, 30, -2, 2), 2: (10, 270, -30, 10, -5, 1)},
    "case30": {0: (0, 80, -8, 150, 0, 100), 2: (0, 50, -15, 40, -5, 20), 3: (0, 55, -15, 45, -10, 20)},
}


def with_curves(name: str) -> dict[str, Any]:
    """Return a case of PYPOWER with capability curves."""
    case: dict[str, Any] = getattr(pytest.importorskip("pypower.api"), name)()
    units = np.zeros((len(case["gen"]), 21))
    units[:, : case["gen"].shape[1]] = case["gen"]
    for row, columns in CURVES[name].items():
        units[row, 10:16] = columns
    return {**case, "gen": units}


def written(case: dict[str, Any], path: Path) -> Path:
    """Write a case of PYPOWER as a file of MATPOWER."""
    tables = [
        f"mpc.{name} = [\n"
        + "".join(" ".join(map(repr, row)) + ";\n" for row in case[name].tolist())
        + "];\n"
        for name in ("bus", "gen", "branch", "gencost")
    ]
    head = f"function mpc = x\nmpc.version = '2';\nmpc.baseMVA = {float(case['baseMVA'])};\n"
    path.write_text(head + "".join(tables))
    return path


@pytest.mark.parametrize("name", CURVES)
def test_optimum_and_prices_are_those_of_pypower(name: str, tmp_path: Path) -> None:
    from pypower.api import ppoption, runopf

    case = with_curves(name)
    network = read_network(written(case, tmp_path / "x.m"))
    plan = om.MultiStage(network, 1, options=PRECISE).solve()
    tight = dict.fromkeys(("PDIPM_FEASTOL", "PDIPM_GRADTOL"), 1e-9)
    tight |= dict.fromkeys(("PDIPM_COMPTOL", "PDIPM_COSTTOL"), 1e-10)
    theirs = runopf(case, ppoption(VERBOSE=0, OUT_ALL=0, **tight))
    assert theirs["success"]
    assert plan.objective == pytest.approx(theirs["f"], rel=1e-9)
    for quantity, column in (("lmp", 13), ("lmp_q", 14)):
        np.testing.assert_allclose(plan.data[quantity].values[0], theirs["bus"][:, column], atol=1e-6)
    upper = theirs["lin"]["mu"]["u"]  # $/h per p.u. on 100 MVA, as of the rows here
    binding = sorted(mu for rows in ("PQh", "PQl") for mu in upper[rows] if mu > 1e-5)
    duals = plan.solution.dual("generator_capability")[:, 0]
    assert binding
    np.testing.assert_allclose(sorted(duals[duals > 1e-5]), binding, rtol=1e-6)
    without = network.copy()
    for unit in network.of(om.Generator):
        without.update(unit, capability=None)
    assert om.MultiStage(without, 1).solve().objective < theirs["f"] - 0.01


# Closed forms --------------------------------------------------------------------------------------


def one_bus() -> om.Network:
    """A storage that alone gives the 4 MVAr of the town: its diamond then leaves it 1 MW."""
    grid = om.Network("one-bus")
    grid.bus = om.Bus()
    grid.unit = om.Generator("bus", p=(0, 100), q=(0, 0), cost=om.Polynomial(0, 10, 0))
    grid.cell = om.Storage("bus", energy=20, initial=0, power=10, q=10, capability=DIAMOND)
    grid.town = om.Load("bus", p=20, q=4)
    return grid


@pytest.mark.parametrize(
    ("formulation", "cost"),
    [("ac", 780.0), ("ac-rectangular", 780.0), ("soc", 780.0), ("dc", 700.0), ("copperplate", 700.0)],
)
def test_a_storage_shares_its_diamond(formulation: str, cost: float) -> None:
    grid, prices = one_bus(), {"unit.c1": [10, 30]}
    plan = om.MultiStage(grid, 2, formulation=formulation, profiles=prices).solve()
    assert plan.objective == pytest.approx(cost, rel=1e-6)
    report = check(grid, plan.data, prices)
    assert report.max_violation < 1e-7
    assert report.cost == pytest.approx(cost, rel=1e-6)
    assert "storage capability" in report.violations


def test_both_directions_of_a_polygon_are_one(tmp_path: Path) -> None:
    grid = one_bus()
    grid.update("cell", capability=DIAMOND[::-1])
    plan = om.MultiStage(grid, 2, profiles={"unit.c1": [10, 30]}).solve()
    assert plan.objective == pytest.approx(780, rel=1e-6)


# Horizons and outages ------------------------------------------------------------------------------

HOT = ((20.0, -10.0), (60.0, -10.0), (60.0, 5.0), (20.0, 10.0))  # a unit that cannot idle


def pair() -> om.Network:
    grid = om.Network("pair")
    grid.north, grid.south = om.Bus(reference=True), om.Bus()
    grid.tie = om.Branch("north", "south", r=0.01, x=0.05)
    grid.cheap = om.Generator("north", p=(0, 60), q=(-50, 50), cost=om.Polynomial(0, 10, 0), capability=HOT)
    grid.dear = om.Generator("south", p=(0, 90), q=(-50, 50), cost=om.Polynomial(0.01, 40, 0))
    grid.town = om.Load("south", p=50, q=15)
    return grid


@pytest.mark.parametrize("formulation", ["ac", "soc", "dc"])
def test_a_unit_that_is_out_admits_zero(formulation: str) -> None:
    problem = om.MultiStage(pair(), 2, formulation=formulation, outages=["cheap"])
    free, out = problem.solve(), problem.solve(out=["cheap"])
    assert free.optimal and out.optimal
    assert out.data["pg"].sel(generator="cheap").values == pytest.approx([0, 0], abs=1e-6)
    assert check(pair(), out.data).max_violation < 1e-7
    q = free.data.get("qg")
    assert q is None or (q.sel(generator="cheap").values <= 6.3).all()


@pytest.mark.parametrize("response", ["corrective", "preventive"])
@pytest.mark.parametrize("screen", [True, False])
def test_a_plan_survives_the_outage_of_a_unit_with_a_curve(response: Any, screen: bool) -> None:
    security = om.Security({"generators": ["cheap"]}, response=response, screen=screen)
    plan = om.MultiStage(pair(), 2, security=security).solve()
    assert plan.optimal and check(pair(), plan.data).max_violation < 1e-7
    assert om.assess(plan, security).secure


@pytest.mark.parametrize(
    "horizon",
    [
        om.Horizon.grid([1, 2]),
        om.Horizon.tree([1, 2], {"low": 0.4, "high": 0.6}, common=1),
    ],
)
def test_trees_and_uneven_steps(horizon: om.Horizon) -> None:
    grid, prices = one_bus(), {"unit.c1": [10, 30, 30]}
    plan = om.MultiStage(grid, horizon, profiles=prices).solve()
    # 1 MWh is stored at 10 $/MWh, and delivered over two hours at 30 $/MWh
    assert plan.objective == pytest.approx(10 * 21 + 30 * (40 - 1), rel=1e-6)
    for name in plan.horizon.scenarios:
        assert check(grid, plan.scenario(name), prices).max_violation < 1e-7


# Plants --------------------------------------------------------------------------------------------


def test_a_power_flow_measures_what_a_redispatch_keeps() -> None:
    grid = pair()
    grid.update("cheap", capability=((20, 0), (60, 0), (60, 5), (20, 5)))
    problem = om.MultiStage(grid, 1, formulation="dc")
    held = om.simulate(problem, om.PowerFlow(), 2)
    kept = om.simulate(problem, om.Redispatch(), 2)
    excess = held.data["generator_capability_excess"].sel(generator="cheap").values
    beyond = -float(held.data["qg"].sel(generator="cheap").values[0])
    assert beyond > 1 and excess == pytest.approx([beyond] * 2)
    assert held.summary()["largest_generator_capability_excess"] == pytest.approx(beyond)
    assert kept.summary()["largest_generator_capability_excess"] < 1e-4
    assert check(grid, held.data).violations["generator capability"].physical == pytest.approx(beyond)
    assert check(grid, kept.data).violations["generator capability"].physical < 1e-4


def test_the_check_finds_power_beyond_a_curve() -> None:
    grid = one_bus()
    data = om.MultiStage(grid, 1).solve().data
    data["ps"] = data["ps"] + 3
    assert check(grid, data).violations["storage capability"].physical == pytest.approx(
        (abs(float(data["ps"][0, 0])) + 4 - 5) / math.sqrt(2), abs=1e-6
    )
    dc = om.MultiStage(grid, 1, formulation="dc").solve().data
    dc["ps"] = dc["ps"] * 0 + 6
    assert check(grid, dc).violations["storage capability"].physical == pytest.approx(1)


# Polygons ------------------------------------------------------------------------------------------

numbers = st.floats(-100, 100, allow_nan=False).map(lambda x: round(x, 3))


@st.composite
def polygons(draw: st.DrawFn) -> list[tuple[float, float]]:
    """Corners of an ellipse's chords, in either direction."""
    angles = sorted(draw(st.lists(st.integers(0, 35), min_size=3, max_size=8, unique=True)))
    x, y = draw(numbers), draw(numbers)
    width, height = draw(st.floats(1, 50)), draw(st.floats(1, 50))
    corners = [
        (x + width * math.cos(a * math.pi / 18), y + height * math.sin(a * math.pi / 18)) for a in angles
    ]
    return corners[::-1] if draw(st.booleans()) else corners


@given(polygons(), st.lists(st.floats(0, 1), min_size=8, max_size=8))
@settings(max_examples=40, deadline=None)
def test_half_planes_enclose_the_corners_and_what_is_between(corners: Any, weights: list[float]) -> None:
    assert fault_of(corners) == ""
    total = sum(weights[: len(corners)]) or 1.0
    inside = [sum(w * c[i] for w, c in zip(weights, corners, strict=False)) / total for i in (0, 1)]
    for a, b, c in half_planes(corners):
        assert all(
            a * x + b * y <= c + 1e-9
            for x, y in [*corners, *([inside] if any(weights[: len(corners)]) else [])]
        )
        assert math.hypot(a, b) == pytest.approx(1)
    centre = np.mean(corners, axis=0)
    for x, y in corners:  # beyond a corner
        far = (x + 0.1 * (x - centre[0]), y + 0.1 * (y - centre[1]))
        assert max(a * far[0] + b * far[1] - c for a, b, c in half_planes(corners)) > 0


@given(polygons(), st.tuples(*[st.floats(0, 60)] * 4))
@settings(max_examples=30, deadline=None)
def test_reserves_within_a_curve_can_be_used_together(corners: Any, reserves: tuple[float, ...]) -> None:
    grid = om.Network("one")
    grid.bus = om.Bus()
    grid.unit = om.Generator("bus", p=(-500, 500), q=(-500, 500), capability=corners)
    units = per_unit(grid).generator
    centre = np.mean(corners, axis=0) / units.base_mva
    given_ = tuple(np.array([r]) / units.base_mva for r in reserves)
    left = _within_curves(units, centre[:1], centre[1:], given_)
    assert all((new <= old + 1e-12).all() for new, old in zip(left, given_, strict=True))
    up, down, q_up, q_down = left
    for p in (centre[0] + up, centre[0] - down):
        for q in (centre[1] + q_up, centre[1] - q_down):
            outside = units.capability_p * p + units.capability_q * q - units.capability_limit
            assert outside.max() < 1e-9


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (((0, 0), (1, 1)), r"a: capability = .*: must be a list of at least 3 points \[MW, MVAr\]"),
        ("oval", "must be a list of at least 3 points"),
        (((0, 0), (1,), (1, 1)), r"capability = \(1,\): must be a list"),
        (((0, 0), (1, "x"), (1, 1)), "must be a list"),
        (((0, 0), (1, math.inf), (1, 1)), "both must be finite numbers"),
        (((0, 0), (1, 1), (2, 2)), "must enclose an area"),
        (((0, 0), (10, 0), (2, 2), (0, 10)), r"must be convex, .*: point \(2, 2\) is not"),
        (((0, 0), (10, 10), (10, 0), (0, 10)), "must"),  # crosses itself, and encloses nothing in sum
        (((0, 3), (2, -3), (-3, 1), (3, 1), (-2, -3)), "must be convex"),  # a star goes round twice
        (((200, 0), (300, 0), (200, 5)), "no point of it is within the limits of p and q"),
    ],
)
def test_bad_polygons_are_refused(value: Any, message: str) -> None:
    with pytest.raises(ComponentError, match=message):
        om.Generator("bus", p=(0, 100), q=(-50, 50), capability=value).check("a")


def test_points_on_an_edge_and_repeated_points_are_accepted() -> None:
    om.Generator("bus", p=(0, 9), capability=((0, 0), (5, 0), (5, 0), (9, 0), (9, 3), (0, 3), (0, 0))).check(
        "a"
    )


def test_a_scenario_declares_curves_with_units(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(
        "name: s\nnetwork:\n  buses: {bus: {}}\n"
        "  generators: {unit: {bus: bus, p: [0, 50], capability: [[0, -10 MVAr], [50 MW, -5], [0.05 GW, 5], [0, 10]]}}\n"
        "  loads: {town: {bus: bus, p: 20, q: 4}}\ntime: {steps: 1}\ncontroller: {horizon: 1}\n"
    )
    scenario = om.load_scenario(tmp_path / "s.yaml")
    assert scenario.network.unit.capability == ((0, -10), (50, -5), (50, 5), (0, 10))
    assert scenario.simulate().status == "done"
    text = (tmp_path / "s.yaml").read_text()
    (tmp_path / "s.yaml").write_text(text.replace("[0, 10]]", "[49, 0]]"))
    with pytest.raises(om.OpfmodelError, match=r"s.yaml:4:.*capability.*must be convex.*\(49, 0\)"):
        om.load_scenario(tmp_path / "s.yaml")


# Files ---------------------------------------------------------------------------------------------


@st.composite
def columns(draw: st.DrawFn) -> tuple[tuple[float, ...], tuple[float, float], tuple[float, float]]:
    """Columns of a capability curve that narrows, and limits."""
    low, wide, rise, fall = (draw(st.integers(*r)) for r in ((-40, 0), (10, 60), (0, 20), (0, 20)))
    first = draw(st.integers(-20, 20))
    ends = (low, low + wide, low + rise, low + wide - fall)
    p = sorted(draw(st.lists(st.integers(-10, 60), min_size=2, max_size=2)))
    q = sorted(draw(st.lists(st.integers(-50, 50), min_size=2, max_size=2)))
    curve = (first, first + draw(st.integers(1, 60)), *map(float, ends))
    return curve, (float(p[0]), float(p[1])), (float(q[0]), float(q[1]))


def permitted(curve: tuple[float, ...], p: float, q: float) -> float:
    """Return by how much a point is within the sloped lines of MATPOWER; negative if it is not."""
    pc1, pc2, lo1, hi1, lo2, hi2 = curve
    share = (p - pc1) / (pc2 - pc1)
    return min(q - (lo1 + share * (lo2 - lo1)), hi1 + share * (hi2 - hi1) - q)


@given(columns(), st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), min_size=20, max_size=20))
@settings(max_examples=60, deadline=None)
def test_columns_of_matpower_permit_what_their_polygon_does(given_: Any, places: Any) -> None:
    curve, p, q = given_
    polygon = polygon_of(curve, p, q)
    again = None if polygon is None or len(polygon) < 3 else trapezoid_of(polygon, p, q)
    for x, y in places:
        at = (p[0] + x * (p[1] - p[0]), q[0] + y * (q[1] - q[0]))
        margin = permitted(curve, *at)
        if abs(margin) < 1e-6:
            continue
        within = polygon is None or (
            len(polygon) > 2 and all(a * at[0] + b * at[1] <= c + 1e-9 for a, b, c in half_planes(polygon))
        )
        assert within == (margin > 0)
        if again is not None:  # written and read again
            (left, right), (low, high), lines = again
            box = left - 1e-7 <= at[0] <= right + 1e-7 and low - 1e-7 <= at[1] <= high + 1e-7
            assert (box and (lines[0] == lines[1] or permitted(lines, *at) > -1e-7)) == (margin > 0)
    if polygon is not None and inside_box(polygon, p, q) and p[0] < p[1] and q[0] < q[1]:
        region = inside_box(polygon, p, q)
        assert again is not None or len(region) < 3 or fault_of(region)


def test_matpower_files_keep_curves(tmp_path: Path) -> None:
    grid = pair()
    grid.update("cheap", capability=((0, -20), (60, -10), (60, 5), (0, 30)))
    path = write_network(grid, tmp_path / "x.m", lossy=False)
    again = read_network(path)
    one, other = (om.MultiStage(network, 1).solve().objective for network in (grid, again))
    assert one == pytest.approx(other, rel=1e-9)
    assert again.gen1.capability is not None
    grid.update("cheap", capability=((0, -20), (60, -30), (60, 5), (0, 30)))  # it widens
    with pytest.raises(CaseError, match="cheap: capability: MATPOWER has one sloped line"):
        write_network(grid, path, lossy=False)
    with pytest.warns(CaseWarning, match="cheap: capability"):
        assert read_network(write_network(grid, path)).gen1.capability is None


@pytest.mark.parametrize(
    ("curve", "message"),
    [
        ((50, 10, 0, 0, 0, 0), "gen1: PC1 = 50: must be at most PC2 = 10"),
        ((0, 10, 0, 5, 0, 8), "gen1: QC2MAX = 8: must be at most QC1MAX = 5"),
        ((0, 10, 0, 5, -1, 5), "gen1: QC1MIN = 0: must be at most QC2MIN = -1"),
        ((0, 10, 900, 901, 900, 901), "gen1: capability .* no point of it is within"),
    ],
)
def test_wrong_columns_are_refused(curve: tuple[int, ...], message: str, tmp_path: Path) -> None:
    case = with_curves("case9")
    case["gen"][0, 10:16] = curve
    with pytest.raises(CaseError, match=rf"x.m:\d+: .*{message}" if "capability" in message else message):
        read_network(written(case, tmp_path / "x.m"))
