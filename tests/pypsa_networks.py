"""Networks of PyPSA, and their optimum and voltages in PyPSA and in opfmodel."""

import importlib
from functools import cache

import numpy as np
import pandas as pd
import pypsa

import opfmodel as om


@cache
def _empty() -> pypsa.Network:
    return pypsa.Network()


def empty() -> pypsa.Network:
    """A network without components; a copy takes a tenth of the time of a new one with its standard types."""
    return _empty().copy()


def snapshots(steps: int, hours: float) -> pypsa.Network:
    n = empty()
    n.set_snapshots(pd.date_range("2025-03-29", periods=steps, freq=pd.Timedelta(hours=hours)))
    n.snapshot_weightings.loc[:] = hours
    return n


def meshed(steps: int = 12, hours: float = 1.0, cyclic: bool = False) -> pypsa.Network:
    """Four buses in two loops, with a series of every kind."""
    return _meshed(steps, hours, cyclic).copy()


@cache
def _meshed(steps: int, hours: float, cyclic: bool) -> pypsa.Network:
    rng = np.random.default_rng(7)
    n = snapshots(steps, hours)
    for bus in "abcd":
        n.add("Bus", bus, v_nom=110.0)
    for i, (u, v) in enumerate(["ab", "bc", "ac", "cd"]):
        n.add("Line", f"line{i}", bus0=u, bus1=v, x=10 + 3 * i, r=1 + i, b=1e-5, s_nom=60 + 5 * i)
    n.lines_t.s_max_pu["line0"] = rng.uniform(0.5, 1.0, steps)
    n.add("Transformer", "trafo", bus0="b", bus1="d", x=0.1, r=0.01, s_nom=100, tap_ratio=1.05, tap_side=1)
    n.add(
        "Generator", "coal", bus="a", p_nom=200, p_min_pu=0.1, marginal_cost=rng.uniform(10, 30, steps),
        ramp_limit_up=0.3, ramp_limit_down=0.3,
    )  # fmt: skip
    n.add("Generator", "wind", bus="d", p_nom=100, p_max_pu=rng.uniform(0, 1, steps), marginal_cost=1)
    n.add("Generator", "gas", bus="c", p_nom=300, marginal_cost=60)
    n.add("Generator", "flexible", bus="c", p_nom=20, marginal_cost=-15, sign=-1)  # a demand that pays
    n.add("Load", "b", bus="b", p_set=rng.uniform(20, 80, steps), q_set=3)
    n.add("Load", "c", bus="c", p_set=rng.uniform(20, 80, steps))
    n.add(
        "StorageUnit", "hydro", bus="c", p_nom=30, max_hours=4, efficiency_store=0.9, standing_loss=0.01,
        efficiency_dispatch=0.85, state_of_charge_initial=20, cyclic_state_of_charge=cyclic,
        p_min_pu=-rng.uniform(0.2, 1.0, steps),
    )  # fmt: skip
    n.add("Store", "tank", bus="d", e_nom=50, e_initial=10, standing_loss=0.02, e_cyclic=cyclic)
    return n


def of_case(name: str, steps: int, hours: float, cyclic: bool = False) -> pypsa.Network:
    """A case of PYPOWER with a daily curve of demand and storage units at its first ten loads."""
    ppc = getattr(importlib.import_module(f"pypower.{name}"), name)()
    n = empty()
    n.import_from_pypower_ppc(ppc)
    n.set_snapshots(pd.date_range("2025-03-29", periods=steps, freq=pd.Timedelta(hours=hours)))
    n.snapshot_weightings.loc[:] = hours
    n.generators["p_set"] = np.nan  # set-points of a power flow
    n.generators["marginal_cost"] = ppc["gencost"][:, 5] + 0.37 * np.arange(len(n.generators))  # no two alike
    n.generators["marginal_cost_quadratic"] = 0.0
    n.transformers["phase_shift"] = 0.0  # neglected by PyPSA's optimum
    n.shunt_impedances["g"] = 0.0  # likewise
    curve = 0.8 + 0.2 * np.sin(2 * np.pi * np.arange(steps) * hours / 24 - 2)
    for load in n.loads.index:
        n.loads_t.p_set[load] = n.loads.p_set[load] * curve
    for load in n.loads.index[:10]:
        power = n.loads.p_set[load]
        n.add("StorageUnit", f"storage {load}", bus=n.loads.bus[load], p_nom=power, max_hours=4,
              efficiency_store=0.95, efficiency_dispatch=0.93, standing_loss=0.002,
              cyclic_state_of_charge=cyclic, state_of_charge_initial=power)  # fmt: skip
    return n


def optima(n: pypsa.Network, **options: object) -> tuple[float | None, float | None]:
    """Optimum of PyPSA, and of opfmodel; None if there is none."""
    status, _ = n.optimize(solver_name="highs", include_objective_constant=False, log_to_console=False)
    network = om.from_pypsa(n, **options)
    cyclic = bool(n.storage_units.cyclic_state_of_charge.any() or n.stores.e_cyclic.any())
    plan = om.MultiStage(
        network,
        horizon=len(n.snapshots),
        formulation="dc-matpower",
        end=om.End(cyclic=cyclic),
        regularisation=0.0,
    ).solve(initial={"e": None} if cyclic else None)
    return n.objective if status == "ok" else None, plan.objective if plan.optimal else None


def difference(n: pypsa.Network) -> float:
    """Largest difference of a voltage between n.pf() and the power flow of the converted network, p.u."""
    n.lpf()  # from a flat start, transformers with shifts of 150 degrees do not converge
    assert n.pf(x_tol=1e-8, use_seed=True).converged.all().all()
    flow = om.power_flow(om.from_pypsa(n), tolerance=1e-10)
    assert flow.status == "converged"
    bus = flow.data.isel(time=0)
    found = dict(zip(bus.bus.values, bus.vm.values * np.exp(1j * np.deg2rad(bus.va.values)), strict=True))
    expected = n.buses_t.v_mag_pu.iloc[0] * np.exp(1j * n.buses_t.v_ang.iloc[0])
    return max(abs(found[str(bus)] - v) for bus, v in expected.items())
