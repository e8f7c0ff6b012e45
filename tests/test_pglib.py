"""The AC optimum of every PGLib case at hand, verified by the independent check."""

from __future__ import annotations

import pytest
from conftest import DATA, pglib_baseline

import opfmodel as om
from opfmodel.check import check

BASELINE = pglib_baseline()


@pytest.mark.parametrize("case", BASELINE)
def test_ac_optimum(case: str) -> None:
    network = om.read_network(DATA / "pglib" / f"{case}.m")
    plan = om.MultiStage(network).solve()
    assert plan.status == "locally_optimal"
    assert plan.objective == pytest.approx(float(BASELINE[case]["ac_usd_per_h"]), rel=1e-4)
    report = check(network, plan.data)
    assert report.max_violation <= 1e-6, str(report)
    assert report.cost == pytest.approx(plan.objective, rel=1e-9)
    assert plan.solution.dual_residual <= 1e-2  # $/h per p.u., at prices of a thousand and more


def test_every_case_of_the_baseline_is_here() -> None:
    assert {p.stem for p in (DATA / "pglib").glob("*.m")} == set(BASELINE)
    assert len(BASELINE) == 14
