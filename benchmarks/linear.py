"""PyPSA's linear optimal power flow on the arrays of opfmodel's DC formulation."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
import pandas as pd
import pypsa

from benchmarks.systems import vectors
from opfmodel.network.arrays import PerUnitNetwork

__all__ = ["pypsa_network", "solve_pypsa"]


def pypsa_network(network: PerUnitNetwork, demand: np.ndarray) -> pypsa.Network:
    """Network with linear costs, storage and ramp limits, in hourly snapshots.

    At a nominal voltage of 1 kV PyPSA's reactances are per unit on 1 MVA, and its flow is the angle
    divided by the reactance, so x = 1 / (base b) gives the flow base b theta in MW.

    Parameters
    ----------
    demand
        Active demand at each bus in p.u., shape ``(buses, stages)``.
    """
    network = vectors(network)
    base, bus, branch = network.base_mva, network.bus, network.branch
    gen, sto = network.generator, network.storage
    name = bus.names
    made = pypsa.Network()
    made.set_snapshots(range(demand.shape[1]))
    made.add("Bus", name, v_nom=1.0)
    susceptance = branch.x / (branch.r**2 + branch.x**2)
    made.add(
        "Line",
        branch.names,
        bus0=[name[i] for i in branch.from_bus],
        bus1=[name[i] for i in branch.to_bus],
        x=1.0 / (base * susceptance),
        s_nom=np.where(np.isfinite(branch.rating), branch.rating * base, 1e6),
    )
    made.add(
        "Generator",
        gen.names,
        bus=[name[i] for i in gen.bus],
        p_nom=gen.p_max * base,
        p_min_pu=gen.p_min / gen.p_max,
        marginal_cost=gen.c1 / base,
        ramp_limit_up=np.minimum(gen.ramp / gen.p_max, 1.0),
        ramp_limit_down=np.minimum(gen.ramp / gen.p_max, 1.0),
    )
    made.add(
        "StorageUnit",
        sto.names,
        bus=[name[i] for i in sto.bus],
        p_nom=sto.power_max * base,
        max_hours=sto.energy / sto.power_max,
        state_of_charge_initial=sto.initial * base,
    )
    drawn = demand + network.at_buses("shunt", network.shunt.g)[:, None]
    loads = [f"load at {bus}" for bus in name]
    series = pd.DataFrame(base * drawn.T, index=made.snapshots, columns=loads)
    made.add("Load", loads, bus=list(name), p_set=series)
    return made


def solve_pypsa(network: pypsa.Network) -> dict[str, Any]:
    """Solve with HiGHS; return the status and the objective in $."""
    for name in ("pypsa", "linopy"):
        logging.getLogger(name).setLevel(logging.ERROR)  # keep reports and hints out of the results
    _, condition = network.optimize(
        solver_name="highs", include_objective_constant=False, log_to_console=False, output_flag=False
    )
    return {"status": condition, "objective": float(network.objective)}
