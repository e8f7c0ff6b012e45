"""Branch flows by formulation: complex power into both ends of each branch, p.u."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from opfmodel.check.trajectories import Array, Complex, Items

if TYPE_CHECKING:
    from opfmodel.check.checker import Checker

__all__ = ["Flows", "ac_flows", "flows"]

Flows = tuple[Complex, Complex]  # power into the from and to ends of each branch, p.u.


def flows(c: Checker) -> Flows | None:
    """Flows by the equations of the formulation, or as reported if it is unknown; None if there are none."""
    made = _FLOWS.get(c.formulation, _reported_flows)(c)
    if made is None:
        return None
    status = c.branches.status()
    return made[0] * status, made[1] * status


def _phasor(magnitude: Array, degrees: Array) -> Complex:
    angle = np.deg2rad(degrees)
    return np.asarray(magnitude * (np.cos(angle) + 1j * np.sin(angle)))


def _series_admittance(branches: Items) -> Complex:
    return np.asarray(1 / (branches.constant("r") + 1j * branches.constant("x")))


def _end_shunts(branches: Items) -> tuple[Complex, Complex]:
    """Admittance to ground at the from and to ends: half the line charging plus the shunt of that end."""
    half = (branches.constant("g") + 1j * branches.constant("b")) / 2
    at_from = half + branches.constant("g_from") + 1j * branches.constant("b_from")
    at_to = half + branches.constant("g_to") + 1j * branches.constant("b_to")
    return at_from, at_to


def ac_flows(c: Checker) -> Flows:
    """Flows of the π model with an ideal transformer at the from end, from complex voltages."""
    v_from, v_to = map(_phasor, c.ends("vm"), c.ends("va"))
    ratio = _phasor(c.branches.setting("tap", "tap"), c.branches.setting("shift", "shift"))
    series, (shunt_from, shunt_to) = _series_admittance(c.branches), _end_shunts(c.branches)
    behind = v_from / ratio  # voltage behind the ideal transformer
    current_behind = (behind - v_to) * series + behind * shunt_from
    current_to = (v_to - behind) * series + v_to * shunt_to
    return behind * current_behind.conj(), v_to * current_to.conj()


def _soc_flows(c: Checker) -> Flows:
    """Flows of the π model from voltage products; also check that the products lie in their cone."""
    w_from, w_to = c.ends("w")
    ratio = _phasor(c.branches.neutral("tap"), c.branches.neutral("shift"))
    if c.has("w_inner"):  # products of the voltages behind adjustable transformers, with their ranges
        (least, most), (low, high) = c.branches.span("tap"), c.branches.span("shift")
        behind, inner = (least < most) | (low < high), c.branches.values("w_inner")
        outside = np.maximum(least**2 * inner - w_from, w_from - most**2 * inner)
        c.note("voltage behind transformers", c.branches.names, np.where(behind, outside, 0.0), "p.u.")
        w_from = np.where(behind, inner, w_from)
        left = _phasor(np.ones_like(least), np.where(low < high, 0.0, c.branches.neutral("shift")))
        ratio = np.where(behind, left, ratio)
    product = c.branches.values("wr") + 1j * c.branches.values("wi")  # v_from v_to*
    c.note("voltage products", c.branches.names, np.abs(product) ** 2 - w_from * w_to, "p.u.")
    series, (shunt_from, shunt_to) = _series_admittance(c.branches), _end_shunts(c.branches)
    at_from = (series + shunt_from).conj() * w_from / np.abs(ratio) ** 2 - series.conj() * product / ratio
    at_to = (series + shunt_to).conj() * w_to - series.conj() * product.conj() / ratio.conj()
    return at_from, at_to


def _behind(c: Checker) -> Array:
    """Angle differences behind adjustable phase shifters, degrees; constant shifts are neglected."""
    low, high = c.branches.span("shift")
    shift = np.where(low < high, c.branches.setting("shift", "shift"), 0.0)
    return np.asarray(c.angles() - shift)


def _dc_flows(c: Checker) -> Flows:
    """Flows as susceptance x / (r² + x²) times the angle difference."""
    flow = -_series_admittance(c.branches).imag * np.deg2rad(_behind(c)) + 0j
    return flow, -flow


def _dc_matpower_flows(c: Checker) -> Flows:
    """Flows as susceptance 1 / (x tap) times the angle difference minus the phase shift."""
    susceptance = 1 / (c.branches.constant("x") * c.branches.neutral("tap"))
    flow = susceptance * np.deg2rad(c.angles() - c.branches.setting("shift", "shift")) + 0j
    return flow, -flow


def _dc_losses_flows(c: Checker) -> Flows:
    """Lossless flows plus half the loss at each end; also check that the loss is at least g angle²."""
    flow, _ = _dc_flows(c)
    loss = c.branches.values("loss") / c.base
    least = c.branches.status() * _series_admittance(c.branches).real * np.deg2rad(_behind(c)) ** 2
    c.note("branch loss", c.branches.names, c.base * np.maximum(least - loss, -loss), "MW")
    return flow + loss / 2, -flow + loss / 2


def _reported_flows(c: Checker) -> Flows | None:
    """Flows reported by an unknown formulation; None if it reports none."""
    c.leave_out(f"branch equations of the formulation {c.formulation!r}")
    if not c.angles_known and c.limited_angles().any():
        c.leave_out("angle differences")
    if c.reactive and not c.voltages_known:
        c.leave_out("voltages")
    if not c.has("pf", "pt") or (c.reactive and not c.has("qf", "qt")):
        return None
    return c.power("pf", "qf", c.branches), c.power("pt", "qt", c.branches)


_FLOWS: dict[str, Callable[[Checker], Flows | None]] = {
    "ac": ac_flows,
    "ac-rectangular": ac_flows,
    "soc": _soc_flows,
    "dc": _dc_flows,
    "dc-matpower": _dc_matpower_flows,
    "dc-losses": _dc_losses_flows,
    "copperplate": lambda _: None,
}
