"""The system that the theory speaks of: states, steady state and closed loops under constant demand."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from opfmodel.analysis.active import active_limits
from opfmodel.analysis.problems import AtStep, constant_problem, convex_problem
from opfmodel.analysis.progress import Advance, silent
from opfmodel.errors import IncompatibleError, ModelError, listed
from opfmodel.objectives.base import Objective
from opfmodel.plan import End, Initial, MultiStage, Plan
from opfmodel.simulation import Controller
from solvers import SolutionStatus, Start
from solvers.template import Degree

__all__ = ["EXACT", "TIGHT", "Loop", "NoSteadyStateError", "State", "SteadyState", "Subject"]

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

# The checks compare costs that differ in the eighth digit.
TIGHT = {"tol": 1e-8}
EXACT = {"tol": 1e-10, "constr_viol_tol": 1e-10, "bound_relax_factor": 1e-12}
_FAR = 3.0  # p.u., for random starts of variables without limits
_ANGLES, _SPREAD = ("va", "vi"), 0.05  # rad
_RELATIVE = 1e-9  # of the stage cost; two solves of the same stage differ by 1e-11
_STARTS = 4  # random starts of a steady state, besides the default one


class NoSteadyStateError(ModelError):
    """No steady state was found; the message says why.

    Parameters
    ----------
    proven
        Whether it is proven that there is none.
    """

    def __init__(self, message: str, proven: bool) -> None:
        super().__init__(message)
        self.proven = proven


@dataclass(frozen=True)
class State:
    """A block of the state x, such as pg, qg or e.

    Attributes
    ----------
    name, kind
        Name of the quantity, and kind of its components.
    where
        Its entries in x.
    stock
        Whether it is stored, and not dispatched.
    """

    name: str
    kind: str
    where: slice
    stock: bool


@dataclass(frozen=True, eq=False)
class SteadyState:
    """The optimal steady state (x_s, u_s)(d): the cheapest stage whose storages end as they begin.

    Attributes
    ----------
    plan
        One stage with a cyclic end.
    cost
        Stage cost, $/h.
    x
        State, p.u. on the base of the network.
    active
        Limits that bind, by name.
    """

    plan: Plan
    cost: float
    x: Array
    active: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Loop:
    """A closed loop under constant demand.

    Attributes
    ----------
    x
        States at the beginning of every step and at the end of the last one, ``(states, steps + 1)``, p.u.
    cost
        Stage cost of every step, $/h.
    status
        Status of the last plan.
    settled
        Whether it ended because the state no longer moved.
    """

    x: Array
    cost: Array
    status: str
    settled: bool


class Subject:
    """A problem with the data of one step for ever.

    Parameters
    ----------
    problem
        The problem of the controller.
    step
        Step whose demand, limits and costs are held constant.
    advance
        Called as work progresses.

    Raises
    ------
    IncompatibleError
        The problem has equipment without a steady state.
    """

    def __init__(self, problem: MultiStage, step: int = 0, advance: Advance = silent) -> None:
        for device in problem.devices:
            if device.component.clocked and not device.physical:
                names = listed(problem.arrays.tables[device.component.kind].names)
                raise IncompatibleError(
                    f"{names}: {device.component.plural} depend on the time of day and have no steady state; "
                    "analyse the scenario without them"
                )
        if not len(problem.arrays.generator):
            raise IncompatibleError("no generator is in service: only grids with generators can be analysed")
        table = problem.arrays.tables["connection"]
        charged = [name for name, cost in zip(table.names, table.peak_cost, strict=True) if np.any(cost > 0)]
        if charged:
            raise IncompatibleError(
                f"{listed(charged)}: a charge for the peak of a period has no steady state; analyse the "
                "scenario with peak_cost: 0"
            )
        self.problem, self.step, self.advance = problem, step, advance
        for state in self.stage_problem.model.states.values():
            table = problem.arrays.tables[state.kind]
            if len(table) and state.role == "stock" and not state.ends and table.kind.clocked:
                raise IncompatibleError(
                    f"{listed(table.names)}: {state.name} depends on the time of day and has no steady "
                    f"state; analyse the scenario without such {table.kind.plural}"
                )
        storage = problem.arrays.storage
        wanted = [storage.names[i] for i in np.flatnonzero(np.isfinite(storage.wanted).any(axis=1))]
        if wanted:
            raise IncompatibleError(
                f"{listed(wanted)}: wanted depends on the time of day; analyse the scenario without it"
            )

    def problem_of(
        self,
        stages: int,
        hours: float | None = None,
        *,
        exact: bool = False,
        objective: Objective | None = None,
    ) -> MultiStage:
        """Return the problem of a number of stages with constant data.

        Stored energy costs so little beside generation that the default tolerance of IPOPT would leave it
        undetermined.

        Parameters
        ----------
        exact
            Whether costs are to be exact: without regularisation and terminal cost, and to the last digit
            of IPOPT. For problems of one stage, whose dispatch is decided.
        objective
            The objective, in place of that of the problem.
        """
        made = constant_problem(self.problem, self.step, stages, hours)
        own = self.problem.options if self.problem.solver.partition(":")[0] == "ipopt" else {}
        made.solver, made.options = "ipopt", {**TIGHT, **own}
        if exact:
            made.objective = AtStep(self.problem.objective, self.step, terminal=False)
            made.generator_delay, made.regularisation, made.end = 0, 0.0, End()
            made.options = {**EXACT, **own}
        if objective is not None:
            made.objective = objective
        return made

    @property
    def stages(self) -> int:
        """Number of base steps that the controller plans ahead."""
        return self.problem.horizon.steps

    @cached_property
    def stage_problem(self) -> MultiStage:
        """The problem of one stage, to be solved exactly."""
        return self.problem_of(1, exact=True)

    @cached_property
    def steady(self) -> SteadyState:
        """The optimal steady state.

        Raises
        ------
        NoSteadyStateError
            No stage whose storages end as they begin is feasible, or none was found.
        """
        problem = self.stage_problem
        cyclic = End(cyclic=True)
        plan = problem.solve(initial=free(problem), end=cyclic)
        for start in random_starts(plan, _STARTS):
            other = again(plan, start)
            if other.optimal and not plan.objective <= other.objective * (1 + 1e-9):
                plan = other
        if not plan.optimal:
            twin = problem.elastic_twin()
            short = twin.solve(initial=free(twin), end=cyclic).shortages
            lacking = "; ".join(str(shortage) for shortage in short[:3])
            proven = _proven_infeasible(plan)
            what = "exists" if proven else "was found, nor a proof that there is none"
            raise NoSteadyStateError(
                f"{self.problem.step_name(self.step)}: no steady state {what}: {lacking or plan.termination}",
                proven,
            )
        return SteadyState(plan, plan.objective / problem.step, self.x(plan)[:, 0], active_limits(plan))

    @cached_property
    def rest(self) -> Array:
        """The steady state with the regularisation of plans, p.u., where these settle: not quite x_s.

        Regularisation determines the reactive power of storages, which costs nothing.
        """
        problem = self.problem_of(1, exact=True)
        problem.regularisation = self.problem.regularisation
        plan = problem.solve(initial=free(problem), end=End(cyclic=True))
        return self.x(plan)[:, 0] if plan.optimal else self.steady.x

    @cached_property
    def states(self) -> tuple[State, ...]:
        """The blocks of the state, in the order of x, without settings of the network.

        Only the cost of moves links these with the stage before; without it, bounds stay bounds.
        """
        found, size = [], 0
        for name, state in self.stage_problem.model.states.items():
            if state.role == "setting":
                continue
            count = len(self.problem.arrays.tables[state.kind])
            found.append(State(name, state.kind, slice(size, size + count), state.role == "stock"))
            size += count
        return tuple(found)

    @property
    def unit(self) -> float:
        """Factor from internal per-unit values to those on the base of the network."""
        return self.problem.arrays.rebased

    @property
    def tolerance(self) -> float:
        """Difference between stage costs that is more than solver error, $/h."""
        return _RELATIVE * max(1.0, abs(self.steady.cost))

    def x(self, plan: Plan) -> Array:
        """Return the states at the start of the stages of a plan, ``(states, stages)``, p.u."""
        return self.unit * np.vstack([plan.solution.value(state.name) for state in self.states])

    def names(self) -> list[str]:
        """Return the names of the entries of x, such as ``coal.pg``."""
        tables = self.problem.arrays.tables
        return [f"{name}.{state.name}" for state in self.states for name in tables[state.kind].names]

    def physical(self, x: Array) -> dict[str, float]:
        """Return a state by name, in MW, MVAr and MWh."""
        base = self.problem.network.base_mva
        return {name: float(value * base) for name, value in zip(self.names(), x, strict=True)}

    def initial(self, x: Array) -> Initial:
        """Return a state as the argument of a solve, in physical units."""
        base = self.problem.network.base_mva
        return {state.name: x[state.where] * base for state in self.states}

    def declared(self, state: Initial) -> Array:
        """Return x from states by name in physical units."""
        base = self.problem.network.base_mva
        return np.concatenate([np.asarray(state[each.name], dtype=float) / base for each in self.states])

    @cached_property
    def q(self) -> Array:
        """Q, half the second derivative of the stage cost by the state in x_s, $/(h p.u.²)."""
        plan = self.steady.plan
        solution, program = plan.solution, plan.solution.program
        rows = np.zeros(program.n_rows)
        upper = solution.evaluator.hessian(solution.x, solution.instance.parameters, 1.0, rows)
        upper = sp.csc_array(upper)
        hessian = (upper + upper.T - sp.diags_array(upper.diagonal())).tocsr()
        entries = self._entries
        return np.asarray(hessian[entries][:, entries].toarray() / (2.0 * self.unit**2 * plan.problem.step))

    @cached_property
    def slope(self) -> Array:
        """Derivative of the stage cost by the state in x_s, $/(h p.u.)."""
        plan = self.steady.plan
        solution = plan.solution
        gradient = solution.evaluator.gradient(solution.x, solution.instance.parameters)
        return np.asarray(gradient[self._entries] / (self.unit * plan.problem.step))

    @property
    def _entries(self) -> Index:
        """Positions of the states at the beginning of a stage among the variables of the steady state."""
        program = self.steady.plan.solution.program
        blocks = [program.variables[state.name] for state in self.states]
        return np.concatenate([block.offset + np.arange(block.items) for block in blocks])

    @property
    def quadratic(self) -> bool:
        """Whether the stage cost is quadratic, as Assumption 4.1 asks."""
        costs = self.steady.plan.solution.program.costs
        return all(cost.template.degree <= Degree.QUADRATIC for cost in costs)

    @cached_property
    def _stored(self) -> tuple[Array, Array]:
        """Least and largest value of each state that is stored, p.u.; zero for dispatched ones."""
        ends = np.zeros((2, len(self.steady.x)))
        for state in self.states:
            if state.stock:
                source = self.stage_problem.model.bounds[state.name]
                limits = source.resolve(self.steady.plan.network.tables[state.kind])
                for end, limit in zip(ends, limits, strict=True):
                    end[state.where] = self.unit * np.ravel(limit)  # of all alike, or of each
        return ends[0], ends[1]

    @property
    def capacity(self) -> Array:
        """Range of each state that is stored, p.u.; zero for dispatched ones and without limits."""
        low, high = self._stored
        return np.where(np.isfinite(high - low), high - low, 0.0)

    def stored(self, share: float) -> Array:
        """Return the steady state of plans with storages filled to a share of their range."""
        stock = np.concatenate([np.full(s.where.stop - s.where.start, s.stock) for s in self.states])
        return np.where(stock, self._stored[0] + share * self.capacity, self.rest)

    def loop(self, stages: int, x: Array, steps: int, still: float = 0.0) -> Loop:
        """Return the closed loop of the controller under constant demand, planning for a number of stages.

        Parameters
        ----------
        x
            State at the first step, p.u.
        steps
            Number of steps, at most.
        still
            A loop whose state moves by less in a step has settled and ends, p.u.
        """
        problem = constant_problem(self.problem, self.step, stages)
        controller = Controller(problem)
        states: list[Array] = []
        costs: list[float] = []
        state = self.initial(x)
        settled = False
        for time in range(steps):
            plan = controller.plan(time, state)
            if not plan.optimal:
                break
            states.append(self.x(plan)[:, 0])
            cost = problem.objective.stage_cost(plan.stage)
            costs.append(0.0 if cost is None else float(cost[0]))
            state = plan.next_state()
            self.advance(f"closed loop with a horizon of {stages}", time + 1, steps)
            settled = len(states) > 1 and float(np.linalg.norm(states[-1] - states[-2])) < still
            if settled:
                break
        states.append(self.declared(state))
        return Loop(np.column_stack(states), np.array(costs), plan.status, settled)

    @cached_property
    def storage_function(self) -> dict[str, Array]:
        """Price of each stock in the steady state, $/(p.u. h) on the base of the network, by its name.

        The storage function of the theory is the sum of price times stored quantity.
        """
        plan = self.steady.plan
        return {
            state.name: plan.solution.dual(f"{state.name}_dynamics")[:, 0] / self.unit
            for state in self.states
            if state.stock and f"{state.name}_dynamics" in plan.solution.program.rows
        }


def _proven_infeasible(plan: Plan) -> bool:
    """Return whether a relaxation proves that the problem of a plan is infeasible."""
    try:
        relaxed = convex_problem(plan.problem).solve_once(plan.request)
    except IncompatibleError:
        return False
    return relaxed.solution.status is SolutionStatus.PROVEN_INFEASIBLE


def free(problem: MultiStage) -> Initial:
    """Return an initial state of which nothing is given."""
    return dict.fromkeys(problem.model.states, None)


def random_starts(plan: Plan, number: int, seed: int = 0) -> list[Start]:
    """Return random starts: variables anywhere within their bounds, angles close to those of a plan.

    From random angles, Newton steps rarely reach a feasible voltage profile.
    """
    random = np.random.default_rng(seed)
    solution = plan.solution
    low, high = (np.clip(side, -_FAR, _FAR) for side in (solution.instance.lower, solution.instance.upper))
    angles = [block for name, block in solution.program.variables.items() if name in _ANGLES]
    starts = []
    for _ in range(number):
        x = random.uniform(np.minimum(low, high), high)
        for block in angles:
            x[block.slice] = solution.x[block.slice] + _SPREAD * random.standard_normal(block.size)
        starts.append(Start(x))
    return starts


def again(plan: Plan, start: Start) -> Plan:
    """Return the plan of the same request from another start."""
    solution = plan.problem.session.solve(plan.solution.instance, start)
    return Plan(plan.problem, plan.model, solution, plan.whole, plan.request)
