"""The independent check detects violations of every family, planted one at a time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
import xarray as xr
from conftest import demand, everything
from hypothesis import given, settings
from hypothesis import strategies as st
from one_by_one import cost, excesses

import opfmodel as om
from opfmodel.check import Violation, check, economic_cost, losses
from opfmodel.components import Component, at_bus, flag
from opfmodel.errors import ProfileError, ResultError

SERIES = demand(5)


@pytest.fixture(scope="module")
def solved() -> tuple[om.Network, xr.Dataset]:
    grid = everything()
    return grid, om.MultiStage(grid, 5, profiles=SERIES).solve().data


def test_a_sound_plan_has_no_violation(solved: tuple[om.Network, xr.Dataset]) -> None:
    report = check(*solved, SERIES)
    assert report.max_violation < 1e-6
    assert set(report.violations) >= {
        "voltage",
        "branch rating",
        "active balance",
        "ramp",
        "storage dynamics",
    }
    assert "active balance" in str(report)


PLANTED = [
    ("voltage", "vm", "a", 0.3, None),
    ("generator p", "pg", "cheap", 70.0, None),
    ("generator q", "qg", "dear", 60.0, None),
    ("ramp", "pg", "cheap", 30.0, None),
    ("active balance", "pg", "dear", 5.0, 5.0 / 50),
    ("reactive balance", "qs", "tank", 1.0, 1.0 / 50),
    ("storage power", "ps", "battery", 30.0, None),
    ("storage q", "qs", "tank", 9.0, None),
    ("storage rating", "qs", "battery", 20.0, None),
    ("storage energy", "e_next", "tank", 100.0, None),
    ("storage dynamics", "e_next", "tank", 2.0, 2.0 / 50),
    ("storage dynamics", "e_next", "battery", 2.0, None),
    ("energy continuity", "e", "tank", 4.0, None),
    ("reported flow", "pf", "line", 1.0, 1.0 / 50),
    ("reported flow", "qt", "cable", 1.0, 1.0 / 50),
    ("branch rating", "va", "a", 30.0, None),
    ("angle difference", "va", "a", 30.0, None),
]


@pytest.mark.parametrize(("family", "quantity", "component", "amount", "expected"), PLANTED)
def test_a_planted_violation_is_found(
    solved, family: str, quantity: str, component: str, amount: float, expected
):
    grid, data = solved
    wrong = data.copy(deep=True)
    dimension = wrong[quantity].dims[1]
    wrong[quantity].loc[{dimension: component, "time": 2.0}] += amount
    found = check(grid, wrong, SERIES).violations[family]
    assert found.value > 1e-3
    assert found.time in (1.0, 2.0, 3.0)
    if expected is not None:
        assert found.value == pytest.approx(expected, rel=0.35)


def test_a_missing_number_is_a_violation(solved: tuple[om.Network, xr.Dataset]) -> None:
    grid, data = solved
    wrong = data.copy(deep=True)
    wrong["vm"][2, 0] = np.nan
    assert check(grid, wrong, SERIES).max_violation == np.inf


def test_the_demand_is_taken_from_the_declaration_not_from_the_plan(solved) -> None:
    grid, data = solved
    assert check(grid, data).violations["active balance"].value > 1e-2  # without the series


def test_the_ramp_from_the_dispatch_before(solved: tuple[om.Network, xr.Dataset]) -> None:
    grid, data = solved
    first = float(data["pg"].sel(generator="cheap")[0])
    report = check(grid, data, SERIES, previous_pg={"cheap": first - 20, "dear": 0.0})
    assert report.violations["ramp"].value == pytest.approx(5 / 50)


def test_losses_are_generation_minus_demand_minus_charging_minus_shunts(solved) -> None:
    grid, data = solved
    balance = (
        data["pg"].sum("generator")
        - data["pd"].sum("bus")
        - data["ps"].sum("storage")
        - grid.capacitor.g * data["vm"].sel(bus="d") ** 2
    )
    assert losses(grid, data) == pytest.approx(balance.values, abs=1e-5)
    assert losses(grid, data).min() > 0


def test_reactive_power_counts_where_there_is_no_generator() -> None:
    grid = om.Network("off grid")
    grid.bus = om.Bus()
    grid.cell = om.Storage("bus", energy=100, power=20, q=50)
    grid.town = om.Load("bus", p=10, q=5)
    data = om.MultiStage(grid, 2, objective=om.StateOfChargeTracking()).solve().data
    assert check(grid, data).max_violation < 1e-6
    data["qs"][1] += 3.0
    assert check(grid, data).violations["reactive balance"].value == pytest.approx(0.03, abs=1e-6)
    assert losses(grid, data).tolist() == [0.0, 0.0]


def test_costs_of_all_kinds(solved: tuple[om.Network, xr.Dataset]) -> None:
    grid, data = solved
    cheap, dear = (data["pg"].sel(generator=g).values for g in ("cheap", "dear"))
    expected = 0.02 * cheap**2 + 12 * cheap + 5 + np.interp(dear, [0, 20, 50], [0, 500, 1700])
    assert economic_cost(grid, data, SERIES) == pytest.approx(expected, rel=1e-6)


def test_piecewise_linear_costs_beside_others() -> None:
    grid = om.Network()
    grid.bus = om.Bus()
    grid.even = om.Generator("bus", p=(0, 9), cost=om.PiecewiseLinear([(0, 1), (5, 11), (8, 17)]))  # one line
    grid.smooth = om.Generator("bus", p=(0, 9), cost=om.Polynomial(2, 0, 1))
    grid.steep = om.Generator("bus", p=(0, 9), cost=om.PiecewiseLinear([(0, 0), (1, 1), (2, 3), (3, 7)]))
    pg = np.array([[3.0, 1.0, 0.5], [20.0, 2.0, 2.5], [-1.0, 0.0, 4.0]])
    data = xr.Dataset({"pg": (("time", "generator"), pg)}, {"time": range(3), "generator": list(grid)[1:]})
    even, smooth, steep = 1 + 2 * pg[:, 0], 1 + 2 * pg[:, 1] ** 2, np.array([0.5, 5.0, 11.0])
    assert economic_cost(grid, data) == pytest.approx(even + smooth + steep, rel=1e-12)
    assert economic_cost(grid, data, {"smooth.c1": [0, 0, 1, 3, 5]}, first=2) == pytest.approx(
        even + smooth + steep + [1, 6, 0], rel=1e-12
    )


# Location of the largest violation ------------------------------------------------------------------


def place(violation: Violation) -> tuple[str, float]:
    return violation.component, violation.time


DIRECT = [
    ("voltage", "vm", "d", 3.0),
    ("generator p", "pg", "dear", 400.0),
    ("generator q", "qg", "dear", 400.0),
    ("ramp", "pg", "cheap", 400.0),
    ("storage power", "ps", "tank", 400.0),
    ("storage q", "qs", "tank", 400.0),
    ("storage energy", "e_next", "tank", 400.0),
    ("reported flow", "pf", "ring", 400.0),
    ("reported flow", "qf", "ring", 400.0),
    ("reported flow", "pt", "cable", 400.0),
    ("reported flow", "qt", "transformer", 400.0),
]


@pytest.mark.parametrize(("family", "quantity", "component", "amount"), DIRECT)
def test_a_violation_has_its_component_and_time(
    solved, family: str, quantity: str, component: str, amount: float
):
    grid, data = solved
    wrong = data.copy(deep=True)
    wrong[quantity].loc[{wrong[quantity].dims[1]: component, "time": 3.0}] += amount
    assert place(check(grid, wrong, SERIES).violations[family]) == (component, 3.0)


@pytest.mark.parametrize("end", ["pf", "qf", "pt", "qt"])
def test_ratings_hold_at_both_ends(solved, end: str) -> None:
    grid, data = solved
    wrong = data.copy(deep=True).assign_attrs(formulation="of another package")
    wrong[end].loc[{"branch": "transformer", "time": 1.0}] = 900.0
    found = check(grid, wrong, SERIES).violations["branch rating"]
    assert place(found) == ("transformer", 1.0)
    assert found.physical == pytest.approx(900 - 70, abs=1)


def test_ties_go_to_the_first_component_and_then_the_first_stage(solved) -> None:
    grid, data = solved
    wrong = data.copy(deep=True)
    for bus, time in (("c", 1.0), ("b", 4.0), ("b", 3.0), ("d", 0.0)):
        wrong["vm"].loc[{"bus": bus, "time": time}] = 1.5
    for order in ("abcd", "dcba"):
        found = check(grid, wrong.sel(bus=list(order)), SERIES).violations["voltage"]
        assert place(found) == ("b", 3.0)
        assert found.value == pytest.approx(0.4)


def test_without_violation_the_first_component_is_recorded(solved) -> None:
    grid, data = solved
    calm = data.copy(deep=True)
    calm["vm"][:] = 1.0
    calm["vm"].loc[{"bus": "a", "time": 2.0}] = 1.05  # closest to its limit
    calm["vm"].loc[{"bus": "c", "time": 1.0}] = 1.09
    found = check(grid, calm, SERIES).violations["voltage"]
    assert (found.value, *place(found)) == (0.0, "a", 2.0)


def test_energy_continuity_holds_between_stages_only(solved) -> None:
    grid, data = solved
    found = check(grid, data.isel(time=[2]), SERIES, first=2).violations["energy continuity"]
    assert (found.value, *place(found)) == (0.0, "battery", 2.0)


# Missing data -----------------------------------------------------------------------------------


def test_a_missing_dispatch_violates_limits_but_not_ramps(solved) -> None:
    grid, data = solved
    wrong = data.copy(deep=True)
    wrong["pg"].loc[{"generator": "cheap", "time": 2.0}] = np.nan
    found = check(grid, wrong, SERIES).violations
    assert (found["generator p"].value, *place(found["generator p"])) == (np.inf, "cheap", 2.0)
    assert (found["active balance"].value, *place(found["active balance"])) == (np.inf, "a", 2.0)
    assert found["ramp"].value < 1e-6


def test_a_missing_number_does_not_hide_simultaneous_charging_and_discharging(solved) -> None:
    grid, data = solved
    grid = grid.copy()
    grid.other = om.Storage("d", energy=40, power=10, charge_efficiency=0.9)
    wrong = data.reindex(storage=["other", "battery", "tank"], fill_value=0.0)
    wrong["e_next"].loc[{"storage": "battery", "time": 2.0}] -= 3.0
    some = check(grid, wrong, SERIES).simultaneous
    wrong["ps"].loc[{"storage": "other", "time": 1.0}] = np.nan
    report = check(grid, wrong, SERIES)
    assert report.simultaneous == some > 0.1
    assert place(report.violations["storage dynamics"]) == ("other", 1.0)


def test_components_missing_from_the_data_count_as_out_of_service(solved) -> None:
    grid, data = solved
    report = check(grid, data.drop_sel(generator="dear"), SERIES)
    found, lacking = report.violations["active balance"], data["pg"].sel(generator="dear")
    assert found.physical == pytest.approx(float(lacking.max()), abs=1e-4)
    assert place(found) == ("c", float(lacking.idxmax()))
    assert report.cost < check(grid, data, SERIES).cost
    idle = grid.copy()
    idle.update("mill", in_service=False)
    idle.update("capacitor", in_service=False)
    assert check(idle, data, SERIES).violations["active balance"].component == "d"
    fewer = check(grid, data.drop_dims("storage"), SERIES)
    assert not {family for family in fewer.violations if family.startswith(("storage", "energy"))}
    assert fewer.violations["active balance"].component in ("b", "d")


def test_a_duplicate_component_in_the_data_is_refused(solved) -> None:
    grid, data = solved
    with pytest.raises(ResultError, match=r"generator: 'cheap'"):
        check(grid, data.sel(generator=["cheap", "dear", "cheap"]), SERIES)


@pytest.mark.parametrize("key", ["mill.q", "line.rating"])
@pytest.mark.parametrize("stages", [[4], [2, 3, 4]])
def test_a_series_must_cover_the_stages(solved, key: str, stages: list[int]) -> None:
    grid, data = solved
    short = {**SERIES, key: np.full(4, 60.0)}
    with pytest.raises(ProfileError, match=rf"'{key}': has 4 values; 5 are needed"):
        check(grid, data.isel(time=stages), short, first=stages[0])
    check(grid, data, {**SERIES, "mill.x": [1.0], "nobody.p": [1.0]})  # series that are not used


def test_a_single_limit_may_have_a_time_series(solved) -> None:
    grid, data = solved
    limit = np.full(9, np.inf)
    limit[5] = float(data["pg"].sel(generator="dear")[3]) - 7
    found = check(grid, data, {"dear.p_max": limit}, first=2).violations["generator p"]
    assert place(found) == ("dear", 3.0)
    assert found.physical == pytest.approx(7, abs=1e-6)


def test_unchecked_items_of_a_formulation_from_another_package(solved) -> None:
    grid, data = solved
    other = data.assign_attrs(formulation="other")
    equations = "branch equations of the formulation 'other'"
    balance = "bus balances: the results do not include the power of the branches"
    assert check(grid, other, SERIES).unchecked == (equations,)
    assert check(grid, other, SERIES).max_violation < 1e-6
    fewer = other.drop_vars(["vm", "va", "qf"])
    assert check(grid, fewer, SERIES).unchecked == (equations, "angle differences", "voltages", balance)
    assert not {"branch rating", "active balance"} & set(check(grid, fewer, SERIES).violations)
    angles = check(grid, other.drop_vars("pf"), SERIES)  # angles need no flows
    assert angles.unchecked == (equations, balance)
    assert angles.violations["angle difference"] == check(grid, data, SERIES).violations["angle difference"]


@dataclass(frozen=True)
class Boiler(Component):
    """A device from another package, which may inject active power without reactive power."""

    kind: ClassVar[str] = "boiler"
    plural: ClassVar[str] = "boilers"

    bus: str = at_bus()
    in_service: bool = flag(True)


def test_injections_of_devices_from_other_packages_count(solved) -> None:
    grid, data = solved
    grid = grid.copy()
    grid.idle = Boiler("a", in_service=False)
    assert check(grid, data, SERIES).unchecked == ()
    grid.boiler = Boiler("c")
    limits = "limits and cost of the boilers"
    balance = "bus balances: the results do not include the power of the boilers"
    assert check(grid, data, SERIES).unchecked == (limits, balance)
    fed = data["vm"].copy(data=np.zeros((5, 4)))
    fed.loc[{"bus": "c", "time": 3.0}] = -8.0
    report = check(grid, data.assign(boiler_p=fed), SERIES)
    found = report.violations["active balance"]
    assert (found.physical, *place(found)) == (pytest.approx(8, abs=1e-4), "c", 3.0)
    assert report.unchecked == (limits,)
    assert report.violations["reactive balance"].value < 1e-6
    report = check(grid, data.assign(boiler_p=0 * fed, boiler_q=fed), SERIES)
    assert report.violations["reactive balance"].physical == pytest.approx(8, abs=1e-4)


def test_copperplate_islands_are_connected_by_branches_in_service() -> None:
    grid = om.Network(base_mva=10)
    for bus in ("z", "m", "y", "a", "x", "elsewhere"):
        grid.add(bus, om.Bus())
    for end in ("x", "a", "y"):
        grid.add(f"z{end}", om.Branch("z", end, r=0, x=0.1))
    grid.away = om.Branch("a", "elsewhere", r=0, x=0.1)
    grid.out = om.Branch("a", "m", r=0, x=0.1, in_service=False)
    grid.here, grid.there = om.Generator("z", p=(0, 90)), om.Generator("m", p=(0, 90))
    grid.town, grid.mill = om.Load("a", p=30), om.Load("m", p=20)
    data = xr.Dataset(
        {"pg": (("time", "generator"), [[30.0, 20.0], [28.0, 23.0], [25.0, 20.0]])},
        {"time": [0.0, 1.0, 2.0], "bus": list("mzayx"), "generator": ["here", "there"]},
        {"formulation": "copperplate"},
    )
    found = check(grid, data).violations["active balance"]
    assert (found.physical, *place(found)) == (pytest.approx(5), "a", 2.0)
    found = check(grid, data.isel(time=[0, 1])).violations["active balance"]
    assert (found.physical, *place(found)) == (pytest.approx(3), "m", 1.0)


# Arbitrary data ---------------------------------------------------------------------------------

QUANTITIES = {
    "ac": {"bus": ("vm", "va", "p_shortage", "q_shortage", "p_surplus", "q_surplus")},
    "soc": {"bus": ("w",), "branch": ("wr", "wi")},
    "dc": {"bus": ("va",)},
    "dc-matpower": {"bus": ("va",)},
    "dc-losses": {"bus": ("va",), "branch": ("loss",)},
    "copperplate": {},
    "of another package": {"bus": ("vm", "va"), "branch": ("pf", "qf", "pt", "qt")},
}
REACTIVE = ("ac", "soc", "of another package")
COMPUTED = {  # families where rounding may decide which of two equal violations is larger
    "active balance",
    "angle difference",
    "branch loss",
    "branch rating",
    "reactive balance",
    "reported flow",
    "storage dynamics",
    "storage rating",
    "voltage products",
}
CENTRES = {"vm": (1.0, 0.1), "w": (1.0, 0.1), "wr": (1.0, 0.1), "wi": (0.0, 0.2), "va": (0.0, 20.0)}


def drawn(formulation: str, seed: int, stages: int) -> xr.Dataset:
    """A random trajectory of the grid of :func:`everything` with many violations, on a lattice to create ties."""
    grid, random = everything(), np.random.default_rng(seed)
    names = {k.kind: list(grid.of(k)) for k in (om.Bus, om.Branch, om.Generator, om.Storage)}
    quantities = {kind: list(chosen) for kind, chosen in QUANTITIES[formulation].items()}
    quantities |= {"generator": ["pg"], "storage": ["ps", "e", "e_next"]}
    if formulation in REACTIVE:
        quantities["generator"].append("qg")
        quantities["storage"].append("qs")
    data = xr.Dataset(coords={"time": np.arange(stages) * 0.5, **names})
    for kind, chosen in quantities.items():
        for quantity in chosen:
            mean, spread = CENTRES.get(quantity, (10.0, 30.0))
            values = mean + spread * np.round(random.normal(size=(stages, len(names[kind]))), 1)
            data[quantity] = ("time", kind), values
    return data.assign_attrs(formulation=formulation, step_hours=0.5)


formulations = pytest.mark.parametrize("formulation", QUANTITIES)
seeds = given(st.integers(0, 2**32 - 1))


@formulations
@settings(max_examples=10)
@seeds
def test_neither_the_order_nor_the_layout_of_the_data_matters(formulation: str, seed: int) -> None:
    grid, data, random = everything(), drawn(formulation, seed, 4), np.random.default_rng(seed)
    other = data.transpose(..., "time")
    for kind in ("bus", "branch", "generator", "storage"):
        shuffled = [str(name) for name in random.permutation(data[kind].values)]
        other = other.sel({kind: shuffled}).assign_coords({kind: np.array(shuffled, dtype=object)})
    report, again = check(grid, data, SERIES), check(grid, other, SERIES)
    assert list(again.violations) == list(report.violations)
    for family, found in report.violations.items():
        assert again.violations[family].physical == pytest.approx(found.physical, rel=1e-12, abs=1e-12)
        assert family in COMPUTED or place(again.violations[family]) == place(found)
    assert again.cost == pytest.approx(report.cost, rel=1e-12)
    assert again.simultaneous == pytest.approx(report.simultaneous, rel=1e-12)


@formulations
@settings(max_examples=10)
@seeds
def test_the_check_agrees_with_a_scalar_implementation(formulation: str, seed: int) -> None:
    grid, data = everything(), drawn(formulation, seed, 4)
    series = {
        **SERIES,
        "mill.p": 20 * SERIES["mill.p"],
        "line.rating": [50.0, np.inf, 0.0, 10.0],
        "cheap.p_max": [60.0, 20.0, 0.0, 5.0],
        "cheap.c1": [12.0, -3.0, 0.0, 100.0],
        "dear.ramp": [np.inf, 3.0, np.inf, 40.0],
        "tank.energy_min": [3.0, 9.0, 0.0, 30.0],
    }
    report, expected = check(grid, data, series), excesses(grid, data, series)
    assert set(report.violations) == set(expected)
    order = list(grid)
    for family, found in report.violations.items():
        # of several constraints at one place, keep the largest: it is sorted last
        excess = {(order.index(name), time): excess for name, time, excess in sorted(expected[family])}
        worst, where = max(0.0, *excess.values()), (order.index(found.component), found.time)
        assert found.physical == pytest.approx(worst, rel=1e-12, abs=1e-10), family
        if worst > 0 and family not in COMPUTED:
            assert where == min(place for place, amount in excess.items() if amount == worst), family
        assert worst == 0 or excess[where] == pytest.approx(worst, rel=1e-9), family
    assert report.cost == pytest.approx(cost(grid, data, series), rel=1e-12)
