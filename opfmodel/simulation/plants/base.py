"""The base class of plants, and the outcome of a step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from opfmodel.network.arrays import PerUnitNetwork
from opfmodel.plan import Initial, MultiStage, Plan

__all__ = ["Key", "Plant", "Step", "Values"]

Array = npt.NDArray[np.float64]
Key = tuple[str, str]
Values = dict[Key, Array]


@dataclass(frozen=True)
class Step:
    """The outcome of one step.

    Attributes
    ----------
    values
        Per-unit values ``(items,)`` by ``(kind, quantity)``.
    state
        State at the next step, in physical units.
    described
        Unit and description of each quantity.
    formulation
        The formulation whose equations the values satisfy.
    status
        ``planned``, or the status of the plant's own problem.
    solved
        Whether the plant found a solution; if not, network quantities are NaN.
    """

    values: Mapping[Key, Array]
    state: Mapping[str, Array]
    described: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    formulation: str = "ac"
    status: str = "planned"
    solved: bool = True


class Plant:
    """The response of the grid to the first stage of a plan, and the next state; one class per file.

    Registered by an entry point in the group ``opfmodel.plants``; the keyword arguments of the
    constructor are the options in a scenario file, beside ``mode``, the name of the plant.

    Attributes
    ----------
    needs_perfect_forecast
        Whether the plant takes the plan as the outcome; an imperfect forecast would then break the
        power balance.
    """

    needs_perfect_forecast: ClassVar[bool] = False

    def check(self, network: PerUnitNetwork) -> None:
        """Raise :class:`opfmodel.errors.ModelError` if the options do not fit a network."""

    def begin(self, problem: MultiStage, state: Initial | None = None) -> None:
        """Start a run and discard the history of the last one.

        Parameters
        ----------
        problem
            Problem of the controller.
        state
            The state at the first step, in physical units; see :meth:`MultiStage.solve`.
        """

    def apply(self, plan: Plan) -> Step:
        """Apply the first stage of a plan; the steps of a run arrive in chronological order.

        Returns
        -------
        Step
            Also if the plant finds no solution; ``solved`` is then false.
        """
        raise NotImplementedError
