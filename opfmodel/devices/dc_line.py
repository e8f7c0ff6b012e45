"""Point-to-point DC lines."""

from __future__ import annotations

from typing import Any

import numpy as np

from opfmodel.model import Device, Model, Stage
from opfmodel.network.arrays import Array, Table
from opfmodel.network.components import DCLine
from solvers import Expression, largest, total

__all__ = ["DESCRIBED", "DCLineDevice"]


DESCRIBED = {
    "dc_line_forward": "power that the from end sends; without proportional loss, less what it receives",
    "dc_line_backward": "power that the from end receives, of lines with proportional loss",
    "dc_line_qf": "reactive power that the converter injects into the from bus",
    "dc_line_qt": "reactive power that the converter injects into the to bus",
}
"""Description of each quantity that is decided."""


class DCLineDevice(Device):
    r"""DC lines whose losses grow with the power in either direction.

    With f sent forward by the from end and :math:`\beta` received backward there,

    .. math::
        p_f = f - \beta, \quad p_t = \frac{\beta}{1 - l_1} - (1 - l_1) f + l_0, \quad
        p_{min} \le p_f \le p_{max}, \quad f, \beta \ge 0

    where :math:`p_f` and :math:`p_t` enter the line at its ends. Without :math:`l_1`, f has either sign and
    :math:`\beta = 0`. With it, f and :math:`\beta` relax :math:`|p_f|`: both at once waste energy, which
    pays only where energy has a negative value. The linear loss is that of MATPOWER's ``dcline`` for
    power that flows forward; source: R. D. Zimmerman and C. E. Murillo-Sánchez, "MATPOWER User's Manual",
    version 7.1, section 7.6.3.

    Cost: :math:`c\,|p_f|`.
    """

    component = DCLine
    waste = ("dc_line_loss",)

    def declare(self, model: Model, table: Table) -> None:
        """Declare ``dc_line_forward``, ``dc_line_backward`` and the reactive power of converters."""
        forward, backward = (
            model.variable("dc_line", name, *limits, unit="MW", description=DESCRIBED[name])
            for name, limits in (
                ("dc_line_forward", (_least_forward, _most_forward)),
                ("dc_line_backward", (_least_backward, _most_backward)),
            )
        )
        qf = qt = None
        if model.reactive:
            qf, qt = (
                model.variable(
                    "dc_line", name, f"{field}_min", f"{field}_max", unit="MVAr", description=DESCRIBED[name]
                )
                for name, field in (("dc_line_qf", "q_from"), ("dc_line_qt", "q_to"))
            )
            model.regularise(qf)
            model.regularise(qt)
        self.connect(model, table, (forward, backward), (qf, qt))

    @staticmethod
    def connect(
        model: Model,
        table: Table,
        p: tuple[Expression, Expression],
        q: tuple[Expression | None, Expression | None],
    ) -> None:
        """Publish the power at both ends, and inject it.

        Parameters
        ----------
        p
            Power that the from end sends forward, and that it receives backward.
        q
            Reactive power injected into the from and to buses.
        """
        (forward, backward), arrives = p, 1.0 - table.loss
        pf = forward - backward
        pt = backward / arrives - arrives * forward + model.field("dc_line", "loss_fixed")
        for name, values, description in (
            ("dc_line_pf", pf, "active power that enters the line at its from end"),
            ("dc_line_pt", pt, "active power that enters the line at its to end"),
            ("dc_line_loss", pf + pt, "loss of the line"),
        ):
            model.publish("dc_line", name, values, unit="MW", description=description)
        model.inject(table.from_bus, p=-pf, q=q[0])
        model.inject(table.to_bus, p=-pt, q=q[1])

    def cost(self, stage: Stage) -> Any:
        """Return the cost of the power at the from end, $/h; None if no line has one."""
        line = stage.dc_line
        if isinstance(line.cost, np.ndarray) and not line.cost.any():
            return None
        return total(line.cost * largest(line.dc_line_pf, -line.dc_line_pf))


# Without proportional loss there is no need to tell the directions apart.


def _least_forward(table: Table) -> Array:
    return np.asarray(np.where(table.loss > 0, np.maximum(table.p_min, 0.0), table.p_min))


def _most_forward(table: Table) -> Array:
    return np.asarray(np.where(table.loss > 0, np.maximum(table.p_max, 0.0), table.p_max))


def _least_backward(table: Table) -> Array:
    return np.asarray(np.where(table.loss > 0, np.maximum(-table.p_max, 0.0), 0.0))


def _most_backward(table: Table) -> Array:
    return np.asarray(np.where(table.loss > 0, np.maximum(-table.p_min, 0.0), 0.0))
