"""The base class of formulations, and the declarations that they share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from opfmodel.errors import IncompatibleError
from opfmodel.formulations.settings import adjustable, cost_of_moves, relaxed_shunts, switched_shunts
from opfmodel.model import Model, Soft, Stage
from opfmodel.network.arrays import Array, Index, PerUnitNetwork, Table
from solvers import Expression, Solution

__all__ = [
    "Formulation",
    "angles",
    "limit_angle",
    "limit_flows",
    "limit_products",
    "price_rating",
    "publish_flows",
    "refuse_resistive",
    "resistive",
    "shunts",
    "soft_rating",
    "soft_voltage",
    "transport",
]


class Formulation:
    """Bus variables, branch physics and network limits; one class per file.

    Registered by an entry point in the group ``opfmodel.formulations``.

    Attributes
    ----------
    name
        Name in scenario files and results.
    reactive
        Whether reactive power is balanced.
    publishes
        Network quantities that objectives and constraints may use.
    slack_losses
        Whether losses are only bounded from below: fictitious ones may absorb power that costs nothing.
    physics
        ``ac`` or ``dc`` if flows are those of :mod:`opfmodel.network.branch_outages`, which then tests many
        outages at once; ``dc`` needs a method ``flow``, see :class:`opfmodel.formulations.dc.DC`. By
        default they are not known, and every outage is tested by its own problem.
    relaxed_by
        Name of a convex formulation that admits every state that this one admits, so that its optimum is a
        lower bound; see :func:`opfmodel.certify`. By default none is known.
    """

    name: ClassVar[str]
    reactive: ClassVar[bool]
    publishes: ClassVar[tuple[str, ...]]
    slack_losses: ClassVar[bool] = False
    physics: ClassVar[Literal["ac", "dc"] | None] = None
    relaxed_by: ClassVar[str | None] = None

    def zones(self, network: PerUnitNetwork) -> npt.NDArray[np.intp]:
        """Return the balance row of each bus; by default one per bus."""
        return np.arange(len(network.bus))

    def notes(self, network: PerUnitNetwork) -> tuple[str, ...]:  # noqa: ARG002
        """Return what users should know of this formulation of their network; by default nothing."""
        return ()

    def declare(self, model: Model) -> None:
        """Declare the variables of the network, add branch flows to the balance, and set the limits."""
        raise NotImplementedError

    def cost(self, stage: Stage) -> Any:
        """Return the operating cost of the network, $/h: that of moving taps, phase shifters and shunts."""
        return cost_of_moves(stage)

    def relaxation(self, solution: Solution, network: PerUnitNetwork) -> dict[str, float]:  # noqa: ARG002
        """Return the deviation of a solution from the relaxed equations, by name; empty if there are none."""
        return {}


def angles(model: Model) -> Expression:
    """Declare ``va``, zero at the reference bus of every island; it starts without flow."""
    bus = model.network.bus
    free = np.full(len(bus), np.inf)
    free[model.network.reference] = 0.0
    start = model.network.resting_angle
    return model.variable("bus", "va", -free, free, unit="deg", start=start, description="voltage angle")


def resistive(network: PerUnitNetwork) -> list[str]:
    """Return the names of the branches without reactance, which a DC flow cannot represent."""
    return [network.branch.names[i] for i in np.flatnonzero(network.branch.x == 0.0)]


def refuse_resistive(network: PerUnitNetwork, formulation: str) -> None:
    """Raise :class:`IncompatibleError` if a branch has no reactance."""
    if names := resistive(network):
        raise IncompatibleError(
            f"{names[0]}: x = 0: formulation {formulation!r} needs the reactance of every branch; 'ac', "
            "'ac-rectangular', 'soc' and 'copperplate' do not, and 'dc' leaves the branch open"
        )


def shunts(model: Model, vm_squared: Expression | float, relaxed: bool = False) -> None:
    """Subtract the power drawn by shunts at a squared voltage from the balance of their buses.

    Where one is switchable, their susceptance is the variable ``shunt_b``, or what they inject is one if the
    product with the squared voltage is relaxed.
    """
    shunt = model.network.shunt
    if not len(shunt):
        return
    at = vm_squared[shunt.bus] if isinstance(vm_squared, Expression) else vm_squared
    if relaxed and isinstance(at, Expression) and adjustable(shunt, "b").any():
        model.inject(shunt.bus, p=model.build.expression(-shunt.g * at), q=relaxed_shunts(model, at))
        return
    b = switched_shunts(model) if model.reactive else None
    p, q = -shunt.g * at, (shunt.b if b is None else b) * at
    model.inject(shunt.bus, p=model.build.expression(p), q=model.build.expression(q))


def publish_flows(
    model: Model, pf: Expression, qf: Expression | None, pt: Expression, qt: Expression | None
) -> None:
    """Publish the power entering each branch at its two ends."""
    for name, flow, power, end in (
        ("pf", pf, "active", "from"),
        ("qf", qf, "reactive", "from"),
        ("pt", pt, "active", "to"),
        ("qt", qt, "reactive", "to"),
    ):
        if flow is not None:
            unit = "MW" if power == "active" else "MVAr"
            model.publish(
                "branch", name, flow, unit=unit, description=f"{power} power into the branch at its {end} end"
            )


def transport(model: Model, pf: Expression, qf: Expression, pt: Expression, qt: Expression) -> None:
    """Subtract branch flows from the balance of their buses, and limit the apparent power at both ends.

    The flows of a branch share most of their expressions, so its balance and limits are one template. In the
    expanded form of the program the flows are variables, and the branch equations rows.
    """
    branch = model.network.branch
    assert model.balance_q is not None
    for limited in (False, True):
        members = np.flatnonzero(np.isfinite(branch.rating) == limited)
        if not members.size:
            continue
        f, t = model.zones[branch.from_bus[members]], model.zones[branch.to_bus[members]]
        rows = [model.balance_p[f], model.balance_q[f], model.balance_p[t], model.balance_q[t]]
        if limited:

            def square(table: Table, members: Index = members) -> npt.NDArray[np.float64]:
                rating: npt.NDArray[np.float64] = table.rating
                return rating[members] ** 2

            soft = soft_rating(members, squared=True)
            for name in ("rating_from", "rating_to"):
                rows.append(model.limit("branch", name, members.size, -np.inf, square, soft))

            def read(solution: Solution, network: PerUnitNetwork, members: Index = members) -> Array:
                rating: Array = network.branch.rating[members]
                rating = np.where(np.isfinite(rating), rating, 0.0)
                price: Array = np.zeros((members.size, 1))
                for name in ("rating_from", "rating_to"):  # of the square, with what it is exceeded by
                    exceeded = f"{name}_above"
                    by = solution.value(exceeded) if exceeded in model.slacks else 0.0
                    price = price + 2.0 * (rating + by) * solution.dual(name)
                return price

            price_rating(model, members, read)
        flows = [flow[members] for flow in (pf, qf, pt, qt)]
        model.build.compose(_drawn_and_squared if limited else _drawn, flows, into=rows)


def _drawn(*flows: Expression) -> list[Expression]:
    """Return what flows add to the balance of their buses."""
    return [-flow for flow in flows]


def _drawn_and_squared(*flows: Expression) -> list[Expression]:
    """Return what flows add to the balance of their buses, and the squared apparent power at both ends."""
    pf, qf, pt, qt = flows
    return [*_drawn(*flows), pf**2 + qf**2, pt**2 + qt**2]


def limit_flows(model: Model, **flows: Expression) -> None:
    """Limit active flows in both directions on branches with a rating; one block of rows each."""
    members = np.flatnonzero(np.isfinite(model.network.branch.rating))
    if not members.size:
        return
    soft = soft_rating(members, ends=len(flows))
    for name, flow in flows.items():
        model.rows(
            "branch", name, flow[members], lambda t: -t.rating[members], lambda t: t.rating[members], soft
        )

    def read(solution: Solution, _: PerUnitNetwork) -> Array:
        return np.asarray(np.sum([np.abs(solution.dual(name)) for name in flows], axis=0))

    price_rating(model, members, read)


def price_rating(model: Model, members: Index, read: Callable[[Solution, PerUnitNetwork], Array]) -> None:
    """Report the value of one more MVA of rating; ``read`` returns that of the branches ``members``."""

    def spread(solution: Solution, network: PerUnitNetwork) -> Array:
        limited = read(solution, network)
        price = np.zeros((len(network.branch), limited.shape[1]))
        price[members] = limited
        rating = network.branch.rating
        own = np.broadcast_to(~np.isfinite(network.branch.emergency_rating), rating.shape)
        for node in model.horizon.contingencies:  # with a multiple of the rating, or an emergency rating
            owner = model.horizon.owner[node]
            with np.errstate(invalid="ignore", divide="ignore"):
                multiple = rating[members, node] / rating[members, owner]
            counts = np.isfinite(multiple) & own[members, node]
            price[members, owner] += np.where(counts, multiple, 0.0) * price[members, node]
        return price

    model.price("branch", "rating_price", spread, "$/MWh", "value of one more MVA of rating")


def limit_angle(model: Model, angle: Expression) -> None:
    """Limit the angle difference across the branches that have such a limit."""
    members = _angle_limited(model)
    if members.size:
        model.rows(
            "branch",
            "angle_difference",
            angle[members],
            lambda table: table.angle_min[members],
            lambda table: table.angle_max[members],
            _soft_angle(members),
        )


def limit_products(
    model: Model, w_r: Expression, w_i: Expression, widened: tuple[Array | float, Array | float] = (0.0, 0.0)
) -> None:
    r"""Limit the angle difference across branches in terms of voltage products.

    :math:`\theta \ge a` is :math:`w_i \cos a - w_r \sin a \ge 0`, and likewise at the upper end, as long
    as the two limits are at most 180 degrees apart.

    Parameters
    ----------
    widened
        What is added to the lower and the upper limits, rad; limits that it takes too far apart do not hold.
    """
    members = _angle_limited(model)
    if not members.size:
        return
    branch = model.network.branch
    low, high = branch.angle_min[members], branch.angle_max[members]
    wide = np.flatnonzero(high - low > np.pi)
    if wide.size:
        first = wide[0]
        raise IncompatibleError(
            f"{branch.names[members[first]]}: angle = ({np.rad2deg(low[first, 0]):g}, "
            f"{np.rad2deg(high[first, 0]):g}): limits "
            "more than 180 degrees apart cannot be expressed in voltage products; "
            "tighten them, or remove them with (-360, 360)"
        )
    low, high = (
        limit + np.broadcast_to(by, branch.x.shape)[members]
        for limit, by in zip((low, high), widened, strict=True)
    )
    kept = np.flatnonzero(high - low <= np.pi)
    members, low, high = members[kept], low[kept], high[kept]
    real, imaginary = model.switched(w_r)[members], model.switched(w_i)[members]
    above = np.cos(low) * imaginary - np.sin(low) * real
    below = np.cos(high) * imaginary - np.sin(high) * real
    soft = _soft_angle(members)  # near 1 p.u. the excess in products is that of the angle
    model.rows("branch", "angle_above", above, 0.0, np.inf, soft)
    model.rows("branch", "angle_below", below, -np.inf, 0.0, soft)


def soft_voltage(model: Model, squared: bool = False) -> Soft:
    """Return how the voltage limits of all buses are softened in an elastic problem."""
    buses = np.arange(len(model.network.bus))
    below, above = "is {} below its minimum voltage", "is {} above its maximum voltage"
    return Soft("voltage", buses, "p.u.", below, above, squared=squared)


def soft_rating(members: Index, squared: bool = False, ends: int = 2) -> Soft:
    """Return how the ratings of branches, limited at one or both ends, are softened in an elastic problem."""
    sentence = "exceeds its rating by {}"
    return Soft("rating", members, "MVA", sentence, sentence, squared=squared, share=1.0 / ends)


def _soft_angle(members: Index) -> Soft:
    return Soft("angle", members, "deg", "is {} below its minimum angle", "is {} above its maximum angle")


def _angle_limited(model: Model) -> Index:
    """Return the branches with a limit on the angle difference."""
    branch = model.network.branch
    return np.flatnonzero((branch.angle_min > -2 * np.pi) | (branch.angle_max < 2 * np.pi))
