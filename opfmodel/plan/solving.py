"""One solve of a compiled problem: from a request to a plan."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from opfmodel.errors import ModelError, listed, shown
from opfmodel.horizon import Horizon
from opfmodel.network.arrays import PerUnitNetwork, Table
from opfmodel.network.bounds import integer
from opfmodel.network.units import scale
from opfmodel.plan.compiled import Compiled
from opfmodel.plan.nodes import at_nodes, mean_of_futures
from opfmodel.plan.numbers import Numbers
from opfmodel.plan.outages import free_rows, idle, lost_fields, status_at, without
from opfmodel.plan.peaks import with_least_peaks
from opfmodel.plan.request import Limits, Request
from opfmodel.plan.result import Plan
from opfmodel.plan.security import at_contingencies
from opfmodel.plan.start import grown, lifted, moved
from solvers import Instance, Kind, Program, Start, classify

if TYPE_CHECKING:
    from opfmodel.plan.multistage import MultiStage

__all__ = ["posed", "solved"]

_log = logging.getLogger(__name__)

Array = npt.NDArray[np.float64]


def posed(
    problem: MultiStage, compiled: Compiled, request: Request, limits: Limits | None = None
) -> tuple[Instance, PerUnitNetwork]:
    """Return the instance of a compiled problem that a request asks for, and the network at its nodes.

    Parameters
    ----------
    limits
        Bounds of rows and variables, by block, in place of those of the request.
    """
    time, initial, end = request.time, request.initial, request.end
    model, program = compiled.model, compiled.program
    horizon = problem.horizon_from(time)
    if len(horizon) == len(request.horizon):
        horizon = request.horizon
    begin = _begin(problem, request)
    series = {**problem.ahead(time), **(request.expected or {})}
    never = idle(problem.arrays, horizon, request.out)
    lost = lost_fields(problem.arrays, horizon, problem.outages)
    if lost or problem.security is not None:
        series = {key: _of_owners(values, horizon) for key, values in series.items()}
        series = at_contingencies(series, problem.security, horizon, problem.arrays, never)
        series = without(series, problem.arrays, status_at(problem.arrays, horizon, request.out, never), lost)
    network = problem.arrays.with_series(series)
    numbers = _numbers(problem, compiled, network, series, begin)
    if model.horizon.varying:
        numbers.parameters["probability"] = request.horizon.regular.probability
    for state in model.states.values():
        table = network.tables[state.kind]
        if initial is not None and state.name in initial:
            given = initial[state.name]
            values = None if given is None else _state(state.name, given)
            if values is not None and state.role == "dispatch" and values.shape == (len(table),):
                values = np.where(_gone(table, request.out), 0.0, values)
            if values is not None:
                values = values / scale(state.unit, table.base_mva)
        else:
            values = table.arrays[state.initial][:, 0] if state.initial else None
        numbers.start_from(state.name, values)
        numbers.end_with(state.name, end, _gone(table, request.out))
    for constraint in problem.constraints.values():
        if constraint.limited:
            low, high = constraint.window(time, horizon.steps, problem.at_end == "repeat")
            nodes = horizon.regular
            numbers.limit(
                constraint.rows,
                at_nodes([low[None, :]], nodes, "max"),
                at_nodes([high[None, :]], nodes, "min"),
            )
    held = {name: (values, values) for name, values in (request.settings or {}).items()}
    for name, (lower, upper) in {**dict(free_rows(model, program, never)), **held, **(limits or {})}.items():
        numbers.limit(name, lower, upper)
    return numbers.instance(), network


def solved(
    problem: MultiStage,
    compiled: Compiled,
    request: Request,
    previous: Plan | None = None,
    multipliers: bool = True,
    limits: Limits | None = None,
) -> Plan:
    """Return the plan of one solve; of an elastic problem for the sum of cost and penalty.

    Parameters
    ----------
    previous
        An earlier plan to start from, with its multipliers or without.
    limits
        As for :func:`posed`.
    """
    _check(request, problem, compiled, previous)
    model = compiled.model
    instance, network = posed(problem, compiled, request, limits)
    begin = _begin(problem, request)
    start, effort = _from_previous(previous, compiled.program, request, begin, multipliers), 0.0
    if start is None and not limits:
        start, effort = _from_expected(problem, compiled, request, network)
    solution = compiled.session.solve(instance, start)
    solution = replace(solution, seconds=solution.seconds + effort, skipped=begin)
    if solution.status.is_optimal:
        solution = with_least_peaks(model, solution)
    plan = Plan(problem, model, solution, network, request)
    _log.info("%r: %s, %s iterations, %.3f s", plan, solution.solver, solution.iterations, solution.seconds)
    return plan


def _begin(problem: MultiStage, request: Request) -> int:
    """Return the stage of the program at which a plan begins."""
    return problem.stages - len(problem.horizon_from(request.time).regular)


def _gone(table: Table, out: Sequence[str]) -> npt.NDArray[np.bool_]:
    """Return which components are out of service."""
    gone = np.zeros(len(table), dtype=bool)
    gone[[table.position[name] for name in out if name in table.position]] = True
    return gone


def _of_owners(values: Array, horizon: Horizon) -> Array:
    """Return values of the stages also for contingencies, which have those of their owners."""
    return values[:, horizon.owner] if values.shape[1] == len(horizon.regular) else values


def _check(request: Request, problem: MultiStage, compiled: Compiled, previous: Plan | None) -> None:
    """Raise :class:`ModelError` for arguments of a solve that do not fit the compiled problem."""
    model, program = compiled.model, compiled.program
    integer("time", request.time, at_least=0)
    if previous is not None and not isinstance(previous, Plan):
        raise ModelError(f"previous = {shown(previous)}: must be a plan")
    if (
        previous is not None
        and previous.problem is not problem
        and previous.solution.x.size != program.n_variables
        and not (
            previous.problem.is_variant_of(problem) and len(previous.request.horizon) != len(request.horizon)
        )
    ):
        raise ModelError("previous: belongs to a problem with other variables; give a plan of this one")
    for key in request.expected or {}:
        if key not in model.series:
            known = listed(f"{kind}.{field}" for kind, field in sorted(model.series)) or "none"
            raise ModelError(f"expected: {'.'.join(key)}: has no time series; those that have: {known}")
    for name in request.initial or {}:
        if name not in model.states:
            raise ModelError(f"initial: no state is named {name!r}; states: {', '.join(model.states)}")
    own, given = model.horizon, request.horizon
    if {name for names in given.out for name in names} <= set(problem.outages):
        given = replace(given, out=own.out)  # which component goes out is data
    same = own.varying or np.array_equal(own.probability, given.probability)
    if given is not own and not (same and own.same_nodes(given)):
        raise ModelError(
            "horizon: may differ from that of the problem in probabilities alone, if these are varying"
        )


def _numbers(
    problem: MultiStage,
    compiled: Compiled,
    network: PerUnitNetwork,
    series: Mapping[tuple[str, str], Array],
    begin: int,
) -> Numbers:
    """Return the instance data of a plan that begins at a stage of the program."""
    model, program, shrinking = compiled.model, compiled.program, compiled.shrinking
    if not begin:
        return Numbers(model, program, network)
    assert shrinking is not None
    ahead = {key: np.repeat(values[:, :1], begin, axis=1) for key, values in series.items()}
    whole = {key: np.hstack([ahead[key], values]) for key, values in series.items()}
    return Numbers(model, program, problem.arrays.with_series(whole), begin, shrinking.freed(begin))


def _state(state: str, given: npt.ArrayLike) -> Array:
    try:
        return np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        raise ModelError(f"initial {state}: {given!r}: must be one number per component") from None


def _from_previous(
    previous: Plan | None, program: Program, request: Request, begin: int, multipliers: bool
) -> Start | None:
    time = request.time
    if previous is None or time < previous.time or not previous.solution.status.is_optimal:
        return None
    steps = max(time - previous.time - (begin - previous.solution.skipped), 0)
    before, after = previous.request.horizon, request.horizon
    if len(before) != len(after):  # screening has found more contingencies
        start = moved(previous.solution, before, before, steps)
        return grown(start, previous.solution.program, before, program, after)
    start = moved(previous.solution, before, after, steps)
    if previous.solution.program is not program:  # from another elastic variant of the problem
        return Start(start.x) if start.x.size == program.n_variables else None
    same = previous.request.out == request.out  # else other limits bind
    return start if multipliers and same else Start(start.x)


def _from_expected(
    problem: MultiStage, compiled: Compiled, request: Request, network: PerUnitNetwork
) -> tuple[Start | None, float]:
    """Return the plan for the expected future as a start, and its seconds; None if it is of no use.

    Nonlinear problems over a tree need fewer iterations from it, and it is far smaller.
    """
    model, program = compiled.model, compiled.program
    if model.horizon.is_chain or classify(program).kind < Kind.NONLINEAR:
        return None, 0.0
    known = {
        (kind, field): values
        for kind, field in model.series
        for values in (network.tables[kind].arrays[field],)
    }
    chain = problem.expected_problem
    mean = mean_of_futures(known, request.horizon)
    mean = {key: values for key, values in mean.items() if key in chain.model.series}
    asked = replace(request, expected=mean, horizon=chain.horizon, settings=None)
    plan = chain.solve_once(asked)
    start = lifted(plan.solution, program, request.horizon) if plan.optimal else None
    return start, plan.solution.seconds
