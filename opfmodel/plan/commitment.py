"""Unit commitment: which units run in each stage, by a mixed-integer program of the DC model."""

from __future__ import annotations

import time as clock
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from opfmodel.data.series import Profiles, SeriesKey
from opfmodel.errors import IncompatibleError, ModelError, nearest, shown
from opfmodel.horizon import Horizon
from opfmodel.network.bounds import integer, number_within
from opfmodel.network.governed import at_start, governed
from opfmodel.network.series import fields_with_series, window
from opfmodel.plan.commitment_program import UnitProgram, Units
from opfmodel.plan.multistage import MultiStage
from opfmodel.plan.nodes import over_nodes
from opfmodel.plan.parts import make_formulation
from opfmodel.plan.request import Initial, Request
from opfmodel.plan.result import Plan, status_word
from solvers import Instance, Kind, classify, solve_mixed

if TYPE_CHECKING:
    from solvers import MixedSolution

__all__ = ["Commitment", "commit", "committed_ahead", "plan_with_commitment", "with_commitment"]

Array = npt.NDArray[np.float64]

_MOST_ROUNDS = 10  # of tangents
_LEAST_ERROR = 1e-7  # of tangents, relative: below it, they differ by rounding
_MARGINS = (0.02, 0.05, 0.10)


@dataclass(frozen=True, eq=False)
class Commitment:
    """Which units run in each stage, and what it costs on the linear model.

    Attributes
    ----------
    on
        Series ``{unit}.on`` of the units that are committed, from step 0 to the end of the horizon: profiles
        for a :class:`opfmodel.MultiStage`. Steps before the first one are as they were. Empty unless a
        feasible commitment was found.
    starts
        Number of starts of each unit.
    status
        ``globally_optimal`` within the gap, ``proven_infeasible``, or ``stopped`` at a limit.
    termination
        Why the search stopped.
    objective, bound
        Cost of the commitment on the linear model, with penalties of an elastic problem, and a proven lower
        bound on the cost of any, $.
    gap
        Relative difference between the two.
    seconds
        Time that it took.
    margin
        Additional capacity that was required, as a share of that of the first commitment; see
        :func:`plan_with_commitment`.
    formulation
        The linear model.
    capacity, available
        Total capacity of the committed units that run, and of those that could, MW in each stage.
    """

    on: Profiles
    starts: Mapping[str, int]
    status: str
    termination: str
    objective: float
    bound: float
    seconds: float
    formulation: str
    margin: float = 0.0
    capacity: Array = field(default_factory=lambda: np.zeros(0), repr=False)
    available: Array = field(default_factory=lambda: np.zeros(0), repr=False)

    @property
    def found(self) -> bool:
        """Whether a feasible commitment was found."""
        return bool(np.isfinite(self.objective))

    @property
    def gap(self) -> float:
        """Relative difference between objective and bound; NaN without a feasible commitment."""
        return max(0.0, self.objective - self.bound) / max(abs(self.objective), 1e-9)

    def __repr__(self) -> str:
        cost = f", {self.objective:.6g}, gap {self.gap:.1e}" if self.found else ""
        return f"Commitment({len(self.starts)} units: {self.status}{cost})"

    def as_dict(self) -> dict[str, object]:
        """Return the figures as plain data."""
        return {
            "status": self.status,
            "termination": self.termination,
            "objective": self.objective if self.found else None,
            "bound": self.bound if np.isfinite(self.bound) else None,
            "gap": self.gap if self.found else None,
            "seconds": self.seconds,
            "margin": self.margin,
            "formulation": self.formulation,
            "starts": dict(self.starts),
            "on": {str(key): values.tolist() for key, values in self.on.items()},
        }


def commit(
    problem: MultiStage,
    time: int = 0,
    initial: Initial | None = None,
    *,
    units: Iterable[str] | None = None,
    gap: float = 1e-4,
    seconds: float | None = None,
    segments: int = 8,
    capacity: npt.ArrayLike = 0.0,
    verbose: bool = False,
) -> Commitment:
    r"""Decide which units run in each stage of a problem, on its linear (DC) model.

    With :math:`u, v, w \in \{0, 1\}` for a unit that is on, started and stopped,

    .. math::
        u_k - u_{k-1} = v_k - w_k, \quad
        \sum_{j:\, t_k - UT < t_j \le t_k} v_j \le u_k, \quad
        \sum_{j:\, t_k - DT < t_j \le t_k} w_j \le 1 - u_k

    .. math::
        p_{min} u_k \le p_k \le p_{max} u_k, \quad
        p_k - p_{k-1} \le R\, u_{k-1} + S\, v_k, \quad p_{k-1} - p_k \le R\, u_k + S\, w_k

    with :math:`R = \Delta\, ramp` and :math:`S = \max(R, p_{min})`. Everything else is the compiled program
    of the same problem: network, storages, custom constraints, other devices. The tight and compact
    formulation of [1]_, with the minimum times of [2]_.

    Parameters
    ----------
    problem
        The problem. Formulations with reactive power are replaced by ``dc``, others are kept if they are
        linear.
    time, initial
        First step, and the state before it, as for :meth:`MultiStage.solve`. For how long units have been
        running follows from their series ``on`` before that step, and from ``hours_on``.
    units
        Names of the units that are committed: by default those with a minimum output above zero, a cost of
        starts, or a minimum time. All others run as declared. Where a unit has a series ``on``, it is
        available while the series is 1.
    gap
        Relative difference between the cost and its proven bound at which the search stops. HiGHS solves
        only linear programs: quadratic costs are replaced by tangents, which are added until their error is
        below half the gap.
    seconds
        Time limit of each search.
    segments
        Number of tangents of each quadratic cost at the beginning.
    capacity
        Least total capacity of the committed units that run, MW: a number, or one per stage.

    Returns
    -------
    Commitment
        Also if there is none, see :attr:`Commitment.status`. Its series ``on`` are profiles of a problem.

    Raises
    ------
    IncompatibleError
        The horizon is a tree, the problem is secured, or its program is not linear; the message names the
        part.
    ModelError
        A unit is unknown, or an option invalid.

    References
    ----------
    .. [1] Morales-España, Latorre and Ramos, "Tight and compact MILP formulation for the thermal unit
       commitment problem", IEEE Transactions on Power Systems 28(4), 2013.
    .. [2] Rajan and Takriti, "Minimum up/down polytopes of the unit commitment problem with start-up costs",
       IBM Research Report RC23628, 2005.

    Examples
    --------
    >>> import opfmodel as om
    >>> grid = om.Network("one-bus")
    >>> grid.bus = om.Bus()
    >>> grid.coal = om.Generator("bus", p=(60, 100), cost=om.Polynomial(0, 20, 100), start_cost=500)
    >>> grid.gas = om.Generator("bus", p=(0, 100), cost=om.Polynomial(0, 50, 0))
    >>> grid.town = om.Load("bus", p=50)
    >>> problem = om.MultiStage(grid, 4, profiles={"town.p": [30, 90, 95, 20]})
    >>> found = om.commit(problem)
    >>> found.on["coal.on"].tolist(), round(found.objective)
    ([0.0, 1.0, 1.0, 0.0], 6900)
    """
    began = clock.perf_counter()
    gap = number_within("gap", gap, at_least=0.0)
    seconds = None if seconds is None else number_within("seconds", seconds, at_least=0.0)
    segments = integer("segments", segments, at_least=2)
    time = integer("time", time, at_least=0)
    _check(problem)
    names = _names(problem, units)
    linear = _linear(problem, names, time)
    horizon, made = linear.horizon, _units(linear, problem, names, time)
    least = np.asarray(capacity, dtype=float) / linear.arrays.base_mva
    if least.shape not in ((), (len(horizon),)) or not np.isfinite(least).all():
        raise ModelError(
            f"capacity = {shown(capacity)}: must be one number, or one per stage: {len(horizon)}"
        )
    least = np.broadcast_to(least, (len(horizon),))
    posed = partial(_posed, linear, names, time, initial)
    off, on = posed([]), posed(names)
    alone = [posed([name]) for name in names]
    program = UnitProgram(linear.model, linear.compile(), horizon, made, off, alone, on, least)
    program.spread_tangents(segments)
    share = 0.5 * gap if program.curved.size else gap
    for _ in range(_MOST_ROUNDS):
        found = solve_mixed(program.mixed(), share, seconds, verbose)
        if not found.found:
            break
        exact, stated = program.curve(found.x)
        error = float((exact - stated).sum())
        if error <= max(share, _LEAST_ERROR) * abs(found.objective):
            break
        far = np.flatnonzero(exact - stated > 0.1 * error / max(1, exact.size))
        program.add_tangents(found.x[program.curved[far]], far)
    return _result(problem, linear, program, names, time, found, clock.perf_counter() - began)


def _result(
    problem: MultiStage,
    linear: MultiStage,
    program: UnitProgram,
    names: Sequence[str],
    time: int,
    found: MixedSolution,
    seconds: float,
) -> Commitment:
    """Return a commitment in physical units, with its series over the base steps."""
    horizon, base = linear.horizon, linear.arrays.base_mva
    none = Commitment(
        on=Profiles(),
        starts={},
        status=status_word(found.status),
        termination=found.termination.value,
        objective=np.nan,
        bound=found.bound,
        seconds=seconds,
        formulation=linear.formulation.name,
    )
    if not found.found:
        return none
    exact, stated = program.curve(found.x)
    u, starts = (np.abs(found.x[index]) for index in (program.u, program.v))
    series = {}
    for name, row in zip(names, u, strict=True):
        past = [_declared(problem, name, step) for step in range(time)]
        series[f"{name}.on"] = np.concatenate([past, np.repeat(row, horizon.lengths)])
    return replace(
        none,
        on=Profiles(series, problem.profiles.calendar),
        starts={name: round(row.sum()) for name, row in zip(names, starts, strict=True)},
        objective=found.objective + float((exact - stated).sum()),
        capacity=(program.units.p_max * u).sum(axis=0) * base,
        available=(program.units.p_max * program.units.available).sum(axis=0) * base,
    )


def _check(problem: MultiStage) -> None:
    """Raise an error for problems that cannot be committed."""
    if not isinstance(problem, MultiStage):
        raise ModelError(f"problem = {shown(problem)}: must be a MultiStage")
    if not problem.horizon.is_chain:
        raise IncompatibleError("commitment: horizon with scenarios: must be a chain of stages")
    if problem.security is not None:
        raise IncompatibleError("commitment: security: must be none; secure the plan with the commitment")


def _names(problem: MultiStage, units: Iterable[str] | None) -> list[str]:
    """Return the names of the units that are committed."""
    table = problem.arrays.generator
    if units is None:
        wanted = (problem.peak.generator.p_min > 0).any(axis=1)
        for quantity in ("start_cost", "min_up", "min_down"):
            wanted |= table.arrays[quantity][:, 0] > 0
        return [name for name, chosen in zip(table.names, wanted, strict=True) if chosen]
    if isinstance(units, str):
        raise ModelError(f"units = {units!r}: must be a list of names")
    names = list(dict.fromkeys(units))
    for name in names:
        if name not in table.position:
            raise ModelError(
                f"units: {shown(name)}: no generator in service has this name; "
                f"{nearest(str(name), table.names)}"
            )
    return sorted(names, key=table.position.__getitem__)


def _linear(problem: MultiStage, names: Sequence[str], time: int) -> MultiStage:
    """Return the problem with a linear formulation, in which the units have a series of their status."""
    horizon = problem.horizon_from(time)
    steps = problem.profiles.length or 0
    if problem.at_end != "repeat" or not steps:
        steps = max(steps, time + horizon.steps)
    stated = Profiles({f"{name}.on": np.ones(steps) for name in names}, problem.profiles.calendar)
    formulations = [] if problem.formulation.reactive else [problem.formulation]
    for formulation in (*formulations, make_formulation("dc")):
        made = problem.variant(elastic=problem.elastic, horizon=horizon)
        made.formulation, made.regularisation, made.solver, made.options = formulation, 0.0, "auto", {}
        made.risk, made.outages = None, ()
        made.at_end = "repeat" if problem.at_end == "repeat" else "error"
        made.profiles = stated.or_else(problem.profiles)
        if classify(made.compile()).kind <= Kind.QUADRATIC:
            break
    return made


def _declared(problem: MultiStage, name: str, step: int) -> float:
    """Return whether a unit runs in a step, as declared."""
    values = problem.profiles.get(SeriesKey(name, "on"))
    if values is None:
        return float(problem.network[name].on)  # type: ignore[attr-defined]
    return float(values[step % values.size if problem.at_end == "repeat" else step])


def _units(linear: MultiStage, problem: MultiStage, names: Sequence[str], time: int) -> Units:
    """Return the data of the units that are committed."""
    horizon, table = linear.horizon, linear.arrays.generator
    item = np.array([table.position[name] for name in names], dtype=np.intp)
    fields = _fields(linear, time, linear.profiles)

    def of(name: str) -> Array:
        values = fields.get(("generator", name), table.arrays[name])
        return np.broadcast_to(values[item], (item.size, len(horizon))).copy()

    available = np.zeros((item.size, len(horizon)), dtype=bool)
    for i, name in enumerate(names):
        stated = np.array([_declared(problem, name, time + step) for step in range(horizon.steps)])
        part = stated[(stated > 0) & (stated < 1)]
        if part.size:
            raise ModelError(f"{name}: on = {part[0]:g}: must be 0 or 1 for a unit that is committed")
        available[i] = np.minimum.reduceat(stated, horizon.step) > 0
    return Units(
        item=item,
        p_min=of("p_min"),
        p_max=of("p_max"),
        ramp=of("ramp"),
        available=available,
        min_up=table.min_up[item, 0],
        min_down=table.min_down[item, 0],
        before=np.array([_before(problem, name, time) for name in names]),
    )


def _posed(
    linear: MultiStage, names: Sequence[str], time: int, initial: Initial | None, on: Collection[str]
) -> Instance:
    """Return the instance in which some of the committed units run in all stages, and before."""
    horizon, arrays = linear.horizon, linear.arrays
    stated = Profiles({f"{name}.on": np.full(time + horizon.steps, float(name in on)) for name in names})
    profiles = stated.or_else(linear.profiles)
    if time:
        before = window(profiles, arrays, time - 1, 1, linear.at_end == "repeat")
    else:
        before = at_start(arrays)
        item = [arrays.generator.position[name] for name in names]
        before["generator", "on"][item] = np.nan
    fields = _fields(linear, time, profiles)
    expected = governed(fields, linear.profiles, arrays, horizon.parent, horizon.hours, before)
    return linear.pose(Request(time, initial, linear.end, expected, horizon))[0]


def _fields(linear: MultiStage, time: int, profiles: Profiles) -> dict[tuple[str, str], Array]:
    """Return series at the nodes of a plan."""
    ahead = window(profiles, linear.arrays, time, linear.horizon.steps, linear.at_end == "repeat")
    return over_nodes([ahead], linear.horizon, linear.arrays)


def _before(problem: MultiStage, name: str, time: int) -> float:
    """Return for how long a unit has been running before a step, h; negative: shut down; NaN if not known."""
    stated = problem.network[name].hours_on  # type: ignore[attr-defined]
    known = np.nan if stated is None else float(stated)
    if time == 0:
        return known
    if ("generator", "on") not in fields_with_series(problem.profiles, problem.arrays):
        return np.nan
    now, step = _declared(problem, name, time - 1), time - 1
    while step > 0 and _declared(problem, name, step - 1) == now:
        step -= 1
    hours = (time - step) * problem.step
    if step == 0 and not np.isnan(known) and (known > 0) == (now > 0.5):
        hours += abs(known)
    return hours if now > 0.5 else -hours


def plan_with_commitment(
    problem: MultiStage,
    time: int = 0,
    initial: Initial | None = None,
    *,
    units: Iterable[str] | None = None,
    gap: float = 1e-4,
    seconds: float | None = None,
    segments: int = 8,
) -> tuple[Plan, list[Commitment]]:
    """Commit units on the linear model, then solve the problem with that commitment, and repair it.

    If the problem has no solution with the commitment, for example because the voltages need more units, up
    to three more are made: with a capacity of the units that run that is 2, 5 and 10 % above that of the
    first one in every stage, or all of it where that is less.

    Parameters
    ----------
    problem, time, initial, units, gap, seconds, segments
        As for :func:`commit`.

    Returns
    -------
    plan
        The last plan; its problem has the series ``on``. Without a commitment, units run as declared.
    commitments
        The commitments in order; the last one that was found is that of the plan.
    """
    search = partial(commit, problem, time, initial, units=units, gap=gap, seconds=seconds, segments=segments)
    made = [search()]
    if not made[0].found:
        return problem.solve(time, initial), made
    plan = with_commitment(problem, made[0]).solve(time, initial)
    for margin in _MARGINS:
        if plan.optimal:
            break
        least = np.minimum((1.0 + margin) * made[0].capacity, made[0].available)
        made.append(replace(search(capacity=least), margin=margin))
        if made[-1].found:
            plan = with_commitment(problem, made[-1]).solve(time, initial)
    return plan, made


def committed_ahead(problem: MultiStage, steps: int, initial: Initial | None = None) -> MultiStage:
    """Return a problem with the status of its units in all steps that the plans of a closed loop see.

    Parameters
    ----------
    problem
        The problem of the plans.
    steps
        Steps of the loop; its last plan looks a horizon further, or to the end of the data.

    Raises
    ------
    ModelError
        There is no commitment.
    """
    _check(problem)
    ahead = steps + problem.horizon.steps - 1
    if problem.at_end == "shrink":
        ahead = min(ahead, problem.profiles.length or ahead)
    whole = problem.variant(elastic=problem.elastic, horizon=Horizon.chain(ahead, problem.step))
    found = commit(whole, 0, initial)
    if not found.found:
        raise ModelError(f"no commitment of {ahead} steps: {found.status} ({found.termination})")
    return with_commitment(problem, found)


def with_commitment(problem: MultiStage, commitment: Commitment) -> MultiStage:
    """Return the same problem with the series of a commitment."""
    made = problem.variant(elastic=problem.elastic)
    made.profiles = commitment.on.or_else(problem.profiles)
    return made
