"""Settings of the network: adjustable transformers and switchable shunts, shared by formulations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from opfmodel.model import Model, Stage, declare_setting
from opfmodel.network.arrays import Array, Index, PerUnitNetwork, Table
from opfmodel.network.physics import branch_flow, through_transformer
from solvers import Expression, stacked, total

__all__ = [
    "Terminals",
    "adjustable",
    "behind_transformers",
    "cost_of_moves",
    "flows",
    "relaxed_shunts",
    "shift_beyond",
    "switched_shunts",
]

_MOVES = (("branch", "tap"), ("branch", "shift"), ("shunt", "shunt_b"))


def adjustable(table: Table, field: str) -> Any:
    """Return which components have a range for an adjustable field, ``(items, 1)``."""
    return table.arrays[f"{field}_min"] < table.arrays[f"{field}_max"]


def flows(model: Model, w_f: Any, w_t: Any, w_r: Any, w_i: Any) -> tuple[Any, Any, Any, Any]:
    """Return the power into both ends of the branches from the voltage products at their buses.

    Declares ``tap`` and ``shift`` where some are adjustable.
    """
    network = model.network
    tap, shift = _ratio(model), phase_shift(model)
    if tap is None and shift is None:
        return branch_flow(model.admittance, w_f, w_t, w_r, w_i)
    branch = network.branch
    admittance = network.admittance_at(
        branch.tap if tap is None else np.ones_like(branch.tap),
        branch.shift if shift is None else np.zeros_like(branch.shift),
    )
    if model.status is not None:
        admittance = admittance * model.status
    return branch_flow(admittance, *through_transformer(w_f, w_t, w_r, w_i, tap, shift))


def _ratio(model: Model) -> Expression | None:
    """Declare ``tap`` if a ratio is adjustable."""
    branch = model.network.branch
    if not adjustable(branch, "tap").any():
        return None
    about = "transformer ratio"
    return declare_setting(model, "branch", "tap", "tap", branch.tap_steps, unit="", description=about)


def phase_shift(model: Model) -> Expression | None:
    """Declare ``shift`` if a phase shift is adjustable."""
    branch = model.network.branch
    if not adjustable(branch, "shift").any():
        return None
    about = "phase shift of the transformer"
    return declare_setting(
        model, "branch", "shift", "shift", branch.shift_steps, unit="deg", description=about
    )


def behind_transformers(model: Model, w: Expression) -> tuple[Expression, Terminals]:
    r"""Relax adjustable transformers: declare the squared voltages behind them.

    .. math::
        \tau_{min}^2 w' \le w_f \le \tau_{max}^2 w'

    The ratio and the shift are no variables: the angle across the branch behind the transformer has the
    range of the angle difference, widened by that of the shift.

    Returns
    -------
    Expression, Terminals
        Squared voltages at the buses and behind the transformers, and how the branches are connected to them.
    """
    terminals = Terminals.of(model.network)
    if not terminals.members.size:
        return w, terminals
    branch, members = model.network.branch, terminals.members
    low, high = branch.tap_min[members] ** 2, branch.tap_max[members] ** 2
    count = len(model.network.bus)
    least, most = terminals.vm_min[count:] ** 2, terminals.vm_max[count:] ** 2
    start = np.clip(1.0, least, most)
    inner = model.build.variable("w_behind", members.size, model.stages, least, most, start)
    at_from = w[branch.from_bus[members]]
    for name, limit, bounds in (
        ("w_behind_low", low, (0.0, np.inf)),
        ("w_behind_high", high, (-np.inf, 0.0)),
    ):
        rows = model.build.rows(name, members.size, model.stages, *bounds)
        model.build.add(at_from - limit * inner, into=rows)
    joined = stacked(w, inner)
    about = "squared voltage magnitude behind the transformer"
    model.report("branch", "w_inner", joined[terminals.at_from], unit="p.u.^2", description=about)
    return joined, terminals


def relaxed_shunts(model: Model, w: Expression) -> Expression:
    r"""Return the reactive power that shunts inject at squared voltages, if some are switchable.

    :math:`b_{min} w \le q \le b_{max} w` is exact but for steps, and linear.
    """
    shunt = model.network.shunt
    q = model.variable("shunt", "shunt_q", unit="MVAr", start=shunt.b, description="reactive power injected")
    model.rows("shunt", "shunt_q_low", q - shunt.b_min * w, 0.0, np.inf)
    model.rows("shunt", "shunt_q_high", q - shunt.b_max * w, -np.inf, 0.0)
    about = "susceptance of the shunt, as reactive power injected at 1 p.u. voltage"
    model.report("shunt", "shunt_b", q / w, unit="MVAr", description=about)
    return q


@dataclass(frozen=True)
class Terminals:
    """Where branches are connected: at buses, and behind the adjustable transformers at their from ends.

    Attributes
    ----------
    members
        Branches with an adjustable transformer; their terminals come after the buses.
    at_from, at_to
        Terminals of the branches.
    vm_min, vm_max
        Limits of the voltage magnitude at the terminals, p.u.
    tap, shift
        What is left of the transformers between the terminals, as of :class:`Branch`.
    shift_min, shift_max
        Phase shifts by which the angle between the terminals differs from that between the buses, rad.
    """

    members: Index
    at_from: Index
    at_to: Index
    vm_min: Array
    vm_max: Array
    tap: Array
    shift: Array
    shift_min: Array
    shift_max: Array

    @classmethod
    def of(cls, network: PerUnitNetwork) -> Terminals:
        """Return the terminals of a network."""
        bus, branch = network.bus, network.branch
        turned = adjustable(branch, "shift")
        behind = adjustable(branch, "tap") | turned
        members = np.flatnonzero(behind)
        at_from = branch.from_bus.copy()
        at_from[members] = len(bus) + np.arange(members.size)
        ends = branch.from_bus[members]
        return cls(
            members,
            at_from,
            branch.to_bus,
            np.concatenate([bus.vm_min, bus.vm_min[ends] / branch.tap_max[members]]),
            np.concatenate([bus.vm_max, bus.vm_max[ends] / branch.tap_min[members]]),
            np.where(behind, 1.0, branch.tap),
            np.where(turned, 0.0, branch.shift),
            np.where(turned, branch.shift_min, 0.0),
            np.where(turned, branch.shift_max, 0.0),
        )


def shift_beyond(model: Model, counted: Array | float) -> Expression | float:
    """Return the phase shift of adjustable transformers, less what a linear flow counts already."""
    shift = phase_shift(model)
    if shift is None:
        return 0.0
    beyond: Expression = (shift - counted) * adjustable(model.network.branch, "shift")
    return beyond


def switched_shunts(model: Model) -> Expression | None:
    """Declare ``shunt_b`` if a shunt is switchable."""
    shunt = model.network.shunt
    if not adjustable(shunt, "b").any():
        return None
    about = "susceptance of the shunt, as reactive power injected at 1 p.u. voltage"
    return declare_setting(model, "shunt", "shunt_b", "b", shunt.steps + 1.0, unit="MVAr", description=about)


def cost_of_moves(stage: Stage) -> Any:
    """Return the cost of the positions by which settings move, $/h; None if none are counted."""
    costs = []
    for kind, name in _MOVES:
        if stage.has(f"{name}_moves"):
            of = getattr(stage, kind)
            price = np.where(np.isfinite(of.move_cost), of.move_cost, 0.0)
            costs.append(total(price / stage.step * getattr(of, f"{name}_moves")))
    made = costs[0] if costs else None
    for cost in costs[1:]:
        made = made + cost
    return made
