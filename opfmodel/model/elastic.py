"""Limits that give way at a price: what an elastic problem is, and how it reports what is short."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Literal

import numpy as np
import numpy.typing as npt

from opfmodel.errors import ModelError
from opfmodel.network.arrays import PerUnitNetwork
from opfmodel.network.units import scale
from solvers import Solution

__all__ = ["Elastic", "Shortage", "Side", "Slack", "Soft", "shortages"]

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

_LEAST = 1e-5  # p.u.; below it a slack is the solver's tolerance, not a shortage
_TOTALS = {"MW": "MWh", "MVAr": "MVArh"}


@dataclass(frozen=True)
class Elastic:
    """Prices at which the limits of a problem give way, so that it always has a solution.

    The prices weigh one shortage against another. However high costs are, no shortage is accepted to
    save them: of all plans with the least priced shortage the cheapest is taken.

    A price of 1 p.u. of anything (power, voltage, angle in radians, energy) for one hour is the price
    below times the power base of the system, :attr:`Network.scale_mva`, so that 0.01 p.u. of voltage
    costs as much as 1 MW where that is 100 MVA.

    Parameters
    ----------
    limit
        Of ratings, voltages, angles, ramps and custom constraints, $/MWh.
    shedding
        Of demand that is not served, $/MWh.
    balance
        Of unserved balance (slack injection), active or reactive, and of energy outside a store's
        limits, $/MWh. The highest, for nothing in a grid corresponds to it.
    """

    limit: float = 5_000.0
    shedding: float = 10_000.0
    balance: float = 20_000.0

    def __post_init__(self) -> None:
        for name in ("limit", "shedding", "balance"):
            price = getattr(self, name)
            if not isinstance(price, int | float) or not 0 < price < np.inf:
                raise ModelError(f"elastic: {name} = {price!r}: must be a positive price in $/MWh")


class Side(Enum):
    """On which side of a limit a quantity is."""

    BELOW = -1
    ABOVE = 1

    @property
    def other(self) -> Side:
        """The other side."""
        return Side(-self.value)


@dataclass(frozen=True, eq=False)
class Soft:
    """How a limit gives way in an elastic problem.

    Attributes
    ----------
    limit
        What is limited: ``voltage``, ``rating``, ``balance``, ...; shortages of one component and one
        limit are reported together.
    members
        Positions of the components that the rows belong to.
    unit
        Physical unit of what is exceeded.
    below, above
        Sentences on a component below its lower or above its upper limit, with ``{}`` for the amount.
        Where they are the same the side does not matter. An empty one is a side without a limit.
    price
        Which price of :class:`Elastic` counts.
    squared
        Whether the rows limit the square of the quantity; it is exceeded by an amount all the same.
    share
        Part of the price that each row bears, where several rows state one limit.
    first
        Stage of the first column of the rows; -1 for values at the ends of stages.
    noun
        What the components are called; their kind by default.
    names
        Names of the components, where they are no components of the network.
    timed
        Whether the columns of the rows are stages; sentences on the others name no hour.
    """

    limit: str
    members: Index
    unit: str
    below: str = ""
    above: str = ""
    price: Literal["limit", "shedding", "balance"] = "limit"
    squared: bool = False
    share: float = 1.0
    first: int = 0
    noun: str = ""
    names: tuple[str, ...] = ()
    timed: bool = True

    def sentence(self, side: Side) -> str:
        """The sentence on a component on one side of the limit."""
        return self.above if side is Side.ABOVE else self.below

    def side(self, side: Side) -> Side:
        """The side, or always the same one where it does not matter."""
        return Side.ABOVE if self.below == self.above else side


@dataclass(frozen=True, eq=False)
class Slack:
    """A variable of an elastic problem: what a limit is exceeded by on one side, p.u.

    Attributes
    ----------
    block
        Name of the variable block.
    counts
        Gives, from the solution with the least shortage, which values are a shortage of their own, and
        do not merely follow from another; all by default.
    """

    block: str
    kind: str
    soft: Soft
    side: Side
    counts: Callable[[Solution, PerUnitNetwork], npt.NDArray[np.bool_]] | None = None

    def parts(self, values: Array, network: PerUnitNetwork, least: Solution) -> list[tuple[Side, Array]]:
        """How much is exceeded on each side, p.u.: positive and negative values of the variable."""
        if self.counts is not None:
            values = np.where(self.counts(least, network), values, 0.0)
        return [(self.side, np.maximum(values, 0.0)), (self.side.other, np.maximum(-values, 0.0))]

    def spread(self, amounts: Array, items: int, stages: int) -> Array:
        """Amounts of all components of the kind in all stages, ``(items, stages)``."""
        out = np.zeros((items, stages))
        kept = slice(max(-self.soft.first, 0), None)
        amounts = amounts[:, kept]
        first = max(self.soft.first, 0)
        np.add.at(out[:, first : first + amounts.shape[1]], self.soft.members, amounts)
        return out


@dataclass(frozen=True, eq=False)
class Shortage:
    """One component that is short of something, in one or several stages.

    Attributes
    ----------
    kind, component
        Of what, by name.
    soft, side
        The limit that is exceeded, and on which side.
    amounts
        By stage, in the physical unit.
    hours
        Hour at which each stage begins; empty if the amounts are not of stages.
    step
        Hours per stage.
    cost
        What it costs at the prices of the elastic problem, $.
    """

    kind: str
    component: str
    soft: Soft
    side: Side
    amounts: Array
    hours: Array
    step: float
    cost: float

    @property
    def unit(self) -> str:
        """Unit of ``amounts``."""
        return self.soft.unit

    @property
    def worst(self) -> float:
        """Largest amount over the stages."""
        return float(self.amounts.max())

    def __str__(self) -> str:
        short = np.flatnonzero(self.amounts > 1e-3 * self.worst)
        amount = f"{_figure(self.worst)} {self.unit}".strip()
        text = f"{self.kind} {self.component} {self.soft.sentence(self.side).format(amount)}"
        if not self.hours.size:
            return text
        text += f" at hour {self.hours[np.argmax(self.amounts)]:g}"
        if short.size > 1:
            total = ""
            if self.unit in _TOTALS:
                total = f", {_figure(float(self.amounts.sum()) * self.step)} {_TOTALS[self.unit]} in all"
            text += f" ({short.size} stages short{total})"
        return text


def shortages(
    slacks: Iterable[Slack],
    solution: Solution,
    least: Solution,
    network: PerUnitNetwork,
    prices: Elastic,
    step: float,
    hours: Array,
) -> tuple[Shortage, ...]:
    """What the components of a network are short of, the most expensive first.

    Parameters
    ----------
    solution
        What happens.
    least
        The solution with the least shortage, whose prices tell what causes a shortage.
    hours
        Hour at which each stage begins.
    """
    found: dict[tuple[str, str, str, str, Side], tuple[Soft, Array]] = {}
    for slack in slacks:
        soft = slack.soft
        names = soft.names or network.tables[slack.kind].names
        for side, part in slack.parts(solution.value(slack.block), network, least):
            spread = slack.spread(part, len(names), hours.size) if soft.timed else part
            for item in np.flatnonzero(spread.max(axis=1, initial=0.0) > _LEAST):
                key = (soft.noun or slack.kind, names[item], soft.limit, soft.unit, soft.side(side))
                _, known = found.get(key, (soft, np.zeros(spread.shape[1])))
                # both ends of a branch have one rating; what several loads of a bus lack adds up
                join = np.maximum if soft.price == "limit" else np.add
                found[key] = soft, join(known, spread[item])
    made = []
    for (kind, component, _, unit, side), (soft, amounts) in found.items():
        cost = float(getattr(prices, soft.price)) * float(amounts.sum()) * step
        cost *= network.base_mva if unit else 1.0
        physical = amounts * scale(unit, network.base_mva)
        moments = hours if soft.timed else hours[:0]
        made.append(Shortage(kind, component, soft, side, physical, moments, step, cost))
    return tuple(sorted(made, key=lambda shortage: -shortage.cost))


def _figure(value: float) -> str:
    """Three or four significant digits, without an exponent."""
    return f"{value:,.1f}" if value > 9.995 else f"{value:.3g}"
