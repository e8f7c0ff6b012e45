"""Networks of pandapower: compared with its own power flow and optimal power flow."""

from __future__ import annotations

import importlib
import json
import logging
import pkgutil
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandapower as pp
import pandapower.networks as grids
import pytest
from hypothesis import Phase, assume, given, settings
from hypothesis import strategies as st
from newton import power_flow

import opfmodel as om
from opfmodel.errors import CaseError, CaseWarning
from opfmodel.network.cases.pandapower import tables
from opfmodel.network.cases.pandapower.source import Source

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
    pp.runpp(net, calculate_voltage_angles=True, tolerance_mva=1e-9, max_iteration=50)
    names = [Source(net, "").name("bus", index) for index in net.bus.index]
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
    "case4gs", "case5", "case6ww", "case9", "case14", "case24_ieee_rts", "case30", "case33bw", "case39",
    "case57", "case89pegase", "case118", "case145", "case300", "case_illinois200", "iceland",
    "GBreducednetwork", "create_cigre_network_hv", "create_cigre_network_mv", "create_cigre_network_lv",
    "mv_oberrhein", "example_multivoltage", "example_simple", "simple_four_bus_system",
    "simple_mv_open_ring_net", "create_kerber_landnetz_freileitung_1", "create_kerber_dorfnetz",
    "create_synthetic_voltage_control_lv_network", "panda_four_load_branch",
]  # fmt: skip


@pytest.mark.parametrize("name", [*NETWORKS, pytest.param("case1888rte", marks=pytest.mark.slow)])
def test_voltages_are_those_of_runpp(name: str) -> None:
    net = getattr(grids, name)()
    net = net[0] if isinstance(net, tuple) else net
    assert largest_difference(net, read(net)) < 1e-6


@pytest.mark.parametrize("with_der", ["all", "pv_wind"])
def test_voltages_with_distributed_generation_are_those_of_runpp(with_der: str) -> None:
    net = grids.create_cigre_network_mv(with_der=with_der)
    assert largest_difference(net, read(net)) < 1e-6


def test_an_open_ring_stays_open() -> None:
    net = grids.create_cigre_network_mv()
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
@settings(max_examples=60, phases=[Phase.explicit, Phase.reuse, Phase.generate])
@given(random_nets())
def test_voltages_of_random_networks_are_those_of_runpp(net: Any) -> None:
    try:
        pp.runpp(net, calculate_voltage_angles=True)
    except (pp.LoadflowNotConverged, UserWarning, IndexError):  # an IndexError of newtonpf: nothing to solve
        assume(False)
    assume(net.res_bus.vm_pu.min() > 0.7)
    assert largest_difference(net, read(net)) < 1e-6
