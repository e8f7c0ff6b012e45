"""Linear active-power formulations: DC power flow in the variants of PowerModels and MATPOWER."""

from __future__ import annotations

from typing import ClassVar

from opfmodel.errors import listed
from opfmodel.formulations.base import (
    Formulation,
    angles,
    limit_angle,
    limit_flows,
    publish_flows,
    refuse_resistive,
    resistive,
    shunts,
)
from opfmodel.formulations.settings import shift_beyond
from opfmodel.model import Model
from opfmodel.network.arrays import Array, PerUnitNetwork
from solvers import Expression

__all__ = ["DC", "DCMatpower"]


class DC(Formulation):
    r"""DC power flow in PowerModels' DCP form, which gives the DC column of PGLib; linear.

    .. math::
        p_f = -p_t = \frac{x}{r^2 + x^2} (\theta_f - \theta_t)

    Neglects losses, reactive power, voltage magnitudes (1 p.u.), taps and constant phase shifts; adjustable
    ones act. Shunts draw their power at 1 p.u. Source: the DCP form of PowerModels.jl.
    """

    name = "dc"
    reactive = False
    publishes = ("va", "pf", "pt")
    physics = "dc"
    shifted: ClassVar[bool] = False  # whether flow() has the phase shifts

    def flow(self, network: PerUnitNetwork, angle: Expression) -> Expression:
        """Return the flow from the from end to the to end, given the angle across each branch."""
        branch = network.branch
        susceptance: Array = branch.x / (branch.r**2 + branch.x**2)
        return angle * susceptance

    def notes(self, network: PerUnitNetwork) -> tuple[str, ...]:
        """Return which branches carry no flow."""
        names = resistive(network)
        return (f"branches without reactance carry no flow: {listed(names)}",) if names else ()

    def declare(self, model: Model) -> None:
        """Declare ``va`` and the branch flows."""
        branch = model.network.branch
        va = angles(model)
        shunts(model, 1.0)
        angle = va[branch.from_bus] - va[branch.to_bus]
        behind = angle - shift_beyond(model, branch.shift if self.shifted else 0.0)
        flow = model.switched(self.flow(model.network, behind))
        publish_flows(model, flow, None, -flow, None)
        model.inject(branch.from_bus, p=-flow)
        model.inject(branch.to_bus, p=flow)
        limit_flows(model, rating=flow)
        limit_angle(model, angle)


class DCMatpower(DC):
    r"""DC power flow in MATPOWER's form, with taps and phase shifts; linear.

    .. math::
        p_f = -p_t = \frac{1}{x \tau} (\theta_f - \theta_t - \phi)

    Neglects losses, resistance, reactive power and voltage magnitudes (1 p.u.). Source: Zimmerman and
    Murillo-Sánchez, MATPOWER User's Manual, section 3.7.
    """

    name = "dc-matpower"
    shifted = True

    def flow(self, network: PerUnitNetwork, angle: Expression) -> Expression:
        """Return the flow from the from end to the to end, given the angle across each branch."""
        branch = network.branch
        refuse_resistive(network, self.name)
        susceptance: Array = 1.0 / (branch.x * branch.tap)
        shifted: Expression = angle - branch.shift
        return shifted * susceptance
