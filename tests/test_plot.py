"""Figures: plotted values equal the data."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from conftest import Call, demand, everything
from test_plants import Heater, HeaterDevice

import opfmodel as om
from opfmodel.check import losses
from opfmodel.errors import ResultError
from opfmodel.results import binding, figures, load, save
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


def panel(figure: object, label: str) -> object:
    """The panel with a label of its axis of values."""
    (axis,) = [axis for axis in figure.axes if axis.get_ylabel() == label]
    return axis


def lines(axis: object, style: str) -> list[list[float]]:
    """Values of the thick lines of a style, in the order of their buses."""
    found = [line for line in axis.get_lines() if line.get_linestyle() == style and line.get_linewidth() > 1]
    return [np.asarray(line.get_ydata()).tolist() for line in found]


def limits(axis: object) -> set[float]:
    """Values of the thin lines."""
    return {float(y) for line in axis.get_lines() if line.get_linewidth() < 1 for y in line.get_ydata()}


def marks(axis: object, marker: str) -> list[tuple[float, float]]:
    """Points with a marker."""
    found = [line.get_xydata() for line in axis.get_lines() if line.get_marker() == marker]
    return sorted((float(x), float(y)) for points in found for x, y in points)


def held(values: np.ndarray) -> list[list[float]]:
    """Values of stages as lines: the last one is repeated to end its stage."""
    return [[*line, line[-1]] for line in np.asarray(values).T.tolist()]


def test_the_figure_of_the_paper_has_the_panels_of_its_captions(plan: om.Plan) -> None:
    data, figure = plan.data, figures.paper(plan.data)
    generation, charging = (
        panel(figure, "generation\n[MW], [MVAr]"),
        panel(figure, "charging power\n[MW], [MVAr]"),
    )
    assert lines(generation, "-") == held(data["pg"].values)  # of buses a and c
    assert lines(generation, "--") == held(data["qg"].values)
    order = ["tank", "battery"]  # of buses b and d
    assert lines(charging, "-") == held(data["ps"].sel(storage=order).values)
    assert lines(charging, "--") == held(data["qs"].sel(storage=order).values)
    voltage, angle = panel(figure, "voltage [p.u.]"), panel(figure, "angle [deg]")
    assert voltage.bbox.bounds == angle.bbox.bounds  # one panel
    assert lines(voltage, "-") == held(data["vm"].values)
    assert lines(angle, "--") == held(data["va"].values)
    whole = np.vstack([data["e"].sel(storage=order), data["e_next"].sel(storage=order)[-1:]])
    assert lines(panel(figure, "energy [MWh]"), "-") == whole.T.tolist()
    demands = panel(figure, "demand\n[MW], [MVAr]")
    assert lines(demands, "-") == held(data["pd"].values)
    assert lines(demands, "--") == held(data["qd"].values)
    total = data["pd"].sum("bus").values
    assert lines(panel(figure, "total demand [MW]"), "-.") == held(total[:, None])
    assert lines(panel(figure, "total energy [MWh]"), "-") == [whole.sum(axis=1).tolist()]
    names = ("generation $P^g$", "demand $P^d$", "charging $P^s$", "losses $P^{loss}$")
    pg, pd, ps, loss = (drawn(figure, name) for name in names)
    assert pg - pd - ps - loss == pytest.approx(0.4 * data["vm"].sel(bus="d").values ** 2, abs=1e-5)  # shunt
    assert {"bus a", "active, voltage", "reactive, angle", "limit", "at ramp limit"} <= set(labels(figure))


def test_datasets_have_the_limits_of_their_quantities(plan: om.Plan, tmp_path: Path) -> None:
    data = plan.data
    assert data["vm_max"].values.tolist() == [1.1] * 4
    assert data["pg_min"].sel(generator="cheap") == 5
    assert data["pg_ramp"].values.tolist() == [15, np.inf]
    battery = data.sel(storage="battery")
    assert (battery["ps_min"], battery["ps_max"], battery["e_min"], battery["e_max"]) == (-11, 10, 0, 40)
    series = {**demand(3), "dear.p_max": [50, 40, 30]}
    varying = om.MultiStage(everything(), 3, formulation="copperplate", profiles=series).solve().data
    assert varying["pg_max"].sel(generator="dear").values == pytest.approx([50, 40, 30])
    assert "vm_max" not in varying
    save(varying, {}, tmp_path)
    xr.testing.assert_identical(load(tmp_path), varying)
    save(varying.assign(pg_max=("bus", np.ones(4))), {}, tmp_path)
    with pytest.raises(ResultError, match="pg_max: has the dimensions"):
        load(tmp_path)


@pytest.fixture
def bound(plan: om.Plan) -> xr.Dataset:
    """Data at limits: a voltage, generation, a storage and a ramp."""
    data = plan.data.copy(deep=True)
    data["vm"].loc[{"bus": "a"}] = [1.1, 1.05, 0.9]
    data["pg"].loc[{"generator": "cheap"}] = [60, 45, 50]  # 15 MW of ramp down
    data["e_next"].loc[{"storage": "battery"}] = [40, 20, 0.001]
    data["qs"].loc[{"storage": "tank"}] = 0
    data["qs_min"].loc[{"storage": "tank"}] = data["qs_max"].loc[{"storage": "tank"}] = 0
    return data


def without_limits(data: xr.Dataset) -> xr.Dataset:
    return data.drop_vars([name for name in data if str(name).endswith(("_min", "_max", "_ramp"))])


def test_limits_bind_where_values_reach_them(bound: xr.Dataset) -> None:
    at_limit = binding(bound)
    assert at_limit["vm"].sel(bus="a").values.tolist() == [1, 0, -1]
    assert at_limit["pg"].sel(generator="cheap").values.tolist() == [1, 0, 0]
    assert at_limit["e"].sel(storage="battery").values.tolist() == [1, 0, -1]
    assert at_limit["pg_ramp"].sel(generator="cheap").values.tolist() == [0, -1, 0]
    assert not at_limit["pg_ramp"].sel(generator="dear").any()  # without a ramp limit
    assert not at_limit["qs"].sel(storage="tank").any()  # fixed
    out = bound.assign(generator_status=bound["pg"].copy(data=[[1, 1], [0, 1], [1, 1]]))
    assert not binding(out)["pg_ramp"].any()  # a unit that trips or returns
    assert not set(binding(without_limits(bound)))


def test_the_figure_of_the_paper_marks_limits_that_bind(bound: xr.Dataset) -> None:
    figure = figures.paper(bound, ["a", "d"])
    voltage, energy = panel(figure, "voltage [p.u.]"), panel(figure, "energy [MWh]")
    generation = panel(figure, "generation\n[MW], [MVAr]")
    assert (0.5, 1.1) in marks(voltage, "^")  # in the middle of the stage
    assert (2.5, 0.9) in marks(voltage, "v")
    assert (marks(energy, "^"), marks(energy, "v")) == ([(1, 40)], [(3, 0.001)])  # at its end
    assert marks(generation, "D") == [(1, 52.5)]  # half-way between two stages
    assert limits(voltage) == {0.9, 1.1}
    assert limits(energy) == {0, 40}
    far = figures.paper(bound.assign(vm_max=bound["vm_max"] + 9), ["a"])
    assert limits(panel(far, "voltage [p.u.]")) == {0.9}


@pytest.mark.parametrize("formulation", ["dc", "copperplate"])
def test_the_figure_of_the_paper_shows_what_there_is(formulation: str) -> None:
    grid = everything()
    grid.remove("tank")
    grid.remove("battery")
    figure = figures.paper(om.MultiStage(grid, 2, formulation=formulation, profiles=demand(2)).solve().data)
    shown = [axis.get_ylabel() for axis in figure.axes]
    assert ("angle [deg]" in shown) == (formulation == "dc")
    assert not {"charging power\n[MW], [MVAr]", "voltage [p.u.]", "total energy [MWh]"} & set(shown)


def test_the_figure_of_the_paper_shows_scenarios_as_a_fan() -> None:
    horizon = om.Horizon.tree([1, 1], {"low": 0.4, "high": 0.6}, common=1)
    problem = om.MultiStage(everything(), horizon, profiles=demand(2), formulation="dc")
    futures = [om.Profiles.of({key: values * f for key, values in demand(2).items()}) for f in (0.6, 1)]
    data = problem.solve(expected=problem.expected(futures)).data
    data["pg"].loc[{"generator": "cheap"}] = [30, 45, 15]  # both are a ramp from the common stage
    assert binding(data)["pg_ramp"].sel(generator="cheap").values.tolist() == [0, 1, -1]
    generation = panel(figures.paper(data, ["a"]), "generation\n[MW], [MVAr]")
    assert lines(generation, "-") == [[30, 45, 45], [30, 15, 15]]
    assert marks(generation, "D") == [(1, 22.5), (1, 37.5)]


def test_plot_paper_draws_one_figure_of_the_chosen_buses(
    bound: xr.Dataset, tmp_path: Path, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(figures, "_drawn", lambda figure, _: ",".join(labels(figure)).encode())  # quick
    save(bound, {}, tmp_path)
    code, out, err = call("plot", tmp_path, "--paper", "--buses", "a, d", "--bus", "b", "--json")
    assert (code, err) == (0, "")
    assert json.loads(out)["figures"] == [str(tmp_path / "paper.pdf"), str(tmp_path / "paper.png")]
    content = (tmp_path / "paper.png").read_text()
    assert [bus for bus in "abcd" if f"bus {bus}," in content] == ["a", "b", "d"]
    code, _, err = call("plot", tmp_path, "--paper", "--buses", "a,e,f")
    assert (code, err) == (2, "error: no bus is named 'e', 'f'; available: a, b, c, d\n")
    save(without_limits(bound), {}, tmp_path)
    assert not (tmp_path / "paper.png").exists()  # of the results before
    code, _, err = call("plot", tmp_path, "--paper")
    assert code == 0
    assert "no limits" in err
