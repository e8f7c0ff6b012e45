"""Uncertain futures: the scenarios of a controller, named cases or paths drawn from its forecast."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from opfmodel.data.grid import Grid
from opfmodel.data.series import Profiles, SeriesKey
from opfmodel.errors import HorizonError
from opfmodel.forecasts.base import Forecast
from opfmodel.forecasts.reduction import fast_forward_selection
from opfmodel.horizon import Horizon
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
        Number of scenarios to keep, by fast forward selection.
    seed
        Seed of the random numbers.
    """

    number: int
    keep: int
    seed: int = 0

    def __post_init__(self) -> None:
        integer("draw: number", self.number, at_least=1, error=HorizonError)
        integer("draw: keep", self.keep, at_least=1, error=HorizonError)
        integer("draw: seed", self.seed, at_least=0, error=HorizonError)
        if self.keep > self.number:
            raise HorizonError(
                f"keep = {self.keep}: must be at most number = {self.number}, the paths that are drawn",
                "draw", "keep",
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
    """

    series: Sequence[Profiles]
    probability: Array
    stands_for: Sequence[int]


@dataclass(frozen=True)
class Scenarios:
    """The futures that a controller plans for; give cases, or a draw.

    Parameters
    ----------
    common
        Number of stages at the beginning that all futures share.
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

    common: int = 1
    cases: Mapping[str, Case] = field(default_factory=dict)
    draw: Draw | None = None
    folder: Path = Path()

    def __post_init__(self) -> None:
        if bool(self.cases) == (self.draw is not None):
            raise HorizonError("scenarios: give either cases or a draw")

    def horizon(self, hours: Sequence[float], step: float | None = None) -> Horizon:
        """Return the tree of the scenarios over stages of the given lengths.

        Raises
        ------
        HorizonError
            Probabilities, the common part or a length do not fit; see :meth:`Horizon.tree`.
        """
        if self.draw is None:
            shares = {name: case.probability for name, case in self.cases.items()}
            return Horizon.tree(hours, shares, self.common, step)
        names = [f"path {number}" for number in range(1, self.draw.keep + 1)]
        return Horizon.tree(hours, dict.fromkeys(names, 1 / len(names)), self.common, step, varying=True)

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
        common = begins[min(self.common, len(begins) - 1)]
        if self.draw is not None:
            paths = forecast.paths(issued, time, self.draw.number, self.draw.seed, actual.calendar)
            return _reduced(self.draw, issued, paths, common)
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
            changed = Profiles({key: book.series[key][time:] for key in issued})
            series.append(_after(common, issued, changed))
        shares = np.array([case.probability for case in self.cases.values()])
        return Futures(series, shares, [1] * len(series))


def _reduced(draw: Draw, issued: Profiles, paths: Mapping[SeriesKey, Array], common: int) -> Futures:
    """Reduce paths, ordered by their total, so that successive plans resemble each other."""
    points = np.hstack([np.zeros((draw.number, 1)), *(values[:, common:] for values in paths.values())])
    reduced = fast_forward_selection(points, np.full(draw.number, 1.0 / draw.number), draw.keep)
    order = np.argsort(points[reduced.kept].sum(axis=1), kind="stable")
    many = np.bincount(reduced.stands_for, minlength=draw.keep)[order]
    series = [
        _after(common, issued, {key: values[path] for key, values in paths.items()})
        for path in reduced.kept[order]
    ]
    return Futures(series, reduced.probability[order], many.tolist())


def _after(common: int, issued: Profiles, changed: Mapping[SeriesKey, Array]) -> Profiles:
    """Return the issued series, with what is changed after the common part."""
    made = {key: np.concatenate([issued[key][:common], values[common:]]) for key, values in changed.items()}
    return Profiles({**issued, **made})
