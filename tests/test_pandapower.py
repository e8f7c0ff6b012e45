"""Networks of pandapower: compared with its own power flow and optimal power flow."""

from __future__ import annotations

import importlib
import logging
import pkgutil
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandapower as pp
import pytest
from conftest import SCENARIOS, examples
from hypothesis import Phase, assume, given, settings
from hypothesis import strategies as st
from newton import power_flow
from pandapower import toolbox
from pandapower_tables import copied, example

import opfmodel as om
from opfmodel.errors import CaseError, CaseWarning
from opfmodel.network.cases.pandapower import tables
from opfmodel.network.cases.pandapower.source import Source, element_names
from opfmodel.network.cases.pandapower.write import write_pandapower
from opfmodel.network.polygon import inside_box

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")
logging.getLogger("pandapower").setLevel(logging.CRITICAL)


def read(net: Any, **options: Any) -> om.Network:
    """Read a network without its warnings."""
    with warnings.catch_warnings(action="ignore"):
        return om.from_pandapower(net, **options)


# Voltages -----------------------------------------------------------------------------------------


def largest_difference(net: Any, network: om.Network) -> float:
    """Maximum difference of the complex voltages of two power flows, p.u., over all buses of the table.

    Buses that are dead in one and alive in the other count as infinitely different.
    """
    pp.runpp(net, calculate_voltage_angles=True, tolerance_mva=1e-9, max_iteration=50, numba=False)
    names = [element_names(net)["bus", index] for index in net.bus.index]
    theirs = net.res_bus.vm_pu.to_numpy() * np.exp(1j * np.radians(net.res_bus.va_degree.to_numpy()))
    carriers = [network.aliases.get(name, name) for name in names]
    start = {c: v for c, v in zip(carriers, theirs, strict=True) if c is not None and not np.isnan(v)}
    mine = power_flow(network, start)
    turns: dict[int, complex] = {}
    found = 0.0
    for carrier, voltage in zip(carriers, theirs, strict=True):
        if (carrier not in mine) != np.isnan(voltage):
            return np.inf
        if carrier in mine:
            # angles are relative to the reference bus
            turn = turns.setdefault(0, voltage / mine[carrier] / abs(voltage / mine[carrier]))
            found = max(found, abs(mine[carrier] * turn - voltage))
    return found


NETWORKS = [
    "case14", "case24_ieee_rts", "case33bw", "case118", "iceland", "GBreducednetwork", "create_cigre_network_hv",
    "create_cigre_network_mv", "mv_oberrhein", "example_multivoltage", "example_simple", "simple_four_bus_system",
    "create_kerber_landnetz_freileitung_1", "create_synthetic_voltage_control_lv_network", "panda_four_load_branch",
]  # fmt: skip
OTHERS = [
    "case4gs", "case5", "case6ww", "case9", "case30", "case39", "case57", "case89pegase", "case145", "case300",
    "case_illinois200", "create_cigre_network_lv", "simple_mv_open_ring_net", "create_kerber_dorfnetz", "case1888rte",
]  # fmt: skip


@pytest.mark.parametrize(
    "name", [*NETWORKS, *(pytest.param(name, marks=pytest.mark.slow) for name in OTHERS)]
)
def test_voltages_are_those_of_runpp(name: str) -> None:
    net = example(name)
    assert largest_difference(net, read(net)) < 1e-6


@pytest.mark.parametrize("with_der", ["all", "pv_wind"])
def test_voltages_with_distributed_generation_are_those_of_runpp(with_der: str) -> None:
    net = example("create_cigre_network_mv", with_der=with_der)
    assert largest_difference(net, read(net)) < 1e-6


def test_an_open_ring_stays_open() -> None:
    net = example("create_cigre_network_mv")
    closed = net.switch.closed.copy()
    assert not closed.all()
    opened = read(net)
    net.switch.closed = True
    assert largest_difference(net, read(net)) < 1e-6
    assert largest_difference(net, opened) > 1e-4


# Random networks ----------------------------------------------------------------------------------


def number(draw: st.DrawFn, low: float, high: float) -> float:
    return draw(st.integers(0, 100)) / 100 * (high - low) + low


@st.composite
def random_nets(draw: st.DrawFn) -> Any:
    """A meshed 110 kV grid, a 20 kV feeder below each of its transformers, and every kind of switch."""
    net = pp.create_empty_network(sn_mva=draw(st.sampled_from([1.0, 100.0])))
    high = [pp.create_bus(net, 110.0) for _ in range(draw(st.integers(2, 4)))]
    for a, b in zip(high, high[1:] + high[:1], strict=True):
        if a != b:
            line(draw, net, a, b, x=0.4)
    pp.create_ext_grid(net, high[0], vm_pu=number(draw, 0.98, 1.04), va_degree=draw(st.sampled_from([0, 30])))
    low = []
    for hv in high:
        for _ in range(draw(st.integers(0, 1))):
            lv = pp.create_bus(net, 20.0)
            transformer(draw, net, hv, lv)
            end = pp.create_bus(net, 20.0)
            line(draw, net, lv, end, x=0.3)
            low += [lv, end]
    if draw(st.booleans()):
        low += three_windings(draw, net, draw(st.sampled_from(high)))
    extra = [
        pp.create_bus(net, net.bus.vn_kv.at[bus])
        for bus in draw(st.lists(st.sampled_from(high + low), max_size=3))
    ]
    buses = high + low + extra
    for bus in extra:
        other = draw(
            st.sampled_from([b for b in buses if net.bus.vn_kv.at[b] == net.bus.vn_kv.at[bus] and b != bus])
        )
        pp.create_switch(
            net, bus, other, "b", closed=draw(st.booleans()), z_ohm=draw(st.sampled_from([0, 0, 0.5]))
        )
    for bus in buses:
        element(draw, net, bus)
    for index in net.bus.index[1:]:
        net.bus.loc[index, "in_service"] = draw(st.integers(0, 9)) > 0
    return net


def line(draw: st.DrawFn, net: Any, a: int, b: int, x: float) -> None:
    index = pp.create_line_from_parameters(
        net, a, b, number(draw, 1, 8), number(draw, 0.05, 0.2), x, number(draw, 0, 200), 0.5,
        g_us_per_km=number(draw, 0, 2), parallel=draw(st.integers(1, 2)), in_service=draw(st.integers(0, 7)) > 0,
    )  # fmt: skip
    if draw(st.integers(0, 2)) == 0:
        pp.create_switch(net, draw(st.sampled_from([a, b])), index, "l", closed=draw(st.booleans()))


def transformer(draw: st.DrawFn, net: Any, hv: int, lv: int) -> None:
    changer = draw(st.sampled_from(["Ratio", "Symmetrical", "Ideal", None]))
    step = {"tap_step_percent": 1.5} if changer != "Ideal" else {"tap_step_degree": 2.0}
    if changer == "Symmetrical":
        step["tap_step_degree"] = 60.0
    index = pp.create_transformer_from_parameters(
        net, hv, lv, 25.0, 110.0, number(draw, 19, 21), number(draw, 0.2, 0.6), number(draw, 8, 14),
        number(draw, 0, 40), number(draw, 0, 0.4), shift_degree=draw(st.sampled_from([0, 30, 150, 330])),
        tap_side=draw(st.sampled_from(["hv", "lv"])), tap_neutral=0, tap_pos=draw(st.integers(-5, 5)), tap_min=-9,
        tap_max=9, tap_changer_type=changer, parallel=draw(st.integers(1, 2)), **step,
    )  # fmt: skip
    if draw(st.integers(0, 2)) == 0:
        pp.create_switch(net, draw(st.sampled_from([hv, lv])), index, "t", closed=draw(st.booleans()))


def three_windings(draw: st.DrawFn, net: Any, hv: int) -> list[int]:
    mv, lv = pp.create_bus(net, 20.0), pp.create_bus(net, 10.0)
    index = pp.create_transformer3w_from_parameters(
        net, hv, mv, lv, 110.0, 20.0, 10.0, 40.0, 25.0, 15.0, 10.0, 11.0, 12.0, 0.3, 0.31, 0.32,
        number(draw, 0, 40), number(draw, 0, 0.4), shift_mv_degree=draw(st.sampled_from([0, 150])),
        shift_lv_degree=draw(st.sampled_from([0, 30])), tap_side=draw(st.sampled_from(["hv", "mv", "lv"])),
        tap_step_percent=1.2, tap_neutral=0, tap_pos=draw(st.integers(-4, 4)), tap_min=-9, tap_max=9,
        tap_changer_type="Ratio", tap_at_star_point=draw(st.booleans()),
    )  # fmt: skip
    if draw(st.booleans()):
        pp.create_switch(net, draw(st.sampled_from([hv, mv, lv])), index, "t3", closed=draw(st.booleans()))
    return [mv, lv]


def element(draw: st.DrawFn, net: Any, bus: int) -> None:
    """Connect something, or nothing, to a bus."""
    p, q = number(draw, -2, 2), number(draw, -1, 1)
    scaling, in_service = number(draw, 0.5, 1.5), draw(st.integers(0, 5)) > 0
    kind = draw(
        st.sampled_from(
            [
                "load",
                "sgen",
                "gen",
                "storage",
                "shunt",
                "ward",
                "xward",
                "motor",
                "asymmetric",
                "impedance",
                "none",
            ]
        )
    )
    if kind == "load":
        pp.create_load(
            net, bus, p, q, scaling=scaling, in_service=in_service, controllable=draw(st.booleans())
        )
    elif kind == "sgen":
        pp.create_sgen(
            net, bus, p, q, scaling=scaling, in_service=in_service, controllable=draw(st.booleans())
        )
    elif kind == "gen" and net.bus.vn_kv.at[bus] == 110.0:
        pp.create_gen(
            net, bus, p, vm_pu=float(net.ext_grid.vm_pu.iloc[0]), scaling=scaling, in_service=in_service
        )
    elif kind == "storage":
        pp.create_storage(
            net,
            bus,
            p,
            q_mvar=q,
            max_e_mwh=5.0,
            soc_percent=40.0,
            scaling=scaling,
            in_service=in_service,
            controllable=draw(st.booleans()),
        )
    elif kind == "shunt":
        vn_kv = net.bus.vn_kv.at[bus] * draw(st.sampled_from([1.0, 1.05]))
        pp.create_shunt(
            net, bus, q, abs(p) / 4, vn_kv=vn_kv, step=draw(st.integers(0, 3)), in_service=in_service
        )
    elif kind == "ward":
        pp.create_ward(net, bus, p, q, abs(p) / 4, q / 4, in_service=in_service)
    elif kind == "xward":
        pp.create_xward(net, bus, p, q, abs(p) / 4, q / 4, 0.5, 8.0, 1.01, in_service=in_service)
    elif kind == "motor":
        pp.create_motor(
            net,
            bus,
            0.8,
            0.85,
            efficiency_percent=90.0,
            loading_percent=70.0,
            scaling=scaling,
            in_service=in_service,
        )
    elif kind == "asymmetric":
        pp.create_asymmetric_load(
            net, bus, p / 3, p / 3, p / 3, q / 3, q / 3, q / 3, scaling=scaling, in_service=in_service
        )
    elif kind == "impedance":
        same = [b for b in net.bus.index if b != bus and net.bus.vn_kv.at[b] == net.bus.vn_kv.at[bus]]
        if same:
            pp.create_impedance(
                net,
                bus,
                draw(st.sampled_from(same)),
                0.01,
                0.05,
                20.0,
                gf_pu=0.002,
                bf_pu=0.01,
                gt_pu=0.001,
                bt_pu=0.03,
            )


# Shrinking takes minutes, since every example is a power flow.
@settings(examples(5), phases=[Phase.explicit, Phase.reuse, Phase.generate])
@given(random_nets())
def test_voltages_of_random_networks_are_those_of_runpp(net: Any) -> None:
    try:
        pp.runpp(net, calculate_voltage_angles=True, numba=False)
    except (pp.LoadflowNotConverged, UserWarning, IndexError):  # an IndexError of newtonpf: nothing to solve
        assume(False)
    assume(net.res_bus.vm_pu.min() > 0.7)
    assert largest_difference(net, read(net)) < 1e-6


# Optima -------------------------------------------------------------------------------------------


def optimum(network: om.Network) -> float:
    plan = om.MultiStage(network).solve()
    assert plan.optimal, plan.status
    return plan.objective


def runopp(net: Any) -> float:
    """Cost of pandapower's optimal power flow, which limits currents instead of apparent powers."""
    pp.runopp(net, delta=1e-12, PDIPM_GRADTOL=1e-8, PDIPM_FEASTOL=1e-9, PDIPM_COSTTOL=1e-9)
    return float(net.res_cost)


@pytest.mark.parametrize(
    "name",
    [
        *("case9", "case24_ieee_rts", "case118"),
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("case14", "case33bw", "case39")),
    ],
)
def test_optima_are_those_of_runopp(name: str) -> None:
    net = example(name)
    assert optimum(read(net)) == pytest.approx(runopp(net), rel=1e-5)


@pytest.mark.parametrize("name", ["case6ww", "case30"])
def test_optima_of_cases_with_congestion_are_those_of_runopp_without_it(name: str) -> None:
    net = example(name)
    limited = optimum(read(net))
    net.line = net.line.drop(columns="max_loading_percent")
    free = optimum(read(net))
    assert free == pytest.approx(runopp(net), rel=1e-5)
    assert limited > free + 1e-3


def test_magnetising_branches_have_their_sign(tmp_path: Path) -> None:
    net = feeder()
    pp.create_bus(net, 20.0)
    pp.create_transformer(net, 1, 2, "25 MVA 110/20 kV")
    branch = read(net)["trafo0"]
    assert branch.b < 0 < branch.g  # draws reactive and active power
    losses = branch.g * net.sn_mva
    assert losses == pytest.approx(net.trafo.pfe_kw.iloc[0] / 1000, rel=1e-3)


def test_charging_of_transformers_survives_a_file_of_powerio(tmp_path: Path) -> None:
    """MATPOWER's 118-bus case has transformers with charging, which is not the sign of a magnetising branch."""
    import powerio

    case = SCENARIOS / "data" / "case118.m"
    powerio.emit(powerio.parse(str(case)), "pandapower-json", str(tmp_path / "case118.json"))
    with warnings.catch_warnings(action="ignore"):
        found = optimum(om.read_network(tmp_path / "case118.json"))
    assert found == pytest.approx(129_660.69, abs=0.01)
    assert found == pytest.approx(optimum(om.read_network(case)), rel=1e-9)


def test_a_negative_open_loop_current_has_the_meaning_of_pandapower(tmp_path: Path) -> None:
    net = example("case118")
    assert (net.trafo.i0_percent < 0).any()
    with pytest.warns(
        CaseWarning, match=r"i0_percent is negative.*: 'trafo7', 'trafo9', 'trafo11', 'trafo12'"
    ):
        network = om.from_pandapower(net)
    assert optimum(network) == pytest.approx(runopp(net), rel=1e-6)


@copied
def feeder(**external: Any) -> Any:
    """Two buses, 110 kV, with a load of 30 MW."""
    net = pp.create_empty_network()
    for _ in range(2):
        pp.create_bus(net, 110.0, min_vm_pu=0.9, max_vm_pu=1.1)
    pp.create_ext_grid(net, 0, **{"controllable": True, **external})
    pp.create_line_from_parameters(net, 0, 1, 20, 0.1, 0.3, 10, 0.5, max_loading_percent=100)
    pp.create_load(net, 1, 30, 5)
    pp.create_poly_cost(net, 0, "ext_grid", cp1_eur_per_mw=10)
    return net


LIMITS = {"min_p_mw": 0, "max_p_mw": 20, "min_q_mvar": -10, "max_q_mvar": 10}


def held_external_grid() -> Any:
    return feeder(controllable=False, vm_pu=1.02)


def generator(**fields: Any) -> Any:
    net = feeder()
    pp.create_gen(net, 1, 10, **{"vm_pu": 1.03, **LIMITS, **fields})
    pp.create_poly_cost(net, 0, "gen", cp1_eur_per_mw=5, cp2_eur_per_mw2=0.02, cp0_eur=7)
    return net


def static_generator(**fields: Any) -> Any:
    net = feeder()
    pp.create_sgen(net, 1, 10, 1, scaling=0.7, **LIMITS, **fields)
    pp.create_poly_cost(net, 0, "sgen", cp1_eur_per_mw=5, cp0_eur=3)
    return net


def demand_response(price: float) -> Any:
    net = feeder()
    limits = {"min_p_mw": 2, "max_p_mw": 20, "min_q_mvar": 0, "max_q_mvar": 1}
    pp.create_load(net, 1, 10, 1, controllable=True, **limits)
    pp.create_poly_cost(net, 1, "load", cp1_eur_per_mw=price)
    return net


def storage(**fields: Any) -> Any:
    net = feeder()
    limits = {"min_p_mw": -5, "max_p_mw": 5, "min_q_mvar": -1, "max_q_mvar": 1}
    given = {"max_e_mwh": 1000, "soc_percent": 50, "controllable": True, **limits, **fields}
    pp.create_storage(net, 1, 2.0, q_mvar=0.5, **given)
    return net


def piecewise() -> Any:
    net = feeder()
    net.poly_cost = net.poly_cost.iloc[:0]
    pp.create_sgen(net, 1, 10, 1, controllable=True, **LIMITS)
    pp.create_pwl_cost(net, 0, "ext_grid", [[0, 10, 3], [10, 100, 10]])
    pp.create_pwl_cost(net, 0, "sgen", [[0, 5, 1], [5, 20, 9]])
    return net


def extended_ward() -> Any:
    net = feeder()
    pp.create_xward(net, 1, 1, 0.5, 0.5, 0.3, 1.0, 20.0, 1.01)
    pp.create_ward(net, 1, 1, 0.5, 0.5, 0.3)
    return net


def three_winding_transformer() -> Any:
    net = feeder()
    mv, lv = (pp.create_bus(net, kv, min_vm_pu=0.9, max_vm_pu=1.1) for kv in (20.0, 10.0))
    pp.create_transformer3w(net, 1, mv, lv, "63/25/38 MVA 110/20/10 kV")
    pp.create_load(net, mv, 12, 3)
    pp.create_load(net, lv, 8, 1)
    return net


NETS: list[Callable[[], Any]] = [
    feeder,
    held_external_grid,
    lambda: feeder(max_p_mw=100, min_p_mw=0, max_q_mvar=6),
    generator,
    lambda: generator(controllable=False),
    lambda: generator(vm_pu=1.0, min_vm_pu=0.98, max_vm_pu=1.01),
    static_generator,
    lambda: static_generator(controllable=True),
    lambda: demand_response(-20),
    lambda: demand_response(5),
    storage,
    lambda: storage(controllable=False),
    piecewise,
    extended_ward,
    three_winding_transformer,
]


@pytest.mark.parametrize("make", NETS)
def test_what_is_controllable_has_the_optimum_of_runopp(make: Callable[[], Any]) -> None:
    net = make()
    assert optimum(read(net)) == pytest.approx(runopp(net), rel=1e-5)


def test_an_impedance_is_limited_by_its_rating_as_in_runopp() -> None:
    net = feeder()
    net.line["in_service"] = False
    pp.create_impedance(net, 0, 1, 0.01, 0.05, sn_mva=25)
    with pytest.raises(pp.OPFNotConverged):
        runopp(net)
    assert not om.MultiStage(read(net)).solve().optimal
    net.impedance.loc[:, "sn_mva"] = 40
    assert optimum(read(net)) == pytest.approx(runopp(net), rel=1e-5)


# Components ---------------------------------------------------------------------------------------


def test_names_are_kept_where_they_are_unique() -> None:
    net = feeder()
    net.bus["name"] = ["Town", "Town"]
    net.load["name"] = "load7"
    net.line["name"] = "  "
    net.ext_grid["name"] = 5
    pp.create_load(net, 0, 1, name="Mill\x1b")
    pp.create_load(net, 0, 1, name="Werk Süd", index=7)
    network = read(net)
    assert list(network.of(om.Bus)) == ["bus0", "bus1"]
    assert list(network.of(om.Branch)) == ["line0"]
    assert list(network.of(om.Generator)) == ["5"]
    # the name of load 0 is that of load 7 by its index
    assert list(network.of(om.Load)) == ["load0", "load1", "Werk Süd"]


def test_fused_and_dead_buses_are_in_the_aliases() -> None:
    net = feeder()
    for name in ("busbar 2", "island", "off"):
        pp.create_bus(net, 110.0, name=name, max_vm_pu=1.05, in_service=name != "off")
    pp.create_switch(net, 1, 2, "b")
    pp.create_load(net, 2, 4, 1)
    pp.create_load(net, 3, 9, 9)
    with pytest.warns(CaseWarning, match="no connection to an external grid, .*: 'island'"):
        network = om.from_pandapower(net)
    assert dict(network.aliases) == {
        "bus0": "bus0", "bus1": "bus1", "busbar 2": "bus1", "island": None, "off": None,
    }  # fmt: skip
    assert network["bus1"].vm == (0.9, 1.05)  # the tightest of the fused buses
    assert network["load1"].bus == "bus1"
    assert not network["island"].in_service
    assert largest_difference(net, network) < 1e-6
    assert read(feeder()).aliases == {}


def test_a_line_between_fused_buses_is_a_shunt() -> None:
    net = feeder()
    pp.create_bus(net, 110.0)
    pp.create_switch(net, 1, 2, "b")
    pp.create_line_from_parameters(net, 1, 2, 5, 0.1, 0.3, 300, 0.5, g_us_per_km=3)
    network = read(net)
    assert list(network.of(om.Shunt)) == ["line1"]
    assert largest_difference(net, network) < 1e-6


def test_set_points() -> None:
    net = generator()
    pp.create_sgen(net, 1, 3, 1, scaling=0.5)
    network = read(net)
    assert (network["gen0"].pg_set, network["gen0"].vm_set, network["gen0"].regulates) == (10, 1.03, True)
    sgen = network["sgen0"]
    assert (sgen.pg_set, sgen.qg_set, sgen.regulates, sgen.p, sgen.q) == (
        1.5,
        0.5,
        False,
        (1.5, 1.5),
        (0.5, 0.5),
    )
    assert (network["ext_grid0"].vm_set, network["bus0"].reference) == (1.0, True)
    battery = read(storage(min_e_mwh=100))["storage0"]
    assert (battery.ps_set, battery.qs_set, battery.power, battery.q) == (2.0, 0.5, (-5, 5), (-1, 1))
    assert (battery.energy, battery.energy_min, battery.initial) == (1000, 100, 500)


def test_storages_of_simbench_have_efficiencies() -> None:
    net = storage()
    net.storage["efficiency_percent"], net.storage["self-discharge_percent_per_day"] = 0.95, 0.24
    battery = read(net)["storage0"]
    assert (battery.charge_efficiency, battery.discharge_efficiency) == (0.95, 0.95)
    assert battery.standing_loss == pytest.approx(0.0001)
    net.storage["efficiency_percent"] = 95.0
    assert read(net)["storage0"].charge_efficiency == 0.95


@pytest.mark.slow
@pytest.mark.parametrize("code", ["1-MV-rural--2-sw", "1-LV-rural1--0-sw"])
def test_voltages_of_simbench_are_those_of_runpp(code: str) -> None:
    simbench = pytest.importorskip("simbench")
    net = simbench.get_simbench_net(code)
    assert largest_difference(net, read(net)) < 1e-6


def test_indices_need_not_be_consecutive() -> None:
    net = example("example_multivoltage")
    toolbox.reindex_buses(net, {bus: 7 * bus + 3 for bus in net.bus.index})
    for table in ("load", "line", "trafo", "trafo3w", "xward"):
        toolbox.reindex_elements(net, table, [5 * index + 2 for index in net[table].index])
    net.line = net.line.sort_index(ascending=False)
    assert largest_difference(net, read(net)) < 1e-6


@pytest.mark.parametrize(
    "options",
    [
        {"trafo3w_losses": "star"},
        {"trafo_model": "pi"},
        {"switch_rx_ratio": 1},
        {"calculate_voltage_angles": "auto"},
    ],
)
def test_saved_options_of_power_flows_count(options: dict[str, Any]) -> None:
    net = example("example_multivoltage")
    net.switch.loc[net.switch.et == "b", "z_ohm"] = 0.1
    net.trafo3w[["pfe_kw", "i0_percent"]] = [30.0, 0.1]
    plain = read(net)
    pp.set_user_pf_options(net, **options)
    network = read(net)
    assert largest_difference(net, network) < 1e-6
    changes = [name for name in network if name not in plain or network[name] != plain[name]]
    assert bool(changes) is ("calculate_voltage_angles" not in options)


def test_the_network_is_not_changed() -> None:
    net = example("example_multivoltage")
    before = pp.to_json(net)
    read(net)
    assert pp.to_json(net) == before


def test_costs_of_demand_are_costs_of_the_power_drawn() -> None:
    net = demand_response(-20)
    net.poly_cost.loc[1, ["cp2_eur_per_mw2", "cp0_eur"]] = [0.1, 4]
    assert read(net)["load1"].cost == om.Polynomial(0.1, 20, 4)
    net.poly_cost = net.poly_cost.iloc[:1]
    pp.create_pwl_cost(net, 1, "load", [[2, 5, -30], [5, 20, -10]])
    assert read(net)["load1"].cost == om.PiecewiseLinear(((-20, -300), (-5, -150), (-2, -60)))


def test_units_without_cost() -> None:
    net = generator()
    net.poly_cost = net.poly_cost.iloc[:1]
    with pytest.warns(CaseWarning, match="no cost data for 'gen0'; these units cost nothing"):
        network = om.from_pandapower(net)
    assert network["gen0"].cost == om.Polynomial()
    network = om.from_pandapower(net, default_cost=om.Polynomial(0, 30, 0))
    assert (network["gen0"].cost, network["ext_grid0"].cost) == (
        om.Polynomial(0, 30, 0),
        om.Polynomial(0, 10, 0),
    )
    net.poly_cost = net.poly_cost.iloc[:0]
    with pytest.warns(CaseWarning, match="no cost data; these units cost nothing"):
        om.from_pandapower(net)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda net: net.gen.drop(columns=["max_p_mw"], inplace=True), "no min_p_mw or max_p_mw .*: 'gen0'"),
        (
            lambda net: pp.create_storage(net, 1, 1, max_e_mwh=1),
            "not controllable hold their power: 'storage0'",
        ),
        (
            lambda net: pp.control.DiscreteTapControl(net, 0, 0.98, 1.02),
            r"controllers do not act.*: 0 \(Disc",
        ),
    ],
)
def test_warnings(change: Callable[[Any], Any], message: str) -> None:
    net = generator()
    pp.create_bus(net, 20.0)
    pp.create_transformer(net, 1, 2, "25 MVA 110/20 kV")
    change(net)
    with pytest.warns(CaseWarning, match=message):
        om.from_pandapower(net)


# What is lost or refused --------------------------------------------------------------------------


def add_asymmetric_impedance(net: Any) -> None:
    pp.create_impedance(net, 0, 1, 0.01, 0.05, 100, rtf_pu=0.02, xtf_pu=0.05)


def add_second_external_grid(net: Any) -> None:
    pp.create_ext_grid(net, 1)
    pp.create_poly_cost(net, 1, "ext_grid", 1)


def add_dc_grid(net: Any) -> None:
    bus = pp.create_bus_dc(net, 100.0)
    other = pp.create_bus_dc(net, 100.0)
    pp.create_line_dc(net, bus, other, 10, "2400-CU")
    pp.create_source_dc(net, bus)
    pp.create_load_dc(net, other, 1)


@pytest.mark.parametrize(
    ("add", "loss"),
    [
        (lambda net: pp.create_load(net, 1, 1, const_z_p_percent=40, const_i_q_percent=10),
         r"load 'load1': const_z_p_percent = 40, const_i_q_percent = 10: .* depends on the voltage"),
        (lambda net: pp.create_svc(net, 1, 1, -10, 1, 90), "svc 'svc0': a static var compensator"),
        (lambda net: pp.create_ssc(net, 1, 0, 5), "ssc 'ssc0': a static synchronous compensator"),
        (lambda net: pp.create_tcsc(net, 0, 1, 1, -10, -5, 140), "tcsc 'tcsc0': a thyristor"),
        (add_dc_grid, "bus_dc 'bus_dc0': a dc bus; .*line_dc 'line_dc0'.*source_dc 'source_dc0'.*load_dc 'load_dc0'"),
        (add_asymmetric_impedance, "impedance 'impedance0': rtf_pu and xtf_pu differ"),
        (add_second_external_grid, "ext_grid 'ext_grid1': holds the angle of its bus, as 'ext_grid0'"),
        (lambda net: pp.create_asymmetric_load(net, 1, 1, 2, 3), "asymmetric_load 'asymmetric_load0': its phases"),
        (lambda net: pp.create_sgen(net, 1, 1, controllable=True, reactive_capability_curve=True), "sgen 'sgen0': reactive_capab"),
        (lambda net: net.poly_cost.__setitem__("cq1_eur_per_mvar", 1.0), "poly_cost 0: a cost of reactive power"),
        (lambda net: pp.create_pwl_cost(net, 0, "ext_grid", [[0, 1, 1]], power_type="q", check=False), "pwl_cost 0: a cost of rea"),
        (lambda net: net.poly_cost.__setitem__("redispatch_up_eur_per_mw", 9.0), "poly_cost 0: a cost of redispatch"),
        (lambda net: pp.set_user_pf_options(net, distributed_slack=True), "distributed_slack = True"),
        (lambda net: pp.create_poly_cost(net, 0, "storage", 3), "storage 'storage0': a cost of its power"),
    ],
)  # fmt: skip
def test_losses_are_refused_unless_they_are_accepted(add: Callable[[Any], Any], loss: str) -> None:
    net = storage()
    add(net)
    with pytest.raises(CaseError, match=rf"^pandapower: contains what opfmodel does not represent: .*{loss}"):
        read(net)
    with pytest.warns(CaseWarning, match=f"lost: .*{loss.split(';', maxsplit=1)[0]}"):
        network = om.from_pandapower(net, lossy=True)
    assert om.MultiStage(network).solve().optimal


def test_what_is_out_of_service_is_no_loss() -> None:
    net = feeder()
    pp.create_dcline(net, 0, 1, 5, 1, 0.1, 1, 1, in_service=False)
    pp.create_load(net, 1, 1, const_z_p_percent=40, in_service=False)
    pp.create_storage(net, 1, 1, max_e_mwh=np.nan, controllable=True, in_service=False)
    assert optimum(read(net)) == pytest.approx(optimum(read(feeder())))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: storage(max_e_mwh=np.nan), "storage 'storage0': max_e_mwh has no value; .* needs its energy"),
        (lambda: storage(soc_percent=np.nan), "storage 'storage0': soc_percent has no value"),
        (lambda: storage(soc_percent=120), "storage0: initial = 1200"),
        (lambda: changed(net=feeder(), ext_grid={"in_service": False}), "No reference bus is available"),
        (lambda: changed(net=feeder(), load={"bus": 17}), "17"),
        (lambda: changed(net=feeder(), load={"p_mw": np.nan}), "load 'load0': p_mw has no value"),
        (lambda: changed(net=feeder(), load={"p_mw": "much"}), "'much'|convert"),
        (lambda: changed(net=feeder(), line={"length_km": 0.0}), "line0: r, x = "),
        (lambda: changed(net=feeder(), bus={"min_vm_pu": 1.2}), "bus0: vm = .* above the maximum"),
        (lambda: changed(net=piecewise(), pwl_cost={"points": "[[0, 5, 1], [7, 20, 9]]"}), "begins at 7 MW"),
        (lambda: changed(net=piecewise(), pwl_cost={"points": "[[0, 5], 3]"}), "points = .* must be a list"),
        (lambda: changed(net=piecewise(), pwl_cost={"points": "[]"}), "at least one range"),
        (lambda: changed(net=piecewise(), pwl_cost={"points": "[[0, 5, 9], [5, 9, 1]]"}), "must be convex"),
        (lambda: changed(net=feeder(), bus={"vn_kv": "high"}), "pandapower cannot convert the network"),
        (lambda: with_index(feeder(), 10**12), "bus: index 1000000000000: must be an integer from 0 to"),
        (lambda: with_index(feeder(), -2), "bus: index -2: must be"),
        (lambda: with_index(feeder(), 0), "bus: repeated labels of index: 0; must differ"),
        (lambda: with_table(feeder(), "load", {"bus": [1]}), "load is a dict; must be a table"),
        (lambda: 5, "a int; must be a network of pandapower"),
    ],
)  # fmt: skip
def test_invalid_networks_are_refused(make: Callable[[], Any], message: str) -> None:
    with pytest.raises(CaseError, match=f"^pandapower: .*{message}"):
        read(make())


def with_table(net: Any, name: str, table: object) -> Any:
    """Replace a table."""
    net[name] = table
    return net


def with_index(net: Any, index: int) -> Any:
    """Rename the second bus."""
    net.bus.index = [0, index]
    return net


def changed(net: Any, **tables: dict[str, Any]) -> Any:
    """Set columns of tables."""
    for table, columns in tables.items():
        for column, value in columns.items():
            net[table][column] = value
    return net


def test_a_cost_given_twice_is_refused() -> None:
    net = feeder()
    pp.create_poly_cost(net, 0, "ext_grid", cp1_eur_per_mw=3, check=False)
    with pytest.raises(CaseError, match="cost of ext_grid 'ext_grid0': given twice"):
        read(net)


def test_an_injection_that_this_version_does_not_know_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    net = feeder()
    pp.create_motor(net, 1, 2, 0.9)
    rows = Source.rows
    monkeypatch.setattr(
        Source, "rows", lambda self, table: iter(()) if table == "motor" else rows(self, table)
    )
    with pytest.raises(CaseError, match=r"bus 'bus1': draws 30 MW.* by the tables .* but 32"):
        read(net)


# Tables and columns of pandapower -----------------------------------------------------------------


def columns_of_pandapower() -> dict[str, set[str]]:
    """Tables that pandapower knows, with the columns of an empty network and of its schemas."""
    net = pp.create_empty_network()
    found = {
        table: set(frame.columns)
        for table, frame in net.items()
        if hasattr(frame, "columns") and not table.startswith(("_", "res_"))
    }
    package = importlib.import_module("pandapower.network_schema")
    for module in pkgutil.iter_modules(package.__path__):
        if module.name in found:
            schema = importlib.import_module(f"{package.__name__}.{module.name}")
            found[module.name] |= set(getattr(schema, f"{module.name}_schema").columns)
    return found


def test_every_table_and_column_of_pandapower_is_known() -> None:
    found = columns_of_pandapower()
    assert len(found) > 30
    known = (tables.READ, tables.CONVERTED, tables.REPORTED, tables.IGNORED)
    for table, columns in found.items():
        if table in tables.UNMODELLED or table in tables.TABLES_IGNORED:
            continue
        sets = [group.get(table, frozenset()) for group in known]
        assert columns <= frozenset().union(*sets), f"{table}: {columns - frozenset().union(*sets)}"
        assert sum(map(len, sets)) == len(frozenset().union(*sets)), f"{table}: a column is in two lists"


def test_the_lists_name_no_unknown_table() -> None:
    found = columns_of_pandapower()
    for group in (tables.READ, tables.CONVERTED, tables.REPORTED, tables.IGNORED, tables.UNMODELLED):
        assert set(group) <= set(found)


def test_an_unknown_table_with_equipment_is_a_loss() -> None:
    net = feeder()
    net["flywheel"] = net.load.copy()
    with pytest.raises(CaseError, match="flywheel: 1 element in service, of a kind that this version"):
        read(net)
    net["flywheel"]["in_service"] = False
    read(net)


# Files --------------------------------------------------------------------------------------------


def save(net: Any, path: Path) -> Path:
    pp.to_json(net, str(path))
    return path


def test_a_file_is_read_as_the_network(tmp_path: Path) -> None:
    net = example("create_cigre_network_mv", with_der="pv_wind")
    path = save(net, tmp_path / "grid.json")
    with warnings.catch_warnings(action="ignore"):
        network = om.read_network(path)
        named = om.read_network(save(net, tmp_path / "grid.txt"), format="pandapower")
    expected = read(pp.from_json(str(path)))
    assert {n: network[n] for n in network} == {n: expected[n] for n in expected}
    assert {n: named[n] for n in named} == {n: network[n] for n in network}
    assert network.name == (net.name or "grid")


def test_a_scenario_reads_a_file(tmp_path: Path) -> None:
    save(generator(), tmp_path / "grid.json")
    (tmp_path / "day.yaml").write_text(
        "network: {file: grid.json}\ntime: {step: 1.0, steps: 2}\ncontroller: {horizon: 2}\n"
    )
    assert set(om.load_scenario(tmp_path / "day.yaml").network.of(om.Generator)) == {"ext_grid0", "gen0"}


def plain() -> Any:
    """A network that powerio represents faithfully."""
    net = feeder()
    net["ext_grid"]["controllable"] = True
    pp.create_gen(net, 1, 10, vm_pu=1.03, **LIMITS)
    pp.create_poly_cost(net, 0, "gen", cp1_eur_per_mw=5)
    pp.create_shunt(net, 1, 2, vn_kv=100.0, step=2)
    return net


def with_transformer(**fields: Any) -> Any:
    net = plain()
    pp.create_bus(net, 20.0)
    pp.create_transformer(net, 1, 2, "25 MVA 110/20 kV")
    for column, value in fields.items():
        net.trafo[column] = value
    return net


def with_open_switch() -> Any:
    net = plain()
    pp.create_switch(net, 1, 0, "l", closed=False)
    return net


@pytest.mark.parametrize(
    ("make", "dropped"),
    [
        (with_open_switch, "switch"),
        (with_transformer, "trafo.i0_percent, trafo.pfe_kw"),
        (static_generator, "sgen"),
        (storage, "storage"),
        (piecewise, "pwl_cost"),
        (three_winding_transformer, "trafo3w"),
        (held_external_grid, "ext_grid.controllable"),
        (lambda: generator(controllable=False), "gen.controllable"),
        (lambda: demand_response(3), "load.controllable"),
        (lambda: with_transformer(i0_percent=0.0, pfe_kw=0.0, tap_pos=3), "trafo.tap_pos"),
        (lambda: changed(net=plain(), load={"const_z_p_percent": 30.0}), "load.const_z_p_percent"),
        (lambda: changed(net=plain(), poly_cost={"cq1_eur_per_mvar": 1.0}), "poly_cost.cq1_eur_per_mvar"),
    ],
)
def test_without_pandapower_a_file_that_would_lose_something_is_refused(
    make: Callable[[], Any], dropped: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = save(make(), tmp_path / "grid.json")
    monkeypatch.setitem(sys.modules, "pandapower", None)
    message = rf"grid\.json: reading .*{dropped}.* needs pandapower, .*: pip install 'opfmodel\[pandapower\]'"
    with pytest.raises(CaseError, match=message):
        om.read_network(path)


@pytest.mark.parametrize("make", [plain, lambda: with_transformer(i0_percent=0.0, pfe_kw=0.0)])
def test_without_pandapower_a_plain_file_has_the_same_optimum(
    make: Callable[[], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    net = make()
    path = save(net, tmp_path / "grid.json")
    expected = optimum(read(net))
    monkeypatch.setitem(sys.modules, "pandapower", None)
    assert optimum(om.read_network(path)) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace("pandas.core.frame", "subprocess"), "Python module 'subprocess'"),
        (lambda text: text.replace('"_class": "DataFrame"', '"_class": "read_pickle"', 1), "cannot read it"),
        (lambda text: text[: len(text) // 2], "cannot read it"),
        (lambda text: text.replace('\\"index\\"', '\\"inde\\"'), "cannot"),
        (lambda text: text.replace('"format_version": "', '"format_version": "9'), "cannot read it"),
    ],
)
def test_corrupt_files_are_refused(change: Callable[[str], str], message: str, tmp_path: Path) -> None:
    path = save(plain(), tmp_path / "grid.json")
    text = path.read_text()
    path.write_text(change(text))
    assert path.read_text() != text
    with pytest.raises(CaseError, match=rf"grid\.json: .*{message}"):
        om.read_network(path)


def test_without_pandapower_a_corrupt_file_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = save(plain(), tmp_path / "grid.json")
    path.write_text(path.read_text()[:-20])
    monkeypatch.setitem(sys.modules, "pandapower", None)
    with pytest.raises(CaseError, match=r"grid\.json: not a JSON file of pandapower"):
        om.read_network(path)


def test_curves_of_pandapower(tmp_path: Path) -> None:
    import pandas as pd
    from pandapower.control.util.auxiliary import create_q_capability_characteristics_object

    net = pp.create_empty_network()
    buses = [pp.create_bus(net, 110) for _ in range(2)]
    pp.create_ext_grid(net, buses[0])
    pp.create_line(net, *buses, 10, "149-AL1/24-ST1A 110.0")
    pp.create_load(net, buses[1], 30, 10)
    unit = pp.create_gen(
        net, buses[1], 20, vm_pu=1, min_p_mw=-5, max_p_mw=50, min_q_mvar=-99, max_q_mvar=99,
        reactive_capability_curve=True, id_q_capability_characteristic=0, curve_style="straightLineYValues",
    )  # fmt: skip
    points = {"p_mw": [-5.0, 30, 50], "q_min_mvar": [-20.0, -20, -5], "q_max_mvar": [20.0, 25, 8]}
    net["q_capability_curve_table"] = pd.DataFrame({"id_q_capability_curve": [0] * 3, **points})
    create_q_capability_characteristics_object(net)
    pp.create_poly_cost(net, 0, "ext_grid", 20)
    pp.create_poly_cost(net, unit, "gen", 10)
    network = om.from_pandapower(net)
    curve = network["gen0"].capability
    low, high = net.q_capability_characteristic.iloc[0][["q_min_characteristic", "q_max_characteristic"]]
    for p in (-5, 5, 10, 22, 37, 49):
        q = [y for _, y in inside_box(curve, (p - 1e-9, p + 1e-9), (-99, 99))]
        assert (min(q), max(q)) == pytest.approx((float(low(p)), float(high(p))), abs=1e-6)
    assert om.MultiStage(network).solve().optimal
    net.q_capability_curve_table.loc[1, "q_max_mvar"] = 10.0  # a notch
    with pytest.raises(CaseError, match="gen 'gen0': reactive_capability_curve: only convex curves"):
        om.from_pandapower(net)
    with pytest.warns(CaseWarning, match="only convex curves"):
        assert om.from_pandapower(net, lossy=True)["gen0"].q == (-99, 99)
    net.gen["curve_style"] = "constantYValue"
    with pytest.raises(CaseError, match="only those of straight lines"):
        om.from_pandapower(net)
    with pytest.raises(CaseError, match="capability curves of gen0"):
        write_pandapower(network, tmp_path / "x.json", lossy=False)
