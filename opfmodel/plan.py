"""Plans: a network, a horizon, a formulation and an objective compiled into one program."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Iterable, Mapping
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from opfmodel import plugins
from opfmodel.components import Network
from opfmodel.elastic import Elastic, Shortage, Soft, shortages
from opfmodel.errors import ModelError, PluginError, QuantityError, nearest
from opfmodel.formulations.base import Formulation
from opfmodel.model import Device, Model, NumericStage, Price, Published, Stage
from opfmodel.network import PerUnitNetwork, per_unit
from opfmodel.objectives.base import Objective
from opfmodel.objectives.economic import Economic
from opfmodel.profiles.series import Profiles
from opfmodel.units import scale
from solvers import (
    Constraint,
    Expression,
    Instance,
    Program,
    Session,
    Solution,
    SolutionStatus,
    SolverError,
    Start,
    Sum,
    prepare,
    total,
)

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["End", "MultiStage", "PhysicalStage", "Plan", "make_devices", "make_formulation", "status_word"]

Array = npt.NDArray[np.float64]
Initial = Mapping[str, "npt.ArrayLike | None"]


@dataclass(frozen=True)
class End:
    """What is asked of stored energy at the end of the horizon.

    Parameters
    ----------
    cyclic
        As much as at its start: e(N) = e(0).
    minimum
        At least this share of the capacity, from 0 to 1.
    price
        Value of what is left, $/MWh.
    """

    cyclic: bool = False
    minimum: float = 0.0
    price: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.minimum <= 1.0:
            raise ModelError(f"end of horizon: minimum = {self.minimum!r}: must be a share between 0 and 1")
        if not np.isfinite(self.price):
            raise ModelError(f"end of horizon: price = {self.price!r}: must be a number in $/MWh")


class MultiStage:
    """An optimal power flow over several stages, compiled once and solved any number of times.

    Parameters
    ----------
    network
        The declared network.
    horizon
        Number of stages; 1 is an ordinary optimal power flow.
    step
        Length of a stage in hours.
    formulation
        Name of a formulation, or an instance of one.
    objective
        An objective; :class:`opfmodel.Economic` by default.
    profiles
        Time series ``{"component.field": values}``; see :class:`opfmodel.Profiles`.
    generator_delay
        0: the dispatch of the first stage is decided, ramp-limited from the last one applied.
        1: it is given, and decisions take effect one stage later (Faulwasser and Engelmann).
    end
        What is asked of stored energy at the end; see :class:`End`.
    regularisation
        Weight in $/(h p.u.²) on the squares of storage power, which makes the problem well posed
        and is not part of any reported cost. By default the objective's own.
    elastic
        Prices at which limits give way, so that there is always a solution; see :class:`Elastic`.
        By default every limit is hard.
    devices
        Devices for kinds of components that no plugin provides, or in place of a plugin's.
    solver, options
        Back end and its options; see :func:`solvers.prepare`.
    verbose
        Whether the solver prints its iterations.

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
        horizon: int = 1,
        step: float = 1.0,
        *,
        formulation: str | Formulation = "ac",
        objective: Objective | None = None,
        profiles: Mapping[str, npt.ArrayLike] | Profiles | None = None,
        generator_delay: int = 0,
        end: End | None = None,
        regularisation: float | None = None,
        elastic: Elastic | None = None,
        devices: Iterable[Device] = (),
        solver: str = "auto",
        options: Mapping[str, Any] | None = None,
        verbose: bool = False,
    ) -> None:
        if isinstance(horizon, bool) or not isinstance(horizon, int) or horizon < 1:
            raise ModelError(f"horizon = {horizon!r}: must be a whole number of stages, at least 1")
        if not isinstance(step, int | float) or not 0 < step < np.inf:
            raise ModelError(f"step = {step!r}: must be a positive number of hours")
        if generator_delay not in (0, 1):
            raise ModelError(f"generator_delay = {generator_delay!r}: must be 0 or 1")
        self.network = network
        self.horizon = horizon
        self.step = float(step)
        self.arrays = per_unit(network)
        self.formulation = make_formulation(formulation)
        self.objective = Economic() if objective is None else objective
        self.profiles = Profiles.of(profiles)
        self.profiles.check(network, self.arrays)
        self.generator_delay = generator_delay
        self.end = End() if end is None else end
        self.regularisation = self.objective.regularisation if regularisation is None else regularisation
        self.elastic = elastic
        self.devices = make_devices(self.arrays, devices)
        self.solver = solver
        self.options = dict(options or {})
        self.verbose = verbose
        self.build_seconds = 0.0
        self._constraints: dict[str, _Own] = {}

    @property
    def notes(self) -> tuple[str, ...]:
        """What was left out of the network or chosen for it."""
        return self.arrays.notes

    def constrain(
        self,
        name: str,
        constraint: Callable[[Stage], Any],
        *,
        at_least: npt.ArrayLike | None = None,
        at_most: npt.ArrayLike | None = None,
    ) -> None:
        """State a constraint of one's own, for every formulation that publishes what it uses.

        Results have its price ``<name>_price``: how much the cost in $/h rises when its right-hand
        side rises by one unit. It is positive where a least value binds, negative where a
        largest value does, zero where the constraint does not matter. A constraint of some of the
        stages only has none.

        Parameters
        ----------
        name
            Its name, for messages and prices.
        constraint
            A function of the stage, whose quantities are in physical units here. It returns a
            comparison, entry by entry or of totals; or a quantity or total, which the limits
            below are then for.
        at_least, at_most
            Limits in physical units: a number, or one value per time step, which moves with the
            horizon as profiles do.

        Examples
        --------
        A reserve of 100 MW in every stage::

            plan.constrain("reserve", lambda s: om.total(s.generator.p_max - s.generator.pg) >= 100)

        and one that differs from step to step::

            plan.constrain(
                "reserve",
                lambda s: om.total(s.generator.p_max - s.generator.pg),
                at_least=[100, 120, 140, 100],
            )
        """
        if "_compiled" in self.__dict__:
            raise ModelError(f"constraint {name!r}: the problem is compiled already; state constraints first")
        if name in self._constraints:
            raise ModelError(f"two constraints are named {name!r}")
        limits = _limit(name, "at_least", at_least, -np.inf), _limit(name, "at_most", at_most, np.inf)
        self._constraints[name] = _Own(constraint, *limits)

    def elastic_twin(self, prices: Elastic | None = None) -> MultiStage:
        """The same problem with limits that give way at a price, to tell what it lacks.

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
        twin = copy(self)
        vars(twin).pop("_compiled", None)
        twin.elastic = Elastic() if prices is None else prices
        return twin

    @property
    def described(self) -> dict[str, tuple[str, str]]:
        """Unit and description of each published quantity."""
        model = self.model
        named: dict[str, Published | Price] = {**model.published, **model.reported, **model.prices}
        slacks = {name: (s.soft.unit, s.phrase.format("so much")) for name, s in model.slacks.items()}
        injections = {i.name: (i.unit, i.description) for i in model.injections}
        return slacks | {name: (p.unit, p.description) for name, p in named.items()} | injections

    def window(self, start: int, stages: int) -> PerUnitNetwork:
        """The network with the time series of the steps from ``start`` on.

        Raises
        ------
        ProfileError, ModelError
            A series of the profiles or of the objective ends before the window does.
        """
        series = self.profiles.window(self.arrays, start, stages)
        for key, values in self._objective_series.items():
            known = values.shape[1]
            if known == 1:
                series[key] = np.repeat(values, stages, axis=1)
            elif known < start + stages:
                raise ModelError(
                    f"{type(self.objective).__name__}: {key[1]} has {known} values; "
                    f"steps {start} to {start + stages - 1} need {start + stages}"
                )
            else:
                series[key] = values[:, start : start + stages]
        return self.arrays.with_series(series)

    @cached_property
    def _objective_series(self) -> Mapping[tuple[str, str], Array]:
        return self.objective.series(self.arrays)

    # Compiling ---------------------------------------------------------------------------

    @property
    def model(self) -> Model:
        """What formulation and devices declared; compiled if need be."""
        return self._compiled[0]

    def declare(self) -> Model:
        """What formulation and devices declare, without objective and constraints; not kept."""
        own = {key: values[:, 0] for key, values in self._objective_series.items()}
        model = Model(
            self.arrays.with_series(own),
            self.horizon,
            self.step,
            reactive=self.formulation.reactive,
            zones=self.formulation.zones(self.arrays),
            series={*self.profiles.fields(self.arrays), *own},
            elastic=self.elastic,
        )
        self.formulation.declare(model)
        for device in self.devices:
            model.connect(device)
        return model

    def compile(self) -> Program:
        """The program; compiled at the first call, and by :meth:`solve` if need be."""
        return self._compiled[1]

    @cached_property
    def _compiled(self) -> tuple[Model, Program, Session]:
        began = clock.perf_counter()
        model = self.declare()
        self._check_needs(model)
        self._minimize(model)
        for name, own in self._constraints.items():
            self._constrain(model, name, own)
        for name, published in {**model.published, **model.reported}.items():
            model.build.output(name, published.values)
        program = model.build.build()
        session = prepare(program, self.solver, self.options, self.verbose)
        self.build_seconds = clock.perf_counter() - began
        return model, program, session

    def _check_needs(self, model: Model) -> None:
        missing = [name for name in self.objective.needs if not model.has(name)]
        if missing:
            able = _publishing(missing)
            raise ModelError(
                f"objective {type(self.objective).__name__} needs {', '.join(missing)}, which formulation "
                f"{self.formulation.name!r} with the devices of {self.network.name!r} does not have"
                + (f"; formulations that publish it: {', '.join(able)}" if able else "")
            )

    def explain(self, error: QuantityError) -> str:
        """What to tell somebody whose constraint uses a quantity that is not published here."""
        able = _publishing([error.quantity])
        if not able:
            return str(error)
        return (
            f"formulation {self.formulation.name!r} does not publish {error.kind}.{error.quantity}; "
            f"formulations that do: {', '.join(able)}"
        )

    def _minimize(self, model: Model) -> None:
        build = model.build
        cost = self.objective.stage_cost(model)
        if cost is not None:
            build.minimize(self.step * cost)
        terminal = self.objective.terminal_cost(model)
        if terminal is not None:
            build.minimize(terminal)
        if self.regularisation:
            for name in ("ps", "qs"):
                if model.has(name):
                    build.minimize(self.regularisation * self.step * total(model.published[name].values ** 2))
        price = build.parameter("end_price", 1)
        for state in model.states.values():
            if state.role == "stock":
                last = model.published[f"{state.name}_next"].values[:, -1:]
                build.minimize(-price * last)

    def _constrain(self, model: Model, name: str, own: _Own) -> None:
        try:
            stated = own.state(PhysicalStage(model))
        except QuantityError as error:
            raise ModelError(f"constraint {name!r}: {self.explain(error)}") from error
        except (ModelError, SolverError) as error:
            raise ModelError(f"constraint {name!r}: {error}") from error
        if isinstance(stated, Expression | Sum) and own.limited:
            stated = Constraint(stated, -np.inf, np.inf)  # every solve states the limits
        elif not isinstance(stated, Constraint):
            wanted = "a quantity or a total, to be limited" if own.limited else "a comparison of quantities"
            raise ModelError(f"constraint {name!r} must return {wanted}, not {stated!r}")
        elif own.limited:
            raise ModelError(f"constraint {name!r} is a comparison already; leave out at_least and at_most")
        if f"{name}_price" in model.prices:
            raise ModelError(
                f"constraint {name!r}: there is a price '{name}_price' already; take another name"
            )
        rows = model.build.constrain(_rows_of(name), stated)
        items, stages = rows.index.shape
        entries, timed = np.arange(items), stages == self.horizon
        soft = Soft(entries, "", "is missed by {}", "is exceeded by {}", timed=timed)
        limits = (own.lower, own.upper) if own.limited else (stated.lower, stated.upper)
        model.soften("constraint", rows, soft, *limits)
        if stages != self.horizon:  # of some stages only: no price by stage
            if own.limited:
                raise ModelError(
                    f"constraint {name!r}: at_least and at_most are for all stages; write >= or <="
                )
            return
        model.price(
            "" if items == 1 else f"{name}_item", f"{name}_price",
            lambda solution, _: -solution.dual(rows.name) / self.step,
            "$/h", f"rise of the cost when the right-hand side of {name!r} rises by one unit",
        )  # fmt: skip

    # Solving -----------------------------------------------------------------------------

    def solve(
        self,
        time: int = 0,
        initial: Initial | None = None,
        previous: Plan | None = None,
        end: End | None = None,
        multipliers: bool = True,
        expected: Mapping[tuple[str, str], Array] | None = None,
    ) -> Plan:
        """Solve for the stages from ``time`` on.

        Parameters
        ----------
        time
            First step of the profiles.
        initial
            Initial values by state (``e`` in MWh, ``pg`` in MW, ``qg`` in MVAr), one per
            component; None leaves a state free. A state that is not mentioned starts from its
            component (``Storage.initial``) or is free.
        previous
            An earlier plan of this problem to start from; it is shifted by the difference in time.
        end
            Something else to ask at the end of the horizon, for this solve.
        multipliers
            Whether the start has the multipliers of the earlier plan too; without them it is only
            another point to start from.
        expected
            Values of fields over the horizon by ``(kind, field)``, ``(items, stages)`` in per unit,
            in place of those that the profiles have: a forecast, say.

        Returns
        -------
        Plan
            Also when the solver failed; see :attr:`Plan.status`.
        """
        model, program, session = self._compiled
        end = self.end if end is None else end
        network = self.window(time, self.horizon).with_series(expected or {})
        numbers = _Numbers(model, program, network)
        states = {name: None for name in (initial or {}) if name not in model.states}
        if states:
            raise ModelError(
                f"initial: no state is named {next(iter(states))!r}; states: {', '.join(model.states)}"
            )
        for state in model.states.values():
            table = network.tables[state.kind]
            if initial is not None and state.name in initial:
                given = initial[state.name]
                values = (
                    None
                    if given is None
                    else np.asarray(given, dtype=float) / scale(state.unit, table.base_mva)
                )
            else:
                values = table.arrays[state.initial] if state.initial else None
            numbers.start_from(state.name, values, self.generator_delay)
            numbers.end_with(state.name, end)
        for name, own in self._constraints.items():
            if own.limited:
                numbers.limit(_rows_of(name), *own.window(name, time, self.horizon))
        instance = numbers.instance()
        start = _start(previous, time, multipliers)
        solution = session.solve(instance, start)
        return Plan(self, model, solution, network, time)


class _Numbers:
    """The parameters and bounds of one solve."""

    def __init__(self, model: Model, program: Program, network: PerUnitNetwork) -> None:
        self.model = model
        self.program = program
        self.parameters: dict[str, Array] = {
            name: np.asarray(network.tables[kind].arrays[field])
            for name, (kind, field) in model.parameters.items()
        }
        self.lower: dict[str, Array] = {}
        self.upper: dict[str, Array] = {}
        changed = {kind for kind, table in network.tables.items() if table is not model.network.tables[kind]}
        for name, source in model.bounds.items():
            if source.kind in changed:
                low, high = source.resolve(network.tables[source.kind])
                self.lower[name], self.upper[name] = self._fit(name, low), self._fit(name, high)

    def _fit(self, name: str, values: npt.NDArray[Any]) -> Array:
        """Bounds of a stage hold at its end; the first point of a stock has those of the first stage."""
        stages = (self.program.variables.get(name) or self.program.rows[name]).stages
        if values.ndim == 2 and values.shape[1] == stages - 1:
            return np.hstack([values[:, :1], values])
        if values.ndim == 2 and values.shape[1] > stages:
            return np.asarray(values[:, -stages:])
        return values

    def _bounds(self, name: str) -> tuple[Array, Array]:
        """Bounds of a block as arrays that can be changed."""
        block = self.program.variables.get(name) or self.program.rows[name]
        for side, default in ((self.lower, block.lower), (self.upper, block.upper)):
            side[name] = np.array(block.spread(side.get(name, default)))
        return self.lower[name], self.upper[name]

    def start_from(self, name: str, values: Array | None, delay: int) -> None:
        """Fix the initial value of a state, or leave it free."""
        state = self.model.states[name]
        if values is not None:
            values = np.asarray(values, dtype=float)
            if values.shape != (self.program.variables[name].items,) or np.isnan(values).any():
                raise ModelError(
                    f"initial {name}: {self.program.variables[name].items} numbers are needed, "
                    f"one per {state.kind}, not {values!r}"
                )
        if (state.role == "stock" or delay == 1) and values is not None:
            lower, upper = self._bounds(name)
            lower[:, 0] = upper[:, 0] = values
        if f"{name}_ramp_first" in self.program.rows:
            if values is None or delay == 1:
                lower, upper = self._bounds(f"{name}_ramp_first")
                lower[:], upper[:] = -np.inf, np.inf
            else:
                self.parameters[f"{name}_previous"] = values[state.ramped]

    def end_with(self, name: str, end: End) -> None:
        """State what is asked at the end of the horizon."""
        if self.model.states[name].role == "stock":
            if end.cyclic:
                lower, upper = self._bounds(f"{name}_cyclic")
                lower[:] = upper[:] = 0.0
            if end.minimum > 0:
                lower, upper = self._bounds(f"{name}_limit" if self.model.elastic is not None else name)
                lower[:, -1] = np.maximum(lower[:, -1], end.minimum * upper[:, -1])
            self.parameters["end_price"] = np.array([end.price * self.model.network.base_mva])

    def limit(self, rows: str, lower: Array, upper: Array) -> None:
        """Give rows their limits, one value per stage."""
        self.lower[rows], self.upper[rows] = lower[None, :], upper[None, :]

    def instance(self) -> Instance:
        """The numbers as an instance of the program."""
        return self.program.instance(self.parameters, self.lower, self.upper)


@dataclass(frozen=True)
class _Own:
    """A user's constraint: what it limits, and limits that may change from step to step."""

    state: Callable[[Stage], Any]
    lower: Array
    upper: Array

    @property
    def limited(self) -> bool:
        """Whether limits were given beside the function."""
        return bool(np.isfinite(self.lower).any() or np.isfinite(self.upper).any())

    def window(self, name: str, start: int, stages: int) -> tuple[Array, Array]:
        """Limits of the stages from a step on."""
        limits = []
        for side, values in (("at_least", self.lower), ("at_most", self.upper)):
            if values.ndim and len(values) < start + stages:
                raise ModelError(
                    f"constraint {name!r}: {side} has {len(values)} values; "
                    f"steps {start} to {start + stages - 1} need {start + stages}"
                )
            limits.append(values[start : start + stages] if values.ndim else np.full(stages, values))
        return limits[0], limits[1]


def _limit(name: str, side: str, given: npt.ArrayLike | None, absent: float) -> Array:
    """A limit as a number or a vector over time steps."""
    values = np.asarray(absent if given is None else given)
    if values.ndim > 1 or values.dtype.kind not in "if" or np.isnan(values).any():
        raise ModelError(
            f"constraint {name!r}: {side} = {given!r}: must be a number or one number per time step"
        )
    return values.astype(float)


def _rows_of(name: str) -> str:
    """Name of the rows of a user's constraint, which no quantity of a formulation or device has."""
    return f"constraint {name}"


class PhysicalStage:
    """A model whose quantities are in physical units, for users' constraints."""

    def __init__(self, model: Model) -> None:
        self.network = model.network
        self.step = model.step
        self._model = model

    def __getattr__(self, kind: str) -> Any:
        if kind.startswith("_"):
            raise AttributeError(kind)
        if kind not in self.network.tables:
            raise ModelError(f"there is no kind of component {kind!r}; {nearest(kind, self.network.tables)}")
        return _PhysicalQuantities(self._model, kind)

    def has(self, name: str) -> bool:
        """Whether a quantity is published."""
        return self._model.has(name)

    @property
    def operating_cost(self) -> Any:
        """Sum of the costs of all devices, $/h."""
        return self._model.operating_cost


class _PhysicalQuantities:
    def __init__(self, model: Model, kind: str) -> None:
        self._model = model
        self._kind = kind

    def __contains__(self, name: str) -> bool:
        return name in getattr(self._model, self._kind)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        value = getattr(getattr(self._model, self._kind), name)
        table = self._model.network.tables[self._kind]
        published = self._model.published.get(name)
        unit = published.unit if published is not None else table.units.get(name, "")
        return (
            value
            if name in table.arrays and table.arrays[name].dtype.kind != "f"
            else value * scale(unit, table.base_mva)
        )


def _start(previous: Plan | None, time: int, multipliers: bool) -> Start | None:
    if previous is None or time < previous.time or not previous.solution.status.is_optimal:
        return None
    moved = previous.solution.shifted(time - previous.time)
    return moved if multipliers else Start(moved.x)


def make_formulation(formulation: str | Formulation) -> Formulation:
    """A formulation by name, or as given."""
    if isinstance(formulation, Formulation):
        return formulation
    made = plugins.load("formulation", formulation)()
    assert isinstance(made, Formulation)
    return made


def make_devices(network: PerUnitNetwork, given: Iterable[Device] = ()) -> list[Device]:
    """The devices of a network: one object per kind that has components and takes part in the balance."""
    wired = ("bus", "branch", "shunt")
    by_kind = {device.component.kind: device for device in given}
    return [
        by_kind[kind] if kind in by_kind else plugins.load("device", kind)()
        for kind, table in network.tables.items()
        if kind not in wired and len(table)
    ]


def _publishing(quantities: list[str]) -> list[str]:
    """Formulations that publish some quantities."""
    able = []
    for name, plugin in plugins.plugins("formulation").items():
        try:
            if set(quantities) <= set(getattr(plugin.load(), "publishes", ())):
                able.append(name)
        except PluginError:
            continue  # "opfmodel list" reports it
    return able


# Plans ------------------------------------------------------------------------------------------


class Plan:
    """The result of one solve: trajectories in physical units, status and effort.

    Attributes
    ----------
    solution
        The certified solution of the program.
    time
        First step of the plan.
    """

    def __init__(
        self, problem: MultiStage, model: Model, solution: Solution, network: PerUnitNetwork, time: int
    ) -> None:
        self.problem = problem
        self.solution = solution
        self.time = time
        self._model = model
        self._network = network

    def __repr__(self) -> str:
        return f"Plan({self._network.name!r}, from step {self.time}: {self.status}, {self.objective:.6g} $)"

    @property
    def status(self) -> str:
        """``globally_optimal``, ``locally_optimal``, ``*_infeasible`` or ``stopped``."""
        return status_word(self.solution.status)

    @property
    def termination(self) -> str:
        """Why the solver stopped."""
        return f"{self.solution.termination.value} ({self.solution.message})"

    @property
    def optimal(self) -> bool:
        """Whether the plan is an optimum."""
        return self.solution.status.is_optimal

    @cached_property
    def objective(self) -> float:
        """Value of the objective in $ over the horizon, without regularisation."""
        stage = self.stage
        cost = self.problem.objective.stage_cost(stage)
        value = 0.0 if cost is None else float(np.sum(cost)) * self.problem.step
        terminal = self.problem.objective.terminal_cost(stage)
        return value + (0.0 if terminal is None else float(np.sum(terminal)))

    @cached_property
    def stage(self) -> NumericStage:
        """The quantities of the plan as numbers in per unit, for metering costs."""
        return NumericStage(self._network, self.problem.step, self.quantities(), self._model.devices)

    def quantities(self) -> dict[tuple[str, str], Array]:
        """All published quantities in per unit, ``(items, stages)`` by ``(kind, name)``.

        And what devices of other packages feed into the buses, as ``("bus", "<kind>_p")`` and ``_q``.
        """
        named = {**self._model.published, **self._model.reported}
        values = {(p.kind, name): self.solution.value(name) for name, p in named.items()}
        for injection in self._model.injections:
            power = injection.at_buses(self.solution, self._network)
            values["bus", injection.name] = values.get(("bus", injection.name), 0.0) + power
        return values

    def exceeded(self) -> dict[tuple[str, str], Array]:
        """By how much limits are exceeded in an elastic plan, p.u., as :meth:`quantities`."""
        network, stages = self._network, self.problem.horizon
        return {
            (slack.kind, name): slack.spread(
                slack.amount(self.solution.value(name), network), len(network.tables[slack.kind]), stages
            )
            for name, slack in self._model.slacks.items()
            if slack.kind in network.tables and name not in self._model.reported
        }

    @cached_property
    def shortages(self) -> tuple[Shortage, ...]:
        """What an elastic problem lacks, the dearest first; nothing where every limit is hard."""
        prices = self.problem.elastic
        if prices is None:
            return ()
        slacks, step = self._model.slacks.values(), self.problem.step
        return shortages(slacks, self.solution.value, self._network, prices, step, self.times)

    def next_state(self, happened: Mapping[tuple[str, str], Array] | None = None) -> dict[str, Array]:
        """The states after the first stage has been applied, in physical units.

        Parameters
        ----------
        happened
            Per-unit values ``(items,)`` by ``(kind, name)`` of the first stage, if it was not what was
            planned. A dispatch that is committed one stage ahead stays as planned.
        """
        out = {}
        committed = self.problem.generator_delay == 1
        for state in self._model.states.values():
            name = f"{state.name}_next" if state.role == "stock" else state.name
            if happened is not None and (state.role == "stock" or not committed):
                values = happened[state.kind, name]
            elif state.role == "stock" or not committed:
                values = self.solution.value(name)[:, 0]
            elif self.problem.horizon == 1:
                raise ModelError("with generator_delay = 1 a receding horizon needs at least 2 stages")
            else:
                values = self.solution.value(name)[:, 1]
            out[state.name] = values * scale(state.unit, self._network.base_mva)
        return out

    def stocks(self) -> dict[str, Array]:
        """The stocks that the plan starts from, in physical units."""
        return {
            state.name: self._points(state.name)[:, 0] * scale(state.unit, self._network.base_mva)
            for state in self._model.states.values()
            if state.role == "stock"
        }

    def decisions(self) -> list[tuple[str, str]]:
        """Published quantities, by ``(kind, name)``, that are variables: neither stocks nor results."""
        return [
            (p.kind, name)
            for name, p in self._model.published.items()
            if name in self.solution.program.variables and name not in self.stocks()
        ]

    def _points(self, name: str) -> Array:
        return self.solution.program.variables[name].read(self.solution.x)

    @cached_property
    def data(self) -> xr.Dataset:
        """All published quantities and the demand, in physical units, over ``time`` and components."""
        from opfmodel.results import dataset

        described = self.problem.described
        values = {
            name: (kind, *described[name], array)
            for (kind, name), array in {**self.quantities(), **self.prices()}.items()
        }
        made = dataset(self._network, values, self.times)
        made.attrs |= {
            "network": self._network.name,
            "formulation": self.problem.formulation.name,
            "objective": type(self.problem.objective).__name__,
            "status": self.status,
            "step_hours": self.problem.step,
            "cost": self.objective,
        }
        made.attrs |= self.relaxation
        return made

    def price(self, name: str) -> Array:
        """A shadow price in $ and per unit, ``(items, stages)``: ``lmp``, ``reserve_price``, ..."""
        return self._model.prices[name].read(self.solution, self._network)

    def prices(self) -> dict[tuple[str, str], Array]:
        """All shadow prices by ``(kind, name)``; see :meth:`price`."""
        return {(price.kind, name): self.price(name) for name, price in self._model.prices.items()}

    @cached_property
    def relaxation(self) -> dict[str, float]:
        """How far the plan is from the equations that its formulation relaxes, by name.

        For ``soc`` the ``largest_cone_slack`` in p.u. and the ``largest_angle_mismatch`` around loops
        in degrees: the relaxation is exact where both vanish. Empty for formulations that relax
        nothing and for plans that are no optimum.
        """
        if not self.optimal:
            return {}
        return self.problem.formulation.relaxation(self.solution, self._network)

    def relaxation_gap(self, exact: Plan | float) -> float:
        """How far the objective lies below that of an exact formulation: ``(exact - this) / |exact|``."""
        other = exact.objective if isinstance(exact, Plan) else float(exact)
        return (other - self.objective) / abs(other)

    @property
    def times(self) -> Array:
        """Hours at which the stages begin."""
        stages = np.arange(self.problem.horizon, dtype=float)
        return (self.time + stages) * self.problem.step


def status_word(status: SolutionStatus) -> str:
    """A status as the command line and results spell it."""
    return "stopped" if status is SolutionStatus.NONE else status.value.replace(" ", "_")
