"""Plugins of another distribution are found, listed and used by name; broken ones do no harm."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path

import networkx as nx
import numpy as np
import pytest
from conftest import DATA, ROOT, SCENARIOS, Call
from distributions import metadata, visible
from jsonschema import Draft202012Validator
from numpy.testing import assert_allclose

import opfmodel as om
import solvers
from opfmodel import plugins
from opfmodel.check import check
from opfmodel.data.yaml import parse
from opfmodel.errors import ModelError, PluginError, ScenarioError
from opfmodel.plugins.catalogue import Entry, catalogue
from opfmodel.scenario.reference import scenario_schema

SOURCE = ROOT / "tests" / "plugins"
SUBURB = SOURCE / "suburb.yaml"
MINIMAL = "network:\n  buses: {a: {}}\n  generators: {g: {bus: a, p: [0, 9]}}\n"


@pytest.fixture
def installed(example_plugins: Path) -> Iterator[Path]:
    with visible(example_plugins):
        yield example_plugins


@pytest.fixture(scope="module")
def broken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A distribution of plugins that are broken in different ways."""
    target = tmp_path_factory.mktemp("broken")
    (target / "fails.py").write_text("import no_such_library\n")
    (target / "leaves.py").write_text("raise SystemExit('bye')\n")
    (target / "strange.py").write_text(
        "number = 3\n"
        "class Stranger: 'No base class.'\n"
        "from opfmodel.formulations import Formulation\n"
        "from opfmodel.model import Device\n"
        "class Alias(Formulation):\n    name = 'ac'\n"
        "class Bodiless(Device): 'No component.'\n"
        "class Thing:\n    kind, plural = 'impostor', 'generators'\n"
        "class Impostor(Device):\n    component = Thing\n"
        "class Shy:\n    name = 'shy'\n    accepts = None\n    solvers = prepare = len\n"
        "class Sick:\n    name = 'sick'\n    prepare = len\n"
        "    def __init__(self):\n        import solvers\n        self.accepts = solvers.Kind.LINEAR\n"
        "    def solvers(self):\n        raise OSError('licence server')\n"
    )
    points = {
        "opfmodel.objectives": {"number": "strange:number", "economic": "strange:Stranger"},
        "opfmodel.formulations": {
            "exits": "leaves:Formulation",
            "missing": "strange:Missing",
            "alias": "strange:Alias",
        },
        "opfmodel.devices": {
            "reactor": "fails:Device",
            "stranger": "strange:Stranger",
            "bodiless": "strange:Bodiless",
            "impostor": "strange:Impostor",
        },
        "opfmodel.profiles": {"odd": "not a reference"},
        "solvers.backends": {"shy": "strange:Shy", "sick": "strange:Sick", "gone": "leaves:BackEnd"},
    }
    metadata(target, "broken-plugins", points)
    return target


def listed() -> dict[tuple[str, str, str], Entry]:
    return {(e.sort, e.name, e.origin): e for e in catalogue()}


# Found and listed -------------------------------------------------------------------------------


def test_the_catalogue_lists_all_plugins_with_their_origin(installed: Path) -> None:
    entries = listed()
    for sort, name in (
        ("objective", "emissions"),
        ("formulation", "lindistflow"),
        ("device", "fleet"),
        ("profile", "repeat"),
        ("forecast", "average"),
        ("plant", "inexact"),
        ("back end", "linprog"),
    ):
        entry = entries[sort, name, "opfmodel-example-plugins"]
        assert not entry.broken
        assert entry.summary[0].isupper()
    assert {sort for sort, _, origin in entries if origin == "opfmodel"} == {*plugins.GROUPS, "back end"}


def test_removed_plugins_are_forgotten(installed: Path) -> None:
    with visible(installed):
        assert "fleet" in plugins.plugins("device")
    sys.path.remove(str(installed))
    plugins.rescan()
    assert "fleet" not in plugins.plugins("device")
    sys.path.insert(0, str(installed))


@pytest.mark.parametrize(
    ("sort", "name", "reason"),
    [
        ("objective", "number", "3 is not a subclass of opfmodel.objectives.base.Objective"),
        ("objective", "economic", "shadowed by the objective of the same name from opfmodel"),
        ("formulation", "exits", r"formulation 'exits' .* \(leaves:Formulation\): SystemExit: bye"),
        ("formulation", "missing", "AttributeError: module 'strange' has no attribute 'Missing'"),
        ("formulation", "alias", "its name is 'ac'; must be 'alias'"),
        ("device", "bodiless", "its component.kind is None; must be 'bodiless'"),
        ("device", "reactor", "ModuleNotFoundError: No module named 'no_such_library'"),
        ("device", "stranger", "is not a subclass of opfmodel.model.Device"),
        ("profile", "odd", "cannot be loaded"),
        ("back end", "shy", "strange:Shy is not a back end: name = 'shy', accepts = None"),
        ("back end", "sick", "solvers: OSError: licence server"),
        ("back end", "gone", "its module exits: bye"),
    ],
)
def test_a_broken_plugin_is_reported_by_name(broken: Path, sort: str, name: str, reason: str) -> None:
    with visible(broken):
        entry = listed()[sort, name, "broken-plugins"]
        assert entry.broken
        assert entry.summary.startswith("BROKEN: ")
        assert re.search(reason, entry.summary), entry.summary


def test_broken_plugins_do_not_affect_others(broken: Path, tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(MINIMAL)
    with visible(broken):
        assert om.load_scenario(tmp_path / "s.yaml").simulate().status == "done"
        assert sum(entry.broken for entry in catalogue()) == 12
        made = om.MultiStage(om.load_scenario(tmp_path / "s.yaml").network, formulation="dc")
        made.constrain("low", lambda s: s.bus.vm >= 1)
        with pytest.raises(ModelError, match=r"formulations that do: ac, ac-rectangular$"):
            made.compile()  # lists only formulations that load
        assert "sick" not in solvers.find("clarabel", solvers.Kind.LINEAR)[0].name


def test_using_a_broken_plugin_reports_the_reason(broken: Path, tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    with visible(broken):
        with pytest.raises(
            PluginError, match=r"'exits' from broken-plugins cannot be loaded .* SystemExit: bye"
        ):
            plugins.load("formulation", "exits")
        path.write_text(MINIMAL + "controller: {formulation: exits}\n")
        with pytest.raises(ScenarioError, match=r":4:14: controller.formulation: .*SystemExit: bye"):
            om.load_scenario(path)
        path.write_text(MINIMAL + "  reactors: {r: {bus: a}}\n")
        with pytest.raises(
            ScenarioError, match=r":4:3: network.reactors: unknown key.*device 'reactor' .*no_such_library"
        ):
            om.load_scenario(path)
        with pytest.raises(ScenarioError, match=r"device 'impostor' of broken-plugins: .*plural"):
            om.load_scenario(path)
        path.write_text(MINIMAL + "controller: {solver: sick}\n")
        with pytest.raises(ScenarioError, match=r"solver .*'sick'; .*could not be loaded: .*sick .*licence"):
            om.load_scenario(path)


# Used from a scenario file ----------------------------------------------------------------------


def test_the_states_of_a_device_are_analysed(installed: Path) -> None:
    found = om.analyze(om.load_scenario(SUBURB), ["steady_state"]).checks["steady_state"]
    assert "commuters.level" in found.figures["state"]
    assert found.figures["path"]["connected"]


def test_a_scenario_uses_plugins_by_name(installed: Path) -> None:
    scenario = om.load_scenario(SUBURB)
    run = scenario.simulate()
    assert run.status == "done"
    data = run.data
    assert (data.attrs["formulation"], set(data["level"].dims)) == ("lindistflow", {"time", "fleet"})
    assert data["fleet_bus"].values.tolist() == ["close"]
    series = scenario.profiles
    report = check(scenario.network, data, series)
    assert report.max_violation < 1e-8
    assert set(report.unchecked) == {
        "limits and cost of the fleets",
        "branch equations of the formulation 'lindistflow'",
    }
    assert "active balance" in report.violations
    assert "not checked" in str(report)
    assert data["pf"].sel(branch="feeder").max() <= 9 + 1e-9


def test_the_check_finds_power_that_a_fleet_does_not_draw(installed: Path) -> None:
    scenario = om.load_scenario(SUBURB)
    data = scenario.simulate().data
    series = scenario.profiles
    wrong = data.copy(deep=True)
    wrong["fleet_p"].loc[{"bus": "close", "time": 2.0}] -= 1.0
    assert check(scenario.network, wrong, series).violations["active balance"].value == pytest.approx(0.1)
    report = check(scenario.network, data.drop_vars("fleet_p"), series)
    assert "bus balances: the results do not include the power of the fleets" in report.unchecked
    report = check(scenario.network, data.drop_vars("pt"), series)
    assert "bus balances: the results do not include the power of the branches" in report.unchecked


def test_the_command_line_uses_plugins(installed: Path, call: Call, tmp_path: Path) -> None:
    arguments = ("run", SUBURB, "--json", "--out", tmp_path, "--no-figures", "--set", "time.steps=2")
    command = [sys.executable, "-c", "from opfmodel import cli; cli.main()", *map(str, arguments)]
    environment = os.environ | {"PYTHONPATH": str(installed)}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    summary = json.loads(done.stdout)
    assert (done.returncode, summary["status"], summary["steps"]) == (0, "done", 2)
    assert "limits and cost of the fleets" in summary["unchecked"]
    assert "Traceback" not in done.stderr
    assert "lindistflow" in call("list")[1]


def test_every_formulation_serves_a_fleet(installed: Path) -> None:
    scenario = om.load_scenario(SUBURB)
    costs = {}
    for formulation in ("ac", "soc", "dc", "copperplate", "lindistflow"):
        plan = om.MultiStage(
            scenario.network,
            12,
            formulation=formulation,
            objective=scenario.problem.objective,
            profiles=scenario.profiles,
        ).solve()
        assert plan.optimal
        level = plan.data["level_next"].sel(fleet="commuters").values
        assert level[6] >= 10 - 1e-4  # enough for the departure
        assert_allclose(plan.data["charge"].values[7:, 0], 0, atol=1e-4)
        costs[formulation] = plan.objective
    assert costs["copperplate"] <= costs["dc"] + 1e-3 <= costs["ac"]
    assert costs["soc"] == pytest.approx(costs["ac"], rel=1e-4)  # radial


# What the examples compute ----------------------------------------------------------------------


def test_lindistflow_is_the_sum_of_the_drops_along_the_path(installed: Path) -> None:
    grid = om.read_network(SCENARIOS / "data" / "case33bw.m")
    plan = om.MultiStage(grid, formulation="lindistflow").solve()
    branches = {n: b for n, b in grid.of(om.Branch).items() if b.in_service}
    tree = nx.Graph([(b.from_bus, b.to_bus, {"branch": b}) for b in branches.values()])
    (root,) = {g.bus for g in grid.of(om.Generator).values()}
    data = plan.data.isel(time=0)
    flow = {}
    for branch in branches.values():  # the load downstream of the branch
        paths = nx.single_source_shortest_path(tree, root)
        behind = [p[-1] for p in paths.values() if {branch.from_bus, branch.to_bus} <= set(p)]
        loads = [load for load in grid.of(om.Load).values() if load.bus in behind]
        flow[branch] = sum(complex(load.p, load.q) for load in loads) / grid.base_mva
    for bus, path in nx.single_source_shortest_path(tree, root).items():
        drop = 0.0
        for ends in pairwise(path):
            branch = tree.edges[ends]["branch"]
            drop += 2 * (branch.r * flow[branch].real + branch.x * flow[branch].imag)
        expected = float(data["w"].sel(bus=root)) - drop
        assert float(data["w"].sel(bus=bus)) == pytest.approx(expected, abs=1e-7)
    exact = om.MultiStage(grid).solve().data.isel(time=0)
    assert np.abs(np.sqrt(data["w"]) - exact["vm"]).max() < 0.02


def test_lindistflow_refuses_a_loop(installed: Path) -> None:
    grid = om.read_network(DATA / "matpower" / "case5.m")
    with pytest.raises(ModelError, match="'lindistflow' is for radial grids; 'case5' has a loop"):
        om.MultiStage(grid, formulation="lindistflow").solve()


def test_a_price_of_emissions_moves_generation(installed: Path) -> None:
    from example_plugins.emissions import Emissions

    grid = om.Network("two-units")
    grid.bus = om.Bus()
    grid.coal = om.Generator("bus", p=(0, 100), cost=om.Polynomial(0, 20, 0))
    grid.gas = om.Generator("bus", p=(0, 100), cost=om.Polynomial(0, 40, 0))
    grid.town = om.Load("bus", p=80)
    for price, coal in ((30.0, 80.0), (50.0, 50.0)):  # worth it above 20 / (0.9 - 0.4) = 40 $/t
        objective = om.Economic() + Emissions({"coal": 0.9, "gas": 0.4}, price, limit=57.0)
        plan = om.MultiStage(grid, 2, formulation="dc", objective=objective).solve()
        assert_allclose(plan.data["pg"].sel(generator="coal"), coal, atol=1e-3)
    with pytest.raises(ModelError, match="emissions: no generator is named 'cola'; did you mean 'coal'"):
        om.MultiStage(grid, objective=Emissions({"cola": 1.0}, 1.0)).solve()


def test_errors_in_options_of_a_plugin_are_located(installed: Path, tmp_path: Path) -> None:
    text = SUBURB.read_text()
    for old, new, message in (
        ("price: 50", "prise: 50", "objective 'emissions' has no option 'prise'; did you mean 'price'"),
        ("price: 50", "price: dear", "emissions': price = 'dear'"),
        ("field: driving", "field: diving", "a fleet has no number 'diving'"),
        ("energy: 12", "energie: 12", "unknown field of a fleet; did you mean 'energy'"),
        ("fleets:", "fleet:", r"network.fleet: unknown key; did you mean 'fleets'"),
        ("lindistflow", "lindistflo", "there is no formulation 'lindistflo'; did you mean 'lindistflow'"),
    ):
        (tmp_path / "s.yaml").write_text(text.replace(old, new, 1))
        with pytest.raises(ScenarioError, match=message):
            om.load_scenario(tmp_path / "s.yaml")


def test_single_stages_are_rejected_when_a_fleet_couples_them(installed: Path) -> None:
    scenario = om.load_scenario(SUBURB)
    with pytest.raises(ModelError, match="fleet carries its level from stage to stage"):
        scenario.single_stages(6)


def test_the_schema_knows_installed_plugins(installed: Path) -> None:
    schema = scenario_schema()
    content, _ = parse(SUBURB.read_text(), "")
    assert list(Draft202012Validator(schema).iter_errors(content)) == []
    assert schema["$defs"]["fleet"]["properties"]["wear"]["description"].startswith("Cost of battery wear")
    content["network"]["fleets"]["commuters"]["wears"] = 1
    assert list(Draft202012Validator(schema).iter_errors(content))
    assert "fleet" not in scenario_schema({"opfmodel"})["$defs"]


def test_the_documentation_shows_the_sources() -> None:
    page = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
    shown = re.findall(r"```(?:py|ini|yaml)\n(.*?)```", page, flags=re.DOTALL)
    sources = [
        p for p in SOURCE.rglob("*") if p.suffix in (".py", ".cfg", ".yaml") and p.name != "__init__.py"
    ]
    assert sorted(shown) == sorted(path.read_text(encoding="utf-8") for path in sources)


def test_the_examples_are_short_and_the_documentation_states_their_length() -> None:
    page = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
    stated = {name: int(lines) for name, lines in re.findall(r"\| `(\w+\.py)` \| (\d+) \|", page)}
    folder = SOURCE / "example_plugins"
    assert stated == {
        path.name: len(path.read_text().splitlines())
        for path in folder.glob("*.py")
        if path.name != "__init__.py"
    }
    assert max(stated.values()) <= 80


@pytest.mark.slow
def test_pip_installs_the_same_entry_points(example_plugins: Path, tmp_path: Path) -> None:
    copy, site = tmp_path / "source", tmp_path / "site"
    shutil.copytree(SOURCE, copy)  # pip builds inside the source tree
    here = find_spec("setuptools") and find_spec("wheel")
    command = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--no-deps",
        "--target",
        str(site),
        str(copy),
    ]
    if here:
        command.append("--no-build-isolation")
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if not here and "No matching distribution found for setuptools" in done.stderr:
        pytest.skip("pip has neither setuptools nor a network to get it from")
    assert done.returncode == 0, done.stderr

    def points(folder: Path) -> set[str]:
        (file,) = folder.glob("opfmodel_example_plugins-*.dist-info/entry_points.txt")
        return {line.replace(" ", "") for line in file.read_text().splitlines() if line}

    assert points(site) == points(example_plugins)
    with visible(site):
        assert om.load_scenario(SUBURB).problem.solve().optimal
