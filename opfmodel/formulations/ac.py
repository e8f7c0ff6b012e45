"""The AC formulation in polar coordinates."""

from __future__ import annotations

import numpy as np

from opfmodel.formulations.base import (
    Formulation,
    angles,
    limit_angle,
    publish_flows,
    shunts,
    soft_voltage,
    transport,
)
from opfmodel.formulations.settings import flows
from opfmodel.model import Model
from opfmodel.network.physics import polar_products

__all__ = ["AC"]


class AC(Formulation):
    r"""AC power flow in voltage magnitudes and angles; exact, non-convex.

    .. math::
        S_f = y_{ff}^* v_f^2 + y_{ft}^* v_f v_t e^{j\theta}, \quad
        S_t = y_{tt}^* v_t^2 + y_{tf}^* v_f v_t e^{-j\theta}, \quad
        |S_f|, |S_t| \le rating, \quad \theta_{min} \le \theta \le \theta_{max}

    with :math:`\theta = \theta_f - \theta_t`. The ratio and the phase shift of a transformer in the
    admittances may be decided. Source: Zimmerman and Murillo-Sánchez, MATPOWER
    User's Manual, sections 3 and 6.1.
    """

    name = "ac"
    reactive = True
    publishes = ("vm", "va", "pf", "qf", "pt", "qt")
    physics = "ac"
    relaxed_by = "soc"

    def declare(self, model: Model) -> None:
        """Declare ``vm``, ``va`` and the branch flows."""
        network = model.network
        bus, branch = network.bus, network.branch
        start = np.clip(1.0, bus.vm_min, bus.vm_max)
        vm = model.variable(
            "bus", "vm", "vm_min", "vm_max",
            unit="p.u.", start=start, description="voltage magnitude", soft=soft_voltage(model),
        )  # fmt: skip
        va = angles(model)
        shunts(model, vm**2)
        f, t = branch.from_bus, branch.to_bus
        angle = va[f] - va[t]
        power = flows(model, *polar_products(vm[f], vm[t], angle))
        publish_flows(model, *power)
        transport(model, *power)
        limit_angle(model, angle)
