"""The base class of plants, and the outcome of a step."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from copy import copy
from dataclasses import dataclass, field
from typing import ClassVar, Self

import numpy as np
import numpy.typing as npt

from opfmodel.errors import IncompatibleError
from opfmodel.model import NumericStage
from opfmodel.network.arrays import PerUnitNetwork
from opfmodel.plan import Initial, MultiStage, Plan
from opfmodel.plan.recall import Memory
from opfmodel.simulation.outages import Outage, Outages, outages_of

__all__ = ["Key", "Plant", "Step", "Values", "with_following"]

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
    takes_outages
        Whether it realises outages: a component that is out of service in a step carries and produces
        nothing in it.
    outages
        The outages that happen; see :meth:`with_outages`.
    """

    needs_perfect_forecast: ClassVar[bool] = False
    takes_outages: ClassVar[bool] = False
    outages: Outages = Outages()

    def with_outages(
        self,
        events: Iterable[Outage],
        known: int | None = None,
        minutes: float | None = None,
        rating: float | None = None,
    ) -> Self:
        """Return the plant with outages that happen.

        Parameters
        ----------
        events
            What trips, and when.
        known
            Steps after the trip until the controller knows: by default 1, or 0 if the plant follows the plan,
            which then has to know at once.
        minutes
            Time in which units respond in the steps in which the controller does not know; by default that
            of its security, else 15.
        rating
            Multiple of the rating of a branch in these steps, if it has no emergency rating; by default that
            of its security, else 1.

        Raises
        ------
        IncompatibleError
            The plant does not realise outages, or follows plans that do not know of them.
        """
        if not self.takes_outages:
            raise IncompatibleError(
                f"outages: the plant {type(self).__name__} does not realise any", "outages"
            )
        made = copy(self)
        made.outages = outages_of(events, known, self.needs_perfect_forecast, minutes=minutes, rating=rating)
        return made

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

    def memory(self) -> Memory:
        """Return what later steps of the run depend on besides their plans; empty if on nothing.

        Returns
        -------
        Mapping
            Plain data: nested mappings, lists, numbers, texts and arrays, so that a run can be resumed. They
            must not change later.
        """
        return {}

    def recall(self, memory: Memory) -> None:
        """Put back what :meth:`memory` returned, after :meth:`begin`, in another process for instance."""

    def apply(self, plan: Plan) -> Step:
        """Apply the first stage of a plan; the steps of a run arrive in chronological order.

        Returns
        -------
        Step
            Also if the plant finds no solution; ``solved`` is then false.
        """
        raise NotImplementedError


def with_following(plan: Plan, values: Mapping[Key, Array], network: PerUnitNetwork) -> Values:
    """Return the values of a step with what follows from them for devices that are no part of the grid.

    Parameters
    ----------
    plan
        The plan that the step applied; only the stocks of such devices at its start count.
    network
        The network in the step.
    """
    others = {d.component.kind: d for d in plan.model.devices if not d.physical}
    if not others:
        return dict(values)
    stocks = {(state.kind, state.name) for state in plan.model.states.values() if state.role == "stock"}
    prices = {(price.kind, name) for name, price in plan.model.prices.items()}
    kept = stocks | prices
    happened = {key: v[:, None] for key, v in values.items() if key[0] not in others or key in kept}
    stage = NumericStage(network, plan.problem.step, happened, plan.model.costed)
    made = dict(values)
    for kind, device in others.items():
        made |= {(kind, name): v[:, 0] for name, v in device.follow(stage).items()}
    return made
