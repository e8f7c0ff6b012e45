"""What a plant is."""

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
    """What happened in one step.

    Attributes
    ----------
    values
        Per-unit values ``(items,)`` by ``(kind, quantity)``.
    state
        The state at the next step, in physical units.
    described
        Unit and description of each quantity.
    formulation
        The physics that the values obey.
    status
        How the plant found them: ``planned``, or the status of its own problem.
    solved
        Whether it did; if not, values of the network are NaN.
    """

    values: Mapping[Key, Array]
    state: Mapping[str, Array]
    described: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    formulation: str = "ac"
    status: str = "planned"
    solved: bool = True


class Plant:
    """What the grid does in the first stage of a plan, and the state it leads to; one class in one file.

    Registered by an entry point in the group ``opfmodel.plants``; the keyword arguments of the
    constructor are the options in a scenario file, beside ``mode``, which is the plant's name.

    Attributes
    ----------
    needs_perfect_forecast
        Whether it takes what was planned for what happens, so that the balance would not hold if
        something else did.
    """

    needs_perfect_forecast: ClassVar[bool] = False

    def check(self, network: PerUnitNetwork) -> None:
        """Raise :class:`opfmodel.errors.ModelError` for options that do not fit a network."""

    def begin(self, problem: MultiStage, state: Initial | None = None) -> None:
        """Begin a run, and forget the last one.

        Parameters
        ----------
        problem
            The controller's problem.
        state
            The state at the first step, in physical units; see :meth:`MultiStage.solve`.
        """

    def apply(self, plan: Plan) -> Step:
        """Apply the first stage of a plan; steps of a run come in the order of time.

        Returns
        -------
        Step
            Also where the plant finds no state; then with ``solved`` false.
        """
        raise NotImplementedError
