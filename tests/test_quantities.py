"""Values with units, in the fields of components, keys of scenarios and options of plugins."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import hypothesis.strategies as st
import pytest
from conftest import ROOT
from hypothesis import given

import opfmodel as om
from opfmodel.check import check
from opfmodel.cli import show
from opfmodel.data.yaml import parse
from opfmodel.errors import NetworkError, ScenarioError, UnitError
from opfmodel.network.quantities import Basis, currency_fault, is_quantity, read_quantity
from opfmodel.network.units import UNITS
from opfmodel.results import figures
from opfmodel.study.comparison import COSTS, Comparison, markdown

GRID = """\
currency: EUR
network:
  base_mva: 200 MVA
  buses: {a: {vm: [0.95 pu, 1.05 p.u.], base_kv: 110 kV, reference: true}, b: {}}
  branches: {line: {from_bus: a, to_bus: b, r: 0.01 pu, x: 0.1, rating: 120 MVA, shift: 0.1 rad, angle: [-30 deg, 30°]}}
  generators:
    coal: {bus: a, p: [0, 1.2 GW], q: [-50 Mvar, 0.5 pu], ramp: 0.5 MW/min, cost: {c2: 0.01 EUR/MW²h, c1: 40 EUR/MWh, c0: 1 kEUR/h}}
    peaker: {bus: b, p: [0, 60], cost: {points: [[0 MW, 0 EUR/h], [30, 1500 EUR/h], [60 MW, 3600]]}}
  storages: {cell: {bus: b, energy: 200 MWh, power: 500 kW, initial: 25% of energy, standing_loss: 1 %/h, charge_efficiency: 95%}}
  loads: {town: {bus: b, p: 50 MW, q: 10 MVAr}}
time: {step: 15 min, steps: 2}
profiles: [step: {loads: [town], first: 0, last: 1, add: 2000 kW}]
controller:
  end: {price: 0.03 EUR/kWh}
  elastic: {shedding: 9 kEUR/MWh}
  objective: {loss-minimisation: {price: 40 EUR/MWh}}
plant: {mode: redispatch, price: 90 EUR/MWh, reactive_price: 2 EUR/MVArh}
published: {source: nobody, J_e: 2 kEUR}
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "grid.yaml").write_text(GRID)
    return tmp_path / "grid.yaml"


def test_quantities_of_a_scenario_are_in_the_units_of_their_fields(path: Path) -> None:
    scenario = om.load_scenario(path)
    line, coal, cell = (scenario.network[name] for name in ("line", "coal", "cell"))
    assert isinstance(line, om.Branch)
    assert isinstance(coal, om.Generator)
    assert isinstance(cell, om.Storage)
    assert scenario.network.base_mva == 200
    assert scenario.network["a"] == om.Bus(vm=(0.95, 1.05), base_kv=110, reference=True)
    assert (line.r, line.rating, line.angle) == (0.01, 120, (-30, 30))
    assert line.shift == pytest.approx(5.729577951308232)
    assert (coal.p, coal.q, coal.ramp) == ((0, 1200), (-50, 100), 30)
    assert coal.cost == om.Polynomial(0.01, 40, 1000)
    assert scenario.network["peaker"].cost == om.PiecewiseLinear(((0, 0), (30, 1500), (60, 3600)))  # type: ignore[attr-defined]
    assert (cell.energy, cell.power, cell.initial, cell.charge_efficiency) == (200, 0.5, 50, 0.95)
    assert cell.standing_loss == 0.01
    assert scenario.settings.time.step == 0.25
    assert scenario.profiles.series["town", "p"][:2].tolist() == [52, 52]
    assert scenario.problem.end.price == pytest.approx(30)
    assert scenario.elastic.shedding == 9000
    assert scenario.published == {"J_e": 2000}
    assert scenario.problem.objective.price == 40  # type: ignore[attr-defined]
    assert scenario.plant().price == 90  # type: ignore[attr-defined]


# field: value, what the message shows of it, and what it says is accepted
WRONG = {
    "storages.cell.energy": ("200 MW", "200 MW", "MWh"),
    "storages.cell.power": ("[-1 MW, 1 MVAr]", "1 MVAr", "MW"),
    "generators.coal.ramp": ("30 MW", "30 MW", "MW/h"),
    "generators.coal.p": ("[0, 10 kW h]", "10 kW h", "MW"),
    "generators.coal.cost": ("{c1: 40 EUR/MW}", "40 EUR/MW", "EUR/MWh"),
    "generators.peaker.cost": ("{points: [[0, 0], [10 MWh, 20]]}", "10 MWh", "MW"),
    "buses.a.vm": ("[104 kV, 116 kV]", "104 kV", "p.u."),
    "buses.a.base_kv": ("110 kA", "110 kA", "kV"),
    "branches.line.x": ("4 ohm", "4 ohm", "p.u."),
    "branches.line.rating": ("120 MW", "120 MW", "MVA"),
    "branches.line.tap": ("1.02 pu", "1.02 pu", "plain number"),
    "loads.town.p": ("50 Megawatt", "50 Megawatt", "MW"),
    "loads.town.q": ("1e400 MVAr", "1e400 MVAr", "finite"),
}


@pytest.mark.parametrize("key", WRONG)
def test_a_wrong_unit_is_an_error_with_field_value_and_accepted_unit(key: str, path: Path) -> None:
    text, shown, accepted = WRONG[key]
    with pytest.raises(ScenarioError) as caught:
        om.load_scenario(path, overrides={f"network.{key}": parse(text, "")[0]})
    message = str(caught.value)
    assert f"network.{key}: {shown!r}" in message
    assert accepted in message.rpartition("must be")[2]


@pytest.mark.parametrize(
    ("key", "value", "accepted"),
    [
        ("time.step", "15 MW", "h"),
        ("network.base_mva", "100 MW", "MVA"),
        ("controller.end.price", "3 EUR/MW", "EUR/MWh"),
        ("plant.price", "90 EUR", "EUR/MWh"),
        ("controller.objective.loss-minimisation.price", "1 h", "EUR/MWh"),
        ("published.J_e", "3 EUR/h", "EUR"),
        ("currency", "MW", "currency"),
        ("currency", 3, "text"),
        ("currency", "", "currency"),
    ],
)
def test_wrong_units_outside_components_are_errors_with_key_and_value(
    key: str, value: Any, accepted: str, path: Path
) -> None:
    with pytest.raises(ScenarioError) as caught:
        om.load_scenario(path, overrides={key: value})
    message = str(caught.value)
    assert key.rpartition(".")[2] in message
    assert repr(value) in message
    assert accepted in message.rpartition("must be")[2]


def test_a_quantity_out_of_range_is_an_error_with_the_value_in_the_unit_of_the_field(path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"limit: -3000.0: must be greater than 0"):
        om.load_scenario(path, overrides={"controller.elastic.limit": "-3 EUR/kWh"})
    with pytest.raises(ScenarioError, match=r"energy: -0.2: must be at least 0"):
        om.load_scenario(path, overrides={"network.storages.cell.energy": "-200 kWh"})


def test_a_value_in_another_currency_is_an_error_with_both(path: Path) -> None:
    for key, value in (
        ("network.generators.coal.cost", {"c1": "40 $/MWh"}),
        ("plant.price", "90 USD/MWh"),
        ("controller.end.price", "9 CHF/MWh"),
    ):
        with pytest.raises(ScenarioError, match=r"but the currency is EUR; must be in EUR/MWh"):
            om.load_scenario(path, overrides={key: value})


@pytest.mark.parametrize("value", ["200", "MWh", "two MWh", "2019-07-22", "12:30", "", "1_000"])
def test_text_that_is_no_quantity_stays_refused(value: str, path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"energy: .*must be a number in MWh"):
        om.load_scenario(path, overrides={"network.storages.cell.energy": value})


def test_the_example_of_the_page_on_inputs_is_read(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "inputs.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"## Units\n.*?```yaml\n(.*?)```", page, flags=re.DOTALL)
    (tmp_path / "grid.yaml").write_text(block)
    options = dict(item.split("=") for item in re.findall(r'--set "([^"]+)"', page))
    grid = om.load_scenario(tmp_path / "grid.yaml", overrides=options).network
    assert grid["cell"] == om.Storage("a", energy=200, power=(-0.5, 50), charge_efficiency=0.95, initial=50)
    assert grid["town"] == om.Load("a", p=200, q=20)


def test_a_power_base_from_a_file_counts_for_per_unit_powers(tmp_path: Path, path: Path) -> None:
    case = Path(__file__).parent / "data" / "matpower" / "case9.m"
    (tmp_path / "s.yaml").write_text(
        f"network: {{file: {case}, default_cost: 3 k$/GWh, update: {{gen1: {{p: [0 MW, 0.5 pu]}}}}}}"
    )
    assert om.load_scenario(tmp_path / "s.yaml").network["gen1"].p == (0, 50)  # type: ignore[attr-defined]


def test_the_currency_of_a_network_is_a_name() -> None:
    assert om.Network(currency="EUR").copy().currency == "EUR"
    for wrong in ("", "MW", "E R", "a" * 20, 3):
        with pytest.raises(NetworkError, match="currency"):
            om.Network(currency=wrong)  # type: ignore[arg-type]
    grid = om.Network()
    with pytest.raises(NetworkError, match="currency"):
        grid.currency = "EUR"


def test_results_are_labelled_with_the_currency(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scenario = om.load_scenario(path, overrides={"plant": "nominal", "cost": "economic"})
    run = scenario.simulate()
    plan = scenario.problem.solve()
    units = [
        str(values.attrs["units"])
        for data in (run.data, plan.data)
        for values in data.values()
        if "units" in values.attrs
    ]
    assert {"EUR", "EUR/h", "EUR/MWh"} <= set(units)
    assert not [unit for unit in units if "$" in unit]
    report = check(scenario.network, run.data, scenario.profiles)
    for printed in (repr(run), repr(plan), str(report)):
        assert " EUR" in printed
        assert "$" not in printed
    labels = [axis.get_ylabel() for axis in figures.system(run.data).axes]
    assert "cost [EUR/h]" in labels
    comparison = Comparison("s", dict.fromkeys(COSTS, 1000.0), {}, {}, "EUR")
    assert markdown([comparison]).startswith("| kEUR |")
    assert comparison.as_dict()["currency"] == "EUR"
    show.plan(plan, None, [], elastic=False)
    show.comparisons([comparison])
    out = capsys.readouterr().out
    assert "kEUR" in out
    assert "$" not in out


NUMBERS = st.floats(-1e6, 1e6, allow_nan=False)
PREFIXES = {"": 1.0, "k": 1e3, "M": 1e6, "G": 1e9}


@given(NUMBERS, st.sampled_from([u for u in UNITS if u and not u.startswith("p.u. ")]))
def test_a_number_in_the_unit_of_its_field_is_itself(number: float, unit: str) -> None:
    text = f"{number!r} {unit}"
    assert is_quantity(text)
    assert read_quantity(text, unit, Basis(base_mva=7.0)) == number


@given(NUMBERS, st.sampled_from(sorted(PREFIXES)), st.sampled_from(sorted(PREFIXES)))
def test_prefixes_are_powers_of_thousand(number: float, above: str, below: str) -> None:
    assert read_quantity(f"{number!r} {above}W", "MW") == pytest.approx(
        number * PREFIXES[above] / 1e6, rel=1e-12
    )
    cost = read_quantity(f"{number!r} {above}$/{below}Wh", "$/MWh")
    assert cost == pytest.approx(number * PREFIXES[above] / PREFIXES[below] * 1e6, rel=1e-12)


@given(st.sampled_from(UNITS), st.sampled_from(UNITS))
def test_units_of_different_fields_are_never_confused(one: str, other: str) -> None:
    if other.startswith("p.u. ") or one == other or not other:
        return
    alike = {one.partition(" ")[0], other} <= {"p.u."}
    if {one, other} == {"h", "min"}:
        assert read_quantity(f"60 {other}", one) in (1.0, 3600.0)
    elif alike:
        assert read_quantity(f"1 {other}", one) == 1
    else:
        with pytest.raises(UnitError, match="must be in"):
            read_quantity(f"1 {other}", one)


@given(st.text(max_size=12), st.sampled_from(UNITS))
def test_any_text_is_read_or_refused(text: str, unit: str) -> None:
    for candidate in (text, f"1 {text}"):
        try:
            assert isinstance(read_quantity(candidate, unit), float)
        except UnitError as error:
            assert "must be" in str(error)
    assert isinstance(currency_fault(text), str)
