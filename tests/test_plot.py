"""Figures: plotted values equal the data."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import demand, everything
from test_plants import Heater, HeaterDevice

import opfmodel as om
from opfmodel.check import losses
from opfmodel.results import figures
from opfmodel.results.figures import system


def drawn(figure: object, label: str) -> np.ndarray:
    """Values of the line with a label, without the last one, which is repeated to end the last step."""
    lines = [line for axis in figure.axes for line in axis.get_lines() if line.get_label() == label]
    return np.asarray(lines[0].get_ydata())[:-1]


@pytest.mark.parametrize("formulation", ["ac", "dc"])
def test_branch_losses_do_not_include_the_consumption_of_devices(formulation: str) -> None:
    grid = everything()
    grid.boiler = Heater("d", power=(8, 8))
    devices = [*om.MultiStage(everything()).devices, HeaterDevice()]
    made = om.MultiStage(grid, 3, formulation=formulation, profiles=demand(3), devices=devices)
    data = made.solve().data
    expected = losses(grid, data) if formulation == "ac" else np.zeros(3)
    assert drawn(system(data), "branch losses") == pytest.approx(expected, abs=1e-4)
    assert drawn(system(data), "heater (injection > 0)") == pytest.approx(np.full(3, -8), abs=1e-6)


def test_without_flows_there_are_no_losses() -> None:
    data = om.MultiStage(everything(), 2, formulation="copperplate", profiles=demand(2)).solve().data
    labels = [line.get_label() for axis in system(data).axes for line in axis.get_lines()]
    assert "branch losses" not in labels
    assert "generation" in labels


def labels(figure: object) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


@pytest.fixture(scope="module")
def plan() -> om.Plan:
    return om.MultiStage(everything(), 3, formulation="ac", profiles=demand(3)).solve()


def test_stored_energy_is_drawn_until_the_end_of_the_last_step(plan: om.Plan) -> None:
    axes = [*system(plan.data).axes, *figures.buses(plan.data).axes]
    panels = [axis for axis in axes if axis.get_ylabel() == "energy [MWh]"]
    assert len(panels) == 2
    for axis in panels:
        drawn = [line.get_xydata() for line in axis.get_lines() if len(line.get_xdata())]
        assert all(points[:, 0].tolist() == [0, 1, 2, 3] for points in drawn)
        assert sum(points[-1, 1] for points in drawn) == pytest.approx(float(plan.data["e_next"][-1].sum()))
        assert sum(points[0, 1] for points in drawn) == pytest.approx(float(plan.data["e"][0].sum()))


def test_line_styles_of_active_and_reactive_power_have_a_key(plan: om.Plan) -> None:
    for figure in (figures.demand(plan.data), figures.buses(plan.data)):
        assert {"active", "reactive"} <= set(labels(figure))
        shown = {line.get_label(): line.get_linestyle() for axis in figure.axes for line in axis.get_lines()}
        assert (shown["active"], shown["reactive"]) == ("-", "--")
    without = om.MultiStage(everything(), 2, formulation="dc", profiles=demand(2)).solve().data
    assert "reactive" not in labels(figures.buses(without))


@pytest.mark.parametrize("hours", [[1, 1, 1], [1, 2, 3]])
def test_scenarios_are_a_fan_with_one_label(hours: list[int]) -> None:
    horizon = om.Horizon.tree(hours, {"low": 0.2, "mid": 0.5, "high": 0.3}, common=1)
    problem = om.MultiStage(everything(), horizon, profiles=demand(6), formulation="dc")
    low, mid = (np.full(sum(hours), demand(6)["town.p"][0] * factor) for factor in (0.8, 0.9))
    known = om.Profiles.of({key: values[: sum(hours)] for key, values in demand(6).items()})
    futures = [om.Profiles({**known, "town.p": values}) for values in (low, mid, known["town.p"])]
    plan = problem.solve(expected=problem.expected(futures))
    for figure in (system(plan.data), figures.buses(plan.data), figures.demand(plan.data)):
        assert len(set(labels(figure))) == len(labels(figure))
        for axis in figure.axes:
            lines = [line for line in axis.get_lines() if len(line.get_xdata())]
            assert len(lines) % 3 == 0
            assert all(line.get_xdata().tolist() == [0, *np.cumsum(hours)] for line in lines)
            assert all(
                (a.get_alpha(), b.get_alpha()) == (0.58, 1.0)
                for a, b in zip(lines[::3], lines[1::3], strict=True)
            )
    panel = system(plan.data).axes[0]
    for line, name in zip(panel.get_lines()[:3], ("low", "mid", "high"), strict=True):
        drawn = plan.scenario(name)["pd"].sum("bus").values
        assert line.get_ydata()[:-1].tolist() == pytest.approx(drawn.tolist())


def test_a_fan_may_split_more_than_once() -> None:
    horizon = om.Horizon.branching([1, 1, 1], {1: 2, 2: 2})
    problem = om.MultiStage(everything(), horizon, profiles=demand(3), formulation="dc")
    plan = problem.solve(
        expected=problem.expected(
            [om.Profiles.of({key: values * f for key, values in demand(3).items()}) for f in (0.8, 0.9, 1, 1)]
        )
    )
    for figure in (system(plan.data), figures.buses(plan.data), figures.demand(plan.data)):
        for axis in figure.axes:
            assert len([line for line in axis.get_lines() if len(line.get_xdata())]) % 4 == 0
    for line, name in zip(system(plan.data).axes[0].get_lines()[:4], horizon.scenarios, strict=True):
        drawn = plan.scenario(name)["pd"].sum("bus").values
        assert line.get_ydata()[:-1].tolist() == pytest.approx(drawn.tolist())


def test_the_title_names_the_scenario(plan: om.Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    titles = []
    monkeypatch.setattr(
        "matplotlib.figure.Figure.savefig", lambda self, *_, **__: titles.append(self.axes[0].get_title())
    )
    figures.save_figures(plan.data.assign_attrs(scenario="island:dc"), tmp_path, figures=["system"])
    assert set(titles) == {"island:dc: system"}
