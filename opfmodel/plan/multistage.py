"""Multi-stage problems: a network, horizon, formulation and objective compiled into one program."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import Any, get_args

import numpy as np
import numpy.typing as npt

from opfmodel.data.calendar import Times, duration
from opfmodel.data.notebook import pairs
from opfmodel.data.series import Profiles
from opfmodel.errors import (
    ConstraintError,
    IncompatibleError,
    ModelError,
    shown,
)
from opfmodel.formulations.base import Formulation
from opfmodel.horizon import Horizon
from opfmodel.model import CustomConstraint, Device, Elastic, Model, Price, Published, Stage
from opfmodel.network.arrays import PerUnitNetwork, per_unit
from opfmodel.network.bounds import integer, number_within
from opfmodel.network.clock import check_clocked, clocked
from opfmodel.network.governed import at_start, governed, governing
from opfmodel.network.network import Network
from opfmodel.network.series import check_series, window
from opfmodel.objectives.base import Objective
from opfmodel.objectives.economic import Economic
from opfmodel.plan.compiled import Compiled, compiled, declared
from opfmodel.plan.end import End
from opfmodel.plan.extent import AtEnd, check_lengths, steps_from
from opfmodel.plan.memory import check_memory, problem_bytes
from opfmodel.plan.nodes import over_nodes
from opfmodel.plan.outages import check_declared, check_stated
from opfmodel.plan.parts import make_devices, make_formulation
from opfmodel.plan.positions import at_positions
from opfmodel.plan.request import Initial, Limits, Request
from opfmodel.plan.result import Plan
from opfmodel.plan.risk import Risk
from opfmodel.plan.screening import Contingency, Screening
from opfmodel.plan.security import NOTHING, Security
from opfmodel.plan.shortage import Nothing, without_outbidding
from opfmodel.plan.solving import posed, solved
from solvers import Instance, Program, Session, in_parts
from solvers.interrupt import interruptible

__all__ = ["Initial", "MultiStage"]

Array = npt.NDArray[np.float64]
Fields = dict[tuple[str, str], Array]

# What a program is compiled from; the constraints are added by a method.
_STATED = frozenset(
    (
        "network", "horizon", "arrays", "formulation", "objective", "profiles", "generator_delay",
        "end", "regularisation", "elastic", "risk", "security", "outages", "devices", "at_end", "solver",
        "options", "verbose",
    )
)  # fmt: skip


# Clarabel certifies infeasibility; with more passes some problems of many stages end without a result.
_RELAXED = ("clarabel", {"equilibrate_max_iter": 1})


class MultiStage:
    """An optimal power flow over several stages, compiled once and solved any number of times.

    Parameters
    ----------
    network
        The network.
    horizon
        Number of stages, where 1 is an ordinary optimal power flow; or a :class:`opfmodel.Horizon`: an uneven
        grid or a tree of scenarios.
    step
        Length of a stage in hours, if the horizon is a number of stages; by default that of the time series,
        or 1 h if they have no time stamps.
    formulation
        Name or instance of a formulation.
    objective
        An objective; :class:`opfmodel.Economic` by default.
    profiles
        Time series ``{"component.field": values}``; see :class:`opfmodel.Profiles`. They override those
        of the network, one by one.
    generator_delay
        0: the dispatch of the first stage is decided, ramp-limited from the last one applied.
        1: it is given, and decisions take effect one stage later (Faulwasser and Engelmann).
    end
        Terminal conditions on stored energy; see :class:`End`.
    regularisation
        Weight in $/(h p.u.²) of the squares of storage power, which make the problem well posed and are
        part of no reported cost. Per unit refers to :attr:`Network.scale_mva`, at most 100 MVA, not to
        the base of the impedances. The objective's own weight by default.
    elastic
        Penalty prices of soft limits, with which there is always a solution; see :class:`Elastic`.
        By default every limit is hard.
    risk
        Risk aversion over the scenarios of a tree; by default the expected cost is minimised.
    security
        Outages that every stage must survive; see :class:`Security`. None by default.
    outages
        Names of the branches, units and other components that a solve may take as out of service; see the
        argument ``out`` of :meth:`solve`.
    devices
        Devices for kinds of components without a plugin, or to replace a plugin's.
    at_end
        What a plan does that looks beyond the end of the data (time series of the network, the objective
        and the constraints). ``error``: it is refused. ``repeat``: the whole series follow once more, and
        again. ``shrink``: the plan ends with the data; the program is the same for all horizons.
    solver, options
        Back end and its options; see :func:`solvers.prepare`.
    verbose
        Whether the solver prints its iterations.

    Attributes
    ----------
    constraints
        Custom constraints, by name; see :meth:`constrain`.

    Examples
    --------
    >>> import opfmodel as om
    >>> grid = om.Network("one-bus")
    >>> grid.bus = om.Bus()
    >>> grid.unit = om.Generator("bus", p=(0, 100), cost=om.Polynomial(0, 20, 0))
    >>> grid.town = om.Load("bus", p=50)
    >>> plan = om.MultiStage(grid, horizon=3).solve()
    >>> round(plan.objective, 3)
    3000.0
    """

    def __init__(
        self,
        network: Network,
        horizon: int | Horizon = 1,
        step: float | None = None,
        *,
        formulation: str | Formulation = "ac",
        objective: Objective | None = None,
        profiles: Mapping[str, npt.ArrayLike] | Profiles | None = None,
        generator_delay: int = 0,
        end: End | None = None,
        regularisation: float | None = None,
        elastic: Elastic | None = None,
        risk: Risk | None = None,
        security: Security | None = None,
        outages: Iterable[str] = (),
        devices: Iterable[Device] = (),
        at_end: AtEnd = "error",
        solver: str = "auto",
        options: Mapping[str, Any] | None = None,
        verbose: bool = False,
    ) -> None:
        if isinstance(generator_delay, bool) or generator_delay not in (0, 1):
            raise ModelError(f"generator_delay = {generator_delay!r}: must be 0 or 1")
        if at_end not in get_args(AtEnd):
            raise ModelError(f"at_end = {at_end!r}: must be {', '.join(map(repr, get_args(AtEnd)))}")
        if not isinstance(network, Network):
            raise ModelError(f"network = {shown(network)}: must be a Network")
        for name, value, kind in (
            ("objective", objective, Objective),
            ("end", end, End),
            ("elastic", elastic, Elastic),
            ("risk", risk, Risk),
            ("security", security, Security),
        ):
            if not (value is None or isinstance(value, kind)):
                raise ModelError(
                    f"{name} = {shown(value)}: must be None or an object of class {kind.__name__}"
                )
        self.profiles = Profiles.of(profiles).or_else(network.profiles)
        check_series(self.profiles, network)
        self.network = network.copy()  # what is changed from now on is for other problems
        self.network.attach(Profiles())  # the problem has them
        self.arrays = per_unit(self.network)
        self.formulation = make_formulation(formulation)
        stages = len(horizon) if isinstance(horizon, Horizon) else integer("horizon", horizon, at_least=1)
        needed = problem_bytes(self.arrays.n_components, stages, self.formulation.reactive, in_parts(solver))
        check_memory(f"horizon = {stages:,}", needed)
        self.horizon = self._horizon(horizon, step)
        self.outages = check_declared(outages, self.peak)
        self.security = security
        if security is not None:
            self._check_secured(elastic)
            self._secure(security)
        self.objective = Economic() if objective is None else objective
        self.generator_delay = generator_delay
        self.end = End() if end is None else end
        self.regularisation = (
            self.objective.regularisation
            if regularisation is None
            else number_within("regularisation", regularisation, at_least=0)
        )
        self.elastic = elastic
        self.risk = risk
        self.devices = make_devices(self.arrays, devices)
        self.at_end = at_end
        simple = self.horizon.is_chain and self.horizon.is_even and security is None
        if at_end == "shrink" and not simple:
            raise IncompatibleError(
                "at_end = 'shrink': needs stages of one step, without scenarios and security; "
                "use 'error' or 'repeat'"
            )
        self.solver = solver
        self.options = dict(options or {})
        self.verbose = verbose
        self.constraints: dict[str, CustomConstraint] = {}
        self.rationed, self.split_shedding = False, False
        self._family = object()  # shared with the variants, which are copies

    def __setattr__(self, name: str, value: Any) -> None:
        if name in _STATED and "_compiled" in self.__dict__:
            raise ModelError(f"{name}: the problem is already compiled; create another one")
        super().__setattr__(name, value)

    def _horizon(self, given: int | Horizon, step: float | None) -> Horizon:
        """Return a horizon, from its number of stages and their length if it is not one."""
        calendar = self.profiles.calendar
        stated = given.base if isinstance(given, Horizon) else step
        if isinstance(given, Horizon) and step is not None and step != given.base:
            raise ModelError(
                f"step = {step!r}: the horizon has steps of {given.base:g} h; leave the step out"
            )
        if stated is not None and calendar is not None and not calendar.has_step(stated):
            raise ModelError(
                f"step = {stated!r}: the time series have steps of {duration(calendar.step)}; "
                "leave the step out, or resample the series"
            )
        if isinstance(given, Horizon):
            if given.out:
                raise ModelError("horizon: has contingencies; state them by security = Security(...)")
            return given
        known = 1.0 if calendar is None else calendar.step
        return Horizon.chain(given, known if stated is None else stated)

    def __repr__(self) -> str:
        return (
            f"MultiStage({self.network.name!r}: {self.horizon}, {self.formulation.name}, "
            f"{type(self.objective).__name__})"
        )

    def _repr_html_(self) -> str:
        """Show what is solved in a notebook."""
        known = {
            "horizon": str(self.horizon),
            "formulation": self.formulation.name,
            "objective": type(self.objective).__name__,
            "solver": self.solver,
            "constraints": ", ".join(self.constraints) or "none",
        }
        return pairs(self.network.name, known)

    @property
    def stages(self) -> int:
        """Number of stages, which are the nodes of the horizon without contingencies."""
        return len(self.horizon.regular)

    @property
    def step(self) -> float:
        """Length of a base step in hours: that of the time series, and of a closed loop."""
        return self.horizon.base

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the network and its formulation: components left out, and choices made for it."""
        own = () if self.security is None else self.security.notes(self.peak)
        return (*self.arrays.notes, *self.formulation.notes(self.arrays), *own)

    def _check_secured(self, elastic: Elastic | None) -> None:
        """Raise :class:`IncompatibleError` for a problem that cannot be secured."""
        if elastic is not None and elastic.traded:
            raise IncompatibleError(
                "security with shortfalls that are traded against cost (limits: soft): those after outages "
                "that have not happened would outweigh real ones; use hard limits"
            )
        if self.formulation.slack_losses:
            raise IncompatibleError(
                f"security with formulation {self.formulation.name!r}: after an outage its losses cost "
                "nothing and would absorb any power; use ac, soc or dc"
            )

    def _secure(self, security: Security) -> None:
        """Check the contingencies; unless they are screened, the horizon has them all."""
        names = security.outages(self.peak)
        if security.screen:
            return
        after = [(node, (name,)) for node in range(len(self.horizon)) for name in names]
        self.horizon = self._with_contingencies(security, after)

    def _with_contingencies(self, security: Security, after: Iterable[Contingency]) -> Horizon:
        """Return the horizon with contingencies, if the problem then fits in memory."""
        made = self.horizon.with_contingencies(after, security.response_minutes)
        states = problem_bytes(self.arrays.n_components, len(made), self.formulation.reactive)
        check_memory(f"security: {len(made):,} stages and contingencies", states)
        return made

    @property
    def peak(self) -> PerUnitNetwork:
        """The arrays of the network with the series from their beginning to their end."""
        steps = self.profiles.length
        return self.arrays.with_series(window(self.profiles, self.arrays, 0, steps)) if steps else self.arrays

    def constrain(
        self,
        name: str,
        constraint: Callable[[Stage], Any],
        *,
        at_least: npt.ArrayLike | None = None,
        at_most: npt.ArrayLike | None = None,
    ) -> None:
        """Add a custom constraint, for every formulation that publishes the quantities it uses.

        Results contain its price ``<name>_price``: the increase in cost, $/h, per unit increase of the
        right-hand side. It is positive where a lower limit binds, negative where an upper limit binds, and
        zero elsewhere. A constraint on only some of the stages has no price.

        Parameters
        ----------
        name
            Name for messages and prices.
        constraint
            A function of the stage, with quantities in physical units. It returns a comparison, elementwise
            or of totals, or a quantity or total to which the limits below apply.
        at_least, at_most
            Limits in physical units: a number, or one value per time step, which moves with the
            horizon as profiles do.

        Examples
        --------
        A reserve of 100 MW in every stage::

            plan.constrain("reserve", lambda s: om.total(s.generator.p_max - s.generator.pg) >= 100)

        and one that varies over time::

            plan.constrain(
                "reserve",
                lambda s: om.total(s.generator.p_max - s.generator.pg),
                at_least=[100, 120, 140, 100],
            )
        """
        if "_compiled" in self.__dict__:
            raise ModelError(f"constraint {name!r}: the problem is already compiled; add constraints first")
        if name in self.constraints:
            raise ModelError(f"two constraints are named {name!r}")
        try:
            self.constraints[name] = CustomConstraint.of(name, constraint, at_least, at_most)
        except ConstraintError as error:
            raise ModelError(f"constraint {name!r}: {error}") from error

    def elastic_twin(self, prices: Elastic | None = None) -> MultiStage:
        """Return the same problem with soft limits, to diagnose its shortfalls.

        Examples
        --------
        >>> import opfmodel as om
        >>> grid = om.Network("one-bus")
        >>> grid.bus = om.Bus()
        >>> grid.unit = om.Generator("bus", p=(0, 40), cost=om.Polynomial(0, 20, 0))
        >>> grid.town = om.Load("bus", p=50)
        >>> problem = om.MultiStage(grid)
        >>> problem.solve().optimal
        False
        >>> print(problem.elastic_twin().solve().shortages[0])
        bus bus lacks 10.0 MW at hour 0
        """
        soft = Elastic() if prices is None else prices
        if self.security is not None:
            self._check_secured(soft)
        return self.variant(elastic=soft)

    def variant(
        self,
        *,
        elastic: Elastic | None,
        objective: Objective | None = None,
        rationed: bool = False,
        horizon: Horizon | None = None,
        split_shedding: bool = False,
    ) -> MultiStage:
        """Return the same problem with other penalty prices, another objective, or a limit on the penalty.

        Parameters
        ----------
        rationed
            Whether every solve limits the penalty.
        horizon
            The horizon, if it differs.
        split_shedding
            Whether active and reactive demand may be shed in different shares.
        """
        twin = copy(self)
        for name, member in vars(MultiStage).items():
            if isinstance(member, cached_property):
                vars(twin).pop(name, None)
        twin.constraints = dict(self.constraints)
        twin.elastic, twin.rationed, twin.split_shedding = elastic, rationed, split_shedding
        twin.horizon = self.horizon if horizon is None else horizon
        twin.objective = self.objective if objective is None else objective
        return twin

    def contingency_problem(self, security: Security, outages: Sequence[str]) -> MultiStage:
        """Return the problem of one stage and one outage after it, with soft limits and no other cost.

        Parameters
        ----------
        outages
            The components that may go out; which of them does, if any, is stated by each solve.
        """
        after = Horizon.chain(1, self.step).with_contingencies([(0, (NOTHING,))], security.response_minutes)
        alone = self.variant(elastic=Elastic(), objective=Nothing(self.objective), horizon=after)
        alone._check_secured(alone.elastic)
        alone.security, alone.risk, alone.constraints = security, None, {}
        alone.devices = [device for device in alone.devices if device.physical]
        alone.outages = tuple(dict.fromkeys([*self.outages, *outages, NOTHING]))
        return alone

    def with_security(
        self, security: Security | None, after: Iterable[Contingency] | None = None
    ) -> MultiStage:
        """Return the same problem with other outages to survive, or none.

        Parameters
        ----------
        after
            The contingencies to include, without screening: a stage and what goes out after it.
        """
        made = self.variant(elastic=self.elastic, horizon=self.horizon.regular)
        made.security = security
        if security is not None and after is not None:
            made.security = replace(security, screen=False)
            made.horizon = made._with_contingencies(security, after)
        elif security is not None:
            made._check_secured(made.elastic)
            made._secure(security)
        return made

    @cached_property
    def relaxed_problem(self) -> MultiStage:
        """The same problem in the formulation that relaxes its own, without regularisation.

        Raises
        ------
        IncompatibleError
            No formulation is known that relaxes it.
        """
        relaxing = self.formulation.relaxed_by
        if relaxing is None:
            raise IncompatibleError(f"formulation {self.formulation.name!r}: no relaxation of it is known")
        made = self.variant(elastic=self.elastic)
        made.formulation, made.regularisation = make_formulation(relaxing), 0.0
        made.solver, made.options = _RELAXED
        return made

    @cached_property
    def screening(self) -> Screening:
        """The contingencies that plans of this problem include, and what is tested for the others."""
        return Screening(self)

    def is_variant_of(self, other: MultiStage) -> bool:
        """Return whether this is the other problem, or a :meth:`variant` of the same one."""
        return self._family is other._family

    @cached_property
    def shortage_problems(self) -> tuple[MultiStage, MultiStage]:
        """The problem of minimum penalty, and that of minimum cost at a given penalty."""
        least = self.variant(elastic=self.elastic, objective=Nothing(self.objective))
        return least, self.variant(elastic=self.elastic, rationed=True)

    @cached_property
    def split_shedding_problem(self) -> MultiStage:
        """The problem of minimum penalty in which active and reactive demand are shed independently."""
        return self.variant(elastic=self.elastic, objective=Nothing(self.objective), split_shedding=True)

    @cached_property
    def expected_problem(self) -> MultiStage:
        """The problem of the expected future alone."""
        chain = self.variant(elastic=self.elastic, horizon=self.horizon.trunk)
        chain.risk = None  # of a single future there is none
        chain.security = None
        chain.constraints = {}  # they may name nodes; without them it is still a start
        return chain

    @property
    def described(self) -> dict[str, tuple[str, str]]:
        """Unit and description of each published quantity."""
        model = self.model
        named: dict[str, Published | Price] = {**model.published, **model.reported, **model.prices}
        slacks = {
            name: (s.soft.unit, s.soft.sentence(s.side).format("this amount"))
            for name, s in model.slacks.items()
        }
        injections = {i.name: (i.unit, i.description) for i in model.injections}
        return slacks | {name: (p.unit, p.description) for name, p in named.items()} | injections

    def check_lengths(self, steps: int, metered: Objective | None = None) -> None:
        """Raise :class:`ModelError` if data that vary over time are too short for a closed loop.

        Parameters
        ----------
        steps
            Steps of the loop; the plan of the last one looks a horizon ahead.
        metered
            Objective that evaluates the realised costs; by default that of the problem.
        """
        check_lengths(self, steps, metered)

    def horizon_from(self, time: int) -> Horizon:
        """Return the horizon of the plan from a step on: a shorter one if plans end with the data.

        Raises
        ------
        ModelError
            The data end before the step.
        """
        steps = steps_from(self, time)
        return self.horizon if steps == self.horizon.steps else Horizon.chain(steps, self.step)

    def times(self, first: int, horizon: Horizon | int) -> Times:
        """Return the beginnings of the stages of a horizon, or of a number of steps, from a step on."""
        begins = np.arange(horizon) if isinstance(horizon, int) else horizon.step
        return Times(first + begins, self.step, self.profiles.calendar)

    def step_name(self, step: int) -> str:
        """Return a step for messages: its number, and its local time if the series have time stamps."""
        calendar = self.profiles.calendar
        return f"step {step}" if calendar is None else f"step {step} ({calendar.shown(step)})"

    def window(self, start: int, steps: int, objective: Objective | None = None) -> PerUnitNetwork:
        """Return the network with the time series of ``steps`` base steps from ``start``.

        Parameters
        ----------
        objective
            The objective whose series are included; by default that of the problem.

        Raises
        ------
        ProfileError, ModelError
            A series of the profiles or of the objective ends before the window does.
        """
        series = self._series(start, steps, objective)
        return self.arrays.with_series(self._governed(series, start, Horizon.chain(steps, self.step)))

    def ahead(self, time: int) -> Fields:
        """Return the data at the nodes of the plan from a step on, ``(items, nodes)`` per unit."""
        horizon = self.horizon_from(time)
        check_clocked(self.network, self.arrays, self.times(time, horizon), horizon.lengths)
        ahead = over_nodes([self._series(time, horizon.steps)], horizon, self.arrays)
        return self._governed(ahead, time, horizon)

    def _governed(self, series: Fields, time: int, horizon: Horizon) -> Fields:
        """Return series at the nodes of a plan with the quantities that depend on others in each stage."""
        if not self._governing:
            return series
        repeats = self.at_end == "repeat"
        before = window(self.profiles, self.arrays, time - 1, 1, repeats) if time else at_start(self.arrays)
        return governed(series, self.profiles, self.arrays, horizon.parent, horizon.hours, before)

    @cached_property
    def _governing(self) -> bool:
        return bool(governing(self.profiles, self.arrays))

    def expected(self, futures: Sequence[Profiles], horizon: Horizon | None = None, time: int = 0) -> Fields:
        """Return expected series at the nodes of the horizon, as :meth:`solve` takes them.

        Parameters
        ----------
        futures
            Series of ``horizon.steps`` values, one set per future of the horizon or one for all.
        horizon
            That of the plan, see :meth:`horizon_from`; by default that of the problem.
        time
            First step of the plan.

        Returns
        -------
        dict
            Arrays ``(items, nodes)`` in per unit by ``(kind, field)``.
        """
        nodes = self.horizon if horizon is None else horizon
        ahead = [window(own, self.arrays, 0, nodes.steps) for own in futures]
        return self._governed(over_nodes(ahead, nodes, self.arrays), time, nodes)

    def _series(self, start: int, steps: int, objective: Objective | None = None) -> Fields:
        """Return the time series of a window by ``(kind, field)``, per unit ``(items, steps)``."""
        repeats = self.at_end == "repeat"
        times = Times(np.arange(start, start + steps), self.step, self.profiles.calendar)
        series = window(self.profiles, self.arrays, start, steps, repeats)
        series |= clocked(self.network, self.arrays, times)
        objective = self.objective if objective is None else objective
        for key, values in self.series_of(objective).items():
            known = values.shape[1]
            if known == 1 or repeats:
                series[key] = values[:, np.arange(start, start + steps) % known]
            elif known < start + steps:
                raise ModelError(
                    f"{type(objective).__name__}: {key[1]} has {known} values; "
                    f"steps {start} to {start + steps - 1} need {start + steps}"
                )
            else:
                series[key] = values[:, start : start + steps]
        return series

    @cached_property
    def _objective_series(self) -> Mapping[tuple[str, str], Array]:
        return self.objective.series(self.arrays)

    def series_of(self, objective: Objective) -> Mapping[tuple[str, str], Array]:
        """Return the series of an objective, per unit; those of the problem's own are cached."""
        own = objective is self.objective
        return self._objective_series if own else objective.series(self.arrays)

    # Compiling ---------------------------------------------------------------------------

    @cached_property
    def _compiled(self) -> Compiled:
        return compiled(self)

    def compile(self) -> Program:
        """Return the program, compiled at the first call or solve."""
        return self._compiled.program

    @property
    def model(self) -> Model:
        """Declarations of the formulation and the devices; compiles the problem if necessary."""
        return self._compiled.model

    @property
    def session(self) -> Session:
        """The prepared solver; compiles the problem if necessary."""
        return self._compiled.session

    @property
    def build_seconds(self) -> float:
        """Time that compilation took; 0 before."""
        return self._compiled.seconds if "_compiled" in self.__dict__ else 0.0

    def declare(self, horizon: Horizon | None = None) -> Model:
        """Return the declarations of formulation and devices, without objective and constraints; uncached.

        Parameters
        ----------
        horizon
            The horizon, if it differs.
        """
        return declared(self, self.horizon if horizon is None else horizon)

    # Solving -----------------------------------------------------------------------------

    @interruptible()
    def solve(
        self,
        time: int = 0,
        initial: Initial | None = None,
        previous: Plan | None = None,
        end: End | None = None,
        multipliers: bool = True,
        expected: Mapping[tuple[str, str], Array] | None = None,
        horizon: Horizon | None = None,
        out: Sequence[str] = (),
    ) -> Plan:
        """Solve for the stages from ``time`` on.

        Parameters
        ----------
        time
            First step of the profiles.
        initial
            Initial values by state (``e`` in MWh, ``pg`` in MW, ``qg`` in MVAr), one per
            component; None leaves a state free. A state not listed starts from its
            component (``Storage.initial``) or is free.
        previous
            An earlier plan of this problem to warm-start from, shifted by the difference in time.
        end
            Terminal conditions of this solve, in place of the problem's.
        multipliers
            Whether the warm start includes the multipliers of the earlier plan; without them, only its
            primal point is used.
        expected
            Values of fields over the stages of the plan by ``(kind, field)``, ``(items, stages)`` in per
            unit, in place of those of the profiles or the objective; for instance a forecast, see
            :meth:`expected`.
        horizon
            The horizon with other probabilities, if it declares that they vary.
        out
            Names of components that are out of service from ``time`` on, of those declared as
            :attr:`outages`; their return is not known in advance. A contingency that would now split the
            grid is left out.

        Returns
        -------
        Plan
            Also if the solver fails; see :attr:`Plan.status`. For an elastic problem, the cheapest of the
            plans with the minimum penalty, or that with the minimum sum of cost and penalty if the prices
            are :attr:`Elastic.traded`.
        """
        nodes = self.horizon if horizon is None else horizon
        gone = check_stated(out, self.outages, self.peak) if out != () else ()
        request = Request(time, initial, self.end if end is None else end, expected, nodes, gone)
        return self.solve_requested(request, previous, multipliers)

    def solve_requested(
        self, request: Request, previous: Plan | None = None, multipliers: bool = True
    ) -> Plan:
        """Solve for a request; see :meth:`solve`."""
        secured = self.security is not None and self.security.screen
        solve = self.screening.solve if secured else self.solve_included
        plan = solve(request, previous, multipliers)
        return at_positions(plan, lambda held: solve(held, plan, True), self._solve_short)

    def _solve_short(self, request: Request) -> Plan:
        """Solve for the minimum penalty of soft limits, without other costs and outages to survive."""
        return self._short.solve_once(replace(request, horizon=request.horizon.regular))

    @cached_property
    def _short(self) -> MultiStage:
        """The problem of minimum penalty, without outages to survive."""
        return self.with_security(None).elastic_twin().shortage_problems[0]

    def solve_included(self, request: Request, previous: Plan | None, multipliers: bool) -> Plan:
        """Solve the problem as it is, without screening; an elastic one for minimum penalty first."""
        plan = self.solve_once(request, previous, multipliers)
        certain = self.elastic is None or self.elastic.traded or (plan.optimal and not plan.short)
        return plan if certain else without_outbidding(self, plan)

    def solve_once(
        self,
        request: Request,
        previous: Plan | None = None,
        multipliers: bool = True,
        limits: Limits | None = None,
    ) -> Plan:
        """Solve the compiled problem once; an elastic one for the sum of cost and penalty.

        Parameters
        ----------
        limits
            Bounds of rows and variables, by block, in place of those of the request.
        """
        return solved(self, self._compiled, request, previous, multipliers, limits)

    def pose(self, request: Request, limits: Limits | None = None) -> tuple[Instance, PerUnitNetwork]:
        """Return what :meth:`solve_once` would solve, and the network at its nodes."""
        return posed(self, self._compiled, request, limits)
