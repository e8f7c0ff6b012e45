"""Independent verification of results: recompute all constraints and the cost from the data alone.

This module shares no equations with the rest of the package. It works on declared components and on
trajectories in physical units, uses complex arithmetic, and does not depend on programs or solvers,
so it provides independent evidence about them. A trajectory is checked against the physics of the
formulation named in its attributes. For formulations and devices from other packages, everything that
requires no knowledge of them is verified, and the rest is reported as unchecked.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from opfmodel.check.checker import Checker
from opfmodel.check.flows import ac_flows
from opfmodel.check.report import Report, Violation
from opfmodel.check.trajectories import Array, Data, Series
from opfmodel.network.network import Network

__all__ = ["Report", "Violation", "check", "economic_cost", "losses"]


def check(
    network: Network,
    data: Data,
    series: Series | None = None,
    first: int = 0,
    previous_pg: Mapping[str, float] | None = None,
) -> Report:
    """Recompute all constraints and the operating cost of a trajectory.

    Parameters
    ----------
    network
        Declared network.
    data
        Trajectories over ``time`` in physical units, as in ``plan.data``, ``plan.scenario(name)``,
        ``plan.trajectory(name)`` or ``run.data``: for AC ``vm``, ``va``, ``pg``, ``qg`` and, with storage,
        ``ps``, ``qs``, ``e``, ``e_next``. The
        attribute ``formulation`` selects the physics, AC by default. Components may be in any order;
        components that are missing from the data count as out of service.
    series
        Time series: :class:`opfmodel.Profiles`, or values by ``"component.field"``. All other fields
        are constant.
    first
        Position of the first stage of ``data`` in the series.
    previous_pg
        Dispatch before the first stage, MW by generator; required to check the first ramp.

    Returns
    -------
    Report

    Raises
    ------
    ProfileError
        A time series does not cover all stages.
    ResultError
        The data contain two components of the same kind and name.
    """
    return Checker(network, data, series, first, previous_pg).run()


def economic_cost(network: Network, data: Data, series: Series | None = None, first: int = 0) -> Array:
    """Operating cost of all equipment in each stage, $/h, from its declaration."""
    return Checker(network, data, series, first).cost_rate()


def losses(network: Network, data: Data) -> Array:
    """Active losses of all branches in each stage, MW: the sum of the flows into both ends."""
    at_from, at_to = ac_flows(Checker(network, data, None, 0))
    return np.asarray((at_from.real + at_to.real).sum(axis=0) * network.base_mva)
