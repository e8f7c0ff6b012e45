"""Per-unit arrays, islands and reference buses."""

from __future__ import annotations

from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
from conftest import demand, everything, two_bus
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import opfmodel as om
from opfmodel.check import check
from opfmodel.errors import ComponentError, NetworkError, ProfileError
from opfmodel.network.arrays import per_unit
from opfmodel.network.islands import connected
from opfmodel.network.physics import branch_admittance, branch_flow, polar_products


def test_quantities_are_in_per_unit(rich_grid: om.Network) -> None:
    arrays = per_unit(rich_grid)
    assert (arrays.base_mva, arrays.declared_mva) == (100, 50)  # chosen from the size, not the declared base
    assert_allclose(arrays.generator.p_max[:, 0], [0.6, 0.5])
    assert_allclose(arrays.generator.ramp[:, 0], [0.15, np.inf])
    assert_allclose(arrays.generator.c2[:, 0], [0.02 * 100**2, 0])
    assert_allclose(arrays.generator.c1[:, 0], [12 * 100, 0])
    assert_allclose(arrays.generator.segment_slope[:, 0], [25 * 100, 40 * 100])
    assert arrays.generator.segment_owner.tolist() == [1, 1]
    assert_allclose(arrays.storage.power_min[:, 0], [-0.12, -0.06])
    assert_allclose(arrays.storage.initial[:, 0], [0.15, (3 + 30) / 2 / 100])
    assert_allclose(arrays.branch.x[:2, 0], [0.16, 0.10])
    assert_allclose(arrays.branch.b[2], 0.1)
    assert_allclose(arrays.branch.b_from[2], 0.005)
    assert_allclose(arrays.branch.shift[1], np.deg2rad(3))
    assert_allclose(arrays.branch.angle_max[0], np.deg2rad(25))
    assert_allclose(arrays.branch.rating[:, 0], [0.6, 0.7, np.inf, 0.4])
    assert arrays.load.bus.tolist() == [1, 3, 2]
    for table in arrays.tables.values():
        for field, unit in table.units.items():
            owner = {
                "segment_slope": "segment",
                "segment_offset": "segment",
                "capability_limit": "capability",
            }
            rows = table.arrays[f"{owner[field]}_owner"] if field in owner else table.names
            shape = (len(rows), 1)
            quantity = table.arrays[field].dtype.kind == "f"
            assert quantity or not unit
            assert table.arrays[field].shape == (shape if quantity else shape[:1]), field
    assert_allclose(100 * arrays.load.p[:, 0], [40, 25, -6])


def rebased(grid: om.Network, base_mva: float) -> om.Network:
    """The same grid with impedances declared on another base."""
    made = om.Network(grid.name, base_mva)
    ratio = base_mva / grid.base_mva
    for name in grid:
        component = grid[name]
        if isinstance(component, om.Branch):
            powers = {"r": ratio, "x": ratio} | dict.fromkeys(ADMITTANCES, 1 / ratio)
            component = replace(component, **{k: f * getattr(component, k) for k, f in powers.items()})
        made.add(name, component)
    return made


ADMITTANCES = ("b", "g", "b_from", "g_from", "b_to", "g_to")


@pytest.mark.parametrize("formulation", ["ac", "ac-rectangular", "soc", "dc", "dc-losses"])
@pytest.mark.parametrize("base_mva", [1e-4, 0.01, 1.0, 1e3, 1e7])
def test_results_do_not_depend_on_the_base(formulation: str, base_mva: float) -> None:
    def solved(grid: om.Network) -> om.Plan:
        return om.MultiStage(grid, 4, formulation=formulation, profiles=demand(4)).solve()

    plan, other = solved(everything()), solved(rebased(everything(), base_mva))
    assert other.status == plan.status
    assert other.objective == pytest.approx(plan.objective, rel=1e-9)
    for name, values in plan.data.items():
        assert other.data[name].values == pytest.approx(values.values, rel=1e-5, abs=1e-5), name
    found, expected = (
        check(grid, p.data, demand(4)).worst
        for grid, p in ((rebased(everything(), base_mva), other), (everything(), plan))
    )
    assert found.relative <= 1e-6
    assert found.physical == pytest.approx(found.value * (base_mva if found.unit.startswith("M") else 1))
    assert expected.physical <= 1e-4


def test_an_elastic_plan_does_not_depend_on_the_base() -> None:
    series = {**demand(4), "town.p": [40.0, 120.0, 60.0, 40.0]}
    plans = [
        om.MultiStage(grid, 4, profiles=series).elastic_twin().solve()
        for grid in (everything(), rebased(everything(), 0.01))
    ]
    assert plans[0].shortages
    assert [str(s) for s in plans[0].shortages] == [str(s) for s in plans[1].shortages]


@pytest.mark.parametrize(
    "objective",
    [
        lambda unit: om.Economic(0.1 / unit**2, 0.2 / unit**2),
        lambda unit: om.StateOfChargeTracking(0.9, 30.0 / unit**2),
        lambda unit: om.SetpointTracking(
            om.Setpoints({"cheap.pg": 70.0, "tank.ps": 1.0}), 2 / unit**2, 1 / unit**2
        ),
        lambda unit: om.LinearQuadratic(
            {"pg": 2 / unit**2}, {"ps": 1 / unit**2}, {"pg": 30 / unit}, {"ps": 4 / unit}
        ),
    ],
    ids=["economic", "state of charge", "set-points", "linear-quadratic"],
)
def test_weights_are_in_per_unit_on_the_declared_base(objective) -> None:
    plans = [
        om.MultiStage(
            rebased(everything(), base), 3, objective=objective(50 / base), profiles=demand(3)
        ).solve()
        for base in (50, 100, 2)
    ]
    assert plans[0].objective > 0.1
    for plan in plans[1:]:
        assert plan.objective == pytest.approx(plans[0].objective, rel=1e-9)


@pytest.mark.parametrize(
    ("base_mva", "absurd"), [(1e-4, True), (0.01, True), (1, False), (1e6, False), (1e8, True)]
)
def test_an_implausible_base_is_noted(base_mva: float, absurd: bool) -> None:
    notes = om.MultiStage(rebased(two_bus(), base_mva)).notes
    assert any(f"base_mva = {base_mva:g} for a system of 200 MW" in note for note in notes) is absurd


@pytest.mark.parametrize(
    ("capacity", "scale_mva"),
    [(0.0, 100), (0.05, 0.01), (9.9, 1), (10, 10), (999, 100), (3e5, 100), (np.inf, 10)],
)
def test_the_scale_of_a_system(capacity: float, scale_mva: float) -> None:
    grid = om.Network("scale", base_mva=7)
    grid.bus = om.Bus()
    grid.unit = om.Generator("bus", p=(0, capacity))
    if np.isinf(capacity):
        grid.town = om.Load("bus", p=40)
        grid.lake = om.Storage("bus", energy=5, power=(-1, np.inf))
    assert grid.scale_mva == pytest.approx(scale_mva)


def test_an_unknown_bus_is_named(grid: om.Network) -> None:
    grid.wire = om.Branch("north", "sout", r=0, x=1)
    with pytest.raises(ComponentError, match=r"wire: to_bus = 'sout': no such bus; did you mean 'south'\?"):
        per_unit(grid)


def test_components_out_of_service_are_left_out_and_reported(rich_grid: om.Network) -> None:
    rich_grid.update("cable", in_service=False)
    rich_grid.update("sun", in_service=False)
    arrays = per_unit(rich_grid)
    assert arrays.branch.names == ("line", "transformer", "ring")
    assert arrays.load.names == ("town", "mill")
    assert arrays.notes == ("out of service, left out: 'cable', 'sun'",)


def test_invalid_data_out_of_service_are_noted(rich_grid: om.Network) -> None:
    rich_grid.add("old", om.Generator("a", p=(5.4, 2.0), in_service=False))
    rich_grid.add("gone", om.Bus(vm=(1.1, 0.9), in_service=False))
    rich_grid.update("sun", in_service=False)
    arrays = per_unit(rich_grid)
    assert arrays.generator.names == ("cheap", "dear")
    assert arrays.left_out == ("sun", "old", "gone")
    (note,) = (n for n in arrays.notes if "with invalid data" in n)
    assert "'old', 'gone'" in note
    assert "old: p = (5.4, 2.0)" in note
    assert "sun" not in note


def test_components_at_a_bus_out_of_service_are_left_out(rich_grid: om.Network) -> None:
    rich_grid.update("d", in_service=False)
    arrays = per_unit(rich_grid)
    assert arrays.bus.names == ("a", "b", "c")
    assert "'battery'" in arrays.notes[0]
    assert arrays.branch.names == ("line", "transformer")


def test_every_island_has_one_reference(rich_grid: om.Network) -> None:
    for branch in ("line", "cable"):
        rich_grid.remove(branch)
    arrays = per_unit(rich_grid)  # b-c and a-d
    assert arrays.n_islands == 2
    assert arrays.island.tolist() == [0, 1, 1, 0]
    assert arrays.reference.tolist() == [0, 1]  # a has the larger generator, b is declared
    assert arrays.notes[0] == "2 islands, each with its own reference bus"
    assert "no reference bus declared in the island of 'a'; 'a' is used" in arrays.notes


@given(st.lists(st.tuples(st.integers(0, 11), st.integers(0, 11)), max_size=15))
def test_islands_are_those_of_networkx(pairs: list[tuple[int, int]]) -> None:
    graph = nx.Graph(pairs)
    graph.add_nodes_from(range(10))
    expected = sorted(map(sorted, nx.connected_components(graph)))
    assert sorted(map(sorted, connected(range(10), pairs))) == expected


def test_too_many_references_are_reported(grid: om.Network) -> None:
    grid.update("south", reference=True)
    assert per_unit(grid).notes == ("several reference buses in one island; 'north' is used",)


def test_an_isolated_bus_is_left_out_and_reported(grid: om.Network) -> None:
    grid.west = om.Bus()
    arrays = per_unit(grid)
    assert arrays.bus.names == ("north", "south")
    assert arrays.notes == ("isolated buses with nothing connected, left out: 'west'",)


def test_a_network_needs_a_bus() -> None:
    with pytest.raises(NetworkError, match="has no bus in service"):
        per_unit(om.Network())


positive, angle = st.floats(0.01, 2), st.floats(-1.5, 1.5)


@given(
    r=st.floats(0, 0.5),
    x=positive,
    tap=st.floats(0.8, 1.2),
    shift=angle,
    vf=positive,
    vt=positive,
    theta=angle,
)
def test_branch_flows_agree_with_complex_circuit_theory(r, x, tap, shift, vf, vt, theta) -> None:
    shunt_from, shunt_to = 0.01 + 0.05j, 0.02 - 0.03j
    y = branch_admittance(r, x, 0.01, 0.05, 0.02, -0.03, tap, shift)
    flows = branch_flow(y, *polar_products(vf, vt, theta))
    v_from, v_to = vf * np.exp(1j * theta), vt + 0j
    behind = v_from / (tap * np.exp(1j * shift))
    through = (behind - v_to) / (r + 1j * x)
    s_from = behind * (through + behind * shunt_from).conj()
    s_to = v_to * (-through + v_to * shunt_to).conj()
    assert_allclose(flows, [s_from.real, s_from.imag, s_to.real, s_to.imag], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("series", "message"),
    [
        ({"wind.p_max": [3, -40]}, "'wind.p_max': step 1: -40: must be at least p_min = 0"),
        ({"wind.p_min": [3, 40]}, "'wind.p_min': step 1: 40: must be at most p_max = 30"),
        (
            {"wind.p_max": [9, 9], "wind.p_min": [0, 10, 99]},
            "'wind.p_max': step 1: 9: must be at least p_min = 10",
        ),
        ({"cell.energy_min": [0, 300]}, "'cell.energy_min': step 1: 300: must be at most energy = 200"),
        ({"cell.energy": [-1]}, "'cell.energy': step 0: -1: must be at least 0"),
        ({"cell.power_min": [11]}, "'cell.power_min': step 0: 11: must be at most power_max = 10"),
        ({"tie.rating": [5, -5]}, "'tie.rating': step 1: -5: must be at least 0"),
        ({"coal.ramp": [-5]}, "'coal.ramp': step 0: -5: must be at least 0"),
        ({"coal.c2": [-5]}, "'coal.c2': step 0: -5: must be at least 0 because"),
    ],
)
def test_series_keep_the_rules_of_their_fields(
    grid: om.Network, series: dict[str, list[float]], message: str
) -> None:
    grid.wind = om.Generator("south", p=(0, 30))
    with pytest.raises(ProfileError, match=message):
        om.MultiStage(grid, profiles=series)


@pytest.mark.parametrize(
    ("vm", "absurd"), [((104, 116), True), ((0.95, 1.05), False), ((0, np.inf), False), ((0.0, 0.05), True)]
)
def test_implausible_voltage_limits_are_noted(
    grid: om.Network, vm: tuple[float, float], absurd: bool
) -> None:
    grid.update("south", vm=vm)
    notes = per_unit(grid).notes
    assert any(f"vm = ({vm[0]:g}, {vm[1]:g}) at 'south'" in note for note in notes) is absurd


def test_an_assignment_to_a_component_says_how_to_change_it(grid: om.Network) -> None:
    with pytest.raises(ComponentError, match=r"Load: p = 60: .* network\.update\(name, p="):
        grid.town.p = 60
    grid.update("town", p=60)
    assert grid.town.p == 60


def test_bounds_may_move_together(grid: om.Network) -> None:
    om.MultiStage(grid, profiles={"coal.p_min": [250.0, 10], "coal.p_max": [300.0, 10]})


def test_aliases_name_buses_and_are_copied(grid: om.Network) -> None:
    assert grid.aliases == {}
    grid.alias({"north": "north", "busbar 2": "north", "dead": None, "south": "south"})
    assert list(grid.copy().aliases.items()) == [
        ("north", "north"),
        ("busbar 2", "north"),
        ("dead", None),
        ("south", "south"),
    ]
    with pytest.raises(NetworkError, match=r"alias 'busbar 3' = 'nort': no such bus; did you mean 'north'"):
        grid.alias({"busbar 3": "nort"})
    with pytest.raises(NetworkError, match=r"alias 'a' = 'coal': no such bus"):
        grid.alias({"a": "coal"})
