"""Uncertain futures: the scenarios of a controller, named cases or paths drawn from its forecast."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt

from opfmodel.data.grid import Grid
from opfmodel.data.series import Profiles, SeriesKey
from opfmodel.errors import HorizonError
from opfmodel.forecasts.base import Forecast
from opfmodel.forecasts.reduction import backward_construction
from opfmodel.horizon import Horizon, check_splits
from opfmodel.network.bounds import integer
from opfmodel.network.network import Network
from opfmodel.profiles.base import ProfileRule, Workbook

__all__ = ["Case", "Draw", "Futures", "Scenarios"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Case:
    """A named future: rules that change the expected series after the common part.

    Parameters
    ----------
    probability
        Probability of the case; those of all cases sum to 1.
    rules
        Profile rules, applied in order at absolute steps; without rules, the expected series.
    """

    probability: float
    rules: Sequence[ProfileRule] = ()


@dataclass(frozen=True)
class Draw:
    """Paths drawn from the error model of the forecast, and reduced to a few.

    Parameters
    ----------
    number
        Number of paths to draw.
    keep
        Number of scenarios to keep, by fast forward selection. Or give ``splits``.
    seed
        Seed of the random numbers.
    splits
        Number of children of every node at the end of a number of stages, by that number: a tree that splits
        more than once, see :func:`opfmodel.forecasts.reduction.backward_construction`.
    """

    number: int
    keep: int | None = None
    seed: int = 0
    splits: Mapping[int, int] | None = None

    def __post_init__(self) -> None:
        integer("draw: number", self.number, at_least=1, error=HorizonError)
        integer("draw: seed", self.seed, at_least=0, error=HorizonError)
        if (self.keep is None) == (self.splits is None):
            raise HorizonError("draw: give either keep or splits", "draw")
        if self.splits is None:
            key, leaves = "keep", integer("draw: keep", self.keep, at_least=1, error=HorizonError)
        else:
            key, leaves = "splits", math.prod(check_splits(self.splits).values())
        if leaves > self.number:
            raise HorizonError(
                f"{key} = {getattr(self, key)}: must make at most number = {self.number} scenarios, as many "
                "as paths are drawn",
                "draw", key,
            )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Futures:
    """The expected series of the scenarios of one plan.

    Attributes
    ----------
    series
        Expected series of each scenario, from the step of the plan on.
    probability
        Probability of each scenario.
    stands_for
        Number of drawn paths for which each scenario stands; 1 for a case.
    drawn
        The scenario that stands for each drawn path; empty for cases.
    """

    series: Sequence[Profiles]
    probability: Array
    stands_for: Sequence[int]
    drawn: Sequence[int] = ()


@dataclass(frozen=True)
class Scenarios:
    """The futures that a controller plans for; give cases, or a draw.

    Parameters
    ----------
    common
        Number of stages at the beginning that all futures share, 1 by default; the splits of a draw state it.
    cases
        Named futures.
    draw
        How paths are drawn and reduced.
    folder
        Folder to which the file names of rules are relative.

    Examples
    --------
    >>> from opfmodel.profiles.scale import Scale
    >>> cases = {"low": Case(0.5, [Scale(0.9)]), "high": Case(0.5, [Scale(1.1)])}
    >>> Scenarios(common=1, cases=cases).horizon([1, 1]).scenario
    ('', 'low', 'high')
    """

    common: int | None = None
    cases: Mapping[str, Case] = field(default_factory=dict)
    draw: Draw | None = None
    folder: Path = Path()

    def __post_init__(self) -> None:
        if bool(self.cases) == (self.draw is not None):
            raise HorizonError("scenarios: give either cases or a draw")
        if self.common is not None and self.draw is not None and self.draw.splits is not None:
            raise HorizonError(
                f"common = {self.common}: the splits of a draw state what all futures share: give either",
                "common",
            )

    @property
    def splits(self) -> dict[int, int]:
        """Number of children of every node at the end of a number of stages, in order of time."""
        if self.draw is not None and self.draw.splits is not None:
            return check_splits(self.draw.splits)
        common = 1 if self.common is None else self.common
        return {common: len(self.cases) if self.draw is None else self.draw.keep or 1}

    def horizon(self, hours: Sequence[float], step: float | None = None) -> Horizon:
        """Return the tree of the scenarios over stages of the given lengths.

        Raises
        ------
        HorizonError
            Probabilities, the common part, a split or a length do not fit; see :meth:`Horizon.tree` and
            :meth:`Horizon.branching`.
        """
        if self.draw is not None and self.draw.splits is not None:
            return Horizon.branching(hours, self.draw.splits, step, varying=True)
        ((common, many),) = self.splits.items()
        if self.draw is None:
            shares = {name: case.probability for name, case in self.cases.items()}
            return Horizon.tree(hours, shares, common, step)
        names = [f"path {number}" for number in range(1, many + 1)]
        return Horizon.tree(hours, dict.fromkeys(names, 1 / many), common, step, varying=True)

    def futures(
        self,
        issued: Profiles,
        time: int,
        horizon: Horizon,
        *,
        actual: Profiles,
        forecast: Forecast,
        network: Network,
    ) -> Futures:
        """Return the expected series of each scenario at a step.

        Parameters
        ----------
        issued
            The forecast from step ``time`` on, of ``horizon.steps`` values.
        horizon
            The tree of the scenarios; see :meth:`horizon`.
        actual
            The actual series, of which rules see the steps before ``time``.
        forecast
            The forecast that issued them, from which paths are drawn.
        """
        begins = [*horizon.step[horizon.paths[0]].tolist(), horizon.steps]
        edges = [*(begins[min(depth, len(begins) - 1)] for depth in self.splits), horizon.steps]
        if self.draw is not None:
            paths = forecast.paths(issued, time, self.draw.number, self.draw.seed, actual.calendar)
            return _reduced(self.draw, issued, paths, edges, list(self.splits.values()))
        times = actual.calendar
        grid = Grid(time + horizon.steps, horizon.base)
        if times is not None:
            grid = replace(grid, start=times.start, zone=times.zone)
        known = {key: np.concatenate([actual[key][:time], values]) for key, values in issued.items()}
        series = []
        for case in self.cases.values():
            book = Workbook(network, replace(grid), self.folder, dict(known))
            for rule in case.rules:
                rule.apply(book)
            changed = {key: book.series[key][time + edges[0] :] for key in issued}
            series.append(_after(edges[0], issued, changed))
        shares = np.array([case.probability for case in self.cases.values()])
        return Futures(series, shares, [1] * len(series))


def _reduced(
    draw: Draw,
    issued: Profiles,
    paths: Mapping[SeriesKey, Array],
    edges: Sequence[int],
    children: Sequence[int],
) -> Futures:
    """Reduce paths to a tree, which splits at all steps of ``edges`` but the last, where it ends."""
    none = np.zeros((draw.number, 1))  # there may be no path of any series
    stretches = [
        np.hstack([none, *(values[:, first:last] for values in paths.values())])
        for first, last in pairwise(edges)
    ]
    made = backward_construction(stretches, np.full(draw.number, 1.0 / draw.number), children)
    later = np.arange(edges[0], edges[-1])
    series = []
    for carried in made.carried:
        path = np.repeat(carried, np.diff(edges))  # at each later step
        changed = {key: values[path, later] for key, values in paths.items()}
        series.append(_after(edges[0], issued, changed))
    many = np.bincount(made.stands_for, minlength=len(series))
    return Futures(series, made.probability, many.tolist(), made.stands_for.tolist())


def _after(common: int, issued: Profiles, later: Mapping[SeriesKey, Array]) -> Profiles:
    """Return the issued series until the end of the common part, and others from then on."""
    made = {key: np.concatenate([issued[key][:common], values]) for key, values in later.items()}
    return Profiles({**issued, **made})
