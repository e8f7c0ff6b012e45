"""Time series: values must be finite, whatever their source."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import two_bus

import opfmodel as om
from opfmodel.errors import ModelError, ProfileError, ScenarioError
from opfmodel.network.components import BUILT_IN

SCENARIO = """
network:
  buses: {a: {reference: true}, b: {}}
  branches: {line: {from_bus: a, to_bus: b, r: 0, x: 0.1, rating: 100}}
  generators: {g: {bus: a, p: [0, 90], ramp: 30, cost: {c1: 10}}}
  loads: {l: {bus: b, p: 5, q: 1}}
time: {steps: 3}
"""
# fields for which infinity means "no limit"
NO_LIMIT = {"line.rating": np.inf, "g.ramp": np.inf, "g.q_max": np.inf, "g.q_min": -np.inf}


def load(folder: Path, text: str) -> om.Scenario:
    path = folder / "s.yaml"
    path.write_text(SCENARIO + text)
    return om.load_scenario(path)


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan, 1e31])
@pytest.mark.parametrize(
    "series", ["town.p", "town.q", "coal.p_max", "coal.c1", "coal.c2", "cell.energy", "north.vm_max"]
)
def test_series_in_python_are_finite(series: str, value: float) -> None:
    with pytest.raises(ProfileError, match=rf"'{series}': step 1") as caught:
        om.MultiStage(two_bus(), 2, profiles={series: [90, value, 90]})
    assert (str(caught.value.series), caught.value.step) == (series, 1)


def test_infinity_means_no_limit_where_accepted() -> None:
    for series, value in NO_LIMIT.items():
        grid = two_bus()
        kind = {"line": "tie", "g": "coal"}[series.partition(".")[0]]
        name = f"{kind}.{series.partition('.')[2]}"
        om.MultiStage(grid, 2, profiles={name: [-80 if "min" in name else 80, value]})
        with pytest.raises(ProfileError, match=f"'{name}': step 1: .* or {value:g} for no limit"):
            om.MultiStage(grid, 2, profiles={name: [0, -value]})


def test_fields_that_may_be_unlimited() -> None:
    found = {
        f"{kind.kind}.{key}{end}"
        for kind in BUILT_IN
        for key in kind.fields()
        for end in ("", "_min", "_max")
        if kind.unlimited(key + end) is not None
    }
    assert found == {
        "branch.rating",
        "storage.rating",
        "renewable.rating",
        "generator.ramp",
        "generator.q_min",
        "generator.q_max",
    }


@pytest.mark.parametrize("entry", ["inf", "-inf", "1e400", "1e31"])
@pytest.mark.parametrize("heading", ["l.p", "l.q", "g.p_max", "g.c1"])
def test_series_of_a_table_are_finite(tmp_path: Path, heading: str, entry: str) -> None:
    (tmp_path / "t.csv").write_text(f"# MW\nhour,{heading}\n0,1\n1,{entry}\n2,1\n")
    message = rf"s.yaml:8:13: profiles.0.table: .*t.csv: line 4, column '{heading}': .*step 1: .*finite"
    with pytest.raises(ScenarioError, match=message):
        load(tmp_path, "profiles: [{table: {file: t.csv}}]\n")


def test_a_table_may_lift_limits(tmp_path: Path) -> None:
    rows = "\n".join(",".join(str(v) for v in NO_LIMIT.values()) for _ in range(2))
    (tmp_path / "t.csv").write_text(f"{','.join(NO_LIMIT)}\n80,20,50,-50\n{rows}\n")
    scenario = load(tmp_path, "profiles: [{table: {file: t.csv}}]\n")
    assert scenario.profiles.series["line", "rating"].tolist() == [80, np.inf, np.inf]
    assert scenario.simulate().status == "done"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("profiles: [{scale: {factor: .inf}}]", ":8:21: profiles.0.scale.factor: .*finite"),
        ("profiles: [{step: {loads: [l], first: 0, last: 1, add: .inf}}]", ":8:51: profiles.0.step.add: .*finite"),
        ("profiles: [{step: {loads: [l], first: 0, last: 1, factor: -.inf}}]", ":8:51: profiles.0.step.factor: .*finite"),
        ("profiles: [{noise: {deviation: .inf, correlation: 0, seed: 1}}]", ":8:21: profiles.0.noise.deviation: .*finite"),
        ("profiles: [{noise: {deviation: 0.1, correlation: .nan, seed: 1}}]", ":8:37: profiles.0.noise.correlation: .*finite"),
        ("profiles: [{power-factor: {value: .nan}}]", ":8:28: profiles.0.power-factor.value: .*finite"),
        ("profiles: [{scale: {factor: 1e29}}, {scale: {factor: 1e29}}]", ":8:38: profiles.1.scale: .*step 0: 5e.58.*finite"),
        ("profiles: [{shape: {file: t.csv, column: c}}]", ":8:13: profiles.0.shape: .*t.csv: line 3, column 'c': 'inf' is not a finite"),
        ("constraints: {c: {terms: {g.pg: 1}, at_most: {file: t.csv, column: c}}}", ":8:37: .*t.csv: line 3, column 'c': 'inf' is not a finite"),
        ("constraints: {c: {terms: {g.pg: .inf}, at_most: 1}}", ":8:27: .*finite number"),
        ("constraints: {c: {terms: {g.pg: 1}, at_most: [1, .inf, 1]}}", ":8:50: .*finite number"),
        ("forecast: {file: {file: f.csv}}\nplant: {mode: redispatch}", ":8:12: .*f.csv: line 3, column 'l.p': 'inf' is not a finite"),
        ("forecast: {noisy: {deviation: .inf, seed: 1}}\nplant: {mode: redispatch}", ":8:20: forecast.noisy.deviation: .*finite"),
        ("controller: {objective: {setpoint-tracking: {setpoints: {file: f.csv}}}}", ":8:46: .*f.csv: line 3, column 'l.p': 'inf' is not a finite"),
        ("controller: {objective: {setpoint-tracking: {setpoints: {g.pg: .inf}}}}", ":8:58: .*'g.pg': step 0: inf"),
        ("controller: {objective: {setpoint-tracking: {setpoints: {g.pg: 1}, state_weight: .inf}}}", ":8:68: .*state_weight: .*finite"),
        ("cost: {linear-quadratic: {state: .nan}}", ":8:27: .*nan: must be a finite"),
        ("published: {source: x, J_e: .inf}", ":8:24: published.J_e: inf: .*finite"),
        ("plant: {mode: power-flow, participation: {g: .inf}}", ":8:43: plant.participation.g: .*inf: .*finite"),
    ],
)  # fmt: skip
def test_non_finite_values_are_reported_with_their_location(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "t.csv").write_text("c\n1\ninf\n1\n")
    (tmp_path / "f.csv").write_text("l.p\n1\ninf\n1\n")
    with pytest.raises(ScenarioError, match=f"s.yaml{message}"):
        load(tmp_path, text + "\n")


def test_a_forecast_of_infinite_demand_is_refused() -> None:
    class Wild(om.Forecast):
        """Expects infinite demand."""

        def expected(self, actual: om.Profiles, time: int, stages: int) -> om.Profiles:
            return om.Profiles({("town", "p"): np.array([90.0, np.inf])})

    problem = om.MultiStage(two_bus(), 2, profiles={"town.p": [90.0] * 3})
    with pytest.raises(ModelError, match=r"forecast Wild.*'town.p': step 1: inf"):
        om.Controller(problem, Wild()).plan(0, None)
