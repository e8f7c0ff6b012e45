"""Loads."""

from __future__ import annotations

from typing import Any

import numpy as np

from opfmodel.model import Device, Model, Side, Slack, Stage
from opfmodel.network.arrays import Array, Index, Table
from opfmodel.network.components import Load
from solvers import Expression, total

__all__ = ["LoadDevice", "per_active_power", "sheddable"]

_LEAST_FACTOR = 1e-3  # active per reactive power, below which a load counts as reactive only


class LoadDevice(Device):
    r"""Demand ``p + jq``, a parameter of every solve, of which a part may be shed at a cost.

    A load with a ``shed_cost`` c may be served in part, with its power factor:

    .. math::
        0 \le p^{shed} \le \max(p, 0), \quad q^{shed} = \frac{q}{p} p^{shed}

    at :math:`c\, p^{shed}`. Injections (:math:`p < 0`) and loads with hardly any active power (less than a
    thousandth of the reactive) are not shed. An outage changes nothing: after it, as much is shed as in the
    stage before.

    In an elastic problem a share of each load may be left unserved besides, active and reactive alike, at the
    shedding price times its apparent power; both together do not exceed the load. The diagnosis separates
    the two shares, each at half the price, to find how much active and how much reactive power a bus lacks.
    """

    component = Load

    def declare(self, model: Model, table: Table) -> None:
        """Withdraw the demand from its bus, and declare ``load_shed`` if some of it may be shed."""
        p, q = model.parameter("load", "p"), model.parameter("load", "q")
        model.inject(table.bus, p=-p, q=-q)
        priced = sheddable(table)
        shed = self._shed(model, table) if priced.size else None
        if model.elastic is not None:
            self._unserved(model, table, p, q, None if shed is None else shed[priced], priced)

    @staticmethod
    def _shed(model: Model, table: Table) -> Expression:
        """Allow loads to be shed at a cost, in contingencies as much as in the stage before."""
        regular = np.ones((1, model.stages))
        regular[0, model.horizon.contingencies] = 0.0

        def most(t: Table) -> Array:
            demand = np.where(np.isfinite(t.shed_cost) & _has_active_power(t), np.maximum(t.p, 0.0), 0.0)
            return np.asarray(demand if regular.all() else demand * regular)

        variable = model.variable("load", "load_shed", 0.0, most, unit="MW", publish=False)
        shed = variable if regular.all() else variable[:, model.horizon.owner]
        model.publish("load", "load_shed", shed, unit="MW", description="active demand shed at a cost")
        reactive = None
        if model.reactive:
            reactive = model.of_fields("load", "load reactive share", per_active_power) * shed
            model.publish(
                "load", "load_shed_q", reactive, unit="MVAr", description="reactive demand shed with it"
            )
        model.inject(table.bus, p=shed, q=reactive)
        return shed

    @staticmethod
    def _unserved(
        model: Model, table: Table, p: Expression, q: Expression, shed: Expression | None, priced: Index
    ) -> None:
        """Allow a share of each load to be left unserved."""
        share = model.share("load", "unserved")
        active = p * share
        model.inject(table.bus, p=active)
        soft = model.soft_balance(table.bus, "MW", "shedding")
        model.slacks["p_unserved"] = Slack("p_unserved", "bus", soft, Side.BELOW)
        model.report("load", "p_unserved", active, unit="MW", description="unserved active demand")
        price = model.penalty(soft)

        def most(t: Table) -> Array:
            return np.asarray(np.maximum(t.p[priced], 0.0))

        if shed is not None:
            model.rows("load", "load_left", shed + active[priced], -np.inf, most)
        if not model.reactive:
            model.penalise(price * np.sqrt(p**2) * share)
            return
        share_q = model.share("load", "unserved_q") if model.split_shedding else share
        reactive = q * share_q
        model.inject(table.bus, q=reactive)
        soft_q = model.soft_balance(table.bus, "MVAr", "shedding")
        model.slacks["q_unserved"] = Slack("q_unserved", "bus", soft_q, Side.BELOW)
        model.report("load", "q_unserved", reactive, unit="MVAr", description="unserved reactive demand")
        if shed is not None and model.split_shedding:
            model.rows("load", "load_left_q", shed + p[priced] * share_q[priced], -np.inf, most)
        mean = 0.5 * (share + share_q) if model.split_shedding else share
        model.penalise(price * np.sqrt(p**2 + q**2) * mean)

    def cost(self, stage: Stage) -> Any:
        """Cost of shed demand, $/h."""
        loads, priced = stage.load, sheddable(stage.network.load)
        if not priced.size:
            return None
        return total(loads.shed_cost[priced] * loads.load_shed[priced])


def sheddable(table: Table) -> Index:
    """Return the positions of the loads that may be shed at a cost."""
    return np.flatnonzero(np.isfinite(table.shed_cost).all(axis=1))


def per_active_power(table: Table) -> Array:
    """Return the reactive power of each load per active power; 0 if it may not be shed."""
    active = _has_active_power(table)
    shape = np.broadcast_shapes(table.p.shape, table.q.shape)
    return np.asarray(np.divide(table.q, table.p, out=np.zeros(shape), where=active))


def _has_active_power(table: Table) -> Any:
    return (table.p > 0.0) & (table.p >= _LEAST_FACTOR * np.abs(table.q))
