"""Branch equations as pure functions of numbers or symbols.

All functions accept floats, NumPy arrays and expressions of :mod:`solvers`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = [
    "Admittance",
    "branch_admittance",
    "branch_flow",
    "polar_products",
    "rectangular_products",
    "through_transformer",
]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Admittance:
    """Entries ``y_ab = g_ab + j b_ab`` of the two-port admittance matrices of branches, p.u."""

    g_ff: Array
    b_ff: Array
    g_ft: Array
    b_ft: Array
    g_tf: Array
    b_tf: Array
    g_tt: Array
    b_tt: Array

    def __getitem__(self, key: Any) -> Admittance:
        """Select branches."""
        return Admittance(*(getattr(self, field.name)[key] for field in fields(self)))

    def __mul__(self, factor: Any) -> Admittance:
        """Multiply the entries of each branch, with 0 for a branch that is out of service."""
        return Admittance(*(getattr(self, field.name) * factor for field in fields(self)))


def branch_admittance(
    r: Array,
    x: Array,
    g_from: Array,
    b_from: Array,
    g_to: Array,
    b_to: Array,
    tap: Array,
    shift: Array,
) -> Admittance:
    r"""Two-port admittances of the π model with an ideal transformer at the from end.

    With :math:`y = 1/(r + jx)` and :math:`a = \tau e^{j\phi}`:

    .. math::
        y_{ff} = (y + y_{from}) / \tau^2, \quad y_{ft} = -y / a^*, \quad
        y_{tf} = -y / a, \quad y_{tt} = y + y_{to}

    Parameters
    ----------
    r, x
        Series impedance, p.u.
    g_from, b_from, g_to, b_to
        Shunt admittance at each end, p.u.
    tap, shift
        Transformer ratio :math:`\tau`, and phase shift :math:`\phi` in radians.

    References
    ----------
    Zimmerman and Murillo-Sánchez, MATPOWER User's Manual, section 3.2.
    """
    y = 1.0 / (np.asarray(r) + 1j * np.asarray(x))
    ratio = tap * np.exp(1j * np.asarray(shift))
    ff = (y + g_from + 1j * np.asarray(b_from)) / np.square(tap)
    ft = -y / ratio.conj()
    tf = -y / ratio
    tt = y + g_to + 1j * np.asarray(b_to)
    return Admittance(ff.real, ff.imag, ft.real, ft.imag, tf.real, tf.imag, tt.real, tt.imag)


def polar_products(vm_f: Any, vm_t: Any, angle: Any) -> tuple[Any, Any, Any, Any]:
    r"""Voltage products of a branch from voltage magnitudes and the angle difference.

    Returns
    -------
    w_f, w_t, w_r, w_i
        :math:`v_f^2,\; v_t^2,\; v_f v_t \cos\theta,\; v_f v_t \sin\theta` with
        :math:`\theta = \theta_f - \theta_t`.
    """
    product = vm_f * vm_t
    return vm_f**2, vm_t**2, product * np.cos(angle), product * np.sin(angle)


def rectangular_products(e_f: Any, f_f: Any, e_t: Any, f_t: Any) -> tuple[Any, Any, Any, Any]:
    r"""Voltage products of a branch from the real and imaginary parts of its voltages.

    Returns
    -------
    w_f, w_t, w_r, w_i
        As :func:`polar_products`.
    """
    return e_f**2 + f_f**2, e_t**2 + f_t**2, e_f * e_t + f_f * f_t, f_f * e_t - e_f * f_t


def through_transformer(
    w_f: Any, w_t: Any, w_r: Any, w_i: Any, tap: Any, shift: Any
) -> tuple[Any, Any, Any, Any]:
    r"""Voltage products behind the ideal transformer at the from end of a branch.

    With the voltage :math:`V_f / (\tau e^{j\phi})` in place of :math:`V_f`:

    .. math::
        w_f' = w_f / \tau^2, \quad w_t' = w_t, \quad w_r' + j w_i' = (w_r + j w_i) e^{-j\phi} / \tau

    Parameters
    ----------
    tap, shift
        Ratio :math:`\tau`, and phase shift :math:`\phi` in radians; None leaves the products as they are.
    """
    if shift is not None:
        cosine, sine = np.cos(shift), np.sin(shift)
        w_r, w_i = w_r * cosine + w_i * sine, w_i * cosine - w_r * sine
    if tap is not None:
        w_f, w_r, w_i = w_f / tap**2, w_r / tap, w_i / tap
    return w_f, w_t, w_r, w_i


def branch_flow(y: Admittance, w_f: Any, w_t: Any, w_r: Any, w_i: Any) -> tuple[Any, Any, Any, Any]:
    r"""Power flowing into both ends of a branch, linear in the voltage products.

    .. math::
        S_f = y_{ff}^* w_f + y_{ft}^* (w_r + j w_i), \quad
        S_t = y_{tt}^* w_t + y_{tf}^* (w_r - j w_i)

    Returns
    -------
    pf, qf, pt, qt
        Active and reactive power into the from and to ends, p.u.
    """
    pf = y.g_ff * w_f + y.g_ft * w_r + y.b_ft * w_i
    qf = -y.b_ff * w_f - y.b_ft * w_r + y.g_ft * w_i
    pt = y.g_tt * w_t + y.g_tf * w_r - y.b_tf * w_i
    qt = -y.b_tt * w_t - y.b_tf * w_r - y.g_tf * w_i
    return pf, qf, pt, qt
