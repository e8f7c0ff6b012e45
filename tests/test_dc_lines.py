"""DC lines: optima known from other tools and in closed form, horizons, outages, files."""

from __future__ import annotations

import copy
import importlib
import inspect
import types
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import opfmodel as om
from opfmodel.check import check
from opfmodel.errors import CaseError, CaseWarning, ComponentError, OpfmodelError
from opfmodel.forecasts import Noisy
from opfmodel.network import per_unit
from opfmodel.network.cases.pandapower.write import write_pandapower
from opfmodel.network.inspection import inspect as inspected

CLOSE = 1e-6
PRECISE = {"OPF_VIOLATION": 1e-8, "PDIPM_GRADTOL": 1e-8, "PDIPM_COMPTOL": 1e-8, "PDIPM_COSTTOL": 1e-9}


def zones(**line: Any) -> om.Network:
    """Build two zones with one DC line: cheap energy and a short AC line in the west, a costly east."""
    grid = om.Network("zones", base_mva=100)
    grid.west, grid.coast, grid.east = (om.Bus(vm=(0.95, 1.05)) for _ in range(3))
    grid.add("ac", om.Branch("west", "coast", r=0.005, x=0.05, rating=150))
    grid.add("ac2", om.Branch("west", "coast", r=0.005, x=0.05, rating=150))
    grid.coal = om.Generator("west", p=(0, 300), q=(-100, 100), cost=om.Polynomial(0, 20, 0))
    grid.gas = om.Generator("east", p=(0, 200), q=(-100, 100), cost=om.Polynomial(0, 50, 0))
    grid.port = om.Load("coast", p=60, q=10)
    grid.city = om.Load("east", p=90, q=20)
    options = {"p": 50, "loss": 0.05, "loss_fixed": 1.0, "q_from": 20, "q_to": (-10, 30)}
    grid.link = om.DCLine("coast", "east", **{**options, **line})
    return grid


def flows(plan: Any) -> tuple[np.ndarray, np.ndarray]:
    """Power that enters the line at its ends."""
    return plan.data.dc_line_pf.values[:, 0], plan.data.dc_line_pt.values[:, 0]


def sound(network: om.Network, data: Any, **options: Any) -> None:
    """Check results independently."""
    report = check(network, data, **options)
    assert report.max_violation < CLOSE, str(report)
    assert report.simultaneous < CLOSE
    assert not report.unchecked


# Closed forms -----------------------------------------------------------------------------------------


@settings(max_examples=8, deadline=None)
@given(
    loss=st.just(0.0) | st.floats(1e-3, 0.7),
    fixed=st.floats(0, 3),
    cost=st.floats(0, 40),
    most=st.floats(1, 80),
    back=st.booleans(),
)
def test_a_line_is_full_if_it_pays_and_idle_if_not(
    loss: float, fixed: float, cost: float, most: float, back: bool
) -> None:
    """Both zones have spare capacity at 20 and 50 $/MWh; the line is declared in either direction."""
    grid = zones(loss=loss, loss_fixed=fixed, cost=cost, p=most)
    if back:
        grid.update("link", from_bus="east", to_bus="coast")
    sent = most / (1 - loss) if back else most
    arrives = (1 - loss) * sent
    gain = 50 * arrives - 20 * sent - cost * most
    assume(abs(gain) > 0.5 * most)  # near it a solver stops between both
    plan = om.MultiStage(grid, formulation="copperplate").solve()
    (pf,), (pt,) = flows(plan)
    full = 1.0 if gain > 0 else 0.0
    assert pf == pytest.approx(full * (-arrives if back else sent), abs=1e-4)
    assert pt == pytest.approx(full * (sent if back else -arrives) + fixed, abs=1e-4)
    base = 20 * (60 + fixed) + 50 * 90 if back else 20 * 60 + 50 * (90 + fixed)
    assert plan.objective == pytest.approx(base - max(gain, 0.0), rel=1e-6)
    sound(grid, plan.data)


def test_the_ratio_of_prices_of_an_unlimited_line_is_its_efficiency() -> None:
    grid = zones(p=(0, 500), loss=0.08, loss_fixed=0.0)
    for unit, c2 in (("coal", 0.02), ("gas", 0.05)):
        grid.update(unit, cost=om.Polynomial(c2, 20, 0))
    for formulation in ("dc", "ac"):
        plan = om.MultiStage(grid, formulation=formulation).solve()
        lmp = plan.data.lmp.sel(bus=["coast", "east"]).values[0]
        assert lmp[0] / lmp[1] == pytest.approx(1 - 0.08, rel=1e-6)
    # dc: 0.04 p + 20 = 0.92 (0.1 g + 20) with p = 60 + f and g = 90 - 0.92 f
    f = (0.92 * (0.1 * 90 + 20) - 20 - 0.04 * 60) / (0.04 + 0.92**2 * 0.1)
    assert flows(om.MultiStage(grid, formulation="dc").solve())[0][0] == pytest.approx(f, rel=1e-6)


def test_all_formulations_agree_where_the_grid_is_ideal() -> None:
    grid = zones()
    found = {}
    for name in ("copperplate", "dc", "dc-matpower", "soc", "ac", "ac-rectangular"):
        plan = om.MultiStage(grid, formulation=name).solve()
        sound(grid, plan.data)
        found[name] = plan.objective
        assert ("dc_line_qf" in plan.data) == (name in ("soc", "ac", "ac-rectangular"))
    assert found["copperplate"] == pytest.approx(found["dc"], rel=1e-7)
    assert found["soc"] == pytest.approx(found["ac"], rel=1e-6)
    assert found["dc"] == pytest.approx(20 * (60 + 50) + 50 * (90 - 50 * 0.95 + 1), rel=1e-7)


def test_converters_support_the_voltage() -> None:
    """A weak bus without other support is served only by the reactive power of the converter."""
    grid = zones(q_from=(0, 0))
    grid.update("port", q=140.0)
    for name in ("ac", "ac2"):
        grid.update(name, r=0.01, x=0.2)
    assert not om.MultiStage(grid).solve().optimal
    grid.update("link", q_from=(0, 130))
    plan = om.MultiStage(grid).solve()
    assert plan.optimal
    assert plan.data.dc_line_qf.values[0, 0] > 20
    sound(grid, plan.data)


def test_losses_of_lines_count_where_losses_are_minimised() -> None:
    grid = zones()
    plan = om.MultiStage(grid, objective=om.LossMinimisation()).solve()
    (pf,), _ = flows(plan)
    assert pf == pytest.approx(0.0, abs=1e-3)  # the east supplies itself; the fixed loss stays
    lost = plan.data.dc_line_loss.values.sum() + (plan.data.pf + plan.data.pt).values.sum()
    assert plan.data.dc_line_loss.values[0, 0] == pytest.approx(1.0, abs=1e-4)
    assert plan.objective == pytest.approx(lost, rel=1e-6)
    sound(grid, plan.data)


def test_power_is_wasted_only_at_negative_prices() -> None:
    grid = zones(loss_fixed=0.0)
    for unit in ("coal", "gas"):
        grid.update(unit, p=(100, 300), cost=om.Polynomial(0, 20, 0))
    plan = om.MultiStage(grid, formulation="copperplate").solve()
    report = check(grid, plan.data)  # 200 MW are generated, 150 MW demanded
    assert not plan.optimal or report.simultaneous > 0.1
    grid.update("link", p=1000)
    plan = om.MultiStage(grid, formulation="copperplate").solve()
    report = check(grid, plan.data)
    assert plan.optimal
    assert report.max_violation < CLOSE
    assert report.simultaneous > 0.1
    assert plan.data.dc_line_loss.values[0, 0] == pytest.approx(50, abs=1e-4)


# Other tools ------------------------------------------------------------------------------------------


def pypower_dc_lines() -> Any:
    """Return PYPOWER's ``toggle_dcline``; NumPy no longer takes its floating-point indices."""
    source = inspect.getsource(importlib.import_module("pypower.toggle_dcline"))
    for end in ("F_BUS", "T_BUS"):
        column = f"dc[:, c['{end}']]"
        source = source.replace(f"['e2i'][{column}]", f"['e2i'][{column}.astype(int)]")
        source = source.replace(f"['bus'][{column}, ", f"['bus'][{column}.astype(int), ")
    made = types.ModuleType("toggle_dcline")
    exec(source, made.__dict__)
    return made.toggle_dcline


def matpower_text(case: dict[str, Any]) -> str:
    """Write a case of PYPOWER for MATPOWER."""
    tables = [name for name in ("bus", "gen", "branch", "gencost", "dcline", "dclinecost") if name in case]
    lines = ["function mpc = case9", "mpc.version = '2';", f"mpc.baseMVA = {case['baseMVA']};"]
    for name in tables:
        rows = (" ".join(repr(float(value)) for value in row) + ";" for row in case[name])
        lines += [f"mpc.{name} = [", *rows, "];"]
    return "\n".join(lines)


@pytest.fixture
def case9() -> dict[str, Any]:
    """The example of PYPOWER, without capability curves and the line that is out of service."""
    made: dict[str, Any] = importlib.import_module("pypower.t.t_case9_dcline").t_case9_dcline()
    made["gen"][:, 10:16] = 0
    for name in ("dcline", "dclinecost"):
        made[name] = made[name][[0, 1, 3]]
    return made


def read(path: Path, **options: Any) -> om.Network:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CaseWarning)
        return om.read_network(path, **options)


@pytest.mark.parametrize(
    "changes", [{}, *(pytest.param(c, marks=pytest.mark.slow) for c in ({"fixed": 2.0}, {"backward": True}))]
)
def test_pypower_finds_the_same_optimum(
    changes: dict[str, Any], case9: dict[str, Any], tmp_path: Path
) -> None:
    del case9["dclinecost"]  # PYPOWER fails with it
    if "fixed" in changes:
        case9["dcline"][:, 15] = changes["fixed"]
    if "backward" in changes:  # in MATPOWER, negative limits are those of the to end
        case9["dcline"][:, 9:11] = [[-10, 10], [-8, -3], [-6, -2]]
        case9["dcline"][:, 15:17] = [[1, 0], [0.5, 0], [0, 0]]
    (tmp_path / "case9.m").write_text(matpower_text(case9))
    grid = read(tmp_path / "case9.m")
    plan = om.MultiStage(grid).solve()
    api = importlib.import_module("pypower.api")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        case = pypower_dc_lines()(copy.deepcopy(case9), "on")
        found = api.runopf(case, api.ppoption(OUT_ALL=0, VERBOSE=0, **PRECISE))
    assert found["success"]
    assert plan.objective == pytest.approx(found["f"], rel=1e-7)
    assert plan.data.dc_line_pf.values[0] == pytest.approx(found["dcline"][:, 3], abs=1e-3)
    assert -plan.data.dc_line_pt.values[0] == pytest.approx(found["dcline"][:, 4], abs=1e-3)
    sound(grid, plan.data)


def pandapower_net(pp: Any, **line: Any) -> Any:
    """Build two areas with external grids, and a DC line between them."""
    net = pp.create_empty_network(sn_mva=1.0)
    for _ in range(5):
        pp.create_bus(net, 380, min_vm_pu=0.95, max_vm_pu=1.05)
    for start, end, km in ((0, 1, 30), (1, 2, 20), (3, 4, 20)):
        pp.create_line(net, start, end, km, "490-AL1/64-ST1A 380.0", max_loading_percent=100)
    limits = {
        f"{end}_q_{at}_mvar": size for end, size in (("min", -20), ("max", 20)) for at in ("from", "to")
    }
    options = {"p_mw": 20.0, "loss_percent": 5.0, "loss_mw": 0.5, "max_p_mw": 100.0, **limits}
    pp.create_dcline(net, 2, 3, **{**options, **line}, vm_from_pu=1.0, vm_to_pu=1.0)
    for bus in (0, 4):
        pp.create_ext_grid(net, bus, 1.0, min_p_mw=0.0, max_p_mw=1e3, min_q_mvar=-300, max_q_mvar=300)
    pp.create_load(net, 3, 80.0, 10.0)
    pp.create_load(net, 1, 30.0, 5.0)
    pp.create_gen(net, 2, 10.0, min_p_mw=0, max_p_mw=50, min_q_mvar=-40, max_q_mvar=40, vm_pu=1.0)
    pp.create_poly_cost(net, 0, "ext_grid", cp1_eur_per_mw=10.0)
    pp.create_poly_cost(net, 1, "ext_grid", cp1_eur_per_mw=12.0, cp2_eur_per_mw2=0.01)
    pp.create_poly_cost(net, 0, "gen", cp1_eur_per_mw=11.0)
    return net


CHANGES = {
    "losses": {},
    "at its limit": {"max_p_mw": 25.0},
    "cost": {"cost": 1.3},
    "reactive power": {"q": 200.0, "max_q_to_mvar": 60.0},
    "backward": {"p_mw": -20.0, "loss_percent": 0.0, "loss_mw": 0.0, "demand": 0.0, "price": 40.0},
}


@pytest.mark.parametrize(
    "name",
    ["at its limit", *(pytest.param(n, marks=pytest.mark.slow) for n in CHANGES if n != "at its limit")],
)
def test_pandapower_finds_the_same_optimum(name: str) -> None:
    pp = pytest.importorskip("pandapower")
    change: dict[str, Any] = CHANGES[name]
    line = {key: value for key, value in change.items() if key.endswith(("mw", "percent", "mvar"))}
    net = pandapower_net(pp, **line)
    if "q" in change:
        net.load.loc[0, "q_mvar"] = change["q"]
    if "demand" in change:
        net.load.loc[0, "p_mw"] = change["demand"]
        net.poly_cost.loc[[0, 2], "cp1_eur_per_mw"] = change["price"]
    if "cost" in change:
        pp.create_poly_cost(net, 0, "dcline", cp1_eur_per_mw=change["cost"])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pp.runopp(net, delta=1e-9, **PRECISE)
        grid = om.from_pandapower(net)
    plan = om.MultiStage(grid).solve()
    assert plan.objective == pytest.approx(net.res_cost, rel=1e-6)
    sign = np.sign(net.dcline.p_mw.iloc[0])  # the sending end is the from end
    sent = net.res_dcline[["p_from_mw", "p_to_mw"]].iloc[0].to_numpy()[:: int(sign)]
    assert [float(end[0]) for end in flows(plan)] == pytest.approx(sent, abs=2e-2)
    sound(grid, plan.data)


def test_what_pandapower_states_otherwise_is_reported() -> None:
    pp = pytest.importorskip("pandapower")
    net = pandapower_net(pp, p_mw=-5.0)
    pp.create_poly_cost(net, 0, "dcline", cp1_eur_per_mw=2.0)
    with pytest.raises(CaseError, match=r"dcline 'dcline0': its cost is left out; only cp1_eur_per_mw"):
        om.from_pandapower(net)
    with pytest.warns(CaseWarning, match=r"flow backward and lose power; in runopp they gain it: 'dcline0'"):
        grid = om.from_pandapower(net, lossy=True)
    assert (grid.dcline0.from_bus, grid.dcline0.to_bus) == ("bus3", "bus2")
    assert (grid.dcline0.p, grid.dcline0.pf_set, grid.dcline0.cost) == ((0.0, 100.0), 5.0, 0.0)
    net.dcline["from_bus"] = 17
    with pytest.raises(CaseError, match=r"dcline 'dcline0': from_bus = 17: no such bus"):
        om.from_pandapower(net, lossy=True)


def pypsa_zones() -> Any:
    """Build three zones over a day, with wind, links both ways and with losses, and an AC loop."""
    pypsa = pytest.importorskip("pypsa")
    hours = np.arange(24)
    n = pypsa.Network(snapshots=hours)
    n.add("Bus", ["north", "south", "isle", "shore"], v_nom=380.0)
    n.add("Line", "coast", bus0="south", bus1="shore", x=20.0, r=1.0, s_nom=120.0)
    wind = 0.5 + 0.5 * np.sin(hours / 3.0)
    n.add("Generator", "wind", bus="isle", p_nom=120.0, p_max_pu=wind, marginal_cost=1.0)
    n.add("Generator", "coal", bus="north", p_nom=150.0, marginal_cost=30.0)
    n.add("Generator", "gas", bus="south", p_nom=200.0, marginal_cost=55.0, marginal_cost_quadratic=0.05)
    n.add("Load", "town", bus="north", p_set=70.0 + 30 * np.cos(hours / 4.0))
    n.add("Load", "city", bus="shore", p_set=80.0 + 20 * np.sin(hours / 5.0))
    cable = {"bus0": "isle", "bus1": "north", "p_nom": 90.0, "efficiency": 0.94}
    n.add("Link", "cable", **cable, marginal_cost=2.0 + np.cos(hours))
    n.add("Link", "tie", bus0="north", bus1="south", p_nom=50.0, p_min_pu=-0.8, p_max_pu=0.4 + 0.02 * hours)
    n.add("Link", "must", bus0="isle", bus1="shore", p_nom=20.0, p_min_pu=0.0, efficiency=0.9)
    n.add("Link", "held", bus0="south", bus1="north", p_nom=20.0, p_set=3.0)
    return n


def test_pypsa_finds_the_same_optimum_of_a_day() -> None:
    n = pypsa_zones()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        status = n.optimize(solver_name="highs", log_to_console=False)
        grid = om.from_pypsa(n)
    assert status == ("ok", "optimal")
    plan = om.MultiStage(grid, 24, formulation="dc-matpower").solve()
    assert plan.objective == pytest.approx(n.objective, rel=1e-6)
    for name in ("cable", "tie", "must", "held"):
        assert plan.data.dc_line_pf.sel(dc_line=name).values == pytest.approx(
            n.links_t.p0[name].values, abs=1e-2
        )
        assert plan.data.dc_line_pt.sel(dc_line=name).values == pytest.approx(
            n.links_t.p1[name].values, abs=1e-2
        )
    sound(grid, plan.data, series=grid.profiles)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"efficiency": 1.2}, r"Link efficiency of 'cable': 1\.2: a DC line delivers at most"),
        ({"p_min_pu": -1.0}, r"Link p_min_pu of 'cable': power that flows backward gains"),
        ({"p_min_pu": -1.0, "efficiency": 1.0}, r"Link marginal_cost of 'cable': is earned"),
        ({"marginal_cost": -3.0}, r"Link marginal_cost of 'cable': is negative"),
        ({"p_nom_extendable": True}, r"Link p_nom_extendable: .*its capacity is a decision"),
        ({"committable": True}, r"Link committable: .*always on"),
        ({"ramp_limit_up": 0.5}, r"Link ramp_limit_up: .*no ramp limit"),
        ({"bus2": "south", "efficiency2": 0.3}, r"Link bus2: .*whose DC lines have two ends"),
    ],
)
def test_links_that_are_no_dc_lines_are_losses(change: dict[str, Any], message: str) -> None:
    n = pypsa_zones()
    n.remove("Link", "cable")
    options = {"bus0": "isle", "bus1": "north", "p_nom": 90.0, "efficiency": 0.94, "marginal_cost": 2.0}
    n.add("Link", "cable", **{**options, **change})
    with pytest.raises(CaseError, match=message):
        om.from_pypsa(n)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert om.from_pypsa(n, lossy=True).cable.p[1] == 90.0


# Files ------------------------------------------------------------------------------------------------


def test_matpower_files_keep_dc_lines_and_their_costs(case9: dict[str, Any], tmp_path: Path) -> None:
    case9["dcline"][1, 9:11] = [-8, 10]
    (tmp_path / "case9.m").write_text(matpower_text(case9))
    with pytest.warns(CaseWarning, match="VF and VT are not used"):
        first = om.read_network(tmp_path / "case9.m")
    assert first.dcline3.cost == 7.3
    assert (first.dcline2.p, first.dcline1.loss, first.dcline1.loss_fixed) == ((-8.0, 10.0), 0.01, 1.0)
    om.write_network(first, tmp_path / "again.m", lossy=False)
    second = read(tmp_path / "again.m")
    assert second.of(om.DCLine) == first.of(om.DCLine)
    free, costly = om.MultiStage(first).solve(), om.MultiStage(second).solve()
    assert free.objective == pytest.approx(costly.objective, rel=1e-9)


@settings(max_examples=6, deadline=None)
@given(low=st.floats(-50, 50), width=st.floats(0, 60), fixed=st.floats(0, 2), loss=st.floats(0, 0.2))
def test_limits_of_either_sign_survive_matpower(
    low: float, width: float, fixed: float, loss: float, tmp_path_factory: pytest.TempPathFactory
) -> None:
    grid = zones(p=(low, low + width), loss=loss, loss_fixed=fixed, cost=1.0)
    path = tmp_path_factory.mktemp("limits") / "grid.m"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CaseWarning)
        om.write_network(grid, path)
        again = om.read_network(path, lossy=True).dcline1
    assert again.p == pytest.approx(grid.link.p, abs=1e-9)
    assert (again.loss, again.loss_fixed) == (loss, fixed)


def test_what_matpower_states_otherwise_is_reported(case9: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "case9.m"
    case9["dcline"][0, 9] = -5
    case9["dclinecost"][1, 3:7] = [3, 0.1, 2, 0]
    path.write_text(matpower_text(case9))
    with pytest.raises(
        CaseError, match=r"dcline1: LOSS1 = 0\.01 with PMIN = -5: .*dcline2: its cost is left out"
    ):
        read(path)
    case9["dclinecost"] = case9["dclinecost"][:2]
    path.write_text(matpower_text(case9))
    with pytest.raises(CaseError, match=r"case9\.m:\d+: mpc\.dclinecost has 2 rows for 3 DC lines"):
        read(path)
    del case9["dclinecost"]
    case9["dcline"][0, 16] = -0.1
    path.write_text(matpower_text(case9))
    with pytest.raises(CaseError, match=r"case9\.m:\d+: dcline1: loss = -0\.1: must be at least 0"):
        read(path)
    grid = zones(cost=2.0)
    with pytest.raises(
        CaseError, match=r"link: in MATPOWER, power that flows backward gains.*cost is earned"
    ):
        om.write_network(grid, path, lossy=False)


def test_pandapower_files_do_not_hold_them(tmp_path: Path) -> None:
    pytest.importorskip("pandapower")
    grid = zones()
    for bus in ("west", "coast", "east"):
        grid.update(bus, reference=bus != "coast", base_kv=380.0)
    with pytest.raises(CaseError, match="dc lines link"):
        write_pandapower(grid, tmp_path / "grid.json")


SCENARIO = """
network:
  buses: {a: {reference: true}, b: {}, c: {}}
  branches: {one: {from_bus: a, to_bus: b, r: 0.01, x: 0.1}, two: {from_bus: a, to_bus: b, r: 0.01, x: 0.1}}
  generators:
    coal: {bus: a, p: [0, 200], q: [-100, 100], cost: {c1: 20}}
    gas: {bus: c, p: [0, 100], q: [-100, 100], cost: {c1: 50}}
  loads: {port: {bus: b, p: 40, q: 5}, city: {bus: c, p: 60, q: 10}}
  dc_lines: {link: {from_bus: b, to_bus: c, p: 40 MW, loss: 3 %, q_from: 10, q_to: [-10, 10], cost: 0.5 $/MWh}}
time: {step: 1.0, steps: 4}
profiles:
  - step: {component: link, field: p_max, first: 2, set: 10}
controller:
  horizon: 2
  security: {contingencies: {dc_lines: [link], branches: ["*"]}, minutes: 60}
plant:
  outages: [{dc_line: link, step: 1, hours: 1}]
"""


def test_a_scenario_file_names_them(tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(
        SCENARIO.replace("  - step: {component: link, field: p_max, first: 2, set: 10}\n", "").replace(
            "profiles:\n", ""
        )
    )
    run = om.load_scenario(path).simulate()
    assert run.data.dc_line_status.values[:, 0].tolist() == [1, 0, 1, 1]
    assert run.data.dc_line_pf.values[:, 0] == pytest.approx([40, 0, 40, 40], abs=1e-4)
    path.write_text(path.read_text().replace("dc_lines: [link]", "dc_lines: [lnk]"))
    with pytest.raises(OpfmodelError, match=r"dc_lines: 'lnk': no dc_line in service .*'link'"):
        om.load_scenario(path)


@pytest.mark.parametrize(
    ("field", "value", "accepted"),
    [
        ("p", "much", "must be a pair"),
        ("p", (10, -10), "above the maximum"),
        ("p", float("inf"), "must be finite in both directions with loss = 0.05"),
        ("p", -5, "must be at least 0"),
        ("loss", -0.1, "must be at least 0"),
        ("loss", 1.0, "must be at most 0.999"),
        ("loss_fixed", -1.0, "must be at least 0"),
        ("loss_fixed", float("nan"), "must be a finite number"),
        ("q_from", (5, 1), "above the maximum"),
        ("q_to", "x", "must be a pair"),
        ("cost", -1.0, "must be at least 0"),
        ("to_bus", "coast", "must differ from from_bus"),
        ("to_bus", "cost", "no such bus"),
        ("from_bus", 3.5, "must be the name of a bus"),
        ("in_service", 3, "must be true or false"),
        ("pf_set", "x", "must be a number"),
        ("qf_set", "x", "must be a number"),
        ("qt_set", "x", "must be a number"),
    ],
)
def test_a_wrong_value_is_named(field: str, value: object, accepted: str) -> None:
    grid = zones()
    with pytest.raises(ComponentError, match=rf"^link: {field} = .*{accepted}"):
        grid.update("link", **{field: value})
        per_unit(grid)


def test_series_of_coefficients_are_refused() -> None:
    for field in ("loss", "loss_fixed"):
        with pytest.raises(OpfmodelError, match=f"the {field} of a dc_line is constant"):
            om.MultiStage(zones(), 2, profiles={f"link.{field}": [0.1, 0.2]})


# Horizons and outages ---------------------------------------------------------------------------------


def day() -> dict[str, np.ndarray]:
    hours = np.arange(8)
    return {
        "city.p": 80 + 20 * np.sin(hours),
        "coal.c1": np.where(hours % 3 == 2, 70.0, 20.0),
        "link.p_max": 50.0 - 3 * hours,
        "link.p_min": -40.0 + 8 * hours,  # the line turns one-directional
        "link.cost": 0.5 * hours,
    }


@pytest.mark.parametrize("formulation", ["ac", "soc", "dc"])
def test_uneven_steps_average_the_limits(formulation: str) -> None:
    grid, profiles = zones(), day()
    horizon = om.Horizon.grid([1, 1, 2, 4], step=1)
    plan = om.MultiStage(grid, horizon, formulation=formulation, profiles=profiles).solve()
    low, high = (
        [profiles[f"link.{end}"][span].mean() for span in map(slice, (0, 1, 2, 4), (1, 2, 4, 8))]
        for end in ("p_min", "p_max")
    )
    cheap = [20.0, 20.0, 45.0, 45.0]
    expected = [m if c < 50 * 0.95 - 2.5 else None for c, m in zip(cheap, high, strict=True)]
    pf, _ = flows(plan)
    for found, wanted, least, most in zip(pf, expected, low, high, strict=True):
        assert least - 1e-5 <= found <= most + 1e-5
        assert wanted is None or found == pytest.approx(wanted, abs=1e-4)
    sound(grid, plan.data, series=profiles)


def test_a_tree_decides_in_each_node() -> None:
    grid, profiles = zones(loss_fixed=0.0), {"coal.c1": [20.0, 20.0, 20.0]}
    tree = om.Horizon.tree([1, 1, 1], {"low": 0.5, "high": 0.5}, common=1)
    problem = om.MultiStage(grid, tree, formulation="dc", profiles=profiles)
    plan = problem.solve()
    for name in ("low", "high"):
        sound(grid, plan.scenario(name), series=profiles)
    assert plan.data.dc_line_pf.values == pytest.approx(50.0, abs=1e-4)


@pytest.mark.parametrize("response", ["corrective", "preventive"])
@pytest.mark.parametrize("formulation", [pytest.param("ac", marks=pytest.mark.slow), "dc"])
def test_plans_survive_the_loss_of_a_line(response: str, formulation: str) -> None:
    """Screening gives the plan of the whole problem, with lines and branches as contingencies."""
    grid = zones(p=(-20, 50))
    grid.add("second", om.DCLine("coast", "east", p=(0, 60), q_to=5))
    for unit in ("coal", "gas"):
        grid.update(unit, ramp=60.0)
    for branch in ("ac", "ac2"):
        grid.update(branch, rating=110.0)
    contingencies = {"dc_lines": ["*"], "branches": ["ac*"], "generators": []}
    plans = []
    for screen in (True, False):
        security = om.Security(contingencies, response, screen=screen)
        plan = om.MultiStage(grid, formulation=formulation, security=security).solve()
        assert plan.optimal
        assert om.assess(plan).secure
        sound(grid, plan.data)
        plans.append(plan)
    assert plans[0].objective == pytest.approx(plans[1].objective, rel=1e-6)
    free = om.MultiStage(grid, formulation=formulation).solve()
    assert plans[0].objective > free.objective + 1.0
    assert not om.assess(free, om.Security(contingencies, response)).secure


def test_a_preventive_plan_holds_what_the_lines_that_are_left_carry() -> None:
    """Of two lines of which one goes out, the other does not change: the unit in the east makes up for it."""
    grid = zones(loss=0.0, loss_fixed=0.0)
    grid.add("second", om.DCLine("coast", "east", p=(0, 60), loss=0.02))
    grid.update("gas", p=(0, 70))
    security = om.Security({"dc_lines": ["*"]}, "preventive", screen=False)
    plan = om.MultiStage(grid, formulation="dc", security=security).solve()
    kept = 90 - 70.0  # what the other line must deliver when the larger one is lost
    link, second = plan.data.dc_line_pf.values[0]
    assert min(link, 0.98 * second) == pytest.approx(kept, abs=1e-4) or min(link, 0.98 * second) > kept
    for node in plan.horizon.contingencies:
        (lost,) = plan.horizon.out[node]
        left = 1 if lost == "link" else 0
        whole = plan.solution.value("dc_line_pf")
        assert whole[1 - left, node] == pytest.approx(0.0, abs=1e-7)
        assert whole[left, node] == pytest.approx(whole[left, 0], abs=1e-7)


@pytest.mark.parametrize("plant", [om.NominalPlant, om.PowerFlow, om.Redispatch])
@pytest.mark.parametrize("formulation", ["ac", "dc"])
def test_a_closed_loop_holds_set_points(plant: type, formulation: str) -> None:
    if plant is om.NominalPlant and formulation == "dc":
        pytest.skip("the nominal plant repeats the plan")
    grid, profiles = zones(), {key: values[:4] for key, values in day().items()}
    problem = om.MultiStage(grid, 2, formulation=formulation, profiles=profiles)
    forecast = None if plant is om.NominalPlant else Noisy(0.05, seed=2, fields=("p",))
    run = om.simulate(om.Controller(problem, forecast=forecast), plant(), 3)
    pf = run.data.dc_line_pf.values[:, 0]
    planned = om.MultiStage(grid, 3, formulation="dc", profiles=profiles).solve().data.dc_line_pf.values[:, 0]
    assert pf == pytest.approx(planned, abs=0.5)  # full, or as much as is demanded
    sound(grid, run.data, series=profiles)
    if formulation == "dc":
        reactive = run.data[["dc_line_qf", "dc_line_qt"]].to_array().values
        assert np.abs(reactive).max() < (1e-3 if plant is om.PowerFlow else 31)


@pytest.mark.parametrize("plant", [om.NominalPlant, om.PowerFlow, om.Redispatch])
def test_a_line_that_is_out_loses_nothing(plant: type) -> None:
    grid = zones()
    problem = om.MultiStage(grid, 2, outages=["link"])
    run = om.simulate(problem, plant().with_outages([om.Outage("link", 1, 1)]), 3)
    for quantity in ("pf", "pt", "loss", "qf", "qt"):
        assert np.abs(run.data[f"dc_line_{quantity}"].values[1]).max() < 1e-5
    assert run.data.dc_line_loss.values[[0, 2], 0] == pytest.approx(3.5, abs=1e-4)
    sound(grid, run.data)
    plan = problem.solve(out=["link"])
    assert plan.data.dc_line_loss.values == pytest.approx(0.0, abs=1e-6)


# Islands, power flow, the check -------------------------------------------------------------------------


def test_a_bus_that_hangs_on_a_line_alone_is_an_island_of_its_own() -> None:
    grid = zones()
    grid.remove("gas")
    grid.update("link", p=(0, 120), q_to=(-10, 40))
    arrays = per_unit(grid)
    assert arrays.n_islands == 2
    assert len(arrays.bus) == 3
    assert not any("isolated" in note for note in arrays.notes)
    found = inspected(grid)
    assert [island.import_mw for island in found.islands] == pytest.approx([0.0, 0.95 * 120 - 1])
    assert not any(s.component == "east" or s.field == "capacity" for s in found.suspicions)
    for formulation in ("ac", "soc", "dc", "copperplate"):
        plan = om.MultiStage(grid, formulation=formulation).solve()
        assert flows(plan)[1][0] == pytest.approx(-90, abs=1e-5)
        sound(grid, plan.data)
    grid.update("link", p=(0, 60))
    suspicions = [s for s in inspected(grid).suspicions if s.field == "capacity"]
    assert "island 2 of 1 buses has less capacity than its 90 MW, with 56 MW by DC lines" in suspicions[0].why
    with pytest.raises(OpfmodelError, match="its outage splits the grid"):
        om.MultiStage(changed(grid), outages=["ac"])
    om.MultiStage(grid, outages=["link"])  # the outage of a DC line splits nothing
    assert om.Security("all").outages(per_unit(changed(grid))) == []


def changed(grid: om.Network) -> om.Network:
    """Return the grid with one AC line, and a DC line beside it."""
    made = grid.copy()
    made.remove("ac2")
    made.add("beside", om.DCLine("west", "coast", p=100))
    return made


def test_suspicious_values() -> None:
    grid = zones(p=1e6, loss=0.5)
    grid.add("dead", om.DCLine("west", "east", p=(0, 0), loss_fixed=1.0))
    found = {(s.component, s.field) for s in inspected(grid).suspicions}
    assert {("link", "p"), ("link", "loss"), ("dead", "p"), ("dead", "loss_fixed")} <= found


@pytest.mark.parametrize("pf", [30.0, -30.0, None])
def test_a_power_flow_holds_set_points(pf: float | None) -> None:
    grid = zones(pf_set=pf, qf_set=4.0)
    flow = om.power_flow(grid)
    assert flow.converged
    power = pf or 0.0
    arrives = 0.95 * power if power > 0 else power / 0.95
    assert flow.data.dc_line_pf.values[0, 0] == pytest.approx(power, abs=1e-9)
    assert flow.data.dc_line_pt.values[0, 0] == pytest.approx(1.0 - arrives, abs=1e-9)
    assert flow.data.dc_line_qf.values[0, 0] == pytest.approx(4.0)
    assert flow.slack["east"] == pytest.approx(90 + 1.0 - arrives, abs=1e-6)
    sound(grid, flow.data)
    assert {outcome.out for outcome in om.assess(flow, om.Security({"dc_lines": ["link"]})).outcomes} == {
        "link"
    }


def mutations() -> Iterator[tuple[str, str, float]]:
    """Family of the check, quantity, and what is added to it."""
    yield "DC line p", "dc_line_pf", 30.0
    yield "DC line q from", "dc_line_qf", 50.0
    yield "DC line q to", "dc_line_qt", -50.0
    yield "DC line loss", "dc_line_pt", -0.1
    yield "DC line loss", "dc_line_pt", 90.0
    yield "DC line reported loss", "dc_line_loss", 0.1
    yield "active balance", "dc_line_pt", 0.1
    yield "reactive balance", "dc_line_qf", 0.1


@pytest.mark.parametrize(("family", "quantity", "change"), list(mutations()))
def test_the_check_finds_every_mistake(family: str, quantity: str, change: float) -> None:
    grid = zones(cost=2.0)
    data = om.MultiStage(grid).solve().data
    honest = check(grid, data)
    assert honest.max_violation < CLOSE
    assert honest.violations[family].value < CLOSE
    data[quantity] = data[quantity] + change
    assert check(grid, data).violations[family].value > 1e-4
    if quantity == "dc_line_pf":
        assert check(grid, data).cost == pytest.approx(honest.cost + 2.0 * change)


def test_lines_that_carry_nothing_else_leave_the_program_as_it_is() -> None:
    grid = zones(in_service=False)
    program = om.MultiStage(grid).compile()
    other = zones()
    other.remove("link")
    plain = om.MultiStage(other).compile()
    assert list(program.variables) == list(plain.variables)
    assert not any(name.startswith("dc_line") for name in program.variables)
    assert (program.n_variables, program.n_rows) == (plain.n_variables, plain.n_rows)
