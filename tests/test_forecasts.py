"""Forecasts: their values, their errors, and their use in closed loops."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import two_bus
from hypothesis import given, settings
from hypothesis import strategies as st

import opfmodel as om
from opfmodel import plugins
from opfmodel.check import check
from opfmodel.data.calendar import Calendar
from opfmodel.data.series import SeriesKey
from opfmodel.errors import ModelError, ProfileError, ScenarioError
from opfmodel.forecasts import File, Forecast, Noisy, Perfect, Persistence
from opfmodel.plugins import registry
from opfmodel.testing import ContractError, check_forecast

ACTUAL = om.Profiles.of(
    {"town.p": np.arange(10.0, 70.0), "town.q": np.arange(1.0, 7.0, 0.1), "coal.c1": np.full(60, 15.0)}
)
TOWN = ("town", "p")


def series(**values: list[float]) -> om.Profiles:
    return om.Profiles.of({key.replace("_", "."): value for key, value in values.items()})


def test_perfect() -> None:
    assert Perfect().expected(ACTUAL, 4, 3).series[TOWN].tolist() == [14, 15, 16]


@pytest.mark.parametrize(
    ("period", "time", "expected"),
    [
        (1, 5, [14, 14, 14, 14]),
        (1, 0, [10, 10, 10, 10]),
        (3, 7, [14, 15, 16, 14]),
        (3, 1, [11, 12, 10, 11]),
    ],
)
def test_persistence(period: int, time: int, expected: list[float]) -> None:
    seen = Persistence(period).expected(ACTUAL, time, 4)
    assert seen.series[TOWN].tolist() == expected
    assert seen.series["coal", "c1"].tolist() == [15] * 4


@given(period=st.integers(1, 30), time=st.integers(0, 40), stages=st.integers(1, 20))
def test_persistence_does_not_know_the_future(period: int, time: int, stages: int) -> None:
    seen = Persistence(period).expected(ACTUAL, time, stages).series[TOWN]
    known = max(time, period)  # until the first period is over, its own values stand in
    assert (seen < 10 + known).all()


@settings(max_examples=30)
@given(seed=st.integers(0, 2**40), time=st.integers(0, 40), deviation=st.floats(0, 0.5))
def test_noise_keeps_power_factors_signs_and_prices(seed: int, time: int, deviation: float) -> None:
    seen = Noisy(deviation, seed).expected(ACTUAL, time, 12).series
    part = slice(time, time + 12)
    factor = seen[TOWN] / ACTUAL.series[TOWN][part]
    assert (factor >= 0).all()
    assert seen["town", "q"] == pytest.approx(factor * ACTUAL.series["town", "q"][part])
    assert (seen["coal", "c1"] == 15).all()


def relative(noisy: Noisy, component: str, time: int, stages: int) -> np.ndarray:
    """The relative errors of a forecast."""
    known = om.Profiles({f"{component}.p": np.ones(time + stages)})
    return noisy.expected(known, time, stages)[f"{component}.p"] - 1.0


def test_noise_depends_only_on_seed_component_and_step() -> None:
    noisy = Noisy(0.1, seed=3)
    late, early = (noisy.expected(ACTUAL, time, 5).series[TOWN] for time in (7, 2))
    again = Noisy(0.1, seed=3)
    assert (again.expected(ACTUAL, 2, 5).series[TOWN] == early).all()
    assert (again.expected(ACTUAL, 7, 5).series[TOWN] == late).all()
    assert (again.expected(ACTUAL, 7, 9).series[TOWN][:5] == late).all()
    errors = [relative(Noisy(0.1, 3), "town", 7, 5), relative(Noisy(0.1, 4), "town", 7, 5)]
    errors += [relative(Noisy(0.1, 3), "mill", 7, 5), relative(Noisy(0.1, 3), "town", 8, 5)]
    assert len({tuple(error) for error in errors}) == 4


def test_the_error_grows_with_the_lead_time() -> None:
    noisy = Noisy(0.1, seed=1, correlation=0.8)
    errors = np.array([relative(noisy, "town", time, 12) for time in range(4000)])
    ahead = np.arange(1, 13)
    expected = 0.1 * np.sqrt((1 - 0.8 ** (2 * ahead)) / (1 - 0.8**2))
    assert errors.std(axis=0) == pytest.approx(expected, rel=0.05)
    assert errors.mean(axis=0) == pytest.approx(np.zeros(12), abs=0.01)
    assert np.corrcoef(errors[:, 10], errors[:, 11])[0, 1] == pytest.approx(0.8, abs=0.03)
    assert abs(np.corrcoef(errors[:-1, 0], errors[1:, 0])[0, 1]) < 0.05


def write(folder: Path, text: str) -> Path:
    path = folder / "forecast.csv"
    path.write_text(text)
    return path


def test_a_file_without_issues(tmp_path: Path) -> None:
    forecast = File(write(tmp_path, "# made by hand\nhour,town.p\n0,1\n1,2\n2,3\n3,4\n"))
    seen = forecast.expected(ACTUAL, 1, 3).series
    assert seen[TOWN].tolist() == [2, 3, 4]
    assert seen["town", "q"] == pytest.approx([1.1, 1.2, 1.3])


def test_the_latest_issue_of_a_file_applies(tmp_path: Path) -> None:
    rows = "issued,town.p\n0,1\n0,2\n0,3\n0,4\n2,30\n2,40\n2,50\n"
    forecast = File(write(tmp_path, rows))
    assert forecast.expected(ACTUAL, 1, 2).series[TOWN].tolist() == [2, 3]
    assert forecast.expected(ACTUAL, 2, 2).series[TOWN].tolist() == [30, 40]
    assert forecast.expected(ACTUAL, 3, 2).series[TOWN].tolist() == [40, 50]


ENSEMBLE = "issued,member,town.p\n0,1,1\n0,1,2\n0,2,5\n0,2,8\n1,2,9\n1,1,3\n1,2,7\n1,1,5\n1,7,3\n1,7,0\n"


def test_an_ensemble_is_its_mean_and_its_members_are_the_paths(tmp_path: Path) -> None:
    forecast = File(write(tmp_path, ENSEMBLE))
    assert forecast.expected(ACTUAL, 0, 2).series[TOWN].tolist() == [3, 5]
    issued = forecast.expected(ACTUAL, 1, 2)
    assert issued.series[TOWN].tolist() == [5, 4]
    assert issued.series["town", "q"].tolist() == ACTUAL.series["town", "q"][1:3].tolist()
    members = [[3, 5], [9, 7], [3, 0]]
    assert forecast.paths(issued, 1, 3, seed=0)[TOWN].tolist() == members
    pairs = {tuple(map(tuple, forecast.paths(issued, 1, 2, seed)[TOWN])) for seed in range(30)}
    assert pairs == {tuple(map(tuple, np.delete(members, left, 0))) for left in range(3)}


def test_members_at_local_times(tmp_path: Path) -> None:
    calendar = Calendar(np.datetime64("2024-04-30T22:00"), 1.0, "Europe/Berlin")
    known = om.Profiles({"town.p": np.arange(6.0)}, calendar)
    rows = [f"2024-05-01T0{hour}:00,{member},{10 * member + hour}" for member in (1, 2) for hour in range(6)]
    forecast = File(write(tmp_path, "\n".join(["time,member,town.p", *rows])))
    assert forecast.expected(known, 2, 3).series[TOWN].tolist() == [17, 18, 19]
    paths = forecast.paths(forecast.expected(known, 2, 3), 2, 2, 0, calendar)
    assert paths[TOWN].tolist() == [[12, 13, 14], [22, 23, 24]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("town.p\n1\n2\n", "issued at step 0 has no members .* column 'member'"),
        (ENSEMBLE, "issued at step 1 has 3 members, fewer than the 4 paths to draw"),
    ],
)
def test_an_ensemble_has_no_more_paths_than_members(tmp_path: Path, text: str, message: str) -> None:
    forecast = File(write(tmp_path, text))
    with pytest.raises(ProfileError, match=message):
        forecast.paths(forecast.expected(ACTUAL, 1, 1), 1, 4, seed=0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file is empty"),
        ("hour\n1\n", "no column is named 'component.field'"),
        ("hour,town.p\n", "has no row"),
        ("hour,town.p\n0,1\n1,many\n", "line 3, column 'town.p': 'many' is not a number"),
        ("hour,town.p\n0\n", "line 2, column 'town.p': the value is missing"),
        ("town.p\n# a comment\n1\nmany\n", "line 4, column 'town.p': 'many' is not a number"),
        ("town.p\n1\ninf\n", "line 3, column 'town.p': 'inf' is not a finite number"),
        (f"town.p\n{200_000 * '1'}\n", "line 2: not CSV: field larger than"),
        ("issued,town.p\n0,1\n0.5,2\n", "line 3, column 'issued': 0.5 is not a step"),
        ("member,town.p\n0,1\n0.5,2\n", "line 3, column 'member': 0.5 is not a member"),
        ("member,town.p\n0,1\n0,2\n1,2\n", "line 4, column 'member': the members .* the same steps"),
        ("issued,town.p\n3,1\n", "issued by step 1; .* 3$"),
        ("hour,town.p\n0,1\n1,2\n", "the forecast issued at step 0 has 2 rows; steps 1 to 3 need 4"),
        (
            "hour,twon.p\n" + 9 * "0,1\n",
            "column 'twon.p': the profiles have no such series; did you mean 'town.p'",
        ),
    ],
)
def test_errors_in_a_file(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ProfileError, match=message):
        File(write(tmp_path, text)).expected(ACTUAL, 1, 3)


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(ProfileError, match=r"none\.csv: no such file"):
        File(tmp_path / "none.csv")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Persistence(0), "period = 0"),
        (lambda: Noisy(-0.1, 1), "deviation = -0.1"),
        (lambda: Noisy(0.1, 1, correlation=1.0), "correlation = 1.0"),
        (lambda: Noisy(0.1, -1), "seed = -1"),
    ],
)
def test_options_out_of_range(make: object, message: str) -> None:
    with pytest.raises(ProfileError, match=message):
        make()  # type: ignore[operator]


def problem(**options: object) -> om.MultiStage:
    grid = two_bus()
    grid.update("coal", ramp=200)
    demand = {"town.p": [60, 80, 100, 70, 60, 80, 90, 60], "town.q": [20] * 8}
    return om.MultiStage(grid, 3, profiles=demand, **options)  # type: ignore[arg-type]


def test_plans_use_the_forecast_and_plants_the_actual_series() -> None:
    made = problem()
    controller = om.Controller(made, Persistence())
    plan = controller.plan(3, None)
    assert plan.data["pd"].sel(bus="south").values == pytest.approx([100, 100, 100])
    run = om.simulate(om.Controller(made, Persistence()), om.Redispatch(), 5)
    assert run.data["pd"].sel(bus="south").values == pytest.approx([60, 80, 100, 70, 60])
    assert (
        check(made.network, run.data, {"town.p": [60, 80, 100, 70, 60], "town.q": [20] * 5}).max_violation
        < 1e-6
    )
    changed = run.data["pg_redispatch"].values[:, 0] + run.data["ps_redispatch"].values[:, 0]
    assert changed == pytest.approx([0, 20, 20, 30, 10], abs=2)


def test_the_default_forecast_is_perfect() -> None:
    runs = [om.simulate(om.Controller(problem(), f), steps=3) for f in (None, Perfect())]
    assert runs[0].cost == runs[1].cost
    plans = [om.Controller(problem(), f).plan(0, None).objective for f in (None, Noisy(0.0, 1))]
    assert plans[0] == plans[1]


def test_an_imperfect_forecast_needs_a_plant_that_can_respond(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"Noisy with NominalPlant: .* power-flow or redispatch"):
        om.simulate(om.Controller(problem(), Noisy(0.1, 1)))
    with pytest.raises(ScenarioError, match=r"scenario.yaml:8:1: forecast: .* power-flow or redispatch"):
        om.load_scenario(written(tmp_path, "forecast: persistence"))


def test_a_run_is_reproducible() -> None:
    costs = {
        om.simulate(om.Controller(problem(), Noisy(0.05, seed=7)), om.Redispatch(), 4).cost for _ in range(2)
    }
    assert len(costs) == 1


def test_available_power_is_forecast_but_never_below_the_minimum_of_a_unit() -> None:
    class Calm(Forecast):
        def expected(self, actual: om.Profiles, time: int, stages: int) -> om.Profiles:
            return om.Profiles({key: np.zeros(stages) if key[1] == "p_max" else v[time : time + stages]
                                for key, v in actual.series.items()})  # fmt: skip

    grid = two_bus()
    grid.wind = om.Generator("south", p=(5, 40), q=(0, 0))
    made = om.MultiStage(grid, 2, profiles={"wind.p_max": [30, 30, 30], "town.p": [90, 90, 90]})
    plan = om.Controller(made, Calm()).plan(0, None)
    assert plan.data["pg"].sel(generator="wind").values == pytest.approx([5, 5], abs=1e-4)


MINIMAL = """
network:
  buses: {a: {}}
  generators: {g: {bus: a, p: [0, 99]}}
  loads: {town: {bus: a, p: 10}}
profiles: [{scale: {factor: 1.0}}]
time: {steps: 3}
"""


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "scenario.yaml"
    path.write_text(MINIMAL + text)
    return path


def scenario(tmp_path: Path, text: str) -> om.Scenario:
    return om.load_scenario(written(tmp_path, text + "\nplant: {mode: redispatch}\n"))


def test_a_scenario_selects_its_forecast(tmp_path: Path) -> None:
    assert isinstance(scenario(tmp_path, "").forecast, Perfect)
    assert isinstance(scenario(tmp_path, "forecast: persistence").forecast, Persistence)
    noisy = scenario(tmp_path, "forecast: {noisy: {deviation: 0.1, seed: 4, fields: [p]}}").forecast
    assert isinstance(noisy, Noisy)
    assert (noisy.deviation, noisy.seed, noisy.correlation, noisy.fields) == (0.1, 4, 0.9, ("p",))
    write(tmp_path, "hour,town.p\n0,11\n1,12\n2,13\n")
    made = scenario(tmp_path, "forecast: {file: {file: forecast.csv}}")
    plan = om.Controller(made.problem, made.forecast).plan(0, None)
    assert plan.data["pg"].values[:, 0] == pytest.approx([11], abs=1e-3)
    run = made.simulate()
    assert run.data["pg_redispatch"].values[:, 0] == pytest.approx([1, 2, 3], abs=1e-2)
    assert run.data["pd"].values[:, 0] == pytest.approx([10, 10, 10])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("forecast: nosy", r"scenario.yaml:8:1: forecast: there is no forecast 'nosy'; did you mean 'noisy'"),
        ("forecast: {noisy: {deviation: 0.1}}", "forecast 'noisy' requires the option 'seed'"),
        (
            "forecast: {noisy: {deviaton: 0.1, seed: 1}}",
            r":8:20: forecast.noisy.deviaton: .*did you mean 'deviation'",
        ),
        ("forecast: {noisy: {deviation: -1, seed: 1}}", r":8:12: forecast.noisy: noisy: deviation = -1"),
        ("forecast: {file: {file: none.csv}}", r":8:12: forecast.file: .*none.csv: no such file"),
    ],
)
def test_errors_in_a_scenario(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        scenario(tmp_path, text)


# The contract ---------------------------------------------------------------------------------------

OPTIONS = {"noisy": {"deviation": 0.1, "seed": 3}, "persistence": {"period": 2}}


@pytest.mark.parametrize("name", plugins.plugins("forecast"))
def test_a_forecast_satisfies_its_contract(name: str, tmp_path: Path) -> None:
    rows = "".join(f"{issued},{n}\n" for issued in (0, 2) for n in range(5))
    options = {"file": {"file": write(tmp_path, "issued,town.p\n" + rows)}, **OPTIONS}.get(name, {})
    check_forecast(plugins.make("forecast", name, options))


def planted(expected: object) -> Forecast:
    return type("Planted", (Forecast,), {"__doc__": "Planted.", "expected": expected, "calls": 0})()


def shortened(self, actual, time, stages):
    return Perfect().expected(actual, time, 1)


def forgetful(self, actual, time, stages):
    return om.Profiles({("town", "p"): np.ones(stages)})


def undefined(self, actual, time, stages):
    return om.Profiles({key: np.full(stages, np.nan) for key in actual.series})


def moody(self, actual, time, stages):
    self.calls += 1
    return om.Profiles({key: np.full(stages, float(self.calls)) for key in actual.series})


def hurried(self, actual, time, stages):
    return om.Profiles({key: np.full(stages, float(stages)) for key in actual.series})


def greedy(self, actual, time, stages):
    for values in actual.series.values():
        np.multiply(values, 2.0, out=values)
    return Perfect().expected(actual, time, stages)


@pytest.mark.parametrize(
    ("expected", "message"),
    [
        (shortened, "one value per stage"),
        (forgetful, "every actual series and no other"),
        (undefined, "nan: must be a number"),
        (moody, "the same values when called again in another order"),
        (hurried, "the same values for any number of stages"),
        (greedy, "forecasts every step.*read-only"),
    ],
)
def test_a_forecast_that_breaks_a_rule_is_caught(expected: object, message: str) -> None:
    with pytest.raises(ContractError, match=message):
        check_forecast(planted(expected))


@pytest.mark.parametrize(
    ("drawn", "message"),
    [
        (lambda _self, issued, *_: {key: np.ones((2, 2)) for key in issued}, "one value per path and step"),
        (lambda *_: {SeriesKey("moon", "p"): np.ones((2, 3))}, "paths of forecast series alone"),
        (lambda _self, issued, *_: {key: np.full((2, 3), np.inf) for key in issued}, "draws finite values"),
        (lambda _self, issued, *_: {k: np.random.rand(2, 3) for k in issued}, "same paths when called again"),
    ],
)
def test_paths_that_break_a_rule_are_caught(drawn: object, message: str) -> None:
    forecast = planted(Perfect.expected)
    type(forecast).paths = drawn
    with pytest.raises(ContractError, match=message):
        check_forecast(forecast)


def test_an_inherited_constructor_has_the_types_of_its_options(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Mine(File):
        """Forecasts from a file of mine."""

    monkeypatch.setattr(registry, "load", lambda sort, name: Mine)
    path = write(tmp_path, "town.p\n1\n")
    made = plugins.make("forecast", "mine", {"file": path.name}, {Path: lambda name: tmp_path / name})
    assert made.file == path


@pytest.mark.parametrize(
    "make",
    [lambda fields: Noisy(0.05, 3, fields=fields), lambda fields: Persistence(fields=fields)],
    ids=["noisy", "persistence"],
)
def test_a_field_that_no_component_has_is_refused(make: Callable[[tuple[str, ...]], object]) -> None:
    with pytest.raises(ProfileError, match=r"fields: 'pmax': .* did you mean 'p_max'"):
        make(("p", "pmax"))
    with pytest.raises(ProfileError, match="fields: 'charge_efficiency'"):
        make(("charge_efficiency",))
    make(("p", "p_min", "c1", "rating"))
