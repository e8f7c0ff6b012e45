"""Snapshots of PyPSA: equal steps with time stamps."""

from __future__ import annotations

from typing import Any

import numpy as np

from opfmodel.data.calendar import Calendar
from opfmodel.errors import CaseError
from opfmodel.network.cases.losses import Losses
from opfmodel.network.cases.pypsa.source import check_numbers

__all__ = ["steps_of"]

_WEIGH = 1e-9  # relative; one third of an hour has no exact number


def steps_of(n: Any, source: str, losses: Losses) -> tuple[float, Calendar | None]:
    """Length of the steps, h, and their time stamps; None for snapshots without stamps.

    PyPSA counts the hours of a snapshot by its weightings, and its snapshots may be labels of any kind.
    Here, steps are as long as the stamps are apart, or 1 h without stamps, and other weightings are a
    loss.

    Raises
    ------
    CaseError
        The snapshots belong to investment periods, or are not equally spaced.
    """
    import pandas as pd

    snapshots = n.snapshots
    if isinstance(snapshots, pd.MultiIndex) or len(n.investment_periods):
        raise CaseError(
            f"{source}: snapshots of several investment periods; "
            "opfmodel reads one period without investment at a time"
        )
    hours, calendar = 1.0, None
    if len(snapshots) > 1 and isinstance(snapshots, pd.DatetimeIndex):
        stamps = snapshots.to_numpy()
        gaps = np.diff(stamps)
        _check_gaps(snapshots, gaps, source)
        hours = float(gaps[0] / np.timedelta64(1, "h"))
        calendar = Calendar(stamps[0], hours)
    for column, weights in n.snapshot_weightings.items():
        check_numbers(weights, f"{source}: snapshot_weightings {column}")
        wrong = ~(np.abs(weights.to_numpy(dtype=float) - hours) <= _WEIGH * hours)
        if wrong.any():
            where = int(np.argmax(wrong))
            losses.add(
                f"snapshot_weightings {column}: {float(weights.iloc[where]):g} h at {snapshots[where]}: "
                f"{_spacing(snapshots, hours, calendar)}, and every snapshot counts {hours:g} h; "
                f"set n.snapshot_weightings.loc[:] = {hours:g} if this is meant"
            )
    return hours, calendar


def _check_gaps(snapshots: Any, gaps: Any, source: str) -> None:
    odd = (gaps != gaps[0]) | (gaps <= np.timedelta64(0))
    if odd.any():
        where = int(np.argmax(odd))
        raise CaseError(
            f"{source}: snapshots: {snapshots[where + 1]} follows {snapshots[where]}; "
            f"all must be as far apart as the first two, {snapshots[1] - snapshots[0]}, in rising order"
        )


def _spacing(snapshots: Any, hours: float, calendar: Calendar | None) -> str:
    if calendar is not None:
        return f"the snapshots are {hours:g} h apart"
    return "a single snapshot has no length" if len(snapshots) == 1 else "the snapshots have no time stamps"
