"""Assessment: which outages a plan, or the present dispatch, does not survive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from opfmodel.errors import ModelError, shown
from opfmodel.plan.multistage import MultiStage
from opfmodel.plan.outages import cut_off
from opfmodel.plan.power_flow_result import PowerFlowResult
from opfmodel.plan.response import Outcome, Responses, Stage, stages_of
from opfmodel.plan.result import Plan
from opfmodel.plan.security import Security

__all__ = ["Assessment", "Cut", "assess"]


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
        problem, stages = dispatch.problem, stages_of(dispatch)
    elif not isinstance(dispatch, PowerFlowResult):
        raise ModelError(f"dispatch = {shown(dispatch)}: must be a plan or the result of a power flow")
    else:
        problem, stages = _stage_of(dispatch)
    own = problem.security or Security() if security is None else security
    if not isinstance(own, Security):
        raise ModelError(f"security = {shown(own)}: must be None or an object of class Security")
    already = dispatch.request.out if isinstance(dispatch, Plan) else ()
    responses = Responses(problem, own)
    outages = responses.possible(already)
    outcomes = [outcome for stage in stages for outcome in responses.outcomes(stage, outages, already)]
    return Assessment(tuple(outcomes), tuple(Cut(*cut) for cut in cut_off(problem.peak, already)))


def _stage_of(flow: PowerFlowResult) -> tuple[MultiStage, list[Stage]]:
    if not flow.converged:
        raise ModelError("the power flow diverged: there is no dispatch to assess")
    problem = MultiStage(flow.network, profiles={})
    values = flow.per_unit()
    return problem, [Stage(0, "", 0, flow.arrays, 0, values.get)]
