"""How far the data of a problem reach, and what plans do at their end."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from opfmodel.errors import ModelError
from opfmodel.objectives.base import Objective

if TYPE_CHECKING:
    from opfmodel.plan.multistage import MultiStage

__all__ = ["AtEnd", "check_lengths", "steps_from"]

AtEnd = Literal["error", "repeat", "shrink"]


def steps_from(problem: MultiStage, time: int) -> int:
    """Return the number of steps of a plan: those of the horizon, or fewer if plans end with the data.

    Raises
    ------
    ModelError
        The data end before the step.
    """
    lengths = _lengths(problem, problem.objective).values() if problem.at_end == "shrink" else ()
    end = min(lengths, default=time + problem.horizon.steps)
    if time >= end:
        raise ModelError(f"{problem.step_name(time)}: the data end after {end} steps")
    return min(problem.horizon.steps, end - time)


def check_lengths(problem: MultiStage, steps: int, metered: Objective | None = None) -> None:
    """Raise :class:`ModelError` if data that vary over time are too short for a closed loop.

    Parameters
    ----------
    steps
        Steps of the loop; unless plans shrink, the plan of the last one looks a horizon ahead.
    metered
        Objective that evaluates the realised costs; by default that of the problem.
    """
    if problem.at_end == "repeat":
        _check_period(problem, metered)
        return
    planned = steps + problem.horizon.steps - 1 if problem.at_end == "error" else steps
    needed = [(what, length, planned) for what, length in _lengths(problem, problem.objective).items()]
    if metered is not None:
        needed += [(what, length, steps) for what, length in _lengths(problem, metered).items()]
    for what, length, values in needed:
        if length < values:
            ahead = f" with a horizon of {problem.horizon.steps}" if values > steps else ""
            hint = "; at_end tells what to do at their end" if length >= steps else ""
            raise ModelError(
                f"{steps} steps{ahead} need {what} of {values} values; the shortest has {length}; "
                f"extend the series, or reduce the horizon or the steps{hint}"
            )


def _lengths(problem: MultiStage, objective: Objective) -> dict[str, int]:
    """Return the number of steps that each sort of data covers; data that do not vary cover all."""
    lengths = {"time series": problem.profiles.length}
    lengths |= {f"constraint {name!r}": own.length for name, own in problem.constraints.items()}
    own = [values.shape[1] for values in problem.series_of(objective).values()]
    lengths[f"series of {type(objective).__name__}"] = min((s for s in own if s > 1), default=None)
    return {what: length for what, length in lengths.items() if length is not None}


def _check_period(problem: MultiStage, metered: Objective | None) -> None:
    """Raise :class:`ModelError` unless all data are equally long and can repeat together."""
    lengths = {f"profile '{key}'": values.size for key, values in problem.profiles.items()}
    for objective in (problem.objective, metered or problem.objective):
        lengths |= {k: v for k, v in _lengths(problem, objective).items() if k != "time series"}
    first = next(iter(lengths), "")
    for what, length in lengths.items():
        if length != lengths[first]:
            raise ModelError(
                f"at_end = 'repeat': {first} has {lengths[first]} values and {what} has {length}; all data "
                "must have the same length to repeat"
            )
