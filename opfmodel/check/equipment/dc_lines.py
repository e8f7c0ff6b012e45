"""DC lines."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from opfmodel.check.equipment.base import Equipment
from opfmodel.check.trajectories import Array, Complex
from opfmodel.network.components import DCLine

__all__ = ["DCLines"]

_LEAST = 1e-6


class DCLines(Equipment):
    """Limits of active and reactive power, and the loss between the ends."""

    component = DCLine

    def check(self) -> None:
        """Check limits, and that the line loses what its power implies."""
        checker, lines = self.checker, self.items
        checker.inside("DC line p", lines, lines.values("dc_line_pf"), lines.left("p"), "MW")
        if checker.reactive:
            for end, quantity in (("from", "dc_line_qf"), ("to", "dc_line_qt")):
                limits = lines.left(f"q_{end}")
                checker.inside(f"DC line q {end}", lines, lines.values(quantity), limits, "MVAr")
        if lines.names:
            self._check_loss()

    def _check_loss(self) -> None:
        """Check the loss; a line that may carry power both ways may waste some, as if it carried both."""
        checker, lines = self.checker, self.items
        pf, pt = lines.values("dc_line_pf"), lines.values("dc_line_pt")
        share = lines.constant("loss")
        sent, received = np.maximum(pf, 0.0), np.maximum(-pf, 0.0)
        backward = share / (1.0 - share)  # per power that the from end receives
        least = share * sent + backward * received + lines.constant("loss_fixed") * lines.status()
        low, high = lines.left("p")
        with np.errstate(invalid="ignore"):  # infinite on both sides
            room = np.minimum(np.maximum(high, 0.0) - sent, np.maximum(-low, 0.0) - received)
        both = np.where((share > 0) & (low < 0) & (high > 0), np.maximum(room, 0.0), 0.0)
        wasted = pf + pt - least
        most = np.where(both > 0, (share + backward) * both, 0.0)
        checker.note("DC line loss", lines.names, np.maximum(-wasted, wasted - most), "MW")
        told = (both > 0) & (share > _LEAST)  # below it the waste is rounding
        overlap = np.divide(wasted, share + backward, out=np.zeros_like(wasted), where=told)
        known = checker.report.simultaneous
        checker.report.simultaneous = max(known, float(np.fmax.reduce(overlap, axis=None)) / checker.base)
        if checker.has("dc_line_loss"):
            stated = np.abs(lines.values("dc_line_loss") - pf - pt)
            checker.note("DC line reported loss", lines.names, stated, "MW")

    def power(self) -> Iterator[tuple[list[str], Complex]]:
        """Yield what the converters inject at both ends."""
        checker, lines = self.checker, self.items
        for end, active, reactive in (
            ("from_bus", "dc_line_pf", "dc_line_qf"),
            ("to_bus", "dc_line_pt", "dc_line_qt"),
        ):
            injected = -lines.values(active) + 0j
            if checker.reactive:
                injected += 1j * lines.values(reactive)
            yield lines.each(end), injected / checker.base

    def cost_rate(self) -> Array:
        """Cost of the power at the from end."""
        rate = self.items.number("cost") * np.abs(self.items.values("dc_line_pf"))
        return np.asarray(rate.sum(axis=0))
