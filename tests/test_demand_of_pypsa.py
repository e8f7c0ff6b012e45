"""Demand that sheds and flexible demand, against PyPSA's own optimum (linopy and HiGHS)."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
import pytest

import opfmodel as om

pypsa = pytest.importorskip("pypsa")
pytestmark = pytest.mark.filterwarnings("ignore::FutureWarning")  # linopy


def optimise(theirs: Any) -> None:
    for name in ("pypsa", "linopy"):
        logging.getLogger(name).setLevel(logging.ERROR)
    theirs.optimize(solver_name="highs", log_to_console=False, include_objective_constant=False)


def test_the_optimum_is_that_of_pypsa_with_a_generator_for_lost_load() -> None:
    town, hall = np.array([60.0, 95.0, 130.0, 80.0]), np.array([30.0, 99.0, 20.0, 50.0])
    theirs, ours = pypsa.Network(), om.Network("three", base_mva=100)
    theirs.set_snapshots(range(4))
    for name in "abc":
        theirs.add("Bus", name)
        ours.add(name, om.Bus(reference=name == "a"))
    for name, ends, x, rating in (("ab", "ab", 0.1, 55), ("bc", "bc", 0.2, 60), ("ac", "ac", 0.1, 70)):
        theirs.add("Line", name, bus0=ends[0], bus1=ends[1], x=x, s_nom=rating)
        ours.add(name, om.Branch(*ends, r=0.0, x=x * 100, rating=rating))
    for name, bus, p, cost in (("coal", "a", 120, 20), ("gas", "b", 25, 70)):
        theirs.add("Generator", name, bus=bus, p_nom=p, marginal_cost=cost)
        ours.add(name, om.Generator(bus, p=(0, p), cost=om.Polynomial(0, cost, 0)))
    for name, bus, p, cost in (("town", "c", town, 900), ("hall", "b", hall, 400)):
        theirs.add("Load", name, bus=bus, p_set=p)
        theirs.add("Generator", f"lost {name}", bus=bus, p_nom=1, p_max_pu=p, marginal_cost=cost)
        ours.add(name, om.Load(bus, p=0, shed_cost=cost))
    optimise(theirs)
    plan = om.MultiStage(ours, 4, formulation="dc", profiles={"town.p": town, "hall.p": hall}).solve()
    assert plan.objective == pytest.approx(theirs.objective, rel=1e-7)
    lost = theirs.generators_t.p[["lost town", "lost hall"]].values
    assert (lost.sum(axis=0) > 10).all()
    assert plan.data["load_shed"].sel(load=["town", "hall"]).values == pytest.approx(lost, abs=1e-3)


@pytest.mark.parametrize("back", [0.0, -4.0])
def test_the_optimum_is_that_of_pypsa_with_stores_behind_links(back: float) -> None:
    """A store takes the energy of all windows so far, through a link that is available inside windows."""
    hours, step = np.arange(96) * 0.5, 0.5
    clock = (hours - 18) % 24
    inside, closes = clock < 13, np.isclose(clock, 12.5)
    done = np.cumsum(closes)
    price = 40 + 25 * np.sin(0.5 * hours) + 10 * np.cos(1.7 * hours)
    gain = 0.9 if back == 0 else 1.0
    theirs, ours = pypsa.Network(), om.Network("one", base_mva=100)
    theirs.set_snapshots(range(96))
    theirs.snapshot_weightings[:] = step
    for bus in ("a", "cars"):
        theirs.add("Bus", bus)
    theirs.add("Generator", "coal", bus="a", p_nom=60, marginal_cost=price)
    theirs.add("Generator", "gas", bus="a", p_nom=60, marginal_cost=90)
    town = 45 + 10 * np.sin(0.3 * hours)
    theirs.add("Load", "town", bus="a", p_set=town)
    theirs.add("Link", "in", bus0="a", bus1="cars", p_nom=8, efficiency=gain, p_max_pu=inside.astype(float))
    if back:
        theirs.add("Link", "out", bus0="cars", bus1="a", p_nom=-back, p_max_pu=inside.astype(float))
    begun = 10 * (np.cumsum(np.isclose(clock, 0)) + 1)  # a window is open at the beginning
    theirs.add(
        "Store", "cars", bus="cars", e_nom=100, e_initial=6, e_min_pu=10 * done / 100, e_max_pu=begun / 100
    )  # fmt: skip
    optimise(theirs)
    ours.a = om.Bus()
    ours.coal = om.Generator("a", p=(0, 60), cost=om.Polynomial(0, 40, 0))
    ours.gas = om.Generator("a", p=(0, 60), cost=om.Polynomial(0, 90, 0))
    ours.town = om.Load("a", p=0)
    ours.cars = om.FlexibleLoad(
        "a", energy=10, power=(back, 8), begin=18, hours=13, efficiency=gain, delivered=6
    )
    series = {"coal.c1": price, "town.p": town}
    problem = om.MultiStage(ours, 96, step=step, formulation="copperplate", profiles=series)
    plan = problem.solve()
    assert plan.objective == pytest.approx(theirs.objective, rel=1e-7)
    drawn = plan.data["flexible_load_p"].values
    assert (drawn.max() > 7.9) and (drawn.min() == pytest.approx(back, abs=1e-3))
