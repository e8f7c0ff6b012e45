"""What follows from an outage after a stage: the response that lacks least, and what it lacks."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from opfmodel.devices.held import WIDE, divide
from opfmodel.errors import ModelError
from opfmodel.model.elastic import shortages
from opfmodel.network.components import BUILT_IN
from opfmodel.network.outages import ACOutages, DCOutages, Reserve
from opfmodel.plan.end import End
from opfmodel.plan.request import Request
from opfmodel.plan.result import Plan
from opfmodel.plan.security import NOTHING, Security
from opfmodel.plan.set_points import participation_of

if TYPE_CHECKING:
    from opfmodel.network.arrays import PerUnitNetwork
    from opfmodel.plan.multistage import MultiStage

__all__ = ["Outcome", "Responses", "Stage", "Worst", "stages_of"]

Array = npt.NDArray[np.float64]
State = Callable[[str], "Array | None"]  # values of a variable in per unit, by its name

_AFTER = slice(1, 2)  # the node after the outage, in the problem of a contingency
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
            nodes = plan.nodes.columns(found.shape[1])
            return None if nodes is None else found[:, int(np.flatnonzero(nodes == node)[0])]

        return values

    moments = plan.time + horizon.step
    return [
        Stage(node, horizon.scenario[node], int(moments[node]), plan.network, node, state(node))
        for node in range(len(horizon))
    ]


class Responses:
    """The problem of an outage after a stage, and what follows from it.

    Parameters
    ----------
    problem
        The problem of the plan that is assessed.
    security
        Permitted response.
    """

    def __init__(self, problem: MultiStage, security: Security) -> None:
        self.problem, self.security = problem, security
        self._trials: dict[str, _Trial] = {}

    def outcomes(self, stage: Stage, outages: Sequence[str]) -> list[Outcome]:
        """Return what follows from each outage after a stage.

        Outages whose flows, from the most central state that a response reaches, are within limits are
        secure. Of the others, their own problem tells.
        """
        passed = self._survived(stage, outages)
        return [
            Outcome(out, stage.scenario, stage.number, "secure", None)
            if out in passed
            else self._trial(out).outcome(stage)
            for out in outages
        ]

    def _trial(self, out: str) -> _Trial:
        if out not in self._trials:
            self._trials[out] = _Trial(self.problem, self.security, out)
        return self._trials[out]

    def _survived(self, stage: Stage, outages: Sequence[str]) -> set[str]:
        """Return the outages of branches that one and the same response survives.

        With the interior-point method and no objective, that response is far from all limits.
        """
        physics, known = self.problem.formulation.physics, stage.network.branch.position
        out = [name for name in outages if name in known]
        built_in = all(device.component in BUILT_IN for device in self.problem.devices)
        if physics is None or not built_in or not out:
            return set()
        response = self._trial(NOTHING).plan(stage)
        if not response.optimal or response.short:
            return set()
        test = (_ac_outages if physics == "ac" else _dc_outages)(response, self.security)
        survived = test.survived(np.array([known[name] for name in out], dtype=np.intp))
        return {name for name, passes in zip(out, survived, strict=True) if passes}


def _dc_outages(response: Plan, security: Security) -> DCOutages:  # noqa: ARG001
    """Return the flows after outages from the state of a response, if they are linear."""
    network, branch = response.whole.over(_AFTER), response.whole.branch
    formulation: Any = response.problem.formulation
    va = response.solution.value("va")[:, _AFTER]
    angle = va[branch.from_bus] - va[branch.to_bus]
    flow = response.solution.value("pf")[:, _AFTER]
    slope = formulation.flow(network, angle + 1.0) - formulation.flow(network, angle)
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
    if security.response == "preventive":
        moves = units.p_min[:, 0] < units.p_max[:, 0]
        weights = np.where(moves, participation_of(units, moves, security.participation), 0.0)
    else:
        weights = np.clip(np.minimum(up, down), 0.0, WIDE)
    share = divide(weights, network.island[units.bus])
    q_up, q_down = units.q_max[:, 0] - qg[:, 1], qg[:, 1] - units.q_min[:, 0]
    droop = _DROOP if security.response == "corrective" else 0.0
    return ACOutages(
        network, np.ones(len(network.branch)), vm, va, Reserve(up, down, share, q_up, q_down, droop)
    )


class _Trial:
    """The problem of one contingency: a stage that is given, and the state after an outage."""

    def __init__(self, problem: MultiStage, security: Security, out: str) -> None:
        self.out = out
        self.problem = problem.contingency_problem(security, out)

    def plan(self, stage: Stage) -> Plan:
        """Return the state that lacks least after the outage."""
        problem = self.problem
        expected = {
            (kind, field): values[:, [min(stage.column, values.shape[1] - 1)]]
            for kind, field in problem.model.series
            for values in (stage.network.tables[kind].arrays[field],)
        }
        request = Request(stage.time, {}, End(), expected, problem.horizon)
        return problem.solve_once(request, limits=dict(self._given(stage.state)))

    def outcome(self, stage: Stage) -> Outcome:
        """Return what follows from the outage after a stage."""
        plan = self.plan(stage)
        worst = self._worst(plan) if plan.optimal else None
        status = "violated" if worst or plan.infeasible else "secure" if plan.optimal else "diverged"
        return Outcome(self.out, stage.scenario, stage.number, status, worst)

    def _given(self, state: State) -> Iterator[tuple[str, tuple[Array, Array]]]:
        """Yield the bounds that fix the variables of the stage, and free the rows that led to them."""
        model, program = self.problem.model, self.problem.compile()
        for name, block in program.variables.items():
            declared = model.published.get(name) or model.states.get(name) or model.bounds.get(name)
            values = None if declared is None or declared.kind == "branch" else state(name)
            nodes = model.horizon.columns(block.stages)
            if values is None or nodes is None:
                continue
            fixed = np.full(block.shape, np.nan)
            fixed[:, nodes == 0] = values[:, None]
            yield name, (fixed, fixed)
        for name, block in program.rows.items():
            source = model.bounds.get(name)
            nodes = np.arange(2) if source is None or source.nodes is None else source.nodes
            if nodes.size == block.stages:
                free = np.where(np.broadcast_to(nodes <= 0, block.shape), np.inf, np.nan)
                yield name, (-free, free)

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
