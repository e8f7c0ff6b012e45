"""Variants and overrides: what is merged, and what is replaced."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

import opfmodel as om
from opfmodel.cli.app import app
from opfmodel.errors import ScenarioError
from opfmodel.scenario import laid_over, load_scenario
from opfmodel.scenario.document import read_document
from opfmodel.study import read_study

GRID = (
    "network:\n  buses: {a: {}}\n  generators: {g: {bus: a, p: [0, 9], cost: {points: [[0, 0], [9, 90]]}}}\n"
)
NOISY = "forecast: {noisy: {deviation: 0.05, seed: 3}}\n"
REDISPATCH = "plant: {mode: redispatch, price: 50}\n"


def laid(tmp_path: Path, base: str, variant: str | None = None, **overrides: Any) -> dict[str, Any]:
    """Lay a variant, if given, and overrides over a file; the result must be valid."""
    path = tmp_path / "scenario.yaml"
    path.write_text(GRID + base + ("" if variant is None else f"variants:\n  v: {variant}\n"))
    name = None if variant is None else "v"
    dotted = {key.replace("__", "."): value for key, value in overrides.items()}
    load_scenario(path, name, dotted)
    return laid_over(read_document(path), name, dotted)


@pytest.mark.parametrize(
    ("base", "variant", "key", "expected"),
    [
        (NOISY + REDISPATCH, "{forecast: {persistence: {period: 24}}}", "forecast", {"persistence": {"period": 24}}),
        (NOISY + REDISPATCH, "{forecast: persistence}", "forecast", "persistence"),
        (NOISY + REDISPATCH, "{forecast: {noisy: {seed: 4}}}", "forecast", {"noisy": {"deviation": 0.05, "seed": 4}}),
        (REDISPATCH, "{plant: {mode: power-flow}}", "plant", {"mode": "power-flow"}),
        (REDISPATCH, "{plant: power-flow}", "plant", "power-flow"),
        (REDISPATCH, "{plant: {mode: redispatch, reactive_price: 2}}", "plant", {"mode": "redispatch", "price": 50, "reactive_price": 2}),
        (REDISPATCH, "{plant: {price: 60}}", "plant", {"mode": "redispatch", "price": 60}),
        ("plant: redispatch\n", "{plant: {price: 60}}", "plant", {"mode": "redispatch", "price": 60}),
        ("cost: {economic: {reactive_weight: 1}}\n", "{cost: {voltage-deviation: {target: 1}}}", "cost", {"voltage-deviation": {"target": 1}}),
        ("cost: {economic: {reactive_weight: 1}}\n", "{cost: {economic: {energy_weight: 2}}}", "cost", {"economic": {"reactive_weight": 1, "energy_weight": 2}}),
        ("cost: economic\n", "{cost: {economic: {energy_weight: 2}}}", "cost", {"economic": {"energy_weight": 2}}),
        ("controller: {objective: {economic: {reactive_weight: 1}}, horizon: 2}\n", "{controller: {objective: {voltage-deviation: {}}}}", "controller", {"objective": {"voltage-deviation": {}}, "horizon": 2}),
        ("controller: {solver: {name: ipopt, options: {max_iter: 9}}}\n", "{controller: {solver: {name: 'qp:osqp'}}}", "controller", {"solver": {"name": "qp:osqp"}}),
        ("controller: {solver: ipopt}\n", "{controller: {solver: {options: {max_iter: 9}}}}", "controller", {"solver": {"name": "ipopt", "options": {"max_iter": 9}}}),
    ],
)  # fmt: skip
def test_another_plugin_replaces_the_options_and_the_same_one_merges(
    base: str, variant: str, key: str, expected: Any, tmp_path: Path
) -> None:
    assert laid(tmp_path, base, variant)[key] == expected


@pytest.mark.parametrize(
    ("base", "over", "expected"),
    [
        ("{points: [[0, 0], [9, 90]]}", "{c1: 5}", om.Polynomial(0, 5, 0)),
        ("{c1: 5}", "{points: [[0, 0], [9, 90]]}", om.PiecewiseLinear([(0, 0), (9, 90)])),
        ("{c1: 5}", "{c2: 1}", om.Polynomial(1, 5, 0)),
    ],
)
def test_another_form_of_cost_replaces_the_cost(base: str, over: str, expected: Any, tmp_path: Path) -> None:
    path = tmp_path / "scenario.yaml"
    grid = "network: {{buses: {{a: {{}}}}, generators: {{g: {{bus: a, p: [0, 9], cost: {}}}}}, update: {{g: {{cost: {}}}}}}}\n"
    path.write_text(
        grid.format(base, base)
        + f"variants: {{v: {{network: {{generators: {{g: {{cost: {over}}}}}, update: {{g: {{cost: {over}}}}}}}}}}}\n"
    )
    assert load_scenario(path, "v").network["g"].cost == expected  # type: ignore[attr-defined]
    content = laid_over(read_document(path), "v")["network"]
    assert content["generators"]["g"]["cost"] == content["update"]["g"]["cost"]


def test_overrides_of_one_command_belong_together_in_any_order(tmp_path: Path) -> None:
    expected = {"mode": "redispatch", "price": 60}
    base = "plant: {mode: power-flow, participation: {g: 1}}\n"
    assert laid(tmp_path, base, plant__price=60, plant__mode="redispatch")["plant"] == expected
    assert laid(tmp_path, base, plant__mode="redispatch", plant__price=60)["plant"] == expected


def test_overrides_replace_what_a_variant_chose(tmp_path: Path) -> None:
    made = laid(tmp_path, NOISY, f"{{{REDISPATCH.strip()}}}", plant__mode="power-flow", forecast__perfect={})
    assert made["plant"] == {"mode": "power-flow"}
    assert made["forecast"] == {"perfect": {}}


def test_an_option_set_over_a_scalar_starts_anew(tmp_path: Path) -> None:
    made = laid(
        tmp_path,
        NOISY + REDISPATCH,
        forecast="perfect",
        forecast__noisy__deviation=0.1,
        forecast__noisy__seed=4,
    )
    assert made["forecast"] == {"noisy": {"deviation": 0.1, "seed": 4}}


def test_set_and_study_axes_replace_plugins(tmp_path: Path) -> None:
    path = tmp_path / "scenario.yaml"
    path.write_text(GRID + NOISY + REDISPATCH)
    for item in (
        "forecast={persistence: {period: 24}}",
        "forecast.persistence.period=24",
        "plant.mode=power-flow",
    ):
        result = CliRunner().invoke(app, ["validate", str(path), "--set", item])
        assert result.exit_code == 0, result.output
    study = tmp_path / "study.yaml"
    study.write_text(
        "scenario: scenario.yaml\nvary:\n  plant.mode: [redispatch, power-flow]\n"
        "  forecast: [persistence, {noisy: {seed: 4}}, {persistence: {period: 2}}]\n"
    )
    made = [
        laid_over(read_document(run.scenario), run.variant, run.overrides)
        for run in read_study(study).variations()
    ]
    assert made[0]["plant"] == {"mode": "redispatch", "price": 50}
    assert made[3]["plant"] == {"mode": "power-flow"}
    assert [run["forecast"] for run in made[3:]] == [
        "persistence",
        {"noisy": {"deviation": 0.05, "seed": 4}},
        {"persistence": {"period": 2}},
    ]


@pytest.mark.parametrize("variant", ["null", "5", "[1]"])
def test_a_variant_that_is_no_mapping_is_refused_with_its_position(variant: str, tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r":5:3: variants\.v: .*must be a mapping"):
        laid(tmp_path, "", variant)
