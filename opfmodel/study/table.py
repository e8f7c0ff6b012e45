"""Selecting the columns of a study's table, and statistics of its figures over axes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from opfmodel.errors import ResultError, close, listed, nearest
from opfmodel.simulation.records import DESCRIBED
from opfmodel.study.progress import described

__all__ = ["Group", "Statistics", "aggregate", "axes_of", "is_figure", "shown_columns"]

Row = Mapping[str, Any]

# What a reader wants to see first.
_FIRST = ("status", "cost", "max_violation", "iterations", "time_total_seconds", "error")

# Columns that finished runs may add.
_LATER = (
    *("unchecked", "retries", "diagnosis", "iterations_mean", "elastic_steps"),
    *("redispatched_mwh", "shed_mwh", "curtailed_mwh", "violated_steps", "unsolved_steps"),
    *(f"largest_{name}" for name in DESCRIBED if name.endswith("_excess")),
    *("time_build_seconds", "time_solve_seconds_mean", "time_solve_seconds_max", "time_total_seconds"),
)


@dataclass(frozen=True)
class Statistics:
    """A figure over several runs.

    Attributes
    ----------
    runs
        Number of runs that have the figure.
    mean, deviation
        Mean, and standard deviation of the sample; None for a single run.
    q05, q50, q95
        Quantiles, interpolated linearly between the values of neighbouring runs.
    """

    runs: int
    mean: float
    deviation: float | None
    q05: float
    q50: float
    q95: float


@dataclass(frozen=True)
class Group:
    """The runs at one point of the axes that remain.

    Attributes
    ----------
    labels
        The point.
    done, waiting
        Number of runs that are done, and that have no record.
    failed
        Error of each failed run, by its point on all axes.
    figures
        Statistics over the runs that are done.
    """

    labels: Mapping[str, Any]
    done: int
    waiting: int
    failed: Mapping[str, str]
    figures: Mapping[str, Statistics]

    def as_dict(self) -> dict[str, Any]:
        """The group as plain data."""
        return asdict(self)


def shown_columns(
    rows: Sequence[Row], wanted: Sequence[str] | None = None, *, every: bool = False
) -> list[str]:
    """Return the requested columns.

    By default these are the axes that vary and the status, cost, violation, effort and errors of the runs.

    Parameters
    ----------
    every
        Whether to return all columns in which any run has a value, if none are requested.

    Raises
    ------
    ResultError
        The table has no such column, and will not have it after the runs that are waiting.
    """
    names = list(rows[0])
    known = {*names, *_LATER} if any(row["status"] == "waiting" for row in rows) else {*names}
    for name in wanted or ():
        if name not in known:
            raise ResultError(f"the table has no column {name!r}; {nearest(name, known)}")
    if wanted:
        return list(wanted)
    first = (*(name for name in axes_of(rows) if len({repr(row[name]) for row in rows}) > 1), *_FIRST)
    return [
        name
        for name in (names if every else first)
        if name in names and any(row[name] is not None for row in rows)
    ]


def aggregate(
    rows: Sequence[Row], over: str | Iterable[str], figures: Sequence[str] | None = None
) -> list[Group]:
    """Return statistics of figures over one or several axes, at each point of the others.

    Parameters
    ----------
    rows
        The table, as :func:`opfmodel.study.read_table` returns it.
    over
        Axes, by name or by the last part of a dotted name: ``seed`` for ``forecast.noisy.seed``.
    figures
        Columns of numbers; all of them by default.

    Raises
    ------
    ResultError
        The study has no such axis, or several; or a column has no numbers.
    """
    axes = axes_of(rows)
    away = {_axis(name, axes) for name in ([over] if isinstance(over, str) else over)}
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(repr([row[name] for name in axes if name not in away]), []).append(row)
    known = [name for name in rows[0] if name not in axes and is_figure(name, rows)]
    for name in figures or ():
        if name not in known:
            raise ResultError(f"column {name!r} has no numbers; {nearest(name, known)}")
    return [_group(members, axes, away, figures or known) for members in groups.values()]


def _group(rows: Sequence[Row], axes: Sequence[str], away: set[str], figures: Sequence[str]) -> Group:
    done = [row for row in rows if row["status"] == "done"]
    waiting = [row for row in rows if row["status"] == "waiting"]
    failed = [row for row in rows if row["status"] not in ("done", "waiting")]
    values = {name: [row[name] for row in done if row[name] is not None] for name in figures}
    return Group(
        {name: rows[0][name] for name in axes if name not in away},
        len(done),
        len(waiting),
        {described({name: row[name] for name in axes}): str(row["error"]) for row in failed},
        {name: _statistics(known) for name, known in values.items() if known},
    )


def _statistics(values: Sequence[float]) -> Statistics:
    numbers = np.array(values, dtype=float)
    deviation = float(numbers.std(ddof=1)) if numbers.size > 1 else None
    quantiles = np.quantile(numbers, [0.05, 0.5, 0.95]).tolist()
    return Statistics(numbers.size, float(numbers.mean()), deviation, *quantiles)


def axes_of(rows: Sequence[Row]) -> list[str]:
    """Return the axes, which are the columns before the key."""
    names = list(rows[0])
    return names[: names.index("key")]


def _axis(name: str, axes: Sequence[str]) -> str:
    """Return the axis of this name, or the only one of which it is the last part."""
    if name in axes:
        return name
    found = [axis for axis in axes if axis.rpartition(".")[2] == name]
    if len(found) == 1:
        return found[0]
    if found:
        raise ResultError(f"{name!r} is the end of several axes; give one of {listed(found)}")
    hint = nearest(name, axes) if close(name, axes) else f"axes: {listed(axes) or 'none'}"
    raise ResultError(f"the study has no axis {name!r}; {hint}")


def is_figure(name: str, rows: Sequence[Row]) -> bool:
    """Whether a column holds numbers, and no provenance."""
    values = [row[name] for row in rows if row[name] is not None]
    plain = all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    return bool(values) and plain and not name.startswith("provenance_")
