"""Figures: plotted values equal the data."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import demand, everything
from test_plants import Heater, HeaterDevice

import opfmodel as om
from opfmodel.check import losses
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
