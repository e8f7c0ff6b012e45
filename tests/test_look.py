"""Looking at data before solving, and the commands that write files to start from."""

from __future__ import annotations

import importlib
import json
import re
import sys
import warnings
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from conftest import DATA, SCENARIOS, Call
from hypothesis import given
from hypothesis import strategies as st

import opfmodel as om
from opfmodel.cli import installation
from opfmodel.data.calendar import Calendar
from opfmodel.errors import CaseError, CaseWarning, ResultError
from opfmodel.network.cases.pandapower.write import write_pandapower
from opfmodel.network.inspection import Inspection, inspect, topology
from opfmodel.network.layout import positions
from opfmodel.results.map import save_map
from opfmodel.scenario.template import template
from opfmodel.scenario.write import scalar, write_scenario

CASES = sorted([*DATA.glob("pglib/*.m"), *DATA.glob("matpower/*.m"), SCENARIOS / "data" / "case33bw.m"])
CASE14 = DATA / "pglib" / "pglib_opf_case14_ieee.m"
CASE33 = SCENARIOS / "data" / "case33bw.m"
CASE5 = SCENARIOS / "case5-step.yaml"


def contents(network: om.Network) -> dict:
    return {name: network[name] for name in network}


def suspected(network: om.Network, component: str = "") -> set[str]:
    """Fields of a component under suspicion."""
    return {s.field for s in inspect(network).suspicions if s.component == component}


# Inspection ---------------------------------------------------------------------------------------


def test_the_summary_of_a_radial_feeder() -> None:
    """Figures of Baran and Wu's feeder: 33 buses, 5 open ties, 3.715 MW."""
    found = inspect(om.read_network(CASE33))
    assert (found.in_service["branches"], found.out_of_service["branches"]) == (32, 5)
    assert (found.loops, len(found.islands)) == (0, 1)
    assert found.demand_mw == found.peak_mw == pytest.approx(3.715)
    assert [(level.base_kv, level.buses, level.branches) for level in found.levels] == [(12.66, 33, 32)]


def test_the_summary_agrees_with_networkx_and_the_file() -> None:
    network = om.read_network(DATA / "pglib" / "pglib_opf_case300_ieee.m")
    found = inspect(network)
    assert sum(level.buses for level in found.levels) == 300
    # a branch between two levels counts at both
    inside, between = (sum(getattr(lv, key) for lv in found.levels) for key in ("branches", "transformers"))
    assert inside + between / 2 == 411 == found.in_service["branches"]
    assert found.loops == 411 - 300 + 1
    assert found.capacity_mw == sum(g.p[1] for g in network.of(om.Generator).values())


def test_the_peak_is_that_of_the_series(grid: om.Network) -> None:
    """The rest of the demand and the capacity count in every step."""
    network = om.Network()
    network.bus = om.Bus(reference=True)
    network.wind = om.Generator("bus", p=(0, 100))
    network.town, network.mill = om.Load("bus", p=10), om.Load("bus", p=7)
    series = {"town.p": [10, 60, 20], "wind.p_max": [100, 70, 10]}
    found = inspect(network, series)
    assert (found.peak_mw, found.peak_step, found.steps) == (67, 1, 3)
    assert found.spare_mw == 10 - 27
    assert "capacity" in {s.field for s in found.suspicions}
    network.attach(om.Profiles(series))
    assert inspect(network) == found
    assert inspect(network, {}).peak_mw == 17


def test_components_out_of_service_do_not_count() -> None:
    network = om.read_network(CASE14)
    before = inspect(network)
    for name in ("gen1", "load2"):
        network.update(name, in_service=False)
    after = inspect(network)
    assert after.capacity_mw == before.capacity_mw - network.gen1.p[1]
    assert after.demand_mw == pytest.approx(before.demand_mw - network.load2.p)
    assert after.out_of_service["generators"] == 1


def sound_grid() -> om.Network:
    """A grid without suspicious data."""
    grid = om.Network(base_mva=100)
    grid.a, grid.b = om.Bus(base_kv=110, reference=True), om.Bus(base_kv=110)
    grid.line = om.Branch("a", "b", r=0.01, x=0.1, rating=100)
    grid.cable = om.Branch("a", "b", r=0.02, x=0.1, rating=100)
    grid.unit = om.Generator("a", p=(0, 100), q=(-50, 50), cost=om.Polynomial(0.01, 10, 0))
    grid.gas = om.Generator("b", p=(0, 100), q=(-50, 50), cost=om.Polynomial(0, 30, 0))
    grid.cell = om.Storage("b", energy=20, power=5)
    grid.town = om.Load("b", p=50, q=10)
    grid.coil = om.Shunt("b", b=-5)
    return grid


def test_a_sound_grid_is_not_suspected() -> None:
    assert inspect(sound_grid()).suspicions == ()


@pytest.mark.parametrize(
    ("component", "changes", "field"),
    [
        ("line", {"r": 0.2}, "r, x"),
        ("line", {"r": 1e-7, "x": 1e-7}, "r, x"),
        ("line", {"r": -0.01}, "r"),
        ("line", {"x": -0.1}, "x"),
        ("line", {"rating": None}, "rating"),
        ("line", {"rating": 0}, "rating"),
        ("line", {"rating": 1e9}, "rating"),
        ("line", {"tap": 100.0}, "tap"),
        ("line", {"angle": (0.0, 0.5)}, "angle"),
        ("cable", {"r": 0.01}, "to_bus"),
        ("a", {"vm": (1.0, 1.0)}, "vm"),
        ("a", {"vm": (0.0, 1.1)}, "vm"),
        ("a", {"vm": (0.9, 9.0)}, "vm"),
        ("unit", {"p": (0.0, 0.0), "q": (0.0, 0.0)}, "p"),
        ("unit", {"p": (0.0, 1e7)}, "p"),
        ("unit", {"q": (-np.inf, np.inf)}, "q"),
        ("unit", {"ramp": 0.0}, "ramp"),
        ("unit", {"cost": om.Polynomial(0, -5, 0)}, "cost"),
        ("cell", {"power": 0.1}, "power, energy"),
        ("cell", {"power": (-5, 0)}, "power"),
        ("cell", {"energy": 0}, "energy"),
        ("cell", {"charge_efficiency": 0.5, "discharge_efficiency": 0.5}, "charge_efficiency, discharge_efficiency"),
        ("town", {"p": -1, "q": 0}, "p"),
        ("town", {"q": 200}, "p, q"),
        ("coil", {"g": -1}, "g"),
    ],
)  # fmt: skip
def test_suspicious_data_are_found_with_component_value_and_reason(
    component: str, changes: dict, field: str
) -> None:
    grid = sound_grid()
    grid.update(component, **changes)
    (found,) = (s for s in inspect(grid).suspicions if s.component)
    assert (found.component, found.field) == (component, field)
    assert found.why
    grid.update(component, in_service=False)
    assert component not in {s.component for s in inspect(grid).suspicions}


def test_resistance_above_reactance_is_usual_at_low_voltage() -> None:
    grid = sound_grid()
    grid.update("line", r=0.2)
    for bus in ("a", "b"):
        grid.update(bus, base_kv=0.4)
    assert suspected(grid, "line") == set()


def test_what_is_suspicious_about_the_whole() -> None:
    grid = sound_grid()
    grid.remove("town")
    assert suspected(grid) == {"demand"}
    grid = sound_grid()
    grid.update("town", p=300)
    assert suspected(grid) == {"capacity"}
    grid = sound_grid()
    for unit in ("unit", "gas"):
        grid.update(unit, cost=om.Polynomial(0, 5, 0))
    assert suspected(grid) == {"cost"}
    grid.update("gas", cost=om.Polynomial())
    grid.update("unit", cost=om.PiecewiseLinear([(0, 0), (100, 0)]))
    assert suspected(grid) == {"cost"}
    grid = sound_grid()
    grid.update("unit", in_service=False)
    grid.c = om.Bus()
    grid.d = om.Bus()
    grid.far = om.Branch("c", "d", r=0.01, x=0.1, rating=10)
    grid.mine = om.Load("d", p=7)
    assert [(i.buses, i.demand_mw, i.capacity_mw) for i in inspect(grid).islands] == [(2, 50, 100), (2, 7, 0)]
    assert suspected(grid) == {"capacity"}
    grid.remove("mine")
    grid.remove("far")
    assert suspected(grid, "c") == {"in_service"}


def test_positions_fill_a_square() -> None:
    for path in (CASE33, DATA / "pglib" / "pglib_opf_case300_ieee.m"):
        placed = np.array(list(positions(topology(om.read_network(path))).values()))
        assert placed.min(axis=0) == pytest.approx(0)
        assert placed.max(axis=0) == pytest.approx(1)


def test_a_map_is_refused_in_words(tmp_path: Path) -> None:
    grid = sound_grid()
    for name in ("map", "map.xyz", "no/map.png", "nul\0.png"):
        with pytest.raises(ResultError, match=r"\.png, \.pdf, \.svg|cannot be written"):
            save_map(grid, tmp_path / name)
    with pytest.raises(ResultError, match="0 buses"):
        save_map(om.Network(), tmp_path / "map.png")


def test_info(call: Call, tmp_path: Path) -> None:
    code, out, _ = call("info", CASE33, "--out", tmp_path / "map.png")
    assert code == 0
    assert "radial" in out and "3.72 MW" in out and "no rating" in out and "●" in out
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")
    code, out, _ = call("info", CASE33, "--json")
    found = json.loads(out)
    assert (code, found["loops"], found["picture"]) == (0, 0, None)
    assert {"component", "kind", "field", "value", "why"} == set(found["suspicions"][0])
    assert set(found) == {*Inspection.__dataclass_fields__, "picture"}


def test_info_on_a_scenario_has_its_series(call: Call) -> None:
    code, out, _ = call("info", CASE5, "--json")
    found = json.loads(out)
    scenario = om.load_scenario(CASE5)
    total = sum(scenario.profiles[f"load{n}.p"] for n in (2, 3, 4))
    assert code == 0
    assert found["peak_mw"] == pytest.approx(total.max())
    assert found["steps"] == len(total)
    assert found["peak_step"] == int(total.argmax())


def test_a_large_network_is_counted_instead_of_drawn(call: Call, tmp_path: Path) -> None:
    ring = om.Network()
    for n in range(400):
        ring.add(str(n + 1), om.Bus(reference=n == 0))
    for n in range(400):
        ring.add(f"line{n}", om.Branch(str(n + 1), str((n + 1) % 400 + 1), r=0.01, x=0.1, rating=10))
    ring.unit = om.Generator("1", p=(0, 10))
    path = om.write_network(ring, tmp_path / "ring.m")
    code, out, _ = call("info", path)
    assert code == 0
    assert "branches per bus" in out and "█ 400" in out and "●" not in out


# Doctor -------------------------------------------------------------------------------------------


def test_the_doctor_solves_with_every_solver(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    from solvers import back_ends, installed

    code, out, _ = call("doctor", "--json")
    found = json.loads(out)
    assert (code, found["healthy"]) == (0, True)
    assert found["versions"]["opfmodel"] == version("opfmodel")
    assert {(t["back_end"], t["solver"]) for t in found["tests"]} == {
        (name, solver) for name, end in back_ends().items() for solver in installed(end)
    }
    assert {p["name"]: p["version"] for p in found["optional"]}["pandapower"] == version("pandapower")
    monkeypatch.setattr(installation, "_COST", 1000.0)
    code, out, _ = call("doctor")
    assert code == 1
    assert "FAILED" in out


def test_the_version_is_an_attribute() -> None:
    assert om.__version__ == version("opfmodel")
    with pytest.raises(AttributeError):
        _ = om.no_such_name
    assert importlib.import_module("opfmodel").__version__ == om.__version__


# Convert ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", CASES, ids=lambda p: p.stem)
def test_a_network_is_read_back_from_a_scenario_exactly(path: Path, tmp_path: Path) -> None:
    network = om.read_network(path)
    again = om.load_scenario(write_scenario(network, tmp_path / "copy.yaml")[0]).network
    assert contents(again) == contents(network)
    assert (again.name, again.base_mva) == (network.name, network.base_mva)


def test_every_field_of_every_kind_survives_a_scenario(rich_grid: om.Network, tmp_path: Path) -> None:
    again = om.load_scenario(write_scenario(rich_grid, tmp_path / "copy.yaml")[0]).network
    assert contents(again) == contents(rich_grid)


@given(st.one_of(st.text(), st.floats(), st.integers(-(2**60), 2**60), st.booleans(), st.none()))
def test_a_scalar_is_read_back(value: object) -> None:
    from opfmodel.data.yaml import parse
    from opfmodel.errors import ScenarioError

    try:
        again = parse(f"key: [{scalar(value)}]", "text")[0]["key"][0]
    except ScenarioError:
        assert isinstance(value, str) and not value.isprintable()
        return
    assert repr(again) == repr(value)


@pytest.mark.parametrize("suffix", [".m", ".yaml"])
@pytest.mark.parametrize(
    "path", [p for p in CASES if "case300" not in p.stem and "case118" not in p.stem], ids=lambda p: p.stem
)
def test_a_converted_case_has_the_same_optimum(path: Path, suffix: str, call: Call, tmp_path: Path) -> None:
    to = tmp_path / f"copy{suffix}"
    code, out, _ = call("convert", path, to, "--json")
    assert (code, json.loads(out)["losses"]) == (0, [])
    again = om.load_scenario(to).network if suffix == ".yaml" else om.read_network(to)
    network = om.read_network(path)
    if contents(again) == contents(network):
        assert again.base_mva == network.base_mva  # the same problem
        return
    assert suffix == ".m"
    before, after = (om.MultiStage(n).solve() for n in (network, again))
    assert after.status == before.status
    if before.optimal:
        assert after.objective == pytest.approx(before.objective, rel=1e-8)


def test_convert_reports_what_it_wrote_and_lost(call: Call, tmp_path: Path, rich_grid: om.Network) -> None:
    (rich,) = write_scenario(rich_grid, tmp_path / "rich.yaml")
    to = tmp_path / "copy.m"
    code, out, err = call("convert", rich, to)
    assert (code, out, to.exists()) == (2, "", False)
    assert "cannot hold all of the network" in err and "battery: standing_loss" in err
    code, out, err = call("convert", rich, to, "--lossy", "--json")
    result = json.loads(out)
    assert (code, result["status"], result["written"]) == (0, "done", [str(to)])
    assert any("battery: standing_loss" in loss for loss in result["losses"])
    assert any("numbered from 1" in warning for warning in result["warnings"])
    assert not any("numbered from 1" in loss for loss in result["losses"])
    assert len(om.read_network(to).of(om.Bus)) == 4


def test_convert_states_the_losses_of_reading(call: Call, tmp_path: Path) -> None:
    source = tmp_path / "more.m"
    source.write_text((DATA / "matpower" / "case5.m").read_text() + "\nmpc.reserves = [\n1 3 10;\n];\n")
    code, _, err = call("convert", source, tmp_path / "a.yaml")
    assert (code, "mpc.reserves" in err) == (2, True)
    code, out, _ = call("convert", source, tmp_path / "a.yaml", "--lossy", "--json")
    assert (code, len(json.loads(out)["losses"])) == (0, 1)


def test_series_are_lost_in_files_of_one_moment(call: Call, tmp_path: Path) -> None:
    code, _, err = call("convert", CASE5, tmp_path / "a.m")
    assert (code, "time series" in err) == (2, True)
    network = sound_grid()
    network.attach(om.Profiles({"town.p": [1, 2]}))
    with pytest.raises(CaseError, match="1 time series"):
        om.write_network(network, tmp_path / "a.m", lossy=False)
    with pytest.warns(CaseWarning, match="lost: 1 time series"):
        om.write_network(network, tmp_path / "a.m")


@pytest.mark.parametrize(
    "calendar",
    [
        None,
        Calendar(np.datetime64("2025-03-29T23:30"), 0.25, "Europe/Berlin"),
        Calendar(np.datetime64("2024-02-29"), 1 / 3),
    ],
)
def test_attached_series_are_read_back_from_a_scenario(calendar: Calendar | None, tmp_path: Path) -> None:
    network = sound_grid()
    network.add('old "mill", east', om.Load("a", p=1))
    network.add("v1.2", om.Load("a", p=1))
    random = np.random.default_rng(1)
    keys = ("town.p", "town.q", "gas.p_max", "unit.c1", "line.rating", 'old "mill", east.p', "v1.2.p")
    series = {key: random.uniform(0, 100, 7) for key in keys}
    series["line.rating"][2] = np.inf
    network.attach(om.Profiles(series, calendar))
    written = write_scenario(network, tmp_path / "copy.yaml")
    assert [path.name for path in written] == ["copy.yaml", "copy.csv"]
    again = om.load_scenario(written[0])
    assert contents(again.network) == contents(network)
    assert again.profiles.calendar == calendar
    assert set(map(str, again.profiles)) == set(keys)
    for key, values in series.items():
        assert again.profiles[key].tolist() == values.tolist(), key


def test_a_pypsa_file_becomes_a_scenario_with_its_series(call: Call, tmp_path: Path) -> None:
    pypsa = pytest.importorskip("pypsa")
    n = pypsa.Network(snapshots=pd.date_range("2025-01-01", periods=4, freq="h"))
    n.add("Bus", ["north", "south"], v_nom=110.0)
    n.add("Line", "tie", bus0="north", bus1="south", r=1.0, x=10.0, s_nom=80.0)
    n.add("Generator", "wind", bus="north", p_nom=100.0, p_max_pu=[0.2, 0.9, 0.5, 0.1], marginal_cost=1.0)
    n.add("Generator", "gas", bus="south", p_nom=100.0, marginal_cost=50.0)
    n.add("Load", "town", bus="south", p_set=[40.0, 60.0, 70.0, 50.0])
    n.add("StorageUnit", "cell", bus="south", p_nom=10.0, max_hours=4.0, state_of_charge_initial=20.0)
    n.export_to_netcdf(tmp_path / "grid.nc")
    code, out, err = call("convert", tmp_path / "grid.nc", tmp_path / "grid.yaml", "--json")
    assert code == 0, err
    assert [Path(path).name for path in json.loads(out)["written"]] == ["grid.yaml", "grid.csv"]
    scenario = om.load_scenario(tmp_path / "grid.yaml", overrides={"controller.formulation": "dc-matpower"})
    network = om.read_network(tmp_path / "grid.nc")
    assert contents(scenario.network) == contents(network)
    assert scenario.profiles.calendar == network.profiles.calendar
    plan = om.MultiStage(scenario.network, 4, profiles=scenario.profiles, formulation="dc-matpower").solve()
    n.optimize(solver_name="highs", include_objective_constant=False)
    assert plan.objective == pytest.approx(n.objective, rel=1e-6)


def test_steps_that_not_all_series_have_are_lost(tmp_path: Path) -> None:
    network = sound_grid()
    network.attach(om.Profiles({"town.p": [1, 2], "town.q": [1, 2, 3]}))
    with pytest.raises(CaseError, match=r"steps after 2 of the series town\.q"):
        write_scenario(network, tmp_path / "a.yaml")


def test_numbers_that_no_scenario_holds_are_lost(tmp_path: Path) -> None:
    network = sound_grid()
    network.add("idle", om.Generator("a", p=(0, np.nan), in_service=False))
    with pytest.raises(CaseError, match="idle: p: not a finite number"):
        write_scenario(network, tmp_path / "a.yaml")
    with pytest.warns(CaseWarning, match="idle: p"):
        again = om.load_scenario(write_scenario(network, tmp_path / "a.yaml", lossy=True)[0]).network
    network.remove("idle")
    assert contents(again) == contents(network)


# pandapower's converter changes some transformers of the 300-bus case; that is found and refused.
EXACT = [p for p in CASES if not re.search("case300|case118|__", p.stem)]
NO_POWER_FLOW = {"pglib_opf_case39_epri", "pglib_opf_case3_lmbd"}  # at the set-points of the file


def without_angle_limits(network: om.Network) -> om.Network:
    for name in network.of(om.Branch):
        network.update(name, angle=(-360.0, 360.0))
    return network


@pytest.mark.parametrize("path", EXACT, ids=lambda p: p.stem)
def test_a_network_is_read_back_from_pandapower_with_the_same_optimum_and_power_flow(
    path: Path, tmp_path: Path
) -> None:
    network = without_angle_limits(om.read_network(path))
    for name, branch in network.of(om.Branch).items():
        if branch.emergency_rating is not None:  # which pandapower cannot hold either
            network.update(name, emergency_rating=None)
    with pytest.warns(CaseWarning, match="renamed by pandapower"):
        again = om.read_network(write_pandapower(network, tmp_path / "grid.json"))
    assert list(again.of(om.Bus)) == list(network.of(om.Bus))
    before, after = (om.MultiStage(n).solve() for n in (network, again))
    assert after.status == before.status == "locally_optimal"
    assert after.objective == pytest.approx(before.objective, rel=1e-8)
    flows = [om.power_flow(n) for n in (network, again)]
    vm, other = (np.array([bus["vm"] for bus in flow.summary()["buses"]]) for flow in flows)
    assert [flow.converged for flow in flows] == [path.stem not in NO_POWER_FLOW] * 2
    assert other == pytest.approx(vm, abs=1e-8, nan_ok=True)


def test_what_pandapower_cannot_hold_is_refused(call: Call, tmp_path: Path) -> None:
    grid = sound_grid()
    grid.update("line", angle=(-20.0, 30.0))
    grid.update("unit", ramp=7.0)
    to = tmp_path / "grid.json"
    with pytest.raises(CaseError) as refused:
        write_pandapower(grid, to)
    for what in ("angle limits of line", "ramps of unit", "storages cell"):
        assert what in str(refused.value)
    assert not to.exists()
    with pytest.warns(CaseWarning, match="lost: storages cell"):
        write_pandapower(grid, to, lossy=True)
    assert len(om.read_network(to).of(om.Generator)) == 2
    case = DATA / "pglib" / "pglib_opf_case300_ieee.m"
    code, _, err = call("convert", case, to)
    assert code == 2
    assert "angle limits" in err and "admittances at" in err


def test_writing_for_pandapower_needs_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandapower", None)
    with pytest.raises(CaseError, match=r"pip install 'opfmodel\[pandapower\]'"):
        write_pandapower(sound_grid(), tmp_path / "grid.json")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("convert", CASE14, "copy.xyz"), "no format is written under '.xyz'"),
        (("convert", CASE14, "copy"), "accepted are"),
        (("convert", CASE14, CASE14), "is the file to convert"),
        (("convert", "nowhere.m", "copy.m"), "no such file"),
        (("convert", CASE14, "no/such/folder.m"), "cannot be written"),
        (("convert", CASE14, "no/such/folder.yaml"), "cannot be written"),
        (("init", "scenario.txt"), "must end in .yaml"),
        (("init", "no/such/folder.yaml"), "cannot be written"),
        (("init", "a.yaml", "--from", "nowhere.m"), "no such file"),
        (("info", "nowhere.m"), "no such file"),
        (("info", CASE5, "--lossy"), "network.lossy"),
        (("info", CASE14, "--out", "map.bmp"), "can be saved as"),
    ],
)
def test_mistakes_are_one_line(
    call: Call, arguments: tuple, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, err = call(*arguments)
    assert (code, out) == (2, "")
    assert err.startswith("error: ") and err.count("\n") == 1 and message in err
    assert list(tmp_path.iterdir()) == []


# Init ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("source", [None, CASE14, CASE33, DATA / "psse" / "four-buses.raw"])
def test_a_scenario_to_start_from_is_valid_and_runs(source: Path | None, call: Call, tmp_path: Path) -> None:
    path = tmp_path / "start.yaml"
    start = () if source is None else ("--from", source)
    code, out, _ = call("init", path, *start, "--json")
    assert (code, json.loads(out)["written"]) == (0, [str(path)])
    assert call("validate", path)[0] == 0
    for variant in ((), ("--variant", "dc")):
        code, out, _ = call(
            "run", path, "--out", tmp_path / "out", "--json", "--no-figures", "--force", *variant
        )
        assert (code, json.loads(out)["status"]) == (0, "done"), variant
    lines = path.read_text().splitlines()
    stated = [line for line in lines if line and not line[0].isspace() and not line.startswith("#")]
    assert {line.partition(":")[0] for line in stated} >= {"network", "time", "cost", "controller"}
    assert all(len(line) <= 120 for line in lines)


def test_a_file_is_overwritten_only_by_force(call: Call, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("mine")
    code, _, err = call("init", path)
    assert (code, path.read_text()) == (2, "mine")
    assert "--force" in err
    assert call("init", path, "--force")[0] == 0
    assert path.read_text() == template()


def test_a_scenario_from_a_lossy_file_says_so(call: Call, tmp_path: Path) -> None:
    source = tmp_path / "more.m"
    source.write_text((DATA / "matpower" / "case5.m").read_text() + "\nmpc.reserves = [\n1 3 10;\n];\n")
    assert call("init", tmp_path / "a.yaml", "--from", source)[0] == 2
    assert call("init", tmp_path / "a.yaml", "--from", source, "--lossy")[0] == 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CaseWarning)
        assert len(om.load_scenario(tmp_path / "a.yaml").network.of(om.Bus)) == 5


def test_a_network_without_demand_gives_a_scenario_too(tmp_path: Path) -> None:
    grid = sound_grid()
    for name in ("town", "cell"):
        grid.remove(name)
    write_scenario(grid, tmp_path / "grid.yaml")
    om.write_network(grid, tmp_path / "grid.m")
    (tmp_path / "start.yaml").write_text(template(om.read_network(tmp_path / "grid.m"), "grid.m"))
    assert om.load_scenario(tmp_path / "start.yaml").simulate().status == "done"
