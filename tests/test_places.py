"""Places of buses: read from and written to network files, kept in results, and used by drawings."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from conftest import two_bus

import opfmodel as om
from opfmodel.network.cases.pandapower.write import write_pandapower
from opfmodel.network.inspection import topology
from opfmodel.network.layout import positions
from opfmodel.scenario.write import write_scenario


def placed() -> om.Network:
    """Two buses with places."""
    grid = two_bus()
    grid.update("north", x=8.0, y=54.0)
    grid.update("south", x=11.0, y=48.0)
    return grid


def test_results_hold_places_and_the_ends_of_branches() -> None:
    data = om.MultiStage(placed(), 1).solve().data
    assert data["bus_x"].values.tolist() == [8.0, 11.0]
    assert data["bus_y"].values.tolist() == [54.0, 48.0]
    assert data["branch_from_bus"].values.tolist() == ["north"]
    assert data["branch_to_bus"].values.tolist() == ["south"]
    assert data["rating"].values.tolist() == [120.0]
    assert "bus_x" not in om.MultiStage(two_bus(), 1).solve().data.coords


def test_a_drawing_keeps_places_in_proportion() -> None:
    at = positions(topology(placed()))
    assert at == {"north": (0.0, 1.0), "south": (0.5, 0.0)}


def test_buses_without_places_are_among_their_neighbours() -> None:
    grid = placed()
    grid.middle, grid.far = om.Bus(), om.Bus()
    grid.add("a", om.Branch("north", "middle", r=0.0, x=0.1))
    grid.add("b", om.Branch("middle", "south", r=0.0, x=0.1))
    grid.add("c", om.Branch("middle", "far", r=0.0, x=0.1))
    at = positions(topology(grid))
    assert at["middle"] == at["far"] == pytest.approx((0.25, 0.5))


def test_scenario_files_keep_places(tmp_path: Path) -> None:
    write_scenario(placed(), tmp_path / "grid.yaml")
    again = om.load_scenario(tmp_path / "grid.yaml").network
    assert (again["north"].x, again["north"].y) == (8.0, 54.0)


def test_pandapower_files_keep_places(tmp_path: Path) -> None:
    pandapower = pytest.importorskip("pandapower")
    net = pandapower.networks.case5()
    net.bus["geo"] = [json.dumps({"type": "Point", "coordinates": [float(n), 50.0]}) for n in range(5)]
    net.bus.loc[net.bus.index[2], "geo"] = None
    grid = om.from_pandapower(net, lossy=True)
    buses = list(grid.of(om.Bus).values())
    assert [bus.x for bus in buses] == [0.0, 1.0, None, 3.0, 4.0]
    assert buses[0].y == 50.0
    path = tmp_path / "grid.json"
    write_pandapower(grid, path, lossy=True)
    again = om.read_network(path, lossy=True)
    assert [bus.x for bus in again.of(om.Bus).values()] == [0.0, 1.0, None, 3.0, 4.0]


def test_pypsa_networks_keep_places() -> None:
    pypsa = pytest.importorskip("pypsa")
    net = pypsa.Network()
    net.add("Bus", ["a", "b"], v_nom=110.0, x=[8.0, 9.0], y=[50.0, 51.0])
    net.add("Line", "l", bus0="a", bus1="b", x=1.0, r=0.1, s_nom=100.0)
    net.add("Generator", "g", bus="a", p_nom=100.0, marginal_cost=10.0)
    net.add("Load", "d", bus="b", p_set=50.0)
    grid = om.from_pypsa(net)
    assert [(bus.x, bus.y) for bus in grid.of(om.Bus).values()] == [(8.0, 50.0), (9.0, 51.0)]
    net.c.buses.static[["x", "y"]] = 0.0
    assert om.from_pypsa(net)["a"].x is None


def test_matpower_files_lose_places_with_a_warning(tmp_path: Path) -> None:
    grid = om.Network("one", base_mva=100)
    grid.add("1", om.Bus(reference=True, x=1.0, y=2.0))
    with pytest.warns(match="places of buses on the map are left out"):
        om.write_network(grid, tmp_path / "one.m")
