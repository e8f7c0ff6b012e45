"""What ``opfmodel validate`` finds without a solve."""

from __future__ import annotations

from pathlib import Path

import pytest
from conftest import SCENARIOS

import opfmodel as om
from opfmodel.cli.inspect import validate
from opfmodel.errors import OpfmodelError, ScenarioError
from opfmodel.plan import Plan

GRID = """\
network:
  buses: {a: {reference: true}, b: {}}
  branches: {line: {from_bus: a, to_bus: b, r: 0.01, x: 0.1}}
  generators: {g: {bus: a, p: [0, 100], ramp: 50, cost: {c1: 10}}}
  storages: {cell: {bus: b, energy: 20, power: 5}}
  loads: {town: {bus: b, p: 50, q: 10}}
time: {steps: 4}
plant: redispatch
"""
SERIES = "profiles: [{table: {file: series.csv}}]\n"


def written(tmp_path: Path, text: str) -> Path:
    """Write a scenario and its series."""
    path = tmp_path / "scenario.yaml"
    path.write_text(GRID + text)
    (tmp_path / "series.csv").write_text("town.p\n" + 6 * "50\n")
    return path


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("controller: {solver: clarabel}\n", r":9:14: controller.solver: 'clarabel' solves at most"),
        ("controller: {solver: {name: ipopt, options: {nosuch: 1}}}\n", r":9:14: controller.solver: .*nosuch"),
        ("controller: {formulation: dc, objective: voltage-deviation}\n", r":9:31: controller.objective: .* needs vm"),
        ("cost: voltage-deviation\ncontroller: {formulation: dc}\n", r":9:1: cost: .* needs vm"),
        ("constraints:\n  pg_ramp: {terms: {g.pg: 1}, at_most: 90}\n", "'pg_ramp"),
        ("variants:\n  v: {controller: {solver: clarabel}}\n", r":10:20: controller.solver: 'clarabel' .*\(variant 'v'\)"),
        ("controller: {objective: {setpoint-tracking: {setpoints: {g.pg: [1, 2]}}}}\n", "time.steps: .*need series of .* 4 values"),
        (SERIES + "controller: {horizon: 3}\nforecast: {file: {file: forecast.csv}}\n", ":11:1: forecast: .*'twon.p': .* did you mean 'town.p'"),
        (SERIES + "controller: {horizon: 3}\nforecast: {file: {file: short.csv}}\n", ":11:1: forecast: .*5 rows; steps 3 to 5 need 6"),
    ],
)  # fmt: skip
def test_what_a_run_refuses_before_its_first_solve_is_found(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "forecast.csv").write_text("twon.p\n" + 6 * "50\n")
    (tmp_path / "short.csv").write_text("town.p\n" + 5 * "50\n")
    with pytest.raises(OpfmodelError, match=message):
        validate(written(tmp_path, text))


def test_a_run_states_the_position_of_a_forecast_that_cannot_be_made(tmp_path: Path) -> None:
    path = written(tmp_path, SERIES + "forecast: {file: {file: short.csv}}\n")
    (tmp_path / "short.csv").write_text("town.p\n50\n50\n")
    with pytest.raises(ScenarioError, match=r":10:1: forecast: .*2 rows; steps 3 to 3 need 4"):
        om.load_scenario(path).simulate()


def test_nothing_is_solved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> Plan:
        raise AssertionError("a problem is solved")

    monkeypatch.setattr(om.MultiStage, "solve", refuse)
    text = (
        SERIES
        + "controller: {horizon: 3, generator_delay: 1, objective: {setpoint-tracking: {setpoints: single-stage}}}\n"
        + "variants:\n  v: {controller: {formulation: dc, generator_delay: 0}}\n"
    )
    assert validate(written(tmp_path, text)) == 0


@pytest.mark.parametrize("path", sorted(SCENARIOS.glob("*.yaml")), ids=lambda path: path.stem)
def test_the_scenarios_of_the_repository_are_valid(path: Path) -> None:
    assert validate(path) == 0


def test_variants_are_limited_in_number(tmp_path: Path) -> None:
    empty = ", ".join(f"v{number}: {{}}" for number in range(201))
    with pytest.raises(ScenarioError, match=r":9:1: variants: .*201.* at most 200 .*study"):
        om.load_scenario(written(tmp_path, f"variants: {{{empty}}}\n"))


def test_set_points_of_a_file_cover_the_last_horizon(tmp_path: Path) -> None:
    (tmp_path / "setpoints.csv").write_text("g.pg\n" + 9 * "50\n")
    text = "controller: {horizon: 3, formulation: dc, objective: {setpoint-tracking: {setpoints: {file: setpoints.csv}}}}\n"
    path = written(tmp_path, text)
    assert validate(path) == 0
    (tmp_path / "setpoints.csv").write_text("g.pg\n" + 5 * "50\n")
    with pytest.raises(ScenarioError, match=r"controller.objective.*5 rows; 6 are needed"):
        validate(path)
