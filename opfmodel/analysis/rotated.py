"""The rotated cost of a stage, as an objective."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.analysis.problems import AtStep
from opfmodel.analysis.subject import Subject
from opfmodel.model import Stage
from opfmodel.network.arrays import PerUnitNetwork
from opfmodel.objectives.base import Objective
from solvers import total

__all__ = ["Rotated"]

Array = npt.NDArray[np.float64]


class Rotated(Objective):
    r"""The rotated cost less a multiple of the squared distance from the steady state.

    .. math::
        \tilde\ell(x, u) - \alpha \|x - x_s\|^2, \qquad
        \tilde\ell = \ell(x, u) - \frac{\lambda(x^+) - \lambda(x)}{\Delta}, \qquad
        \lambda(x) = \sum_l p_l e_l

    in $/h, up to the constant :math:`\ell(x_s, u_s)`, with the state in p.u. on the base of the network.
    Source: Faulwasser and Engelmann (2019), proof of Proposition 4.1.

    Parameters
    ----------
    subject
        The system, with its steady state.
    alpha
        :math:`\alpha`, $/(h p.u.²).
    """

    def __init__(self, subject: Subject, alpha: float) -> None:
        self.objective = AtStep(subject.problem.objective, subject.step, terminal=False)
        self.subject, self.alpha = subject, alpha
        self.needs = self.objective.needs

    def series(self, network: PerUnitNetwork) -> Mapping[tuple[str, str], Array]:
        """Return the series of the objective."""
        return self.objective.series(network)

    def stage_cost(self, stage: Stage) -> Any:
        """Return the cost of every stage."""
        subject = self.subject
        own = self.objective.stage_cost(stage)
        cost = 0.0 if own is None else own
        for state in subject.states:
            of = getattr(stage, state.kind)
            x = subject.unit * getattr(of, state.name)
            if state.name in subject.storage_function:
                price = subject.storage_function[state.name][:, None]
                gained = subject.unit * getattr(of, f"{state.name}_next") - x
                cost = cost - total(price * gained) / stage.step
            if self.alpha:
                away = x - subject.steady.x[state.where][:, None]
                cost = cost - self.alpha * total(away**2)
        return own if isinstance(cost, float) else cost
