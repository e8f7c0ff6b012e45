"""Soft limits: the penalty prices of an elastic problem, and how it reports shortfalls."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from itertools import product
from typing import Literal

import numpy as np
import numpy.typing as npt

from opfmodel.data.calendar import Times
from opfmodel.horizon import Horizon
from opfmodel.network.arrays import PerUnitNetwork
from opfmodel.network.bounds import number_within
from opfmodel.network.units import scale
from solvers import Solution

__all__ = ["LEAST", "Elastic", "Shortage", "Side", "Slack", "Soft", "shortages"]

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

LEAST = 1e-5  # p.u.; a smaller slack is solver tolerance, not a shortfall
_TOTALS = {"MW": "MWh", "MVAr": "MVArh"}


@dataclass(frozen=True)
class Elastic:
    """Penalty prices of soft limits, with which a problem always has a solution.

    By default the prices weigh shortfalls against each other, never against cost: the plan is the cheapest
    of those with the minimum penalty. If shortfalls are traded, they count like any other cost.

    One hour of 1 p.u. of anything (power, voltage, angle in radians, energy) is penalised at the price
    times the power base of the system, :attr:`Network.scale_mva`. On a base of 100 MVA, 0.01 p.u. of
    voltage therefore costs as much as 1 MW.

    Parameters
    ----------
    limit
        Price of violating ratings, voltage, angle and ramp limits and custom constraints, $/MWh.
    shedding
        Price of unserved demand, $/MWh.
    balance
        Price of unserved balance (slack injection), active or reactive, and of stored energy outside its
        limits, $/MWh. The highest price, since it has no physical counterpart.
    traded
        Whether shortfalls are traded against cost: the plan minimises the sum of cost and expected penalty,
        in one solve.
    """

    limit: float = 5_000.0
    shedding: float = 10_000.0
    balance: float = 20_000.0
    traded: bool = False

    def __post_init__(self) -> None:
        for name in ("limit", "shedding", "balance"):
            number_within(f"elastic: {name}", getattr(self, name), above=0)


class Side(Enum):
    """The side of a limit on which a quantity lies."""

    BELOW = -1
    ABOVE = 1

    @property
    def other(self) -> Side:
        """The opposite side."""
        return Side(-self.value)


@dataclass(frozen=True, eq=False)
class Soft:
    """How a limit is softened in an elastic problem.

    Attributes
    ----------
    limit
        Kind of limit: ``voltage``, ``rating``, ``balance``, ... Shortfalls of one component and one kind
        of limit are reported together.
    members
        Positions of the components to which the rows belong.
    unit
        Physical unit of the violation.
    below, above
        Sentences for a component below its lower or above its upper limit, with ``{}`` for the amount.
        Equal sentences mean that the side does not matter; an empty one, that the side has no limit.
    price
        The price of :class:`Elastic` that applies.
    squared
        Whether the rows limit the square of the quantity; the slack is that of the quantity itself.
    share
        Share of the price that each row bears if several rows state one limit.
    noun
        Word for the components in the sentences; their kind by default.
    names
        Names to report, if the rows do not belong to components of the network.
    timed
        Whether the columns of the rows are stages; if not, the sentences name no hour, and each column is
        penalised as the first stage is.
    """

    limit: str
    members: Index
    unit: str
    below: str = ""
    above: str = ""
    price: Literal["limit", "shedding", "balance"] = "limit"
    squared: bool = False
    share: float = 1.0
    noun: str = ""
    names: tuple[str, ...] = ()
    timed: bool = True

    def sentence(self, side: Side) -> str:
        """Return the sentence for a component on one side of the limit."""
        return self.above if side is Side.ABOVE else self.below

    def side(self, side: Side) -> Side:
        """Return the side, or always the same one if the side does not matter."""
        return Side.ABOVE if self.below == self.above else side


@dataclass(frozen=True, eq=False)
class Slack:
    """A variable of an elastic problem: what a limit is exceeded by on one side, p.u.

    Attributes
    ----------
    block
        Name of the variable block or output.
    nodes
        Node of each column, if there is not one per node; -1 for values before the first.
    """

    block: str
    kind: str
    soft: Soft
    side: Side
    nodes: Index | None = None

    def parts(self, values: Array) -> list[tuple[Side, Array]]:
        """Return the violation on each side, p.u., from the positive and negative values of the variable."""
        return [(self.side, np.maximum(values, 0.0)), (self.side.other, np.maximum(-values, 0.0))]

    def spread(self, amounts: Array, items: int, stages: int) -> Array:
        """Return the amounts of all components of the kind in all stages, ``(items, stages)``."""
        out = np.zeros((items, stages))
        nodes = np.arange(stages) if self.nodes is None else self.nodes
        skipped = nodes.size - amounts.shape[1]  # by a plan that ends with the data
        nodes = np.minimum(nodes[skipped:] - skipped, stages - 1)
        kept = np.flatnonzero(nodes >= 0)
        np.add.at(out, np.ix_(self.soft.members, nodes[kept]), amounts[:, kept])
        return out


@dataclass(frozen=True, eq=False)
class Shortage:
    """A shortfall of one component, in one or several stages.

    Attributes
    ----------
    kind, component
        Kind and name of the component.
    soft, side
        The limit that is exceeded, and on which side.
    amounts
        Amount by stage, in the physical unit.
    hours
        Hour at which each stage begins; empty if the amounts do not belong to stages.
    moments
        The same as text, such as ``hour 3`` or a local time.
    horizon
        The nodes in time that the stages are.
    cost
        Amount times the price of the elastic problem, weighted with probability, $; after outages, as if they
        happened.
    """

    kind: str
    component: str
    soft: Soft
    side: Side
    amounts: Array
    hours: Array
    moments: tuple[str, ...]
    horizon: Horizon
    cost: float

    @property
    def unit(self) -> str:
        """Unit of ``amounts``."""
        return self.soft.unit

    @property
    def worst(self) -> float:
        """Maximum amount over the stages."""
        return float(self.amounts.max())

    @property
    def hypothetical(self) -> bool:
        """Whether it arises only after outages."""
        contingencies = self.horizon.contingencies
        return bool(self.hours.size and contingencies.size and (self.amounts[contingencies] > 0).any())

    def __str__(self) -> str:
        short = np.flatnonzero(self.amounts > 1e-3 * self.worst)
        amount = f"{_figure(self.worst)} {self.unit}".strip()
        text = f"{self.kind} {self.component} {self.soft.sentence(self.side).format(amount)}"
        if not self.hours.size:
            return text
        first = np.argmax(self.amounts >= (1.0 - 1e-4) * self.worst)  # of equals, whatever the solver leaves
        scenario = self.horizon.scenario[first]
        text += f" at {self.moments[first]}" + (f" of scenario {scenario!r}" if scenario else "")
        if self.hypothetical:
            others = short.size - 1
            return f"{text} after the outage of {', '.join(self.horizon.out[first])}" + (
                f" (and after {others} others)" if others else ""
            )
        if short.size > 1:
            total = ""
            if self.unit in _TOTALS:
                energy = _figure(float(self.amounts @ self.horizon.influence))
                total = f", {energy} {_TOTALS[self.unit]} {'in all' if self.horizon.is_chain else 'expected'}"
            text += f" (in {short.size} stages{total})"
        return text


def shortages(
    slacks: Iterable[Slack],
    solution: Solution,
    network: PerUnitNetwork,
    prices: Elastic,
    horizon: Horizon,
    times: Times,
) -> tuple[Shortage, ...]:
    """Return the shortfalls of a network, the most expensive first, those after outages last.

    Parameters
    ----------
    solution
        The solution to report.
    horizon, times
        The nodes in time, and when each begins.
    """
    hours = times.hours
    found: dict[tuple[str, str, str, str, Side, bool], tuple[Soft, Array, Array]] = {}
    real = np.ones(len(horizon), dtype=bool)
    real[horizon.contingencies] = False
    for slack in slacks:
        soft = slack.soft
        names = soft.names or network.tables[slack.kind].names
        for side, part in slack.parts(solution.value(slack.block)):
            spread = slack.spread(part, len(names), hours.size) if soft.timed else part
            weights = horizon.influence if soft.timed else horizon.influence[:1]
            priced = float(getattr(prices, soft.price)) * spread * weights
            nodes = real if spread.shape[1] == real.size else np.ones(spread.shape[1], dtype=bool)
            for happens, item in product((True, False), range(len(spread))):
                own = spread[item] * (nodes == happens)
                if own.max(initial=0.0) <= LEAST:
                    continue
                key = (soft.noun or slack.kind, names[item], soft.limit, soft.unit, soft.side(side), happens)
                none = np.zeros(spread.shape[1])
                _, known, cost = found.get(key, (soft, none, none))
                # the ends of a branch share one rating; the shortfalls of several loads at a bus add up
                join = np.maximum if soft.price == "limit" else np.add
                found[key] = soft, join(known, own), join(cost, priced[item] * (nodes == happens))
    made = []
    moments = times.shown if found else ()
    for (kind, component, _, unit, side, _), (soft, amounts, costs) in found.items():
        total = float(costs.sum()) * (network.base_mva if unit else 1.0)
        physical = amounts * scale(unit, network.base_mva)
        timed = (hours, moments) if soft.timed else (hours[:0], ())
        made.append(Shortage(kind, component, soft, side, physical, *timed, horizon, total))
    return tuple(sorted(made, key=lambda shortage: (shortage.hypothetical, -shortage.cost)))


def _figure(value: float) -> str:
    """Format with three or four significant digits and no exponent."""
    return f"{value:,.1f}" if value > 9.995 else f"{value:.3g}"
