"""What follows from an outage after a stage: the response that lacks least, and what it lacks."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from opfmodel.errors import ModelError
from opfmodel.model.elastic import shortages
from opfmodel.network.branch_outages import ACOutages, DCOutages, Reserve
from opfmodel.network.components import BUILT_IN
from opfmodel.network.shares import WIDE, divide
from opfmodel.plan.end import End
from opfmodel.plan.outages import free_rows, splitting
from opfmodel.plan.request import Limits, Request
from opfmodel.plan.result import Plan
from opfmodel.plan.security import NOTHING, Security

if TYPE_CHECKING:
    from opfmodel.network.arrays import PerUnitNetwork, Table
    from opfmodel.plan.multistage import MultiStage

__all__ = ["Outcome", "Responses", "Stage", "Worst", "stages_of"]

Array = npt.NDArray[np.float64]
State = Callable[[str], "Array | None"]  # values of a variable in per unit, by its name

_AFTER = slice(1, 2)  # the node after the outage, in the problem of a contingency
_WITHIN = 1e-6  # p.u.; violation that is tolerance
_DROOP = 0.05  # p.u.; fall of the voltage at which a unit adds all its reactive reserve


class Worst(NamedTuple):
    """The largest shortfall after an outage: what limit of which component, and by how much."""

    kind: str
    name: str
    quantity: str
    value: float
    unit: str
    text: str


class Outcome(NamedTuple):
    """What follows from one outage after one stage.

    Attributes
    ----------
    out
        The component that is lost.
    scenario, stage
        Future and position of the stage after which it happens.
    status
        ``secure``; ``violated`` if no response keeps all limits; ``diverged`` if the solver could not tell.
    worst
        What is lacking if it is violated; None if the problem is infeasible also with soft limits.
    """

    out: str
    scenario: str
    stage: int
    status: str
    worst: Worst | None

    @property
    def text(self) -> str:
        """What is lacking, in words; empty if it is secure."""
        if self.status == "violated":
            return self.worst.text if self.worst else "no response is within the limits of the units"
        return "the solver could not tell" if self.status == "diverged" else ""


class Stage(NamedTuple):
    """A stage after which outages happen: its data and its state."""

    number: int
    scenario: str
    time: int
    network: PerUnitNetwork
    column: int
    state: State


def stages_of(plan: Plan) -> list[Stage]:
    """Return the stages of a plan with their state.

    Raises
    ------
    ModelError
        The plan is not optimal.
    """
    if not plan.optimal:
        raise ModelError(f"the plan from step {plan.time} is {plan.status}: there is nothing to assess")
    horizon, solution = plan.horizon, plan.solution

    def state(node: int) -> State:
        def values(name: str) -> Array | None:
            if name not in solution.program.variables:
                return None
            found = solution.variable(name)
            nodes, source = plan.nodes.columns(found.shape[1]), plan.model.bounds.get(name)
            if source is not None and source.nodes is not None and source.nodes.size == found.shape[1]:
                nodes = source.nodes  # as many columns may mean other nodes
            return None if nodes is None else found[:, int(np.flatnonzero(nodes == node)[0])]

        return values

    moments = plan.time + horizon.step
    return [
        Stage(node, horizon.scenario[node], int(moments[node]), plan.network, node, state(node))
        for node in range(len(horizon))
    ]


class Responses:
    """What follows from outages after the stages of a plan.

    One problem is compiled for all of them: a stage that is given, and the state after an outage, which is
    data.

    Parameters
    ----------
    problem
        The problem of the plan that is assessed.
    security
        Outages and permitted response.
    """

    def __init__(self, problem: MultiStage, security: Security) -> None:
        self.security = security
        self.peak = problem.peak
        self.outages = security.outages(self.peak)
        self.problem = problem.contingency_problem(security, self.outages)
        self._known: dict[tuple[int, str], Array] = {}
        self.last: dict[str, Plan] = {}  # of any stage; the next one starts from it

    def begin(self) -> None:
        """Begin with another request: nothing is known of its stages."""
        self._known.clear()

    def possible(self, already: Sequence[str]) -> list[str]:
        """Return the outages that may follow when some components are out already."""
        never = {*already, *splitting(self.peak, already)} if already else set()
        return [out for out in self.outages if out not in never]

    def outcomes(self, stage: Stage, outages: Sequence[str], already: tuple[str, ...] = ()) -> list[Outcome]:
        """Return what follows from each outage after a stage.

        First the response to no outage at all is found. Without an objective, an interior-point method finds
        one that is far from all limits. Outages of branches that this same response survives are secure. Of
        each other one, its own problem tells.

        Parameters
        ----------
        already
            Components that are out of service in the stage.
        """
        if not outages:
            return []
        central = self._response(stage, NOTHING, already)
        passed = self._survived(central, outages)
        return [
            Outcome(out, stage.scenario, stage.number, "secure", None)
            if out in passed
            else self._outcome(stage, out, already, central)
            for out in outages
        ]

    def _response(
        self, stage: Stage, out: str, already: tuple[str, ...], previous: Plan | None = None
    ) -> Plan:
        """Return the state that lacks least after an outage."""
        problem = self.problem
        horizon = replace(problem.horizon, out=((), (out,)))
        expected = {
            (kind, field): values[:, [min(stage.column, values.shape[1] - 1)]]
            for kind, field in problem.model.series
            for values in (stage.network.tables[kind].arrays[field],)
        }
        request = Request(stage.time, {}, End(), expected, horizon, already)
        limits = dict(self._given(stage.state))
        plan = self._still(stage, out, request, limits)
        if plan is None:
            plan = problem.solve_once(request, self.last.get(out, previous), limits=limits)
            if plan.optimal:
                self.last[out] = plan
                if not plan.short:
                    self._known[stage.number, out] = plan.solution.x
        return plan

    def _still(self, stage: Stage, out: str, request: Request, limits: Limits) -> Plan | None:
        """Return the response found for another dispatch of the stage; None if it is none to this one."""
        known, model = self._known.get((stage.number, out)), self.problem.model
        if known is None:
            return None
        last = self.last[out].solution
        instance, network = self.problem.pose(request, limits)
        given = np.clip(known, instance.lower, instance.upper)  # with the new dispatch of the stage
        x = given.copy()
        for name, state in model.states.items():
            if state.role == "stock":  # points before, between and after; it changes by as much as it did
                _, between, after = last.program.variables[name].index.T
                x[after] += given[between] - known[between]
        x = np.clip(x, instance.lower, instance.upper)
        solution = replace(last, instance=instance, x=x, iterations=0, seconds=0.0)
        plan = Plan(self.problem, model, solution, network, request)
        return None if solution.primal_residual > _WITHIN or plan.short else plan

    def _outcome(self, stage: Stage, out: str, already: tuple[str, ...], central: Plan) -> Outcome:
        """Return what follows from an outage after a stage."""
        plan = self._response(stage, out, already, central)
        worst = self._worst(plan) if plan.optimal and plan.short else None
        status = "violated" if worst or plan.infeasible else "secure" if plan.optimal else "diverged"
        return Outcome(out, stage.scenario, stage.number, status, worst)

    def _survived(self, central: Plan, outages: Sequence[str]) -> set[str]:
        """Return the outages of branches that one response survives, of those that flows can tell."""
        physics, known = self.problem.formulation.physics, central.network.branch.position
        out = [name for name in outages if name in known]
        built_in = all(device.component in BUILT_IN for device in self.problem.devices)
        if physics is None or not built_in or not out or not central.optimal or central.short:
            return set()
        if physics == "ac" and self.problem.model.settings:  # the admittances are those of the plan
            return set()
        test = _ac_outages(central, self.security) if physics == "ac" else _dc_outages(central)
        survived = test.survived(np.array([known[name] for name in out], dtype=np.intp))
        return {name for name, passes in zip(out, survived, strict=True) if passes}

    def _given(self, state: State) -> Iterator[tuple[str, tuple[Array, Array]]]:
        """Yield the bounds that fix the variables of the stage, and free the rows that led to them."""
        model, program = self.problem.model, self.problem.compile()
        for name, block in program.variables.items():
            declared = model.published.get(name) or model.states.get(name) or model.bounds.get(name)
            flows = declared is None or (declared.kind == "branch" and name not in model.settings)
            values = None if flows else state(name)
            source = model.bounds.get(name)
            nodes = model.horizon.columns(block.stages) if source is None else source.nodes
            nodes = np.arange(len(model.horizon)) if source is not None and nodes is None else nodes
            if values is None or nodes is None:
                continue
            fixed = np.full(block.shape, np.nan)
            fixed[:, nodes == 0] = values[:, None]
            yield name, (fixed, fixed)
        yield from free_rows(model, program, np.array([-1, 0]))

    def _worst(self, plan: Plan) -> Worst | None:
        elastic, horizon = self.problem.elastic, plan.request.horizon
        assert elastic is not None
        times = self.problem.times(plan.time, horizon)
        slacks = plan.model.slacks.values()
        lacking = [
            shortage
            for shortage in shortages(slacks, plan.solution, plan.whole, elastic, horizon, times)
            if shortage.hypothetical
        ]
        if not lacking:
            return None
        most = lacking[0]
        return Worst(most.kind, most.component, most.soft.limit, most.worst, most.unit, str(most))


def _dc_outages(response: Plan) -> DCOutages:
    """Return the flows after outages from the state of a response, if they are linear."""
    network, branch = response.whole.over(_AFTER), response.whole.branch
    formulation: Any = response.problem.formulation
    status = branch.status[:, _AFTER]
    va = response.solution.value("va")[:, _AFTER]
    angle = va[branch.from_bus] - va[branch.to_bus]
    flow = response.solution.value("pf")[:, _AFTER]
    slope = (formulation.flow(network, angle + 1.0) - formulation.flow(network, angle)) * status
    return DCOutages(network, flow[:, 0], slope[:, 0], angle[:, 0])


def _ac_outages(response: Plan, security: Security) -> ACOutages:
    """Return the flows after outages from the state of a response.

    A preventive response holds voltages and shares. A corrective one moves units within their reserves,
    and their voltages follow reactive power.
    """
    network, solution = response.whole.over(_AFTER), response.solution
    vm, va = (solution.value(name)[:, 1] for name in ("vm", "va"))
    units = network.generator
    pg, qg = (solution.value(name) if len(units) else np.zeros((0, 2)) for name in ("pg", "qg"))
    ramp = units.ramp[:, 0] * security.response_minutes / 60
    up = np.minimum(units.p_max[:, 0], pg[:, 0] + ramp) - pg[:, 1]
    down = pg[:, 1] - np.maximum(units.p_min[:, 0], pg[:, 0] - ramp)
    q_up, q_down = units.q_max[:, 0] - qg[:, 1], qg[:, 1] - units.q_min[:, 0]
    up, down, q_up, q_down = _within_curves(units, pg[:, 1], qg[:, 1], (up, down, q_up, q_down))
    island = network.island[units.bus]
    if security.response == "preventive":
        share = security.shares(units, island)[:, 0]
    else:
        share = divide(np.clip(np.minimum(up, down), 0.0, WIDE), island)
    droop = _DROOP if security.response == "corrective" else 0.0
    return ACOutages(
        network, network.branch.status[:, 0], vm, va, Reserve(up, down, share, q_up, q_down, droop)
    )


def _within_curves(
    units: Table, pg: Array, qg: Array, reserves: tuple[Array, Array, Array, Array]
) -> tuple[Array, Array, Array, Array]:
    """Return reserves up and down, active and reactive, that units can use together within their curves.

    Those of a unit with a capability curve shrink by one factor, until all of their box is within the curve.
    """
    owner = units.capability_owner
    if not owner.size:
        return reserves
    ranges = (
        units.capability_p_max[:, 0] - pg,
        pg - units.capability_p_min[:, 0],
        units.capability_q_max[:, 0] - qg,
        qg - units.capability_q_min[:, 0],
    )
    up, down, q_up, q_down = (np.minimum(r, most) for r, most in zip(reserves, ranges, strict=True))
    a, b, limit = (getattr(units, f"capability_{part}")[:, 0] for part in ("p", "q", "limit"))
    left = np.maximum(limit - a * pg[owner] - b * qg[owner], 0.0)
    farthest = np.where(a > 0, a * up[owner], -a * down[owner]) + np.where(
        b > 0, b * q_up[owner], -b * q_down[owner]
    )
    share = np.ones(len(units))
    np.minimum.at(share, owner, np.divide(left, farthest, out=np.ones_like(left), where=farthest > left))
    return share * up, share * down, share * q_up, share * q_down
