"""Assessment: which outages a plan, or the present dispatch, does not survive."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from opfmodel.errors import ModelError, shown
from opfmodel.model.elastic import shortages
from opfmodel.plan.end import End
from opfmodel.plan.multistage import MultiStage
from opfmodel.plan.request import Request
from opfmodel.plan.result import Plan
from opfmodel.plan.security import Security, cut_off

if TYPE_CHECKING:
    from opfmodel.network.arrays import PerUnitNetwork
    from opfmodel.plan.power_flow_result import PowerFlowResult

__all__ = ["Assessment", "Cut", "Outcome", "Worst", "assess"]

Array = npt.NDArray[np.float64]
State = Callable[[str], "Array | None"]  # values of a variable in per unit, by its name


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


class Cut(NamedTuple):
    """A branch whose outage splits the grid: peak demand and capacity of the part that it cuts off, MW."""

    out: str
    load_mw: float
    generation_mw: float


@dataclass(frozen=True)
class Assessment:
    """Outcomes of all outages after all stages, and the outages that split the grid."""

    outcomes: tuple[Outcome, ...]
    islanding: tuple[Cut, ...]

    @property
    def secure(self) -> bool:
        """Whether every outage that does not split the grid is survived."""
        return all(outcome.status == "secure" for outcome in self.outcomes)

    @property
    def violated(self) -> tuple[Outcome, ...]:
        """Outcomes that are not secure, those that lack most first; undecided ones last."""
        found = [outcome for outcome in self.outcomes if outcome.status != "secure"]
        size = {outcome: outcome.worst.value if outcome.worst else np.inf for outcome in found}
        return tuple(sorted(found, key=lambda o: (o.status != "violated", -size[o])))

    def as_dict(self) -> dict[str, object]:
        """Return the assessment as plain data."""

        def plain(outcome: Outcome) -> dict[str, object]:
            worst = outcome.worst
            fields = None if worst is None else {k: v for k, v in worst._asdict().items() if k != "text"}
            return {**outcome._asdict(), "worst": fields}

        return {
            "secure": self.secure,
            "contingencies": [plain(outcome) for outcome in self.outcomes],
            "islanding": [cut._asdict() for cut in self.islanding],
        }


def assess(dispatch: Plan | PowerFlowResult, security: Security | None = None) -> Assessment:
    """Find the outages that a plan, or the dispatch of a power flow, does not survive.

    After every stage and for every outage, the problem of that contingency alone is solved with soft limits,
    from the state that the dispatch leaves: whatever it lacks, no permitted response can provide. Where the
    formulation is not convex, this is the verdict of a local solver.

    Parameters
    ----------
    dispatch
        An optimal plan of any formulation that can be secured, or a power flow that converged. Of a plan, its
        own formulation is used; of a power flow, ``ac``.
    security
        Outages and permitted response; by default those of the plan's problem, else all branches with a
        corrective response.

    Raises
    ------
    ModelError
        The plan is not optimal, or the power flow diverged.
    IncompatibleError
        The formulation of the plan cannot be secured.

    Examples
    --------
    >>> import opfmodel as om
    >>> grid = om.Network("two-bus")
    >>> grid.north, grid.south = om.Bus(), om.Bus()
    >>> grid.one = om.Branch("north", "south", r=0.01, x=0.1, rating=80)
    >>> grid.two = om.Branch("north", "south", r=0.01, x=0.1, rating=80)
    >>> grid.coal = om.Generator("north", p=(0, 200), q=(-100, 100), cost=om.Polynomial(0, 20, 0))
    >>> grid.town = om.Load("south", p=90)
    >>> found = om.assess(om.MultiStage(grid).solve())
    >>> found.secure, [outcome.out for outcome in found.violated]
    (False, ['one', 'two'])
    """
    if isinstance(dispatch, Plan):
        problem, stages = dispatch.problem, _stages_of(dispatch)
    else:
        problem, stages = _stage_of(dispatch)
    own = problem.security or Security() if security is None else security
    if not isinstance(own, Security):
        raise ModelError(f"security = {shown(own)}: must be None or an object of class Security")
    outcomes = []
    for out in own.outages(problem.peak):
        trial = _Trial(problem, own, out)
        outcomes += [trial.outcome(stage) for stage in stages]
    outcomes.sort(key=lambda outcome: outcome.stage)
    return Assessment(tuple(outcomes), tuple(Cut(*cut) for cut in cut_off(problem.peak)))


class _Stage(NamedTuple):
    """A stage after which outages happen: its data and its state."""

    number: int
    scenario: str
    time: int
    network: PerUnitNetwork
    column: int
    state: State


def _stages_of(plan: Plan) -> list[_Stage]:
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
        _Stage(node, horizon.scenario[node], int(moments[node]), plan.network, node, state(node))
        for node in range(len(horizon))
    ]


def _stage_of(flow: PowerFlowResult) -> tuple[MultiStage, list[_Stage]]:
    if not flow.converged:
        raise ModelError("the power flow diverged: there is no dispatch to assess")
    problem = MultiStage(flow.network, profiles={})
    values = flow.per_unit()
    return problem, [_Stage(0, "", 0, flow.arrays, 0, values.get)]


class _Trial:
    """The problem of one contingency: a stage that is given, and the state after an outage."""

    def __init__(self, problem: MultiStage, security: Security, out: str) -> None:
        self.out = out
        self.problem = problem.contingency_problem(security, out)

    def outcome(self, stage: _Stage) -> Outcome:
        """Return what follows from the outage after a stage."""
        problem = self.problem
        expected = {
            (kind, field): values[:, [min(stage.column, values.shape[1] - 1)]]
            for kind, field in problem.model.series
            for values in (stage.network.tables[kind].arrays[field],)
        }
        request = Request(stage.time, {}, End(), expected, problem.horizon)
        plan = problem.solve_once(request, limits=dict(self._given(stage.state)))
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
