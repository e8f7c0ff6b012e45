"""DC power flow with quadratic losses."""

from __future__ import annotations

import numpy as np

from opfmodel.formulations.base import (
    Formulation,
    angles,
    limit_angle,
    limit_flows,
    publish_flows,
    refuse_resistive,
    shunts,
)
from opfmodel.formulations.settings import shift_beyond
from opfmodel.model import Model

__all__ = ["DCLosses"]

_SCALE = 0.01  # p.u. of loss; gives the entries of its cone similar magnitudes


class DCLosses(Formulation):
    r"""DC power flow with a convex quadratic loss on every branch; a second-order cone program.

    .. math::
        p_f = b\theta + \tfrac{1}{2} l, \quad p_t = -b\theta + \tfrac{1}{2} l, \quad
        l \ge g \theta^2, \quad g + jb' = \frac{1}{r + jx}, \quad b = -b'

    The loss is the second-order term of the AC loss at flat voltages. The inequality is tight where
    energy has a positive price; elsewhere fictitious losses may absorb power. Neglects
    reactive power, voltage magnitudes (1 p.u.), taps and constant phase shifts; adjustable ones act.
    Source: C. Coffrin, P. Van
    Hentenryck and R. Bent, "Approximating line losses and apparent power in AC power flow
    linearizations", IEEE PES General Meeting 2012.
    """

    name = "dc-losses"
    reactive = False
    publishes = ("va", "loss", "pf", "pt")
    slack_losses = True

    def declare(self, model: Model) -> None:
        """Declare ``va``, the losses and the branch flows."""
        branch = model.network.branch
        refuse_resistive(model.network, self.name)
        va = angles(model)
        shunts(model, 1.0)
        angle = va[branch.from_bus] - va[branch.to_bus]
        behind = angle - shift_beyond(model, 0.0)
        impedance = branch.r**2 + branch.x**2
        flow = model.switched(branch.x / impedance * behind)
        conductance = branch.r / impedance
        lossy = np.flatnonzero(conductance > 0)
        upper = np.where(conductance > 0, np.inf, 0.0)
        loss = model.variable("branch", "loss", 0.0, upper, unit="MW", description="active losses", start=0.0)
        if lossy.size:
            # 4 g theta^2 + (1 - l)^2 <= (1 + l)^2 means l >= g theta^2
            scaled = loss[lossy] / _SCALE
            root = 2.0 * np.sqrt(conductance[lossy] / _SCALE)
            model.build.cone("branch_loss", 1.0 + scaled, 1.0 - scaled, root * model.switched(behind)[lossy])
        pf, pt = flow + 0.5 * loss, -flow + 0.5 * loss
        publish_flows(model, pf, None, pt, None)
        model.inject(branch.from_bus, p=-pf)
        model.inject(branch.to_bus, p=-pt)
        limit_flows(model, rating_from=pf, rating_to=pt)
        limit_angle(model, angle)
