"""What a formulation is."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import numpy.typing as npt

from opfmodel.model import Model
from opfmodel.network import Index, PerUnitNetwork, Table
from solvers import Expression

__all__ = ["Formulation", "limit_angle", "publish_flows", "transport"]


class Formulation:
    """Bus variables, branch physics and network limits; one class in one file.

    Registered by an entry point in the group ``opfmodel.formulations``.

    Attributes
    ----------
    name
        Name in scenario files and results.
    reactive
        Whether reactive power is balanced.
    publishes
        Network quantities that objectives and constraints may use.
    """

    name: ClassVar[str]
    reactive: ClassVar[bool]
    publishes: ClassVar[tuple[str, ...]]

    def zones(self, network: PerUnitNetwork) -> npt.NDArray[np.intp]:
        """Balance row of each bus: by default each its own."""
        return np.arange(len(network.bus))

    def declare(self, model: Model) -> None:
        """Declare the variables of the network, add branch flows to the balance, state limits."""
        raise NotImplementedError


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
    """Take branch flows out of the balance of their buses and limit the apparent power at both ends.

    The flows of a branch share most of their formula, so that balance and limits of a branch are
    one template.
    """
    branch = model.network.branch
    assert model.balance_q is not None
    for limited in (False, True):
        members = np.flatnonzero(np.isfinite(branch.rating) == limited)
        if not members.size:
            continue
        f, t = model.zones[branch.from_bus[members]], model.zones[branch.to_bus[members]]
        flows = [flow[members] for flow in (pf, qf, pt, qt)]
        terms = [-flow for flow in flows]
        rows = [model.balance_p[f], model.balance_q[f], model.balance_p[t], model.balance_q[t]]
        if limited:

            def square(table: Table, members: Index = members) -> npt.NDArray[np.float64]:
                rating: npt.NDArray[np.float64] = table.rating
                return rating[members] ** 2

            for name, power in (("rating_from", flows[:2]), ("rating_to", flows[2:])):
                rows.append(model.limit("branch", name, members.size, -np.inf, square))
                terms.append(power[0] ** 2 + power[1] ** 2)
        model.build.add(terms, into=rows)


def limit_angle(model: Model, angle: Expression) -> None:
    """Limit the angle across the branches that have such a limit."""
    branch = model.network.branch
    members = np.flatnonzero((branch.angle_min > -2 * np.pi) | (branch.angle_max < 2 * np.pi))
    if members.size:
        model.rows(
            "branch",
            "angle_difference",
            angle[members],
            lambda table: table.angle_min[members],
            lambda table: table.angle_max[members],
        )
