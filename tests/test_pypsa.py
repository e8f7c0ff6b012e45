"""Networks of PyPSA, against PyPSA's own optimum and power flow."""

import importlib
import logging
import shutil
import sys
import warnings
from functools import cache
from pathlib import Path

import hypothesis.strategies as st
import numpy as np
import pandas as pd
import pypsa
import pytest
from conftest import examples
from hypothesis import HealthCheck, given, settings
from pypsa_networks import difference, empty, meshed, optima, snapshots

import opfmodel as om
from opfmodel.errors import CaseError, CaseWarning
from opfmodel.network.cases.pypsa.attributes import CLASSES, TYPES

pytestmark = [
    pytest.mark.filterwarnings("ignore::FutureWarning"),  # linopy, of PyPSA's own problem
    pytest.mark.filterwarnings("ignore::opfmodel.errors.CaseWarning"),
]


@pytest.fixture(autouse=True)
def quiet() -> None:
    for name in ("pypsa", "linopy"):
        logging.getLogger(name).setLevel(logging.ERROR)


# Optima --------------------------------------------------------------------------------------------


@cache
def plain() -> tuple[float | None, float | None]:
    return optima(meshed())


@pytest.mark.parametrize(("hours", "cyclic"), [(0.25, False), (1.0, False), (3.0, True)])
def test_the_optimum_is_that_of_pypsa(hours: float, cyclic: bool) -> None:
    expected, found = (
        plain() if (hours, cyclic) == (1.0, False) else optima(meshed(hours=hours, cyclic=cyclic))
    )
    assert found == pytest.approx(expected, rel=1e-6)


def test_fixed_powers_and_energies_are_those_of_pypsa() -> None:
    n = meshed()
    n.generators_t.p_set["wind"] = np.where(np.arange(12) % 3, np.nan, 2.0)
    n.storage_units_t.p_set["hydro"] = np.where(np.arange(12) == 4, 3.0, np.nan)
    n.stores_t.e_set["tank"] = np.where(np.arange(12) == 7, 30.0, np.nan)
    n.stores_t.e_max_pu["tank"] = np.linspace(1.0, 0.7, 12)
    n.storage_units_t.state_of_charge_set["hydro"] = np.where(np.arange(12) == 9, 25.0, np.nan)
    expected, found = optima(n)
    assert found == pytest.approx(expected, rel=1e-6)
    assert expected > plain()[0] * (1 + 1e-4)  # the set-points matter


def test_quadratic_costs_are_those_of_pypsa() -> None:
    n = meshed(steps=4)
    n.generators.loc["gas", "marginal_cost_quadratic"] = 0.3
    n.generators_t.marginal_cost_quadratic["coal"] = [0.1, 0.2, 0.05, 0.4]
    expected, found = optima(n)
    assert found == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("neglected", ["phase shift", "shunt", "magnetising branch"])
def test_what_pypsas_optimum_neglects_is_the_only_difference(neglected: str) -> None:
    n = meshed()
    if neglected == "phase shift":
        n.transformers.loc["trafo", "phase_shift"] = 10.0
    elif neglected == "magnetising branch":
        n.transformers.loc["trafo", ["b", "model"]] = -4.0, "t"
    else:
        n.add("ShuntImpedance", "coil", bus="c", g=1e-4)
    expected, found = optima(n)
    assert abs(found / expected - 1) > 1e-4
    if neglected == "magnetising branch":
        n.transformers.loc["trafo", "model"] = "pi"
    elif neglected == "shunt":
        n.remove("ShuntImpedance", "coil")
        n.add("Load", "coil", bus="c", p_set=1e-4 * 110**2)
    expected, found = plain() if neglected == "phase shift" else optima(n)
    assert found == pytest.approx(expected, rel=1e-6)


def test_overlapping_charge_and_discharge_keep_to_the_limits_of_their_snapshot() -> None:
    n = snapshots(3, 1.0)
    n.add("Bus", "a", v_nom=20.0)
    n.add("Generator", "waste", bus="a", p_nom=50, marginal_cost=-10)
    n.add("StorageUnit", "battery", bus="a", p_nom=10, max_hours=0.2, efficiency_store=0.5, efficiency_dispatch=0.5,
          p_min_pu=[-1.0, -0.2, -0.6], p_max_pu=[0.3, 1.0, 0.1])  # fmt: skip
    expected, found = optima(n)
    assert found == pytest.approx(expected, rel=1e-6)


@st.composite
def networks(draw: st.DrawFn) -> pypsa.Network:
    steps = draw(st.integers(1, 4))
    hours = draw(st.sampled_from([0.25, 0.5, 1.0, 2.0]))
    n = snapshots(steps, hours) if steps > 1 else empty()
    number = draw(st.integers(1, 4))
    buses = [f"bus{i}" for i in range(number)]
    for bus in buses:
        n.add("Bus", bus, v_nom=110.0)
    bus = st.sampled_from(buses)
    share = st.floats(0, 1).map(lambda v: round(v, 3))

    def series(values: st.SearchStrategy[float]) -> object:
        if steps > 1 and draw(st.booleans()):
            return draw(st.lists(values, min_size=steps, max_size=steps))
        return draw(values)

    for i in range(1, number + draw(st.integers(0, 2)) if number > 1 else 0):
        u = buses[draw(st.integers(0, min(i, number) - 1))]
        v = buses[i] if i < number else draw(bus.filter(lambda b, u=u: b != u))
        rating = draw(st.floats(5, 200))
        if draw(st.booleans()):
            n.add("Line", f"line{i}", bus0=u, bus1=v, x=draw(st.floats(1, 50)), s_nom=rating,
                  s_max_pu=series(st.floats(0.5, 1)))  # fmt: skip
        else:
            n.add("Transformer", f"line{i}", bus0=u, bus1=v, x=draw(st.floats(0.05, 0.3)), s_nom=rating,
                  tap_ratio=draw(st.floats(0.9, 1.1)), tap_side=draw(st.integers(0, 1)))  # fmt: skip
    for i, at in enumerate(buses):
        n.add("Load", at, bus=at, p_set=series(st.floats(0, 40)))  # named as its bus
        n.add("Generator", f"backup{i}", bus=at, p_nom=100, marginal_cost=200.0)
    retired = draw(st.booleans())  # PyPSA itself fails where some units are inactive and others have ramps
    for i in range(draw(st.integers(0, 2))):
        ramp = np.nan if retired else draw(st.sampled_from([np.nan, 0.2, 0.6]))
        n.add("Generator", f"unit{i}", bus=draw(bus), p_nom=draw(st.floats(0, 60)), p_max_pu=series(share),
              marginal_cost=series(st.floats(-20, 60)), ramp_limit_up=ramp, ramp_limit_down=ramp,
              active=not retired or draw(st.booleans()))  # fmt: skip
    cyclic = draw(st.booleans())
    for i in range(draw(st.integers(0, 2))):
        power, full = draw(st.floats(1, 30)), draw(st.floats(0.5, 5))
        n.add("StorageUnit", f"storage{i}", bus=draw(bus), p_nom=power, max_hours=full,
              efficiency_store=draw(st.floats(0.7, 1)), efficiency_dispatch=draw(st.floats(0.7, 1)),
              standing_loss=draw(st.floats(0, 0.2)), cyclic_state_of_charge=cyclic,
              p_max_pu=series(st.floats(0.1, 1)), p_min_pu=series(st.floats(-1, -0.1)),
              state_of_charge_initial=power * full * draw(st.floats(0, 0.5)))  # fmt: skip
    for i in range(draw(st.integers(0, 1))):
        n.add("Store", f"storage{i}", bus=draw(bus), e_nom=draw(st.floats(1, 60)), e_cyclic=cyclic,
              standing_loss=draw(st.floats(0, 0.1)))  # fmt: skip
    if draw(st.integers(0, 9)) == 0:
        n.add("Generator", "pump", bus=draw(bus), p_nom=5, committable=True)
    return n


@settings(examples(3), suppress_health_check=[HealthCheck.too_slow])
@given(n=networks())
def test_random_networks_have_the_optimum_of_pypsa_or_are_refused(n: pypsa.Network) -> None:
    if n.generators.committable.any():
        with pytest.raises(CaseError, match=r"committable: True of 'pump'"):
            om.from_pypsa(n)
        return
    expected, found = optima(n)
    assert (found is None) == (expected is None)
    if found is not None:
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-4)


# Power flow ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", ["case9", "case14", "case30", "case39", "case57", "case118"])
def test_the_voltages_of_pypower_cases_are_those_of_pypsa(case: str) -> None:
    n = empty()
    n.import_from_pypower_ppc(getattr(importlib.import_module(f"pypower.{case}"), case)())
    assert difference(n) < 1e-6


@pytest.mark.parametrize("model", ["t", "pi"])
@pytest.mark.parametrize("tap_side", [0, 1])
def test_the_voltages_of_transformers_are_those_of_pypsa(model: str, tap_side: int) -> None:
    n = empty()
    for bus, kv in (("high", 110.0), ("middle", 20.0), ("end", 20.0)):
        n.add("Bus", bus, v_nom=kv, v_mag_pu_set=1.03 if bus == "high" else 1.0)
    n.add("Transformer", "own", bus0="high", bus1="middle", model=model, x=0.11, r=0.01, g=0.002, b=-0.03,
          s_nom=40, tap_ratio=0.94, tap_side=tap_side, phase_shift=147.0)  # fmt: skip
    n.add("Transformer", "typed", bus0="high", bus1="end", type="25 MVA 110/20 kV", tap_position=-3,
          num_parallel=2, model=model)  # fmt: skip
    n.add("Line", "typed", bus0="middle", bus1="end", type="NA2XS2Y 1x240 RM/25 12/20 kV", length=30.0,
          num_parallel=1.5)  # fmt: skip
    n.add("Line", "off", bus0="middle", bus1="end", x=1.0, active=False)
    n.add("Generator", "grid", bus="high", control="Slack")
    n.add("Generator", "plant", bus="end", p_set=6.0, q_set=1.5)
    n.add("Generator", "drain", bus="middle", p_set=2.0, q_set=0.5, sign=-1)
    n.add("Load", "town", bus="middle", p_set=11.0, q_set=4.0)
    n.add("StorageUnit", "battery", bus="end", p_set=-2.0, q_set=0.7)
    n.add("Store", "tank", bus="middle", p_set=1.0, q_set=-0.3)
    n.add("ShuntImpedance", "coil", bus="end", g=1e-4, b=-2e-3)
    assert difference(n) < 1e-6
    before = n.transformers.copy()
    om.from_pypsa(n)
    pd.testing.assert_frame_equal(n.transformers, before)  # the user's network is left alone


def test_the_slack_bus_is_that_of_pypsa_in_every_island() -> None:
    n = empty()
    n.add("Bus", ["a", "b", "c", "d"], v_nom=20.0)
    n.add("Line", ["ab", "cd"], bus0=["a", "c"], bus1=["b", "d"], x=1.0, s_nom=10)
    n.add("Generator", ["first", "slack", "pv", "last"], bus=["a", "b", "c", "d"], p_nom=10,
          control=["PQ", "Slack", "PV", "Slack"])  # fmt: skip
    n.add("Generator", "retired", bus="a", control="PV", active=False)
    network = om.from_pypsa(n)
    assert [name for name, bus in network.of(om.Bus).items() if bus.reference] == ["b", "d"]
    assert {name: g.regulates for name, g in network.of(om.Generator).items()} == {
        "first": False, "slack": True, "pv": True, "last": True, "retired": True,
    }  # fmt: skip


# Losses --------------------------------------------------------------------------------------------


def one_of_each() -> pypsa.Network:
    return _one_of_each().copy()


@cache
def _one_of_each() -> pypsa.Network:
    n = snapshots(3, 1.0)
    n.add("Bus", ["a", "b"], v_nom=110.0)
    n.add("Line", "line", bus0="a", bus1="b", x=1.0, s_nom=100)
    n.add("Transformer", "trafo", bus0="a", bus1="b", x=0.1, s_nom=100)
    n.add("Generator", "unit", bus="a", p_nom=100, marginal_cost=10)
    n.add("Load", "town", bus="b", p_set=50)
    n.add("StorageUnit", "hydro", bus="b", p_nom=10, max_hours=4)
    n.add("Store", "tank", bus="b", e_nom=10)
    n.add("ShuntImpedance", "coil", bus="b", b=1e-4)
    n.add("Link", "cable", bus0="a", bus1="b", p_nom=5, efficiency=0.9)
    return n


def inputs(table: object) -> set[str]:
    return set(table.index[~table.status.str.startswith("Output")])


@pytest.mark.parametrize("class_name", list(empty().components.keys()))
def test_every_attribute_of_pypsa_is_used_or_meaningless_or_lost(class_name: str) -> None:
    known = CLASSES[class_name]  # a new class of components needs an entry
    if known.whole:
        return
    groups = [known.used, known.constant, known.unused, frozenset(known.lost)]
    assert sum(map(len, groups)) == len(frozenset().union(*groups))
    assert inputs(empty().components[class_name].defaults) - frozenset().union(*groups) == set()


LOST = [
    (class_name, attribute)
    for class_name, known in CLASSES.items()
    for attribute in sorted(known.lost)
]  # fmt: skip


@pytest.mark.parametrize(("class_name", "attribute"), LOST)
def test_what_is_lost_is_refused_or_warned_of(class_name: str, attribute: str) -> None:
    n = one_of_each()
    components = n.components[class_name]
    default = components.defaults.at[attribute, "default"]
    components.static[attribute] = True if default is False else 3.0
    with pytest.raises(CaseError, match=rf"{components.name} {attribute}: (True|3.0) of '\w+': "):
        om.from_pypsa(n)
    with pytest.warns(CaseWarning, match=rf"lost: {components.name} {attribute}: "):
        om.from_pypsa(n, lossy=True)
    components.static["active"] = False
    om.from_pypsa(n)  # out of service, nothing is lost


@pytest.mark.parametrize(
    ("class_name", "attribute"),
    [
        (class_name, attribute)
        for class_name, known in CLASSES.items()
        for attribute in sorted(known.constant)
    ],
)
def test_a_series_of_what_is_constant_is_refused(class_name: str, attribute: str) -> None:
    n = one_of_each()
    components = n.components[class_name]
    name = components.static.index[-1]
    components.dynamic[attribute][name] = [0.9, 0.9, 0.9]
    om.from_pypsa(n)  # the same in all snapshots
    components.dynamic[attribute][name] = [0.9, 0.8, 0.9]
    with pytest.raises(CaseError, match=rf"{components.name} {attribute}: varies for '{name}'"):
        om.from_pypsa(n)


def test_an_attribute_that_is_not_known_is_refused_unless_it_has_its_default(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    n = one_of_each()
    known = CLASSES["generators"]
    monkeypatch.setitem(
        CLASSES, "generators", type(known)(used=known.used - {"marginal_cost"}, unused=known.unused)
    )
    with pytest.raises(CaseError, match=r"marginal_cost: 10.0 of 'unit': an attribute unknown to opfmodel"):
        om.from_pypsa(n)
    n.generators["marginal_cost"] = 0.0
    om.from_pypsa(n)


def test_all_losses_are_listed_at_once() -> None:
    n = one_of_each()
    n.add("Bus", ["heat", "pole"], carrier=["heat", "DC"])
    n.add("Link", "pump", bus0="a", bus1="heat", p_nom=5)
    n.add("Load", "warmth", bus="heat", p_set=5)
    n.add("Process", "factory", bus0="a", bus1="heat", p_nom=5)
    n.add("GlobalConstraint", "co2", sense="<=", constant=1.0)
    n.generators["ramp_limit_up"] = 0.5
    n.generators["p_init"] = 20.0
    n.stores["e_cyclic"] = True
    with pytest.raises(CaseError) as caught:
        om.from_pypsa(n)
    for loss in (
        "Bus 'heat': carrier = 'heat'",
        "Bus 'pole': carrier = 'DC'",
        "Process 'factory'",
        "GlobalConstraint 'co2'",
        "ramp_limit_up, ramp_limit_down: differ for 'unit'",
        "p_init of 'unit'",
        "cyclic end of 'tank'",
    ):
        assert loss in str(caught.value)
    network = om.from_pypsa(n, lossy=True)
    assert "warmth" not in network
    assert network.unit.ramp == 50.0


def test_a_cyclic_end_with_varying_limits_is_refused() -> None:
    n = one_of_each()
    n.remove("StorageUnit", "hydro")
    n.stores["e_cyclic"] = True
    with pytest.warns(CaseWarning, match=r"'tank': energy ends where it begins; .*End\(cyclic=True\)"):
        om.from_pypsa(n)
    n.stores_t.e_max_pu["tank"] = [1.0, 0.5, 1.0]
    with pytest.raises(CaseError, match=r"cyclic end of 'tank': its energy limits vary"):
        om.from_pypsa(n)


def test_of_a_stochastic_network_one_scenario_is_read_if_losses_are_accepted() -> None:
    n = one_of_each()
    n.set_scenarios({"low": 0.4, "high": 0.6})
    with pytest.raises(CaseError, match=r"2 scenarios: only 'low' is read"):
        om.from_pypsa(n)
    assert om.from_pypsa(n, lossy=True).unit.p == (0.0, 100.0)


# Time ----------------------------------------------------------------------------------------------


def test_snapshots_become_a_calendar() -> None:
    network = om.from_pypsa(meshed(hours=0.25))
    calendar = network.profiles.calendar
    assert (calendar.start, calendar.step, calendar.zone) == (np.datetime64("2025-03-29T00:00"), 0.25, "UTC")
    assert set(map(str, network.profiles)) == {
        "line0.rating", "coal.c1", "wind.p_max", "load_b.p", "load_c.p", "hydro.power_max",
    }  # fmt: skip
    assert network.coal.ramp == pytest.approx(0.3 * 200 / 0.25)
    assert network.load_b.p == network.profiles["load_b.p"][0]


def test_a_single_snapshot_has_no_series() -> None:
    n = empty()
    n.add("Bus", "a")
    n.add("Load", "town", bus="a", p_set=5.0)
    network = om.from_pypsa(n)
    assert len(network.profiles) == 0
    assert network.profiles.calendar is None


@pytest.mark.parametrize(
    ("stamps", "weights", "message"),
    [
        (["2025-01-01 00:00", "2025-01-01 01:00", "2025-01-01 03:00"], 1.0, r"03:00:00 follows 2025-01-01 01:00:00"),
        (["2025-01-01 00:00", "2025-01-01 00:00"], 1.0, r"00:00:00 follows 2025-01-01 00:00:00"),
        (["2025-01-01 01:00", "2025-01-01 00:00"], 1.0, r"00:00:00 follows 2025-01-01 01:00:00"),
        (["2025-01-01 00:00", "2025-01-01 00:15"], 1.0, r"objective: 1 h at 2025-01-01 00:00:00: .* 0.25 h apart"),
        (["2025-01-01 00:00", "2025-01-01 01:00"], [1.0, 2.0], r"stores: 2 h at 2025-01-01 01:00:00"),
        (["2025-01-01 00:00", "2025-01-01 01:00"], np.nan, r"generators: nan h at 2025-01-01 00:00:00"),
    ],
)  # fmt: skip
def test_uneven_snapshots_and_other_weightings_are_refused(
    stamps: list[str], weights: float, message: str
) -> None:
    n = pypsa.Network(snapshots=pd.DatetimeIndex(stamps))
    for column in n.snapshot_weightings:
        n.snapshot_weightings[column] = weights
    n.add("Bus", "a")
    with pytest.raises(CaseError, match=message):
        om.from_pypsa(n)


def test_snapshots_without_stamps_are_hours() -> None:
    n = pypsa.Network(snapshots=range(3))
    n.add("Bus", "a")
    n.add("Load", "town", bus="a", p_set=[1.0, 2.0, 3.0])
    network = om.from_pypsa(n)
    assert network.profiles.calendar is None
    assert network.profiles["town.p"].tolist() == [1, 2, 3]
    n.snapshot_weightings.loc[:] = 3.0
    with pytest.raises(CaseError, match=r"objective: 3 h at 0: the snapshots have no time stamps"):
        om.from_pypsa(n)


def test_investment_periods_are_refused() -> None:
    n = pypsa.Network(snapshots=pd.date_range("2025", periods=2, freq="h"))
    n.investment_periods = [2025, 2030]
    with pytest.raises(CaseError, match=r"snapshots of several investment periods"):
        om.from_pypsa(n, lossy=True)


# Names and values ----------------------------------------------------------------------------------


def test_a_name_of_several_classes_stays_with_the_bus() -> None:
    n = empty()
    n.add("Bus", ["1", "2"])
    n.add("Line", "1", bus0="1", bus1="2", x=1.0, s_nom=1)
    n.add("Load", ["2", "line_1"], bus="2", p_set=1.0)
    n.add("Generator", "free", bus="1", p_nom=1)
    assert list(om.from_pypsa(n)) == ["1", "2", "line_1_", "free", "load_2", "line_1"]


def test_voltage_limits_of_buses_without() -> None:
    n = empty()
    n.add("Bus", ["none", "low", "high"], v_mag_pu_min=[0, 1.15, 0], v_mag_pu_max=[np.inf, np.inf, 0.8])
    network = om.from_pypsa(n, voltage=(0.95, 1.05))
    assert [bus.vm for bus in network.of(om.Bus).values()] == [(0.95, 1.05), (1.15, 1.15), (0.8, 0.8)]


def test_set_points_that_fix_the_power_are_noted() -> None:
    n = one_of_each()
    n.generators["p_set"] = 30.0
    with pytest.warns(CaseWarning, match=r"'unit': p_set fixes the power"):
        assert om.from_pypsa(n).unit.p == (30.0, 30.0)
    free = om.from_pypsa(n, free_dispatch=True).unit
    assert (free.p, free.pg_set) == ((0.0, 100.0), 30.0)


def test_initial_energy_that_cannot_outlast_its_loss_is_noted() -> None:
    n = one_of_each()
    n.stores[["e_initial", "standing_loss"]] = 10.0, 0.1
    with pytest.warns(
        CaseWarning, match=r"'tank': PyPSA takes no standing loss .* 10 MWh .*; opfmodel takes 1 MWh"
    ):
        assert om.from_pypsa(n).tank.initial == 10.0


@pytest.mark.parametrize(
    ("class_name", "column", "value", "message"),
    [
        ("generators", "p_nom", np.inf, r"unit: p = \(.*inf\)"),
        ("generators", "sign", 0.0, r"generator 'unit': sign = 0"),
        ("generators", "marginal_cost", np.nan, r"unit: cost"),
        ("generators", "marginal_cost_quadratic", -1.0, r"unit: cost .* convex"),
        ("generators", "bus", "c", r"generator 'unit': bus = 'c': no such bus"),
        ("lines", "x", 0.0, r"line: r, x = \(0.0, 0.0\)"),
        ("lines", "type", "copper", r"copper"),
        ("transformers", "tap_side", 2, r"transformer 'trafo': tap_side = 2: must be 0 or 1"),
        ("stores", "e_min_pu", -1.0, r"tank: energy_min = -10"),
        ("stores", "e_initial", 11.0, r"tank: initial = 11"),
        ("storage_units", "efficiency_store", 1.2, r"hydro: charge_efficiency = 1.2"),
        ("storage_units", "standing_loss", 1.5, r"hydro: standing_loss = 1.5"),
        ("loads", "p_set", np.nan, r"town: p = nan"),
        ("buses", "v_nom", 0.0, r"a: base_kv = 0"),
    ],
)
def test_invalid_values_are_errors_that_name_them(
    class_name: str, column: str, value: object, message: str
) -> None:
    n = one_of_each()
    n.components[class_name].static[column] = value
    with pytest.raises(CaseError, match=message):
        om.from_pypsa(n)


def test_invalid_values_of_series_are_errors_with_their_step() -> None:
    n = one_of_each()
    n.loads_t.p_set["town"] = [1.0, np.nan, 2.0]
    with pytest.raises(CaseError, match=r"'town.p': step 1: nan"):
        om.from_pypsa(n)


@pytest.mark.parametrize(
    ("file", "message"),
    [
        ("loads-p_set.csv", r"Load p_set of 'c': 'much' at 2025-03-29 00:00:00: must be a number"),
        ("generators.csv", r"cannot be read as a PyPSA network: .*much"),
        ("snapshots.csv", r"snapshot_weightings \w+: .*'much': must be a number"),
    ],
)
def test_texts_in_place_of_numbers_are_errors(files: tuple[Path, Path], file: str, message: str) -> None:
    path = files[1] / file
    rows = [row.split(",") for row in path.read_text().splitlines()]
    column = rows[0].index("p_nom") if file == "generators.csv" else -1
    rows[1][column] = "much"
    path.write_text("\n".join(",".join(row) for row in rows))
    with pytest.raises(CaseError, match=message):
        om.read_network(files[1])


def test_something_else_is_no_network() -> None:
    with pytest.raises(CaseError, match=r"dict: must be a pypsa.Network"):
        om.from_pypsa({})


# Files ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    n, folder = meshed(hours=0.25), tmp_path_factory.mktemp("meshed")
    n.name = "meshed"
    n.export_to_netcdf(folder / "grid.nc")
    n.export_to_csv_folder(str(folder / "grid"))
    return folder


@pytest.fixture
def files(written: Path, tmp_path: Path) -> tuple[Path, Path]:
    """The same network in a file and in a folder, which a test may change."""
    shutil.copytree(written, tmp_path, dirs_exist_ok=True)
    return tmp_path / "grid.nc", tmp_path / "grid"


def test_files_are_read_as_the_network_that_was_written(files: tuple[Path, Path]) -> None:
    expected = om.from_pypsa(meshed(hours=0.25))
    for path in files:
        found = om.read_network(path)
        assert found.name == "meshed"
        assert list(found) == list(expected)
        for name in expected:  # CSV files round the numbers
            for field in set(expected[name].table_fields()) - set(expected[name].clocked):
                assert found[name].constant(field) == pytest.approx(expected[name].constant(field), rel=1e-12)
        assert found.profiles.calendar == expected.profiles.calendar
        assert found.profiles.keys() == expected.profiles.keys()
        for key, values in expected.profiles.items():
            np.testing.assert_allclose(found.profiles[key], values, rtol=1e-12)


def test_a_scenario_runs_a_file_with_its_series_and_step(files: tuple[Path, Path]) -> None:
    path = files[0].with_name("week.yaml")
    path.write_text(
        "network: {file: grid.nc}\ntime: {steps: 3}\ncontroller: {formulation: dc-matpower, horizon: 8}\n"
    )
    scenario = om.load_scenario(path)
    assert scenario.profiles.calendar.step == 0.25
    run = scenario.simulate()
    available = om.read_network(files[0]).profiles["wind.p_max"][:3]
    assert (run.data.pg.sel(generator="wind").values[:3] <= available + 1e-6).all()


def test_losses_of_files_are_refused_and_accepted(files: tuple[Path, Path]) -> None:
    path = files[1] / "links.csv"
    path.write_text("name,bus0,bus1,p_nom,efficiency\ncable,a,b,10,1.5\n")
    with pytest.raises(CaseError, match=r"grid: .*Link efficiency of 'cable': .*lossy"):
        om.read_network(files[1])
    with pytest.warns(CaseWarning, match=r"grid: lost: Link efficiency of 'cable'"):
        om.read_network(files[1], lossy=True)


@pytest.mark.parametrize("name", ["empty.nc", "text.nc", "cut.nc", "missing.nc", "matpower.nc"])
def test_files_that_are_no_networks_are_errors(files: tuple[Path, Path], name: str) -> None:
    path = files[0].with_name(name)
    content = {"empty.nc": b"", "text.nc": b"hello", "cut.nc": files[0].read_bytes()[:5000]}.get(name)
    if content is not None:
        path.write_bytes(content)
    if name == "matpower.nc":
        import xarray as xr

        xr.Dataset({"a": ("x", [1.0])}).to_netcdf(path)
    with pytest.raises(CaseError, match=rf"{name}: "):
        om.read_network(path)


@pytest.mark.parametrize(
    "text", ["", "name,v_nom\na,much\n", "name\na\na\n", "v_nom\n110\n", '"', "name,v_nom\n\x00,1\n"]
)
def test_folders_that_are_no_networks_are_errors(files: tuple[Path, Path], text: str) -> None:
    (files[1] / "buses.csv").write_text(text)
    with pytest.raises(CaseError, match=r"grid"):
        om.read_network(files[1])


def test_without_pypsa_netcdf_is_refused_with_what_to_install(
    files: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pypsa", None)
    with pytest.raises(CaseError, match=r"grid.nc: .*pip install 'opfmodel\[pypsa\]'"):
        om.read_network(files[0])


def test_without_pypsa_a_folder_is_refused_unless_powerio_reads_all_of_it(
    files: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    n = empty()
    n.add("Bus", ["a", "b"], v_nom=110.0, v_mag_pu_min=0.95, v_mag_pu_max=1.05)
    n.add("Line", "line", bus0="a", bus1="b", x=4.0, r=1.0, b=1e-4, s_nom=90)
    n.add("Transformer", "trafo", bus0="b", bus1="a", x=0.1, r=0.01, s_nom=80, tap_ratio=0.95, phase_shift=2)
    n.add("Generator", "unit", bus="a", control="Slack", p_nom=100, p_min_pu=0.1, marginal_cost=10)
    n.add("Load", "town", bus="b", p_set=50, q_set=5)
    n.add("ShuntImpedance", "coil", bus="b", b=1e-3)
    n.add("Carrier", "AC", color="red")
    folder = files[1].with_name("plain")
    n.export_to_csv_folder(str(folder))
    whole = om.read_network(folder)
    monkeypatch.setitem(sys.modules, "pypsa", None)
    plain = om.read_network(folder)
    objective = [om.MultiStage(network).solve().objective for network in (plain, whole)]
    assert objective[0] == pytest.approx(objective[1], rel=1e-6)
    with pytest.raises(
        CaseError, match=r"grid: .*generators-marginal_cost.csv.*pip install 'opfmodel\[pypsa\]'"
    ):
        om.read_network(files[1])


@pytest.mark.parametrize(
    ("file", "text", "column"),
    [
        ("lines.csv", "name,bus0,bus1,x,s_nom,s_max_pu\nl,a,b,1,10,0.7\n", "s_max_pu"),
        ("lines.csv", "name,bus0,bus1,type,length,s_nom\nl,a,b,copper,1,10\n", "type"),
        ("lines.csv", "name,bus0,bus1,x,g,s_nom\nl,a,b,1,0.1,10\n", "g"),
        ("transformers.csv", "name,bus0,bus1,x,s_nom,tap_ratio,tap_side\nt,a,b,1,10,0.9,1\n", "tap_side"),
        ("generators.csv", "name,bus,p_nom,p_set\ng,a,10,5\n", "p_set"),
        ("generators.csv", "name,bus,p_nom,ramp_limit_up\ng,a,10,0.5\n", "ramp_limit_up"),
        ("generators.csv", "name,bus,p_nom,committable\ng,a,10,True\n", "committable"),
        ("generators.csv", "name,bus,p_nom,novelty\ng,a,10,1\n", "novelty"),
        ("loads.csv", "name,bus,p_set,sign\nl,a,10,1\n", "sign"),
        ("buses.csv", "name,v_nom,carrier\na,110,AC\nb,110,heat\n", "carrier"),
        ("snapshots.csv", "snapshot\n1\n2\n", "several snapshots"),
        ("stores.csv", "name,bus,e_nom\ns,a,10\n", "stores.csv"),
        ("links.csv", "name,bus0,bus1,p_nom\nl,a,b,10\n", "links.csv"),
        ("novelties.csv", "name,bus\nl,a\n", "novelties.csv"),
    ],
)
def test_without_pypsa_each_thing_that_powerio_drops_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str, text: str, column: str
) -> None:
    monkeypatch.setitem(sys.modules, "pypsa", None)
    (tmp_path / "buses.csv").write_text("name,v_nom\na,110\nb,110\n")
    (tmp_path / file).write_text(text)
    with pytest.raises(CaseError, match=rf"{file}(: {column})?.*install PyPSA") as caught:
        om.read_network(tmp_path)
    assert column in str(caught.value)


def test_the_classes_without_injection_are_classes_of_pypsa() -> None:
    assert set(TYPES) <= set(empty().components.keys())


def test_reading_asks_nothing_of_the_internet(
    files: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    import urllib.request

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("a request")

    monkeypatch.setattr(urllib.request, "urlopen", refuse)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        om.read_network(files[0])


def test_series_of_unknown_components_are_errors(files: tuple[Path, Path]) -> None:
    path = files[1] / "loads-p_set.csv"
    rows = path.read_text().splitlines()
    path.write_text("\n".join([rows[0].replace("c", "cc"), *rows[1:]]))
    with pytest.raises(CaseError, match=r"Load p_set: .*no such component"):
        om.read_network(files[1])
