"""Loads."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from opfmodel.model import Device, Model, Side, Slack
from opfmodel.network.arrays import PerUnitNetwork, Table
from opfmodel.network.components import Load
from solvers import Expression, Solution

__all__ = ["LoadDevice"]


class LoadDevice(Device):
    r"""Fixed demand ``p + jq``, a parameter of every solve.

    In an elastic problem a share of each load may be left unserved, active and reactive alike, at the
    shedding price times its apparent power. The shortfall is reported as reactive where
    :math:`\lambda_q q > \lambda_p p` and as active otherwise, with the prices :math:`\lambda` of the
    minimum-penalty solution.
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
        share = model.variable("load", "unserved", 0.0, 1.0, unit="", start=0.0, publish=False)
        active, reactive = p * share, q * share
        model.inject(table.bus, p=active, q=reactive)
        soft = model.soft_balance(table.bus, "MW", "shedding")
        apparent = np.sqrt(p**2 + q**2) if model.reactive else np.sqrt(p**2)
        model.penalise(model.penalty(soft) * apparent * share)
        model.report("load", "p_unserved", active, unit="MW", description="unserved active demand")
        if not model.reactive:
            model.slacks["p_unserved"] = Slack("p_unserved", "bus", soft, Side.BELOW)
            return
        model.report("load", "q_unserved", reactive, unit="MVAr", description="unserved reactive demand")
        soft_q = model.soft_balance(table.bus, "MVAr", "shedding")

        def lacks_reactive(least: Solution, network: PerUnitNetwork) -> npt.NDArray[np.bool_]:
            worth = [
                -least.dual(rows)[model.zones[table.bus]] * network.load.arrays[field]
                for rows, field in (("p_balance", "p"), ("q_balance", "q"))
            ]
            return np.asarray(worth[1] > worth[0])

        def lacks_active(least: Solution, network: PerUnitNetwork) -> npt.NDArray[np.bool_]:
            return ~lacks_reactive(least, network)

        model.slacks["p_unserved"] = Slack("p_unserved", "bus", soft, Side.BELOW, counts=lacks_active)
        model.slacks["q_unserved"] = Slack("q_unserved", "bus", soft_q, Side.BELOW, counts=lacks_reactive)
