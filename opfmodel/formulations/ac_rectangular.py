"""The AC formulation in rectangular coordinates."""

from __future__ import annotations

import numpy as np

from opfmodel.formulations.base import (
    Formulation,
    limit_products,
    publish_flows,
    shunts,
    soft_voltage,
    transport,
)
from opfmodel.formulations.settings import flows
from opfmodel.model import Model
from opfmodel.network.physics import rectangular_products
from solvers import Expression

__all__ = ["ACRectangular"]


class ACRectangular(Formulation):
    r"""AC power flow in real and imaginary parts of the voltages; exact, non-convex.

    The flows are those of :class:`opfmodel.formulations.ac.AC` with the products

    .. math::
        w = e^2 + f^2, \quad w_r = e_f e_t + f_f f_t, \quad w_i = f_f e_t - e_f f_t

    Every equation is quadratic, and the limits :math:`v_{min}^2 \le w \le v_{max}^2` are
    non-convex rows. Source: the ACR form of PowerModels.jl.
    """

    name = "ac-rectangular"
    reactive = True
    publishes = ("vm", "va", "pf", "qf", "pt", "qt")
    physics = "ac"
    relaxed_by = "soc"

    def declare(self, model: Model) -> None:
        """Declare ``vr``, ``vi`` and the branch flows; publish ``vm`` and ``va``."""
        network = model.network
        bus, branch = network.bus, network.branch
        reference = np.zeros((len(bus), 1), dtype=bool)
        reference[network.reference] = True
        start = np.clip(1.0, bus.vm_min, bus.vm_max)
        most = bus.vm_max if model.elastic is None else np.full((len(bus), 1), np.inf)
        vr = model.variable(
            "bus", "vr", np.where(reference, 0.0, -most), most,
            unit="p.u.", start=start * np.cos(network.resting_angle), publish=False,
        )  # fmt: skip
        vi = model.variable(
            "bus", "vi", np.where(reference, 0.0, -most), np.where(reference, 0.0, most),
            unit="p.u.", start=start * np.sin(network.resting_angle), publish=False,
        )  # fmt: skip
        w = vr**2 + vi**2
        soft = soft_voltage(model, squared=True)
        model.rows("bus", "vm_squared", w, lambda t: t.vm_min**2, lambda t: t.vm_max**2, soft)
        model.publish("bus", "vm", np.sqrt(w), unit="p.u.", description="voltage magnitude")
        angle: Expression = np.arctan2(vi, vr)  # type: ignore[call-overload]
        model.publish("bus", "va", angle, unit="deg", description="voltage angle")
        shunts(model, w)
        f, t = branch.from_bus, branch.to_bus
        products = rectangular_products(vr[f], vi[f], vr[t], vi[t])
        power = flows(model, *products)
        publish_flows(model, *power)
        transport(model, *power)
        limit_products(model, products[2], products[3])
