"""Measurements of every step: limit violations, changes of set-points, unserved energy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from opfmodel.network.arrays import PerUnitNetwork, Table
from opfmodel.network.units import scale

if TYPE_CHECKING:
    from opfmodel.plan import MultiStage
    from opfmodel.simulation.plants import Step

__all__ = ["DESCRIBED", "changes", "excesses", "summarise"]

Array = npt.NDArray[np.float64]
Values = Mapping[tuple[str, str], Array]

# Unit and description of every measured quantity.
DESCRIBED = {
    "vm_excess": ("p.u.", "voltage outside its limits"),
    "flow_excess": ("MVA", "apparent power above the rating, at the worse end"),
    "angle_excess": ("deg", "angle difference outside its limits"),
    "pg_excess": ("MW", "active generation outside its limits"),
    "qg_excess": ("MVAr", "reactive generation outside its limits"),
    **{
        f"{kind}_capability_excess": ("MVA", "distance of the power from within the capability curve")
        for kind in ("generator", "storage", "renewable")
    },
    "ramp_excess": ("MW", "change of generation beyond the ramp limit"),
    "e_excess": ("MWh", "stored energy at the end of a stage outside its limits"),
    "pg_redispatch": ("MW", "absolute deviation of generation from its set-point"),
    "ps_redispatch": ("MW", "absolute deviation of charging power from its set-point"),
    "renewable_p_redispatch": ("MW", "absolute deviation of renewable generation from its set-point"),
    "pg_curtailed": ("MW", "available power not generated"),
    "load_shed": ("MW", "active demand shed at a cost"),
    "load_shed_q": ("MVAr", "reactive demand shed with it"),
    "p_unserved": ("MW", "unserved active demand"),
    "q_unserved": ("MVAr", "unserved reactive demand"),
    "p_shortage": ("MW", "unserved active balance (slack injection)"),
    "p_surplus": ("MW", "surplus active balance (slack withdrawal)"),
    "q_shortage": ("MVAr", "unserved reactive balance (slack injection)"),
    "q_surplus": ("MVAr", "surplus reactive balance (slack withdrawal)"),
}
_POWERS = (
    ("generator", "pg", "qg"),
    ("storage", "ps", "qs"),
    ("renewable", "renewable_p", "renewable_q"),
)
_CURTAILED = "_curtailed"  # ending of what devices publish as available but not generated, MW
_TOLERANCE = 1e-5  # p.u.; smaller excesses are solver tolerance in the plan and the resulting state


def excesses(network: PerUnitNetwork, values: Values, step: float, before: Array | None) -> Values:
    """Return the limit violations of a state, p.u., ``(items,)``; 0 within the limits.

    Parameters
    ----------
    network
        Network with the limits of the stage.
    before
        Generation in the previous stage, if ramps are measured.
    """
    bus, branch, generator = network.bus, network.branch, network.generator
    ends = [np.hypot(values["branch", f"p{end}"], values["branch", f"q{end}"]) for end in "ft"]
    angle = values["bus", "va"][branch.from_bus] - values["bus", "va"][branch.to_bus]
    made = {
        ("bus", "vm_excess"): _outside(values["bus", "vm"], bus, "vm_min", "vm_max"),
        ("branch", "flow_excess"): np.maximum(np.maximum(*ends) - _now(branch, "rating"), 0.0),
        ("branch", "angle_excess"): _outside(angle, branch, "angle_min", "angle_max"),
    }
    if len(generator):
        pg, qg = values["generator", "pg"], values["generator", "qg"]
        made["generator", "pg_excess"] = _outside(pg, generator, "p_min", "p_max")
        made["generator", "qg_excess"] = _outside(qg, generator, "q_min", "q_max")
        change = np.zeros_like(pg) if before is None else np.abs(pg - before)
        made["generator", "ramp_excess"] = np.maximum(change - step * _now(generator, "ramp"), 0.0)
    for kind, p, q in _POWERS:
        if (kind, p) in values and network.tables[kind].capability_owner.size:
            excess = _beyond_curve(network.tables[kind], values[kind, p], values[kind, q])
            made[kind, f"{kind}_capability_excess"] = excess
    if ("storage", "e_next") in values:
        storage = network.storage
        made["storage", "e_excess"] = _outside(values["storage", "e_next"], storage, "energy_min", "energy")
    return made


def changes(
    network: PerUnitNetwork, values: Values, planned: Values, available: npt.NDArray[np.bool_]
) -> Values:
    """Return the changes of set-points and the unused available power, p.u.

    Parameters
    ----------
    available
        Which generators have an availability, a time series of ``p_max``.
    """
    made = {
        (kind, f"{name}_redispatch"): np.abs(values[kind, name] - planned[kind, name])
        for kind, name, _ in _POWERS
        if (kind, name) in planned
    }
    if len(network.generator):
        unused = np.maximum(_now(network.generator, "p_max") - values["generator", "pg"], 0.0)
        made["generator", "pg_curtailed"] = np.where(available, unused, 0.0)
    return made


def summarise(problem: MultiStage, steps: Sequence[Step]) -> dict[str, Any]:
    """Return the key figures of a run: stored energy at its end, and what was measured."""
    base, hours = problem.arrays.base_mva, problem.step
    made: dict[str, Any] = {}
    if steps and (stored := steps[-1].values.get(("storage", "e_next"))) is not None:
        made["stored_mwh"] = float(stored.sum()) * base
    over = [
        step.values["budget", "budget_over"] for step in steps if ("budget", "budget_over") in step.values
    ]
    names = problem.arrays.tables["budget"].names
    if over and names:
        made["overspent_units"] = dict(zip(names, (np.sum(over, axis=0) * hours).tolist(), strict=True))
    seen = {name: (kind, name) for step in steps for kind, name in step.values}
    named = {name: key for name, key in seen.items() if name in DESCRIBED or name.endswith(_CURTAILED)}
    curtailed = [name for name in named if name.endswith(_CURTAILED)]
    for key, names in (
        ("redispatched_mwh", tuple(f"{name}_redispatch" for _, name, _ in _POWERS)),
        ("shed_mwh", ("load_shed", "p_unserved", "p_shortage")),
        ("curtailed_mwh", (*curtailed, "p_surplus")),
    ):
        present = [named[name] for name in names if name in named]
        if present:
            parts = [np.nansum(np.abs(s.values[k])) for s in steps for k in present if k in s.values]
            made[key] = float(sum(parts)) * base * hours
    exceeded = [key for name, key in named.items() if name.endswith("_excess")]
    for kind, name in sorted(exceeded):
        worst = max(float(np.nanmax(s.values[kind, name], initial=0.0)) for s in steps)
        made[f"largest_{name}"] = worst * scale(DESCRIBED[name][0], base)
    if exceeded:
        broken = [max(float(np.nanmax(s.values[k], initial=0.0)) for k in exceeded) for s in steps]
        made["violated_steps"] = sum(worst > _TOLERANCE for worst in broken)
        made["unsolved_steps"] = sum(not step.solved for step in steps)
    return made


def _beyond_curve(table: Table, p: Array, q: Array) -> Array:
    """Return the distance of power from the edges of the capability curves, while units are in service."""
    owner, made = table.capability_owner, np.zeros(len(table))
    beyond = _now(table, "capability_p") * p[owner] + _now(table, "capability_q") * q[owner]
    np.maximum.at(made, owner, beyond - _now(table, "capability_limit"))
    return made * _now(table, "status")


def _outside(values: Array, table: Table, lower: str, upper: str) -> Array:
    """Return the distance of values outside their limits."""
    return np.maximum(np.maximum(_now(table, lower) - values, values - _now(table, upper)), 0.0)


def _now(table: Table, field: str) -> Array:
    """Return a field of a table with one stage."""
    array: Array = table.arrays[field]
    return array[:, 0]
