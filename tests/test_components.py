"""Declaration of components: names, and an error for every rule."""

from __future__ import annotations

import copy
import math
import pickle
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import opfmodel as om
from opfmodel.errors import ComponentError, ModelError, NetworkError
from opfmodel.network import Component, at_bus, flag, number


def test_a_component_is_read_back_by_name(grid: om.Network) -> None:
    assert grid.coal is grid["coal"]
    assert "coal" in grid
    assert list(grid.of(om.Bus)) == ["north", "south"]
    assert repr(grid) == "Network('two-bus': 2 buses, 1 branch, 1 generator, 1 storage, 1 load)"
    assert len(grid) == 6


def test_loops_use_add() -> None:
    grid = om.Network()
    for step in range(3):
        grid.add(step, om.Bus())
    assert list(grid) == ["0", "1", "2"]


def test_networks_are_copied_and_pickled(grid: om.Network) -> None:
    for twin in (grid.copy(), pickle.loads(pickle.dumps(grid)), copy.deepcopy(grid)):
        assert {n: twin[n] for n in twin} == {n: grid[n] for n in grid}
    twin = grid.copy()
    twin.remove("town")
    assert "town" in grid


def test_fields_can_be_updated(grid: om.Network) -> None:
    grid.update("coal", ramp=30)
    assert grid.coal.ramp == 30
    with pytest.raises(
        ComponentError, match=r"coal: rmap = 3: unknown field of a generator; did you mean 'ramp'\?"
    ):
        grid.update("coal", rmap=3)
    with pytest.raises(ComponentError, match="coal: ramp = -1: must be at least 0"):
        grid.update("coal", ramp=-1)


def test_a_misspelt_field_suggests_the_closest() -> None:
    with pytest.raises(ComponentError, match=r"Generator: rmap = 3: unknown field; did you mean 'ramp'\?"):
        om.Generator("a", p=(0, 1), rmap=3)  # type: ignore[call-arg]


@pytest.mark.parametrize(
    "character", ["\x1b", "\n", "\x00", "\x7f", "\x9b", "\u200b", "\u2028", "\u2029", "\ud800"]
)
def test_names_have_visible_characters_only(character: str, grid: om.Network) -> None:
    name = f"a{character}b"
    with pytest.raises(NetworkError, match="visible") as caught:
        grid.add(name, om.Bus())
    assert str(caught.value).isprintable()
    assert name not in grid
    with pytest.raises(NetworkError, match="visible"):
        om.Network(name)
    with pytest.raises(ModelError, match="visible"):
        om.MultiStage(grid).constrain(name, lambda stage: om.total(stage.generator.pg) >= 0)


def test_names_may_have_any_letter(grid: om.Network) -> None:
    for name in ("Łódź 110 kV", "北京", "a\u00a0b", "№ 5/2", "😀"):
        assert grid.add(name, om.Bus()) is grid[name]


def test_names_are_unique_and_not_attributes_of_the_class(grid: om.Network) -> None:
    with pytest.raises(NetworkError, match="the name 'coal' is used by a generator"):
        grid.coal = om.Bus()
    with pytest.raises(NetworkError, match="'copy' is an attribute of Network"):
        grid.copy = om.Bus()
    with pytest.raises(NetworkError, match=r"has no component 'coat'; did you mean 'coal'\?"):
        grid["coat"]
    with pytest.raises(AttributeError, match="coat"):
        _ = grid.coat
    with pytest.raises(NetworkError, match="thing = 3: must be a component"):
        grid.thing = 3


@pytest.mark.parametrize(
    ("component", "field", "rule"),
    [
        (om.Bus(vm=(1.1, 0.9)), "vm", "the minimum 1.1 is above the maximum 0.9"),
        (om.Bus(vm=(-1, 1)), "vm", "the minimum must be at least 0"),
        (om.Bus(vm=1.0), "vm", r"must be a pair \(min, max\) in p.u."),
        (om.Bus(vm=(math.nan, 1)), "vm", "both ends must be numbers"),
        (om.Bus(reference="yes"), "reference", "must be true or false"),
        (om.Bus(base_kv=0), "base_kv", "must be greater than 0"),
        (om.Branch("a", "b", r=0, x=0), "r, x", "the impedance must be at least 1e-12"),
        (om.Branch("a", "a", r=0, x=1), "to_bus", "must differ from from_bus"),
        (om.Branch("a", "b", r=math.nan, x=1), "r", "must be a finite number"),
        (om.Branch("a", "b", r="0.1", x=1), "r", "must be a number in p.u."),
        (om.Branch("a", "b", r=0, x=1, rating=-1), "rating", "must be at least 0"),
        (om.Branch("a", "b", r=0, x=1, tap=0), "tap", "must be at least 0.001"),
        (om.Branch(1, "b", r=0, x=1), "from_bus", "must be the name of a bus"),
        (om.Generator("a", p=(0, math.nan)), "p", "both ends must be numbers"),
        (om.Generator("a", p=(math.inf, math.inf)), "p", "the minimum must be below infinity"),
        (
            om.Generator("a", p=(0, 1), cost=om.Polynomial(-1)),
            "cost",
            "must be convex: c2 must be at least 0",
        ),
        (om.Generator("a", p=(0, 1), cost=om.Polynomial(0, math.inf)), "cost", "must be finite"),
        (om.Generator("a", p=(0, 1), cost=5), "cost", "must be a Polynomial or PiecewiseLinear"),
        (om.Generator("a", p=(0, 1), cost=om.PiecewiseLinear([(0, 0)])), "cost", "needs at least two points"),
        (
            om.Generator("a", p=(0, 1), cost=om.PiecewiseLinear([(0, 0), (1, 5), (2, 6)])),
            "cost",
            "must be convex: slope 1 follows 5",
        ),
        (
            om.Generator("a", p=(0, 1), cost=om.PiecewiseLinear([(0, 0), (0, 5)])),
            "cost",
            "increasing MW",
        ),
        (om.Storage("a", energy=-1, power=1), "energy", "must be at least 0"),
        (om.Storage("a", energy=1, power=-1), "power", "must be at least 0"),
        (
            om.Storage("a", energy=1, power=1, initial=2),
            "initial",
            "must be between energy_min = 0 and energy = 1",
        ),
        (om.Storage("a", energy=1, power=1, energy_min=2), "energy_min", "must be at most energy = 1"),
        (
            om.Storage("a", energy=1, power=1, charge_efficiency=0),
            "charge_efficiency",
            "must be at least 0.001",
        ),
        (
            om.Storage("a", energy=1, power=1, discharge_efficiency=1.1),
            "discharge_efficiency",
            "must be at most 1",
        ),
        (om.Load("a", p=math.nan), "p", "must be a finite number"),
        (om.Load("a", p=True), "p", "must be a number in MW"),
        (om.Shunt("a", b=math.inf), "b", "must be a finite number"),
        (om.Load("a", p=1e31), "p", "must be a finite number of at most 1e.30"),
        (om.Load("a", p=-(10**400)), "p", "must be a finite number of at most 1e.30"),
        (om.Branch("a", "b", r=1e-200, x=0), "r, x", "the impedance must be at least 1e-12"),
        (om.Branch("a", "b", r=0, x=1, rating=10**400), "rating", "must be a finite number of at most 1e.30"),
        (om.Branch("a", "b", r=0, x=1, tap=1e300), "tap", "must be at most 1000|must be a finite number"),
        (om.Generator("a", p=(0, 10**400)), "p", "both ends must be numbers in MW of at most 1e.30"),
        (om.Generator("a", p=(-1e200, 0)), "p", "both ends must be numbers in MW of at most 1e.30"),
        (om.Storage("a", energy=1, power=10**400), "power", "must be a finite number of at most 1e.30"),
        (om.Storage("a", energy=1, power=math.nan), "power", "must be a finite number of at most 1e.30"),
        (
            om.Generator("a", p=(0, 1), cost=om.Polynomial(1e200)),
            "cost",
            "must be finite numbers of at most 1e.30",
        ),
        (
            om.Generator("a", p=(0, 1), cost=om.PiecewiseLinear([(0, 0), (1, 10**400)])),
            "cost",
            "must be finite numbers",
        ),
        (
            om.Generator("a", p=(0, 1), cost=om.PiecewiseLinear([(0, 0), (1e-320, 1)])),
            "cost",
            "the slopes must be at most",
        ),
    ],
)
def test_a_broken_rule_names_component_field_value_and_rule(
    component: Component, field: str, rule: str
) -> None:
    grid = om.Network()
    with pytest.raises(ComponentError, match=rule) as caught:
        grid.add("it", component)
    assert (caught.value.component, caught.value.field) == ("it", field)
    assert str(caught.value).startswith(f"it: {field} = ")
    assert "it" not in grid


@dataclass(frozen=True)
class Kite(Component):
    """A kind of component from another package, with its own rule."""

    kind: ClassVar[str] = "kite"
    plural: ClassVar[str] = "kites"

    bus: str = at_bus()
    wind: float = number("MW", at_least=0.0)
    height: float = number("", 1.0)
    in_service: bool = flag(True)

    def check(self, name: str) -> None:
        super().check(name)
        if self.height > 9:
            raise ComponentError(name, "height", self.height, "must be at most 9")


BROKEN = [
    (om.Bus(vm=(1.1, 0.9)), "vm"),
    (om.Branch("a", "b", r=0, x=0), "r, x"),
    (om.Branch("a", "a", r=0, x=1), "to_bus"),
    (om.Branch("a", "b", r=math.nan, x=1), "r"),
    (om.Generator("a", p=(5.4, 2.0)), "p"),
    (om.Generator("a", p=(0, 1), cost=om.Polynomial(-1)), "cost"),
    (om.Generator("a", p=(0, 1), cost=om.PiecewiseLinear([(0, 0), (0, 5)])), "cost"),
    (om.Storage("a", energy=1, power=1, initial=2), "initial"),
    (om.Load("a", p=math.inf), "p"),
    (Kite("a", wind=-1), "wind"),
    (Kite("a", wind=1, height=10), "height"),
]


@pytest.mark.parametrize(("component", "field"), BROKEN)
def test_rules_apply_to_components_in_service(component: Component, field: str) -> None:
    grid = om.Network()
    idle = replace(component, in_service=False)
    assert grid.add("it", idle) is grid.it is idle
    with pytest.raises(ComponentError) as caught:
        grid.update("it", in_service=True)
    assert (caught.value.component, caught.value.field) == ("it", field)
    assert grid.it is idle


def test_invalid_data_out_of_service_are_read_from_files() -> None:
    made = om.Generator.from_mapping("it", {"bus": "a", "p": [5, 2], "in_service": False})
    assert made.p == (5, 2)


@pytest.mark.parametrize(
    ("component", "field"),
    [
        (om.Bus(vm=1.0), "vm"),
        (om.Bus(reference="yes"), "reference"),
        (om.Branch("a", "b", r="0.1", x=1), "r"),
        (om.Branch(1, "b", r=0, x=1), "from_bus"),
        (om.Generator("a", p=(0, "1")), "p"),
        (om.Generator("a", p=(0, 1), cost=5), "cost"),
        (om.Generator("a", p=(0, 1), cost=om.Polynomial("1")), "cost"),
        (om.Generator("a", p=(0, 1), cost=om.PiecewiseLinear([(0, 0, 0)])), "cost"),
        (Kite("a", wind=None), "wind"),
    ],
)
def test_types_are_checked_out_of_service(component: Component, field: str) -> None:
    with pytest.raises(ComponentError) as caught:
        om.Network().add("it", replace(component, in_service=False))
    assert (caught.value.component, caught.value.field) == ("it", field)


def test_the_status_must_be_a_flag() -> None:
    with pytest.raises(ComponentError, match="in_service = 0: must be true or false"):
        om.Network().add("it", om.Load("a", p=1, in_service=0))  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["gas\x1b[31m", "gas\n", "\0", "\u202egas"])
def test_names_are_printable(name: str) -> None:
    grid = om.Network()
    for declare in (lambda: om.Network(name), lambda: grid.add(name, om.Bus())):
        with pytest.raises(NetworkError, match="visible characters only") as caught:
            declare()
        assert str(caught.value).isprintable()
    assert len(grid) == 0


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"p": [0, 1]}, "bus = None: required for a generator"),
        ({"bus": "a", "p": [0, 1], "rmap": 1}, "unknown field of a generator; did you mean 'ramp'"),
        ({"bus": "a", "p": [0, 1], "cost": {"c3": 1}}, "must be a Polynomial or PiecewiseLinear"),
        ({"bus": "a", "p": [0, 1], "cost": {"points": [1, 2]}}, "needs at least two points"),
    ],
)
def test_plain_values_are_checked_too(values: dict, message: str) -> None:
    with pytest.raises(ComponentError, match=message):
        om.Generator.from_mapping("it", values)


@pytest.mark.parametrize("base", [-1, 0, 1e-7, 1e10, 1e308, math.inf, math.nan, 10**400, "100", True])
def test_a_network_needs_a_base_of_sensible_size(base: float) -> None:
    with pytest.raises(NetworkError, match=r"base_mva = .*: must be a number from 1e-06 to"):
        om.Network("x", base_mva=base)


numbers = st.one_of(st.none(), st.booleans(), st.floats(), st.integers(-5, 5), st.text(max_size=3))
values = st.one_of(numbers, st.tuples(numbers, numbers), st.lists(numbers, max_size=3))


@given(fields=st.dictionaries(st.sampled_from(sorted(om.Storage.fields())), values))
def test_every_value_is_checked(fields: dict) -> None:
    """Any input gives either a valid component or one error that names the invalid field."""
    try:
        made = om.Storage.from_mapping("it", {"bus": "a", "energy": 1.0, "power": 1.0, **fields})
    except ComponentError as error:
        assert error.field in om.Storage.fields()
        return
    if not made.in_service:
        return
    ready = made.resolved()
    assert 0 <= ready.energy_min <= ready.initial <= ready.energy < math.inf
    assert 0 < ready.charge_efficiency <= 1
    assert 0 < ready.discharge_efficiency <= 1


@given(
    points=st.lists(
        st.tuples(st.integers(-50, 50), st.integers(1, 20)), min_size=2, max_size=6, unique_by=lambda p: p[0]
    ),
    at=st.floats(-60, 60),
)
def test_a_piecewise_linear_cost_is_the_maximum_of_its_segments(
    points: list[tuple[int, int]], at: float
) -> None:
    powers = sorted(p for p, _ in points)
    slopes = sorted(s for _, s in points)[: len(powers) - 1]
    costs = [0.0]
    for slope, left, right in zip(slopes, powers[:-1], powers[1:], strict=True):
        costs.append(costs[-1] + slope * (right - left))
    cost = om.PiecewiseLinear(list(zip(powers, costs, strict=True)))
    cost.check("it", "cost")
    value = max(slope * at + offset for slope, offset in cost.segments)
    inside = min(max(at, powers[0]), powers[-1])
    import numpy as np

    expected = np.interp(inside, powers, costs)
    expected += slopes[0] * min(at - powers[0], 0.0) + slopes[-1] * max(at - powers[-1], 0.0)
    assert value == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("number", [np.int64(5), np.int32(5), np.float32(5), np.float64(5)])
def test_numpy_numbers_are_accepted(number: float) -> None:
    assert om.Network().add("town", om.Load("a", p=number)) == om.Load("a", p=5.0)
