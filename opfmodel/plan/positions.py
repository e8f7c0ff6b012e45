"""Plans whose settings of the network are at positions: rounded, and solved once more."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from opfmodel.model import Setting
from opfmodel.network.components import Branch, Shunt
from opfmodel.network.network import Network
from opfmodel.plan.request import Request
from opfmodel.plan.result import Plan

__all__ = ["at_positions", "without_moves"]

Array = npt.NDArray[np.float64]
Solve = Callable[[Request], Plan]

_REPAIRS = 4
_TELLING = 0.1  # of the largest reduction of the penalty that one position promises


def at_positions(plan: Plan, solve: Solve, short: Solve) -> Plan:
    """Return the plan with its settings at positions, and the effort of all solves.

    Settings are rounded to the nearest positions. Where no plan exists there, as at a binding voltage limit,
    the multipliers of a plan of minimum penalty tell which settings to move by one position, and which way.

    Parameters
    ----------
    plan
        A plan with continuous settings.
    solve, short
        Solve a request, starting from the plan, and for the minimum penalty with soft limits.
    """
    stepped = {name: own for name, own in plan.model.settings.items() if own.stepped.any()}
    if not stepped or not plan.optimal or plan.request.settings is not None:
        return plan
    settings = {name: own.rounded(plan.solution.variable(name)) for name, own in stepped.items()}
    solved = [plan, solve(replace(plan.request, settings=settings))]
    for _ in range(_REPAIRS):
        if not solved[-1].infeasible:
            break
        lacking = short(replace(plan.request, settings=settings))
        settings, before = _moved(settings, stepped, lacking), settings
        if all(np.array_equal(settings[name], before[name], equal_nan=True) for name in settings):
            break
        solved += [lacking, solve(replace(plan.request, settings=settings))]
    return _with_effort(solved)


def without_moves(network: Network) -> Network:
    """Return a network that counts no moves of taps, phase shifters and shunts."""
    made = network.copy()
    members: dict[str, Branch | Shunt] = {**network.of(Branch), **network.of(Shunt)}
    for name, component in members.items():
        if component.move_cost is not None:
            made.update(name, move_cost=None)
    return made


def _moved(settings: Mapping[str, Array], stepped: Mapping[str, Setting], lacking: Plan) -> dict[str, Array]:
    """Return settings of which those that reduce the penalty of a plan most move by one position."""
    if not lacking.optimal:
        return dict(settings)
    gains = {
        name: np.where(own.stepped, lacking.solution.bound_dual(name) * own.size, 0.0)
        for name, own in stepped.items()
    }
    largest = max(float(np.abs(gain).max()) for gain in gains.values())
    made = {}
    for name, own in stepped.items():
        way = np.where(np.abs(gains[name]) >= _TELLING * largest, np.sign(gains[name]), 0.0)
        made[name] = np.clip(settings[name] + way * own.size, own.low, own.high)
    return made


def _with_effort(solved: list[Plan]) -> Plan:
    """Return the last plan with the effort of all, which knows the first one."""
    solutions = [p.solution for p in solved]
    counted = [s.iterations for s in solutions if s.iterations is not None]
    last = solved[-1]
    message = last.solution.message if last.optimal else f"{last.solution.message}; at the nearest positions"
    solution = replace(
        last.solution,
        iterations=sum(counted) if counted else None,
        seconds=sum(s.seconds for s in solutions),
        message=message,
    )
    made = last.with_solution(last.problem, solution)
    made.rounded_from = solved[0]
    return made
