"""The second-order cone relaxation of the AC equations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from opfmodel.formulations.base import (
    Formulation,
    limit_products,
    price_rating,
    publish_flows,
    shunts,
    soft_rating,
)
from opfmodel.formulations.settings import Terminals, adjustable, behind_transformers
from opfmodel.model import Model, Side
from opfmodel.network.arrays import Index, PerUnitNetwork
from opfmodel.network.physics import Array, branch_flow
from solvers import Expression, Solution

__all__ = ["SOC"]

_UNTIED = 1e-9  # weight of an angle of zero for buses that only adjustable phase shifters tie to the others


class SOC(Formulation):
    r"""Jabr's relaxation in voltage products (SOCWR); convex.

    The flows of :class:`opfmodel.formulations.ac.AC` are linear in :math:`w = v^2` at the buses
    and in :math:`w_r = v_f v_t \cos\theta`, :math:`w_i = v_f v_t \sin\theta` of each pair of
    neighbours. Of the relations between the three, only

    .. math::
        w_r^2 + w_i^2 \le w_f w_t

    is kept, with the angle-difference limits, the bounds of the products that follow from the
    bounds of voltages and angles, and the lifted nonlinear cuts of the two. Of an adjustable transformer, the
    voltages behind it count; see :func:`opfmodel.formulations.settings.behind_transformers`. The relaxation
    is exact on
    radial networks under mild conditions, and its optimum is a lower bound on that of the AC equations.
    Sources: R. Jabr, "Radial distribution load flow using conic programming", IEEE Trans. Power
    Systems 21(3), 2006; the SOCWR form of PowerModels.jl; for the cuts C. Coffrin, H. Hijazi and
    P. Van Hentenryck, "Strengthening the SDP relaxation of AC power flows with convex envelopes,
    bound tightening, and valid inequalities", IEEE Trans. Power Systems 32(5), 2017.
    """

    name = "soc"
    reactive = True
    publishes = ("w", "pf", "qf", "pt", "qt")
    relaxed_by = "soc"

    def declare(self, model: Model) -> None:
        """Declare ``w`` and the voltage products of neighbours; report ``vm = sqrt(w)``."""
        network = model.network
        bus, branch = network.bus, network.branch
        start = np.clip(1.0, bus.vm_min, bus.vm_max) ** 2
        w = model.variable(
            "bus", "w", lambda t: t.vm_min**2, lambda t: t.vm_max**2,
            unit="p.u.^2", start=start, description="squared voltage magnitude",
        )  # fmt: skip
        model.report("bus", "vm", np.sqrt(w), unit="p.u.", description="square root of w")
        shunts(model, w, relaxed=True)
        at, terminals = behind_transformers(model, w)
        n = _Neighbours.of(network, terminals, _loose(model))
        pairs = len(n.first)
        least, most = terminals.vm_min, terminals.vm_max
        bounds = n.product_bounds(least[n.first] * least[n.second], most[n.first] * most[n.second])
        near = [np.clip(at, low, high) for at, low, high in ((1.0, *bounds[:2]), (0.0, *bounds[2:]))]
        wr = model.build.variable("wr", pairs, model.stages, *bounds[:2], start=near[0])
        wi = model.build.variable("wi", pairs, model.stages, *bounds[2:], start=near[1])
        at_first, at_second = at[n.first], at[n.second]
        model.build.cone(
            "voltage_products", 0.5 * (at_first + at_second), 0.5 * (at_first - at_second), wr, wi
        )
        _lifted_cuts(model, n, terminals, at, wr, wi)
        f, t = branch.from_bus, branch.to_bus
        branch_r, branch_i = wr[n.pair], n.sign * wi[n.pair]
        admittance = network.admittance_at(terminals.tap, terminals.shift)
        if model.status is not None:
            admittance = admittance * model.status
        flows = branch_flow(admittance, at[terminals.at_from], w[t], branch_r, branch_i)
        publish_flows(model, *flows)
        model.inject(f, p=-flows[0], q=-flows[1])
        model.inject(t, p=-flows[2], q=-flows[3])
        limited = np.flatnonzero(np.isfinite(branch.rating))
        if limited.size:
            rating = model.field("branch", "rating")[limited]
            for name, p, q in (("rating_from", *flows[:2]), ("rating_to", *flows[2:])):
                bound = rating
                if model.elastic is not None:
                    soft = soft_rating(limited)
                    bound = model.slack("branch", f"{name}_above", soft, Side.ABOVE) + rating
                model.build.cone(name, bound, p[limited], q[limited])

            def read(solution: Solution, _: PerUnitNetwork) -> Array:
                both: Array = solution.cone_dual("rating_from")[0] + solution.cone_dual("rating_to")[0]
                return both

            price_rating(model, limited, read)
        limit_products(model, branch_r, branch_i, (-terminals.shift_max, -terminals.shift_min))
        model.report("branch", "wr", branch_r, unit="p.u.^2", description="real product of the voltages")
        model.report("branch", "wi", branch_i, unit="p.u.^2", description="imaginary product of the voltages")

    def relaxation(self, solution: Solution, network: PerUnitNetwork) -> dict[str, float]:
        """Return the largest cone slack (p.u.) and the largest angle mismatch around a loop (degrees).

        The relaxation is exact if both vanish; a radial network has no loops.
        """
        if not len(network.branch):
            return {"largest_cone_slack": 0.0, "largest_angle_mismatch": 0.0}
        t, *u = solution.cone("voltage_products")
        slack = np.maximum(t - np.linalg.norm(u, axis=0), 0.0).max()
        angle = np.arctan2(solution.value("wi"), solution.value("wr"))
        return {
            "largest_cone_slack": float(slack),
            "largest_angle_mismatch": float(np.rad2deg(_angle_mismatch(network, angle))),
        }


@dataclass(frozen=True)
class _Neighbours:
    """Pairs of terminals connected by branches, and the orientation of the branches.

    Attributes
    ----------
    first, second
        Terminals of each pair, the lower position first.
    pair, sign
        Pair of each branch, and 1 if it runs from first to second, -1 otherwise.
    low, high
        Angle range of each pair, the tightest of parallel branches; within ±pi. One column, or one per stage.
    """

    first: Index
    second: Index
    pair: Index
    sign: Array
    low: Array
    high: Array

    @classmethod
    def of(cls, network: PerUnitNetwork, terminals: Terminals, loose: npt.NDArray[np.bool_]) -> _Neighbours:
        """Return the neighbours of a network.

        Parameters
        ----------
        loose
            Which branches limit no angle, ``(branches, 1)`` or ``(branches, stages)``.
        """
        branch = network.branch
        ends = np.column_stack([terminals.at_from, terminals.at_to])
        angle_min, angle_max = branch.angle_min - terminals.shift_max, branch.angle_max - terminals.shift_min
        pairs, pair = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True)
        pair = pair.ravel()
        along = (ends[:, 0] <= ends[:, 1])[:, None]
        loose = loose | (angle_min < -np.pi) | (angle_max > np.pi)  # beyond it angles repeat
        shape = len(pairs), loose.shape[1]
        low, high = np.full(shape, -np.pi), np.full(shape, np.pi)
        least = np.where(loose, -np.inf, angle_min)
        most = np.where(loose, np.inf, angle_max)
        np.maximum.at(low, pair, np.where(along, least, -most))
        np.minimum.at(high, pair, np.where(along, most, -least))
        return cls(pairs[:, 0], pairs[:, 1], pair, np.where(along, 1.0, -1.0), low, high)

    def product_bounds(self, least: Array, most: Array) -> tuple[Array, Array, Array, Array]:
        """Return bounds of ``w_r``, then of ``w_i``, for a range of the product of the magnitudes.

        Cosine and sine take their extremes over an interval at its ends or at a stationary point inside
        it; their products with a magnitude do so at an end of its range.
        """
        bounds = []
        for function, peaks in ((np.cos, (0.0,)), (np.sin, (-np.pi / 2, np.pi / 2))):
            ends = [function(self.low), function(self.high)]
            inside = [
                np.where((self.low <= peak) & (peak <= self.high), function(peak), ends[0]) for peak in peaks
            ]
            smallest, largest = np.min([*ends, *inside], axis=0), np.max([*ends, *inside], axis=0)
            bounds += [
                np.minimum(smallest * least, smallest * most),
                np.maximum(largest * least, largest * most),
            ]
        return bounds[0], bounds[1], bounds[2], bounds[3]


def _loose(model: Model) -> npt.NDArray[np.bool_]:
    """Return which branches limit no angle in which stages, because they are or may be out of service."""
    branch = model.network.branch
    if ("branch", "status") not in model.series:
        return np.zeros((len(branch), 1), dtype=bool)
    declared = np.array([[name in model.outages] for name in branch.names], dtype=bool)
    return np.asarray((branch.status == 0.0) | declared)


def _angle_mismatch(network: PerUnitNetwork, angle: Array) -> float:
    """Return the largest difference between branch angles and the bus angles that fit them best."""
    from scipy.sparse.linalg import splu

    branch, n = network.branch, len(network.bus)
    rows = np.arange(len(branch))
    across = sp.coo_array(
        (
            np.tile([[1.0], [-1.0]], len(branch)).ravel(),
            (np.tile(rows, 2), np.r_[branch.from_bus, branch.to_bus]),
        ),
        shape=(len(branch), n),
    ).tocsc()
    free = adjustable(branch, "shift")[:, 0]
    across, angle = across[~free], angle[~free]
    fixed = np.full(n, _UNTIED)
    fixed[network.reference] = 1.0
    fit = splu((across.T @ across + sp.diags_array(fixed)).tocsc()).solve(across.T @ angle)
    return float(np.abs(angle - across @ fit).max())


def _lifted_cuts(
    model: Model, n: _Neighbours, terminals: Terminals, w: Expression, wr: Expression, wi: Expression
) -> None:
    r"""Add the lifted nonlinear cuts of pairs where their angle range is less than 180 degrees.

    With :math:`\phi` and :math:`\delta` the middle and half-width of the angle range and
    :math:`\sigma = v_{min} + v_{max}` at each end, they bound
    :math:`\sigma_i \sigma_j (w_r \cos\phi + w_i \sin\phi)` from below by planes in
    :math:`w_i, w_j` that touch the feasible set at the corners of the voltage box.
    """
    narrow = n.high - n.low < np.pi
    members = np.flatnonzero(narrow.any(axis=1))
    if not members.size:
        return
    least, most = terminals.vm_min, terminals.vm_max
    i, j = n.first[members], n.second[members]
    phi, delta = 0.5 * (n.high + n.low)[members], 0.5 * (n.high - n.low)[members]
    low_i, high_i, low_j, high_j = least[i], most[i], least[j], most[j]
    sum_i, sum_j = low_i + high_i, low_j + high_j
    along = (sum_i * sum_j) * (np.cos(phi) * wr[members] + np.sin(phi) * wi[members])
    spread = np.cos(delta) * (low_i * low_j - high_i * high_j)
    for name, at_i, at_j, sign in (("cut_high", high_i, high_j, 1.0), ("cut_low", low_i, low_j, -1.0)):
        plane = (at_j * np.cos(delta) * sum_j) * w[i] + (at_i * np.cos(delta) * sum_i) * w[j]
        least = np.where(narrow[members], sign * at_i * at_j * spread, -np.inf)
        rows = model.build.rows(name, members.size, model.stages, least, np.inf)
        model.build.add(along - plane, into=rows)
