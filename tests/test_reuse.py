"""Nothing leaks: from one problem, run or solve to the next, or from the caller's objects."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest
from conftest import two_bus

import opfmodel as om
from opfmodel.check import check
from opfmodel.errors import IncompatibleError, ModelError, NetworkError, OpfmodelError
from opfmodel.forecasts import Forecast
from opfmodel.model import Device
from opfmodel.network import Component, at_bus, flag, number

PLANTS = (om.PowerFlow, om.Redispatch)


def grid() -> om.Network:
    """Two buses without storage and ramps."""
    made = two_bus()
    made.remove("cell")
    made.update("coal", ramp=None)
    return made


def problem(network: om.Network | None = None, demand: float = 50.0, **options: Any) -> om.MultiStage:
    series = {"town.p": [demand] * 4, "town.q": [0.0] * 4}
    return om.MultiStage(grid() if network is None else network, 2, profiles=series, **options)


# Plants and controllers ---------------------------------------------------------------------------


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("change", [{"demand": 110.0}, {"step": 0.25}])
def test_a_plant_serves_one_problem_after_another(plant: type, change: dict) -> None:
    network = two_bus()
    first, second = problem(network), problem(network, **change)
    reused = plant()
    om.simulate(first, reused, 2)
    run, fresh = om.simulate(second, reused, 2), om.simulate(second, plant(), 2)
    assert run.data["pg"].values == pytest.approx(fresh.data["pg"].values, abs=1e-6)
    report = check(network, run.data, second.profiles)
    assert report.violations["active balance"].physical < 1e-4
    assert report.violations["storage dynamics"].physical < 1e-4


def test_a_controller_starts_cold_in_every_run() -> None:
    controller = om.Controller(problem())
    for _ in range(2):
        om.simulate(controller, steps=1)
        assert [attempt.start for attempt in controller.attempts] == ["cold"]


@pytest.mark.parametrize("plant", PLANTS)
def test_the_first_step_is_ramped_from_the_initial_state(plant: type) -> None:
    class Low(Forecast):
        """Less than there will be."""

        def expected(self, actual, time, stages):
            return om.Profiles({key: np.full(stages, 50.0) for key in actual})

    network = grid()
    network.update("coal", ramp=5)
    series = {"town.p": [90.0] * 4}
    controller = om.Controller(om.MultiStage(network, 2, profiles=series), Low())
    run = om.simulate(controller, plant(), 1, initial={"pg": [50.0], "qg": [30.0]})
    generated = float(run.data["pg"][0, 0])
    exceeded = float(run.data["ramp_excess"][0, 0])
    assert exceeded == pytest.approx(max(0.0, generated - 55.0), abs=1e-4)
    assert (generated > 85) == (plant is om.PowerFlow)
    assert run.previous_pg == {"coal": 50.0}
    found = check(network, run.data, series, previous_pg=run.previous_pg).violations["ramp"]
    assert found.physical == pytest.approx(exceeded, abs=1e-4)


# Networks, series and problems --------------------------------------------------------------------


def test_a_problem_keeps_the_network_that_it_was_given() -> None:
    network = grid()
    made = om.MultiStage(network)
    network.update("town", p=20.0)
    network.add("mill", om.Load("south", p=10.0))
    run = om.simulate(made, om.PowerFlow(), 1)
    assert float(run.data["pd"].sum()) == 90.0
    assert check(made.network, run.data).max_violation < 1e-6


def test_a_copy_of_a_network_is_its_own() -> None:
    network = grid()
    for twin in (copy.copy(network), network.copy()):
        twin.update("town", p=1.0)
        assert network.town.p == 90.0
        assert om.MultiStage(twin).arrays.load.p[0, 0] * 100 == pytest.approx(1.0)


def test_series_are_copies_that_nobody_changes() -> None:
    values = np.array([50.0, 50.0])
    made = om.MultiStage(grid(), profiles={"town.p": values})
    values[:] = np.nan
    assert made.solve(1).optimal
    with pytest.raises(ValueError, match="read-only"):
        made.profiles["town.p"][0] = 0.0


@pytest.mark.parametrize(
    ("name", "value"), [("objective", om.Economic()), ("horizon", 3), ("solver", "osqp")]
)
def test_a_compiled_problem_does_not_change(name: str, value: object) -> None:
    made = problem()
    setattr(made, name, getattr(made, name))  # until it is compiled
    made.compile()
    with pytest.raises(ModelError, match=f"{name}: .* already compiled"):
        setattr(made, name, value)


def test_a_kind_belongs_to_one_class() -> None:
    @dataclass(frozen=True)
    class Wind(om.Generator):
        """A generator by another name."""

    with pytest.raises(NetworkError, match=r"extra = .*Wind.*'generator' is that of Generator"):
        grid().extra = Wind("north", p=(0, 10))


# What is expected ---------------------------------------------------------------------------------


@pytest.mark.parametrize("key", [("generator", "c1"), ("branch", "rating"), ("loads", "p")])
def test_only_what_has_a_series_can_be_expected(key: tuple[str, str]) -> None:
    with pytest.raises(ModelError, match=rf"expected: {key[0]}\.{key[1]}: has no time series.*load\.p"):
        problem().solve(expected={key: np.full((1, 2), 0.3)})


@pytest.mark.parametrize(
    "series", [{}, {"town.p": [50, 50]}, {"town.p": [50, 50], "town.q": [0, 0], "coal.c1": [9, 9]}]
)
def test_a_forecast_covers_the_series_that_there_are(series: dict) -> None:
    class Partial(Forecast):
        """Some series, or others."""

        def expected(self, actual, time, stages):
            return om.Profiles(series)

    with pytest.raises(ModelError, match=r"forecast Partial at step 0: .*(town\.q|coal\.c1)"):
        om.Controller(problem(), Partial()).plan(0, None)


# Names and units ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Heat(Component):
    """A heat pump."""

    kind: ClassVar[str] = "heat"
    plural: ClassVar[str] = "heats"

    bus: str = at_bus()
    p: float = number("MW")
    in_service: bool = flag(True)


def heated(*declared: Any) -> om.MultiStage:
    class HeatDevice(Device):
        component = Heat

        def declare(self, model, table):
            for declare in declared:
                declare(model, table)

    network = grid()
    network.pump = Heat("south", p=5.0)
    return om.MultiStage(network, devices=[HeatDevice()])


@pytest.mark.parametrize("name", ["pd", "qd", "lmp", "vm"])
def test_names_of_results_are_unique(name: str) -> None:
    made = heated(
        lambda m, t: m.variable("heat", "warmth" if name == "lmp" else name, 0.0, "p", unit="MW"),
        lambda m, t: (
            m.price("heat", name, lambda s, n: np.zeros((1, 1)), "$/MWh", "") if name == "lmp" else None
        ),
    )
    with pytest.raises(IncompatibleError, match=f"'{name}'"):
        made.compile()


def test_a_field_has_its_own_unit_whatever_else_has_its_name() -> None:
    made = heated(lambda m, t: m.variable("heat", "p", 0.0, 1.0, unit=""))
    seen: dict[str, Any] = {}

    def rule(stage: Any) -> Any:
        seen["p"], seen["slope"] = stage.load.p, stage.generator.segment_slope
        return om.total(stage.generator.pg) <= 190

    made.network.update("coal", cost=om.PiecewiseLinear([(0, 0), (100, 1000), (200, 4000)]))
    again = om.MultiStage(made.network, devices=made.devices)
    again.constrain("rule", rule)
    again.compile()
    assert seen["p"].tolist() == [[90.0]]
    assert seen["slope"].ravel() == pytest.approx([10.0, 30.0])


def test_an_objective_sees_of_a_plan_what_it_saw_of_the_problem() -> None:
    class Curious(om.Economic):
        """Pays for voltages where it finds any."""

        def stage_cost(self, stage):
            cost = super().stage_cost(stage)
            return cost + 1e4 * om.total(stage.bus.vm) if stage.has("vm") else cost

    plan = om.MultiStage(grid(), formulation="soc", objective=Curious()).solve()
    assert plan.objective == pytest.approx(plan.solution.objective, rel=1e-6)


# Lengths ------------------------------------------------------------------------------------------


def test_everything_that_changes_in_time_is_long_enough_before_the_first_step() -> None:
    tracking = om.SetpointTracking(om.Setpoints({"coal.pg": [50.0] * 3}))
    limited = problem()
    limited.constrain("cap", lambda s: om.total(s.generator.pg), at_most=[150.0] * 3)
    for made, what in ((problem(objective=tracking), "SetpointTracking"), (limited, "constraint 'cap'")):
        with pytest.raises(ModelError, match=f"{what} of 4 values; the shortest has 3"):
            om.simulate(made, steps=3)
    with pytest.raises(ModelError, match="series of SetpointTracking of 4 values"):
        om.simulate(om.MultiStage(grid()), steps=4, objective=tracking)
    run = om.simulate(problem(), steps=3, objective=tracking)  # it is measured with series of its own
    assert run.cost == pytest.approx(0.0, abs=1e-2)


# Misuse -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("misuse", "message"),
    [
        (lambda: problem(elastic=True), "elastic = True"),
        (lambda: problem(end="cyclic"), "end = 'cyclic'"),
        (lambda: problem(devices=[3]), "devices: 3"),
        (lambda: om.MultiStage("grid"), "network = 'grid'"),
        (lambda: problem().solve(previous=3), "previous = 3"),
        (lambda: om.simulate(problem(), "nominal"), "plant = 'nominal'"),
        (lambda: om.Controller(3), "problem = 3"),
        (lambda: om.PowerFlow({"coal": "1"}), "participation: coal = '1'"),
        (lambda: om.Redispatch(price="1"), "price = '1'"),
        (lambda: om.Elastic(limit=True), "limit = True"),
        (lambda: problem(generator_delay=True), "generator_delay = True"),
        (lambda: problem().solve(initial={"pg": [np.inf]}), "initial pg"),
        (lambda: check(grid(), problem().solve().data.drop_vars("pg")), "no such quantity: 'pg'"),
        (
            lambda: check(grid(), problem(two_bus()).solve().data.sel(bus=["north"])),
            "has no values of 'south'",
        ),
    ],
)
def test_misuse_is_an_error_that_names_the_argument(misuse: Any, message: str) -> None:
    with pytest.raises(OpfmodelError, match=message):
        misuse()


@pytest.mark.parametrize("side", ["at_least", "at_most"])
def test_a_limit_is_not_infinite_on_its_own_side(side: str) -> None:
    wrong = np.inf if side == "at_least" else -np.inf
    with pytest.raises(ModelError, match=f"{side} = "):
        problem().constrain("own", lambda s: om.total(s.generator.pg), **{side: [1.0, wrong]})


@pytest.mark.parametrize("cost", [0.0, np.array([1.0]), "cheap"])
def test_a_cost_is_a_quantity(cost: object) -> None:
    class Odd(om.Objective):
        """Not a cost."""

        def stage_cost(self, stage):
            return cost

    with pytest.raises(ModelError, match="objective Odd: stage_cost = "):
        problem(objective=Odd()).compile()


def test_numbers_of_numpy_are_numbers() -> None:
    assert om.Elastic(limit=np.int64(500)).limit == 500
    assert om.End(minimum=np.float32(0.5)).minimum == 0.5
    assert om.VoltageDeviation(weight=np.int64(5)).weight == 5
    assert len(om.simulate(problem(), steps=np.int64(2)).steps) == 2
