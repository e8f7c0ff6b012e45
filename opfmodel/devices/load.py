"""Loads."""

from __future__ import annotations

import numpy as np

from opfmodel.model import Device, Model, Side, Slack
from opfmodel.network.arrays import Table
from opfmodel.network.components import Load
from solvers import Expression

__all__ = ["LoadDevice"]


class LoadDevice(Device):
    r"""Fixed demand ``p + jq``, a parameter of every solve.

    In an elastic problem a share of each load may be left unserved, active and reactive alike, at the
    shedding price times its apparent power. The diagnosis separates the two shares, each at half the price,
    to find how much active and how much reactive power a bus lacks.
    """

    component = Load

    def declare(self, model: Model, table: Table) -> None:
        """Withdraw the demand from its bus."""
        p, q = model.parameter("load", "p"), model.parameter("load", "q")
        model.inject(table.bus, p=-p, q=-q)
        if model.elastic is not None:
            self._shed(model, table, p, q)

    @staticmethod
    def _shed(model: Model, table: Table, p: Expression, q: Expression) -> None:
        """Allow a share of each load to be left unserved."""
        share = model.share("load", "unserved")
        active = p * share
        model.inject(table.bus, p=active)
        soft = model.soft_balance(table.bus, "MW", "shedding")
        model.slacks["p_unserved"] = Slack("p_unserved", "bus", soft, Side.BELOW)
        model.report("load", "p_unserved", active, unit="MW", description="unserved active demand")
        price = model.penalty(soft)
        if not model.reactive:
            model.penalise(price * np.sqrt(p**2) * share)
            return
        share_q = model.share("load", "unserved_q") if model.split_shedding else share
        reactive = q * share_q
        model.inject(table.bus, q=reactive)
        soft_q = model.soft_balance(table.bus, "MVAr", "shedding")
        model.slacks["q_unserved"] = Slack("q_unserved", "bus", soft_q, Side.BELOW)
        model.report("load", "q_unserved", reactive, unit="MVAr", description="unserved reactive demand")
        mean = 0.5 * (share + share_q) if model.split_shedding else share
        model.penalise(price * np.sqrt(p**2 + q**2) * mean)
