"""Linearised DistFlow."""

from __future__ import annotations

import numpy as np

from opfmodel.errors import IncompatibleError
from opfmodel.formulations import Formulation
from opfmodel.formulations.base import publish_flows, shunts
from opfmodel.model import Model

__all__ = ["LinDistFlow"]


class LinDistFlow(Formulation):
    r"""Lossless power flow of radial grids in squared voltages; linear, or conic with ratings.

    .. math::
        w_t = w_f / \tau^2 - 2 (r p_f + x q_f), \quad p_t = -p_f, \quad q_t = -q_f, \quad
        p_f^2 + q_f^2 \le rating^2

    with :math:`w = v^2`. Neglects losses, line charging and angles. Source: M. Baran and F. Wu,
    "Network reconfiguration in distribution systems for loss reduction and load balancing",
    IEEE Trans. Power Delivery 4(2), 1989.
    """

    name = "lindistflow"
    reactive = True
    publishes = ("w", "pf", "qf", "pt", "qt")

    def declare(self, model: Model) -> None:
        """Declare ``w`` and the branch flows."""
        network = model.network
        branch = network.branch
        if len(branch) > len(network.bus) - network.n_islands:
            raise IncompatibleError(
                f"formulation 'lindistflow' is for radial grids; {network.name!r} has a loop"
            )
        w = model.variable(
            "bus", "w", lambda t: t.vm_min**2, lambda t: t.vm_max**2,
            unit="p.u.^2", start=1.0, description="squared voltage magnitude",
        )  # fmt: skip
        shunts(model, w)
        pf = model.variable("branch", "pf", unit="MW", start=0.0, publish=False)
        qf = model.variable("branch", "qf", unit="MVAr", start=0.0, publish=False)
        publish_flows(model, pf, qf, -pf, -qf)
        f, t = branch.from_bus, branch.to_bus
        drop = w[f] / branch.tap**2 - w[t] - 2.0 * (branch.r * pf + branch.x * qf)
        model.rows("branch", "voltage_drop", drop, 0.0, 0.0)
        model.inject(f, p=-pf, q=-qf)
        model.inject(t, p=pf, q=qf)
        rated = np.flatnonzero(np.isfinite(branch.rating))
        if rated.size:
            rating = model.field("branch", "rating")[rated]
            model.build.cone("branch_rating", rating, pf[rated], qf[rated])
