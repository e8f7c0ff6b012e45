"""Budgets over time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from opfmodel.data.calendar import Times
from opfmodel.errors import ComponentError
from opfmodel.network.component import Clocked, Component, component
from opfmodel.network.fields import in_service, number, weights

__all__ = ["COUNTED", "Budget", "Use"]

_SAME = 1e-9  # steps; hours are rounded


class Use(NamedTuple):
    """What counts as the use of a component: the energy of a quantity.

    Attributes
    ----------
    magnitude
        Whether the energy of its magnitude counts.
    moves
        Whether the quantity is a number of moves in each stage, which may be missing, and not a power.
    """

    kind: str
    quantity: str
    magnitude: bool = False
    moves: bool = False


COUNTED = (
    Use("generator", "pg"),
    Use("connection", "connection_p"),
    Use("storage", "ps", magnitude=True),
    Use("branch", "tap_moves", moves=True),
    Use("branch", "shift_moves", moves=True),
    Use("shunt", "shunt_b_moves", moves=True),
)
"""What may use up a budget, by kind of component."""


@component
class Budget(Component):
    """A limited amount per period that units use up: emissions, water, fuel, cycles of a battery.

    It has a unit of its own, in which the amount and the uses are stated.
    """

    kind: ClassVar[str] = "budget"
    plural: ClassVar[str] = "budgets"
    clocked: ClassVar[Mapping[str, Clocked]] = {
        "carried": Clocked(
            "", "min"
        ),  # 1 if a step continues the period of the step before, 0 if it begins one
        "remaining": Clocked("h", "last"),  # hours of the period that are left at the end of a step
    }

    amount: float = number(
        "units",
        at_least=0.0,
        over="last",
        description="Amount per period; a series may vary from period to period.",
    )
    uses: Mapping[str, float] = weights(
        "units/MWh",
        of=tuple(dict.fromkeys(use.kind for use in COUNTED)),
        positive=[use.kind for use in COUNTED if use.magnitude or use.moves],  # others are not convex
        description="Use by name: per MWh generated, imported, or drawn and delivered by a storage; per move "
        "of a tap, phase shifter or shunt.",
    )
    hours: float = number(
        "h",
        above=0.0,
        series=False,
        description="Length of a period; the first one begins at midnight of step 0.",
    )
    left: float | None = number(
        "units",
        None,
        at_least=0.0,
        optional=True,
        series=False,
        description="What is left of the current period at step 0; none for the amount.",
    )
    over_cost: float | None = number(
        "$/unit",
        None,
        at_least=0.0,
        optional=True,
        series=False,
        description="Cost of using more than the amount; none for a limit that must not be exceeded.",
    )
    in_service: bool = in_service()

    def check(self, name: str) -> None:
        """Raise :class:`ComponentError` if a field breaks a rule or nothing uses the budget."""
        super().check(name)
        if not self.uses:
            raise ComponentError(name, "uses", self.uses, "must name at least one component")

    def resolved(self) -> Budget:
        """Return the budget with what is left at step 0 filled in."""
        return self if self.left is not None else replace(self, left=self.amount)

    def at_clock(self, times: Times) -> Mapping[str, npt.NDArray[np.float64]]:
        """Return where periods continue, and the hours that are left of them at the end of each step.

        A step within which a period begins belongs to it. What is given for step 0 is what is left then, so
        no period begins there.
        """
        length = max(round(self.hours / times.step), 1)  # of a period, in steps
        period, within = np.divmod(_counted(times), length)
        before = _counted(replace(times, steps=np.maximum(times.steps - 1, 0))) // length
        return {
            "carried": np.where(period > before, 0.0, 1.0),
            "remaining": (length - 1.0 - within) * times.step,
        }


def _counted(times: Times) -> npt.NDArray[np.float64]:
    """Return the local times of the steps as numbers of steps, rounded up."""
    return np.asarray(np.ceil(times.clock / times.step - _SAME))
