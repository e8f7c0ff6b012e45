"""Risk aversion: a weighted sum of the mean and the conditional value at risk of the scenarios' costs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from opfmodel.model import Model
from opfmodel.network.bounds import number_within
from solvers import Expression, Sum, total

__all__ = ["Risk"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Risk:
    r"""Weighted sum of the mean and the conditional value at risk (CVaR) of the scenarios' costs.

    .. math::
        (1 - w) \sum_s \pi_s J_s + w\, \mathrm{CVaR}_\alpha, \quad
        \mathrm{CVaR}_\alpha = \min_t\; t + \frac{1}{1 - \alpha} \sum_s \pi_s \max(J_s - t, 0)

    the mean cost of the worst share :math:`1 - \alpha`. Source: R. T. Rockafellar and S. Uryasev,
    "Optimization of conditional value-at-risk", Journal of Risk 2(3), 2000.

    Parameters
    ----------
    level
        :math:`\alpha`, from 0, where CVaR is the mean, to below 1.
    weight
        :math:`w`, from 0 to below 1.
    """

    level: float
    weight: float

    def __post_init__(self) -> None:
        number_within("risk: level", self.level, at_least=0, below=1)
        number_within("risk: weight", self.weight, at_least=0, below=1)

    def measure(self, costs: Array, probability: Array) -> float:
        """Return the risk-averse value of the costs of scenarios.

        Examples
        --------
        >>> Risk(level=0.5, weight=0.5).measure(np.array([10.0, 30.0]), np.array([0.5, 0.5]))
        25.0
        """
        order = np.argsort(-costs)  # the worst first
        before = np.cumsum(probability[order]) - probability[order]
        worst = np.clip(1.0 - self.level - before, 0.0, probability[order])
        tail = float(costs[order] @ worst) / (1.0 - self.level)
        return (1.0 - self.weight) * float(costs @ probability) + self.weight * tail

    def minimise(self, model: Model, parts: Sequence[tuple[str, Expression | Sum]]) -> None:
        """Add the risk-averse value to the objective of a model.

        The excess of a scenario over t is a variable bounded from below by a row, which is convex if the
        costs are.

        Parameters
        ----------
        parts
            Stage costs (``stage``) in $/h and terminal costs (``terminal``) in $.
        """
        horizon, build = model.horizon, model.build
        scenarios = len(horizon.leaves)
        threshold = build.variable("cost_threshold", 1)
        excess = build.variable("cost_excess", 1, scenarios, 0.0)
        rows = build.rows("scenario_cost", 1, scenarios, -np.inf, 0.0)
        build.add(-threshold - excess, into=rows)
        for what, cost in parts:
            for term in (cost if isinstance(cost, Sum) else total(cost)).spread():
                for position, path in enumerate(horizon.paths):
                    nodes = path if what == "stage" else np.array([position])
                    hours = horizon.hours[path][None, :] if what == "stage" else 1.0
                    build.add(hours * term[:, nodes], into=rows[0, [position] * nodes.size])
        last = model.probability_of(horizon.leaves)
        build.minimize(self.weight * threshold)
        build.minimize(self.weight / (1.0 - self.level) * excess * last)
