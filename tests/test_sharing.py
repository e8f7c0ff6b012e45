"""Programs of the same structure share their functions, and nothing else."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SCENARIOS, demand, everything
from hypothesis import given, settings
from hypothesis import strategies as st

import opfmodel as om
from opfmodel.scenario import load_scenario
from opfmodel.study import execute, execution, read_study, read_table, run_study
from opfmodel.study.specification import Snapshot
from solvers import (
    Evaluator,
    Instance,
    Program,
    ProgramBuilder,
    Sharing,
    Solution,
    SolutionStatus,
    Start,
    prepare,
    solve,
)
from solvers.backends.ipopt import Ipopt, IpoptSession

pytestmark = pytest.mark.filterwarnings("ignore::opfmodel.errors.ProfileWarning")

CASE5 = SCENARIOS / "case5-step.yaml"
BASE = {"time.steps": 2, "controller.horizon": 2}


def functions(program: Program, evaluator: Evaluator, seed: int) -> list[np.ndarray]:
    """Values and derivatives at a random point."""
    chance = np.random.default_rng(seed)
    x, p = chance.uniform(0.9, 1.1, program.n_variables), program.default.parameters
    multipliers = chance.normal(size=program.n_rows)
    return [
        np.array([evaluator.objective(x, p)]),
        evaluator.rows(x, p),
        evaluator.gradient(x, p),
        evaluator.jacobian(x, p).toarray(),
        evaluator.hessian(x, p, 0.7, multipliers).toarray(),
        *(evaluator.cones(x, p)[0] for _ in program.cones),
        *evaluator.outputs(x, p).values(),
    ]


# fields of the network of ``everything``, some of which are bounds and others coefficients
FIELDS = [
    *(("line", field) for field in ("r", "x", "b", "rating")),
    *(("transformer", field) for field in ("tap", "shift", "rating")),
    *(("cable", field) for field in ("g", "b_from")),
    *(("battery", f) for f in ("energy", "power", "charge_efficiency", "standing_loss", "rating", "initial")),
    *(("cheap", field) for field in ("p", "q", "ramp")),
    *(("town", field) for field in ("p", "q")),
    ("capacitor", "b"),
    ("b", "vm"),
]


def changed(value: Any, factor: float) -> Any:
    return tuple(changed(v, factor) for v in value) if isinstance(value, tuple) else value * factor


@settings(max_examples=8)
@given(
    field=st.sampled_from(FIELDS),
    factor=st.floats(0.9, 0.999),
    formulation=st.sampled_from(["ac", "soc", "dc"]),
)
def test_shared_functions_are_those_of_the_program(
    field: tuple[str, str], factor: float, formulation: str
) -> None:
    sharing = Sharing()
    for scale in (1.0, factor):
        network = everything()
        component, name = field
        network.update(component, **{name: changed(getattr(network[component], name), scale)})
        series = {key: scale * values for key, values in demand(2).items()}
        program = om.MultiStage(network, 2, formulation=formulation, profiles=series).compile()
        with sharing.active():
            taken = Evaluator(program)
        own = Evaluator(program)
        assert taken.program is program
        for one, other in zip(
            functions(program, taken, seed=1), functions(program, own, seed=1), strict=True
        ):
            assert np.array_equal(one, other)
    assert sharing.assembled + sharing.shared == 2


@pytest.fixture(scope="module")
def compiled() -> Sharing:
    """The functions of the 5-bus scenario."""
    sharing = Sharing(most=100)
    with sharing.active():
        load_scenario(CASE5, None, BASE).problem.compile()
    return sharing


SEED = [
    {"shape": {"file": "data/germany_2019-07-22_96h.csv", "column": "load_mw"}},
    {"noise": {"deviation": 0.05, "correlation": 0.8, "seed": 2}},
]


@pytest.mark.parametrize(
    ("change", "shared"),
    [
        ({"profiles": SEED}, True),
        ({"forecast": {"noisy": {"deviation": 0.1, "seed": 2}}, "plant.mode": "redispatch"}, True),
        ({"time.steps": 3}, True),
        ({"network.loads.load2.p": 290}, True),
        ({"network.storages.cell*": {"energy": 100, "power": 5, "initial": 50}}, True),
        ({"network.generators.gen1": {"p": [0, 200], "ramp": 5}}, True),
        ({"network.branches.1-2.rating": 390}, True),
        ({"network.buses.1.vm": [0.95, 1.05]}, True),
        ({"controller.end": {"price": 5, "minimum": 0.5, "cyclic": True}}, True),
        ({"network.branches.1-4.rating": 390}, False),  # had none
        ({"network.generators.gen1.cost": {"c2": 0.001, "c1": 16}}, False),
        ({"network.branches.1-2.r": 0.003}, False),
        ({"network.storages.cell*.charge_efficiency": 0.9}, False),
        ({"controller.regularisation": 0.5}, False),
        ({"cost.economic.energy_weight": 0.5}, False),
        ({"controller.horizon": 3}, False),
        ({"controller.formulation": "dc"}, False),
        ({"controller.limits": "soft"}, False),
    ],
)
def test_what_runs_share(change: dict[str, Any], shared: bool, compiled: Sharing) -> None:
    """As docs/studies.md states."""
    before = compiled.assembled, compiled.shared
    with compiled.active():
        load_scenario(CASE5, None, {**BASE, **change}).problem.compile()
    assert (compiled.assembled - before[0], compiled.shared - before[1]) == (not shared, shared)


def test_a_run_does_not_depend_on_earlier_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "study.yaml").write_text(
        f"scenario: {CASE5}\n"
        "set: {time.steps: 2, controller.horizon: 2, controller.generator_delay: 0}\n"
        "vary:\n"
        "  controller: {ac: {}, osqp: {controller: {formulation: dc, solver: {name: osqp}}}}\n"
        "  network.storages.cell*.energy: [100, 150]\n"
    )
    runs = Snapshot().specifications(read_study(tmp_path / "study.yaml"))
    monkeypatch.setattr(execution, "_SHARING", Sharing())
    together = [execute(run) for run in runs]
    for number in (1, 3):
        assert together[number].provenance["provenance_programs_shared"] > 0
        monkeypatch.setattr(execution, "_SHARING", Sharing())
        alone = execute(runs[number])
        assert alone.provenance["provenance_programs_shared"] == 0
        assert alone.result["status"] == "done"
        assert alone.result == together[number].result


def bounded(lower: float, weight: Any = 1.0, items: int = 1) -> Program:
    build = ProgramBuilder()
    x = build.variable("x", items, lower=lower)
    build.minimize(np.asarray(weight) * x**2)
    return build.build()


def test_few_and_small_programs_are_kept() -> None:
    sharing = Sharing(most=2, variables=10)

    def assembles(*arguments: Any) -> bool:
        before = sharing.assembled
        with sharing.active():
            assert solve(bounded(*arguments), "ipopt").status.is_optimal
        return sharing.assembled > before

    assert assembles(1.0)
    assert not assembles(2.0)
    assert assembles(1.0, 2.0)
    assert assembles(1.0, 3.0)
    assert assembles(1.0)  # forgotten: two later ones
    assert assembles(1.0, 1.0, 11)  # too large, so nothing is kept beside it or of it
    assert assembles(1.0, 1.0, 11)
    sharing.clear()
    assert assembles(1.0)
    assert solve(bounded(3.0), "ipopt").objective == pytest.approx(9.0)  # outside, nothing is shared
    assert sharing.shared == 1


WARM = f"""\
scenario: {CASE5}
set: {{time.steps: 2, controller.horizon: 6}}
starts: warm
vary: {{"network.storages.cell*.energy": [100, 120, 140, 160]}}
"""


def test_warm_starts_between_runs_change_the_effort_and_not_the_results(tmp_path: Path) -> None:
    study = tmp_path / "study.yaml"
    study.write_text(WARM)
    warm = run_study(read_study(study), tmp_path / "out", workers=0)
    study.write_text(WARM.replace("starts: warm\n", ""))
    cold = run_study(read_study(study), tmp_path / "out", workers=0)
    assert (warm.done, cold.done) == (4, 4)  # they have other keys
    rows = read_table(tmp_path / "out")
    study.write_text(WARM)
    run_study(read_study(study), tmp_path / "out", workers=0)
    faster = read_table(tmp_path / "out")
    for one, other in zip(faster, rows, strict=True):
        assert one["cost"] == pytest.approx(other["cost"], rel=1e-6)
    assert faster[0]["iterations"] == rows[0]["iterations"]  # the first run finds no earlier one
    assert sum(row["iterations"] for row in faster[1:]) < 0.8 * sum(row["iterations"] for row in rows[1:])


def test_a_shared_start_that_leads_nowhere_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    starts: list[Start | None] = []

    class Stubborn(IpoptSession):
        """Fails from any starting point but its own."""

        def solve(self, instance: Instance, start: Start | None = None) -> Solution:
            starts.append(start)
            found = super().solve(instance)
            return found if start is None else replace(found, status=SolutionStatus.NONE)

    monkeypatch.setattr(Ipopt, "prepare", lambda _, *arguments: Stubborn(*arguments))
    with Sharing().active(starts=True):
        for lower in (1.0, 2.0):
            program = bounded(lower)
            session = prepare(program, "ipopt")
            for _ in range(2):
                assert session.solve(program.default).status.is_optimal
    assert [start is None for start in starts] == [True, True, False, True, True]
